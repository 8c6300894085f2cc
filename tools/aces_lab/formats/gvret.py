"""SavvyCAN's own CSV, named after the GVRET firmware.

    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    18970798,000005F4,false,Rx,0,8,00,09,1C,46,00,00,00,01,
    18970900,18DAF110,true,Tx,1,2,02,1A,00,00,00,00,00,00,

1. Every line is one of: frame, header, blank, unreadable.
2. What a cell says and is not understood makes its line unreadable, and so do fewer bytes than LEN.
3. Times are microseconds of the device's clock, or from 1970 where the program was set so: they stay as written.

*Facts*: SavvyCAN's help and the files it writes. Identifiers and data are hexadecimal without 0x. Older versions have no
Dir; then nothing says which way a frame went. Bytes behind LEN are padding.
*Choice*: a frame of more than 8 bytes is CAN FD; the format has no mark for one, nor for remote and error frames.
"""

from __future__ import annotations

import re

import numpy as np

from aces_bus import Frame, FrameTable
from aces_bus.frame_table import FrameFlag
from aces_bus.recordings.base import printable_start
from aces_bus.recordings.text.rows import FrameRow, LineCapture, RowText, UnreadableRow

from .beginnings import GVRET
from .words import Mask, Words, channel_numbers

_US = 1000
_HEAD = re.compile(GVRET, re.IGNORECASE)
_TRUE = {b"true": True, b"1": True, b"false": False, b"0": False}


class GvretCapture(LineCapture):
    """Frames of a SavvyCAN GVRET file."""

    format = "SavvyCAN GVRET CSV"
    _TURN = re.compile(rb"\s*Time", re.IGNORECASE)
    _BEGINS = re.compile(
        rb"[0-9]{1,20}\s*,\s*[0-9A-F]{1,8}\s*,\s*(?:(?:true|false)\s*,|[01]\s*,\s*[RT]x\s*,)", re.IGNORECASE
    )

    _has_way = True

    def _line(self, text: bytes) -> FrameRow | None:
        if header := _HEAD.match(text):
            self._has_way = header[1] is not None
            self._comment()
            return None
        cells = [cell.strip() for cell in text.split(b",")]
        has_way = self._has_way
        if len(cells) < 5 + has_way:
            raise UnreadableRow(f"{len(cells)} columns; time, ID, extended, bus and length are needed")
        extended = _TRUE.get(cells[2].lower())
        if extended is None:
            raise UnreadableRow(f"extended is {printable_start(cells[2])!r}, neither true nor false")
        is_rx = RowText.is_received(cells[3]) if has_way else None
        bus, size, *data = cells[3 + has_way :]
        length = RowText.integer(size, 10, "length")
        return FrameRow(
            Frame(
                RowText.integer(cells[1], 16, "identifier"),
                RowText.data(data, length),
                None,
                str(RowText.integer(bus, 10, "bus")),
                extended,
                is_fd=length > 8,
                is_rx=is_rx,
            ),
            RowText.nanoseconds(cells[0], _US),
        )

    def _quick(self, block: bytes) -> tuple[Mask, FrameTable]:
        words = Words(block, b",\r\n")
        word, has_way = words.word, self._has_way
        bus, size = 3 + has_way, 4 + has_way
        time, _, good = words.number(word(0), 10, 1, 15)
        good &= words.fits & words.is_flush & (words.count > size)
        for cell in range(size):  # two separators would have an empty cell between
            good &= words.is_next(word(cell))
        identifier, _, is_number = words.number(word(1), 16, 1, 8)
        extended = words.is_text(word(2), b"true")
        received, sent = words.is_text(word(3), b"Rx"), words.is_text(word(3), b"Tx")
        channel, _, is_bus = words.number(word(bus), 10, 1, 5)
        length, _, is_length = words.number(word(size), 10, 1, 2)
        good &= is_number & is_bus & is_length & _IS_LENGTH[length & 0xFF]
        good &= extended | words.is_text(word(2), b"false")
        good &= identifier <= np.where(extended, 0x1FFF_FFFF, 0x7FF)
        flags = extended * np.uint8(FrameFlag.EXTENDED) | (length > 8) * np.uint8(FrameFlag.FD)
        if has_way:
            good &= received | sent
            flags |= received * np.uint8(FrameFlag.RX) | sent * np.uint8(FrameFlag.TX)
        data, is_data = words.data(word(size + 1), length * good)
        behind = size + 1 + length.astype(np.intp) * good
        good &= is_data & (words.count >= behind) & (words.count <= size + 1 + np.maximum(length, 8))
        good &= (words.count == behind) | (words.size(word(behind)) <= 2)  # else where another line begins
        return good, FrameTable(
            time[good] * _US,
            channel_numbers(channel[good], self.channels, str),
            identifier[good].astype(np.uint32),
            flags[good],
            length[good].astype(np.uint8),
            data[good],
            self.channels,
        )


_IS_LENGTH = np.isin(np.arange(256), (*range(9), 12, 16, 20, 24, 32, 48, 64))
