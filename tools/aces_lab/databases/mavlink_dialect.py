"""Dialect files of MAVLink as they are written: messages, fields, enumerations, and what they include.

1. XML of others is data: no document type, no entities, nothing is fetched. An `<include>` names a file beside its own.
2. Work is bounded, by bytes, files and depth, before it is done.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

import construct as c

from aces_bus.errors import CallerError
from aces_bus.protocol import Crc
from aces_bus.protocol.exchange.problems import ImportProblem, ProblemText

#: Bytes and number of the files that are read, elements inside one another, messages.
MOST_BYTES, MOST_FILES, MOST_DEPTH, MOST_MESSAGES = 16 * 1024 * 1024, 64, 32, 16_384
#: The largest payload in bytes, the largest number of a message of MAVLink 1 and of MAVLink 2.
MOST_PAYLOAD, MOST_V1, MOST_V2 = 255, 255, (1 << 24) - 1
#: The types of fields, as they are on the wire.
TYPES: dict[str, c.Construct] = {
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


@dataclass
class DialectField:
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
        return int(TYPES[self.type].sizeof())


@dataclass
class DialectMessage:
    name: str
    number: int
    file: str
    line: int
    fields: list[DialectField] = field(default_factory=list[DialectField])
    text: list[str] = field(default_factory=list[str])
    has_extensions: bool = False
    reason: str = ""

    @property
    def base(self) -> list[DialectField]:
        """The fields that both versions have, as on the wire."""
        return sorted(
            (field for field in self.fields if not field.is_extension), key=lambda field: -field.size
        )

    @property
    def extensions(self) -> list[DialectField]:
        return [field for field in self.fields if field.is_extension]

    def extra(self, crc: Crc) -> bytes:
        """Return the byte that ends what the check covers."""
        data = f"{self.name} ".encode()
        for member in self.base:
            data += f"{member.type} {member.name} ".encode() + bytes([member.count] * bool(member.count))
        number = crc.compute(data)
        return bytes([number & 0xFF ^ number >> 8])


@dataclass
class DialectEnum:
    """`entries` without a value have the next one, which what is included before has a say in."""

    is_bitmask: bool = False
    entries: dict[str, int | None] = field(default_factory=dict[str, "int | None"])

    def add(self, other: DialectEnum) -> None:
        """Take over what another file has of the same enumeration."""
        self.is_bitmask = self.is_bitmask or other.is_bitmask
        highest = max((entry for entry in self.entries.values() if entry is not None), default=0)
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


class Dialect:
    """What a dialect file and those that it includes say."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.messages: list[DialectMessage] = []
        self.enums: dict[str, DialectEnum] = {}
        self.problems: list[ImportProblem] = []
        self.version = 3
        #: Messages, and entries of enumerations.
        self.count = 0
        self._seen: set[Path] = set()
        self._left = MOST_BYTES

    def problem(self, file: str, line: int, reason: str, *, is_note: bool = False) -> None:
        """Note a problem; `file` is empty for the dialect's own."""
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
            self.enums.setdefault(enum, DialectEnum()).add(said)
        self.version = read.version or self.version
        self.messages += read.messages

    def _include(self, path: Path, text: str) -> None:
        other = path.parent / text
        if not text or other.name != text or text in (".", ".."):
            raise CallerError(
                f"<include>{ProblemText.one_line(text)[:80]}</include> is not a file beside this one"
            )
        if other.resolve() in self._seen:
            return
        if len(self._seen) >= MOST_FILES:
            raise CallerError(f"{text}: more than {MOST_FILES} files")
        self.read(other, text)


class _FileReader:
    """The elements of one file; other elements than those that are asked for mean nothing here."""

    def __init__(self, dialect: Dialect, name: str) -> None:
        self.dialect, self.name = dialect, name
        self.includes: list[tuple[int, str]] = []
        self.messages: list[DialectMessage] = []
        self.enums: dict[str, DialectEnum] = {}
        self.version: int | None = None
        self._way: list[str] = []
        #: Where characters go; None: nowhere.
        self._text: list[str] | None = None
        self._enum: DialectEnum | None = None

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
            raise _Refused(
                f"not a MAVLink dialect: it begins with <{ProblemText.one_line(name)[:40]}>, not <mavlink>"
            )
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
        name, number = attributes.get("name", ""), dialect_number(attributes.get("id", ""))
        made = DialectMessage(name, -1 if number is None else number, self.name, self._line)
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
        if found is None or kind not in TYPES or re.fullmatch(r"\w+", name, re.ASCII) is None:
            shown = ProblemText.one_line(attributes.get("type", ""))[:40]
            message.reason = message.reason or f"field {ProblemText.one_line(name)[:40]!r} of type {shown!r}"
            return
        count = int(found[2] or 0)
        made = DialectField(name, kind, count, attributes, message.has_extensions, self._line)
        if found[2] is not None and not 0 < count <= MOST_PAYLOAD:
            message.reason = message.reason or f"field {name} has {count} items"
        message.fields.append(made)
        self._text = made.text

    def begin_enum(self, attributes: Mapping[str, str]) -> None:
        enum = self.enums.setdefault(attributes.get("name", ""), DialectEnum())
        enum.is_bitmask = enum.is_bitmask or attributes.get("bitmask") == "true"
        self._enum = enum

    def begin_entry(self, attributes: Mapping[str, str]) -> None:
        enum = self._enum
        assert enum is not None
        self.dialect.count += 1
        if self.dialect.count > MOST_MESSAGES:
            raise _Refused(f"more than {MOST_MESSAGES:,} messages and entries")
        given = attributes.get("value")
        value = None if given is None else dialect_number(given)
        name = ProblemText.clean(attributes.get("name", ""))
        if not name or (value is None) is not (given is None):
            shown = ProblemText.one_line(given or "")[:40]
            said = f"entry {ProblemText.one_line(name)[:40]} has the value {shown!r}: left out"
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


def dialect_number(text: str) -> int | None:
    """Return a whole number as dialects write them: 12, 0x0C, 0b1100, 2**3, 1<<3."""
    text = text.strip()
    if found := _POWER.fullmatch(text):
        base, by = int(found[1]), int(found[3])
        return (base**by if found[2] == "**" else base << by) if by < 64 else None
    try:
        number = int(text, 0) if len(text) <= 70 else None
    except ValueError:
        return int(text) if text.isdecimal() and len(text) < 20 else None
    return number
