"""What a record type holds, found once from its plan, so that writers need not look at every value.

1. Nothing here looks at a record; it only prepares how records of a type are read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec

from aces_bus.protocol import FlagSet, Record, Variant
from aces_bus.protocol.generate.load import records_of
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import getter as getter
from aces_bus.protocol.record import message_of

Convert = Callable[[Any], Any]
T = TypeVar("T")


class Plans(Mapping[type[Record], p.MessagePlan]):
    """The plan of each record type that scanners of these variants give. To ask for one costs one: a database has
    thousands, of which a recording has a few. To go through them all makes them all."""

    def __init__(self, variants: Sequence[Variant]) -> None:
        self._records = [records_of(variant) for variant in variants]

    def __getitem__(self, kind: type[Record]) -> p.MessagePlan:
        return message_of(kind).plan

    def __iter__(self) -> Iterator[type[Record]]:
        for records in self._records:
            yield from records.values()

    def __len__(self) -> int:
        return sum(map(len, self._records))

    @property
    def names(self) -> frozenset[str]:
        """The names of the messages."""
        return frozenset(name for records in self._records for name in records)

    def named(self, name: str) -> list[type[Record]]:
        """The record types of a message's name, one of each protocol that has it."""
        return [records[name] for records in self._records if name in records]


def plans_of(variants: Sequence[Variant]) -> Plans:
    """The plan of each record type that scanners of these variants give."""
    return Plans(variants)


class OfKind(dict[type[Any], T]):
    """What belongs to a record type, made by `make` when the first of its records comes."""

    def __init__(self, make: Callable[[Any], T]) -> None:
        super().__init__()
        self._make = make

    def __missing__(self, kind: type[Any]) -> T:
        made = self[kind] = self._make(kind)
        return made


# ---------------------------------------------------------------------- plain values


def flag_names(flags: Any) -> list[str]:
    """The names of the set bits; bits without a name as one hexadecimal number."""
    names = list(flags)
    return [*names, f"{flags.unknown:#x}"] if flags.unknown else names


def json_value(value: Any) -> Any:
    """Any value as what JSON has: NaN, infinities and what is unknown are null, flags a list of names, bytes hexadecimal."""
    match value:
        case None | bool():
            return value
        case float():
            return float(value) if math.isfinite(value) else None
        case FlagSet():
            return flag_names(value)
        case int():
            return int(value)
        case bytes() | bytearray() | memoryview():
            return bytes(value).hex()
        case str():
            return str(value)
        case msgspec.Struct():
            return {
                name: json_value(getattr(value, name))
                for name in value.__struct_fields__
                if not name.startswith("_")
            }
        case Mapping():
            return {str(key): json_value(item) for key, item in value.items()}
        case Iterable():
            items: Iterable[Any] = value
            return [json_value(item) for item in items]
        case _:
            from aces_bus.device import UNKNOWN

            return None if value is UNKNOWN else str(value)


def is_single_value(node: p.Node) -> bool:
    """Whether msgspec writes the values of this node as they are."""
    if isinstance(node, p.Scalar):
        return node.kind != "bytes" and not node.flags
    if not node.is_leaf:
        return all(is_single_value(field.node) for _, field in node.children)
    return isinstance(node, (p.FromIdentifier, p.Rest, p.DelimitedField, p.MoreCells))


# ---------------------------------------------------------------------- single values, by path


@dataclass(frozen=True)
class RecordLeaf:
    """One value of a record: `path` is as a condition or a column names it (`servos.0.id`), `get` reads it.

    `conditional` says that the value is None while a selector has other values.
    """

    path: str
    node: p.Node
    get: Callable[[Any], Any]
    conditional: bool = False
    #: Whether it is inside a list of items, which may be without it.
    is_inside: bool = False


def record_leaves(plan: p.MessagePlan, *, is_split: bool = True) -> list[RecordLeaf]:
    """The values of a record, nested records taken apart, and (`is_split`) lists; what has no fixed shape is one value. A
    list of items is one too, with what is inside it behind it."""
    nodes = plan.columns
    if not is_split:
        named = (one for one in plan.walk() if all(isinstance(step, str) for step in one.way))
        nodes = tuple(one for one in named if not isinstance(one.node, p.NestedRecord))
    return [
        RecordLeaf(one.path, one.node, getter(one.way), bool(one.whens), isinstance(one, p.ItemPath))
        for one in nodes
    ]
