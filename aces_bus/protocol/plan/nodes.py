"""The plan: a message with every decision taken, from which everything else is printed.

1. A plan is frozen data: no construct, no expression, no callable in it.
2. Positions are canonical bit numbers (8 × byte + bit, bit 0 least significant) from the first byte of the data (CAN) or
   of the packet (streams), lowest bit of the number first. Byte order exists only in that list.
3. What does not flatten is marked `Opaque` with the reason; construct decodes it, slower and equally.
4. Code that needs the values of a message asks `plan.leaves` (or `walk`), and what is known of a value its node, never the
   node's class: a new kind of node is a subclass of `Node` here, and readers that print or convert values follow their
   shape (`ShapeReader`). Only what makes code or pictures from positions knows classes; a test counts those files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Literal, Protocol, TypeVar

import msgspec
from msgspec.structs import replace

from ..declare.bits import runs_of, whole_bits
from ..record import EACH, FirstOf, Held, WayStep
from .steps import FlagBits as FlagBits
from .steps import Magnitude as Magnitude
from .steps import Scale as Scale
from .steps import ScaleByBit as ScaleByBit
from .steps import Step as Step
from .steps import ValueNames as ValueNames

#: `struct` formats of numbers by kind and size.
FORMATS: dict[tuple[str, int | None], str] = {
    **{("uint", size): mark for size, mark in zip((1, 2, 4, 8), "BHIQ", strict=True)},
    **{("int", size): mark for size, mark in zip((1, 2, 4, 8), "bhiq", strict=True)},
    **{("float", size): mark for size, mark in zip((2, 4, 8), "efd", strict=True)},
}

#: What the values of a field are: numbers, bytes, any text, whole numbers, whole numbers of any size, values of any shape.
Holds = Literal["number", "bytes", "text", "integer", "wide", "json"]

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

#: Widths of the numbers that columns have, in bits.
_WIDTHS = (8, 16, 32, 64)


class ShapeReader(Protocol[T_co]):
    """What a reader makes of values, by their shape; see `Node.shaped`. It asks inner nodes itself."""

    def single(self, node: Node) -> T_co:
        """Return what is made of a single value."""
        ...

    def several(self, node: Node, items: Sequence[Node]) -> T_co:
        """Return what is made of a tuple with a node for each place."""
        ...

    def record(self, node: Node, type_name: str, fields: Sequence[PlanField]) -> T_co:
        """Return what is made of a nested record."""
        ...

    def each(self, node: Node, item: Node) -> T_co:
        """Return what is made of a tuple of any length, whose items are all alike."""
        ...

    def tagged(self, node: Node, type_name: str, kinds: Sequence[ItemKind]) -> T_co:
        """Return what is made of a tuple of items `kind`, `data` and `reason`; an empty name: construct makes them."""
        ...


class Node:
    """What the value of a field is, and where it comes from.

    `steps` lead from the wire to the record. What a kind of node does not have is empty or None.
    """

    __slots__ = ()
    unit: str = ""
    steps: tuple[Step, ...] = ()

    @property
    def children(self) -> Sequence[tuple[str | int, PlanField]]:
        """The nodes inside, each with the step to its value in the record; empty for a single value."""
        return ()

    @property
    def is_leaf(self) -> bool:
        """True if the node is a single value."""
        return True

    @property
    def is_quiet(self) -> bool:
        """True if zero or nothing need not be shown: bits without a field, bytes up to the end of the packet."""
        return False

    @property
    def place(self) -> tuple[int, ...]:
        """Canonical bit numbers, lowest bit of the number first; empty where it has no fixed place of its own."""
        return ()

    @property
    def raw_range(self) -> tuple[int, int] | None:
        """The least and the greatest raw integer; None for what is not an integer of the message."""
        return None

    @property
    def scales(self) -> list[Scale]:
        """Steps that turn the raw number into a quantity, from the wire outward."""
        return [step for step in self.steps if isinstance(step, Scale)]

    @property
    def scale(self) -> Scale | None:
        """Step that turns the raw number into a quantity, the first of `scales`."""
        return next(iter(self.scales), None)

    @property
    def by_bit(self) -> ScaleByBit | None:
        """Two scales, of which the highest bit chooses."""
        return next((step for step in self.steps if isinstance(step, ScaleByBit)), None)

    @property
    def value_names(self) -> dict[Any, str]:
        """The names of raw values."""
        found: dict[Any, str] = {}
        for step in self.steps:
            if isinstance(step, ValueNames):
                found.update(step.values)
            elif isinstance(step, Scale):
                found.update(step.names)
        return found

    def inside(self, leaf: NodePath) -> Iterator[NodePath]:
        """Return what columns have behind a list: the single values of its items; `leaf` is the list itself."""
        return iter(())

    @property
    def flags(self) -> dict[str, int]:
        """The bit number of each flag, by name."""
        return {name: bit for step in self.steps if isinstance(step, FlagBits) for name, bit in step.bits}

    @property
    def flag_names(self) -> dict[int, str]:
        """The names of single bits, rising."""
        return dict(sorted((bit, name) for name, bit in self.flags.items()))

    @property
    def known_names(self) -> list[str] | None:
        """The names that a value may have, flags too; None where it may be any text or bytes."""
        return [*self.value_names.values(), *self.flags]

    @property
    def numbers(self) -> dict[str, float]:
        """The number of each name: raw, or in the unit where there is a scale."""
        found: dict[str, float] = {}
        for step in self.steps:
            if isinstance(step, ValueNames):
                found.update((name, raw) for raw, name in step.values)
            elif isinstance(step, Scale):
                found.update((name, step.physical(raw)) for raw, name in step.names)
        return found

    @property
    def is_magnitude(self) -> bool:
        """True if the number has sign and magnitude."""
        return any(isinstance(step, Magnitude) for step in self.steps)

    # What readers ask: the values in records and columns.

    #: What the values are where a column has to hold Python objects.
    holds: Holds = "json"
    #: Whether it is a number whose bits the plan knows, with whatever names and flags.
    is_number: bool = False
    is_float: bool = False
    #: Whether it is a part of the identifier or of a head number.
    is_captured: bool = False
    #: Whether it is a field of the request.
    is_of_request: bool = False
    #: Whether it is the bits that no field claims.
    is_unclaimed: bool = False
    #: Whether construct decodes it; then `reason` says why, if it is known.
    is_by_construct: bool = False
    is_opaque: bool = False
    #: What an opaque field is all the same, without its place.
    known: Node | None = None
    reason: str = ""
    #: Whether it is whole bytes in one byte order.
    is_whole: bool = False
    #: Whether its values have fields.
    is_record: bool = False
    #: Whether a value is a tuple of any length, in which all items are alike.
    repeats: bool = False
    #: Whether a value may be None although the field is there.
    may_be_none: bool = False
    #: Whether the values may be numbers, or lists of them.
    has_numbers: bool = True
    #: Whether records hold it as JSON has it: a number or a text.
    is_plain: bool = False
    #: Whether sending rounds a number that was read.
    is_rounded: bool = False
    #: Units of values inside what construct decodes: of items by name, of others by path.
    inner_units: Mapping[str, str] = {}
    part_units: Mapping[str, str] = {}

    def shaped(self, reader: ShapeReader[T]) -> T:
        """Return what a reader makes of the values, by their shape."""
        return reader.single(self)

    def python_type(self, *, raw: bool = False, named: str = "str") -> str:
        """Return the type of a single value as an annotation; `named` is that of the names that a value may have."""
        return "Any"

    def number_format(self, *, raw: bool = False) -> str:
        """Return the narrowest number that holds all that a column shows, such as "u2" or "f8"; empty for objects."""
        if self.raw_range is None:
            return ""
        low, high = self.raw_range
        for step in self.steps if not raw else ():
            if isinstance(step, ScaleByBit):
                return "f8"
            if isinstance(step, Scale):
                if (isinstance(step.scale, float) and step.scale != 1.0) or (
                    isinstance(step.offset, float) and step.offset
                ):
                    return "f8"
                low, high = sorted(
                    (int(low * step.scale + step.offset), int(high * step.scale + step.offset))
                )
        for width in _WIDTHS:
            if low >= 0 and high < 1 << width:
                return f"u{width // 8}"
            if low >= -(1 << width - 1) and high < 1 << width - 1:
                return f"i{width // 8}"
        return ""

    @property
    def names_by_number(self) -> dict[float, str]:
        """The names that columns of numbers stand for, by the number."""
        return {number: name for name, number in self.numbers.items()}

    @property
    def enumerated(self) -> list[int]:
        """The raw numbers that an enumeration names."""
        return [raw for step in self.steps if isinstance(step, ValueNames) for raw, _ in step.values]

    @property
    def has_flags(self) -> bool:
        """True if its bits are flags, with or without names."""
        return any(isinstance(step, FlagBits) for step in self.steps)

    @property
    def digits(self) -> int | None:
        """The significant digits that a float of the wire has; None for other numbers."""
        return None

    @property
    def number_place(self) -> tuple[int, ...]:
        """The bits of the whole number that it is, or is a part of."""
        return self.place

    @property
    def value_bits(self) -> tuple[int, ...]:
        """The canonical bit numbers of the bits of a raw value, the lowest first."""
        return self.place

    @property
    def alone(self) -> Node:
        """The node of a single value, where this is that of the same value in every group."""
        return self

    @property
    def open_from(self) -> int | None:
        """The first byte of what goes on to the end of the packet; None where the end is known."""
        return None

    def leads_inside(self, steps: int) -> bool:
        """Return whether so many steps of a path may lead on inside a value."""
        return False

    @property
    def records(self) -> Sequence[NestedRecord]:
        """The records that items of a list consist of, innermost first."""
        return ()

    @property
    def how(self) -> str:
        """Words for the way in which generated code reads it."""
        return ""


class Scalar(Node, msgspec.Struct, frozen=True):
    """One value in the bytes.

    `kind` is "uint", "int" (two's complement), "float", "bytes" or "text". `size` is in bytes, None for "to the end".
    `bits` is empty for everything but integers, and floats that are not whole bytes in one order: then the number has
    `len(bits)` bits, and `offset` and `size` are those of its layout. `steps` go from the wire to the record.
    A text of fixed size stops at the first of its `ends`.
    """

    kind: Literal["uint", "int", "float", "bytes", "text"]
    offset: int
    size: int | None
    order: Literal["little", "big"] = "little"
    bits: tuple[int, ...] = ()
    steps: tuple[Step, ...] = ()
    unit: str = ""
    ends: str = ""

    @property
    def is_whole(self) -> bool:  # type: ignore[override]
        return self.size is not None and self.place == whole_bits(self.offset, self.size, self.order)

    @property
    def format(self) -> str:
        """The `struct` format of a whole number of usual size, else empty."""
        return FORMATS.get((self.kind, self.size), "") if self.is_whole else ""

    @property
    def runs(self) -> list[tuple[int, int, int]]:
        """Its runs of bits that go upward: (lowest bit, place of that bit in the number, width)."""
        return runs_of(self.bits)

    @property
    def is_bytes(self) -> bool:
        """True if the value is bytes or a text, not a number."""
        return self.kind in ("bytes", "text")

    @property
    def holds(self) -> Holds:  # type: ignore[override]
        return "bytes" if self.kind == "bytes" else "text" if self.kind == "text" else "wide"

    @property
    def is_number(self) -> bool:  # type: ignore[override]
        return not self.is_bytes

    @property
    def is_float(self) -> bool:  # type: ignore[override]
        return self.kind == "float"

    @property
    def has_numbers(self) -> bool:  # type: ignore[override]
        return not self.is_bytes

    @property
    def is_plain(self) -> bool:  # type: ignore[override]
        return self.kind != "bytes" and not self.flags

    @property
    def is_rounded(self) -> bool:  # type: ignore[override]
        if len(self.bits) <= 52 and self.kind != "float":
            return False
        return self.scale is not None and (self.scale.scale, self.scale.offset) != (1, 0)

    @property
    def digits(self) -> int | None:
        return {2: 4, 4: 7}.get(self.size or 0, 15) if self.kind == "float" else None

    def python_type(self, *, raw: bool = False, named: str = "str") -> str:
        wire = {"float": "float", "bytes": "bytes", "text": "bytes" if raw else "str"}.get(self.kind, "int")
        return wire if raw else _after(self.steps, wire, named)

    def number_format(self, *, raw: bool = False) -> str:
        if self.kind == "float":
            return "f8"
        return "" if len(self.bits) > 64 else super().number_format(raw=raw)

    @property
    def open_from(self) -> int | None:
        return self.offset if self.size is None else None

    @property
    def how(self) -> str:
        if self.is_bytes:
            return "a slice"
        return "unpacked by struct" if self.is_whole else "shifted out of its bytes"

    @property
    def known_names(self) -> list[str] | None:
        return None if self.is_bytes else super().known_names

    @property
    def is_quiet(self) -> bool:
        return self.size is None

    @property
    def place(self) -> tuple[int, ...]:
        return self.bits or (() if self.size is None else whole_bits(self.offset, self.size, self.order))

    @property
    def raw_range(self) -> tuple[int, int] | None:
        if self.kind not in ("uint", "int"):
            return None
        width = len(self.place)
        for step in self.steps:
            if isinstance(step, Magnitude):
                return -(1 << step.width - 1) + 1, (1 << step.width - 1) - 1
        return (-(1 << width - 1), (1 << width - 1) - 1) if self.kind == "int" else (0, (1 << width) - 1)


def _after(steps: Sequence[Step], wire: str, named: str) -> str:
    """Return the type of a number after its steps."""
    for step in steps:
        if isinstance(step, Scale):
            if step.scale != 1 or step.offset:
                whole = isinstance(step.scale, int) and isinstance(step.offset, int)
                wire = wire if whole else "float"
            if step.names:
                wire += f" | {named}"
            if step.unknown:
                wire += " | None"
        elif isinstance(step, ValueNames):
            wire = f"{named} | int"
        elif isinstance(step, FlagBits):
            wire = "FlagSet"
        elif isinstance(step, ScaleByBit):
            wire = "float"
    return wire


class Many(Node, msgspec.Struct, frozen=True):
    """Several nodes under one name: a tuple. Its unit is what all items have."""

    items: tuple[Node, ...]

    @property
    def unit(self) -> str:  # type: ignore[override]
        units = {item.unit for item in self.items}
        return units.pop() if len(units) == 1 else ""

    @property
    def children(self) -> Sequence[tuple[str | int, PlanField]]:
        return [(index, PlanField(str(index), item)) for index, item in enumerate(self.items)]

    @property
    def is_leaf(self) -> bool:
        return False

    def shaped(self, reader: ShapeReader[T]) -> T:
        return reader.several(self, self.items)


class NestedRecord(Node, msgspec.Struct, frozen=True):
    """A nested record."""

    type_name: str
    fields: tuple[PlanField, ...]

    @property
    def children(self) -> Sequence[tuple[str | int, PlanField]]:
        return [(field.name, field) for field in self.fields]

    @property
    def is_leaf(self) -> bool:
        return False

    is_record = True

    def shaped(self, reader: ShapeReader[T]) -> T:
        return reader.record(self, self.type_name, self.fields)


class FromIdentifier(Node, msgspec.Struct, frozen=True):
    """A captured part of the CAN identifier, or of a head number.

    Alone in it: (number − constant) >> shift; beside others: `width` bits from `shift`. For an identifier `constant`
    includes the flag bits of `aces_bus.frames`, so that it is taken off a key directly.
    """

    constant: int
    shift: int
    width: int
    is_alone: bool
    steps: tuple[Step, ...] = ()
    unit: str = ""
    #: The number it is part of: None for the identifier.
    number: Scalar | None = None

    @property
    def place(self) -> tuple[int, ...]:
        """The bits of a part of a head number; of the whole number where the part is added to it."""
        bits = self.number.place if self.number is not None else ()
        return bits if self.is_alone else bits[self.shift : self.shift + self.width]

    @property
    def raw_range(self) -> tuple[int, int] | None:
        return 0, (1 << self.width) - 1

    is_number = is_captured = is_plain = True

    @property
    def number_place(self) -> tuple[int, ...]:
        return self.number.place if self.number is not None else ()

    def python_type(self, *, raw: bool = False, named: str = "str") -> str:
        return "int" if raw else _after(self.steps, "int", named)

    @property
    def how(self) -> str:
        return "a part of the identifier" if self.number is None else "a part of a head field"


class FromRequest(Node, msgspec.Struct, frozen=True):
    """A field of the request that this message answers, as raw number."""

    holds = "integer"
    is_of_request = may_be_none = True

    def python_type(self, *, raw: bool = False, named: str = "str") -> str:
        return "int | None"

    @property
    def how(self) -> str:
        return "taken from the request"

    @property
    def known_names(self) -> list[str] | None:
        return None


class Selector(msgspec.Struct, frozen=True):
    """A number that says whether other fields are there. What it is is which number of the packet, and under what
    condition that one is there itself; `name` is for people: two selectors of one name are two.
    """

    name: str
    number: Scalar
    when: When | None = None


class When(msgspec.Struct, frozen=True):
    """The raw values of a selector that make a field present, where the selector is."""

    selector: Selector
    values: tuple[int, ...]


class Rest(Node, msgspec.Struct, frozen=True):
    """The bits of `size` bytes from `offset` that no field claims; `claimed` as masks of the little-endian word by the
    selector's raw value (None: any other).

    Where selectors are several, or multiplexed themselves, `claimed` is what is always claimed, and `more` has for each
    selector the masks that its raw values add; other values, and a selector that is not there, add nothing.
    """

    offset: int
    size: int
    claimed: tuple[tuple[int | None, int], ...]
    selector: Selector | None = None
    more: tuple[tuple[Selector, tuple[tuple[int, int], ...]], ...] = ()

    holds = "wide"
    is_unclaimed = is_plain = True

    @property
    def value_bits(self) -> tuple[int, ...]:
        return tuple(range(8 * self.offset, 8 * (self.offset + self.size)))

    @property
    def is_quiet(self) -> bool:
        return True

    def python_type(self, *, raw: bool = False, named: str = "str") -> str:
        return "int"

    def number_format(self, *, raw: bool = False) -> str:
        bits = 8 * self.size
        return next((f"u{width // 8}" for width in _WIDTHS if width >= bits), "")

    @property
    def how(self) -> str:
        return "the bits that are left"


class ItemKind(msgspec.Struct, frozen=True):
    """A kind of item in a list: its name and number, and the plan of its data alone, positions from their first byte; its
    one field is called `data`. `size` is that of the data where it is fixed, in bytes."""

    name: str
    number: int
    plan: MessagePlan
    size: int | None


class ListNode(Node):
    """Values in any number up to the end of the packet, one tuple in the record."""

    __slots__ = ()
    #: The first byte of it in the packet.
    offset: int

    @property
    def known_names(self) -> list[str] | None:
        return None

    @property
    def open_from(self) -> int | None:
        return self.offset

    @property
    def plans(self) -> Sequence[MessagePlan]:
        """The plans of what the list consists of."""
        raise NotImplementedError

    @property
    def how(self) -> str:
        return "read item by item"

    def leads_inside(self, steps: int) -> bool:
        return True


class TaggedItems(ListNode, msgspec.Struct, frozen=True):
    """Items of several kinds from byte `offset` on. `tag` and `size` (None: the kinds have theirs) count from an item's
    first byte, its data begin at `head`, and its size is `counted` more than that of its data. `type_name` is that of the
    items' records: `kind`, `data` and `reason`."""

    offset: int
    tag: Scalar
    size: Scalar | None
    head: int
    counted: int
    kinds: tuple[ItemKind, ...]
    type_name: str

    @property
    def record(self) -> NestedRecord:
        """An item as records have it."""
        opaque = Opaque("decided by the item's tag")
        return NestedRecord(
            self.type_name, tuple(PlanField(name, opaque) for name in ("kind", "data", "reason"))
        )

    has_numbers = False

    @property
    def plans(self) -> Sequence[MessagePlan]:
        return [kind.plan for kind in self.kinds]

    @property
    def records(self) -> Sequence[NestedRecord]:
        return [*(record for plan in self.plans for record in nested_records(plan.fields)), self.record]

    def shaped(self, reader: ShapeReader[T]) -> T:
        return reader.tagged(self, self.type_name, self.kinds)

    def inside(self, leaf: NodePath) -> Iterator[NodePath]:
        """Yield the values of the first good item of each kind."""
        for kind in self.kinds:
            for inner in kind.plan.leaves:
                path = ".".join([leaf.path, kind.name, *map(str, inner.way[1:])])
                doc = inner.doc or leaf.doc
                way = (*leaf.way, FirstOf(kind.name, kind.number), *inner.way)
                yield NodePath(
                    path, way, inner.node, leaf.field, doc, leaf.whens, leaf.conditions, kind, inner.path
                )


class Repeated(ListNode, msgspec.Struct, frozen=True):
    """One group after the other from byte `offset` on, each of `width` bytes: as many as `count` says, or up to the end.
    `plan` is that of one group, as an `ItemKind`'s."""

    offset: int
    width: int
    plan: MessagePlan
    count: Scalar | None = None

    repeats = True

    @property
    def has_numbers(self) -> bool:  # type: ignore[override]
        group = self.plan.fields[0].node
        return group.is_number and group.has_numbers

    @property
    def plans(self) -> Sequence[MessagePlan]:
        return [self.plan]

    @property
    def records(self) -> Sequence[NestedRecord]:
        return nested_records(self.plan.fields)

    def shaped(self, reader: ShapeReader[T]) -> T:
        return reader.each(self, self.plan.fields[0].node)

    def inside(self, leaf: NodePath) -> Iterator[NodePath]:
        """Return for each value of a group the list of all groups' values."""
        for inner in self.plan.leaves:
            if len(inner.way) == 1:
                continue  # a group of one number is the list itself
            path = ".".join([leaf.path, *map(str, inner.way[1:])])
            way = (*leaf.way, EACH, *inner.way[1:])
            yield NodePath(
                path,
                way,
                Each(inner.node),
                leaf.field,
                inner.doc,
                leaf.whens,
                leaf.conditions,
                None,
                inner.path,
            )


class Each(Node, msgspec.Struct, frozen=True):
    """A value of every group of a list, in one tuple."""

    item: Node

    @property
    def unit(self) -> str:  # type: ignore[override]
        return self.item.unit

    @property
    def known_names(self) -> list[str] | None:
        return self.item.known_names

    @property
    def numbers(self) -> dict[str, float]:
        return self.item.numbers

    @property
    def value_names(self) -> dict[Any, str]:
        return self.item.value_names

    @property
    def names_by_number(self) -> dict[float, str]:
        return {}  # its lists hold the names themselves

    repeats = True

    @property
    def alone(self) -> Node:
        return self.item

    @property
    def has_numbers(self) -> bool:  # type: ignore[override]
        return self.item.has_numbers

    def shaped(self, reader: ShapeReader[T]) -> T:
        return reader.each(self, self.item)

    @property
    def how(self) -> str:
        return f"{self.item.how}, of each"


class DelimitedField(Node, msgspec.Struct, frozen=True):
    """A field of a delimited payload, by its number; `conversion` names how text becomes a value."""

    index: int
    conversion: Literal["text", "number", "integer", "degrees", "names"]
    form: str
    names: tuple[tuple[str, str], ...] = ()
    unit: str = ""
    optional: bool = False

    @property
    def value_names(self) -> dict[Any, str]:
        return dict(self.names)

    @property
    def known_names(self) -> list[str] | None:
        return None if self.conversion == "text" else super().known_names

    may_be_none = is_plain = True

    @property
    def holds(self) -> Holds:  # type: ignore[override]
        return "integer" if self.conversion == "integer" else "text"

    @property
    def has_numbers(self) -> bool:  # type: ignore[override]
        return self.conversion not in ("text", "names")

    @property
    def is_rounded(self) -> bool:  # type: ignore[override]
        return self.conversion in ("number", "degrees")

    def python_type(self, *, raw: bool = False, named: str = "str") -> str:
        if raw:
            return "str | None"
        kind = {"number": "float", "integer": "int", "degrees": "float"}.get(self.conversion, "str")
        return f"{named} | {kind} | None" if self.names and named != kind else f"{kind} | None"

    def number_format(self, *, raw: bool = False) -> str:
        return "f8" if self.conversion in ("number", "degrees") and not raw else ""

    @property
    def how(self) -> str:
        return "cut out of the text"


class MoreCells(Node, msgspec.Struct, frozen=True):
    """The cells beyond the declared ones, as texts."""

    start: int

    has_numbers = False

    @property
    def known_names(self) -> list[str] | None:
        return None

    def python_type(self, *, raw: bool = False, named: str = "str") -> str:
        return "tuple[str, ...]"

    def leads_inside(self, steps: int) -> bool:
        return steps == 1

    @property
    def how(self) -> str:
        return "cut out of the text"


class Opaque(Node, msgspec.Struct, frozen=True):
    """Decoded by construct, for this reason."""

    reason: str

    is_by_construct = is_opaque = may_be_none = True

    @property
    def known_names(self) -> list[str] | None:
        return None

    def leads_inside(self, steps: int) -> bool:
        return True

    @property
    def how(self) -> str:
        return self.reason


class OpaqueQuantity(Opaque, frozen=True):
    """A number, or numbers, that construct decodes, of a known unit; or values by name: `units` are theirs, by path."""

    unit: str
    units: tuple[tuple[str, str], ...] = ()

    @property
    def part_units(self) -> Mapping[str, str]:  # type: ignore[override]
        return dict(self.units)


class ByBits(Opaque, frozen=True):
    """A field of a message whose fields are there by bits: `known` is what it is, of no fixed place; `selector` and `bit`
    say when it is there (empty: always)."""

    known: Node  # pyright: ignore[reportIncompatibleVariableOverride]
    selector: str = ""
    bit: int = 0

    @property
    def unit(self) -> str:  # type: ignore[override]
        return self.known.unit

    @property
    def may_be_none(self) -> bool:  # type: ignore[override]
        scale = self.known.scale
        return bool(self.selector) or self.known.may_be_none or (scale is not None and bool(scale.unknown))

    @property
    def place_text(self) -> str:
        """Condition under which the field is there, in words."""
        return f"if {self.selector} bit {self.bit}" if self.selector else ""


class NamedValue(Node, msgspec.Struct, frozen=True):
    """A number that construct decodes, of a known unit; `steps` at most its names."""

    unit: str = ""
    steps: tuple[Step, ...] = ()
    is_float: bool = False

    is_by_construct = True

    def number_format(self, *, raw: bool = False) -> str:
        return "f8" if self.is_float and not raw else ""

    @property
    def names_by_number(self) -> dict[float, str]:
        return {}

    @property
    def how(self) -> str:
        return "a value of an item"


class OpaqueItems(Opaque, frozen=True):
    """Items that construct decodes, whose data hold these values by name: (name, number, what it is) of each."""

    values: tuple[tuple[str, int, NamedValue], ...]

    @property
    def inner_units(self) -> Mapping[str, str]:  # type: ignore[override]
        return {name: node.unit for name, _, node in self.values}

    def inside(self, leaf: NodePath) -> Iterator[NodePath]:
        """Yield the first value of each name."""
        for name, number, node in self.values:
            plan = MessagePlan(name, (PlanField("data", node),), (), (), None, 0)
            kind = ItemKind(name, number, plan, None)
            way = (*leaf.way, Held(name))
            yield NodePath(
                f"{leaf.path}.{name}", way, node, leaf.field, "", leaf.whens, leaf.conditions, kind, "data"
            )


class DescribedItems(Opaque, frozen=True):
    """Tagged items that construct decodes, because the data of some kind hold lists themselves. `items` is what is known of
    them: the kinds whose data have a flat form, lists among these."""

    items: TaggedItems

    def shaped(self, reader: ShapeReader[T]) -> T:
        return reader.tagged(self, "", self.items.kinds)

    def inside(self, leaf: NodePath) -> Iterator[NodePath]:
        """Yield what is in the first good item of each kind; of lists in its data every value."""
        for kind in self.items.kinds:
            for column in kind.plan.columns:
                path = f"{leaf.path}.{kind.name}{column.path.removeprefix('data')}"
                way = (*leaf.way, FirstOf(kind.name, kind.number), *column.way)
                doc = column.doc or leaf.doc
                yield NodePath(
                    path, way, column.node, leaf.field, doc, leaf.whens, leaf.conditions, kind, column.path
                )


class NodePath(msgspec.Struct, frozen=True):
    """A node and where its value is: `path` as columns and conditions name it (`servos.0.id`), `way` as the steps to the
    value in the record.

    `field` is the field of the message, `doc` that of the innermost one. `whens` are the conditions that it is there for,
    the outermost first; `conditions` the same with the paths of their selectors, and with the conditions of these.
    """

    path: str
    way: tuple[WayStep, ...]
    node: Node
    field: PlanField
    doc: str = ""
    whens: tuple[When, ...] = ()
    conditions: tuple[tuple[str, When], ...] = ()
    #: Of a value inside a list: the kind of its item, None in a group. Positions count from the item's data, or the group.
    kind: ItemKind | None = None
    #: Of a value inside a list: the path in the plan of that.
    inner: str = ""

    @property
    def is_inside(self) -> bool:
        """True if it is a value inside a list."""
        return bool(self.inner)

    @property
    def identifier(self) -> str:
        """The path as one name: `motor_0_errors`."""
        return self.path.replace(".", "_")


def walk(
    fields: Sequence[PlanField], is_whole: Callable[[Node], bool] = lambda node: False
) -> Iterator[NodePath]:
    """Yield every node below these fields, the outer before the inner; of those that are taken as a whole only
    themselves.
    """
    for field in fields:
        yield from _below(field.name, field, None, "", is_whole)


def _below(
    step: str | int,
    field: PlanField,
    outer: NodePath | None,
    prefix: str,
    is_whole: Callable[[Node], bool],
) -> Iterator[NodePath]:
    path, when = f"{prefix}{step}", field.when
    if outer is None:
        here = NodePath(path, (step,), field.node, field, field.doc)
    else:
        # What is said of a list is said of its first item.
        doc = field.doc if isinstance(step, str) else "" if step else outer.doc
        here = NodePath(path, (*outer.way, step), field.node, outer.field, doc, outer.whens, outer.conditions)
    if when is not None:
        conditions = _conditions(prefix, when, here.conditions)
        here = replace(here, whens=(*here.whens, when), conditions=conditions)
    yield here
    for inner, child in field.node.children if not is_whole(field.node) else ():
        yield from _below(inner, child, here, f"{path}.", is_whole)


def _conditions(
    prefix: str, when: When | None, known: tuple[tuple[str, When], ...]
) -> tuple[tuple[str, When], ...]:
    if when is None or any(when == condition for _, condition in known):
        return known
    return (*_conditions(prefix, when.selector.when, known), (prefix + when.selector.name, when))


def nested_records(fields: Sequence[PlanField]) -> list[NestedRecord]:
    """Return the nested records among fields and in their lists, innermost first, each once."""
    inward = sorted(walk(fields), key=lambda leaf: -len(leaf.way))
    listed = [record for leaf in inward for record in leaf.node.records]
    nested = [leaf.node for leaf in inward if isinstance(leaf.node, NestedRecord)]
    return list({node.type_name: node for node in [*listed, *nested]}.values())


class PlanField(msgspec.Struct, frozen=True):
    """A field of a record, or of the nested record that it is in. `when`: there only then."""

    name: str
    node: Node
    doc: str = ""
    when: When | None = None


class Constant(msgspec.Struct, frozen=True):
    """Bits that are always the same: (data[offset] & mask) == value."""

    offset: int
    mask: int
    value: int


class OneOf(msgspec.Struct, frozen=True):
    """A whole number that must be among some values."""

    number: Scalar
    values: tuple[int, ...] | range


class DelimitedSplit(msgspec.Struct, frozen=True):
    """How a delimited payload comes apart: bytes [start, end) of the packet, end counted from the packet's end."""

    start: int
    end: int
    separator: bytes
    lead: bool
    least: int
    most: int | None


class MessagePlan(msgspec.Struct, frozen=True, dict=True, weakref=True):
    """Everything about one message."""

    name: str
    fields: tuple[PlanField, ...]
    constants: tuple[Constant, ...]
    one_of: tuple[OneOf, ...]
    #: Lengths of the data (CAN) or the packet (streams); None: any from `least` up.
    lengths: tuple[int, ...] | None
    least: int
    #: Bytes of sync at the packet's start: the framing has seen them.
    sync: int = 0
    #: The least size that the framing lets through.
    framed: int = 0
    #: Bytes at the packet's end that are not payload (check and end of a framing).
    tail: int = 0
    #: selector → total length, where multiplexed fields make the length.
    lengths_by: tuple[Selector, tuple[tuple[int, int], ...], int] | None = None
    #: What decides about fields, an outer one before an inner one, each once.
    selectors: tuple[Selector, ...] = ()
    split: DelimitedSplit | None = None
    #: Whether the message has a check of its own, inside the payload.
    is_checked: bool = False
    opaque: str = ""
    #: Of an opaque message: (path, field names) of each nested record.
    parts: tuple[tuple[str, tuple[str, ...]], ...] = ()
    #: Of a message whose fields are there by bits: the plan of a packet that has all of them, where that is flat.
    all_fields: MessagePlan | None = None
    doc: str = ""
    place: str = ""

    @property
    def is_flat(self) -> bool:
        return not self.opaque

    @property
    def needs_request(self) -> bool:
        """True if the message shows fields of its request."""
        return any(field.node.is_of_request for field in self.fields)

    @property
    def opaque_names(self) -> list[str]:
        """The fields that construct decodes."""
        return [field.name for field in self.fields if field.node.is_opaque]

    def walk(self) -> Iterator[NodePath]:
        """Return every node of the message, the outer before the inner."""
        return walk(self.fields)

    @cached_property
    def leaves(self) -> tuple[NodePath, ...]:
        """The single values of a record, in order; a list of items is one."""
        return tuple(path for path in self.walk() if path.node.is_leaf)

    @cached_property
    def columns(self) -> tuple[NodePath, ...]:
        """Columns of tables: the single values, and behind each list of items its inner values."""
        if self.all_fields is not None:
            by_name = {field.name: field for field in self.fields}
            return tuple(replace(leaf, field=by_name[leaf.field.name]) for leaf in self.all_fields.columns)
        found: list[NodePath] = []
        for leaf in self.leaves:
            found.append(leaf)
            found += leaf.node.inside(leaf)
        return tuple(found)

    @cached_property
    def lists(self) -> tuple[tuple[NodePath, ListNode], ...]:
        """The lists of items."""
        return tuple((leaf, leaf.node) for leaf in self.leaves if isinstance(leaf.node, ListNode))
