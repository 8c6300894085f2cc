"""What `candump -L` writes, with `-x` where the direction is known: one line a frame.

1. A time is in whole microseconds, as candump's, unless nanoseconds are there: then it has nine digits.
2. `CandumpCapture` reads the same frames back, but for what `lossy` counts.

*Facts*: lib.c of can-utils, `snprintf_canframe`; seconds have ten digits in front of the point, as in its log. A remote
frame that asks for 0 bytes is `#R`. A frame without a time gets zero: the format has no word for it.
"""

from __future__ import annotations

from typing import BinaryIO, ClassVar

import numpy as np

from ...frame_table import BITRATE_SWITCH, ERROR, ERROR_STATE, EXTENDED, FD, REMOTE, RX, TX, FrameTable
from ._channels import WrittenChannels
from ._losses import WriteLosses, epoch_times
from ._text import Column, blocks, choices, decimal_text, hexadecimal_text, join_columns, only, padded_data

_ERROR_BIT = np.uint32(0x2000_0000)
_WAYS = choices([b"", b" R", b" T", b" R"])
_FD_MARKS = choices([b"", b"#0", b"#1", b"#2", b"#3"])
_REMOTES = choices([b"", b"R", *(b"R%d" % n for n in range(1, 9))])


class CandumpWriter:
    """Frames as lines of a candump log."""

    format: ClassVar[str] = "candump"

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file = file
        self._names = WrittenChannels()
        self._losses = WriteLosses()

    @property
    def lossy(self) -> dict[str, int]:
        return self._losses.with_names(self._names.lost)

    def write(self, table: FrameTable) -> None:
        """Write the frames, in order."""
        for rows in blocks(len(table)):
            self._file.write(self._lines(table.take(rows)))

    def close(self) -> None:
        """Nothing is kept back."""

    def _lines(self, table: FrameTable) -> bytes:
        n, flags, channel = len(table), table.flags, table.channel
        names = self._names.row(table.channels, int(channel.max()))
        seconds, nanoseconds = np.divmod(epoch_times(table, self._losses), 1_000_000_000)
        fraction = decimal_text(nanoseconds, 9)
        whole = nanoseconds % 1000 == 0
        if whole.all():
            fraction = fraction[:, :6]
        elif whole.any():
            fraction = fraction.copy()
            fraction[whole, 6:] = 0
        is_error = (flags & ERROR).astype(bool)
        wide = (flags & (EXTENDED | ERROR)).astype(bool)
        digits = hexadecimal_text(np.where(is_error, table.id | _ERROR_BIT, table.id))
        if not wide.any():
            digits = digits[:, 5:]
        elif not wide.all():
            digits = digits.copy()
            digits[~wide, :5] = 0
        columns: list[Column | bytes] = [
            b"(",
            decimal_text(seconds, 10),
            b".",
            fraction,
            b") ",
            choices([name.encode("utf-8", "backslashreplace") for name in names])[channel],
            b" ",
            digits,
            b"#",
        ]
        if (flags & FD).any():
            mark = 1 + (flags & BITRATE_SWITCH != 0) + 2 * (flags & ERROR_STATE != 0)
            columns.append(_FD_MARKS[np.where(flags & FD != 0, mark, 0)])
        data = padded_data(table)
        remote = (flags & REMOTE).astype(bool)
        if remote.any():
            columns.append(_REMOTES[np.where(remote, self._losses.remote_lengths(table) + 1, 0)])
            data = only(data, ~remote)
        columns.append(data)
        if (flags & (RX | TX)).any():
            columns.append(_WAYS[flags // RX & 3])
        columns.append(b"\n")
        return join_columns(columns, n)
