"""Registers by name: in decoded lines, and in what is sent. Names, units and ranges are those of the protocol's tables.

    Read    id=1  start=36  count=2            present_position
    Status  id=1  error={}  parameters=FF 01   present_position=149.9 °
    aces send Write id=1 goal_position=150     for start=30 data=0002

1. Where a protocol has several tables, a name or a value is used only where all of them agree: Feetech's differ in their
   byte order.
2. An answer does not say what it is of. Its bytes have names only through the request of the same device before it, and
   only when they are as many as that asked for.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from aces_bus import Unknown
from aces_bus.errors import CallerError, FieldError, UnknownNameError
from aces_bus.protocol import Message, Record, Variant
from aces_bus.protocol.declare.registers import Register, RegisterMap
from aces_bus.protocol.plan.flatten import NotFlat, scalar_of
from aces_bus.protocol.record import FieldValue, protocol_name_of

from .output.field_text import PrintedField
from .output.value_text import anything, value_printer
from .values import parse_value

#: Registers of one packet that are shown with their values; of more the number is.
SHOWN = 8
_NAME = re.compile(r"[A-Za-z_]\w*")
_GIVEN = re.compile(r"\s*([A-Za-z_]\w*)\s*=\s*(.*?)\s*", re.DOTALL)


class RegisterNotes:
    """What records say of registers. `see` takes all records, in their order; `of` is about those it took last."""

    def __init__(self, variants: Iterable[Variant]) -> None:
        protocols = {variant.protocol.name: variant.protocol for variant in variants}
        self._tables = {
            name: _Tables(protocol.register_maps)
            for name, protocol in protocols.items()
            if protocol.register_maps
        }
        self._notes: dict[int, list[PrintedField]] = {}

    def see(self, items: Iterable[Record]) -> None:
        """Take records, and remember what they ask for."""
        if not self._tables:
            return
        self._notes = {}
        for item in items:
            kind = type(item)
            table = None if kind is Unknown else self._tables.get(protocol_name_of(kind))
            if table is not None and (notes := table.notes(kind.__name__, item)):
                self._notes[id(item)] = notes

    def of(self, record: Record) -> Sequence[PrintedField]:
        """Return the registers of a record, as text shows them behind its fields."""
        return self._notes.get(id(record), ())


class _Tables:
    """The tables of one protocol, and what was asked of each device."""

    def __init__(self, maps: Sequence[RegisterMap]) -> None:
        self._maps = maps
        self._replies = {
            table.reply_message: table.reply_field for table in self._maps if table.reply_message
        }
        #: By device: first address and number of bytes.
        self._asked: dict[int, tuple[int, int]] = {}
        self._shows: dict[tuple[int, str], Callable[[Any], str]] = {}

    def notes(self, name: str, record: Record) -> list[PrintedField]:
        if (field := self._replies.get(name)) is not None:
            start, count = self._asked.pop(record.id, (0, 0))
            data: bytes = getattr(record, field)
            return self._values(start, data) if data and len(data) == count else []
        self._asked.pop(getattr(record, "id", -1), None)
        for area in getattr(record, "areas", ()):  # of several devices, an area each
            self._asked[area.id] = area.start, area.count
        address: int | None = getattr(record, "start", None)
        if address is None:
            return []
        number: int | None = getattr(record, "count", None)
        if number is not None:
            for device in getattr(record, "ids", None) or (getattr(record, "id", -1),):
                self._asked[device] = address, number
            return self._names(address, number)
        if (servos := getattr(record, "servos", None)) is not None:
            return self._together(address, {servo.id: servo.data for servo in servos})
        return self._values(address, getattr(record, "data", b""))

    def _names(self, start: int, count: int) -> list[PrintedField]:
        """Return the first and the last of the registers that begin in a stretch."""
        tables = [
            [register for register in _ordered(map_) if 0 <= register.address - start < count]
            for map_ in self._maps
        ]
        names = {(found[0].name, found[-1].name) if found else ("", "") for found in tables}
        if len(names) != 1 or any(found and found[0].address != start for found in tables):
            return []
        first, last = names.pop()
        return [PrintedField("", first if first == last else f"{first}…{last}", "", "value")] if first else []

    def _values(self, start: int, data: bytes) -> list[PrintedField]:
        found = self._read(start, data)
        more = [PrintedField("", f"… and {len(found) - SHOWN} more registers", "", "name")]
        fields = [PrintedField(f"{place[0]}=", place[1], place[2], "value") for place in found[:SHOWN]]
        return fields + (more if len(found) > SHOWN else [])

    def _together(self, start: int, data: Mapping[int, bytes]) -> list[PrintedField]:
        """Return values of several devices: of each register one by device."""
        values: dict[str, dict[int, str]] = {}
        for device, piece in data.items():
            for name, value, unit in self._read(start, piece):
                values.setdefault(name, {})[device] = value + unit
        return [
            PrintedField(f"{name}=", "{" + ", ".join(f"{n}: {v}" for n, v in of.items()) + "}", "", "value")
            for name, of in list(values.items())[:SHOWN]
        ]

    def _read(self, start: int, data: bytes) -> list[tuple[str, str, str]]:
        """Name, value and unit of the registers in `data`, as all tables say them."""
        tables = [self._of_map(number, start, data) for number in range(len(self._maps))]
        return [register for register in tables[0] if all(register in other for other in tables[1:])]

    def _of_map(self, number: int, start: int, data: bytes) -> list[tuple[str, str, str]]:
        found = []
        for register in _ordered(self._maps[number]):
            at = register.address - start
            if at < 0 or at + register.size > len(data):
                continue
            if (number, register.name) not in self._shows:
                self._shows[number, register.name] = _printer(register)
            unit = register.unit or str(getattr(register.field, "unit", ""))
            try:
                value = register.decode(data[at : at + register.size])
            except FieldError:
                continue
            is_number = not isinstance(value, str) and value is not None
            shown = "unknown" if value is None else self._shows[number, register.name](value)
            found.append((register.name, shown, f" {unit}" if unit and is_number else ""))
        return found


def _ordered(table: RegisterMap) -> list[Register]:
    return sorted(table.values(), key=lambda register: register.address)


def _printer(register: Register) -> Callable[[Any], str]:
    try:
        return value_printer(scalar_of(register.field, register.address))
    except NotFlat:
        return lambda value: f"{value:.6g}" if isinstance(value, float) else anything(value)


# ---------------------------------------------------------------------- what is sent


def with_registers(message: Message, texts: Sequence[str]) -> list[str]:
    """Return `field=value` texts of a message in which registers may be named, with addresses and bytes in
    their place.

    `start=NAME` is the address of a register, and `count` its size where none is given; in a message with `start` and
    `data`, `NAME=VALUE` of one or more registers side by side are both. Raises `CallerError` for a name on which the
    protocol's tables disagree, `UnknownNameError`, and `FieldError` for a value that does not fit.
    """
    maps = message.protocol.register_maps
    if not maps or "start" not in message.fields:
        return list(texts)
    given = [(text, _GIVEN.fullmatch(text)) for text in texts]
    names = {found[1] for _, found in given if found}
    kept, written = list[str](), dict[str, str]()
    for text, found in given:
        if found and found[1] == "start" and _NAME.fullmatch(found[2]):
            register = _agreed(message, found[2])
            kept.append(f"start={register.address}")
            if size := next((name for name in ("count", "size") if name in message.fields), None):
                kept += [] if size in names else [f"{size}={register.size}"]
        elif found and found[1] not in message.fields and "data" in message.fields:
            if not any(found[1] in table for table in maps):
                known = [*message.fields, *(name for table in maps for name in table)]
                raise UnknownNameError(f"field of {message.name}, or register", found[1], known)
            written[found[1]] = found[2]
        else:
            kept.append(text)
    if not written:
        return kept
    missing = next((name for table in maps for name in written if name not in table), None)
    if missing is not None:
        raise CallerError(f"{missing} is not in all tables of {message.protocol.name}; give start= and data=")
    if both := names & {"start", "data"}:
        raise CallerError(
            f"{', '.join(written)} and {', '.join(sorted(both))} say the same; give one of them"
        )
    stretches = {table.stretch(_parsed(table, written)) for table in maps}
    if len(stretches) > 1:
        raise CallerError(
            f"{', '.join(written)}: the tables of {message.protocol.name} differ in how this is written;"
            " give start= and data="
        )
    ((start, data),) = stretches
    return [*kept, f"start={start}", f"data=hex:{data.hex()}"]


def _agreed(message: Message, name: str) -> Register:
    """Return the register of this name, where it is at one place and of one size in all tables."""
    maps = message.protocol.register_maps
    found = [table[name] for table in maps if name in table]
    if not found:
        known = {register for table in maps for register in table}
        raise UnknownNameError(f"register of {message.protocol.name}", name, known)
    if len({(register.address, register.size) for register in found}) > 1 or len(found) < len(maps):
        places = ", ".join(f"{register.address} ({register.size} bytes)" for register in found)
        raise CallerError(
            f"{name} is not in all tables of {message.protocol.name} the same: {places}; give the address"
        )
    return found[0]


def _parsed(table: RegisterMap, written: Mapping[str, str]) -> dict[str, FieldValue]:
    """Return values from their texts, as the fields of these registers take them."""
    values = {}
    for name, text in written.items():
        register = table[name]
        try:
            node = scalar_of(register.field, register.address)
        except NotFlat:
            node = None
        values[name] = parse_value(text, node, name)
    return values


__all__ = ["RegisterNotes", "with_registers"]
