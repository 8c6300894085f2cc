"""Bit layouts: fields of any width, in any order, across bytes, in pieces.

1. A bit has one canonical number: 8 × byte + bit, bit 0 being the least significant of its byte.
2. A field is the list of the canonical numbers of its bits, lowest bit first. Order ("lsb", "msb") and splitting exist
   only in how a spec writes that list.
3. Every bit of a layout belongs to a field; those that the spec leaves out are kept in a field named `reserved`.
"""

from __future__ import annotations

import io
from typing import Any

from construct import Construct, Container, IntegerError, ListContainer, Renamed, stream_read

from ...errors import FieldError, SpecError
from .fields import Multiplexed, innermost
from .place import caller


class Bits(Construct):
    """An integer of `width` bits in a `BitLayout`; see `bits` and `Split`, which make it."""

    def __init__(
        self,
        width: int,
        pieces: tuple[tuple[int, int], ...] | None,
        *,
        signed: bool = False,
        order: str | None = None,
    ) -> None:
        super().__init__()
        self.place = caller()
        if width < 1:
            raise SpecError(f"{self.place}: a field of {width} bits")
        if order not in (None, "lsb", "msb"):
            raise SpecError(f"{self.place}: bit order is 'lsb' or 'msb', not {order!r}")
        self.width = width
        self.pieces = pieces
        self.signed = signed
        self.order = order
        self.bytes = (width + 7) // 8

    # A layout hands each field its bits as a little big-endian number, so that adapters work as on any stream.
    def _parse(self, stream: Any, context: Any, path: str) -> int:
        number = int.from_bytes(stream_read(stream, self.bytes, path), "big")
        return number - (1 << self.width) if self.signed and number >> self.width - 1 else number

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        if not isinstance(obj, int):
            raise IntegerError(f"{obj!r} is not an integer", path=path)
        low = -(1 << self.width - 1) if self.signed else 0
        high = low + (1 << self.width) - 1
        if not low <= obj <= high:
            raise IntegerError(f"{obj} is outside {low}…{high}", path=path)
        stream.write((obj & ((1 << self.width) - 1)).to_bytes(self.bytes, "big"))
        return obj

    def _sizeof(self, context: Any, path: str) -> int:
        return self.bytes


def bits(width: int, at: int | None = None, *, signed: bool = False, order: str | None = None) -> Bits:
    """An integer of `width` bits.

    `at` is the number of its first bit in the layout's order, by default the one behind the field before it: in "lsb"
    order bit 0 is the least significant bit of byte 0 and a field grows upward; in "msb" order bit 0 is the most
    significant bit of byte 0 and a field is written high bit first (as in construct's `BitStruct`).
    """
    return Bits(width, None if at is None else ((at, width),), signed=signed, order=order)


def Split(*pieces: tuple[int, int], signed: bool = False, order: str | None = None) -> Bits:
    """One number in several places: `(at, width)` of each piece, least significant piece first."""
    return Bits(sum(width for _, width in pieces), tuple(pieces), signed=signed, order=order)


class Tuple(Construct):
    """Several fields of a `BitLayout` under one name, as a tuple."""

    def __init__(self, *subcons: Construct) -> None:
        super().__init__()
        self.subcons = list(subcons)
        self.place = caller()

    def _sizeof(self, context: Any, path: str) -> int:
        return sum(sc._sizeof(context, path) for sc in self.subcons)


class Slot:
    """A field's place in a layout: its name, its construct and the canonical numbers of its bits."""

    def __init__(
        self, name: str, field: Construct, positions: tuple[int, ...], mux: Multiplexed | None
    ) -> None:
        self.name, self.field, self.positions, self.mux = name, field, positions, mux


class BitLayout(Construct):
    """`size` bytes of bit fields: `BitLayout(8, "speed" / Quantity(bits(12), unit="rpm"), …, order="lsb")`.

    >>> from aces_bus.protocol import BitLayout, bits
    >>> layout = BitLayout(2, "a" / bits(4), "b" / bits(12))
    >>> dict(layout.parse(bytes([0x21, 0x43])))
    {'a': 1, 'b': 1074}
    >>> layout.build({"a": 1, "b": 0x432}).hex()
    '2143'
    """

    def __init__(self, size: int, *fields: Construct, order: str = "lsb") -> None:
        super().__init__()
        self.place = caller()
        if order not in ("lsb", "msb"):
            raise SpecError(f"{self.place}: bit order is 'lsb' or 'msb', not {order!r}")
        self.size = size
        self.order = order
        self.slots: list[Slot] = []
        self.names: list[str] = []
        self._cursor = 0
        for field in fields:
            self._add(field)
        self._check_overlap()
        always = {p for s in self.slots if s.mux is None for p in s.positions}
        self.has_reserved = len(always) < 8 * size

    def _add(self, field: Construct) -> None:
        name = field.name
        if not name:
            raise SpecError(f"{self.place}: every field of a bit layout needs a name")
        if name in self.names or name == "reserved":
            raise SpecError(
                f"{self.place.of_field(name)}: field {name!r} is there twice or taken (bits left out are 'reserved')"
            )
        self.names.append(name)
        body = field.subcon if isinstance(field, Renamed) else field
        mux = body if isinstance(body, Multiplexed) else None
        for part in body.subcons if isinstance(body, Tuple) else [mux.body if mux is not None else body]:
            inner = innermost(part)
            if not isinstance(inner, Bits):
                raise SpecError(f"{self.place.of_field(name)}: field {name!r} is not made of bits(…)")
            self.slots.append(Slot(name, part, self._positions(inner, name), mux))

    def _positions(self, field: Bits, name: str) -> tuple[int, ...]:
        order = field.order or self.order
        pieces = field.pieces
        if pieces is None:
            pieces = ((self._cursor, field.width),)
        found: list[int] = []
        for at, width in pieces:
            if at < 0 or at + width > 8 * self.size:
                place = self.place.of_field(name)
                raise SpecError(
                    f"{place}: field {name!r} ends at bit {at + width - 1}, past the layout of {self.size} bytes"
                    f" ({8 * self.size} bits, {self.place})"
                )
            self._cursor = at + width
            if order == "lsb":
                found += range(at, at + width)
            else:
                found += [p ^ 7 for p in range(at + width - 1, at - 1, -1)]
        return tuple(found)

    def _check_overlap(self) -> None:
        for index, one in enumerate(self.slots):
            for other in self.slots[:index]:
                if (
                    one.mux
                    and other.mux
                    and one.mux.selector == other.mux.selector
                    and not one.mux.when & other.mux.when
                ):
                    continue
                shared = set(one.positions) & set(other.positions)
                if shared:
                    bit = min(shared)
                    raise SpecError(
                        f"{self.place.of_field(one.name)}: field {one.name!r} overlaps {other.name!r}"
                        f" ({self.place.of_field(other.name)}) at byte {bit // 8} bit {bit % 8}"
                    )

    def _parse(self, stream: Any, context: Any, path: str) -> Container:
        word = int.from_bytes(stream_read(stream, self.size, path), "little")
        values = Container()
        inner = Container(
            _=context, _params=context._params, _root=None, _parsing=True, _building=False, _sizing=False
        )
        rest = (1 << 8 * self.size) - 1
        for slot in self.slots:
            if slot.mux is not None and not slot.mux.is_present(inner):
                values[slot.name] = inner[slot.name] = None
                continue
            number = 0
            for index, position in enumerate(slot.positions):
                number |= (word >> position & 1) << index
                rest &= ~(1 << position)
            size = (len(slot.positions) + 7) // 8
            value = slot.field._parsereport(
                io.BytesIO(number.to_bytes(size, "big")), inner, f"{path} -> {slot.name}"
            )
            if self.names.count(slot.name) and sum(s.name == slot.name for s in self.slots) > 1:
                value = ListContainer([*values.get(slot.name, ()), value])
            values[slot.name] = inner[slot.name] = value
        if self.has_reserved:
            values["reserved"] = word & rest
        return values

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        word = 0
        claimed = 0
        inner = Container(
            _=context, _params=context._params, _root=None, _parsing=False, _building=True, _sizing=False
        )
        inner.update(obj)
        used: dict[str, int] = {}
        for slot in self.slots:
            where = f"{path} -> {slot.name}"
            if slot.mux is not None and not slot.mux.is_present(inner):
                if obj.get(slot.name) is not None:
                    wanted = ", ".join(map(str, sorted(slot.mux.when)))
                    raise FieldError(f"{where}: only there while {slot.mux.selector} is {wanted}")
                continue
            many = sum(s.name == slot.name for s in self.slots)
            value = obj[slot.name] if not slot.field.flagbuildnone else obj.get(slot.name)
            if many > 1:
                index = used.get(slot.name, 0)
                used[slot.name] = index + 1
                if len(value) != many:
                    raise FieldError(f"{where}: {many} values wanted, {len(value)} given")
                value = value[index]
            out = io.BytesIO()
            slot.field._build(value, out, inner, where)
            number = int.from_bytes(out.getvalue(), "big")
            for index, position in enumerate(slot.positions):
                word |= (number >> index & 1) << position
                claimed |= 1 << position
        if self.has_reserved:
            reserved = obj.get("reserved") or 0
            if reserved & claimed or not 0 <= reserved < 1 << 8 * self.size:
                raise FieldError(f"{path} -> reserved: {reserved:#x} touches bits of other fields")
            word |= reserved
        stream.write(word.to_bytes(self.size, "little"))
        return obj

    def _sizeof(self, context: Any, path: str) -> int:
        return self.size


__all__ = ["BitLayout", "Bits", "Slot", "Split", "Tuple", "bits"]
