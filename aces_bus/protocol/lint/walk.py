"""The fields of a protocol as the spec wrote them: name, adapters, and the number on the wire below them.

1. A construct that several messages share is one field: it is remarked upon once.
2. What is no number of fixed size (texts, bytes, opaque constructs) has no limits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import construct as c

from ..declare.bits import BitLayout, Bits
from ..declare.delimited import Delimited
from ..declare.fields import Field, Multiplexed, SignMagnitude
from ..declare.message import Message
from ..declare.place import SourceLine
from ..declare.protocol import Protocol


@dataclass(frozen=True, eq=False)
class Written:
    """A field: its adapters from the outside in, and its innermost construct."""

    owner: str
    name: str
    adapters: tuple[Any, ...]
    inner: Any
    #: Where its message is declared.
    base: SourceLine

    @property
    def place(self) -> SourceLine:
        """The line of our own construct, else that of its name in the message; of a database the message's."""
        if not self.base.file.endswith(".py"):
            return self.base
        if self.adapters:
            place: SourceLine = self.adapters[0].place
            return place
        return self.base.of_field(self.name.rpartition(".")[2]) if self.name else self.base

    @property
    def label(self) -> str:
        return f"{self.owner}.{self.name}" if self.name else self.owner

    @property
    def limits(self) -> tuple[int, int] | None:
        """The least and the greatest raw number."""
        for adapter in self.adapters:
            if isinstance(adapter, SignMagnitude):
                return -adapter.limit, adapter.limit
        inner = self.inner
        if isinstance(inner, Bits):
            return None if inner.is_float else _span(inner.width, inner.signed)
        if isinstance(inner, c.FormatField) and inner.fmtstr[-1:] in "BbHhLlQqIi":
            return _span(8 * inner.length, inner.fmtstr[-1:].islower())
        if isinstance(inner, c.BytesInteger) and isinstance(inner.length, int):
            return _span(8 * inner.length, bool(inner.signed))
        return None

    @property
    def byte_order(self) -> str | None:
        """ "little" or "big" of a number of several bytes."""
        inner = self.inner
        if isinstance(inner, c.FormatField) and inner.length > 1 and inner.fmtstr[:1] in "<>":
            return "little" if inner.fmtstr.startswith("<") else "big"
        if isinstance(inner, c.BytesInteger) and inner.length != 1 and isinstance(inner.swapped, bool):
            return "little" if inner.swapped else "big"
        return None


def _span(width: int, signed: bool) -> tuple[int, int]:
    return (-(1 << width - 1), (1 << width - 1) - 1) if signed else (0, (1 << width) - 1)


def declared_fields(protocol: Protocol) -> Iterator[Written]:
    """Every field that some message or register of the protocol has, each construct once."""
    seen: set[int] = set()
    for message in protocol.declared:
        for item in [*_heads(message), *_payload(message)]:
            key = id(item.adapters[0]) if item.adapters else id(item.inner)
            # construct's own numbers (Byte, Int16ul) are shared by everybody: they are told apart by name.
            if item.adapters and key in seen:
                continue
            seen.add(key)
            yield item
    registers = protocol.register_map
    for register in registers.values() if registers is not None else ():
        yield from _walk(register.field, "register", register.name, register.place)


def _heads(message: Message) -> Iterator[Written]:
    for head in message.heads_written:
        if head.name is not None:
            yield from _walk(head.field, message.name, head.name, message.place)


def _payload(message: Message) -> Iterator[Written]:
    yield from _walk(message.payload, message.name, "", message.place)


def _walk(con: Any, owner: str, name: str, place: SourceLine) -> Iterator[Written]:
    if isinstance(con, c.Renamed):
        inner = f"{name}.{con.name}" if name and con.name else con.name or name
        yield from _walk(con.subcon, owner, inner, place)
    elif isinstance(con, BitLayout):
        for slot in con.slots:
            yield from _walk(slot.field, owner, f"{name}.{slot.name}" if name else slot.name, place)
    elif isinstance(con, Delimited):
        for one in con.fields:
            yield from _walk(one, owner, name, place)
    elif isinstance(con, Multiplexed):
        yield from _walk(con.body, owner, name, place)
    elif isinstance(con, c.IfThenElse):
        for case in (con.thensubcon, con.elsesubcon):
            yield from _walk(case, owner, name, place)
    elif isinstance(con, c.Switch):
        for case in [*con.cases.values(), con.default]:
            yield from _walk(case, owner, name, place)
    elif hasattr(con, "subcons"):
        for item in con.subcons:
            yield from _walk(item, owner, name, place)
    else:
        adapters: list[Any] = []
        while hasattr(con, "subcon") and not isinstance(con, (c.Array, c.GreedyRange)):
            if isinstance(con, Field):
                adapters.append(con)
            con = con.subcon
        if isinstance(con, (c.Array, c.GreedyRange)):
            yield from _walk(con.subcon, owner, name, place)
            return
        yield Written(owner, name, tuple(adapters), con, place)


__all__ = ["Written", "declared_fields"]
