"""PEAK's trace files (*.trc), versions 1.0 to 2.1.

    ;$FILEVERSION=2.1
    ;$STARTTIME=41766.4648963872                 days since 30 December 1899
    ;$COLUMNS=N,O,T,B,I,d,R,L,D                  2.x alone; 1.x has fixed columns
          1      1059.900 DT 1      0300 Rx -  7    00 00 00 00 04 00 00        time in ms
          5      1334.416 FD 1      0500 Tx -  9    01 02 … 0C                  L: length code, l: length
          6      1334.222 ER 1         - Rx -  5    04 00 02 00 00              error frame
          7      1334.224 EV 1  User-defined event for bus 1
         13      1336.543 RR 1      0100 Rx -  3                                remote frame

         1)      1059.9  Rx         0300  7  00 00 00 00 04 00 00               1.1; 1.2 has a bus before the type,
         5)      1346.8  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT              1.3 a reserved column behind the identifier,
         7)      1352.7  Rx         0100  3  RTR                                1.0 neither type nor start time

1. Every line is one of: frame, comment or header (`;`), blank, something that is not a frame (`others`), unreadable.
2. Times are from 1970 when the file says when it starts, and from its start when it does not (1.0).
3. A line whose bus, direction, length or number of bytes is not understood is unreadable: no default is used. A column
   that is not there, or is "-", says nothing.

*Facts*: "PEAK CAN TRC File Format" of PEAK-System (2016 to 2023). Identifiers of 4 digits have 11 bits, of 8 digits 29.
Types are DT (data), FD, FB (with bit rate switch), FE (with error state), BI (with both), RR (remote), ER (error frame), ST
(hardware status), EC (error counters), EV (text); python-can takes FE and BI for other flags than PEAK states.
*Choice*: buses count from 1 there and from 0 here; a version without a bus column gives no channel. The data of an error
frame (kind, position, counters) is not kept: it is not that of an error frame elsewhere; nor is its direction, as an error
is of the bus.
*Doubt*: whether the start time is local time or UTC the description does not say; it is taken as UTC, as in python-can.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import Decimal

import numpy as np

from aces_bus import Frame, FrameTable
from aces_bus.frame_table import FrameFlag
from aces_bus.recordings.base import printable_start
from aces_bus.recordings.text.rows import FrameRow, LineCapture, RowText, UnreadableRow

from .words import Mask, Words, channel_numbers

_MS = 1_000_000
#: Days from 30 December 1899 to 1 January 1970.
_EPOCH = 25569
_DEFAULT_COLUMNS = {"2.0": "N,O,T,I,d,l,D", "2.1": "N,O,T,B,I,d,R,L,D"}
_NEEDED = {"O", "T", "I", "D"}

#: Type → flags of its frames.
_DATA = {
    b"DT": 0,
    b"FD": FrameFlag.FD,
    b"FB": FrameFlag.FD | FrameFlag.BITRATE_SWITCH,
    b"FE": FrameFlag.FD | FrameFlag.ERROR_STATE,
    b"BI": FrameFlag.FD | FrameFlag.BITRATE_SWITCH | FrameFlag.ERROR_STATE,
}
_WAYS = {b"Rx": True, b"Tx": False, b"-": None, b"": None}
_OTHERS = {b"ST": "hardware states", b"EC": "error counters", b"EV": "events"}
_OLD_TYPES = (b"Rx", b"Tx", b"Warng", b"Error")
_OLD_LINE = re.compile(rb"[0-9]{1,12}\)\s")
_NEW_LINE = re.compile(rb"[0-9]{1,12}\s")
_HEADER = re.compile(rb";\$([A-Za-z]+)\s*=\s*(.*)", re.DOTALL)

#: Columns of the older versions, by the letters of the newer ones; n is a number with a bracket, l a length.
_OLD_COLUMNS = {"1.0": "nOIlD", "1.1": "nOdIlD", "1.2": "nOBdIlD", "1.3": "nOBdIRlD"}


class TrcCapture(LineCapture):
    """Frames of a PEAK trace."""

    format = "PEAK trace"
    _TURN = re.compile(rb"\s*;\$")
    _BEGINS = re.compile(
        rb"[0-9]{1,12}(?:\)\s+[0-9]+(?:\.[0-9]+)?\s+(?:[0-9]+\s+)?(?:(?:Rx|Tx|Warng|Error)\s+)?[0-9A-F]{4,8}\s"
        rb"|\s+[0-9]+\.[0-9]+\s+(?:DT|FD|FB|FE|BI|RR|ER)\s)",
        re.IGNORECASE,
    )

    _version = "1.0"
    _layout: Sequence[str] = ()
    _origin = 0
    _usual = _OLD_COLUMNS["1.0"]

    # ---- headers

    def _header(self, text: bytes) -> None:
        found = _HEADER.match(text)
        if found is None:
            return
        key, value = found[1].upper(), found[2].strip().decode("ascii", "replace")
        if key == b"FILEVERSION":
            if not re.fullmatch(r"[12]\.[0-9]", value):
                raise UnreadableRow(f"version {value[:16]!r} is not known; 1.0 to 2.1 are")
            self._version, self._layout, self._origin = value, (), 0
        elif key == b"STARTTIME":
            if not re.fullmatch(r"[0-9]{1,7}(?:[.,][0-9]{1,30})?", value):
                raise UnreadableRow("the start time is not a number of days; times count from the start")
            days = Decimal(value.replace(",", ".")) - _EPOCH
            origin = int((days * (86_400 * 10**9)).to_integral_value())
            if abs(origin) >= RowText.MAX_ORIGIN:
                raise UnreadableRow("the start time is out of range; times count from the start")
            self._origin = origin
        elif key == b"COLUMNS":
            columns = value.split(",")
            if not all(re.fullmatch("[A-Za-z]", column) for column in columns) or len(set(columns)) < len(
                columns
            ):
                raise UnreadableRow("columns are single letters, each once")
            self._layout = columns
        self._choose()

    def _choose(self) -> None:
        """Choose the columns of usual lines by version and header; none if they cannot be read as columns."""
        if self._version < "2":
            self._usual = _OLD_COLUMNS.get(self._version, _OLD_COLUMNS["1.3"])
            return
        if not self._layout:
            self._layout = _DEFAULT_COLUMNS.get(self._version, _DEFAULT_COLUMNS["2.1"]).split(",")
        columns = self._layout
        is_usual = set(columns) >= _NEEDED and columns[-1] == "D" and len({"l", "L"} & set(columns)) == 1
        self._usual = "".join(columns) if is_usual else ""

    # ---- one line

    def _check_single(self, text: bytes) -> None:
        if not self._layout or [name.upper() for name in self._layout[:2]] == ["N", "O"]:
            super()._check_single(text)

    def _line(self, text: bytes) -> FrameRow | None:
        if text.startswith(b";"):
            self._header(text)
            self._comment()
            return None
        if self._version >= "2":
            if _NEW_LINE.match(text):
                return self._new(text)
        elif _OLD_LINE.match(text):
            return self._old(text.split())
        raise UnreadableRow(f"not a line of a trace of version {self._version}")

    def _old(self, cells: list[bytes]) -> FrameRow | None:
        """Return a line of versions 1.x; the columns are recognised by what is there, as headers are lost or wrong."""
        time = self._instant(cells[1]) if len(cells) > 1 else 0
        rest = cells[2:]
        bus = kind = None
        if rest[:1] and rest[0] in _OLD_TYPES:
            kind = rest.pop(0)
        elif len(rest) > 1 and rest[1] in _OLD_TYPES:
            bus, kind = RowText.integer(rest[0], 10, "bus"), rest[1]
            rest = rest[2:]
        if rest[1:2] == [b"-"] or (self._version == "1.3" and len(rest) > 2):
            del rest[1]
        if len(rest) < 2:
            raise UnreadableRow("a line needs time, identifier and length")
        channel = None if bus is None else RowText.one_less(bus)
        if kind == b"Warng" or rest[0].upper() == b"FFFFFFFF":
            self._other("bus warnings")
            return None
        if kind == b"Error" or rest[2:3] == [b"ERROR"]:
            return FrameRow(Frame(0, channel=channel, is_error_frame=True), time)
        size = RowText.integer(rest[1], 10, "length")
        is_rx = None if kind is None else kind == b"Rx"
        return self._frame(rest[0], rest[2:], size, channel, is_rx, 0, rest[2:3] == [b"RTR"], time)

    def _new(self, text: bytes) -> FrameRow | None:
        """Return a line of versions 2.x."""
        cells = text.split()
        columns = self._layout
        if "T" not in columns or "O" not in columns:
            raise UnreadableRow("the columns have no type (T) or no time (O)")
        place = columns.index("T")
        if "D" in columns[:place]:
            place += len(cells) - len(columns)
        kind = cells[place] if 0 <= place < len(cells) else b""
        if kind in _OTHERS:
            self._other(_OTHERS[kind])
            return None
        if kind not in _DATA and kind not in (b"RR", b"ER"):
            raise UnreadableRow(f"message type {printable_start(kind)!r} is not known")
        found: dict[str, bytes] = {}
        data: list[bytes] = []
        for number, column in enumerate(columns):
            if column == "D":
                after = len(columns) - number - 1
                end = len(cells) - after
                data, cells = cells[number:end], [*cells[:number], b"", *cells[end:]]
            elif number < len(cells):
                found[column] = cells[number]
        time = self._instant(found.get("O", b""))
        bus = found.get("B", b"")
        channel = None if bus in (b"", b"-") else RowText.one_less(RowText.integer(bus, 10, "bus"))
        if kind == b"ER":
            return FrameRow(Frame(0, channel=channel, is_error_frame=True), time)
        way = found.get("d", b"")
        if way not in _WAYS:
            raise UnreadableRow(f"direction {printable_start(way)!r} is neither Rx nor Tx")
        if "I" not in found:
            raise UnreadableRow("no identifier")
        size = self._size(found, kind)
        if kind == b"DT" and size > 8:
            self._other("J1939 messages longer than a frame")
            return None
        return self._frame(
            found["I"], data, size, channel, _WAYS[way], _DATA.get(kind, 0), kind == b"RR", time
        )

    def _size(self, found: dict[str, bytes], kind: bytes) -> int:
        if "l" in found:
            return RowText.integer(found["l"], 10, "length")
        if "L" not in found:
            raise UnreadableRow("no length")
        code = RowText.integer(found["L"], 10, "length code")
        lengths = RowText.FD_LENGTHS_BY_CODE if kind not in (b"DT", b"RR") else RowText.CLASSIC_LENGTHS
        if code not in lengths:
            if kind == b"DT":
                return code
            raise UnreadableRow(f"length code {code} is more than 15")
        return lengths[code]

    def _frame(
        self,
        digits: bytes,
        cells: list[bytes],
        size: int,
        channel: str | None,
        is_rx: bool | None,
        flags: int,
        remote: bool,
        time: int,
    ) -> FrameRow:
        data = b"" if remote else RowText.data(cells, size)
        if not remote and len(cells) > size:
            raise UnreadableRow(f"more than the {size} bytes that are announced")
        RowText.check_remote(remote, False, size)
        return FrameRow(
            Frame(
                RowText.integer(digits, 16, "identifier"),
                data,
                None,
                channel,
                len(digits) > 4,
                remote,
                False,
                bool(flags & FrameFlag.FD),
                bool(flags & FrameFlag.BITRATE_SWITCH),
                bool(flags & FrameFlag.ERROR_STATE),
                is_rx,
                size if remote else None,
            ),
            time,
        )

    def _instant(self, text: bytes) -> int:
        return self._origin + RowText.nanoseconds(text.rstrip(b")"), _MS)

    # ---- many lines

    def _quick(self, block: bytes) -> tuple[Mask, FrameTable] | None:
        columns = self._usual
        if not columns:
            return None
        words = Words(block)
        found = {column: words.word(place) for place, column in enumerate(columns)}
        n = len(words.count)
        bracket = columns[0] == "n"
        good = words.fits & words.number(words.word(0), 10, 1, 12, behind=int(bracket))[2]
        if bracket:
            good &= words.last(words.word(0)) == ord(")")
        time, is_time = words.time(found["O"], 6, whole_too=True)
        identifier, digits, is_number = words.number(found["I"], 16, 4, 8)
        extended = digits > 4
        good &= is_time & is_number & (identifier <= np.where(extended, 0x1FFF_FFFF, 0x7FF))
        flags = extended * np.uint8(FrameFlag.EXTENDED)
        if "T" in found:
            is_type = np.zeros(n, np.bool_)
            for text, bits in _DATA.items():
                if not is_type.all():
                    is_text = words.is_text(found["T"], text)
                    is_type |= is_text
                    flags |= is_text * np.uint8(bits)
            good &= is_type
        if "d" in found:
            received, sent = words.is_text(found["d"], b"Rx"), words.is_text(found["d"], b"Tx")
            good &= received | sent
            flags |= received * np.uint8(FrameFlag.RX) | sent * np.uint8(FrameFlag.TX)
        is_fd = flags & FrameFlag.FD != 0
        if "L" in found:
            code, _, is_size = words.number(found["L"], 10, 1, 2)
            good &= is_size & (code < 16)
            size = np.where(is_fd, _FD_SIZES[code & 15], np.minimum(code, 8))
        else:
            size, _, is_size = words.number(found["l"], 10, 1, 2)
            good &= is_size & np.where(is_fd, _IS_FD_SIZE[size & 0xFF], size <= 8)
        data, is_data = words.data(found["D"], size * good)
        good &= is_data & (words.count == len(columns) - 1 + size)
        bus = np.zeros(n, np.int64)  # which is none
        if "B" in found:
            bus, _, is_bus = words.number(found["B"], 10, 1, 5)
            good &= is_bus
        channel = channel_numbers(bus[good], self.channels, RowText.one_less)
        return good, FrameTable(
            time[good] + self._origin,
            channel,
            identifier[good].astype(np.uint32),
            flags[good],
            size[good].astype(np.uint8),
            data[good],
            self.channels,
        )


_FD_SIZES = np.array(list(RowText.FD_LENGTHS_BY_CODE.values()))
_IS_FD_SIZE = np.isin(np.arange(256), _FD_SIZES)
