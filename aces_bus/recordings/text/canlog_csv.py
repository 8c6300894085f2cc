"""python-can's CSV.

    timestamp,arbitration_id,extended,remote,error,dlc,data
    1483389946.197,0x00dadada,1,0,0,7,WzQyLCA5XQ==

1. Every line is one of: frame, header, blank, unreadable.
2. A line whose dlc is not its number of bytes is unreadable, of an error frame too.
3. It is recognised by its header, exactly: data are base64 here, and hexadecimal in any other CSV.

*Facts*: python-can's documentation of `CSVWriter`. It has no channel, no direction and no mark for CAN FD.
*Choice*: a frame of more than 8 bytes is CAN FD. What python-can writes as data of a remote frame is its length alone.
"""

from __future__ import annotations

import re
from binascii import Error, a2b_base64

import numpy as np
import numpy.typing as npt

from ...frame_table import FrameFlag, FrameTable
from ...frames import Frame
from ..base import printable_start
from ..beginnings import PYTHON_CAN_CSV
from .rows import FrameRow, LineCapture, RowText, UnreadableRow

Mask = npt.NDArray[np.bool_]

_BASE64 = re.compile(rb"[A-Za-z0-9+/]*={0,2}")
_FLAG = {b"1": True, b"0": False}
_USUAL = re.compile(
    rb"(?:([0-9]{1,10})\.([0-9]{1,8}),0x([0-9a-f]{1,8}),([01]),0,0,([0-8]),((?:[A-Za-z0-9+/]{4}){0,2}+"
    rb"(?:[A-Za-z0-9+/]{3}=|[A-Za-z0-9+/]{2}==)?)\r?|[^\n]*)\n"
)


class CanlogCsvCapture(LineCapture):
    """Frames of python-can's CSV."""

    format = "python-can CSV"

    def _line(self, text: bytes) -> FrameRow | None:
        if text == PYTHON_CAN_CSV:
            self._comment()
            return None
        cells = text.split(b",")
        if len(cells) != 7:
            raise UnreadableRow(f"{len(cells)} columns, not 7")
        time, digits, *marks, length, coded = cells
        try:
            extended, remote, error = (_FLAG[mark] for mark in marks)
        except KeyError as wrong:
            raise UnreadableRow(f"{printable_start(wrong.args[0])!r} is neither 0 nor 1") from None
        size = RowText.integer(length, 10, "length")
        RowText.check_remote(remote, error, size)
        data = b"" if remote else _decoded(coded)
        if not remote and len(data) != size:
            raise UnreadableRow(f"{size} bytes are announced, {len(data)} are there")
        return FrameRow(
            Frame(
                RowText.integer(digits, 16, "identifier"),
                data,
                None,
                None,
                extended and not error,
                remote,
                error,
                len(data) > 8,
                dlc=size if remote else None,
            ),
            RowText.nanoseconds(time),
        )

    def _quick(self, block: bytes) -> tuple[Mask, FrameTable]:
        matches: list[tuple[bytes, ...]] = _USUAL.findall(block)
        usual = np.array([match[0] != b"" for match in matches])
        rows = [match for match in matches if match[0]]
        if not rows:
            return usual, FrameTable.empty(self.channels)
        seconds, fractions, ids, marks, sizes, cells = zip(*rows, strict=True)
        time = [int(whole + rest.ljust(9, b"0")) for whole, rest in zip(seconds, fractions, strict=True)]
        identifier = np.array([int(text, 16) for text in ids], np.uint32)
        extended = np.array(marks) == b"1"
        length = np.array([int(text) for text in sizes], np.uint8)
        data = [a2b_base64(cell) for cell in cells]
        good = (identifier <= np.where(extended, 0x1FFF_FFFF, 0x7FF)) & (length == list(map(len, data)))
        usual[np.flatnonzero(usual)[~good]] = False
        table = FrameTable(
            np.array(time, np.int64),
            np.full(len(data), self.channels.number(None), np.uint16),
            identifier,
            extended * np.uint8(FrameFlag.EXTENDED),
            length,
            np.frombuffer(b"".join([some.ljust(8, b"\0")[:8] for some in data]), np.uint8).reshape(-1, 8),
            self.channels,
        )
        return usual, table if bool(good.all()) else table.take(good)


def _decoded(text: bytes) -> bytes:
    try:
        if _BASE64.fullmatch(text):
            return a2b_base64(text)
    except Error:
        pass
    raise UnreadableRow("the data are not base64")
