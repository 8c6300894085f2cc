"""`--where`: conditions on fields of records.

    position>100          a number; 0x1F and 1e3 are numbers too
    position.1<0          one item of several; without its number any item may fulfil it (`!=`: none may be equal)
    servos.id=3           a field of nested records
    mode=torque           an enumeration's name, or its number
    error=overload        a flag that is set; error=0 compares the whole number
    data=0a00             bytes, in hexadecimal
    temperature=none      no value
    meta.time>12.5        what belongs to the transport: time, channel, direction, identifier, offset, size

1. A record without the field does not fulfil the condition, not even `!=`.
2. `!=` is the opposite of `=`: the other order signs are never fulfilled by names, texts, bytes or no value.
3. A field that no message has, or a name that no enumeration has, is an error and not an empty answer.

Numbers are compared in the sheet's unit, as printed; `=` allows for the rounding of the last digits.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import ge, gt, le, lt
from typing import Any

import msgspec

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.protocol import FlagSet, Meta, Record
from aces_bus.protocol.columns.gather import physical
from aces_bus.protocol.plan import nodes as p

from .output.shape import OfKind, Plans, getter

Test = Callable[[Any], bool]

_CONDITION = re.compile(r"\s*([A-Za-z_][\w.]*)\s*(!=|<=|>=|==|=|<|>)\s*(.*?)\s*", re.DOTALL)
_ORDER: Mapping[str, Callable[[Any, Any], bool]] = {"<": lt, ">": gt, "<=": le, ">=": ge}
_META = tuple(name for name in Meta.__struct_fields__ if name not in ("protocol", "message", "raw"))


@dataclass(frozen=True)
class WhereCondition:
    """One parsed `--where`."""

    text: str
    path: tuple[str | int, ...]
    sign: str
    value: str
    number: int | float | None
    data: bytes | None

    @property
    def is_meta(self) -> bool:
        return self.path[0] == "meta" and len(self.path) > 1


def parse_condition(text: str) -> WhereCondition:
    """Parse `field=value`; raises `CallerError` with what can be written."""
    found = _CONDITION.fullmatch(text)
    if found is None:
        raise CallerError(
            f"--where {text!r} is not a condition; write field=value, or one of != < > <= >= (in quotes)"
        )
    name, sign, value = found.groups()
    path = tuple(int(part) if part.isdecimal() else part for part in name.split("."))
    if "" in path:
        raise CallerError(f"--where {text!r}: {name!r} is not a field; write field, field.0 or field.part")
    condition = WhereCondition(
        text, path, "=" if sign == "==" else sign, value, _number(value), _bytes(value)
    )
    if sign in _ORDER and condition.number is None:
        raise CallerError(f"--where {text!r}: {sign} needs a number, not {value!r}")
    return condition


def _number(text: str) -> int | float | None:
    try:
        return int(text, 0)
    except ValueError:
        pass
    try:
        return int(text) if text.lstrip("+-").isdecimal() else float(text)
    except ValueError:
        return None


def _bytes(text: str) -> bytes | None:
    try:
        return bytes.fromhex(text.removeprefix("0x"))
    except ValueError:
        return None


class Where:
    """Conditions that must all hold. Raises `CallerError` when one can hold for no message of these plans."""

    def __init__(self, texts: Sequence[str], plans: Plans) -> None:
        conditions = [parse_condition(text) for text in texts]
        for condition in conditions:
            _check(condition, plans)
        self._tests = OfKind(lambda kind: _all([_test(condition, plans[kind]) for condition in conditions]))

    def holds(self, record: Any) -> bool:
        """Whether a record fulfils all conditions."""
        return self._tests[type(record)](record)


def _all(tests: Sequence[Test | None]) -> Test:
    wanted = [test for test in tests if test is not None]
    if len(wanted) < len(tests):
        return lambda record: False
    if len(wanted) == 1:
        return wanted[0]
    return lambda record: all(test(record) for test in wanted)


# ---------------------------------------------------------------------- before any record is seen


def _check(condition: WhereCondition, plans: Mapping[type[Record], p.MessagePlan]) -> None:
    if condition.is_meta:
        if condition.path[1] not in _META or len(condition.path) > 2:
            raise UnknownNameError("part of meta", ".".join(map(str, condition.path[1:])), _META)
        return
    found = [node for plan in plans.values() for node in _nodes(condition.path, plan.fields)]
    if not found:
        name = ".".join(map(str, condition.path))
        raise UnknownNameError("field", name, _paths(plans.values()))
    if condition.sign in _ORDER or condition.value in ("", "none"):
        return
    if condition.data is None and all(isinstance(node, p.Scalar) and node.kind == "bytes" for node in found):
        raise CallerError(f"--where {condition.text!r}: bytes are written as hexadecimal digits, two a byte")
    if condition.number is not None:
        return
    known: dict[str, None] = {}
    for node in found:
        names = _names(node)
        if names is None:
            return  # a text or bytes may be anything
        known.update(dict.fromkeys(names))
    if condition.value not in known:
        if known:
            raise UnknownNameError(f"value of {'.'.join(map(str, condition.path))}", condition.value, known)
        raise CallerError(f"--where {condition.text!r}: {condition.value!r} is not a number")


def _nodes(path: Sequence[str | int], plan_fields: Sequence[p.PlanField]) -> Iterator[p.Node]:
    """The values that a path may mean."""
    for field in plan_fields:
        if path and field.name == path[0]:
            yield from _inside(field.node, path[1:])


def _inside(node: p.Node, rest: Sequence[str | int]) -> Iterator[p.Node]:
    if isinstance(node, p.Opaque):
        yield node  # of any shape
    elif isinstance(node, p.Many):
        if rest and isinstance(rest[0], int):
            if rest[0] < len(node.items):
                yield from _inside(node.items[rest[0]], rest[1:])
        else:
            for item in node.items:
                yield from _inside(item, rest)
    elif isinstance(node, p.NestedRecord):
        yield from _nodes(rest, node.fields) if rest else ()
    elif not rest or (isinstance(node, p.MoreCells) and len(rest) == 1):
        yield node


def _names(node: p.Node) -> list[str] | None:
    """The names that a value may have; empty for a plain number, None when it may be any text."""
    if isinstance(node, p.DelimitedField):
        return {"names": [name for _, name in node.names], "text": None}.get(node.conversion, [])
    if isinstance(node, (p.Opaque, p.MoreCells, p.FromRequest)):
        return None
    if isinstance(node, p.Scalar) and node.kind in ("bytes", "text"):
        return None
    found: list[str] = []
    for step in getattr(node, "steps", ()):
        if isinstance(step, p.ValueNames):
            found += [name for _, name in step.values]
        elif isinstance(step, p.FlagBits):
            found += [name for name, _ in step.bits]
        elif isinstance(step, p.Scale):
            found += [name for _, name in step.names]
    return found


def _paths(plans: Any) -> set[str]:
    found: set[str] = set()

    def visit(plan_fields: Sequence[p.PlanField], prefix: str) -> None:
        for field in plan_fields:
            node = field.node
            while isinstance(node, p.Many) and node.items:
                node = node.items[0]
            if isinstance(node, p.NestedRecord):
                visit(node.fields, f"{prefix}{field.name}.")
            else:
                found.add(prefix + field.name)

    for plan in plans:
        visit(plan.fields, "")
    return found


# ---------------------------------------------------------------------- for each record


def _test(condition: WhereCondition, plan: p.MessagePlan) -> Test | None:
    """The condition for one message; None when it lacks the field."""
    one, is_not = comparison(condition, {}), condition.sign == "!="
    if condition.is_meta:
        name = str(condition.path[1])
        return lambda record: one(getattr(record.meta, name)) is not is_not
    nodes = list(_nodes(condition.path, plan.fields))
    if not nodes:
        return None
    one = comparison(condition, {name: raw for node in nodes for raw, name in _numbered(node)})
    path = condition.path
    if len(nodes) == 1 and not isinstance(nodes[0], (p.Opaque, p.MoreCells)):
        get = getter(path)
        return lambda record: one(get(record)) is not is_not

    def of_several(record: Any) -> bool:
        values = list(values_of(record, path))
        return bool(values) and any(map(one, values)) is not is_not

    return of_several


def _numbered(node: p.Node) -> list[tuple[float, str]]:
    """The numbers of a value's names, in its unit."""
    found: list[tuple[float, str]] = []
    for step in getattr(node, "steps", ()):
        if isinstance(step, p.ValueNames):
            found += step.values
        elif isinstance(step, p.Scale):
            found += [(physical(raw, step), name) for raw, name in step.names]
    return found


def values_of(value: Any, path: Sequence[str | int]) -> Iterator[Any]:
    """What a path may mean in a record: several values when it does not say which item of a tuple."""
    if isinstance(value, (tuple, list)):
        if path and isinstance(path[0], int):
            if path[0] < len(value):
                yield from values_of(value[path[0]], path[1:])
        else:
            for item in value:
                yield from values_of(item, path)
    elif not path:
        yield value
    elif isinstance(value, Mapping):
        if path[0] in value:
            yield from values_of(value[path[0]], path[1:])
    elif isinstance(value, msgspec.Struct) and str(path[0]) in value.__struct_fields__:
        yield from values_of(getattr(value, str(path[0])), path[1:])


def comparison(condition: WhereCondition, numbers: Mapping[str, float]) -> Test:
    """Compares one value (`!=` as `=`); `numbers` are the raw numbers of an enumeration's names."""
    wanted, number, data = condition.value, condition.number, condition.data
    if condition.sign in _ORDER:
        order = _ORDER[condition.sign]
        return lambda value: isinstance(value, (int, float)) and order(value, number)
    if condition.is_meta and condition.path[1] == "direction":
        wanted = {"to": "to device", "from": "from device"}.get(wanted, wanted)

    def equal(value: Any) -> bool:
        if value is None:
            return wanted in ("none", "")
        if isinstance(value, FlagSet):
            return value == number if number is not None else wanted in value
        if isinstance(value, str):
            return value == wanted or (number is not None and numbers.get(value) == number)
        if isinstance(value, bytes):
            return value == data
        if isinstance(value, bool):
            return wanted == str(value).lower()
        if number is None:
            return False
        if isinstance(value, float) or isinstance(number, float):
            return (
                math.isnan(value)
                if math.isnan(number)
                else math.isclose(value, number, rel_tol=1e-9, abs_tol=1e-12)
            )
        return bool(value == number)

    return equal


__all__ = ["Where", "WhereCondition", "comparison", "parse_condition", "values_of"]
