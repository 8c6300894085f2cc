"""What a record type holds, found once from its plan, so that writers need not look at every value.

1. Nothing here looks at a record; it only prepares how records of a type are read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from decimal import Decimal
from math import lcm
from typing import Any, NamedTuple

import msgspec

from aces_bus.protocol import FlagSet
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import FieldValue, WayStep
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


def json_value(value: FieldValue) -> Any:
    """Return any value as JSON has it: NaN, infinities and the unknown are null, flags a list of names, bytes
    hexadecimal.
    """
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


def json_string(value: FieldValue) -> str:
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
    if not node.is_number or node.known_names != [] or node.has_flags:
        return None
    if (both := node.by_bit) is not None:
        wholes = [_whole(scale, (0, both.half - 1)) for scale in both.scales]
        return PlainNumber(True, lcm(*wholes) if all(wholes) else 0, False)
    scales = [step for step in node.scales if step.scale != 1 or step.offset]
    is_float = node.is_float or any(
        isinstance(n, float) for step in scales for n in (step.scale, step.offset)
    )
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
    return node.shaped(_Plain())


class _Plain:
    """Functions that make values plain, by their shape."""

    def single(self, node: p.Node) -> Convert:
        number = nameless_number(node)
        if number is None or not number.is_inexact:
            return json_value
        whole = number.whole
        return lambda value: None if value is None else round(value * whole) / whole

    def several(self, node: p.Node, items: Sequence[p.Node]) -> Convert:
        converts = [item.shaped(self) for item in items]
        return lambda values: (
            None
            if values is None
            else [convert(value) for convert, value in zip(converts, values, strict=True)]
        )

    def record(self, node: p.Node, type_name: str, fields: Sequence[p.PlanField]) -> Convert:
        converts = [(field.name, field.node.shaped(self)) for field in fields]
        return lambda value: (
            None if value is None else {name: convert(getattr(value, name)) for name, convert in converts}
        )

    def each(self, node: p.Node, item: p.Node) -> Convert:
        convert = item.shaped(self)
        return lambda values: None if values is None else [convert(value) for value in values]

    def tagged(self, node: p.Node, type_name: str, kinds: Sequence[p.ItemKind]) -> Convert:
        converts = {kind.name: kind.plan.fields[0].node.shaped(self) for kind in kinds}
        return lambda items: [
            {
                "kind": item.kind,
                "data": (json_value if item.reason is not None else converts.get(item.kind, json_value))(
                    item.data
                ),
                "reason": item.reason,
            }
            for item in items
        ]


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
        named = (path for path in plan.walk() if all(isinstance(step, str) for step in path.way))
        nodes = tuple(path for path in named if not path.node.is_record)
    return [
        RecordLeaf(path.path, path.way, path.node, getter(path.way), _may_be_absent(path), path.is_inside)
        for path in nodes
    ]


def _may_be_absent(path: p.NodePath) -> bool:
    """Return whether a value, or the field that it is in, is there in some records only."""
    return bool(path.whens) or (path.node is not path.field.node and path.field.node.may_be_none)
