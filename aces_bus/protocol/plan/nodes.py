"""The plan: a message with every decision taken, from which everything else is printed.

1. A plan is frozen data: no construct, no expression, no callable in it.
2. Positions are canonical bit numbers (8 × byte + bit, bit 0 least significant) from the first byte of the data (CAN) or
   of the packet (streams), lowest bit of the number first. Byte order exists only in that list.
3. What does not flatten is marked `Opaque` with the reason; construct decodes it, slower and equally.
4. Code that needs the values of a message asks `plan.leaves` (or `walk`), and what is known of a value its node: a new kind
   of node is a subclass of `Node` here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, Literal

import msgspec

from ..declare.bits import runs_of, whole_bits
from ..record import EACH, FirstOf, Held
from .paths import ItemPath as ItemPath
from .paths import NodePath as NodePath
from .paths import walk as walk
from .steps import FlagBits as FlagBits
from .steps import Magnitude as Magnitude
from .steps import Scale as Scale
from .steps import Step as Step
from .steps import ValueNames as ValueNames

#: `struct` formats of numbers by kind and size.
FORMATS: dict[tuple[str, int | None], str] = {
    **{("uint", size): mark for size, mark in zip((1, 2, 4, 8), "BHIQ", strict=True)},
    **{("int", size): mark for size, mark in zip((1, 2, 4, 8), "bhiq", strict=True)},
    **{("float", size): mark for size, mark in zip((2, 4, 8), "efd", strict=True)},
}


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
        """The least and the greatest raw integer; None for what is no integer of the message."""
        return None

    @property
    def scale(self) -> Scale | None:
        """Step that turns the raw number into a quantity."""
        return next((step for step in self.steps if isinstance(step, Scale)), None)

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
    def is_whole(self) -> bool:
        """True if an integer is whole bytes in one byte order."""
        assert self.size is not None
        return self.bits == whole_bits(self.offset, self.size, self.order)

    @property
    def format(self) -> str:
        """The `struct` format of a whole number of usual size, else empty."""
        is_whole = self.size is not None and (not self.bits if self.kind == "float" else self.is_whole)
        return FORMATS.get((self.kind, self.size), "") if is_whole else ""

    @property
    def runs(self) -> list[tuple[int, int, int]]:
        """Its runs of bits that go upward: (lowest bit, place of that bit in the number, width)."""
        return runs_of(self.bits)

    @property
    def is_bytes(self) -> bool:
        """True if the value is bytes or a text, not a number."""
        return self.kind in ("bytes", "text")

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


class FromIdentifier(Node, msgspec.Struct, frozen=True):
    """A captured part of the CAN identifier, or of a head number.

    Alone in it: (number − constant) >> shift; beside others: `width` bits from `shift`. For an identifier `constant`
    includes the flag bits of `aces_bus.protocol.keys`, so that it is taken off a key directly.
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


class FromRequest(Node, msgspec.Struct, frozen=True):
    """A field of the request that this message answers, as raw number."""

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

    @property
    def is_quiet(self) -> bool:
        return True


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

    @property
    def known_names(self) -> list[str] | None:
        return None


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

    def inside(self, leaf: NodePath) -> Iterator[NodePath]:
        """Yield the values of the first good item of each kind."""
        for kind in self.kinds:
            for one in kind.plan.leaves:
                path = ".".join([leaf.path, kind.name, *map(str, one.way[1:])])
                doc = one.doc or leaf.doc
                way = (*leaf.way, FirstOf(kind.name, kind.number), *one.way)
                yield ItemPath(
                    path, way, one.node, leaf.field, doc, leaf.whens, leaf.conditions, kind, one.path
                )


class Repeated(ListNode, msgspec.Struct, frozen=True):
    """One group after the other from byte `offset` on, each of `width` bytes: as many as `count` says, or up to the end.
    `plan` is that of one group, as an `ItemKind`'s."""

    offset: int
    width: int
    plan: MessagePlan
    count: Scalar | None = None

    def inside(self, leaf: NodePath) -> Iterator[NodePath]:
        """Return for each value of a group the list of all groups' values."""
        for one in self.plan.leaves:
            if len(one.way) == 1:
                continue  # a group of one number is the list itself
            path = ".".join([leaf.path, *map(str, one.way[1:])])
            way = (*leaf.way, EACH, *one.way[1:])
            yield ItemPath(
                path, way, Each(one.node), leaf.field, one.doc, leaf.whens, leaf.conditions, None, one.path
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


class MoreCells(Node, msgspec.Struct, frozen=True):
    """The cells beyond the declared ones, as texts."""

    start: int

    @property
    def known_names(self) -> list[str] | None:
        return None


class Opaque(Node, msgspec.Struct, frozen=True):
    """Decoded by construct, for this reason."""

    reason: str

    @property
    def known_names(self) -> list[str] | None:
        return None


class NamedValue(Node, msgspec.Struct, frozen=True):
    """A number that construct decodes, of a known unit; `steps` at most its names."""

    unit: str = ""
    steps: tuple[Step, ...] = ()
    is_float: bool = False


class OpaqueItems(Opaque, frozen=True):
    """Items that construct decodes, whose data hold these values by name: (name, number, what it is) of each."""

    values: tuple[tuple[str, int, NamedValue], ...]

    def inside(self, leaf: NodePath) -> Iterator[NodePath]:
        """Yield the first value of each name."""
        for name, number, node in self.values:
            plan = MessagePlan(name, (PlanField("data", node),), (), (), None, 0)
            kind = ItemKind(name, number, plan, None)
            way = (*leaf.way, Held(name))
            yield ItemPath(
                f"{leaf.path}.{name}", way, node, leaf.field, "", leaf.whens, leaf.conditions, kind, "data"
            )


class DescribedItems(Opaque, frozen=True):
    """Tagged items that construct decodes, because the data of some kind hold lists themselves. `items` is what is known of
    them: the kinds whose data have a flat form, lists among these."""

    items: TaggedItems

    def inside(self, leaf: NodePath) -> Iterator[NodePath]:
        """Yield what is in the first good item of each kind; of lists in its data every value."""
        for kind in self.items.kinds:
            for one in kind.plan.columns:
                path = f"{leaf.path}.{kind.name}{one.path.removeprefix('data')}"
                way = (*leaf.way, FirstOf(kind.name, kind.number), *one.way)
                doc = one.doc or leaf.doc
                yield ItemPath(
                    path, way, one.node, leaf.field, doc, leaf.whens, leaf.conditions, kind, one.path
                )


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
    doc: str = ""
    place: str = ""

    @property
    def is_flat(self) -> bool:
        return not self.opaque

    def walk(self) -> Iterator[NodePath]:
        """Return every node of the message, the outer before the inner."""
        return walk(self.fields)

    @cached_property
    def leaves(self) -> tuple[NodePath, ...]:
        """The single values of a record, in order; a list of items is one."""
        return tuple(one for one in self.walk() if one.node.is_leaf)

    @cached_property
    def columns(self) -> tuple[NodePath, ...]:
        """Columns of tables: the single values, and behind each list of items its inner values."""
        found: list[NodePath] = []
        for leaf in self.leaves:
            found.append(leaf)
            found += leaf.node.inside(leaf)
        return tuple(found)

    @cached_property
    def lists(self) -> tuple[tuple[NodePath, ListNode], ...]:
        """The lists of items."""
        return tuple((leaf, leaf.node) for leaf in self.leaves if isinstance(leaf.node, ListNode))
