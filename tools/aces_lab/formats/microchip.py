"""The log of Microchip's CAN bus analyser (*.can, *.csv).

    //---------------------------------
    Microchip Technology Inc.
    CAN BUS Analyzer
    Logging Started: 23/9/2015 22:17:43
    //---------------------------------
    166064;RX;0x21A;8;0xFE;0x36;0x12;0xFE;0x69;0x05;0x07;0xAD;
    505.7052;RX;0x1CFE5FFEx;3;0x01;0x01;0x00;;;;;;

1. Every line is one of: frame, comment (between lines of `//`, these included), blank, unreadable.
2. Fewer bytes than the length, or a direction or number that is not understood, make a line unreadable.
3. Times stay as written, from the start of the recording.

*Facts*: files of the analyser and of SavvyCAN, which describes the columns: time, direction, identifier, length, bytes. An
integer time is in milliseconds, one with a point in seconds. Bytes behind the length are padding.
*Choice*: an identifier is of 29 bits when it ends in x or is greater than 0x7FF; without 0x it is decimal. A line of five
slashes or more, or of two slashes and a rule, begins or ends the comment; other lines of `//` are comments by themselves.
"""

from __future__ import annotations

import re

from aces_bus import Frame
from aces_bus.recordings.base import printable_start
from aces_bus.recordings.text.rows import FrameRow, LineCapture, RowText, UnreadableRow

_RULE = re.compile(rb"//\s*[-=*/_]{3,}|/{5,}")


class MicrochipCapture(LineCapture):
    """Frames of a log of Microchip's CAN bus analyser."""

    format = "Microchip CAN analyser log"
    _BEGINS = re.compile(rb"[0-9.]{1,20}\s*;\s*[RT]X\s*;", re.IGNORECASE)

    _is_comment = False

    def _line(self, text: bytes) -> FrameRow | None:
        if text.startswith(b"//"):
            if _RULE.match(text):
                self._is_comment = not self._is_comment
            self._comment()
            return None
        cells = [cell.strip() for cell in text.split(b";")]
        if len(cells) < 4 or cells[1].upper() not in (b"RX", b"TX"):
            if self._is_comment or text.startswith((b"Microchip", b"CAN BUS Analyzer", b"Logging ")):
                self._comment()
                return None
            if len(cells) < 4:
                raise UnreadableRow("a line needs time, direction, identifier and length")
        is_rx, self._is_comment = RowText.is_received(cells[1]), False
        stamp, _, digits, length, *data = cells
        is_marked = digits[-1:] in b"xX" and digits != b""
        digits = digits[:-1] if is_marked else digits
        number = _number(digits, "identifier")
        size = RowText.integer(length, 10, "length")
        if any(data[size:]) and not all(map(_is_byte, data[size:])):
            raise UnreadableRow("what follows the bytes is none")
        unit = 1_000_000_000 if b"." in stamp else 1_000_000
        frame = Frame(
            number,
            RowText.data([b"%02x" % _byte(cell) for cell in data[:size] if cell], size),
            None,
            None,
            is_marked or number > 0x7FF,
            is_rx=is_rx,
        )
        return FrameRow(frame, RowText.nanoseconds(stamp, unit))


def _number(text: bytes, what: str) -> int:
    return RowText.integer(text, 16 if text[:2] in (b"0x", b"0X") else 10, what)


def _byte(text: bytes) -> int:
    value = _number(text, "byte")
    if value > 255:
        raise UnreadableRow(f"byte {printable_start(text)} is more than 255")
    return value


def _is_byte(text: bytes) -> bool:
    try:
        return text == b"" or _byte(text) >= 0
    except UnreadableRow:
        return False
