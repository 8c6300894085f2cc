"""Numbers of a message that decide about its other fields: what a drawn packet should have in them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import construct as c
from construct import Construct

from ..protocol.declare.bits import BitLayout, Bits
from ..protocol.declare.fields import Multiplexed, Present, innermost
from ..protocol.declare.message import Message


@dataclass(frozen=True)
class Hints:
    """Values that selectors should have, and names of numbers that say how much follows."""

    values: Mapping[str, tuple[int, ...]]
    small: frozenset[str]


@lru_cache(maxsize=4096)
def hints(message: Message) -> Hints:
    """Return what a message's fields say of one another."""
    values: dict[str, set[int]] = {}
    small: set[str] = set()

    def visit(con: Construct) -> None:
        if isinstance(con, Present):
            known = values.setdefault(con.selector, {0})
            known.update({1 << con.bit, max(known) | 1 << con.bit})  # the greatest has all bits so far
        elif isinstance(con, Multiplexed):
            values.setdefault(con.selector, set()).update(con.when)
        elif isinstance(con, BitLayout):
            for slot in con.slots:
                if slot.mux is not None:
                    values.setdefault(slot.mux.selector, set()).update(slot.mux.when)
        elif isinstance(con, c.Switch):
            for name in _names_in(con.keyfunc):
                values.setdefault(name, set()).update(k for k in con.cases if isinstance(k, int))
        elif isinstance(con, c.IfThenElse):
            for name in _names_in(con.condfunc):
                values.setdefault(name, set()).update(_numbers_in(con.condfunc))
        elif isinstance(con, c.Array):
            small.update(_names_in(con.count))
        elif isinstance(con, (c.Bytes, c.BytesInteger)):
            small.update(_names_in(con.length))
        for _, inner in parts_of(con):
            visit(inner)

    visit(message.payload)
    return Hints({k: tuple(sorted(v)) for k, v in values.items() if v}, frozenset(small))


def parts_of(con: Construct) -> Iterator[tuple[str, Any]]:
    """Yield the constructs directly inside a construct, each with its name; "" for a construct without a name."""
    if isinstance(con, BitLayout):
        yield from ((slot.name, slot.field) for slot in con.slots)
        return
    inner: list[Any] = list(getattr(con, "subcons", ()))
    if isinstance(con, Multiplexed):
        inner.append(con.body)
    elif isinstance(con, c.IfThenElse):
        inner += [con.thensubcon, con.elsesubcon]
    elif isinstance(con, c.Switch):
        inner += [*con.cases.values(), con.default]
    elif hasattr(con, "subcon"):
        inner.append(con.subcon)
    name = con.name if isinstance(con, c.Renamed) else ""
    yield from ((name, part) for part in inner)


def _names_in(expression: Any) -> list[str]:
    return (
        [n for n in re.findall(r"\['(\w+)'\]", repr(expression)) if n != "_"] if callable(expression) else []
    )


def _numbers_in(expression: Any) -> list[int]:
    return [int(n) for n in re.findall(r"(?<![\w'])\d+", repr(expression))]


def is_integer(con: Construct) -> bool:
    """Return whether a construct's raw value is a whole number."""
    inner = innermost(con)
    return (isinstance(inner, (c.BytesInteger, Bits)) and not getattr(inner, "is_float", False)) or (
        isinstance(inner, c.FormatField) and inner.fmtstr[-1:] not in "efd"
    )


__all__ = ["Hints", "hints", "is_integer", "parts_of"]
