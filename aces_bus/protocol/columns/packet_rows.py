"""Packets as rows: each packet's bytes beside each other, zeros behind its end.

1. Rows are uint8 (n, width), contiguous, their width a multiple of 8, so that they are also rows of words.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from .table import Array, Column, ColumnKind

#: The first n bytes of a little-endian word.
_MASKS = np.array([(1 << 8 * n) - 1 for n in range(9)], np.uint64)


def packet_rows(buffer: bytes, starts: Array, sizes: Array, width: int) -> Array:
    """The packets at `starts` as rows of `width` bytes."""
    missing = int(starts[-1]) + width - len(buffer)
    if missing > 0:
        buffer += bytes(missing)
    # One item of `width` bytes a packet: copied as a whole, wherever it stands.
    items = np.ndarray(len(buffer) - width + 1, f"V{width}", buffer, strides=(1,))
    rows: Array = items[starts].view(np.uint8).reshape(-1, width)
    least, most = int(sizes.min()), int(sizes.max())
    if least < width:
        words = rows.view("<u8")
        for at in range(8 * (least // 8), width, 8):
            if at >= most:
                words[:, at // 8] = 0
            else:
                masks = _MASKS.take(np.clip(np.arange(most + 1) - at, 0, 8))
                words[:, at // 8] &= masks.take(sizes)
    return rows


def take_rows(rows: Array, which: Array) -> Array:
    """Some of the rows, copied as wholes."""
    width = rows.shape[1]
    found: Array = rows.view(f"V{width}").ravel()[which].view(np.uint8).reshape(-1, width)
    return found


def cells_of(rows: Array, sizes: Array, start: int, size: int | None, tail: int) -> Array:
    """Bytes of each packet as Python objects: `size` from `start`, or (None) all up to `tail` bytes before its end.

    Packets of one length are cut at once.
    """
    found = np.empty(len(rows), object)
    if size is not None:
        found[:] = _cells(rows, start, size)
        return found
    counts = np.bincount(sizes)
    for length in np.flatnonzero(counts).tolist():
        if int(counts[length]) == len(rows):
            found[:] = _cells(rows, start, length - tail - start)
        else:
            some = np.flatnonzero(sizes == length)
            found[some] = _cells(take_rows(rows, some), start, length - tail - start)
    return found


class ByteColumn(Column):
    """A column of bytes that are still where they were: objects are made when `values` is asked for, and kept.

    Made of rows, the sizes of their packets, and where in them the bytes stand (see `cells_of`).
    """

    def __init__(
        self, kind: ColumnKind, rows: Array, sizes: Array, start: int, size: int | None, tail: int
    ) -> None:
        put = object.__setattr__  # a frozen dataclass
        put(self, "kind", kind)
        put(self, "absent", None)
        put(self, "_where", (rows, sizes, start, size, tail))

    @cached_property
    def values(self) -> Array:  # pyright: ignore[reportIncompatibleVariableOverride]  # computed when asked for
        """Bytes objects."""
        where: tuple[Array, Array, int, int | None, int] = self.__dict__["_where"]
        return cells_of(*where)

    def __len__(self) -> int:
        return len(self.__dict__["_where"][1])


def _cells(rows: Array, start: int, size: int) -> Any:
    if size <= 0:
        return b""
    cells = np.ascontiguousarray(rows[:, start : start + size])
    return cells.view(f"V{size}").ravel().astype(object)
