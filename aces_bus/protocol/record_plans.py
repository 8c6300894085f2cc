"""Types of records: their messages and plans, what users name them by, and what is made once for each type.

1. A database has thousands of messages, of which a recording has a few: a plan is made when it is asked for.
"""

from __future__ import annotations

from abc import ABCMeta
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cache
from typing import Any, NoReturn, TypeVar

from .declare.message import Message
from .declare.protocol import DeclaredProtocol, Variant
from .generate.load import records_of
from .plan import nodes as p
from .record import Record, protocol_name_of

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


def message_of(kind: type[Record]) -> Message:
    """Return the message that a record type is generated from; not of `Unknown`, which has none."""
    message: Message = kind._declared  # pyright: ignore[reportPrivateUsage]  # private, as a message may have a field "declared"
    return message


def record_types(protocol: DeclaredProtocol) -> Callable[[str], type[Record]]:
    """Return a function from the name of a message to the type of its records, for `isinstance` and `match`, whatever
    the dialect and configuration; it raises `AttributeError` for other names.

    Each variant of a protocol has record types of its own: in another dialect the fields of a message may be others. What
    users name is an abstract type that all of them belong to. A module of such types, with the stub that `aces spec stubs`
    writes, is one line:

        __getattr__ = record_types(robotis)

    >>> from aces_bus.protocol import Protocol
    >>> from construct import Byte, Struct
    >>> protocol = Protocol("doc_records", link="can")
    >>> message = protocol.message("Lamp", id=0x10, payload=Struct("level" / Byte))
    >>> Lamp = record_types(protocol)("Lamp")
    >>> record, = protocol.scanner().feed([protocol.encode("Lamp", level=7)])
    >>> match record:
    ...     case Lamp(level=level):
    ...         print(level)
    7
    """

    def of(name: str) -> type[Record]:
        return _abstract(protocol, name)

    return of


@cache
def _abstract(protocol: DeclaredProtocol, name: str) -> type[Record]:
    declared = [message for message in protocol.declared if message.name == name]
    if not declared:
        known = ", ".join(dict.fromkeys(message.name for message in protocol.declared))
        raise AttributeError(f"{protocol.name} has no message {name!r} (there are: {known})")

    def belongs(cls: type, kind: type) -> bool:
        return issubclass(kind, Record) and kind.__name__ == name and protocol_name_of(kind) == protocol.name

    def refuse(cls: type, *_: Any, **__: Any) -> NoReturn:
        raise TypeError(f"records come from scanners; to make a packet: {protocol.name}.encode({name!r}, …)")

    fields = tuple(dict.fromkeys(field for message in declared for field in message.fields))
    made: Any = ABCMeta(
        name,
        (),
        {
            "__doc__": declared[0].doc,
            "__module__": f"{protocol.name} records",
            "__match_args__": fields,
            "__new__": refuse,
            "__slots__": (),
            "__subclasshook__": classmethod(belongs),
        },
    )
    return made  # type: ignore[no-any-return]  # abstract, so not a subclass as far as mypy can see
