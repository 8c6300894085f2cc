"""An ECU's values by identifier as a table, from a robot's file or a TOML file of its own. See `aces_devices.tables`."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from aces_bus.errors import CallerError
from aces_devices.tables import NUMBERS, data_of, entries_of, value_of


class IdentifierEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A value, by its identifier."""

    identifier: Annotated[int, Meta(ge=0, le=0xFFFF)]
    type: Literal["u8", "s8", "u16", "s16", "u32", "s32", "u64", "s64", "float", "double", "text", "bytes"]
    #: Of a text or of bytes: how many.
    count: Annotated[int, Meta(ge=1, le=4000)] = 1
    access: Literal["read", "read-write", "write"] = "read"
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    #: Limits of what is set, in `unit`.
    lower: float | None = None
    upper: float | None = None
    order: Literal["high first", "low first"] = "high first"
    #: Names of some or all of its numbers.
    names: dict[str, int] = {}
    #: How often it is read (s), where that is not the device's `every_s`; 0: once, when the bus is opened.
    every_s: Annotated[float, Meta(ge=0)] | None = None
    doc: str = ""
    source: str = ""


class UdsValue:
    """A value of an ECU: its identifier, and its bytes on the wire."""

    def __init__(self, name: str, entry: IdentifierEntry) -> None:
        self.name, self.entry, self.number = name, entry, entry.identifier
        if not entry.scale:
            raise CallerError("a scale of 0 leaves no value")
        if entry.names and (entry.type not in NUMBERS or entry.type in ("float", "double")):
            raise CallerError(f"names are of whole numbers, not of {entry.type}")
        self.size = struct.calcsize(f">{NUMBERS[entry.type]}") if entry.type in NUMBERS else entry.count
        self._named = {number: text for text, number in entry.names.items()}

    def _ordered(self, data: bytes) -> bytes:
        return data if self.entry.order == "high first" or self.entry.type not in NUMBERS else data[::-1]

    def value(self, data: bytes) -> Any:
        """Return the value of these bytes."""
        entry = self.entry
        if self._named:
            number = value_of(self._ordered(data), entry.type, 1, 0)
            return self._named.get(number, number)
        return value_of(self._ordered(data), entry.type, entry.scale, entry.offset)

    def data(self, value: Any) -> bytes:
        """Return the bytes of a value. Raises `CallerError` for one that does not fit."""
        entry, what = self.entry, f"value {self.name}"
        if isinstance(value, str) and entry.names:
            if value not in entry.names:
                raise CallerError(f"{what}: {value!r} is none of {', '.join(entry.names)}")
            return self._ordered(data_of(what, entry.names[value], entry.type, self.size, 1, 0, ""))
        return self._ordered(
            data_of(what, value, entry.type, self.size, entry.scale, entry.offset, entry.unit)
        )


def identifiers_of(who: str, table: str | None, own: Mapping[str, Any]) -> dict[str, UdsValue]:
    """Return the values of a TOML file with [identifiers], and of a device's own entries, which go before.

    Raises `CallerError` naming the value and what is wrong.
    """
    found: dict[str, UdsValue] = {}
    for name, entry in entries_of(who, "identifiers", table, own).items():
        try:
            found[name] = UdsValue(name, msgspec.convert(entry, IdentifierEntry))
        except (msgspec.ValidationError, CallerError) as error:
            raise CallerError(f"{who}: value {name}: {error}") from None
    numbers: dict[int, str] = {}
    for entry in found.values():
        if entry.number in numbers:
            raise CallerError(
                f"{who}: {numbers[entry.number]} and {entry.name} have the same identifier, {entry.number:#06x}"
            )
        numbers[entry.number] = entry.name
    return found
