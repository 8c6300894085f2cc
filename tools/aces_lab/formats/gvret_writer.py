"""SavvyCAN's own CSV, named after the GVRET firmware.

    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    1436509052249713,000005F4,false,Rx,0,8,00,09,1C,46,00,00,00,01,

1. Times are whole microseconds as the recording counts them, from 1970 in most; finer ones are rounded, and counted.
2. Remote and error frames have no mark in it: they are left out and counted, as they would be read as data.

*Facts*: the files that SavvyCAN writes (`GvretCapture` says which). Data of up to 8 bytes are filled up with zeros.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from aces_bus import FrameTable
from aces_bus.frame_table import FrameFlag
from aces_bus.recordings.write.base import ChannelNumbers, FrameWriter
from aces_bus.recordings.write.text import ColumnText

_HEADER = b"Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
_EXTENDED = ColumnText.choices([b",false,", b",true,"])
_WAYS = ColumnText.choices([b"Rx,", b"Tx,"])
_BYTES = ColumnText.choices([b"%02X," % number for number in range(256)])


class GvretWriter(FrameWriter):
    """Frames as lines of a GVRET file."""

    format = "gvret"
    keeps_error_width = True  # it leaves error frames out

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        self._numbers = self._channels = ChannelNumbers()
        file.write(_HEADER)

    def _encoded(self, table: FrameTable) -> bytes:
        flags = table.flags
        self.lose("remote frames (left out)", np.count_nonzero(flags & FrameFlag.REMOTE))
        self.lose("error frames (left out)", np.count_nonzero(flags & FrameFlag.ERROR))
        if (flags & (FrameFlag.REMOTE | FrameFlag.ERROR)).any():
            table = table.take(np.flatnonzero(flags & (FrameFlag.REMOTE | FrameFlag.ERROR) == 0))
            flags = table.flags
        n = len(table)
        if not n:
            return b""
        self.lose(
            "unknown directions (written as received)",
            np.count_nonzero(flags & (FrameFlag.RX | FrameFlag.TX) == 0),
        )
        self.lose_fd(table)
        time = self._epoch_times(table)
        self.lose("times finer than 1 µs", np.count_nonzero(time % 1000))
        length = table.length
        width = max(8, int(length.max()))
        data = np.zeros((n, width), np.uint8)
        data[:, : table.data.shape[1]] = table.data[:, :width]
        is_there = np.arange(width) < np.maximum(length, 8)[:, None]
        cells = _BYTES[np.where(np.arange(width) < length[:, None], data, 0)] * is_there[:, :, None]
        return ColumnText.join(
            [
                ColumnText.decimal((time + 500) // 1000, 19, least=1),
                b",",
                ColumnText.hexadecimal(table.id),
                _EXTENDED[(flags & FrameFlag.EXTENDED != 0).astype(np.uint8)],
                _WAYS[(flags & FrameFlag.TX != 0).astype(np.uint8)],
                ColumnText.decimal(self._numbers.numbers(table) - 1, 5, least=1),
                b",",
                ColumnText.decimal(length, 2, least=1),
                b",",
                cells.reshape(n, -1),
                b"\n",
            ],
            n,
        )
