"""What `candump -L` writes, with `-x` where the direction is known: one line a frame.

1. A time is in whole microseconds, as candump's, unless nanoseconds are there: then it has nine digits.
2. `CandumpCapture` reads the same frames back, but for what `lossy` counts.

*Facts*: lib.c of can-utils, `snprintf_canframe`; seconds have ten digits in front of the point, as in its log. A remote
frame that asks for 0 bytes is `#R`. A frame without a time gets zero: the format has no word for it.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from ...frame_table import FrameFlag, FrameTable
from .base import FrameWriter, WrittenChannels
from .text import Column, ColumnText

_ERROR_BIT = np.uint32(0x2000_0000)
_WAYS = ColumnText.choices([b"", b" R", b" T", b" R"])
_FD_MARKS = ColumnText.choices([b"", b"#0", b"#1", b"#2", b"#3"])
_REMOTES = ColumnText.choices([b"", b"R", *(b"R%d" % n for n in range(1, 9))])


class CandumpWriter(FrameWriter):
    """Frames as lines of a candump log."""

    format = "candump"

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        self._names = self._channels = WrittenChannels()

    def _encoded(self, table: FrameTable) -> bytes:
        n, flags, channel = len(table), table.flags, table.channel
        names = self._names.row(table.channels, int(channel.max()))
        seconds, nanoseconds = np.divmod(self._epoch_times(table), 1_000_000_000)
        fraction = ColumnText.decimal(nanoseconds, 9)
        whole = nanoseconds % 1000 == 0
        if whole.all():
            fraction = fraction[:, :6]
        elif whole.any():
            fraction = fraction.copy()
            fraction[whole, 6:] = 0
        is_error = (flags & FrameFlag.ERROR).astype(bool)
        wide = (flags & (FrameFlag.EXTENDED | FrameFlag.ERROR)).astype(bool)
        digits = ColumnText.hexadecimal(np.where(is_error, table.id | _ERROR_BIT, table.id))
        if not wide.any():
            digits = digits[:, 5:]
        elif not wide.all():
            digits = digits.copy()
            digits[~wide, :5] = 0
        columns: list[Column | bytes] = [
            b"(",
            ColumnText.decimal(seconds, 10),
            b".",
            fraction,
            b") ",
            ColumnText.choices([name.encode("utf-8", "backslashreplace") for name in names])[channel],
            b" ",
            digits,
            b"#",
        ]
        if (flags & FrameFlag.FD).any():
            mark = 1 + (flags & FrameFlag.BITRATE_SWITCH != 0) + 2 * (flags & FrameFlag.ERROR_STATE != 0)
            columns.append(_FD_MARKS[np.where(flags & FrameFlag.FD != 0, mark, 0)])
        data = ColumnText.data(table)
        remote = (flags & FrameFlag.REMOTE).astype(bool)
        if remote.any():
            columns.append(_REMOTES[np.where(remote, self._remote_lengths(table) + 1, 0)])
            data = ColumnText.only(data, ~remote)
        columns.append(data)
        if (flags & (FrameFlag.RX | FrameFlag.TX)).any():
            columns.append(_WAYS[flags // FrameFlag.RX & 3])
        columns.append(b"\n")
        return ColumnText.join(columns, n)
