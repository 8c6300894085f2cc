"""What is doubtful about fields: units, names, ranges, bits that belong to no field, one number the other way round.

1. A rule looks at what the spec wrote: name, adapters, and the number on the wire below them. What an import refuses is not
   asked again.
2. A construct that several messages share is one field: it is remarked upon once. What is not a number of fixed size (texts,
   bytes, opaque constructs) has no limits.
3. The tables of units are data: SI with its prefixes, and what data sheets write beside it (`count`, `turn`, `%`, `rpm`).
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import isinf
from typing import Any

import construct as c
from construct import Construct

from ..declare.bits import BitLayout
from ..declare.delimited import Delimited
from ..declare.fields import Enumeration, Field, Multiplexed, Quantity, SignMagnitude, raw_limits, wire_number
from ..declare.head import enumeration_of
from ..declare.items import Items
from ..declare.message import Message
from ..declare.normalise import inner_constructs
from ..declare.pattern import IdField, describe_values
from ..declare.place import SourceLine
from ..draw.table import FieldRow
from ..protocol import Protocol
from .finding import Finding, Level

#: One number, or so few of all, against so many of the other byte order is remarked upon; of signs against more, for a
#: sheet may call a number signed that is never negative.
FEW, MANY, MANY_UNSIGNED = 0.1, 2, 8


def check_fields(protocol: Protocol) -> Iterator[Finding]:
    """Yield what is wrong or doubtful about the fields of a protocol."""
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
    yield from _signs(fields)
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
    return f"{unit!r} is not a unit" + (
        f"; is it {near!r}?" if near is not None else "; write it as in 'rad/s', 'N·m'"
    )


def _quantity(field: Written, quantity: Quantity) -> Iterator[Finding]:
    limits = field.limits
    if limits is None:
        return
    low, high = limits
    unknown = quantity.unknown
    for value in (unknown[0], unknown[-1]) if isinstance(unknown, range) else unknown:
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
    """Return the numbers missing in a run of names; none where names are not a run."""
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
        if few and many >= MANY and len(few) <= max(1, FEW * len(ordered)):
            for field in few:
                yield _finding(
                    "warning",
                    "byte-order",
                    field,
                    f"is {rare}-endian, {many} other numbers of the protocol are {usual}-endian",
                )


def _signs(fields: Iterable[Written]) -> Iterator[Finding]:
    """Yield signed numbers whose range has nothing below 0, where nearly all others of such a range are unsigned."""
    positive = [field for field in fields if field.is_never_negative]
    signed = [field for field in positive if field.limits is not None and field.limits[0] < 0]
    others = len(positive) - len(signed)
    if others >= MANY_UNSIGNED and len(signed) <= max(1, FEW * others):
        for field in signed:
            yield _finding(
                "warning",
                "sign",
                field,
                f"is signed, and its range has nothing below 0; {others} other such numbers are unsigned",
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
                f"{what}: {FieldRow.bits_place(free)} of its layout belong to no field; they are kept as `reserved`",
                message.name,
            )


def _layouts(con: c.Construct, name: str) -> Iterator[tuple[BitLayout, str]]:
    if isinstance(con, c.Renamed):
        yield from _layouts(con.subcon, con.name or name)
    elif isinstance(con, BitLayout):
        yield con, name
    else:
        for inner in inner_constructs(con):
            yield from _layouts(inner, name)


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


#: Units that take prefixes: the base and derived units of SI (BIPM brochure, 9th edition), and some beside it.
PREFIXED = _words(
    "m g s A K mol cd rad sr Hz N Pa J W C V F Ω ohm Ohm S Wb T H lm lx Bq Gy Sv kat L l t eV Wh Ah VA var bar "
    "gauss Gs G B bit bps baud Bd sps Sps cal gal dB"
)
PREFIXES = _words("Y Z E P T G M k h da d c m µ μ u n p f a z y Ki Mi Gi")
#: Units that do not: angles, times and counts of data sheets, imperial ones, and names of SI written out.
PLAIN = _words(
    "% ‰ ppm ppb ° deg ° ' ″ ′ °C °F degC degF Celsius °/s deg/s min h d yr rpm RPM rev turn turns r count counts "
    "cnt ct LSB lsb digit digits tick ticks step steps pulse pulses px pixel pixels sample samples ratio pu "
    "dBHz dB-Hz dBW dBmV dBµV dBμV dBuV dBd dBc dBA dBFS dBsm "
    "in ft yd mi mph kph knot knots kn kt kts psi lb lbf lbs oz ozf ft·lb gf kgf rps cps fps dBm dBi dBV pH RH %RH "
    "Nm mNm kNm Ncm atm mmHg inHg Torr torr mgauss ha byte bytes bits word words bool flag "
    "degree degrees radian radians meter metre meters metres second seconds ampere volt watt newton kelvin hertz"
)
_NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?\s*(?:[·*×]\s*)?")
_FACTOR = re.compile(r"(?P<name>.*?[^\d^+\-⁰¹²³⁴⁵⁶⁷⁸⁹⁻])(?P<power>\^?[+-]?\d+|[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+)?$")


def is_unit(text: str) -> bool:
    """Return whether `text` is a unit; an empty one is (a number without unit).

    A unit is factors joined by `·`, `*`, `.` or a blank and divided by `/`, each with an optional whole exponent (`m/s²`,
    `m/s^2`, `kg·m2`, `rad s-1`), perhaps behind a number (`2 µs`).

    >>> [is_unit(text) for text in ("N·m", "0.1 mA", "rad/s²", "count", "degC", "bogus", "mm/", "kcount")]
    [True, True, True, True, True, False, False, False]
    """
    text = text.strip()
    if not text or text in PLAIN:
        return True
    number = _NUMBER.match(text)
    rest = text[number.end() :] if number is not None else text
    if not rest:
        return text == "1"
    if rest.startswith("/"):
        rest = "1" + rest
    if rest in PLAIN:
        return True
    bare = rest.replace("(", "").replace(")", "")
    if rest.count("(") != rest.count(")"):
        return False
    return all(
        all(_is_factor(factor) for factor in re.split(r"[·⋅*.\s]+", part.strip())) for part in bare.split("/")
    )


def _is_factor(text: str) -> bool:
    if text == "1" or text in PLAIN:
        return True
    found = _FACTOR.match(text)
    name = found["name"] if found is not None else text
    if name in PLAIN or name in PREFIXED:
        return True
    return any(name[:size] in PREFIXES and name[size:] in PREFIXED for size in (1, 2))


def suggest(text: str) -> str | None:
    """Return a unit that was perhaps meant."""
    folded = {name.lower(): name for name in sorted(PREFIXED | PLAIN)}
    near = difflib.get_close_matches(text.strip().lower(), folded, n=1, cutoff=0.6)
    return folded[near[0]] if near else None


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
                return adapter.raw_limits
        return raw_limits(self.inner)

    @property
    def is_never_negative(self) -> bool:
        """True if the field is a number whose stated range of raw values begins at 0 or above."""
        found = (adapter for adapter in self.adapters if isinstance(adapter, Quantity))
        quantity: Quantity | None = next(found, None)
        if quantity is None or self.limits is None:
            return False
        if quantity.raw_range is not None:
            return bool(quantity.raw_range[0] >= 0)
        is_plain = quantity.scale > 0 and not quantity.offset
        return bool(is_plain and quantity.range is not None and quantity.range[0] >= 0)

    @property
    def byte_order(self) -> str | None:
        """ "little" or "big" of a number of several bytes."""
        wire = wire_number(self.inner)
        return wire.order if wire is not None and wire.size > 1 else None


def declared_fields(protocol: Protocol) -> Iterator[Written]:
    """Yield every field that some message or register of the protocol has, each construct once."""
    seen: set[int] = set()
    for message in protocol.declared:
        for item in [*_heads(message), *payload_fields(message)]:
            key = id(item.adapters[0]) if item.adapters else id(item.inner)
            # construct's own numbers (Byte, Int16ul) are shared by all specs: they are distinguished by name.
            if item.adapters and key in seen:
                continue
            seen.add(key)
            yield item
    for register in (field for table in protocol.register_maps for field in table.values()):
        yield from _walk(register.field, "register", register.name, register.place)


def payload_fields(message: Message) -> Iterator[Written]:
    """Yield every field in a message's payload, those of the items of lists too."""
    yield from _walk(message.payload, message.name, "", message.place)


def _heads(message: Message) -> Iterator[Written]:
    for head in message.heads_written:
        if head.name is not None:
            yield from _walk(head.field, message.name, head.name, message.place)


def _walk(con: Construct, owner: str, name: str, place: SourceLine) -> Iterator[Written]:
    if isinstance(con, c.Renamed):
        inner = f"{name}.{con.name}" if name and con.name else con.name or name
        yield from _walk(con.subcon, owner, inner, place)
    elif isinstance(con, BitLayout):
        for slot in con.slots:
            yield from _walk(slot.field, owner, f"{name}.{slot.name}" if name else slot.name, place)
    elif isinstance(con, Delimited):
        for field in con.fields:
            yield from _walk(field, owner, name, place)
    elif isinstance(con, Items):
        for kind, data in con.data.items():
            yield from _walk(data, owner, f"{name}.{kind}", place)
    elif isinstance(con, (Multiplexed, c.IfThenElse, c.Switch)) or hasattr(con, "subcons"):
        for inner in inner_constructs(con):
            yield from _walk(inner, owner, name, place)
    else:
        adapters: list[Any] = []
        while hasattr(con, "subcon") and not isinstance(con, (c.Array, c.GreedyRange)):
            if isinstance(con, Field):
                adapters.append(con)
            con = con.subcon
        if isinstance(con, (c.Array, c.GreedyRange)):
            yield from _walk(con.subcon, owner, name, place)
            return
        if not adapters and (
            isinstance(con, (BitLayout, Delimited, Multiplexed, c.IfThenElse, c.Switch))
            or hasattr(con, "subcons")
        ):
            yield from _walk(con, owner, name, place)
            return
        yield Written(owner, name, tuple(adapters), con, place)
