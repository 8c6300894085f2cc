"""Bit layouts: fields of any width, in any order, across bytes, in pieces.

1. A bit has one canonical number: 8 × byte + bit, bit 0 being the least significant of its byte.
2. A field is the list of the canonical numbers of its bits, lowest bit first. Order ("lsb", "msb") and splitting exist
   only in how a spec writes that list.
3. Every bit of a layout belongs to a field; those that the spec leaves out are kept in a field named `reserved`.
4. Whether a multiplexed field is there depends on the raw number of its selector, which may be multiplexed itself.
5. Fields share bits only where the layout says `overlapping`, or where they are never there together. Shared bits are
   written once: values that want them different are refused, so that what is built reads back as it was given.
"""

from __future__ import annotations

import io
import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import reduce
from operator import or_
from typing import Any, BinaryIO

from construct import Construct, Container, IntegerError, ListContainer, Renamed, stream_read

from ...errors import FieldError, SpecError
from .fields import Multiplexed, Present, innermost, number_runs, plain_number
from .place import caller

#: `struct` formats of numbers of so many bits (IEEE 754 binary16, binary32, binary64).
#: Bytes of a layout: far more than any frame, few enough for a bound on the work.
LARGEST = 4096
FLOATS = {16: ">e", 32: ">f", 64: ">d"}


def whole_bits(offset: int, size: int, order: str) -> tuple[int, ...]:
    """Return the canonical numbers of the bits of a number of `size` whole bytes, lowest bit first."""
    places = range(offset, offset + size)
    return tuple(8 * byte + bit for byte in (places[::-1] if order == "big" else places) for bit in range(8))


def runs_of(positions: Sequence[int]) -> list[tuple[int, int, int]]:
    """Return runs of bits that go upward: (number of the lowest bit, its place in `positions`, width)."""
    runs: list[tuple[int, int, int]] = []
    for to, at in enumerate(positions):
        if runs and runs[-1][0] + runs[-1][2] == at:
            first, place, width = runs[-1]
            runs[-1] = (first, place, width + 1)
        else:
            runs.append((at, to, 1))
    return runs


class Bits(Construct):
    """A number of `width` bits in a `BitLayout`; see `bits`, `float_bits` and `Split`, which make it."""

    def __init__(
        self,
        width: int,
        pieces: tuple[tuple[int, int], ...] | None,
        *,
        signed: bool = False,
        order: str | None = None,
        is_float: bool = False,
    ) -> None:
        super().__init__()
        self.place = caller()
        if width < 1:
            raise SpecError(f"{self.place}: a field of {width} bits")
        if order not in (None, "lsb", "msb"):
            raise SpecError(f"{self.place}: bit order is 'lsb' or 'msb', not {order!r}")
        if is_float and width not in FLOATS:
            raise SpecError(f"{self.place}: a float has 16, 32 or 64 bits, not {width}")
        self.width = width
        self.pieces = pieces
        self.signed = signed
        self.order = order
        self.is_float = is_float
        self.bytes = (width + 7) // 8

    # A layout hands each field its bits as a little big-endian number, so that adapters work as on any stream.
    def _parse(self, stream: BinaryIO, context: Container, path: str) -> int | float:
        data = stream_read(stream, self.bytes, path)
        if self.is_float:
            return float(struct.unpack(FLOATS[self.width], data)[0])
        return self.raw_of(int.from_bytes(data, "big"))

    def raw_of(self, number: int) -> int:
        """Return the raw value whose bits, read as an unsigned number, are `number`."""
        return number - (1 << self.width) if self.signed and number >> self.width - 1 else number

    @property
    def is_split(self) -> bool:
        """True if the bits are in several places."""
        return self.pieces is not None and len(self.pieces) > 1

    @property
    def raw_limits(self) -> tuple[int, int] | None:
        """The least and the greatest raw number; None of a float."""
        return None if self.is_float else self._limits

    @property
    def _limits(self) -> tuple[int, int]:
        low = -(1 << self.width - 1) if self.signed else 0
        return low, low + (1 << self.width) - 1

    def _build(self, obj: Any, stream: BinaryIO, context: Container, path: str) -> Any:
        if self.is_float:
            try:
                stream.write(struct.pack(FLOATS[self.width], obj))
            except (struct.error, OverflowError) as error:
                raise FieldError(f"{path}: {obj!r} is not a number of {self.width} bits: {error}") from None
            return obj
        obj = plain_number(obj)
        if not isinstance(obj, int):
            raise IntegerError(f"{obj!r} is not an integer", path=path)
        low, high = self._limits
        if not low <= obj <= high:
            raise IntegerError(f"{obj} is outside {low}…{high}", path=path)
        stream.write((obj & ((1 << self.width) - 1)).to_bytes(self.bytes, "big"))
        return obj

    def _sizeof(self, context: Container, path: str) -> int:
        return self.bytes


def bits(width: int, at: int | None = None, *, signed: bool = False, order: str | None = None) -> Bits:
    """Return an integer of `width` bits.

    `at` is the number of its first bit in the layout's order, by default the one behind the field before it: in "lsb"
    order bit 0 is the least significant bit of byte 0 and a field grows upward; in "msb" order bit 0 is the most
    significant bit of byte 0 and a field is written high bit first (as in construct's `BitStruct`).
    """
    return Bits(width, None if at is None else ((at, width),), signed=signed, order=order)


def float_bits(width: int, at: int | None = None, *, order: str | None = None) -> Bits:
    """Return an IEEE 754 number of 16, 32 or 64 bits, placed as an integer of `bits` is."""
    return Bits(width, None if at is None else ((at, width),), order=order, is_float=True)


def Split(*pieces: tuple[int, int], signed: bool = False, order: str | None = None) -> Bits:
    """Declare a number in several places: `(at, width)` of each piece, least significant piece first.

    In a `BitLayout` places are the layout's. Where its pieces are whole bytes side by side, it may also be a field of a
    `Struct`, like a number of so many bytes; places are counted from its own first byte, in "lsb" order.
    """
    return Bits(sum(width for _, width in pieces), tuple(pieces), signed=signed, order=order)


class Tuple(Construct):
    """Several fields of a `BitLayout` under one name, as a tuple."""

    def __init__(self, *subcons: Construct) -> None:
        super().__init__()
        self.subcons = list(subcons)
        self.place = caller()

    def _sizeof(self, context: Container, path: str) -> int:
        return sum(sc._sizeof(context, path) for sc in self.subcons)


class ByteSplit(Bits):
    """A `Split` that is a field by itself: a number of whole bytes, whose pieces are in an order of their own."""

    def __init__(self, field: Bits) -> None:
        self.__dict__.update(vars(field))
        end = 0
        for at, width in sorted(field.pieces or ()):
            end = end + width if at == end else -1
        if end < 0 or end % 8:
            raise SpecError(
                f"{field.place}: the pieces of a Split that is not a field of a BitLayout are whole bytes side by side;"
                " where other fields lie between them, they all go into one:"
                ' BitLayout(3, "mode" / bits(8, at=8), "angle" / Split((0, 8), (16, 8)))'
            )
        self._layout = BitLayout(self.bytes, "number" / field)
        (self.slot,) = self._layout.slots

    def _parse(self, stream: BinaryIO, context: Container, path: str) -> int | float:
        word = int.from_bytes(stream_read(stream, self.bytes, path), "little")
        return self.raw_of(self.slot.read(word))

    def _build(self, obj: Any, stream: BinaryIO, context: Container, path: str) -> Any:
        out = io.BytesIO()
        super()._build(obj, out, context, path)
        stream.write(self.slot.write(int.from_bytes(out.getvalue(), "big")).to_bytes(self.bytes, "little"))
        return obj


class LayoutSlot:
    """A field's place in a layout: its name, its construct, the canonical numbers of its bits, and when it is there."""

    def __init__(
        self,
        name: str,
        field: Construct,
        inner: Bits,
        positions: tuple[int, ...],
        mux: Multiplexed | None,
        doc: str = "",
    ) -> None:
        self.name, self.field, self.positions, self.mux = name, field, positions, mux
        self.inner, self.doc = inner, doc
        self.mask = reduce(or_, (1 << position for position in positions), 0)

    def is_present(self, raws: Mapping[str, int | None]) -> bool:
        """Return whether the field is there, by the raw numbers of the selectors before it."""
        return self.mux is None or raws.get(self.mux.selector) in self.mux.when

    def read(self, word: int) -> int:
        """Return the field's bits in the little-endian word of the layout, as an unsigned number."""
        number = sum((word >> position & 1) << index for index, position in enumerate(self.positions))
        return number

    def write(self, number: int) -> int:
        """Return the word in which the field has this unsigned number, and all other bits are 0."""
        word = sum((number >> index & 1) << position for index, position in enumerate(self.positions))
        return word


class BitLayout(Construct):
    """`size` bytes of bit fields: `BitLayout(8, "speed" / Quantity(bits(12), unit="rpm"), …, order="lsb")`.

    `overlapping` lets fields share bits. `trailing` names a field of the bytes that follow the layout, as many as there
    are; without it there are none.

    >>> from aces_bus.protocol import BitLayout, bits
    >>> layout = BitLayout(2, "a" / bits(4), "b" / bits(12))
    >>> dict(layout.parse(bytes([0x21, 0x43])))
    {'a': 1, 'b': 1074}
    >>> layout.build({"a": 1, "b": 0x432}).hex()
    '2143'
    """

    def __init__(
        self,
        size: int,
        *fields: Construct,
        order: str = "lsb",
        overlapping: bool = False,
        trailing: str = "",
    ) -> None:
        super().__init__()
        self.place = caller()
        if order not in ("lsb", "msb"):
            raise SpecError(f"{self.place}: bit order is 'lsb' or 'msb', not {order!r}")
        if not 0 <= size <= LARGEST:
            raise SpecError(f"{self.place}: a BitLayout has 0 to {LARGEST} bytes, not {size!r}")
        self.size = size
        self.order = order
        self.overlapping = overlapping
        self.trailing = trailing
        self.slots: list[LayoutSlot] = []
        self.names: list[str] = []
        self._known: set[str] = {"reserved", trailing}
        self._cursor = 0
        for field in fields:
            self._add(field)
        counts = Counter(slot.name for slot in self.slots)
        #: Names of several values, with their number.
        self.many = {name: count for name, count in counts.items() if count > 1}
        self.selectors = frozenset(s.mux.selector for s in self.slots if s.mux is not None)
        if not overlapping:
            self._check_overlap()
        always = reduce(or_, (slot.mask for slot in self.slots if slot.mux is None), 0)
        self.has_reserved = always != (1 << 8 * size) - 1

    def _add(self, field: Construct) -> None:
        name = field.name
        if not name:
            raise SpecError(f"{self.place}: every field of a bit layout needs a name")
        if name in self._known:
            raise SpecError(
                f"{self.place.of_field(name)}: field {name!r} is declared twice or taken (bits left out are 'reserved')"
            )
        self._known.add(name)
        self.names.append(name)
        body = field.subcon if isinstance(field, Renamed) else field
        mux = body if isinstance(body, Multiplexed) else None
        if isinstance(body, Present):
            raise SpecError(
                f"{caller()}: {name!r}: Present moves the fields behind it; in a BitLayout these stay"
            )
        for part in body.subcons if isinstance(body, Tuple) else [mux.body if mux is not None else body]:
            inner = innermost(part)
            if not isinstance(inner, Bits):
                raise SpecError(f"{self.place.of_field(name)}: field {name!r} is not made of bits(…)")
            self.slots.append(
                LayoutSlot(name, part, inner, self._positions(inner, name), mux, field.docs or "")
            )

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

    def _conditions(
        self, slot: LayoutSlot, muxes: Mapping[str, Multiplexed | None]
    ) -> dict[str, frozenset[int]]:
        """Return the selector values under which a field is present: of its own selector, of that one's own,
        and so on.
        """
        found: dict[str, frozenset[int]] = {}
        mux = slot.mux
        while mux is not None and mux.selector not in found:
            found[mux.selector] = mux.when
            mux = muxes.get(mux.selector)
        return found

    def _check_overlap(self) -> None:
        muxes = {slot.name: slot.mux for slot in self.slots}
        conditions = [self._conditions(slot, muxes) for slot in self.slots]
        for index, slot in enumerate(self.slots):
            for before, other in enumerate(self.slots[:index]):
                shared = slot.mask & other.mask
                if not shared:
                    continue
                mine, theirs = conditions[index], conditions[before]
                if any(name in mine and not mine[name] & values for name, values in theirs.items()):
                    continue
                bit = (shared & -shared).bit_length() - 1
                raise SpecError(
                    f"{self.place.of_field(slot.name)}: field {slot.name!r} overlaps {other.name!r}"
                    f" ({self.place.of_field(other.name)}) at byte {bit // 8} bit {bit % 8}"
                    "; if that is meant: overlapping=True"
                )

    def _parse(self, stream: BinaryIO, context: Container, path: str) -> Container:
        word = int.from_bytes(stream_read(stream, self.size, path), "little")
        values = Container()
        inner = Container(
            _=context, _params=context._params, _root=None, _parsing=True, _building=False, _sizing=False
        )
        rest = (1 << 8 * self.size) - 1
        raws: dict[str, int | None] = {}
        for slot in self.slots:
            if not slot.is_present(raws):
                values[slot.name] = inner[slot.name] = raws[slot.name] = None
                continue
            number = slot.read(word)
            rest &= ~slot.mask
            if slot.name in self.selectors:
                raws[slot.name] = slot.inner.raw_of(number)
            size = (len(slot.positions) + 7) // 8
            value = slot.field._parsereport(
                io.BytesIO(number.to_bytes(size, "big")), inner, f"{path} -> {slot.name}"
            )
            if slot.name in self.many:
                value = ListContainer([*values.get(slot.name, ()), value])
            values[slot.name] = inner[slot.name] = value
        if self.has_reserved:
            values["reserved"] = word & rest
        if self.trailing:
            values[self.trailing] = stream.read()
        return values

    def _build(self, obj: Any, stream: BinaryIO, context: Container, path: str) -> Any:
        word = 0
        claimed = 0
        inner = Container(
            _=context, _params=context._params, _root=None, _parsing=False, _building=True, _sizing=False
        )
        inner.update(obj)
        used: dict[str, int] = {}
        raws: dict[str, int | None] = {}
        for slot in self.slots:
            where = f"{path} -> {slot.name}"
            if slot.mux is not None and not slot.is_present(raws):
                if obj.get(slot.name) is not None:
                    raise FieldError(
                        f"{where}: only there while {slot.mux.selector} is {number_runs(slot.mux.when)}"
                    )
                continue
            many = self.many.get(slot.name, 1)
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
            if slot.name in self.selectors:
                raws[slot.name] = slot.inner.raw_of(number)
            mine = slot.write(number)
            if (word ^ mine) & slot.mask & claimed:
                raise FieldError(
                    f"{where}: {value!r} contradicts {self._sharing(slot)}, which has some of the same bits"
                )
            word |= mine
            claimed |= slot.mask
        if self.has_reserved:
            reserved = obj.get("reserved") or 0
            if reserved & claimed or not 0 <= reserved < 1 << 8 * self.size:
                raise FieldError(f"{path} -> reserved: {reserved:#x} touches bits of other fields")
            word |= reserved
        stream.write(word.to_bytes(self.size, "little"))
        if self.trailing:
            more = obj.get(self.trailing) or b""
            if not isinstance(more, (bytes, bytearray)):
                raise FieldError(f"{path} -> {self.trailing}: {more!r} is not bytes")
            stream.write(bytes(more))
        return obj

    def _sharing(self, slot: LayoutSlot) -> str:
        """Return the names of the fields before this one that have bits of it."""
        names = [s.name for s in self.slots[: self.slots.index(slot)] if s.mask & slot.mask]
        return " or ".join(dict.fromkeys(names))

    def _sizeof(self, context: Container, path: str) -> int:
        return self.size
