"""Columns from records: the slow way, which takes every message, and the one that says what the columns are.

1. `kinds_of` and `dtype_of` decide what a message's columns are; whoever fills them quicker fills the same ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from ...frame_table import Channels, to_ns
from ..plan import nodes as p
from ..record import Record, getter, plain_value
from .table import Array, Column, ColumnKind, MessageTable

#: Widths of NumPy's integers, in bits.
_WIDTHS = (8, 16, 32, 64)


@lru_cache(maxsize=4096)
def kinds_of(plan: p.MessagePlan, raw: bool = False) -> tuple[ColumnKind, ...]:
    """What the columns of a message are, in the order of its fields."""
    return tuple(_kind(leaf, raw) for leaf in plan.leaves)


def _kind(leaf: p.NodePath, raw: bool) -> ColumnKind:
    node, scale = leaf.node, leaf.node.scale
    optional = bool(leaf.whens) or isinstance(node, (p.DelimitedField, p.FromRequest, p.Opaque))
    is_object = dtype_of(node, raw) is None
    if raw:
        return ColumnKind(leaf.path, "", leaf.field.doc, None, None, is_object, optional)
    names: Mapping[float, str] | None = {number: name for name, number in node.numbers.items()} or None
    optional = optional or (scale is not None and bool(scale.unknown))
    return ColumnKind(leaf.path, node.unit, leaf.field.doc, names, node.flags or None, is_object, optional)


def dtype_of(node: p.Node, raw: bool = False) -> Any:
    """The dtype of a value's column: the narrowest that holds all that the record may show; None for Python objects."""
    if isinstance(node, p.Rest):
        return np.dtype(f"u{_bytes(8 * node.size)}") if node.size <= 8 else None
    if isinstance(node, p.DelimitedField):
        return np.dtype(np.float64) if not raw and node.conversion in ("number", "degrees") else None
    if isinstance(node, p.Scalar) and node.kind == "float":
        return np.dtype(np.float64)
    if node.raw_range is None or (isinstance(node, p.Scalar) and len(node.bits) > 64):
        return None
    low, high = node.raw_range
    for step in node.steps if not raw else ():
        if isinstance(step, p.Scale):
            if (isinstance(step.scale, float) and step.scale != 1.0) or (
                isinstance(step.offset, float) and step.offset
            ):
                return np.dtype(np.float64)
            low, high = sorted((int(low * step.scale + step.offset), int(high * step.scale + step.offset)))
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
        self._fillers = {leaf.path: _filler(leaf.way, dtype_of(leaf.node, raw)) for leaf in plan.leaves}

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
