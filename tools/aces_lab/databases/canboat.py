"""canboat's table of NMEA 2000 (`canboat.json`) as a protocol: a message each PGN, or each of a PGN's proprietary forms.

1. A PGN whose shape cannot be said is declared up to the field that cannot, where bytes may be behind it, or left out;
   both with the reason. It costs itself, not the file.
2. Fast packets may also come by the transport of ISO 11783, and what is too long for them does.
3. What has the same numbers in front (manufacturer, industry, …) is matched by them: they are the message's template,
   and reserved bits among them are captured, so that no bit is lost.
4. A count that is not known (all ones) is of no item.
5. Work is bounded, by bytes and by numbers of PGNs, fields and names, before it is done.

The identifier has `priority`, `source` and, where a PGN is addressed (PDU format below 240, SAE J1939-21), `destination`.
Bits without a meaning are in `reserved`, bytes behind the known fields in `trailing`. A value is raw × resolution + offset,
in the table's unit (SI). The raw values that it calls unknown, out of range or reserved are unknown, but where one has a
name. Fields that are not whole bytes are together in `bits`, where texts or lists are in the same message.

Sources: canboat/canboat `docs/canboat.json`, schema 2, and `docs/canboat.html` of the field types.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import groupby
from typing import Any

import construct as c

from aces_bus.errors import AcesError, CallerError
from aces_bus.protocol import (
    BitLayout,
    Enumeration,
    FastPacket,
    Flags,
    IdField,
    Items,
    J1939Transport,
    Message,
    Protocol,
    Quantity,
    Text,
    Transport,
    bits,
    float_bits,
)
from aces_bus.protocol.declare.j1939 import CONNECTION, DATA
from aces_bus.protocol.declare.pattern import IdPattern
from aces_bus.protocol.declare.place import SourceLine
from aces_bus.protocol.exchange.import_build import TRAILING
from aces_bus.protocol.exchange.import_dbc import protocol_name, read_text
from aces_bus.protocol.exchange.names import PythonNames
from aces_bus.protocol.exchange.problems import ImportedProtocol, ImportProblem, ProblemText
from aces_bus.protocol.record import FieldValue, PlainValue

from .canboat_lists import GroupParameters, KeyedItems, Parameter, camel, field_types

#: Bytes of the largest table, and its PGNs, forms of one PGN, fields, and values with names: canboat's has 3 MB, 611, 56,
#: 5,000 and 6,000.
MOST_BYTES, MOST_PGNS, MOST_FORMS, MOST_FIELDS, MOST_NAMES = 32 * 1024 * 1024, 4096, 128, 32_768, 262_144
#: bit/s of every NMEA 2000 network.
BITRATE = 250_000
#: The longest fast packet, and the longest field and list item, in bits.
MOST_FAST, MOST_BITS = 8 * 223, 8 * 1785

#: By the type of a PGN what carries it, where that is not one frame.
_TRANSPORTS: dict[str, Transport | None] = {
    "Single": None,
    "Fast": FastPacket(also=J1939Transport()),
    "ISO": J1939Transport(),
}

#: What is a number; of the others `_KINDS` says what they are.
_NUMBERS = frozenset(
    {"NUMBER", "TIME", "DURATION", "DATE", "PGN", "MMSI", "ISO_NAME", "FIELD_INDEX", "INDIRECT_LOOKUP"}
    | {"DYNAMIC_FIELD_KEY", "DYNAMIC_FIELD_LENGTH"}
)
_PADDING = frozenset({"RESERVED", "SPARE"})
#: What ends a text of fixed length, as canboat's table of field types has it: "unknown", that of AIS, and C's.
_TEXT_ENDS = b"\xff@\0"
_STRINGS = frozenset({"STRING_LAU", "STRING_LZ"})
_OTHERS = frozenset({"LOOKUP", "BITLOOKUP", "FLOAT", "STRING_FIX", "BINARY", "DECIMAL"})
_SHAPED = {
    "VARIABLE": "a field that another one says the kind of",
    "DYNAMIC_FIELD_VALUE": "a value whose key or length is not before it",
}
#: Numbers that say what comes behind them.
_KEY, _LENGTH = "DYNAMIC_FIELD_KEY", "DYNAMIC_FIELD_LENGTH"
_UNITS = {"deg": "°", "Cos Phi": "", "VAR": "var", "semi-circle": "", "semi-circle/s": "1/s"}


def load_canboat(path: str) -> ImportedProtocol:
    """Return the table as a protocol. Raises `CallerError` when it is no such table, or nothing of it can be used."""
    text = read_text(path, "json")
    if len(text) > MOST_BYTES:
        raise CallerError(f"{path}: {len(text):,} characters; at most {MOST_BYTES:,} are read")
    try:
        table: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CallerError(f"{path}: not JSON that can be read: {ProblemText.one_line(str(error))}") from None
    pgns = table.get("PGNs") if isinstance(table, dict) else None
    if not isinstance(pgns, list):
        raise CallerError(f"{path}: not a table of canboat: it has no list PGNs")
    builder = _Builder(path, table, pgns, _lines(text))
    protocol = builder.build()
    problems = tuple(sorted(builder.problems))
    if not protocol.declared:
        first = f"; first: {problems[0]}" if problems else ""
        raise CallerError(f"{path}: no PGN in it can be used{first}")
    return ImportedProtocol(protocol, problems, len(pgns), path)


def _lines(text: str) -> list[int]:
    """Return the lines where a PGN's number is, in order."""
    found: list[int] = []
    at, line = 0, 1
    for match in re.finditer(r'"PGN"\s*:\s*\d', text):
        line += text.count("\n", at, match.start())
        at = match.start()
        found.append(line)
    return found


class _LeftOut(Exception):
    """This PGN cannot be taken over; the argument says why."""


@dataclass(frozen=True, eq=False)
class _Field:
    """A field as the table has it. `width` is in bits; None: it varies."""

    name: str
    text: str
    kind: str
    width: int | None
    given: Mapping[str, Any]
    #: The only value that it has in its form of the PGN.
    match: int | None

    @property
    def size(self) -> int:
        """Bits that it has at least."""
        return 0 if self.width is None else self.width

    @property
    def is_padding(self) -> bool:
        return self.kind in _PADDING

    @property
    def is_signed(self) -> bool:
        """True if the field is in two's complement: a field with an offset is not."""
        return bool(self.given.get("Signed")) and not self.given.get("Offset")

    @property
    def limits(self) -> tuple[int, int]:
        """The least and the greatest raw value."""
        low = -(1 << self.size - 1) if self.is_signed else 0
        return low, low + (1 << self.size) - 1

    @property
    def is_bytes(self) -> bool:
        return self.kind in ("STRING_FIX", "BINARY", "DECIMAL")

    @property
    def is_aligned(self) -> bool:
        """True if the field consists of whole bytes."""
        return not self.size % 8 and not (_whole(self.given.get("BitStart")) or 0)


@dataclass
class _Form:
    """One form of a PGN: the fields, of which some may have one value."""

    given: Mapping[str, Any]
    line: int
    id: str
    pgn: int
    fields: list[_Field]

    @cached_property
    def fixed(self) -> int:
        """Number of fields with a fixed value."""
        return sum(field.match is not None for field in self.fields)

    @property
    def transport(self) -> Transport | None:
        """Its transport: fast packets may also come by that of ISO 11783, and what is too long for them does."""
        return _TRANSPORTS[self.given["Type"]]

    def head_size(self, behind: Sequence[Sequence[_Field]]) -> int:
        """Return the bytes before these cells, of a form without lists."""
        left = sum(field.size for cell in behind for field in cell)
        return (sum(field.size for field in self.fields) - left) // 8


class _Builder:
    def __init__(
        self, path: str, table: Mapping[str, PlainValue], pgns: Sequence[Any], lines: Sequence[int]
    ) -> None:
        self.path, self.pgns = path, pgns
        self.lines = lines if len(lines) == len(pgns) else [0] * len(pgns)
        self.problems: list[ImportProblem] = []
        self.taken = set(PythonNames.TAKEN_BY_CODE)
        #: Names of values that fields have so far.
        self.named = 0
        self.names = _tables(table, "LookupEnumerations", "EnumValues", "Value")
        self.flags = _tables(table, "LookupBitEnumerations", "EnumBitValues", "Bit")
        self.field_types = dict(field_types(table))
        self.forms: dict[int, list[_Form]] = {}
        version = f", version {ProblemText.clean(str(table['Version']))[:40]}" if "Version" in table else ""
        self.protocol = Protocol(
            protocol_name(path), link="can", bitrate=BITRATE, doc=f"NMEA 2000{version}", source=path
        )
        self.protocol.place = SourceLine(path, 1)

    def _problem(self, line: int, reason: str, *, is_note: bool = False) -> None:
        self.problems.append(ImportProblem(line, reason, is_note=is_note))

    def build(self) -> Protocol:
        if len(self.pgns) > MOST_PGNS:
            raise CallerError(f"{self.path}: {len(self.pgns):,} PGNs; at most {MOST_PGNS:,} are read")
        if sum(len(pgn.get("Fields") or ()) for pgn in self.pgns if isinstance(pgn, dict)) > MOST_FIELDS:
            raise CallerError(f"{self.path}: more than {MOST_FIELDS:,} fields")
        if sum(map(len, [*self.names.values(), *self.flags.values()])) > MOST_NAMES:
            raise CallerError(f"{self.path}: more than {MOST_NAMES:,} names of values")
        forms = self.forms
        for given, line in zip(self.pgns, self.lines, strict=True):
            label = (
                ProblemText.one_line(str(given.get("Id") or given.get("PGN")))[:60]
                if isinstance(given, dict)
                else "?"
            )
            try:
                form = self._form(given, line)
                if len(some := forms.setdefault(form.pgn, [])) >= MOST_FORMS:
                    raise _LeftOut(f"more than {MOST_FORMS} forms of PGN {form.pgn}")
                some.append(form)
            except _LeftOut as reason:
                self._problem(line, f"PGN {label}: {reason}: left out")
        for some in forms.values():
            self._declare_all(some)
        return self.protocol

    @lru_cache(maxsize=64)  # noqa: B019  # a builder lives as long as its protocol
    def parameters(self, pgn: int) -> list[list[Parameter]]:
        """Return the fields of a PGN's forms, for functions about it: made when a packet asks for them."""
        return [[self._parameter(field) for field in form.fields] for form in self.forms.get(pgn, ())]

    def _parameter(self, field: _Field) -> Parameter:
        """Return a field as functions about its group have it: alone, in whole bytes."""
        size = (field.size + 7) // 8
        made: c.Construct | None = None
        if field.is_bytes and size:
            made = c.Bytes(size)
        elif field.kind == "FLOAT":
            made = c.Float32l
        elif size and field.width is not None and field.kind not in _SHAPED:
            made = self.number(field, _integer(size, is_signed=field.is_signed and not field.size % 8))
        return ProblemText.one_line(field.name)[:60], size, made, field.match

    def keyed(self, name: str) -> dict[str, tuple[int, int, c.Construct]]:
        """Return what each key of a table has as its value, by name: key, size in bytes, construct."""
        found: dict[str, tuple[int, int, c.Construct]] = {}
        for entry in self.field_types.get(name, ()):
            key, text = _whole(entry.get("value")), str(entry.get("Bits"))
            width = int(text) if text.isascii() and text.isdigit() and len(text) < 4 else 0
            kind = str(entry.get("FieldType"))
            if key is None or key < 0 or width not in (8, 16, 24, 32, 64) or kind not in _NUMBERS | _OTHERS:
                continue
            is_signed = bool(entry.get("Signed")) and not entry.get("Offset")
            top = (1 << width - is_signed) - 1
            # The greatest numbers mean unknown, out of range and reserved (canboat: Sentinels TopOfRange).
            words = (
                ("UnknownValue", "OutOfRangeValue", "ReservedValue")
                if kind in _NUMBERS - {"ISO_NAME"}
                else ()
            )
            given = {**{word: top - n for n, word in enumerate(words)}, **entry}
            field = _Field(camel(str(entry.get("name") or key)), "", kind, width, given, None)
            construct = self.number(field, _integer(width // 8, is_signed=is_signed))
            found[PythonNames.unused(field.name, set(found))] = key, width // 8, construct
        return found

    def _form(self, given: Any, line: int) -> _Form:
        fields = given.get("Fields") if isinstance(given, dict) else None
        number = _whole(given.get("PGN")) if isinstance(given, dict) else None
        if number is None or not 0 <= number < 1 << 18 or not isinstance(fields, list):
            raise _LeftOut("a PGN has a number below 2¹⁸ and a list Fields")
        if given.get("Fallback"):
            raise _LeftOut("an entry for all unknown PGNs")
        if len(fields) > MOST_FAST:
            raise _LeftOut(f"{len(fields):,} fields")
        if number >> 8 in (CONNECTION, DATA):
            raise _LeftOut(f"its frames are those of {J1939Transport.title}, which are put together")
        kind = given.get("Type")
        if kind not in _TRANSPORTS:
            raise _LeftOut(
                f"of the type {ProblemText.one_line(str(kind))[:20]},"
                " which is neither one frame nor a fast packet nor of ISO 11783"
            )
        read = [_field(field) for field in fields]
        self.named += sum(
            len(self.names.get(str(field.given.get("LookupEnumeration")), ())) for field in read
        )
        if self.named > MOST_NAMES:
            raise _LeftOut(f"more than {MOST_NAMES:,} names of values in all")
        if kind == "Fast" and sum(field.size for field in read) > MOST_FAST and read[-1].is_bytes:
            # The table gives the longest that it may be; packets have what there is.
            read[-1] = replace(read[-1], width=None)
        return _Form(given, line, str(given.get("Id") or f"pgn{number}"), number, read)

    def _declare_all(self, forms: Sequence[_Form]) -> None:
        """Declare the forms of a PGN, the one with more fixed values first where a packet may be either."""
        declared: list[tuple[int, str]] = []
        for form in sorted(forms, key=lambda form: form.fixed):
            name, known = PythonNames.unused(form.id, self.taken), len(self.problems)
            overrides = tuple(entry for fixed, entry in declared if fixed < form.fixed)
            try:
                made = self._declare(form, name, overrides)
            except (_LeftOut, AcesError) as reason:
                del self.problems[known:]
                said = re.sub(r" \([^()]*:\d+\)", "", ProblemText.of_error(reason)).partition("; say what")[0]
                said = f"PGN {ProblemText.one_line(form.id)[:60]}: {said}"
                cut = _cut(form)
                try:
                    if cut is None:
                        raise _LeftOut("nothing of it can be said")
                    made = self._declare(cut, name, overrides)
                except (_LeftOut, AcesError):
                    del self.problems[known:]
                    self._problem(form.line, f"{said}: left out")
                    continue
                rest = ProblemText.one_line(form.fields[len(cut.fields)].name)[:60]
                self._problem(form.line, f"{said}: bytes from {rest} on are in {TRAILING}", is_note=True)
            made.place = SourceLine(self.path, form.line or 1)
            declared.append((form.fixed, name))
            if name != form.id:
                self._problem(
                    form.line, f"PGN {ProblemText.one_line(form.id)[:60]} is called {name} here", is_note=True
                )

    def _declare(self, form: _Form, name: str, overrides: tuple[str, ...]) -> Message:
        prefix, match, payload = _Shape(self, form).made()
        facts = [ProblemText.clean(str(form.given.get(key) or "")) for key in ("Description", "Explanation")]
        return self.protocol.message(
            name,
            id=_identifier(form.pgn),
            transport=form.transport,
            prefix=prefix,
            match=match,
            payload=payload,
            extended=True,
            overrides=overrides,
            doc="\n".join(filter(None, facts)),
            source=f"PGN {form.pgn}",
        )

    def number(self, field: _Field, place: c.Construct) -> c.Construct:
        """Return what a number in these bits means."""
        get = field.given.get
        unit = ProblemText.clean(str(get("Unit") or ""))
        unit = _UNITS.get(unit, unit)
        if field.kind == "FLOAT":
            return Quantity(place, unit=unit) if unit else place
        assert field.width is not None
        low, high = field.limits
        if field.kind == "BITLOOKUP":
            known = self.flags.get(str(get("LookupBitEnumeration")), {})
            return Flags(place, {name: bit for name, bit in known.items() if 0 <= bit < field.width})
        names: dict[str, int] = {}
        if field.kind == "LOOKUP":
            known = self.names.get(str(get("LookupEnumeration")), {})
            names = {name: number for name, number in known.items() if low <= number <= high}
        sentinels = (_whole(get(key)) for key in ("UnknownValue", "OutOfRangeValue", "ReservedValue"))
        named = set(names.values())
        unknown = [
            special
            for special in dict.fromkeys(sentinels)
            if special is not None and low <= special <= high and special not in named
        ]
        scale, offset = _factor(get("Resolution"), 1), _factor(get("Offset"), 0)
        if names and scale == 1 and not offset and not unknown:
            return Enumeration(place, names)
        is_plain = scale == 1 and not offset and not unit and not unknown and not names
        if is_plain or len(unknown) > high - low:
            return place
        return Quantity(place, unit=unit, scale=scale, offset=offset, unknown=unknown, names=names)


class _Shape:
    """How the fields of one form lie in its data."""

    def __init__(self, builder: _Builder, form: _Form) -> None:
        self.builder, self.form = builder, form
        self.places = {field: place for place, field in enumerate(form.fields)}
        self.counts: dict[int, Any] = {}
        self.taken = {
            "reserved",
            TRAILING,
            *PythonNames.TAKEN_BY_RECORDS,
            "priority",
            "source",
            "destination",
        }
        #: The list at the end whose items say their own kind.
        self.own: c.Construct | None = None
        for field in form.fields:
            if "Condition" in field.given:
                raise _LeftOut("a field that is there on a condition")
        self.groups = _groups(form)
        self._take_own()
        form = self.form
        for field in form.fields:
            if field.kind in _SHAPED:
                raise _LeftOut(_SHAPED[field.kind])
        #: By the place of a field that counts a list, how it is asked for.
        self.counts = {count: None for _, _, count in self.groups if count is not None}

    def _take_own(self) -> None:
        """Take the fields at the end that say their own kind as a list, off the others."""
        fields, builder = self.form.fields, self.builder
        kinds = [field.kind for field in fields]
        start = self.groups[-1][0] if self.groups else len(fields)
        if kinds[start:] == ["FIELD_INDEX", "VARIABLE"] and len(self.groups) == 1:
            self._cut_at(start, GroupParameters(builder.parameters))
        if kinds[-1:] != ["DYNAMIC_FIELD_VALUE"] or len(self.groups) > 1:
            return
        if _KEY in kinds:
            start = kinds.index(_KEY) if not self.groups else start
            key, between = fields[start], fields[start + 1 : -1]
            known = builder.keyed(str(key.given.get("LookupFieldTypeEnumeration")))
            if key.kind != _KEY or not known:
                raise _LeftOut("a list that no key begins")
            if len(between) == 1 and between[0].kind == _LENGTH and not (key.size + between[0].size) % 8:
                self._cut_at(start, KeyedItems(key.size, between[0].size, known))
                return
            data = {name: (number, value) for name, (number, _, value) in known.items()}
            if between:
                heads = self._struct(list(_cells(between)), set())
                data = {
                    name: (number, c.Struct(*heads, "value" / value))
                    for name, (number, value) in data.items()
                }
            self._cut_at(start, Items(tag=_integer(key.size // 8, is_signed=False), kinds=data))
        elif self.groups and kinds[start] == _LENGTH:
            between = fields[start:-1]
            size = sum(field.size for field in between[1:]) // 8
            items = self._struct(list(_cells(between)), set())
            record = c.Struct(*items, "value" / c.Bytes(c.this[items[0].name] - size))
            self._cut_at(start, c.GreedyRange(record))

    def _cut_at(self, start: int, own: c.Construct) -> None:
        """Have these fields up to `start`, and a list behind them."""
        self.own, self.groups = own, []
        self.form = replace(self.form, fields=self.form.fields[:start])

    def made(self) -> tuple[c.Struct | None, dict[str, Any], c.Construct]:
        """Return the prefix, what it must be, and the payload behind it."""
        fields = self.form.fields
        end = self.groups[0][0] if self.groups else len(fields)
        if any(field.match is not None for field in fields[end:]):
            raise _LeftOut("a fixed value in a list")
        cells = list(_cells(fields[:end]))
        heads = max(
            (n + 1 for n, cell in enumerate(cells) if any(f.match is not None for f in cell)), default=0
        )
        match: dict[str, Any] = {}
        prefix = [self._head(cell, match) for cell in cells[:heads]]
        return c.Struct(*prefix) if prefix else None, match, self._payload(cells[heads:])

    def _name(self, field: _Field) -> str:
        made = PythonNames.unused(field.name, self.taken)
        if made != field.name and not field.is_padding:
            form, name = ProblemText.one_line(self.form.id)[:60], ProblemText.one_line(field.name)[:60]
            said = f"field {form}.{name} is called {made} here"
            self.builder.problems.append(ImportProblem(self.form.line, said, is_note=True))
        return made

    def _named(self, field: _Field, construct: c.Construct) -> c.Construct:
        return c.Renamed(construct, newname=self._name(field), newdocs=ProblemText.clean(field.text))

    # ------------------------------------------------------------------ what fixed values are in

    def _head(self, cell: Sequence[_Field], match: dict[str, Any]) -> c.Construct:
        """Return whole bytes of the template: fixed values, and the captured numbers beside them."""
        size = sum(field.size for field in cell) // 8
        if len(cell) == 1 and cell[0].match is None and not cell[0].is_padding:
            return self._named(cell[0], self._alone(cell[0]))
        if len(cell) == 1 and cell[0].match is None and size <= 8:
            return self._named(cell[0], _integer(size, is_signed=False))
        if size > 4:
            raise _LeftOut(f"fixed values among {size} bytes that have no other borders")
        pattern, shift = IdPattern(0), 0
        for field in cell:
            if field.match is not None:
                if not 0 <= field.match < 1 << field.size:
                    raise _LeftOut(f"{ProblemText.one_line(field.name)[:60]} is never {field.match}")
                pattern = pattern + (field.match << shift)
            elif field.size > 8:
                raise _LeftOut(
                    f"{ProblemText.one_line(field.name)[:60]} has {field.size} bits beside a fixed value"
                )
            else:
                values = range(1 << field.size)
                pattern = pattern + (
                    IdField(self._name(field), values, doc=ProblemText.clean(field.text)) << shift
                )
            shift += field.size
        name = self._name(cell[0]) if cell[0].match is not None else PythonNames.unused("head", self.taken)
        match[name] = pattern
        return c.Renamed(_integer(size, is_signed=False), newname=name)

    # ------------------------------------------------------------------ what is behind

    def _payload(self, cells: Sequence[Sequence[_Field]]) -> c.Construct:
        fields = [field for cell in cells for field in cell]
        size = sum(field.size for field in fields) // 8
        has_room = (
            self.form.transport is not None or bool(self.groups) or self.form.head_size(cells) + size < 8
        )
        is_fixed = not self.groups and self.own is None and all(field.width is not None for field in fields)
        if fields and is_fixed and not any(map(_is_in_bytes, fields)):
            return self._layout(fields, TRAILING if has_room else "")
        made = self._struct(cells)
        for start, length, count in self.groups:
            made.append(self._list(self.form.fields[start : start + length], count))
        is_open = self.groups[-1][2] is None if self.groups else bool(fields) and _is_open_end(fields[-1])
        if self.own is not None:
            made.append(PythonNames.unused("list", self.taken) / self.own)
            is_open = True
        if has_room and not is_open:
            made.append(TRAILING / c.Default(c.GreedyBytes, b"") * "bytes behind the known fields")
        return c.Struct(*made)

    def _layout(self, fields: Sequence[_Field], trailing: str = "", path: Any = None) -> BitLayout:
        """Return fields in bits; `path` is how the layout is asked for."""
        made: list[c.Construct] = []
        at = 0
        for field in fields:
            place: c.Construct
            if not field.is_padding:
                place = (
                    float_bits(32, at)
                    if field.kind == "FLOAT"
                    else bits(field.size, at, signed=field.is_signed)
                )
                index = self.places[field]
                if index not in self.counts:
                    place = self.builder.number(field, place)
                made.append(self._named(field, place))
                if index in self.counts and path is not None:
                    self.counts[index] = path[made[-1].name]
            at += field.size
        return BitLayout(at // 8, *made, trailing=trailing)

    def _struct(self, cells: Sequence[Sequence[_Field]], taken: set[str] | None = None) -> list[c.Construct]:
        """Return fields one behind the other; `taken` are the names of a record of their own."""
        if taken is not None:
            outer, self.taken = self.taken, {*taken, *PythonNames.TAKEN_BY_RECORDS}
            found = self._struct(cells)
            self.taken = outer
            return found
        made: list[c.Construct] = []
        for is_bits, some in groupby(cells, lambda cell: len(cell) > 1):
            fields = [field for cell in some for field in cell]
            if is_bits:
                name = PythonNames.unused("bits", self.taken)
                made.append(c.Renamed(self._layout(fields, path=c.this[name]), newname=name))
            else:
                made += map(self._whole, fields)
        return made

    def _whole(self, field: _Field) -> c.Construct:
        """Return a field of whole bytes under its name."""
        index = self.places[field]
        made = self._named(field, self._alone(field, is_count=index in self.counts))
        if index in self.counts:
            self.counts[index] = c.this[made.name]
        return made

    def _alone(self, field: _Field, *, is_count: bool = False) -> c.Construct:
        """Return a field of whole bytes by itself."""
        if field.kind == "STRING_LAU":
            text = c.Struct("encoding" / c.Byte * "0: UTF-16, 1: one byte a character", "text" / Text())
            return c.Prefixed(c.Byte, text, includelength=True)
        if field.kind == "STRING_LZ":
            return c.Prefixed(c.Byte, Text())
        if field.width is None and field is self.form.fields[-1] and not self.groups:
            return Text() if field.kind == "STRING_FIX" else c.GreedyBytes
        if field.width is None:
            raise _LeftOut(
                f"{ProblemText.one_line(field.name)[:60]} has a length that its own bytes do not say"
            )
        size = field.width // 8
        if field.is_padding:
            return c.Default(c.Bytes(size), b"\xff" * size)
        if field.kind == "STRING_FIX":
            return Text(size, ends=_TEXT_ENDS)
        if _is_in_bytes(field):
            return c.Bytes(size)
        place = c.Float32l if field.kind == "FLOAT" else _integer(size, is_signed=field.is_signed)
        return place if is_count else self.builder.number(field, place)

    def _list(self, fields: Sequence[_Field], count: int | None) -> c.Construct:
        """Return a list of groups; without a count it takes all bytes that there are."""
        cells = list(_cells(fields))
        outer, self.taken = self.taken, set(PythonNames.TAKEN_BY_RECORDS)
        is_plain = all(field.width is not None and not _is_in_bytes(field) for field in fields)
        group: c.Construct
        group = (
            self._layout(fields)
            if is_plain and any(len(cell) > 1 for cell in cells)
            else c.Struct(*self._struct(cells))
        )
        self.taken = outer
        asked: Any = self.counts[count] if count is not None else None
        if count is not None and asked is None:
            raise _LeftOut("a list whose count is not before it")
        if count is not None and (width := self.form.fields[count].width):
            asked %= (1 << width) - 1  # all ones: not known, and no item
        name = PythonNames.unused("list", self.taken)
        return c.Renamed(c.GreedyRange(group) if count is None else c.Array(asked, group), newname=name)


def _cut(form: _Form) -> _Form | None:
    """Return a form up to the first field that cannot be said, where bytes may be behind it; None without one."""
    stops = [
        place
        for place, field in enumerate(form.fields)
        if "Condition" in field.given
        or field.kind in _SHAPED
        or (field.width is None and field.kind not in _STRINGS)
    ]
    stops += [
        start - 1
        for n in "12"
        if (start := _whole(form.given.get(f"RepeatingFieldSet{n}StartField"))) is not None
    ]
    stop = min((place for place in stops if 0 < place < len(form.fields)), default=0)
    fixed = max((n + 1 for n, field in enumerate(form.fields) if field.match is not None), default=0)
    if form.transport is None or stop < max(1, fixed):
        return None
    given = {key: value for key, value in form.given.items() if not key.startswith("Repeating")}
    return replace(form, fields=form.fields[:stop], given=given)


def _is_in_bytes(field: _Field) -> bool:
    """Return whether a field is read as bytes or text: what is not a number, at the borders of bytes."""
    return field.kind in _STRINGS or (field.is_bytes and field.is_aligned)


def _is_open_end(field: _Field) -> bool:
    """Return whether a field takes all bytes that there are."""
    return field.width is None and field.kind not in _STRINGS


def _cells(fields: Sequence[_Field]) -> Iterator[list[_Field]]:
    """Yield the fields in runs of whole bytes, as short as possible."""
    cell: list[_Field] = []
    width = 0
    for field in fields:
        cell.append(field)
        width += field.size
        if width % 8 == 0:
            yield cell
            cell, width = [], 0
    if cell:
        raise _LeftOut(f"its fields end inside a byte, {width % 8} bits behind one")


def _groups(form: _Form) -> list[tuple[int, int, int | None]]:
    """Return the lists of a form: the place of the first field, how many fields a group has, the place of what counts
    them.
    """
    found: list[tuple[int, int, int | None]] = []
    for number in ("1", "2"):
        start, size, count = (
            _whole(form.given.get(f"RepeatingFieldSet{number}{word}"))
            for word in ("StartField", "Size", "CountField")
        )
        if start is None and size is None:
            continue
        if start is None or size is None or min(start, size) < 1 or start - 1 + size > len(form.fields):
            raise _LeftOut("a list of fields that are not there")
        if found and sum(found[-1][:2]) != start - 1:
            raise _LeftOut("lists that are not one behind the other")
        if found and found[-1][2] is None:
            raise _LeftOut("a list behind one without a count")
        found.append((start - 1, size, None if count is None else count - 1))
    if found and sum(found[-1][:2]) != len(form.fields):
        raise _LeftOut("fields behind a list")
    return found


@lru_cache(maxsize=256)
def _identifier(pgn: int) -> IdPattern:
    """Return the identifiers of a parameter group: any priority and source, any destination where it is addressed."""
    pattern = IdField("priority", range(8)) << 26
    if pgn >> 8 & 0xFF < 240:
        return (
            pattern
            | (IdField("destination", range(256)) << 8)
            | IdField("source", range(256))
            | (pgn & 0x3FF00) << 8
        )
    return pattern | IdField("source", range(256)) | pgn << 8


def _integer(size: int, *, is_signed: bool) -> c.Construct:
    name = f"Int{8 * size}{'s' if is_signed else 'u'}l"
    return getattr(c, name) if hasattr(c, name) else c.BytesInteger(size, signed=is_signed, swapped=True)


def _field(given: Any) -> _Field:
    if not isinstance(given, dict) or not isinstance(given.get("Id"), str):
        raise _LeftOut("a field without an Id")
    kind = str(given.get("FieldType"))
    width = None if given.get("BitLengthVariable") or kind in _STRINGS else _whole(given.get("BitLength"))
    if kind not in _NUMBERS | _PADDING | _STRINGS | _SHAPED.keys() | _OTHERS:
        raise _LeftOut(f"a field of the type {ProblemText.one_line(kind)[:30]}")
    if width is not None and not 0 < width <= MOST_BITS:
        raise _LeftOut(f"a field of {width} bits")
    if kind == "FLOAT" and width != 32:
        raise _LeftOut(f"a float of {width} bits")
    text = str(given.get("Description") or given.get("Name") or "")
    return _Field(given["Id"], text, kind, width, given, _whole(given.get("Match")))


def _tables(table: Mapping[str, Any], key: str, values: str, number: str) -> dict[str, dict[str, int]]:
    """Return the names of values, by the name of their table; of two values with one name the second has its number
    behind it.
    """
    found: dict[str, dict[str, int]] = {}
    for listed in table.get(key) or ():
        names: dict[str, int] = {}
        seen: set[int] = set()
        for entry in (listed.get(values) if isinstance(listed, dict) else None) or ():
            value = _whole(entry.get(number)) if isinstance(entry, dict) else None
            name = ProblemText.clean(str(entry.get("Name") or "")) if value is not None else ""
            if value is not None and name and value not in seen:
                seen.add(value)
                names[name if name not in names else f"{name} {value}"] = value
        if isinstance(listed, dict):
            found[str(listed.get("Name"))] = names
    return found


def _whole(value: FieldValue) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 64 else None


def _factor(value: FieldValue, usual: float) -> float:
    """Return a resolution or an offset, an integer where it is whole."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return usual
    return int(value) if float(value).is_integer() else value
