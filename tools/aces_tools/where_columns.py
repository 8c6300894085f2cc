"""`--where` on columns: the rows that fulfil what `where.py` says of single records.

1. A row is kept exactly when its record would be: `where.py` is the rule, and this is quicker.
2. Where NumPy cannot say it, the rule itself is asked: for each distinct value, or for each object.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import ge, gt, le, lt
from typing import Any

import numpy as np
import numpy.typing as npt

from aces_bus.frame_table import NO_TIME, to_ns
from aces_bus.protocol import FlagSet
from aces_bus.protocol.columns.table import Column, ColumnKind, MessageTable
from aces_bus.protocol.keys import EXTENDED as KEY_EXTENDED
from aces_bus.protocol.keys import FD as KEY_FD
from aces_bus.protocol.keys import REMOTE as KEY_REMOTE

from .output.shape import Plans
from .where import Where, WhereCondition, comparison, parse_condition, values_of

Rows = npt.NDArray[np.bool_]
_ORDER: Mapping[str, Callable[[Any, Any], Any]] = {"<": lt, ">": gt, "<=": le, ">=": ge}
#: Columns of numbers up to this many bytes have few distinct values, and the rule is asked for each.
NARROW = 2


class WhereColumns:
    """Conditions that must all hold; raises what `Where` raises."""

    def __init__(self, texts: Sequence[str], plans: Plans) -> None:
        Where(texts, plans)
        self.conditions = [parse_condition(text) for text in texts]

    def holds(self, table: MessageTable) -> Rows:
        """Which rows of a table fulfil all conditions."""
        kept = np.ones(len(table), bool)
        for condition in self.conditions:
            if kept.any():
                kept &= _meta(condition, table) if condition.is_meta else _field(condition, table)
        return kept


def _field(condition: WhereCondition, table: MessageTable) -> Rows:
    found = [(kind, rest) for kind in table.kinds if (rest := _reach(condition.path, kind)) is not None]
    any_of: Rows = np.zeros(len(table), bool)
    has: Rows = np.zeros(len(table), bool)
    for kind, rest in found:
        column = table[kind.name]
        if kind.is_object and (rest or any(isinstance(one, (list, dict)) for one in column.values.tolist())):
            one = comparison(condition, {})
            for row, value in enumerate(column.values.tolist()):
                values = list(values_of(value, rest))
                has[row] |= bool(values)
                any_of[row] |= any(map(one, values))
        else:
            has[:] = True
            any_of |= _equal(condition, column)
    kept: Rows = has & (any_of != (condition.sign == "!="))
    return kept


def _reach(path: Sequence[str | int], kind: ColumnKind) -> tuple[str | int, ...] | None:
    """What of a condition's path is left behind the column's path; None when it leads elsewhere.

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
    """Where a column's values are as the condition says (`!=` as `=`)."""
    kind = column.kind
    names = kind.names or {}
    one = comparison(condition, {name: number for number, name in names.items()})
    values = column.values
    if kind.is_object:
        found = np.fromiter((one(value) for value in values.tolist()), bool, len(values))
    elif names or kind.flags or (values.dtype.kind in "iu" and values.dtype.itemsize <= NARROW):
        show: Callable[[Any], Any] = lambda number: names.get(number, number)  # noqa: E731
        if kind.flags:
            show = type("Flags", (FlagSet,), {"bits": dict(kind.flags)})
        found = _by_distinct(values, lambda number: one(show(number)))
    else:
        found = _numbers(condition, values)
    if column.absent is not None:
        found = np.where(column.absent, one(None), found)
    return found


def _by_distinct(values: Any, one: Callable[[Any], bool]) -> Rows:
    distinct, places = np.unique(values, return_inverse=True)
    found: Rows = np.fromiter((one(value) for value in distinct.tolist()), bool, len(distinct))
    return found[places]


def _numbers(condition: WhereCondition, values: Any) -> Rows:
    number = condition.number
    if number is None:
        return np.zeros(len(values), bool)
    found: Rows
    if condition.sign in _ORDER:
        found = _ORDER[condition.sign](values, number)
        return found
    if values.dtype.kind != "f" and isinstance(number, int):
        found = values == number
        return found
    if number != number:
        found = np.isnan(values)
        return found
    with np.errstate(invalid="ignore"):  # math.isclose
        near = np.maximum(1e-9 * np.maximum(np.abs(values), abs(number)), 1e-12)
        found = (values == number) | (
            np.isfinite(values) & (abs(number) != np.inf) & (np.abs(values - number) <= near)
        )
    return found


def _meta(condition: WhereCondition, table: MessageTable) -> Rows:
    """A condition on what belongs to the transport."""
    n, one = len(table), comparison(condition, {})
    name = str(condition.path[1])
    found: Rows
    if name == "time":
        known = table.time != NO_TIME
        if condition.number is None:
            found = np.zeros(n, bool)
        elif condition.sign in _ORDER:
            found = _ORDER[condition.sign](table.time, to_ns(float(condition.number)))
        else:
            found = _numbers(condition, table.seconds)
        found = np.where(known, found, one(None))
    elif name == "channel":
        names = table.channels.names
        found = np.fromiter((one(channel) for channel in names), bool, len(names))[table.channel]
    elif name in ("identifier", "offset", "size"):
        if (name == "identifier") is table.is_stream:
            found = np.full(n, one(None))
        elif name == "identifier":
            found = _numbers(condition, table.key & np.uint32(0x1FFF_FFFF))
        else:
            found = _numbers(condition, table.key if name == "offset" or table.size is None else table.size)
    elif name == "is_rx":
        found = np.array([one(False), one(True), one(None)])[table.rx]
    elif name == "direction":
        found = np.full(n, one(table.direction))
    else:
        flag = {"extended": KEY_EXTENDED, "fd": KEY_FD, "remote": KEY_REMOTE}[name]
        is_set = np.zeros(n, bool) if table.is_stream else (table.key & np.uint32(flag)) != 0
        found = np.where(is_set, one(True), one(False))
    kept: Rows = found != (condition.sign == "!=")
    return kept


__all__ = ["WhereColumns"]
