"""MAVLink dialect files (XML) as protocols: dialect `v2` has the packets of MAVLink 2, `v1` those of MAVLink 1.

1. XML of others is data: no document type, no entities, nothing is fetched. An `<include>` names a file beside its own.
2. Work is bounded, by bytes, files and depth, before it is done.
3. A message costs itself, not the file; a meaning that cannot be said costs itself, not the field.

On the wire the fields of a message are sorted by the size of their type, the largest first; extensions follow as the file
has them, in MAVLink 2 alone. A CRC ends with one byte that is computed from names and types (CRC_EXTRA), so that who has
another definition of a message refuses its packets. In MAVLink 2 zeros at the end are cut, and a signature of 13 bytes
(link, 6 bytes of time in 10 µs since 2015, 6 of SHA-256) may follow; it is kept, at the end of `trailing`, and not
verified. There is also what a newer definition has behind the fields that are known.

Sources: ArduPilot/pymavlink `mavparse.py`, `mavgen_python.py`, `mavcrc.py`; mavlink/mavlink `common.xml`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

import construct as c

from ...errors import AcesError, CallerError
from ..declare.checks import Crc, Extra
from ..declare.fields import Enumeration, Flags, Quantity, Text, wire_number
from ..declare.framing import Framing, Trailer
from ..declare.place import SourceLine
from ..declare.protocol import Protocol
from ..declare.stuffing import CutZeros
from .import_dbc import protocol_name
from .names import TAKEN_BY_CODE, TAKEN_BY_RECORDS, unused
from .problems import ImportedProtocol, ImportProblem, clean_text, one_line, without_place

#: Bytes and number of the files that are read, elements inside one another, messages.
MOST_BYTES, MOST_FILES, MOST_DEPTH, MOST_MESSAGES = 16 * 1024 * 1024, 64, 32, 16_384
#: The largest payload in bytes, the largest number of a message of MAVLink 1 and of MAVLink 2.
MOST_PAYLOAD, MOST_V1, MOST_V2 = 255, 255, (1 << 24) - 1
#: The field of what is behind the known ones, a signature among it; bytes of that, and the flag that announces it.
TRAILING: Final = "trailing"
SIGNATURE = Trailer(13, "incompat_flags", bit=0)

_TYPES: dict[str, c.Construct] = {
    "int8_t": c.Int8sl,
    "int16_t": c.Int16sl,
    "int32_t": c.Int32sl,
    "int64_t": c.Int64sl,
    "uint8_t": c.Int8ul,
    "uint16_t": c.Int16ul,
    "uint32_t": c.Int32ul,
    "uint64_t": c.Int64ul,
    "char": c.Int8ul,
    "float": c.Float32l,
    "double": c.Float64l,
}
#: The field that holds the dialect's version is a plain number, which a sender fills in.
_VERSION = "uint8_t_mavlink_version"
_TYPE = re.compile(r"(\w+?)(?:\[(\d{1,3})\])?", re.ASCII)
_POWER = re.compile(r"(\d{1,2})\s*(\*\*|<<)\s*(\d{1,2})", re.ASCII)
_SENTINEL = re.compile(r"(U?)INT(8|16|32|64)_(MAX|MIN)", re.ASCII)

#: Units that need a factor or another name; others stay as they are written.
_UNITS: dict[str, tuple[float, str]] = {
    "deg": (1, "°"),
    "cdeg": (0.01, "°"),
    "degE5": (1e-5, "°"),
    "degE7": (1e-7, "°"),
    "deg/2": (2, "°"),
    "deg/s": (1, "°/s"),
    "cdeg/s": (0.01, "°/s"),
    "ddeg/s": (0.1, "°/s"),
    "degC": (1, "°C"),
    "cdegC": (0.01, "°C"),
    "d%": (0.1, "%"),
    "c%": (0.01, "%"),
    "cA": (0.01, "A"),
    "cV": (0.01, "V"),
    "cs": (0.01, "s"),
    "ds": (0.1, "s"),
    "us": (1, "µs"),
    "dm": (0.1, "m"),
    "dam": (10, "m"),
    "dm/s": (0.1, "m/s"),
    "m/s*5": (0.2, "m/s"),
    "hJ": (100, "J"),
    "pix": (1, "px"),
    "m/s/s": (1, "m/s²"),
    "cm^2": (1, "cm²"),
    "cm^3": (1, "cm³"),
    "cm^3/min": (1, "cm³/min"),
}


def load_mavlink(path: str) -> ImportedProtocol:
    """The dialect file `path`, and what it includes, as a protocol. Raises `CallerError` when nothing of it can be read."""
    dialect = _Dialect(path)
    dialect.read(Path(path), "")
    protocol = _Builder(dialect).build()
    if not protocol.declared:
        first = f"; first: {min(dialect.problems)}" if dialect.problems else ""
        raise CallerError(f"{path}: no message in it can be used{first}")
    return ImportedProtocol(protocol, tuple(sorted(dialect.problems)), dialect.count, path)


# ---------------------------------------------------------------------- the file


@dataclass
class _Field:
    """`count` is the length of an array, else 0."""

    name: str
    type: str
    count: int
    attributes: Mapping[str, str]
    is_extension: bool
    line: int
    text: list[str] = field(default_factory=list[str])

    @property
    def size(self) -> int:
        """Bytes of one item."""
        return int(_TYPES[self.type].sizeof())


@dataclass
class _Message:
    name: str
    number: int
    file: str
    line: int
    fields: list[_Field] = field(default_factory=list[_Field])
    text: list[str] = field(default_factory=list[str])
    has_extensions: bool = False
    reason: str = ""

    @property
    def base(self) -> list[_Field]:
        """The fields that both versions have, as on the wire."""
        return sorted((one for one in self.fields if not one.is_extension), key=lambda one: -one.size)

    @property
    def extensions(self) -> list[_Field]:
        return [one for one in self.fields if one.is_extension]

    def extra(self, crc: Crc) -> bytes:
        """The byte that ends what the check covers."""
        data = f"{self.name} ".encode()
        for one in self.base:
            data += f"{one.type} {one.name} ".encode() + bytes([one.count] * bool(one.count))
        number = crc.compute(data)
        return bytes([number & 0xFF ^ number >> 8])


@dataclass
class _Enum:
    """`entries` without a value have the next one, which what is included before has a say in."""

    is_bitmask: bool = False
    entries: dict[str, int | None] = field(default_factory=dict[str, "int | None"])

    def add(self, other: _Enum) -> None:
        """Take over what another file has of the same enumeration."""
        self.is_bitmask = self.is_bitmask or other.is_bitmask
        highest = max((one for one in self.entries.values() if one is not None), default=0)
        for name, value in other.entries.items():
            value = highest + 1 if value is None else value
            highest = max(highest, value)
            self.entries.setdefault(name, value)

    @property
    def values(self) -> Iterator[tuple[str, int]]:
        """The entries, of two with one value the first."""
        found: dict[int, str] = {}
        for name, value in self.entries.items():
            if value is not None:
                found.setdefault(value, name)
        return ((name, value) for value, name in found.items())


class _Dialect:
    """What a dialect file and those that it includes say."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.messages: list[_Message] = []
        self.enums: dict[str, _Enum] = {}
        self.problems: list[ImportProblem] = []
        self.version = 3
        #: Messages, and entries of enumerations.
        self.count = 0
        self._seen: set[Path] = set()
        self._left = MOST_BYTES

    def problem(self, file: str, line: int, reason: str, *, is_note: bool = False) -> None:
        """`file` is empty for the dialect's own."""
        said = f"{file}:{line}: {reason}" if file else reason
        self.problems.append(ImportProblem(0 if file else line, said, is_note=is_note))

    def read(self, path: Path, name: str) -> None:
        """Read a file, and before it what it includes; `name` is that of an included one."""
        where = name or self.path
        try:
            if path.is_dir():
                raise CallerError(f"{where}: a folder, not an XML file")
            size = path.stat().st_size
            if size > self._left:
                raise CallerError(
                    f"{where}: {size:,} bytes; at most {MOST_BYTES:,} are read, included files and all"
                )
            self._left -= size
            with path.open("rb") as file:
                data = file.read(size + 1)
            self._seen.add(path.resolve())
        except FileNotFoundError:
            raise CallerError(f"{where}: no such file") from None
        except (OSError, ValueError) as error:
            raise CallerError(f"{where}: {getattr(error, 'strerror', None) or error}") from error
        read = _FileReader(self, name)
        read.parse(data, where)
        for line, text in read.includes:
            try:
                self._include(path, text)
            except CallerError as error:
                self.problem(name, line, f"{error}: not included")
        for enum, said in read.enums.items():
            self.enums.setdefault(enum, _Enum()).add(said)
        self.version = read.version or self.version
        self.messages += read.messages

    def _include(self, path: Path, text: str) -> None:
        other = path.parent / text
        if not text or other.name != text or text in (".", ".."):
            raise CallerError(f"<include>{one_line(text)[:80]}</include> is no file beside this one")
        if other.resolve() in self._seen:
            return
        if len(self._seen) >= MOST_FILES:
            raise CallerError(f"{text}: more than {MOST_FILES} files")
        self.read(other, text)


class _FileReader:
    """The elements of one file; other elements than those that are asked for mean nothing here."""

    def __init__(self, dialect: _Dialect, name: str) -> None:
        self.dialect, self.name = dialect, name
        self.includes: list[tuple[int, str]] = []
        self.messages: list[_Message] = []
        self.enums: dict[str, _Enum] = {}
        self.version: int | None = None
        self._way: list[str] = []
        #: Where characters go; None: nowhere.
        self._text: list[str] | None = None
        self._enum: _Enum | None = None

    def parse(self, data: bytes, where: str) -> None:
        parser: Any = expat.ParserCreate()
        self._parser = parser
        parser.buffer_text = True
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.CharacterDataHandler = self._characters
        parser.StartDoctypeDeclHandler = self._doctype
        try:
            parser.Parse(data, True)
        except expat.ExpatError as error:
            raise CallerError(
                f"{where}:{error.lineno}: not XML that can be read: {expat.ErrorString(error.code)}"
            ) from None
        except _Refused as refused:
            raise CallerError(f"{where}:{parser.CurrentLineNumber}: {refused}") from None

    @property
    def _line(self) -> int:
        return int(self._parser.CurrentLineNumber)

    def _doctype(self, *_: object) -> None:
        raise _Refused("a dialect file has no document type (<!DOCTYPE …>)")

    def _characters(self, text: str) -> None:
        if self._text is not None:
            self._text.append(text)

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        way = self._way
        way.append(name)
        if len(way) > MOST_DEPTH:
            raise _Refused(f"elements in one another, {MOST_DEPTH} deep")
        if len(way) == 1 and name != "mavlink":
            raise _Refused(f"not a MAVLink dialect: it begins with <{one_line(name)[:40]}>, not <mavlink>")
        begin = _BEGINS.get(tuple(way))
        if begin is not None:
            begin(self, attributes)

    def _end(self, name: str) -> None:
        path = tuple(self._way)
        self._way.pop()
        text, self._text = ("".join(self._text).strip() if self._text is not None else ""), None
        if path == ("mavlink", "include"):
            self.includes.append((self._line, text))
        elif path == ("mavlink", "version") and text.isdecimal() and int(text[:9]) < 256:
            self.version = int(text[:9])

    def begin_collecting(self, _: Mapping[str, str]) -> None:
        self._text = []

    def begin_message(self, attributes: Mapping[str, str]) -> None:
        self.dialect.count += 1
        if self.dialect.count > MOST_MESSAGES:
            raise _Refused(f"more than {MOST_MESSAGES:,} messages and entries")
        name, number = attributes.get("name", ""), _number(attributes.get("id", ""))
        made = _Message(name, -1 if number is None else number, self.name, self._line)
        if re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII) is None or number is None:
            made.reason = "a message has a name and a number"
        self.messages.append(made)

    def begin_text(self, _: Mapping[str, str]) -> None:
        self._text = self.messages[-1].text

    def begin_extensions(self, _: Mapping[str, str]) -> None:
        self.messages[-1].has_extensions = True

    def begin_field(self, attributes: Mapping[str, str]) -> None:
        message = self.messages[-1]
        name, found = attributes.get("name", ""), _TYPE.fullmatch(attributes.get("type", ""))
        kind = found[1] if found is not None else ""
        if kind == _VERSION:
            kind, attributes = "uint8_t", {**attributes, "version": "yes"}
        if found is None or kind not in _TYPES or re.fullmatch(r"\w+", name, re.ASCII) is None:
            shown = one_line(attributes.get("type", ""))[:40]
            message.reason = message.reason or f"field {one_line(name)[:40]!r} of type {shown!r}"
            return
        count = int(found[2] or 0)
        made = _Field(name, kind, count, attributes, message.has_extensions, self._line)
        if found[2] is not None and not 0 < count <= MOST_PAYLOAD:
            message.reason = message.reason or f"field {name} has {count} items"
        message.fields.append(made)
        self._text = made.text

    def begin_enum(self, attributes: Mapping[str, str]) -> None:
        enum = self.enums.setdefault(attributes.get("name", ""), _Enum())
        enum.is_bitmask = enum.is_bitmask or attributes.get("bitmask") == "true"
        self._enum = enum

    def begin_entry(self, attributes: Mapping[str, str]) -> None:
        enum = self._enum
        assert enum is not None
        self.dialect.count += 1
        if self.dialect.count > MOST_MESSAGES:
            raise _Refused(f"more than {MOST_MESSAGES:,} messages and entries")
        given = attributes.get("value")
        value = None if given is None else _number(given)
        name = clean_text(attributes.get("name", ""))
        if not name or (value is None) is not (given is None):
            said = f"entry {one_line(name)[:40]} has the value {one_line(given or '')[:40]!r}: left out"
            self.dialect.problem(self.name, self._line, said)
            return
        enum.entries.setdefault(name, value)


_MESSAGE = ("mavlink", "messages", "message")
_BEGINS: dict[tuple[str, ...], Callable[[_FileReader, dict[str, str]], None]] = {
    ("mavlink", "include"): _FileReader.begin_collecting,
    ("mavlink", "version"): _FileReader.begin_collecting,
    _MESSAGE: _FileReader.begin_message,
    (*_MESSAGE, "description"): _FileReader.begin_text,
    (*_MESSAGE, "extensions"): _FileReader.begin_extensions,
    (*_MESSAGE, "field"): _FileReader.begin_field,
    ("mavlink", "enums", "enum"): _FileReader.begin_enum,
    ("mavlink", "enums", "enum", "entry"): _FileReader.begin_entry,
}


class _Refused(Exception):
    """This file is not read; the argument says why."""


def _number(text: str) -> int | None:
    """A whole number as dialects write them: 12, 0x0C, 0b1100, 2**3, 1<<3."""
    text = text.strip()
    if found := _POWER.fullmatch(text):
        base, by = int(found[1]), int(found[3])
        return (base**by if found[2] == "**" else base << by) if by < 64 else None
    try:
        number = int(text, 0) if len(text) <= 70 else None
    except ValueError:
        return int(text) if text.isdecimal() and len(text) < 20 else None
    return number


# ---------------------------------------------------------------------- the protocol


class _Builder:
    def __init__(self, dialect: _Dialect) -> None:
        self.dialect = dialect
        path = dialect.path
        has_v1 = any(one.number <= MOST_V1 for one in dialect.messages)
        self.protocol = Protocol(
            protocol_name(path),
            link="serial",
            baud=57_600,
            dialects={"v2": "MAVLink 2", **({"v1": "MAVLink 1"} if has_v1 else {})},
            doc="a MAVLink dialect",
            source=path,
        )
        self.protocol.place = SourceLine(path, 1)
        self.crc = Crc("CRC16-MCRF4XX", over=(slice(1, -2), Extra()))
        sender = (
            "packet_sequence" / c.Default(c.Byte, 0) * "counts the packets of this sender",
            "system" / c.Byte * "the sender's system",
            "component" / c.Byte * "the sender's component",
        )
        self.v2 = self.protocol.framing(
            name="MAVLink 2",
            sync=b"\xfd",
            header=c.Struct(
                "packet_length" / c.Byte,
                "incompat_flags" / c.Default(c.Byte, 0) * "bit 0: signed, by the last 13 bytes of trailing",
                "compat_flags" / c.Default(c.Byte, 0),
                *sender,
                "message" / c.Int24ul,
            ),
            size=c.this.packet_length + 12,
            max_size=12 + MOST_PAYLOAD + SIGNATURE.size,
            gap=0.5,
            stuffing=CutZeros(),
            check=self.crc,
            trailer=SIGNATURE,
        )
        if has_v1:
            self.v1 = self.protocol.framing(
                name="MAVLink 1",
                sync=b"\xfe",
                header=c.Struct("packet_length" / c.Byte, *sender, "message" / c.Byte),
                size=c.this.packet_length + 8,
                max_size=8 + MOST_PAYLOAD,
                gap=0.5,
                check=self.crc,
            )
        for framing in self.protocol.framings:
            framing.place = self.protocol.place
        self.heads = {head.name for head in self.v2.heads if head.name}
        self.taken = set(TAKEN_BY_CODE)
        self._values: dict[tuple[str, ...], c.Construct] = {}

    def build(self) -> Protocol:
        numbers: dict[int, str] = {}
        for one in self.dialect.messages:
            try:
                if one.reason:
                    raise _LeftOut(one.reason)
                if one.number in numbers:
                    raise _LeftOut(f"{numbers[one.number]} has its number {one.number}")
                self._message(one)
                numbers[one.number] = one.name
            except (_LeftOut, AcesError) as reason:
                said = f"message {one_line(one.name)[:60]}: {without_place(reason)}: left out"
                self.dialect.problem(one.file, one.line, said)
        return self.protocol

    def _message(self, one: _Message) -> None:
        fields = [*one.base, *one.extensions]
        size = sum(each.size * max(each.count, 1) for each in fields)
        if size > MOST_PAYLOAD:
            raise _LeftOut(f"{size} bytes of fields, and a packet has {MOST_PAYLOAD}")
        if not 0 <= one.number <= MOST_V2:
            raise _LeftOut(f"{one.number} is no number of a message")
        name = unused(one.name, self.taken)
        names = {*self.heads, TRAILING, *TAKEN_BY_RECORDS}
        made = [self._field(one, each, names) for each in fields]
        trailing = "bytes behind the known fields; of a signed packet the last 13 are its signature"
        behind = TRAILING / c.Default(c.GreedyBytes, b"") * trailing
        self._declare(one, self.v2, "v2", name, c.Struct(*made, behind), incompat_flags=(0, 1))
        if one.number <= MOST_V1:
            self._declare(one, self.v1, "v1", name, c.Struct(*made[: len(one.base)]))

    def _declare(
        self, one: _Message, framing: Framing, dialect: str, name: str, payload: c.Struct, **match: Any
    ) -> None:
        made = framing(
            name,
            match={"message": one.number, **match},
            dialect=dialect,
            check_extra=one.extra(self.crc),
            payload=payload,
            doc=clean_text("".join(one.text)),
            source=f"{one.file or Path(self.dialect.path).name}, {one.number}",
        )
        made.place = SourceLine(
            str(Path(self.dialect.path).with_name(one.file)) if one.file else self.dialect.path, one.line
        )

    def _field(self, message: _Message, one: _Field, taken: set[str]) -> c.Construct:
        name = unused(one.name, taken)
        if name != one.name:
            said = f"field {message.name}.{one.name} is called {name} here"
            self.dialect.problem(message.file, one.line, said, is_note=True)
        return c.Renamed(self._value(message, one), newname=name, newdocs=one_line("".join(one.text)))

    def _value(self, message: _Message, one: _Field) -> c.Construct:
        get = one.attributes.get
        if one.type == "char":
            return Text(max(one.count, 1))
        if get("version"):
            return c.Default(c.Byte, self.dialect.version)
        words = tuple(get(word, "") for word in ("enum", "display", "units", "multiplier", "invalid"))
        if one.type == "uint8_t" and one.count and not any(words):
            return c.Bytes(one.count)
        if words[0] in self.dialect.enums:
            words = (*words[:2], "", "", "")  # names and flags have no units
        key = (one.type, *words)
        if key not in self._values:
            self._values[key] = self._meant(message, one, *words)
        value = self._values[key]
        return c.Array(one.count, value) if one.count else value

    def _meant(
        self,
        message: _Message,
        one: _Field,
        enum: str,
        display: str,
        units: str,
        multiplier: str,
        invalid: str,
    ) -> c.Construct:
        """One number of a field, and what it means."""
        number = _TYPES[one.type]

        def note(reason: str) -> None:
            said = f"field {message.name}.{one.name}: {reason}"
            self.dialect.problem(message.file, one.line, said, is_note=True)

        wire = wire_number(number)
        assert wire is not None
        if enum:
            known = self.dialect.enums.get(enum)
            if known is None or wire.kind == "float":
                note(
                    f"its enumeration {one_line(enum)[:60]} "
                    + ("is not there" if known is None else "names a float")
                )
            elif known.is_bitmask or display == "bitmask":
                single = (
                    (name, value) for name, value in known.values if value > 0 and value.bit_count() == 1
                )
                bits = {name: value.bit_length() - 1 for name, value in single}
                return Flags(number, {name: bit for name, bit in bits.items() if bit < 8 * wire.size})
            else:
                low, high = wire.limits
                return Enumeration(number, {name: n for name, n in known.values if low <= n <= high})
        factor, unit = _UNITS.get(units, (1, clean_text(units)))
        try:
            scale = float(Fraction(multiplier.strip()) * Fraction(str(factor))) if multiplier else factor
        except (ValueError, ZeroDivisionError):
            note(f"its multiplier {one_line(multiplier)[:40]!r} is no number")
            scale = factor
        try:
            unknown = _invalid(invalid, is_list=bool(one.count), is_float=wire.kind == "float")
        except ValueError:
            note(f"what it says of invalid values ({one_line(invalid)[:40]}) is only in its text")
            unknown = ()
        if wire.kind != "float" and any(not wire.limits[0] <= value <= wire.limits[1] for value in unknown):
            unknown = ()
        return (
            number
            if scale == 1 and not unit and not unknown
            else Quantity(number, unit=unit, scale=scale, unknown=unknown)
        )


class _LeftOut(Exception):
    """This message cannot be taken over; the argument says why."""


def _invalid(text: str, *, is_list: bool, is_float: bool) -> Sequence[float]:
    """The raw values of a number that mean unknown. Raises `ValueError` for what is no number.

    Of a list an ordinary number such as 0 says something of the whole list (`[0]`), and is not taken for one of an item.
    """
    text = text.strip()
    if not text:
        return ()
    if is_list:
        text = text.removeprefix("[").removesuffix("]").removesuffix(":").strip()
    if found := _SENTINEL.fullmatch(text):
        width, is_signed = int(found[2]), not found[1]
        top = (1 << width - is_signed) - 1
        return (top if found[3] == "MAX" else -top - 1 if is_signed else 0,)
    if text.lower() == "nan":
        if not is_float:
            raise ValueError(text)
        return (float("nan"),)
    number = float(int(text, 0)) if re.fullmatch(r"[+-]?0[xX]\w+", text) else float(text)
    if is_list:
        return ()
    if not is_float and not number.is_integer():
        raise ValueError(text)
    return (number if is_float else int(number),)
