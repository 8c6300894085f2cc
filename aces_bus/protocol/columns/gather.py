"""Columns from records: the slow way, which takes every message, and the one that says what the columns are.

1. `kinds_of` and `dtype_of` decide what a message's columns are; whoever fills them quicker fills the same ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any

import msgspec
import numpy as np

from ...frame_table import Channels, to_ns
from ..plan import nodes as p
from ..record import Record
from .table import Array, Column, ColumnKind, MessageTable

#: Widths of NumPy's integers, in bits.
_WIDTHS = (8, 16, 32, 64)


#: The conditions a value hangs on, outermost first.
Whens = tuple[p.When, ...]


def value_paths(
    plan: p.MessagePlan,
) -> Iterator[tuple[str, p.PlanField, p.Node, tuple[str | int, ...], Whens]]:
    """(path, field, node, way to the value in the record, what its presence hangs on) of every single value."""
    for field in plan.fields:
        yield from _leaves(field.name, field, field.node, (field.name,), _whens(field))


def _whens(field: p.PlanField) -> Whens:
    return () if field.when is None else (field.when,)


def _leaves(
    path: str, field: p.PlanField, node: p.Node, way: tuple[str | int, ...], whens: Whens
) -> Iterator[tuple[str, p.PlanField, p.Node, tuple[str | int, ...], Whens]]:
    if isinstance(node, p.Many):
        for index, item in enumerate(node.items):
            yield from _leaves(f"{path}.{index}", field, item, (*way, index), whens)
    elif isinstance(node, p.NestedRecord):
        for inner in node.fields:
            yield from _leaves(
                f"{path}.{inner.name}", inner, inner.node, (*way, inner.name), (*whens, *_whens(inner))
            )
    else:
        yield path, field, node, way, whens


@lru_cache(maxsize=4096)
def kinds_of(plan: p.MessagePlan, raw: bool = False) -> tuple[ColumnKind, ...]:
    """What the columns of a message are, in the order of its fields."""
    return tuple(
        _kind(path, field, node, bool(whens), raw) for path, field, node, _, whens in value_paths(plan)
    )


def _kind(path: str, field: p.PlanField, node: p.Node, optional: bool, raw: bool) -> ColumnKind:
    steps: tuple[p.Step, ...] = getattr(node, "steps", ())
    names: Mapping[float, str] | None = None
    flags = None
    if not raw:
        for step in steps:
            if isinstance(step, p.ValueNames):
                names = dict(step.values)
            elif isinstance(step, p.FlagBits):
                flags = dict(step.bits)
            elif isinstance(step, p.Scale):
                optional = optional or bool(step.unknown)
                if step.names:
                    names = {physical(raw, step): name for raw, name in step.names}
    if isinstance(node, (p.DelimitedField, p.FromRequest, p.Opaque)):
        optional = True
    unit = "" if raw else str(getattr(node, "unit", ""))
    return ColumnKind(path, unit, field.doc, names, flags, dtype_of(node, raw) is None, optional)


def physical(raw: float, step: p.Scale) -> float:
    """A raw number in its unit, computed as everywhere."""
    if step.offset:
        return (raw * step.scale if step.scale != 1 else raw) + step.offset
    return raw * step.scale if step.scale != 1 else raw


def dtype_of(node: p.Node, raw: bool = False) -> Any:
    """The dtype of a value's column: the narrowest that holds all that the record may show; None for Python objects."""
    if isinstance(node, p.Rest):
        return np.dtype(f"u{_bytes(8 * node.size)}") if node.size <= 8 else None
    if isinstance(node, p.FromIdentifier):
        return _after(node.steps, *_range("uint", node.width), raw)
    if isinstance(node, p.DelimitedField):
        return np.dtype(np.float64) if not raw and node.conversion in ("number", "degrees") else None
    if not isinstance(node, p.Scalar) or node.kind in ("bytes", "text"):
        return None
    if node.kind == "float":
        return np.dtype(np.float64)
    if len(node.bits) > 64:
        return None
    return _after(node.steps, *_range(node.kind, len(node.bits)), raw)


def _range(kind: str, width: int) -> tuple[int, int]:
    return (-(1 << width - 1), (1 << width - 1) - 1) if kind == "int" else (0, (1 << width) - 1)


def _after(steps: Sequence[p.Step], low: int, high: int, raw: bool) -> Any:
    """The dtype of an integer in [low, high] after these steps."""
    for step in steps:
        if isinstance(step, p.Magnitude):
            high = (1 << step.width - 1) - 1
            low = -high
        elif isinstance(step, p.Scale) and not raw:
            if (isinstance(step.scale, float) and step.scale != 1.0) or (
                isinstance(step.offset, float) and step.offset
            ):
                return np.dtype(np.float64)
            ends = sorted((int(low * step.scale + step.offset), int(high * step.scale + step.offset)))
            low, high = ends
    for width in _WIDTHS:
        if low >= 0 and high < 1 << width:
            return np.dtype(f"u{width // 8}")
        if low >= -(1 << width - 1) and high < 1 << width - 1:
            return np.dtype(f"i{width // 8}")
    return None


def _bytes(bits: int) -> int:
    return next(width for width in _WIDTHS if width >= bits) // 8


class Gatherer:
    """Makes the tables of one message from its records."""

    def __init__(self, kind: type[Record], plan: p.MessagePlan, *, raw: bool) -> None:
        self.record = kind
        self.plan = plan
        self.kinds = kinds_of(plan, raw)
        self._fillers: dict[str, Callable[[ColumnKind, Sequence[Any]], Column]] = {}
        for path, _, node, way, _ in value_paths(plan):
            self._fillers[path] = _filler(way, dtype_of(node, raw))

    def table(self, records: Sequence[Any], rows: Array, channels: Channels) -> MessageTable:
        """The records, of which `rows` are the numbers in the capture; of a stream the packets' offsets."""
        n = len(records)
        is_stream = self.record._is_stream
        fillers = self._fillers
        return MessageTable(
            protocol=self.record._protocol,
            message=self.record.__name__,
            direction=self.record._direction,
            is_stream=is_stream,
            time=np.fromiter((to_ns(r._time) for r in records), np.int64, n),
            channel=np.fromiter((channels.number(r._channel) for r in records), np.uint16, n),
            channels=channels,
            key=np.fromiter((r._key for r in records), np.int64 if is_stream else np.uint32, n),
            row=rows,
            rx=np.fromiter((2 if r._rx is None else bool(r._rx) for r in records), np.uint8, n),
            kinds=self.kinds,
            make=lambda kind: fillers[kind.name](kind, records),
            doc=self.plan.doc,
            size=np.fromiter((len(r._raw) for r in records), np.int64, n) if is_stream else None,
        )


def _filler(way: tuple[str | int, ...], dtype: Any) -> Callable[[ColumnKind, Sequence[Any]], Column]:
    get = getter(way)

    def fill(kind: ColumnKind, records: Sequence[Any]) -> Column:
        values = [get(record) for record in records]
        absent = None
        if any(value is None for value in values):
            absent = np.array([value is None for value in values], bool)
        if dtype is None:
            array = np.empty(len(values), object)
            array[:] = [plain_value(value) for value in values]
            return Column(kind, array, absent)
        if kind.names is not None:
            numbers = {name: number for number, name in kind.names.items()}
            values = [numbers[value] if isinstance(value, str) else value for value in values]
        if absent is not None:
            values = [0 if value is None else value for value in values]
        return Column(kind, np.array(values, dtype), absent)

    return fill


def getter(way: Sequence[str | int]) -> Callable[[Any], Any]:
    """Reads what stands at the end of `way` in a record; None where a part of the way is not there."""
    if len(way) == 1 and isinstance(way[0], str):
        return attrgetter(way[0])

    def get(value: Any) -> Any:
        for step in way:
            if value is None:
                return None
            if isinstance(step, int):
                value = value[step] if isinstance(value, (tuple, list)) and step < len(value) else None
            elif isinstance(value, Mapping):
                value = value.get(step)
            else:
                value = getattr(value, step, None)
        return value

    return get


def plain_value(value: Any) -> Any:
    """A value without a fixed shape: nested records as dicts, tuples as lists."""
    if isinstance(value, msgspec.Struct):
        return {k: plain_value(getattr(value, k)) for k in value.__struct_fields__ if not k.startswith("_")}
    if isinstance(value, (tuple, list)):
        return [plain_value(item) for item in value]
    return value
