"""One value of a message as a plan has it: where its bits are, and the steps from them to the record."""

from __future__ import annotations

from collections.abc import Sequence

import construct as c

from ..declare.bits import Bits, ByteSplit, whole_bits
from ..declare.fields import Counter, Enumeration, Flags, Quantity, SignMagnitude, Text
from ..declare.wire_number import wire_number
from . import nodes as p


class NotFlat(Exception):
    """This construct cannot be flattened; the argument says why."""


def scale_of(quantity: Quantity) -> p.Scale:
    """Return what a quantity makes of a raw number."""
    return p.Scale(
        quantity.scale,
        quantity.offset,
        quantity.unknown,
        quantity.range,
        quantity.raw_range,
        quantity.rounding,
        tuple((value, name) for name, value in quantity.names.items()),
    )


def peeled(con: c.Construct) -> tuple[c.Construct, list[p.Step], str, str]:
    """Return the construct below the known adapters, the steps from it outward, unit and doc."""
    steps: list[p.Step] = []
    unit = doc = ""
    while True:
        if isinstance(con, c.Renamed):
            doc = doc or con.docs or ""
            con = con.subcon
        elif isinstance(con, (c.Default, Counter)):
            con = con.subcon
        elif isinstance(con, Quantity):
            doc = doc or con.docs or ""
            unit = unit or con.unit
            steps.append(scale_of(con))
            con = con.subcon
        elif isinstance(con, SignMagnitude):
            steps.append(p.Magnitude(con.width))
            con = con.subcon
        elif isinstance(con, Enumeration):
            steps.append(p.ValueNames(tuple((v, k) for k, v in con.names.items())))
            con = con.subcon
        elif isinstance(con, Flags):
            steps.append(p.FlagBits(tuple(con.names.items())))
            con = con.subcon
        else:
            return con, steps[::-1], unit, doc


def integer_at(
    inner: Bits, offset: int, size: int, positions: Sequence[int], steps: tuple[p.Step, ...], unit: str
) -> p.Scalar:
    """Return an integer at these bits of the `size` bytes from `offset` on."""
    bits = tuple(8 * offset + position for position in positions)
    # What is all of these bytes may be plain ones, the highest first.
    is_big = size > 1 and bits == whole_bits(offset, size, "big")
    return p.Scalar(
        "int" if inner.signed else "uint", offset, size, "big" if is_big else "little", bits, steps, unit
    )


def scalar_of(con: c.Construct, offset: int) -> p.Scalar:
    """One value of fixed size, such as a register's; raises `NotFlat` with the reason."""
    inner, steps, unit, _ = peeled(con)
    found = tuple(steps)
    if isinstance(inner, Text):
        return p.Scalar("text", offset, inner.size, unit=unit, ends=inner.ends)
    if isinstance(inner, c.FormatField) and inner.fmtstr.startswith("="):
        raise NotFlat("native byte order")
    if isinstance(inner, ByteSplit):
        return integer_at(inner, offset, inner.bytes, inner.slot.positions, found, unit)
    wire = wire_number(inner)
    if wire is not None:
        bits = whole_bits(offset, wire.size, wire.order) if wire.kind != "float" else ()
        return p.Scalar(wire.kind, offset, wire.size, wire.order, bits, found, unit)
    if isinstance(inner, c.Bytes) and not isinstance(inner.length, int):
        raise NotFlat("bytes of a length that varies")
    if isinstance(inner, c.Bytes) and not steps:
        return p.Scalar("bytes", offset, inner.length)
    if inner is c.GreedyBytes and not steps:
        return p.Scalar("bytes", offset, None)
    raise NotFlat(f"{type(inner).__name__} has no flat form")
