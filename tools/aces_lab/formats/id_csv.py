"""CSV of any program that names its columns.

    time,id,data                        Timestamp [ms];Channel;CAN ID (hex);DLC;D0;D1;D2;D3;D4;D5;D6;D7
    0.5,0x123,01 02 0A                  17.4;1;18FEF100;2;01;0A;;;;;;

1. Every line is one of: frame, header, comment (`#`), blank, unreadable.
2. What a column is, its name says. A file whose names do not say where identifier and data are is refused, with what is
   missing; nothing is guessed from values.
   What a cell says and is not understood (a direction, a flag) makes its line unreadable; an empty one says nothing.
3. Times are as written, exact to the last digit: in the unit that the name says, else in seconds; dates are local time
   unless they say their zone.

Names are compared without case, blanks and signs; `NAMES` has them all. The separator is a comma, a semicolon or a tab,
whichever the header has more of. Identifiers and bytes are hexadecimal, with or without 0x, unless the name says decimal
("ID (dec)").

*Choice*: without a column that says so, an identifier is of 29 bits when it ends in x or is greater than 0x7FF; a frame of
more than 8 bytes is CAN FD.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from datetime import datetime

from aces_bus import Frame
from aces_bus.errors import CaptureError
from aces_bus.frame_table import NO_TIME
from aces_bus.recordings.base import printable_start
from aces_bus.recordings.source import MAX_LINE, ByteSource
from aces_bus.recordings.text.rows import FrameRow, LineCapture, RowText, UnreadableRow

#: What a column is → its names, without case, blanks and signs.
NAMES: dict[str, tuple[str, ...]] = {
    "time": ("time", "timestamp", "t", "ts", "timeoffset", "abstime", "reltime", "datetime", "recordtime"),
    "id": (
        *("id", "canid", "arbitrationid", "arbid", "identifier", "msgid", "messageid", "frameid", "address"),
        *("addr", "canidentifier"),
    ),
    "data": (
        *("data", "payload", "databytes", "bytes", "message", "msgdata", "candata", "rawdata", "framedata"),
        "datapayload",
    ),
    "length": ("dlc", "len", "length", "datalength", "datalen", "size", "messagelength", "numbytes"),
    "channel": ("bus", "channel", "ch", "interface", "iface", "busid", "canchannel", "canbus", "busnumber"),
    "extended": (
        "extended",
        "isextended",
        "ext",
        "isext",
        "ide",
        "isextendedid",
        "extendedid",
        "idtype",
        "xtd",
    ),
    "direction": ("dir", "direction", "rxtx", "txrx"),
    "remote": ("remote", "rtr", "isremote", "isremoteframe", "remoteframe"),
    "error": ("error", "iserror", "iserrorframe", "errorframe"),
    "fd": ("fd", "isfd", "edl", "fdf", "canfd"),
    "brs": ("brs", "bitrateswitch"),
    "esi": ("esi", "errorstateindicator"),
}
_ROLES = {name: role for role, names in NAMES.items() for name in names}
_UNITS = {
    "s": 1_000_000_000,
    "sec": 1_000_000_000,
    "seconds": 1_000_000_000,
    "ms": 1_000_000,
    "us": 1_000,
    "ns": 1,
}
_BYTE = re.compile(r"(?:d|b|db|byte|data|databyte)([0-9]{1,2})")
_BRACKETS = re.compile(r"[\[(<{]([^\])>}]*)[\])>}]")
_BASE_WORDS = {"hex": 16, "hexadecimal": 16, "dec": 10, "decimal": 10}
_WORDS = {
    **dict.fromkeys((b"1", b"true", b"yes", b"y", b"x", b"ext", b"extended", b"xtd", b"29"), True),
    **dict.fromkeys((b"", b"0", b"false", b"no", b"n", b"s", b"std", b"standard", b"11", b"-"), False),
}
_WAYS: dict[bytes, bool | None] = {
    b"": None,
    b"-": None,
    **dict.fromkeys((b"rx", b"r", b"in", b"receive", b"received"), True),
    **dict.fromkeys((b"tx", b"t", b"out", b"transmit", b"transmitted", b"sent"), False),
}
_ISO = re.compile(
    r"([0-9]{4}-[0-9]{2}-[0-9]{2})[T ]([0-9]{2}:[0-9]{2}:[0-9]{2})(?:[.,]([0-9]{1,9}))?\s?(Z|[+-][0-9]{2}:?[0-9]{2})?"
)
_GAPS = re.compile(rb"[\s,;:._-]+")


@dataclass(frozen=True)
class Plan:
    """Where things are in a line: column numbers by role, those of single bytes, and how numbers are written."""

    separator: bytes
    places: dict[str, int]
    byte_places: tuple[int, ...]
    columns: int
    id_base: int
    data_base: int
    time_unit: int


def roles_of_header(head: bytes) -> set[str]:
    """Return what of a frame the first line of a file names, as keys of `NAMES`."""
    return _roles(*_header(head)[1:])


class IdCsvCapture(LineCapture):
    """Frames of a CSV with named columns.

    Making it raises `CaptureError` when the header does not say where identifier and data are.
    """

    format = "CSV with named columns"

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        self._head, separator, names = _header(source.head().removeprefix(b"\xef\xbb\xbf"))
        self._plan = _plan(separator, names, source.name)

    def _line(self, text: bytes) -> FrameRow | None:
        if text == self._head or text.startswith(b"#"):
            self._comment()
            return None
        plan = self._plan
        cells = _cells(text, plan.separator)
        self._check_columns(cells)

        def cell(role: str) -> bytes:
            place = plan.places.get(role, -1)
            return cells[place] if 0 <= place < len(cells) else b""

        def flag(role: str) -> bool:
            found = _WORDS.get(cell(role).lower())
            if found is None:
                raise UnreadableRow(f"{role} is {printable_start(cell(role))!r}, neither true nor false")
            return found

        digits = cell("id")
        is_marked = digits[-1:] in b"xX" and digits != b""
        number = self._number(digits[:-1] if is_marked else digits, plan.id_base)
        missing = {role for role, place in plan.places.items() if place >= len(cells)}
        remote, error = flag("remote"), flag("error")
        size = RowText.integer(cell("length"), 10, "length") if cell("length") else None
        RowText.check_remote(remote, error, size or 0)
        if missing - {"data"} or (missing and not remote and size != 0):
            raise UnreadableRow(
                f"{len(cells)} columns; the header names more, and {', '.join(sorted(missing))} in them"
            )
        data = b"" if remote else self._data(cells, cell("data"), size)
        way = cell("direction").lower()
        if way not in _WAYS:
            raise UnreadableRow(f"direction is {printable_start(way)!r}, neither received nor sent")
        switched, passive = flag("brs"), flag("esi")
        fd = flag("fd") if "fd" in plan.places else len(data) > 8 or switched or passive
        if not fd and (switched or passive):
            raise UnreadableRow("bit rate switch and error state exist only in CAN FD")
        return FrameRow(
            Frame(
                number,
                data,
                None,
                cell("channel").decode("utf-8", "backslashreplace") or None,
                not error
                and (flag("extended") or is_marked or ("extended" not in plan.places and number > 0x7FF)),
                remote,
                error,
                fd,
                switched,
                passive,
                _WAYS[way],
                (size or 0) if remote else None,
            ),
            self._time(cell("time")),
        )

    def _check_columns(self, cells: list[bytes]) -> None:
        """Raise `UnreadableRow` where the columns go on with those of another frame, run into the last one."""
        plan = self._plan
        if not any(cells[plan.columns :]):
            return
        place = plan.columns - 1 + plan.places["id"]
        try:
            self._number(cells[place] if place < len(cells) else b"", plan.id_base)
        except UnreadableRow:
            return  # a comment behind the columns
        raise UnreadableRow(
            f"two lines run together: {len(cells)} columns, and the header has {plan.columns}"
        )

    def _data(self, cells: list[bytes], cell: bytes, size: int | None) -> bytes:
        plan = self._plan
        if plan.byte_places:
            found = [cells[place] for place in plan.byte_places if place < len(cells)]
            if size is None:
                while found and not found[-1]:
                    found.pop()
            elif size > 8 and RowText.FD_LENGTHS_BY_CODE.get(size) == sum(map(bool, found)):
                size = RowText.FD_LENGTHS_BY_CODE[size]  # a code, and so many bytes are there
            return self._bytes(found, len(found) if size is None else size)
        parts = [part for part in _GAPS.split(cell) if part]
        if len(parts) == 1 and plan.data_base == 16:
            text = parts[0][2:] if parts[0][:2] in (b"0x", b"0X") else parts[0]
            if len(text) % 2:
                text = b"0" + text if len(text) == 1 else text
            parts = [text[start : start + 2] for start in range(0, len(text), 2)]
            if parts and len(parts[-1]) != 2:
                raise UnreadableRow("odd number of hexadecimal digits")
        if size is not None and len(parts) != size and RowText.FD_LENGTHS_BY_CODE.get(size) != len(parts):
            raise UnreadableRow(f"{size} bytes are announced, {len(parts)} are there")
        return self._bytes(parts, len(parts))

    def _bytes(self, cells: list[bytes], size: int) -> bytes:
        if size > 64:
            raise UnreadableRow(f"{size} bytes are more than a frame holds")
        if self._plan.data_base == 10:
            cells = [b"%02x" % (self._number(cell, 10) & 0xFFF) for cell in cells[:size]]
        return RowText.data(cells, size)

    def _number(self, digits: bytes, base: int) -> int:
        if digits[:2] in (b"0x", b"0X"):
            base = 16
        return RowText.integer(digits, base, "identifier" if base == self._plan.id_base else "number")

    def _time(self, text: bytes) -> int:
        if not text:
            return NO_TIME
        if b"," in text and self._plan.separator != b",":
            text = text.replace(b",", b".")
        if b"-" in text[1:] and b":" in text:
            return _date(text)
        return RowText.nanoseconds(text, self._plan.time_unit)


def _date(text: bytes) -> int:
    found = _ISO.fullmatch(text.decode("ascii", "replace"))
    try:
        if found is not None:
            moment = datetime.fromisoformat(f"{found[1]}T{found[2]}{found[4] or ''}")
            return int(moment.timestamp()) * 1_000_000_000 + int((found[3] or "").ljust(9, "0"))
    except (ValueError, OverflowError, OSError):
        pass
    raise UnreadableRow(f"time {printable_start(text)!r} is neither a number nor a date")


def _cells(line: bytes, separator: bytes) -> list[bytes]:
    if b'"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    text = line.decode("utf-8", "surrogateescape").replace("\0", "")
    try:
        row = next(csv.reader([text], delimiter=separator.decode()), [])
    except csv.Error as error:
        raise UnreadableRow(f"not a line of a CSV: {error}") from None
    return [cell.strip().encode("utf-8", "surrogateescape") for cell in row]


# ---- headers -------------------------------------------------------------------------------------------------------


def _header(head: bytes) -> tuple[bytes, bytes, list[str]]:
    """Return the first line that is not a comment, its separator, and the names in it."""
    for line in head.split(b"\n", 100)[:100]:
        text = line.strip()
        if text and not text.startswith(b"#"):
            if len(text) > MAX_LINE:
                break
            separator = max((b",", b";", b"\t"), key=text.count)
            try:
                cells = _cells(text, separator)
            except UnreadableRow:
                break
            return text, separator, [cell.decode("utf-8", "replace") for cell in cells]
    return b"", b",", []


def _roles(separator: bytes, names: list[str]) -> set[str]:
    found = {role for role, *_ in map(_role, names) if role}
    return {"data" if role.isdigit() else role for role in found}


def _role(name: str) -> tuple[str, int | None, int | None]:
    """Return what a name says: the role (a byte's number for a column of one byte), the base of numbers, the unit of
    times.
    """
    words = name.lower().replace("µ", "u").replace("μ", "u")
    inside = " ".join(_BRACKETS.findall(words))
    bare = re.sub("[^a-z0-9]", "", _BRACKETS.sub("", words))
    base = next((base for word, base in _BASE_WORDS.items() if word in re.split("[^a-z]+", inside)), None)
    unit = next((unit for word, unit in _UNITS.items() if word in re.split("[^a-z]+", inside)), None)
    for ending, value in _BASE_WORDS.items():
        stem = bare.removesuffix(ending)
        if stem != bare and stem in _ROLES:
            bare, base = stem, value
    for ending, value in _UNITS.items():
        stem = bare.removesuffix(ending)
        if bare not in _ROLES and stem != bare and _ROLES.get(stem) == "time":
            bare, unit = stem, value
    if found := _BYTE.fullmatch(bare):
        return found[1], base, None
    return _ROLES.get(bare, ""), base, unit


def _plan(separator: bytes, names: list[str], source: str) -> Plan:
    places: dict[str, int] = {}
    single: dict[int, int] = {}
    id_base = data_base = 16
    unit = 1_000_000_000
    for place, name in enumerate(names):
        role, base, said = _role(name)
        if role.isdigit():
            single.setdefault(int(role), place)
            data_base = base or data_base
        elif role and role not in places:
            places[role] = place
            if role == "id":
                id_base = base or id_base
            elif role == "data":
                data_base = base or data_base
            elif role == "time":
                unit = said or unit
    listed = printable_start(", ".join(names).encode())
    if not names:
        return Plan(separator, places, (), 0, id_base, data_base, unit)  # an empty file
    if "id" not in places:
        raise CaptureError(
            f"{source}: no column of this CSV is named as an identifier (such as id, can_id): {listed}"
        )
    byte_places: tuple[int, ...] = ()
    if single:
        first = min(single)
        if first > 1 or sorted(single) != list(range(first, first + len(single))):
            raise CaptureError(
                f"{source}: the columns of single bytes are not numbered from 0 or 1 on: {listed}"
            )
        if "data" in places and len(single) > 1:
            raise CaptureError(
                f"{source}: data are in one column and in single ones, and which to take is not said: {listed}"
            )
        byte_places = tuple(single[number] for number in sorted(single)) if "data" not in places else ()
    elif "data" not in places:
        raise CaptureError(
            f"{source}: no column of this CSV is named as data (such as data, payload, or d0 to d7): {listed}"
        )
    return Plan(separator, places, byte_places, len(names), id_base, data_base, unit)
