"""`--where`: conditions on fields of records.

    position>100          a number; 0x1F and 1e3 are numbers too
    position.1<0          one item of several; without its number any item may fulfil it (`!=`: none may be equal)
    servos.id=3           a field of nested records
    mode=torque           an enumeration's name, or its number
    error=overload        a flag that is set; error=0 compares the whole number
    data=0a00             bytes, in hexadecimal
    temperature=none      no value
    meta.time>12.5        what belongs to the transport: time, channel, direction, identifier, offset, size

    board=3,4             one of several values; board!=3,4: none of them
    angle=-5..12.5        a range, its ends included
    board=3 and angle>12 or mode=off        `and` binds closer
    name="left, or right" quotes keep commas, dots and words together

1. A record without the field does not fulfil the condition, not even `!=`.
2. `!=` is the opposite of `=`: the other order signs are never fulfilled by names, texts, bytes or no value.
3. A field that no message has, or a name that no enumeration has, is an error and not an empty answer.

Numbers are compared in the sheet's unit, as printed: a value that differs from the written number by rounding alone is
equal to it for every sign, so `<=` holds and `<` does not. Times are equal within half a microsecond, as they are printed.

`WhereColumns` keeps a row of a table exactly when `Where` keeps its record; what NumPy cannot do is asked of the rule for
single records, for each distinct value or each object.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import and_, ge, gt, le, lt, or_
from typing import Any, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.frame_table import NO_TIME, to_ns
from aces_bus.frames import EXTENDED as KEY_EXTENDED
from aces_bus.frames import FD as KEY_FD
from aces_bus.frames import REMOTE as KEY_REMOTE
from aces_bus.protocol import FlagSet, Record
from aces_bus.protocol.columns.table import Column, ColumnKind, MessageTable
from aces_bus.protocol.numbers import parse_number
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import Meta, getter
from aces_bus.protocol.record_plans import OfKind, Plans

#: A float is a written number within this part of the larger one, or within `NEAREST`; a time within `SAME_NS`.
NEAR, NEAREST, SAME_NS = 1e-9, 1e-12, 500

T = TypeVar("T")
Test = Callable[[Any], bool]

_CONDITION = re.compile(r"\s*([A-Za-z_][\w.]*)\s*(!=|<=|>=|==|=|<|>)\s*(.*?)\s*", re.DOTALL)
_QUOTED = r"""("[^"]*"|'[^']*')"""
_RANGE = re.compile(r"(.+?)\s*\.\.\s*(.+)", re.DOTALL)
_ORDER: Mapping[str, Callable[[Any, Any], Any]] = {"<": lt, ">": gt, "<=": le, ">=": ge}
_META = tuple(name for name in Meta.__struct_fields__ if name not in ("protocol", "message", "raw"))


@dataclass(frozen=True)
class WhereCondition:
    """One comparison of a `--where`; of a range, `number` is its lower end and `upper` the other."""

    text: str
    path: tuple[str | int, ...]
    sign: str
    value: str
    number: int | float | None
    data: bytes | None
    upper: int | float | None = None

    @property
    def is_meta(self) -> bool:
        return self.path[0] == "meta" and len(self.path) > 1


@dataclass(frozen=True)
class Joined:
    """Conditions of which any, or all, must hold."""

    parts: tuple[WhereCondition | Joined, ...]
    is_any: bool

    @property
    def conditions(self) -> Iterator[WhereCondition]:
        """The single comparisons."""
        for part in self.parts:
            if isinstance(part, Joined):
                yield from part.conditions
            else:
                yield part

    def joined(
        self, value_of: Callable[[WhereCondition], T], any_of: Callable[..., T], all_of: Callable[..., T]
    ) -> T:
        """Return what single comparisons give, joined by two functions of two values."""
        values = [
            part.joined(value_of, any_of, all_of) if isinstance(part, Joined) else value_of(part)
            for part in self.parts
        ]
        return reduce(any_of if self.is_any else all_of, values)


def parse_where(texts: Sequence[str]) -> Joined:
    """Return all of several `--where`; raises `CallerError` with what can be written."""
    return Joined(tuple(parse_condition(text) for text in texts), is_any=False)


def parse_condition(text: str) -> Joined:
    """Parse `field=value`, with sets, ranges, `and` and `or`; raises `CallerError` with what can be written."""
    either = (
        Joined(
            tuple(_compared(text, compared) for compared in _split(part, r"\s+and(?:\s+|$)")), is_any=False
        )
        for part in _split(text, r"\s+or(?:\s+|$)")
    )
    return Joined(tuple(either), is_any=True)


def _split(text: str, separator: str) -> list[str]:
    """Return the parts of a text between separators, which do not count between quotes."""
    parts, begin = list[str](), 0
    for found in re.finditer(f"{_QUOTED}|{separator}", text):
        if found[1] is None:
            parts.append(text[begin : found.start()])
            begin = found.end()
    return [*parts, text[begin:]]


def _compared(text: str, comparison: str) -> Joined:
    """Parse one comparison of a text, with each value of a set."""
    found = _CONDITION.fullmatch(comparison)
    if found is None:
        raise CallerError(
            f"--where {text!r} is not a condition; write field=value, or one of != < > <= >= (in quotes)"
        )
    name, sign, values = found.groups()
    path = tuple(int(part) if part.isdecimal() else part for part in name.split("."))
    if "" in path:
        raise CallerError(f"--where {text!r}: {name!r} is not a field; write field, field.0 or field.part")
    sign = "=" if sign == "==" else sign
    conditions = tuple(_condition(text, path, sign, value.strip()) for value in _split(values, ","))
    return Joined(conditions, is_any=sign != "!=")


def _condition(text: str, path: tuple[str | int, ...], sign: str, value: str) -> WhereCondition:
    if re.fullmatch(_QUOTED, value):
        number, upper, data, value = None, None, None, value[1:-1]
    else:
        ends = _RANGE.fullmatch(value)
        lower, higher = (parse_number(end) for end in ends.groups()) if ends else (None, None)
        if lower is not None and higher is not None:
            if not lower <= higher:
                raise CallerError(f"--where {text!r}: {value} is empty; write the smaller number first")
            number, upper, data = lower, higher, None
        else:
            number, upper, data = parse_number(value), None, _bytes(value)
    if sign in _ORDER and (number is None or upper is not None):
        raise CallerError(f"--where {text!r}: {sign} needs a number, not {value!r}")
    return WhereCondition(text, path, sign, value, number, data, upper)


def _bytes(text: str) -> bytes | None:
    try:
        return bytes.fromhex(text.removeprefix("0x"))
    except ValueError:
        return None


class Where:
    """Conditions that must all hold. Raises `CallerError` when one can hold for no message of these plans."""

    def __init__(self, texts: Sequence[str], plans: Plans) -> None:
        where = parse_where(texts)
        for condition in where.conditions:
            _check(condition, plans)
        self._tests = OfKind(
            lambda kind: (
                where.joined(lambda condition: _test(condition, plans[kind]), _either, _both) or _never
            )
        )

    def holds(self, record: Record) -> bool:
        """Return whether a record fulfils all conditions."""
        return self._tests[type(record)](record)


def _never(record: Record) -> bool:
    return False


def _either(first: Test | None, other: Test | None) -> Test | None:
    """Return a test of two, of which None is one that never holds."""
    if first is None or other is None:
        return first or other
    return lambda record: first(record) or other(record)


def _both(first: Test | None, other: Test | None) -> Test | None:
    if first is None or other is None:
        return None
    return lambda record: first(record) and other(record)


# ---------------------------------------------------------------------- before any record is seen


def _check(condition: WhereCondition, plans: Mapping[type[Record], p.MessagePlan]) -> None:
    if condition.is_meta:
        if condition.path[1] not in _META or len(condition.path) > 2:
            raise UnknownNameError("part of meta", ".".join(map(str, condition.path[1:])), _META)
        return
    found = [leaf.node for plan in plans.values() for leaf in _meant(condition.path, plan)]
    if not found:
        name = ".".join(map(str, condition.path))
        known_paths = {
            ".".join(step for step in _steps(leaf) if isinstance(step, str))
            for plan in plans.values()
            for leaf in plan.columns
        }
        raise UnknownNameError("field", name, known_paths)
    if condition.sign in _ORDER or condition.value in ("", "none"):
        return
    if condition.data is None and all(node.holds == "bytes" for node in found):
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
        raise CallerError(f"--where {condition.text!r}: {condition.value!r} is not a number; a range is 3..5")


def _meant(path: Sequence[str | int], plan: p.MessagePlan) -> list[p.NodePath]:
    """Return the values that a path may mean: those of a kind of items, or all others."""
    found = [leaf for leaf in plan.columns if _is_meant(path, leaf)]
    return [leaf for leaf in found if leaf.kind is not None] or found


def _steps(leaf: p.NodePath) -> list[str | int]:
    """Return the steps of a value's path."""
    return [int(step) if step.isdecimal() else step for step in leaf.path.split(".")]


def _is_meant(path: Sequence[str | int], leaf: p.NodePath) -> bool:
    """Return whether a path leads to a value; it may leave out the numbers of items."""
    rest = list(path)
    for step in _steps(leaf):
        if rest and rest[0] == step:
            del rest[0]
        elif isinstance(step, str) or (rest and isinstance(rest[0], int)):
            return False
    # What construct decodes may have any shape.
    return not rest or leaf.node.leads_inside(len(rest))


# ---------------------------------------------------------------------- for each record


def _test(condition: WhereCondition, plan: p.MessagePlan) -> Test | None:
    """Return the condition for one message; None when it lacks the field."""
    test, is_not = comparison(condition, {}), condition.sign == "!="
    if condition.is_meta:
        name = str(condition.path[1])
        return lambda record: test(getattr(record.meta, name)) is not is_not
    leaves = _meant(condition.path, plan)
    nodes = [leaf.node for leaf in leaves]
    if not nodes:
        return None
    test = comparison(condition, {name: raw for node in nodes for name, raw in node.numbers.items()})
    path = condition.path
    if leaves[0].kind is not None:
        gets = [getter(leaf.way) for leaf in leaves]
        return lambda record: any(test(get(record)) for get in gets) is not is_not
    if len(nodes) == 1 and not nodes[0].leads_inside(1):
        get = getter(path)
        return lambda record: test(get(record)) is not is_not

    def of_several(record: Record) -> bool:
        values = list(values_of(record, path))
        return bool(values) and any(map(test, values)) is not is_not

    return of_several


def values_of(value: Any, path: Sequence[str | int]) -> Iterator[Any]:
    """Yield what a path may mean in a record: several values when it does not say which item of a tuple."""
    match value:
        case tuple() | list():
            if path and isinstance(path[0], int):
                if path[0] < len(value):
                    yield from values_of(value[path[0]], path[1:])
            else:
                for item in value:
                    yield from values_of(item, path)
        case _ if not path:
            yield value
        case Mapping():
            if path[0] in value:
                yield from values_of(value[path[0]], path[1:])
        case msgspec.Struct() if str(path[0]) in value.__struct_fields__:
            yield from values_of(getattr(value, str(path[0])), path[1:])
        case _:
            pass


def comparison(condition: WhereCondition, numbers: Mapping[str, float]) -> Test:
    """Return a test of one value (`!=` as `=`); `numbers` are the raw numbers of an enumeration's names."""
    wanted, number, data, upper = condition.value, condition.number, condition.data, condition.upper
    near = _is_same_time if condition.is_meta and condition.path[1] == "time" else _is_near
    if upper is not None and number is not None:
        return lambda value: (
            isinstance(value, (int, float))
            and bool(number <= value or near(value, number))
            and bool(value <= upper or near(value, upper))
        )
    if condition.sign in _ORDER:
        order, with_equal = _ORDER[condition.sign], condition.sign.endswith("=")
        if number is None:
            return lambda value: False
        return lambda value: (
            isinstance(value, (int, float))
            and (with_equal if near(value, number) else bool(order(value, number)))
        )
    if condition.is_meta and condition.path[1] == "direction":
        wanted = {"to": "to device", "from": "from device"}.get(wanted, wanted)

    def equal(value: Any) -> bool:
        match value:
            case None:
                return wanted in ("none", "")
            case FlagSet():
                return value == number if number is not None else wanted in value
            case str():
                return value == wanted or (number is not None and numbers.get(value) == number)
            case bytes():
                return value == data
            case bool():
                return wanted == str(value).lower()
            case _:
                if number is None:
                    return False
                if isinstance(number, float) and math.isnan(number):
                    return isinstance(value, float) and math.isnan(value)
                return near(value, number)

    return equal


def _is_near(value: float, number: float) -> bool:
    """Return whether a value is a written number, but for the rounding of a float's last digits."""
    if isinstance(value, float) or isinstance(number, float):
        return value == number or math.isclose(value, number, rel_tol=NEAR, abs_tol=NEAREST)
    return value == number


def _is_same_time(value: float, number: float) -> bool:
    return bool(abs(to_ns(value) - _bound_ns(number)) <= SAME_NS)


# ---------------------------------------------------------------------- columns

Rows = npt.NDArray[np.bool_]
#: Columns of numbers up to this many bytes have few distinct values, and the rule is asked for each.
NARROW = 2


class WhereColumns:
    """Conditions that must all hold, on columns; raises what `Where` raises."""

    def __init__(self, texts: Sequence[str], plans: Plans) -> None:
        Where(texts, plans)
        self._where = parse_where(texts)

    def holds(self, table: MessageTable) -> Rows:
        """Return which rows of a table fulfil all conditions."""
        return self._where.joined(
            lambda condition: _meta(condition, table) if condition.is_meta else _field(condition, table),
            or_,
            and_,
        )


def _field(condition: WhereCondition, table: MessageTable) -> Rows:
    found = [(kind, rest) for kind in table.kinds if (rest := _reach(condition.path, kind)) is not None]
    any_of: Rows = np.zeros(len(table), bool)
    has: Rows = np.zeros(len(table), bool)
    for kind, rest in found:
        column = table[kind.name]
        if kind.is_object and (
            rest or any(isinstance(value, (list, dict)) for value in column.values.tolist())
        ):
            test = comparison(condition, {})
            for row, value in enumerate(column.values.tolist()):
                values = list(values_of(value, rest))
                has[row] |= bool(values)
                any_of[row] |= any(map(test, values))
        else:
            has[:] = True
            any_of |= _equal(condition, column)
    kept: Rows = has & (any_of != (condition.sign == "!="))
    return kept


def _reach(path: Sequence[str | int], kind: ColumnKind) -> tuple[str | int, ...] | None:
    """Return what of a condition's path is left behind the column's path; None when it leads elsewhere.

    The number of an item may be left out; within a column of objects the path may go on.
    """
    rest = list(path)
    for part in kind.name.split("."):
        if part.isdecimal():
            if rest and isinstance(rest[0], int) and rest.pop(0) != int(part):
                return None
        elif not rest or rest.pop(0) != part:
            return None
    return tuple(rest) if not rest or kind.is_object else None


def _equal(condition: WhereCondition, column: Column) -> Rows:
    """Return where a column's values are as the condition says (`!=` as `=`)."""
    kind = column.kind
    names = kind.names or {}
    test = comparison(condition, {name: number for number, name in names.items()})
    values = column.values
    if kind.is_object:
        found = np.fromiter((test(value) for value in values.tolist()), bool, len(values))
    elif names or kind.flags or (values.dtype.kind in "iu" and values.dtype.itemsize <= NARROW):
        show: Callable[[Any], Any] = lambda number: names.get(number, number)  # noqa: E731
        if kind.flags:
            show = type("Flags", (FlagSet,), {"bits": dict(kind.flags)})
        found = _by_distinct(values, lambda number: test(show(number)))
    else:
        found = _numbers(condition, values)
    if column.absent is not None:
        found = np.where(column.absent, test(None), found)
    return found


def _by_distinct(values: Any, test: Callable[[Any], bool]) -> Rows:
    distinct, places = np.unique(values, return_inverse=True)
    found: Rows = np.fromiter((test(value) for value in distinct.tolist()), bool, len(distinct))
    return found[places]


def _numbers(condition: WhereCondition, values: Any) -> Rows:
    number = condition.number
    if number is None:
        return np.zeros(len(values), bool)
    if number != number and condition.sign not in _ORDER and condition.upper is None:
        return np.isnan(values)  # type: ignore[no-any-return]
    if condition.upper is not None:
        lower, upper = _near(values, number), _near(values, condition.upper)
        return ((values >= number) | lower) & ((values <= condition.upper) | upper)  # type: ignore[no-any-return]
    return _ordered(condition.sign, values, number, _near(values, number))


def _ordered(sign: str, values: Any, number: float, near: Rows) -> Rows:
    """Return where values compare as a sign says (`!=` as `=`); those that are `near` are equal to the number."""
    if sign not in _ORDER:
        return near
    found: Rows = np.where(near, sign.endswith("="), _ORDER[sign](values, number))
    return found


def _near(values: Any, number: float) -> Rows:
    """Compare columns as `_is_near` does."""
    found: Rows = values == number
    if values.dtype.kind == "f" or isinstance(number, float):
        with np.errstate(invalid="ignore"):  # math.isclose
            near = np.maximum(NEAR * np.maximum(np.abs(values), abs(number)), NEAREST)
            found = found | (
                np.isfinite(values) & (abs(number) != np.inf) & (np.abs(values - number) <= near)
            )
    return found


def _bound_ns(seconds: float) -> int:
    """Return a bound of times in ns; beyond all instants where it is too large for one."""
    return to_ns(max(-9e9, min(float(seconds), 9e9)))


def _same_times(times: Any, bound: int) -> Rows:
    found: Rows = np.abs(times - bound) <= SAME_NS
    return found


def _meta(condition: WhereCondition, table: MessageTable) -> Rows:
    """Return a condition on what belongs to the transport."""
    n, test = len(table), comparison(condition, {})
    name = str(condition.path[1])
    found: Rows
    match name:
        case "time":
            known = table.time != NO_TIME
            if condition.number is None or condition.number != condition.number:
                found = np.zeros(n, bool)
            else:
                bound = _bound_ns(condition.number)
                near = _same_times(table.time, bound)
                if condition.upper is not None:
                    upper = _bound_ns(condition.upper)
                    found = ((table.time >= bound) | near) & (
                        (table.time <= upper) | _same_times(table.time, upper)
                    )
                else:
                    found = _ordered(condition.sign, table.time, bound, near)
            found = np.where(known, found, test(None))
        case "channel":
            names = table.channels.names
            found = np.fromiter((test(channel) for channel in names), bool, len(names))[table.channel]
        case "identifier" | "offset" | "size":
            if (name == "identifier") is table.is_stream:
                found = np.full(n, test(None))
            elif name == "identifier":
                found = _numbers(condition, table.key & np.uint32(0x1FFF_FFFF))
            else:
                found = _numbers(
                    condition, table.key if name == "offset" or table.size is None else table.size
                )
        case "is_rx":
            found = np.array([test(False), test(True), test(None)])[table.rx]
        case "direction":
            found = np.full(n, test(table.direction))
        case _:
            flag = {"extended": KEY_EXTENDED, "fd": KEY_FD, "remote": KEY_REMOTE}[name]
            is_set = np.zeros(n, bool) if table.is_stream else (table.key & np.uint32(flag)) != 0
            found = np.where(is_set, test(True), test(False))
    kept: Rows = found != (condition.sign == "!=")
    return kept
