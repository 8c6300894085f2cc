"""The fixed integers at the head of a packet: a framing's header, a family's prefix.

1. A head field is a whole number of bytes at a fixed offset; it is what templates match on.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec
from construct import Bytes, Const, Construct, Renamed, Struct
from msgspec.structs import replace

from ...errors import SpecError
from .fields import Enumeration, Field, Flags, WireNumber, innermost, wire_number
from .pattern import IdPattern, as_pattern
from .place import SourceLine


class Head(msgspec.Struct, frozen=True):
    """One field of a head: `offset` from the packet's first byte (from the data's, on CAN)."""

    name: str | None
    field: Construct
    offset: int
    size: int
    order: Literal["little", "big"]
    is_text: bool
    pattern: IdPattern | None = None

    @property
    def is_constant(self) -> bool:
        """True if the template fixes the value, so that records need not carry it."""
        return self.pattern is not None and not self.pattern.captures

    @property
    def is_own(self) -> bool:
        """True if the record shows the field under its own name (not only captures inside it)."""
        return self.name is not None and (
            self.pattern is None or [c.name for c in self.pattern.captures] == [self.name]
        )

    def number(self, packet: bytes) -> int:
        """Return the unsigned number in these bytes."""
        return int.from_bytes(packet[self.offset : self.offset + self.size], self.order)

    def bytes(self, number: int) -> bytes:
        return number.to_bytes(self.size, self.order)

    @property
    def wanted(self) -> str:
        """Required value, as a data sheet would write it: `0x20 + channel`, `'GGA'`."""
        assert self.pattern is not None
        if self.is_text and self.is_constant:
            data = self.bytes(self.pattern.constant)
            if data.isascii() and data.decode("ascii").isprintable():
                return repr(data.decode("ascii"))
        return self.pattern.describe(2 * self.size)

    def matched(self, value: Any, place: SourceLine) -> Head:
        """Return the same field, bound to what a spec's `match` says of it."""
        if isinstance(value, bytes):
            if len(value) != self.size:
                raise SpecError(f"{place}: {self.name} is {self.size} bytes, matched with {value!r}")
            value = int.from_bytes(value, self.order)
        names = enumeration_of(self.field)
        if isinstance(value, str):
            if names is None or value not in names.names:
                raise SpecError(f"{place}: {self.name} has no value named {value!r}")
            value = names.names[value]
        pattern = as_pattern(value, self.name or "")
        if pattern.largest >= 1 << 8 * self.size:
            raise SpecError(
                f"{place}: {self.name} is {8 * self.size} bits wide, matched with {pattern.describe(2)}"
            )
        return replace(self, pattern=pattern)


def enumeration_of(field: Construct) -> Enumeration | None:
    """Return the enumeration among a field's adapters."""
    while True:
        if isinstance(field, Enumeration):
            return field
        if not hasattr(field, "subcon"):
            return None
        field = field.subcon


def flags_of(field: Construct) -> Flags | None:
    """Return the flags among a field's adapters."""
    while not isinstance(field, Flags):
        if not hasattr(field, "subcon"):
            return None
        field = field.subcon
    return field


def heads_of(struct: Struct | None, offset: int, place: SourceLine, what: str) -> tuple[Head, ...]:
    """Return the head fields that a struct declares, from `offset`; raises `SpecError` when one is not a fixed integer."""
    found: list[Head] = []
    for item in struct.subcons if struct is not None else ():
        name = item.name if isinstance(item, Renamed) else None
        body = item.subcon if isinstance(item, Renamed) else item
        shown = f"field {name!r}" if name else f"{body!r}"
        inner = innermost(body)
        pattern = None
        wire = wire_number(inner)
        if isinstance(inner, Bytes) and isinstance(inner.length, int):
            wire = WireNumber("uint", inner.length, "big")
        if wire is None or wire.kind == "float":
            raise SpecError(
                f"{place.of_field(name or '')}: {what} {shown} must be an integer or bytes of fixed size"
            )
        is_text = isinstance(inner, Bytes)
        if isinstance(body, Const):
            number = body.build(None)
            pattern = IdPattern(int.from_bytes(number, wire.order))
        elif is_text and not isinstance(body, Field) and name is None:
            raise SpecError(f"{place}: {what} bytes need a name")
        found.append(Head(name, body, offset, wire.size, wire.order, is_text, pattern))
        offset += wire.size
    return tuple(found)
