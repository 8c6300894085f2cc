"""Vector's ASC log, as CANalyzer, CANoe, python-can and other tools write it.

    date Sam Sep 30 15:06:13.191 2017                     local time; also "am"/"pm", and German names
    base hex  timestamps absolute                         or dec: of identifiers, length codes and data; or relative
    internal events logged
    // version 9.0.0
    Begin Triggerblock Sam Sep 30 15:06:13.191 2017
       0.000000 Start of measurement
       0.015991 CAN 1 Status:chip status error active
       1.015991 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
       3.098426 1  18EBFF00x       Rx   d 8 01 A0 0F A6 60 3B D1 40  Length = 273910 BitCount = 141 ID = 418119424x
       3.197693 1  6F8             Tx   r 8
       4.501000 2  ErrorFrame	Flags = 0xe CodeExt = 0x20a2 …
      30.005021 CANFD   1 Rx  30a  Name   1 0 9 12 01 02 … 0C  102203 133 303000 e0006659 46500250 …
    End TriggerBlock

1. Every line is one of: frame, header or comment, blank, an event that is not a frame (`others`, by kind), unreadable.
2. Times are from 1970 when the file has a date, and from the start of the measurement when it has none.
3. A line that announces more bytes than it holds is unreadable, not a shorter frame. So is a CANFD line whose length code
   and length differ, or that ends before its flags, which alone say whether it is a CAN FD frame.

*Facts*: Vector's description of the format ("CAN, Log & Trigger ASC Logging Format", 1.3.5), logs of CANoe 9 to 12 and of
python-can. On a CANFD line the flags field after the data says what the frame is: bit 4 remote, 12 FD, 13 bit rate
switch, 14 error state. A CANFD line without bit 12 is a classic frame on an FD channel.
*Choice*: channels count from 1 there and from 0 here, as in python-can. The date of the first trigger block goes before that
of the header, as python-can's header holds the time of writing. A fraction of a date of up to three digits is milliseconds:
python-can writes 13.5 for 13.005 s. Relative times are added up.
*Doubt*: a message may have its name instead of its number; then "ID =" behind the data must give the number. Where both are
numbers and contradict each other, the column goes before: it is what all programs write.
"""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime

import numpy as np

from aces_bus import Frame, FrameTable
from aces_bus.frame_table import FrameFlag
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.base import printable_start
from aces_bus.recordings.text.rows import FrameRow, LineCapture, RowText, UnreadableRow

from .words import Ints, Mask, Word, Words, channel_numbers

_TIMED = re.compile(rb"([0-9]{1,12}\.[0-9]{1,9})\s+(.*)", re.DOTALL)
_CLASSIC = re.compile(
    rb"([0-9]{1,5})\s+(\S{1,128})\s+([RT]x|TxRq)\s+([dr])\b\s*(.*)", re.DOTALL | re.IGNORECASE
)
_ERROR_FRAME = re.compile(rb"([0-9]{1,5})\s+ErrorFrame(?:\s|$)", re.IGNORECASE)
_FD_LINE = re.compile(rb"CANFD\s+([0-9]{1,5})\s+([RT]x|TxRq)\s+(.*)", re.DOTALL | re.IGNORECASE)
_NUMBER = re.compile(rb"\bID = ([0-9]{1,10})(x?)", re.IGNORECASE)
_FIELDS = re.compile(rb"\s*(?:Length|BitCount|ID) = ", re.IGNORECASE)
_HEADER = re.compile(
    rb"//|;|date\b|base\b|(?:no\s+)?internal\s+events\s+logged|begin\s+triggerblock|end\s+triggerblock|previous log file",
    re.IGNORECASE,
)
_BASE = re.compile(rb"base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
_DATED = re.compile(rb"(?:(date)|begin\s+triggerblock)\b\s*(.*)", re.IGNORECASE)
_START = re.compile(rb"[0-9.]+\s+Start of measurement\b", re.IGNORECASE)

#: What the first word behind the time stamp, or behind the channel, is for events that are not frames.
_EVENTS: tuple[tuple[re.Pattern[bytes], str], ...] = tuple(
    (re.compile(pattern, re.IGNORECASE), kind)
    for pattern, kind in (
        (rb"(?:[0-9]+\s+)?Statistic:", "bus statistics"),
        (rb"CAN\s+[0-9]+\s+Status:|[0-9]+\s+Status:", "chip states"),
        (rb"(?:CANFD\s+)?[0-9]+\s+(?:[RT]x\s+)?OverloadFrame\b", "overload frames"),
        (rb"(?:Li|L[0-9]+|LIN[0-9]*)\s+[0-9A-Fa-f]+\s+[RT]x\b", "LIN frames"),
        (rb"(?:Li|L[0-9]+|LIN[0-9]*)\b", "LIN events"),
        (rb"(?:[0-9]+\s+)?J1939", "J1939 events"),
        (rb"CANXL\b", "CAN XL frames"),
        (rb"(?:Fr|FlexRay)\b", "FlexRay events"),
        (rb"ETH", "Ethernet events"),
        (rb"SV:", "system variables"),
        (rb"Start of measurement\b|log trigger event\b|TriggerEvent\b", "measurement events"),
        (rb"[^\s=]+\s*:=", "variables"),
        (rb"(?!CAN(?:FD)?\b)[A-Za-z_][\w:.-]*(?:\s|$)", "other events"),
    )
)


class AscCapture(LineCapture):
    """Frames of a Vector ASC log."""

    format = "Vector ASC log"
    _TURN = re.compile(
        rb"\s*(?:date|base|begin\s+triggerblock|[0-9.]+\s+Start of measurement)\b", re.IGNORECASE
    )

    _BEGINS = re.compile(
        rb"[0-9]{1,12}\.[0-9]{1,9}\s+(?:CANFD\s+[0-9]{1,5}\s+(?:[RT]x|TxRq)\s"
        rb"|[0-9]{1,5}\s+(?:\S{1,128}\s+(?:[RT]x|TxRq)\s+[dr]\b|ErrorFrame\b))",
        re.IGNORECASE,
    )

    _base = 16
    _is_relative = False
    _origin = 0  # ns from 1970 to the start of the measurement
    _clock = 0  # ns, of the last line when times are relative
    _has_block = False  # the origin is that of a trigger block
    _next_origin: int | None = None  # of a trigger block whose measurement has not started yet

    # ---- one line

    def _line(self, text: bytes) -> FrameRow | None:
        if _HEADER.match(text):
            self._header(text)
            self._comment()
            return None
        timed = _TIMED.fullmatch(text)
        if timed is None:
            raise UnreadableRow("not a line of an ASC log")
        time = RowText.nanoseconds(timed[1])
        if self._is_relative:
            self._clock += time
            time = self._clock
        return self._event(self._origin + time, timed[2], text)

    def _event(self, time: int, text: bytes, line: bytes) -> FrameRow | None:
        if found := _CLASSIC.fullmatch(text):
            return self._classic(found, time)
        if found := _FD_LINE.fullmatch(text):
            return self._fd(found, time)
        if found := _ERROR_FRAME.match(text):
            return FrameRow(Frame(0, channel=RowText.one_less(int(found[1])), is_error_frame=True), time)
        if _START.match(line) and self._next_origin is not None:
            self._origin, self._next_origin = self._next_origin, None
        for pattern, kind in _EVENTS:
            if pattern.match(text):
                self._other(kind)
                return None
        raise UnreadableRow("neither a frame nor an event of an ASC log")

    def _classic(self, found: re.Match[bytes], time: int) -> FrameRow | None:
        channel, name, way, kind, rest = found.groups()
        if way.lower() == b"txrq":
            self._other("transmit requests")
            return None
        identifier, extended = self._identifier(name, rest)
        remote = kind in b"rR"
        cells = rest.split()
        size = None
        if not remote or (cells and not _FIELDS.match(rest)):
            if not cells:
                raise UnreadableRow("no data length code")
            size = RowText.CLASSIC_LENGTHS.get(RowText.integer(cells[0], self._base, "data length code"))
            if size is None:
                raise UnreadableRow(f"data length code {printable_start(cells[0])} is more than 15")
        data = b"" if remote else self._data(cells[1:], size or 0)
        if (
            not remote
            and len(cells) > 1 + len(data)
            and re.fullmatch(rb"[0-9A-Fa-f]{1,3}", cells[1 + len(data)])
        ):
            raise UnreadableRow(f"more than the {len(data)} bytes that are announced")
        return FrameRow(
            Frame(
                identifier,
                data,
                None,
                RowText.one_less(int(channel)),
                extended,
                remote,
                is_rx=way.lower() == b"rx",
                dlc=(size or 0) if remote else None,
            ),
            time,
        )

    def _fd(self, found: re.Match[bytes], time: int) -> FrameRow | None:
        channel, way, rest = found.groups()
        if way.lower() == b"txrq":
            self._other("transmit requests")
            return None
        cells = rest.split()
        if cells and cells[0].lower() == b"errorframe":
            return FrameRow(
                Frame(
                    0, channel=RowText.one_less(int(channel)), is_error_frame=True, is_rx=way.lower() == b"rx"
                ),
                time,
            )
        if len(cells) > 1 and cells[1] not in (b"0", b"1"):
            del cells[1]  # the symbolic name
        if len(cells) < 5 or cells[1] not in (b"0", b"1") or cells[2] not in (b"0", b"1"):
            raise UnreadableRow("a CANFD line needs identifier, BRS, ESI, length code and length")
        identifier, extended = self._identifier(cells[0], b"")
        code = RowText.integer(cells[3], self._base, "data length code")
        size = RowText.integer(cells[4], 10, "length")
        if code not in RowText.FD_LENGTHS_BY_CODE:
            raise UnreadableRow(f"data length code {code} is more than 15")
        if size not in FD_LENGTHS:
            raise UnreadableRow(f"a CAN FD frame cannot carry {size} data bytes")
        data = self._data(cells[5:], size)
        if self._base == 16 and any(len(cell) != 2 for cell in cells[5 : 5 + size]):
            raise UnreadableRow(f"{size} bytes are announced, and not so many of two digits are there")
        if len(cells) < 8 + size:
            raise UnreadableRow("the line ends before its flags, which say whether it is a CAN FD frame")
        flags = RowText.integer(cells[7 + size], 16, "flags")
        remote = bool(flags & 0x10) or (size == 0 and code > 0)
        switched = cells[1] == b"1"
        fd = not remote and (bool(flags & 0x1000) or size > 8 or switched)
        stated = (RowText.FD_LENGTHS_BY_CODE if fd else RowText.CLASSIC_LENGTHS)[code]
        if not remote and size != stated:
            raise UnreadableRow(f"length code {code} means {stated} bytes, and {size} are announced")
        return FrameRow(
            Frame(
                identifier,
                data if not remote else b"",
                None,
                RowText.one_less(int(channel)),
                extended,
                remote,
                False,
                fd,
                fd and switched,
                fd and cells[2] == b"1",
                way.lower() == b"rx",
                RowText.CLASSIC_LENGTHS[code] if remote else None,
            ),
            time,
        )

    def _data(self, cells: list[bytes], size: int) -> bytes:
        return RowText.data(cells, size, self._base)

    def _identifier(self, name: bytes, rest: bytes) -> tuple[int, bool]:
        extended = name[-1:] in b"xX"
        digits = name[:-1] if extended else name
        found = _NUMBER.search(rest)
        try:
            number = RowText.integer(digits, self._base, "identifier")
        except UnreadableRow:
            if found is None:
                raise
        else:  # a name may read as a number, but seldom as one that a frame can have
            if found is None or number <= (0x1FFF_FFFF if extended else 0x7FF):
                return number, extended
        return int(found[1]), found[2] != b""

    # ---- headers

    def _header(self, text: bytes) -> None:
        if found := _BASE.match(text):
            self._base = 16 if found[1].lower() == b"hex" else 10
            self._is_relative = found[2] is not None and found[2].lower() == b"relative"
        elif found := _DATED.match(text):
            is_header, said = found[1] is not None, found[2]
            if not said or said.startswith(b";"):
                return
            origin = date_ns(said)
            if origin is None:
                raise UnreadableRow("this date is not understood; times count from where they did")
            if is_header:
                self._origin, self._has_block, self._next_origin = origin, False, None
            elif self._has_block:
                self._next_origin = origin
            else:
                self._origin, self._has_block = origin, True
            if self._next_origin is None:
                self._clock = 0

    # ---- many lines

    def _quick(self, block: bytes) -> tuple[Mask, FrameTable] | None:
        if self._base != 16 or self._is_relative:
            return None
        words = Words(block)
        is_fd = words.is_text(words.word(1), b"CANFD")
        usual = np.zeros(len(is_fd), np.bool_)
        places: list[Word] = []
        tables: list[FrameTable] = []
        for lines, columns in ((~is_fd, self._classic_columns), (is_fd, self._fd_columns)):
            if lines.any():
                good, bus, table = columns(words.take(lines))
                channel = channel_numbers(bus[good], self.channels, RowText.one_less)
                places.append(np.flatnonzero(lines)[good])
                tables.append(replace(table.take(good), channel=channel))
                usual[places[-1]] = True
        if not tables:
            return usual, FrameTable.empty(self.channels)
        return usual, FrameTable.concat(tables).take(np.argsort(np.concatenate(places), kind="stable"))

    def _classic_columns(self, words: Words) -> tuple[Mask, Ints, FrameTable]:
        word = words.word
        good, channel, table = self._common(words, 1, 2, 3)
        good &= (words.count >= 6) & words.one_of(word(4), b"d")[1]
        code, is_code = words.one_of(word(5), b"012345678")
        length = (code - 0x30) * is_code
        data, is_data = words.data(word(6), length)
        good &= is_code & is_data
        rest = words.count - 6 - length
        if rest[good].any():
            behind = 6 + length.astype(np.intp)
            number, _, is_number = words.number(
                word(behind + 8), 10, 1, 10, behind=words.last(word(behind + 8)) == ord("x")
            )
            agrees = is_number & (rest == 9) & (number == table.id)
            agrees &= (words.last(word(behind + 8)) == ord("x")) == (table.flags & FrameFlag.EXTENDED != 0)
            for place, text in enumerate((b"Length", b"=", None, b"BitCount", b"=", None, b"ID", b"=")):
                if text is not None:
                    agrees &= words.is_text(word(behind + place), text)
            good &= (rest == 0) | agrees
        return good, channel, replace(table, length=length, data=data)

    def _fd_columns(self, words: Words) -> tuple[Mask, Ints, FrameTable]:
        word = words.word
        good, channel, table = self._common(words, 2, 4, 3)
        begin = 6 - words.one_of(word(5), b"01")[1].astype(np.intp)  # there may be a symbolic name
        switched, is_switch = words.one_of(word(begin), b"01")
        state, is_state = words.one_of(word(begin + 1), b"01")
        code, _, is_code = words.number(word(begin + 2), 16, 1, 1)
        size, _, is_size = words.number(word(begin + 3), 10, 1, 2)
        good &= is_switch & is_state & is_code & is_size & (size > 0) & (size == _FD_SIZES[code & 15])
        length = (size * good).astype(np.uint8)
        data, is_data = words.data(word(begin + 4), length)
        flags, _, is_flags = words.number(word(begin + 6 + length), 16, 1, 8)
        good &= is_data & is_flags & (flags & 0x1010 == 0x1000) & (words.count >= begin + 7 + length)
        bits = (switched == ord("1")) * np.uint8(FrameFlag.BITRATE_SWITCH) | (state == ord("1")) * np.uint8(
            FrameFlag.ERROR_STATE
        )
        return (
            good,
            channel,
            replace(table, length=length, data=data, flags=table.flags | np.uint8(FrameFlag.FD) | bits),
        )

    def _common(self, words: Words, channel: int, identifier: int, way: int) -> tuple[Mask, Ints, FrameTable]:
        """Return channel, and a table of time, identifier and direction; all but the time are at these words."""
        word = words.word
        time, good = words.time(word(0), 9)
        bus, _, is_bus = words.number(word(channel), 10, 1, 5)
        extended = (words.last(word(identifier)) | 0x20) == ord("x")
        number, _, is_number = words.number(word(identifier), 16, 1, 8, behind=extended)
        received = words.is_text(word(way), b"Rx")
        good &= words.fits & is_bus & is_number & (number <= np.where(extended, 0x1FFF_FFFF, 0x7FF))
        good &= received | words.is_text(word(way), b"Tx")
        return (
            good,
            bus,
            FrameTable(
                time + self._origin,
                np.zeros(len(time), np.uint16),
                number.astype(np.uint32),
                extended * np.uint8(FrameFlag.EXTENDED)
                | np.where(received, np.uint8(FrameFlag.RX), np.uint8(FrameFlag.TX)),
                np.zeros(len(time), np.uint8),
                np.zeros((len(time), 8), np.uint8),
                self.channels,
            ),
        )


_FD_SIZES = np.array(list(RowText.FD_LENGTHS_BY_CODE.values()))


# ---- dates ---------------------------------------------------------------------------------------------------------

_MONTHS = {
    name: number
    for number, names in enumerate(
        (
            "jan",
            "feb",
            "mar mär mrz",
            "apr",
            "may mai",
            "jun",
            "jul",
            "aug",
            "sep",
            "oct okt",
            "nov",
            "dec dez",
        ),
        1,
    )
    for name in names.split()
}
_DATE = re.compile(
    r"(?:\w{2,12}\.?,?\s+)??(?P<month>[^\W\d]{3,9}\.?|\d{1,2}月?)\s+(?P<day>\d{1,2})\.?,?\s+"
    r"(?P<hour>\d{1,2}):(?P<minute>\d{1,2}):(?P<second>\d{1,2})(?:[.,:](?P<fraction>\d{1,9}))?"
    r"(?:\s*(?P<half>[ap])\.?m\.?)?\s+(?P<year>\d{4})",
    re.IGNORECASE,
)


def date_ns(text: bytes) -> int | None:
    """Return nanoseconds from 1970 of a date as ASC files write it, in local time; None for another text.

    >>> date_ns(b"Fre M\\xe4r 3 09:21:13.159 pm 2023") == date_ns("Fri Mar 3 21:21:13.159 2023".encode())
    True
    """
    try:
        said = text.decode()
    except UnicodeDecodeError:
        said = text.decode("cp1252", "replace")  # what Vector's tools write in Western Europe
    found = _DATE.match(said.strip())
    if found is None:
        return None
    month = found["month"].rstrip(".月").lower()
    number = int(month) if month.isdigit() else _MONTHS.get(month[:3], 0)
    hour = int(found["hour"])
    if found["half"]:
        hour = hour % 12 + (12 if found["half"] in "pP" else 0) if hour <= 12 else hour
    fraction = found["fraction"] or "0"
    try:
        moment = datetime(
            int(found["year"]), number, int(found["day"]), hour, int(found["minute"]), int(found["second"])
        )
        seconds = int(moment.timestamp())
    except (ValueError, OverflowError, OSError):
        return None
    rest = int(fraction) * 1_000_000 if len(fraction) <= 3 else int(fraction.ljust(9, "0"))
    instant = seconds * 1_000_000_000 + rest
    return instant if abs(instant) < RowText.MAX_ORIGIN else None
