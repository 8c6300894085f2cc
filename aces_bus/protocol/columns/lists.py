"""Columns of what is inside lists of items: all items of a batch of packets are found at once, and are rows themselves.

1. The list itself is a column of Python objects, each list as the record has it: nothing is left out.
2. Of tagged items each kind has the columns of its data: the first good item of the kind in each packet, absent where there
   is none. Of repeated groups each value has one column of lists.
3. Items of a kind are decoded as packets are (`RowDecoder`); bytes that do not fit are not an item of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..generate.load import list_reader
from ..plan import nodes as p
from .table import Array, dtype_of, object_array, packet_rows

if TYPE_CHECKING:
    from .rows import PacketRows, RowDecoder

Values = tuple[Array, Array | None]


class FoundItems(NamedTuple):
    """Items of packets, in order: the number of the row of each, and their bytes as rows."""

    row: Array
    rows: PacketRows


class ListColumns:
    """The columns of one list; `tail` are the bytes of a packet behind it, `make` gives the decoder of a plan by itself."""

    def __init__(
        self,
        node: p.ListNode,
        name: str,
        tail: int,
        *,
        raw: bool,
        make: Callable[[p.MessagePlan], RowDecoder],
    ) -> None:
        self.node, self.tail, self._raw = node, tail, raw
        self._read = list_reader(node, name, raw)
        self._decoders = {id(plan): make(plan) for plan in node.plans}

    def whole(self, rows: PacketRows) -> Values:
        """Return the lists, as records have them."""
        start, read = self.node.offset, self._read
        ends = (rows.lengths.astype(np.int64) - self.tail).tolist()
        packets = (row.tobytes() for row in rows.data)
        return object_array(
            [read(packet, start, end) for packet, end in zip(packets, ends, strict=True)]
        ), None

    def inside(self, leaf: p.NodePath) -> Callable[[PacketRows], Values]:
        """Return a function that gives the values of one column of what is inside."""
        node = self.node
        if isinstance(node, p.Repeated):
            return lambda rows: self._every(node, leaf.inner, rows)
        assert isinstance(node, p.TaggedItems)
        assert leaf.kind is not None
        kind, dtype = leaf.kind, dtype_of(leaf.node, self._raw)
        return lambda rows: self._first(node, kind, leaf.inner, dtype, rows)

    def _every(self, node: p.Repeated, inner: str, rows: PacketRows) -> Values:
        decoder = self._decoders[id(node.plan)]
        found, counts = rows.kept(("groups", id(node)), lambda: _groups(node, rows, self.tail))
        values: list[Any] = []
        if len(found.row):
            values = decoder.column(_kind(decoder, inner), found.rows).to_list()
        ends = np.cumsum(counts).tolist()
        return object_array(
            [values[end - count : end] for end, count in zip(ends, counts.tolist(), strict=True)]
        ), None

    def _first(
        self, node: p.TaggedItems, kind: p.ItemKind, inner: str, dtype: Any, rows: PacketRows
    ) -> Values:
        decoder = self._decoders[id(kind.plan)]
        found = rows.kept(("kind", id(kind)), lambda: self._firsts(node, kind, decoder, rows))
        values: Any = np.zeros(len(rows), dtype or object)
        if dtype is None:
            values[:] = None
        absent = np.ones(len(rows), bool)
        if not len(found.row):
            return values, absent
        column = decoder.column(_kind(decoder, inner), found.rows)
        values[found.row] = column.values
        absent[found.row] = False if column.absent is None else column.absent
        return values, absent if absent.any() else None

    def _firsts(
        self, node: p.TaggedItems, kind: p.ItemKind, decoder: RowDecoder, rows: PacketRows
    ) -> FoundItems:
        """Return the first good item of a kind in each row that has one."""
        row, tag, start, size = rows.kept(("items", id(node)), lambda: _items(node, rows, self.tail))
        mine = np.flatnonzero(tag == kind.number)
        found = _cut(rows, row[mine], start[mine], size[mine], decoder.extent)
        good = decoder.accepts(found.rows) if len(mine) else None
        if good is not None:
            found = FoundItems(found.row[good], found.rows.take(good))
        first = np.flatnonzero(np.diff(found.row, prepend=-1))
        return found if len(first) == len(found.row) else FoundItems(found.row[first], found.rows.take(first))


def _kind(decoder: RowDecoder, name: str) -> Any:
    return next(kind for kind in decoder.kinds if kind.name == name)


def _cut(rows: PacketRows, row: Array, start: Array, size: Array, least: int) -> FoundItems:
    """Return parts of rows as rows of their own, at least `least` bytes wide; `row` and `start` rise."""
    if not len(row):
        return FoundItems(row, type(rows)(np.zeros((0, 8), np.uint8), size, size))
    width = max(8, -(-max(int(size.max()), least) // 8) * 8)
    starts = row * rows.data.shape[1] + start
    return FoundItems(row, type(rows)(packet_rows(rows.data.tobytes(), starts, size, width), size, starts))


def _groups(node: p.Repeated, rows: PacketRows, tail: int) -> tuple[FoundItems, Array]:
    """Return all groups, and how many each row has."""
    counts = (rows.lengths.astype(np.int64) - (node.offset + tail)) // node.width
    row = np.repeat(np.arange(len(rows)), counts)
    number = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    size = np.full(len(row), node.width)
    return _cut(rows, row, node.offset + number * node.width, size, node.width), counts


def _items(node: p.TaggedItems, rows: PacketRows, tail: int) -> tuple[Array, Array, Array, Array]:
    """Return row, tag, start of the data and their size, of all items whose tag and size are whole; in order."""
    data, width = rows.data.reshape(-1), rows.data.shape[1]
    ends = rows.lengths.astype(np.int64) - tail
    at = np.full(len(rows), node.offset)
    pieces: list[Sequence[Array]] = [[np.zeros(0, np.int64)] * 4]
    row = np.flatnonzero(at + node.head <= ends)
    while len(row):
        base, end = row * width + at[row], ends[row]
        tag, start = _numbers(data, base, node.tag), at[row] + node.head
        if node.size is not None:
            stop = start + _numbers(data, base, node.size) - node.counted
        else:
            stop = end.copy()
            for kind in node.kinds:
                if kind.size is not None:
                    mine = tag == kind.number
                    stop[mine] = np.minimum(end[mine], start[mine] + kind.size)
        good = (start <= stop) & (stop <= end)
        row, tag, start, stop = row[good], tag[good], start[good], stop[good]
        pieces.append([row, tag, start, stop - start])
        at[row] = stop
        row = row[stop + node.head <= end[good]]
    found = [np.concatenate(parts) for parts in zip(*pieces, strict=True)]
    order = np.argsort(found[0] * width + found[2], kind="stable")
    row, tag, start, size = (part[order] for part in found)
    return row, tag, start, size


def _numbers(data: Array, base: Array, number: p.Scalar) -> Array:
    """Return a tag or size of each item that begins at `base`."""
    size = number.size or 0
    found = np.zeros(len(base), np.int64)
    for place in range(size):
        shift = 8 * (place if number.order == "little" else size - 1 - place)
        found |= data[base + number.offset + place].astype(np.int64) << shift
    return found
