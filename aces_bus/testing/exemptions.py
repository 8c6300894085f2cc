"""Fields whose bytes do not all survive a round trip, each kind with its reason (law 1).

1. Values always survive: `parse_raw(build_raw(r)) == r` has no exception.
2. Bytes survive outside the fields listed here; inside them, what is built back reads the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import construct as c
from construct import Construct

from ..protocol.declare.bits import FLOATS, Bits
from ..protocol.declare.fields import SignMagnitude
from ..protocol.declare.message import Message
from ..protocol.declare.stuffing import CutZeros
from .hints import parts_of


@dataclass(frozen=True)
class Kind:
    """A kind of exception: which constructs it concerns, and why."""

    name: str
    reason: str
    concerns: Callable[[Any], bool]


def _has_format(mark: str) -> Callable[[Any], bool]:
    def concerns(con: Construct) -> bool:
        if isinstance(con, Bits):
            return con.is_float and FLOATS[con.width][-1:] == mark
        return isinstance(con, c.FormatField) and con.fmtstr[-1:] == mark

    return concerns


#: Of framings whose check is written in hexadecimal digits; its field is called `check`.
CASE = Kind(
    "case of a check",
    "hexadecimal digits mean the same in either case; the check is written as its framing's format says",
    lambda con: False,
)
#: Of framings that cut zeros; its field is called `zeros`.
ZEROS = Kind(
    "zeros at the end",
    "zeros at the end of the data may be there or not; they are sent as few as may be",
    lambda con: False,
)
KINDS = (
    Kind(
        "negative zero",
        "sign and magnitude have two zeros; both read as 0, and 0 is built as the positive one",
        lambda con: isinstance(con, SignMagnitude),
    ),
    Kind(
        "signalling NaN",
        "a 32-bit float becomes a 64-bit one on its way, which makes a signalling NaN quiet (IEEE 754, 6.2)",
        _has_format("f"),
    ),
    Kind(
        "NaN of half precision",
        "Python reads every NaN of a 16-bit float as the same one",
        _has_format("e"),
    ),
    Kind(
        "overlong number",
        "a variable-length number may be written with more bytes than it needs; we build the shortest",
        lambda con: con is c.VarInt or con is c.ZigZag,
    ),
)


@dataclass(frozen=True)
class Exemption:
    """A field of a message and the kind of its exception. `bits` are canonical bit numbers; empty when they vary."""

    field: str
    kind: Kind
    bits: frozenset[int] = frozenset()


@lru_cache(maxsize=4096)
def exemptions(message: Message) -> tuple[Exemption, ...]:
    """Return the exceptions of a message, field by field."""
    found: dict[tuple[str, str], Exemption] = {}

    def visit(con: Construct, path: str) -> None:
        for kind in KINDS:
            if kind.concerns(con):
                found[path, kind.name] = Exemption(path, kind)
        if not isinstance(con, SignMagnitude):
            for name, inner in parts_of(con):
                visit(inner, f"{path}.{name}" if path and name else path or name)

    visit(message.payload, "")
    bits = _bits(message)
    framing = message.framing
    if framing is not None and framing.check is not None and framing.check.digits is not None:
        found["check", CASE.name] = Exemption("check", CASE)
    if framing is not None and isinstance(framing.stuffing, CutZeros):
        found["zeros", ZEROS.name] = Exemption("zeros", ZEROS)
    return tuple(Exemption(e.field, e.kind, bits.get(e.field, frozenset())) for e in found.values())


def _bits(message: Message) -> dict[str, frozenset[int]]:
    """Return the bits of exempt fields of a flat message, by path."""
    found: dict[str, set[int]] = {}
    for leaf in message.plan.leaves:
        node = leaf.node
        if node.is_number and (node.is_float or node.is_magnitude):
            path = ".".join(step for step in leaf.way if isinstance(step, str))
            found.setdefault(path, set()).update(node.place)
    return {path: frozenset(bits) for path, bits in found.items()}


def are_excused(message: Message, image: bytes, rebuilt: bytes) -> bool:
    """Return whether bytes differ only where an exception allows it. That both read the same is for the caller to see."""
    listed = exemptions(message)
    if not listed:
        return False
    framing = message.framing
    if (
        not message.plan.is_flat
        or message.plan.lists
        or (framing is not None and framing.stuffing is not None)
    ):
        return True
    start = 5 if framing is None else 0
    one, other = image[start:], rebuilt[start:]
    if len(one) != len(other) or image[:start] != rebuilt[:start]:
        return False
    free = {bit for e in listed for bit in e.bits}
    if framing is not None:
        end = len(one) - len(framing.end)
        free.update(range(8 * (end - framing.check_size), 8 * end))
    if message.check is not None and message.check.field is not None:
        at, size, _ = message.check_span
        free.update(range(8 * at, 8 * (at + size)))
    differing = int.from_bytes(one, "little") ^ int.from_bytes(other, "little")
    return all(bit in free for bit in range(8 * len(one)) if differing >> bit & 1)


__all__ = ["KINDS", "Exemption", "Kind", "are_excused", "exemptions"]
