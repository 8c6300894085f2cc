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
    found = [node for plan in plans.values() for node in _nodes(condition.path, plan)]
    if not found:
        name = ".".join(map(str, condition.path))
        known_paths = {
            ".".join(step for step in leaf.way if isinstance(step, str))
            for plan in plans.values()
            for leaf in plan.leaves
        }
        raise UnknownNameError("field", name, known_paths)
    if condition.sign in _ORDER or condition.value in ("", "none"):
        return
    if condition.data is None and all(isinstance(node, p.Scalar) and node.kind == "bytes" for node in found):
        raise CallerError(f"--where {condition.text!r}: bytes are written as hexadecimal digits, two a byte")
    if condition.number is not None:
        return
    known: dict[str, None] = {}
    for node in found:
        names = node.known_names
        if names is None:
            return  # a text or bytes may be anything
        known.update(dict.fromkeys(names))
    if condition.value not in known:
        if known:
            raise UnknownNameError(f"value of {'.'.join(map(str, condition.path))}", condition.value, known)
        raise CallerError(f"--where {condition.text!r}: {condition.value!r} is not a number")


def _nodes(path: Sequence[str | int], plan: p.MessagePlan) -> list[p.Node]:
    """The values that a path may mean."""
    return [leaf.node for leaf in plan.leaves if _is_meant(path, leaf)]


def _is_meant(path: Sequence[str | int], leaf: p.NodePath) -> bool:
    """Whether a path leads to a value; it may leave out the numbers of items."""
    rest = list(path)
    for step in leaf.way:
        if rest and rest[0] == step:
            del rest[0]
        elif isinstance(step, str) or (rest and isinstance(rest[0], int)):
            return False
    # What construct decodes may have any shape.
    return (
        not rest or isinstance(leaf.node, p.Opaque) or (isinstance(leaf.node, p.MoreCells) and len(rest) == 1)
    )


# ---------------------------------------------------------------------- for each record


def _test(condition: WhereCondition, plan: p.MessagePlan) -> Test | None:
    """The condition for one message; None when it lacks the field."""
    one, is_not = comparison(condition, {}), condition.sign == "!="
    if condition.is_meta:
        name = str(condition.path[1])
        return lambda record: one(getattr(record.meta, name)) is not is_not
    nodes = _nodes(condition.path, plan)
    if not nodes:
        return None
    one = comparison(condition, {name: raw for node in nodes for name, raw in node.numbers.items()})
    path = condition.path
    if len(nodes) == 1 and not isinstance(nodes[0], (p.Opaque, p.MoreCells)):
        get = getter(path)
        return lambda record: one(get(record)) is not is_not

    def of_several(record: Any) -> bool:
        values = list(values_of(record, path))
        return bool(values) and any(map(one, values)) is not is_not

    return of_several


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
