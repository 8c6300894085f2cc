"""The plans of the record types that scanners of some protocols give, and what is made once for each type.

1. A database has thousands of messages, of which a recording has a few: a plan is made when it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from .declare.protocol import Variant
from .generate.load import records_of
from .plan import nodes as p
from .record import Record, message_of

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

    def only(self, names: Collection[str]) -> Plans:
        """Return the plans of these messages; of all where none is named."""
        if not names:
            return self
        some = Plans(())
        some._records = [
            {name: records[name] for name in names if name in records} for records in self._records
        ]
        return some

    def named(self, name: str) -> list[type[Record]]:
        """Return the record types of a message's name, one of each protocol that has it."""
        return [records[name] for records in self._records if name in records]


def plans_of(variants: Sequence[Variant]) -> Plans:
    """Return the plan of each record type that scanners of these variants give."""
    return Plans(variants)


class OfKind(dict[type[Any], T]):
    """What belongs to a record type, made by `make` when the first of its records comes."""

    def __init__(self, make: Callable[[Any], T]) -> None:
        super().__init__()
        self._make = make

    def __missing__(self, kind: type[Any]) -> T:
        made = self[kind] = self._make(kind)
        return made
