"""Record types by message, for `isinstance` and `match`, whatever the dialect and configuration.

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

from __future__ import annotations

from abc import ABCMeta
from collections.abc import Callable
from functools import cache
from typing import Any, NoReturn

from .declare.protocol import Protocol
from .record import Record


def record_types(protocol: Protocol) -> Callable[[str], type[Record]]:
    """A function from the name of a message to the type of its records; it raises `AttributeError` for other names."""

    def of(name: str) -> type[Record]:
        return _abstract(protocol, name)

    return of


@cache
def _abstract(protocol: Protocol, name: str) -> type[Record]:
    declared = [message for message in protocol.declared if message.name == name]
    if not declared:
        known = ", ".join(dict.fromkeys(message.name for message in protocol.declared))
        raise AttributeError(f"{protocol.name} has no message {name!r} (there are: {known})")

    def belongs(cls: type, kind: type) -> bool:
        return issubclass(kind, Record) and kind.__name__ == name and kind._protocol == protocol.name

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
