"""What is doubtful about fields: units, names, ranges, bits that belong to nobody, one number the other way round.

1. A rule looks at what the spec wrote; what an import refuses is not asked again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import isinf

import construct as c

from ..declare.bits import BitLayout
from ..declare.fields import Enumeration, Quantity
from ..declare.head import enumeration_of
from ..declare.pattern import IdField, describe_values
from ..declare.protocol import Protocol
from ..draw import bits_place
from .finding import Finding, Level
from .units import is_unit, suggest
from .walk import Written, declared_fields

#: One number against so many of the other byte order is remarked upon.
FEW, MANY = 0.1, 8


def check_fields(protocol: Protocol) -> Iterator[Finding]:
    """What is wrong or doubtful about the fields of a protocol."""
    fields = list(declared_fields(protocol))
    for field in fields:
        yield from _unit(field)
        for adapter in field.adapters:
            if isinstance(adapter, Quantity):
                yield from _quantity(field, adapter)
            elif isinstance(adapter, Enumeration):
                yield from _enumeration(field, adapter)
    yield from _captures(protocol)
    yield from _orders(fields)
    yield from _gaps(protocol)


def _finding(level: Level, rule: str, field: Written, text: str) -> Finding:
    return Finding(level, rule, field.place, f"{field.label}: {text}", field.owner)


# ---------------------------------------------------------------------- one field


def _unit(field: Written) -> Iterator[Finding]:
    for adapter in field.adapters:
        unit = getattr(adapter, "unit", "")
        if isinstance(unit, str) and unit and not is_unit(unit):
            yield _finding(_doubt(field), "unit", field, _unit_text(unit))


def _doubt(field: Written) -> Level:
    # Whoever wrote a database is not the one who reads it: there it is only worth knowing.
    return "warning" if field.base.file.endswith(".py") else "note"


def _unit_text(unit: str) -> str:
    near = suggest(unit)
    return f"{unit!r} is no unit" + (
        f"; is it {near!r}?" if near is not None else "; write it as in 'rad/s', 'N·m'"
    )


def _quantity(field: Written, quantity: Quantity) -> Iterator[Finding]:
    limits = field.limits
    if limits is None:
        return
    low, high = limits
    for value in quantity.unknown:
        if not low <= value <= high:
            yield _finding(
                "error", "range", field, f"unknown={value:g} cannot occur: raw numbers are {low}…{high}"
            )
    for name, value in quantity.names.items():
        if not low <= value <= high:
            yield _finding(
                "error", "range", field, f"{name}={value} cannot occur: raw numbers are {low}…{high}"
            )
    if quantity.raw_range is not None:
        yield from _outside(field, "raw_range", quantity.raw_range, (low, high), "", 0)
    if quantity.range is not None:
        ends = sorted((low * quantity.scale + quantity.offset, high * quantity.scale + quantity.offset))
        unit = f" {quantity.unit}" if quantity.unit else ""
        yield from _outside(field, "range", quantity.range, (ends[0], ends[1]), unit, abs(quantity.scale))


def _outside(
    field: Written,
    what: str,
    stated: tuple[float, float],
    possible: tuple[float, float],
    unit: str,
    step: float,
) -> Iterator[Finding]:
    (low, high), (least, most) = stated, possible
    shown = f"{what} {_short(low)}…{_short(high)}{unit}"
    bits = f"what its bits hold, {_short(least)}…{_short(most)}{unit}"
    if high < least - step or low > most + step:
        yield _finding("error", "range", field, f"{shown} is outside {bits}")
    elif (low < least - step and not isinf(low)) or (high > most + step and not isinf(high)):
        yield _finding(_doubt(field), "range", field, f"{shown} goes beyond {bits}")


def _short(number: float) -> str:
    return f"{number:.6g}"


def _enumeration(field: Written, enumeration: Enumeration) -> Iterator[Finding]:
    limits = field.limits
    values = sorted(enumeration.values)
    for value in values:
        if limits is not None and not limits[0] <= value <= limits[1]:
            name = enumeration.values[value]
            yield _finding(
                "error",
                "enumeration",
                field,
                f"{name}={value} cannot occur: raw numbers are {limits[0]}…{limits[1]}",
            )
    holes = _holes(values)
    if holes:
        yield _finding(
            "note",
            "enumeration",
            field,
            f"names {values[0]}…{values[-1]}, but not {describe_values(holes)}; without a name a value shows as its number",
        )


def _holes(values: list[int]) -> list[int]:
    """The numbers missing in a run of names; none where names are no run."""
    # Counted before they are walked: numbers of 32 bits may lie billions apart.
    if len(values) <= 2 or 2 * (values[-1] - values[0] + 1 - len(values)) > len(values):
        return []
    return sorted(set(range(values[0], values[-1])) - set(values))


def _captures(protocol: Protocol) -> Iterator[Finding]:
    seen: set[int] = set()
    for message in protocol.declared:
        captures: list[IdField] = [*message.identifier.captures]
        for head in message.heads_written:
            captures += head.pattern.captures if head.pattern is not None else ()
        for capture in captures:
            key = id(capture.values)
            if key in seen:
                continue
            seen.add(key)
            if capture.unit and not is_unit(capture.unit):
                text = f"{message.name}.{capture.name}: {_unit_text(capture.unit)}"
                yield Finding("warning", "unit", message.place, text, message.name)
            for name, value in (capture.names or {}).items():
                if value not in capture.values:
                    yield Finding(
                        "error",
                        "enumeration",
                        message.place,
                        f"{message.name}.{capture.name}: {name}={value} cannot occur:"
                        f" it is {describe_values(capture.values)}",
                        message.name,
                    )
        for head in message.heads_written:
            names = enumeration_of(head.field)
            if names is None or head.pattern is None or not head.is_own or head.pattern.constant:
                continue
            (values,) = (capture.values for capture in head.pattern.captures)
            if len(values) <= 4096 and not set(values) & set(names.values):
                yield Finding(
                    "note",
                    "enumeration",
                    message.place,
                    f"{message.name}.{head.name}: none of {describe_values(values)} has a name",
                    message.name,
                )


# ---------------------------------------------------------------------- fields together


def _orders(fields: Iterable[Written]) -> Iterator[Finding]:
    ordered = [(field, order) for field in fields if (order := field.byte_order) is not None]
    for rare, usual in (("little", "big"), ("big", "little")):
        few = [field for field, order in ordered if order == rare]
        many = len(ordered) - len(few)
        if few and many >= MANY and len(few) <= FEW * len(ordered):
            for field in few:
                yield _finding(
                    "warning",
                    "byte-order",
                    field,
                    f"is {rare}-endian, {many} other numbers of the protocol are {usual}-endian",
                )


def _gaps(protocol: Protocol) -> Iterator[Finding]:
    seen: set[int] = set()
    for message in protocol.declared:
        for layout, name in _layouts(message.payload, ""):
            if id(layout) in seen or layout.overlapping:
                continue
            seen.add(id(layout))
            taken = 0
            for slot in layout.slots:
                taken |= slot.mask
            free = [bit for bit in range(8 * layout.size) if not taken >> bit & 1]
            if not free:
                continue
            place = layout.place if layout.place.file == message.place.file else message.place
            what = f"{message.name}.{name}" if name else message.name
            yield Finding(
                "note",
                "gap",
                place,
                f"{what}: {bits_place(free)} of its layout belong to no field; they are kept as `reserved`",
                message.name,
            )


def _layouts(con: c.Construct, name: str) -> Iterator[tuple[BitLayout, str]]:
    if isinstance(con, c.Renamed):
        yield from _layouts(con.subcon, con.name or name)
    elif isinstance(con, BitLayout):
        yield con, name
    elif isinstance(con, c.Struct):
        for item in con.subcons:
            yield from _layouts(item, name)
    elif hasattr(con, "subcon"):
        yield from _layouts(con.subcon, name)


__all__ = ["check_fields"]
