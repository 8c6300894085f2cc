"""BUSMASTER's log (*.log).

    ***BUSMASTER Ver 2.4.0***
    ***PROTOCOL CAN***
    ***START DATE AND TIME 8:8:2014 11:49:7:965***              day:month:year hour:minute:second:ms, local time
    ***HEX***                                                   or DEC: of identifiers and data
    ***SYSTEM MODE***                                           times of day; or ABSOLUTE, RELATIVE
    ***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***
    11:49:12:9420 Rx 1 0x023 s 1 40                             s, x: 11 and 29 bits; sr, xr: remote; s-fd, x-fd: CAN FD

1. Every line is one of: frame, header (`***`), blank, message of another bus (`others`), unreadable.
2. A line has exactly as many bytes as it announces; a direction, type or number that is not understood makes it unreadable.
3. In system mode times are from 1970: the day is that of the start, and the next one when the clock goes back by hours.
   In absolute mode they are from the start of the recording, in relative mode they are added up.

*Facts*: logs of BUSMASTER 1.6 to 3.2, and SavvyCAN's help. The last number of a time has four digits, of 100 µs.
*Choice*: a last number of fewer digits is milliseconds, as other programs write it. Channels count from 1, and from 0 here.
The length of a CAN FD frame may be a code: whichever it is, as many bytes must be there.
*Doubt*: how an error line reads differs among versions; a line with the word ERR or ErrorFrame behind its time is an error
frame.
"""

from __future__ import annotations

import re
from datetime import datetime

from aces_bus import Frame
from aces_bus.recordings.text.rows import FrameRow, LineCapture, RowText, UnreadableRow

_SECOND = 1_000_000_000
_DAY = 86_400 * _SECOND
_TIME = re.compile(rb"([0-9]{1,4}):([0-9]{1,2}):([0-9]{1,2}):([0-9]{1,4})\s+(.*)", re.DOTALL)
_STARTED = re.compile(
    rb"\*\*\*START DATE AND TIME ([0-9]{1,2}):([0-9]{1,2}):([0-9]{4}) ([0-9]{1,2}):([0-9]{1,2}):([0-9]{1,2}):([0-9]{1,3})\b",
    re.IGNORECASE,
)
_PROTOCOL = re.compile(rb"\*\*\*PROTOCOL (\w+)", re.IGNORECASE)
_MODE = re.compile(rb"\*\*\*(SYSTEM|ABSOLUTE|RELATIVE) MODE", re.IGNORECASE)
_ERROR = re.compile(rb"(?:[RT]x\s+)?(?:([0-9]{1,5})\s+)?err", re.IGNORECASE)
_TYPES = (b"s", b"x", b"sr", b"xr", b"s-fd", b"x-fd")


class BusmasterCapture(LineCapture):
    """Frames of a BUSMASTER log."""

    format = "BUSMASTER log"

    _BEGINS = re.compile(
        rb"[0-9]{1,4}:[0-9]{1,2}:[0-9]{1,2}:[0-9]{1,4}\s+(?:[RT]x\s|(?:[0-9]{1,5}\s+)?err)", re.IGNORECASE
    )

    _protocol = b"CAN"
    _mode = b"SYSTEM"
    _base = 16
    _start: tuple[int, int] | None = None  # ns from 1970 of its midnight, and of day
    _days = 0
    _last: int | None = None
    _clock = 0

    def _line(self, text: bytes) -> FrameRow | None:
        if text.startswith((b"***", b"-***")):
            self._header(text.lstrip(b"-"))
            self._comment()
            return None
        found = _TIME.fullmatch(text)
        if found is None:
            raise UnreadableRow("not a line of a BUSMASTER log")
        time, rest = self._instant(found), found[5]
        if self._protocol != b"CAN":
            self._other(f"{'LIN frames' if self._protocol == b'LIN' else 'messages of another protocol'}")
            return None
        cells = rest.split()
        if len(cells) < 5 or cells[3].lower() not in _TYPES:
            if error := _ERROR.match(rest):
                channel = RowText.one_less(int(error[1])) if error[1] else None
                return FrameRow(Frame(0, channel=channel, is_error_frame=True), time)
            raise UnreadableRow("a line needs direction, channel, identifier, type and length")
        return FrameRow(self._frame(cells), time)

    def _frame(self, cells: list[bytes]) -> Frame:
        way, channel, digits, kind, code, *data = cells
        is_rx, kind = RowText.is_received(way), kind.lower()
        remote, fd = kind.endswith(b"r"), kind.endswith(b"fd")
        lengths = RowText.FD_LENGTHS_BY_CODE if fd else RowText.CLASSIC_LENGTHS
        number = RowText.integer(code, 10, "length")
        size = number if fd and number in (12, 16, 20, 24, 32, 48, 64) else lengths.get(number)
        if fd and len(data) == lengths.get(number):
            size = len(data)  # 12 may be a length and a code
        if size is None:
            raise UnreadableRow(f"length {number} is more than a frame holds")
        if not remote and len(data) > size:
            raise UnreadableRow(f"{size} bytes are announced, {len(data)} are there")
        is_hex = self._base == 16 or digits[:2] in (b"0x", b"0X")
        return Frame(
            RowText.integer(digits, 16 if is_hex else 10, "identifier"),
            b"" if remote else RowText.data(data, size, self._base),
            None,
            RowText.one_less(RowText.integer(channel, 10, "channel")),
            kind.startswith(b"x"),
            remote,
            is_fd=fd,
            is_rx=is_rx,
            dlc=size if remote else None,
        )

    def _instant(self, found: re.Match[bytes]) -> int:
        hours, minutes, seconds = int(found[1]), int(found[2]), int(found[3])
        last = int(found[4]) * (100_000 if len(found[4]) == 4 else 1_000_000)
        time = ((hours * 60 + minutes) * 60 + seconds) * _SECOND + last
        if self._mode == b"RELATIVE":
            self._clock += time
            return self._clock
        if self._mode == b"ABSOLUTE" or self._start is None:
            return time
        midnight, began = self._start
        previous = began if self._last is None else self._last
        if time < previous - _DAY // 2:
            self._days += 1
        self._last = time
        return midnight + self._days * _DAY + time

    def _header(self, text: bytes) -> None:
        if found := _PROTOCOL.match(text):
            self._protocol = found[1].upper()
        elif found := _MODE.match(text):
            self._mode = found[1].upper()
            self._clock = 0
        elif text[:6].upper() in (b"***HEX", b"***DEC"):
            self._base = 16 if text[3:6].upper() == b"HEX" else 10
        elif found := _STARTED.match(text):
            day, month, year, hour, minute, second, ms = (int(part) for part in found.groups())
            midnight = _midnight(year, month, day)
            if midnight is None:
                raise UnreadableRow("this start time is not a date; times count from midnight")
            self._start = midnight, ((hour * 60 + minute) * 60 + second) * _SECOND + ms * 1_000_000
            self._days, self._last, self._clock = 0, None, 0


def _midnight(year: int, month: int, day: int) -> int | None:
    try:
        found = int(datetime(year, month, day).timestamp()) * _SECOND
    except (ValueError, OverflowError, OSError):
        return None
    return found if abs(found) < RowText.MAX_ORIGIN else None
