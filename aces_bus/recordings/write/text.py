"""Lines of text for thousands of frames at once, out of columns of characters.

1. A column is an array of shape (n, width) of ASCII codes; NUL is not a character and vanishes when lines are joined.
2. Nothing here loops over frames.

A line of a log is a row of such columns side by side: `lines([constant, column, …])`. A number with fewer digits, a byte
behind a frame's length, a suffix that is not there are NULs. That makes a line 56 codes for candump, and a frame costs about
0.3 µs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ...frame_table import FrameTable

Column = npt.NDArray[np.uint8]
#: Rows at a time: what they need stays in the processor's cache.
ROWS = 8192


def blocks(n: int) -> Iterator[slice]:
    """Yield the rows 0…n-1 in slices of `ROWS`."""
    for start in range(0, n, ROWS):
        yield slice(start, start + ROWS)


class ColumnText:
    """Columns of numbers as text: one row of bytes a frame."""

    @staticmethod
    def join(columns: Sequence[Column | bytes], n: int) -> bytes:
        """Return the columns side by side, without NULs; what is given as bytes is in every line."""
        widths = [len(column) if isinstance(column, bytes) else column.shape[1] for column in columns]
        text = np.empty((n, sum(widths)), np.uint8)
        start = 0
        for column, width in zip(columns, widths, strict=True):
            text[:, start : start + width] = (
                np.frombuffer(column, np.uint8) if isinstance(column, bytes) else column
            )
            start += width
        return text.tobytes().translate(None, b"\0")

    @staticmethod
    def choices(
        texts: Sequence[bytes], *, width: int = 0, right: bool = False, fill: bytes = b"\0"
    ) -> Column:
        """Return a table of texts to take rows from: shape (number of texts, longest), filled to `width` at the
        end or in front.
        """
        width = max(width, *map(len, texts)) if texts else width
        rows = [text.rjust(width, fill) if right else text.ljust(width, fill) for text in texts]
        return np.frombuffer(b"".join(rows), np.uint8).reshape(len(texts), width)

    @staticmethod
    def only(column: Column, mask: npt.NDArray[np.bool_]) -> Column:
        """Return the column where `mask` is set, and nothing elsewhere."""
        return column * mask[:, None]

    @staticmethod
    def decimal(values: npt.NDArray[Any], digits: int, *, least: int = 0, fill: bytes = b"") -> Column:
        """Return the last `digits` decimal digits of numbers ≥ 0.

        With `least`, zeros in front of the last `least` digits become blanks where `fill` has some, counted from the right,
        and vanish elsewhere.
        """
        groups = -(-digits // 4)
        text = np.empty((len(values), groups), np.uint32)
        rest = values.astype(np.int64, copy=False)
        for group in range(groups - 1, -1, -1):
            higher = rest // 10_000
            text[:, group] = _FOUR[rest - higher * 10_000 if group else rest % 10_000]
            rest = higher
        column = text.view(np.uint8)[:, groups * 4 - digits :]
        return _without_zeros(column, least, fill) if least else column

    @staticmethod
    def hexadecimal(values: npt.NDArray[Any], *, least: int = 8, fill: bytes = b"") -> Column:
        """Return uint32 as eight hexadecimal digits; zeros in front of the last `least` as with `decimal`."""
        column = _HEX[values.astype(">u4").view(np.uint8).reshape(-1, 4)].view(np.uint8)
        return _without_zeros(column, least, fill) if least < 8 else column

    @staticmethod
    def data(table: FrameTable, *, blank: bool = False) -> Column:
        """Return the data of each frame as hexadecimal digits; with `blank`, a blank before each byte.

        A remote frame gets as many zeros as the bytes it asks for: mask them with `only`.
        """
        longest = int(table.length.max()) if len(table) else 0
        data = table.data[:, : max(min(longest, table.data.shape[1]), 1)]
        column = (_HEX_BLANK if blank else _HEX)[data].view(np.uint8)
        cell = 4 if blank else 2
        if len(table) and int(table.length.min()) < data.shape[1]:
            wide = np.arange(data.shape[1] * cell) // cell
            column = column * (wide < table.length[:, None])
        return column

    @staticmethod
    def interleaved(n: int, parts: Sequence[tuple[npt.NDArray[Any], bytes]]) -> bytes:
        """Return lines of several kinds in one order: each part has its rows' numbers, which are all of 0…n-1 together."""
        parts = [part for part in parts if len(part[0])]
        if len(parts) == 1:
            return parts[0][1]
        out = [b""] * n
        for rows, text in parts:
            for row, line in zip(rows.tolist(), text.splitlines(keepends=True), strict=True):
                out[row] = line
        return b"".join(out)


_FOUR = np.frombuffer(b"".join(b"%04d" % number for number in range(10_000)), np.uint32)


_HEX = np.frombuffer(b"".join(b"%02X" % number for number in range(256)), np.uint16)
_HEX_BLANK = np.frombuffer(b"".join(b" %02X\0" % number for number in range(256)), np.uint32)


def _without_zeros(column: Column, least: int, fill: bytes) -> Column:
    front = column.shape[1] - least
    used = np.flatnonzero((column[:, :front] != 0x30).any(axis=0))
    start = int(used[0]) if len(used) else front  # in front of it all rows have zeros
    blank = np.frombuffer(fill.rjust(front, b"\0"), np.uint8)
    out = column.copy()
    out[:, :start] = blank[:start]
    leading = np.ones(len(column), np.bool_)
    for place in range(start, front):  # at most nine columns
        leading &= column[:, place] == 0x30
        out[leading, place] = blank[place]
    return out
