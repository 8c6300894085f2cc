"""What a record type holds, found once from its plan, so that writers need not look at every value.

1. Nothing here looks at a record; it only prepares how records of a type are read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from decimal import Decimal
from itertools import repeat
from math import lcm
from typing import Any, NamedTuple

import msgspec

from aces_bus.protocol import FlagSet
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import WayStep
from aces_bus.protocol.record import getter as getter
from aces_bus.protocol.record_plans import OfKind as OfKind
from aces_bus.protocol.record_plans import Plans as Plans
from aces_bus.protocol.record_plans import plans_of as plans_of

Convert = Callable[[Any], Any]


# ---------------------------------------------------------------------- plain values


def flag_names(flags: Any) -> list[str]:
    """Return the names of the set bits; bits without a name as one hexadecimal number."""
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


#: A plain value as JSON.
json_bytes: Callable[[Any], bytes] = msgspec.json.Encoder(enc_hook=json_value).encode


def json_string(value: Any) -> str:
    """Return the same as text."""
    return json_bytes(value).decode()


# ---------------------------------------------------------------------- numbers as scale and offset mean them


#: Whole numbers below this are found again from their float with a scale and an offset, however these are rounded.
FOUND_AGAIN = 1 << 48


class PlainNumber(NamedTuple):
    """A number without names.

    `whole` times a float is a whole number, as scale and offset mean it; 0 where that is not known. `has_unknown` says that
    the number may be None although it is there.
    """

    is_float: bool
    whole: int
    has_unknown: bool

    @property
    def is_inexact(self) -> bool:
        """True if the float may be wrong in its last digit: -662 × 0.01 is -6.620000000000001, and -662 / 100
        is -6.62.
        """
        return self.whole & self.whole - 1 != 0

    def mended(self, value: str) -> str:
        """Return the expression of the float that is nearest to what is meant."""
        return f"round({value} * {self.whole}) / {self.whole}" if self.is_inexact else value


def nameless_number(node: p.Node) -> PlainNumber | None:
    """Return what is known of a node's numbers; None where its values may be something else."""
    if not isinstance(node, (p.Scalar, p.FromIdentifier)) or node.known_names != []:
        return None
    if any(isinstance(step, p.FlagBits) for step in node.steps):
        return None  # flags without names
    scales = [step for step in node.steps if isinstance(step, p.Scale) and (step.scale != 1 or step.offset)]
    is_float = isinstance(node, p.Scalar) and node.kind == "float"
    is_float = is_float or any(isinstance(n, float) for step in scales for n in (step.scale, step.offset))
    whole = _whole(scales[0], node.raw_range) if is_float and len(scales) == 1 else 0
    return PlainNumber(is_float, whole, node.scale is not None and bool(node.scale.unknown))


def _whole(scale: p.Scale, raw_range: tuple[int, int] | None) -> int:
    """Return what makes scaled integers whole; 0 where they are too great to be found again."""
    if raw_range is None or not all(type(number) in (int, float) for number in (scale.scale, scale.offset)):
        return 0
    whole = lcm(*(Decimal(repr(number)).as_integer_ratio()[1] for number in (scale.scale, scale.offset)))
    return whole if max(abs(scale.physical(raw)) for raw in raw_range) * whole < FOUND_AGAIN else 0


def plain_of(node: p.Node) -> Convert:
    """Return a function that makes of a node's values what JSON has for them, scaled integers mended."""
    match node:
        case p.Many() | p.Repeated() | p.Each():
            if isinstance(node, p.Many):
                inner: Iterable[Convert] = [plain_of(item) for item in node.items]
            else:
                item = node.plan.fields[0].node if isinstance(node, p.Repeated) else node.item
                inner = repeat(plain_of(item))
            return lambda values: (
                None if values is None else [one(v) for one, v in zip(inner, values, strict=False)]
            )
        case p.NestedRecord():
            fields = [(field.name, plain_of(field.node)) for field in node.fields]
            return lambda value: (
                None if value is None else {name: one(getattr(value, name)) for name, one in fields}
            )
        case p.DescribedItems():
            return plain_of(node.items)
        case p.TaggedItems():
            kinds = {kind.name: plain_of(kind.plan.fields[0].node) for kind in node.kinds}
            return lambda items: [
                {
                    "kind": item.kind,
                    "data": (json_value if item.reason is not None else kinds.get(item.kind, json_value))(
                        item.data
                    ),
                    "reason": item.reason,
                }
                for item in items
            ]
        case _:
            number = nameless_number(node)
            if number is None or not number.is_inexact:
                return json_value
            whole = number.whole
            return lambda value: None if value is None else round(value * whole) / whole


def is_single_value(node: p.Node) -> bool:
    """Return whether msgspec writes the values of this node as they are."""
    if isinstance(node, p.Scalar):
        return node.kind != "bytes" and not node.flags
    return isinstance(node, (p.FromIdentifier, p.Rest, p.DelimitedField))


# ---------------------------------------------------------------------- single values, by path


class RecordLeaf(msgspec.Struct, frozen=True):
    """One value of a record: `path` is as a condition or a column names it (`servos.0.id`), `get` reads it, in the
    steps of `way`.

    `conditional` says that the value is None while a selector has other values.
    """

    path: str
    way: tuple[WayStep, ...]
    node: p.Node
    get: Callable[[Any], Any]
    conditional: bool = False
    #: Whether it is inside a list of items, which may be without it.
    is_inside: bool = False

    @property
    def identifier(self) -> str:
        """The path as one name: `servos_0_id`."""
        return self.path.replace(".", "_")


def record_leaves(plan: p.MessagePlan, *, is_split: bool = True) -> list[RecordLeaf]:
    """Return the values of a record, nested records taken apart, and (`is_split`) lists; what has no fixed shape is
    one value. A list of items is one too, with what is inside it behind it."""
    nodes = plan.columns
    if not is_split:
        named = (one for one in plan.walk() if all(isinstance(step, str) for step in one.way))
        nodes = tuple(one for one in named if not isinstance(one.node, p.NestedRecord))
    return [
        RecordLeaf(one.path, one.way, one.node, getter(one.way), bool(one.whens), isinstance(one, p.ItemPath))
        for one in nodes
    ]
