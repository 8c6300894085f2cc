"""Columns of fields that are there by bits: finds their places in many packets, and makes rows of fixed places.

1. Of each packet it says what `Shapes` says of one; how many shapes there are among the packets costs nothing.
2. In a wide row each field stands where a packet with all fields has it; what is not there is any bytes, but the fields in
   `blanks`, which then are as they must be.
3. Where packets have all fields (or all but the last ones), their rows are the wide ones already.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..declare.fields import Present
from ..declare.shapes import Shapes
from ..live.find import number_at
from ..plan import nodes as p
from .table import Array

if TYPE_CHECKING:
    from .rows import PacketRows


class FieldPlace(NamedTuple):
    """The place of a field: the packets that have it (a bool for all of them), and its offset in each packet."""

    there: Array | bool
    offset: Array | int


class FieldPlaces:
    """The places of a message's fields; a field of open size counts with its least size."""

    def __init__(self, shapes: Shapes) -> None:
        self.names = [item.name for item, _ in shapes.items]
        self.sizes = shapes.sizes
        self.start = shapes.message.payload_start
        self._heads, self._wires = shapes.heads, shapes.wires
        self._present = [body if isinstance(body, Present) else None for _, body in shapes.items]
        #: Narrow numbers, if they do, are quicker.
        self._dtype = np.uint16 if self.start + sum(size for size, _ in self.sizes) < 1 << 16 else np.int64
        #: The bytes that are needed to begin with.
        self.reach = max((head.offset + head.size for head in self._heads), default=0)

    def of(self, data: Array, starts: Array) -> tuple[list[FieldPlace], Array | int, Array | int]:
        """Return the places of the fields in packets that begin at `starts`, where the last field ends, and how many bytes
        say so: of a packet that is cut off before these, places are any.
        """
        numbers: dict[str | None, Array | int] = {
            head.name: _alike(number_at(data, starts + head.offset, head.size, head.order))
            for head in self._heads
        }
        end: Any = self.start
        known: Any = self.reach
        places: list[FieldPlace] = []
        for name, (size, _), wire, present in zip(
            self.names, self.sizes, self._wires, self._present, strict=True
        ):
            there = True if present is None else _is_set(numbers[present.selector], present.bit)
            places.append(FieldPlace(there, end))
            if wire is not None:
                number = number_at(data, starts + end, wire.size, wire.order)
                numbers[name] = _alike(number if there is True else number * there)
                known = np.maximum(known, there * (end + size))
            if there is not False:
                end = end + (size if there is True else np.multiply(there, size, dtype=self._dtype))
        return places, end, known


def _alike(numbers: Array) -> Array | int:
    """Return numbers that are all the same as one."""
    return int(numbers[0]) if len(numbers) and (numbers == numbers[0]).all() else numbers


def _is_set(numbers: Array | int, bit: int) -> Array | bool:
    """Return in which numbers a bit is set; a bool where it is in all of them or in none."""
    if isinstance(numbers, int):
        return bool(numbers >> bit & 1)
    if 1 << bit > np.iinfo(numbers.dtype).max:
        return False
    found: Array = (numbers & numbers.dtype.type(1 << bit)) != 0
    return False if not found.any() else True if found.all() else found


class WideRows(NamedTuple):
    """Rows in which every field has a fixed place; which fields are there, by name; and which rows are as long as their
    fields say.
    """

    rows: PacketRows
    there: dict[str | None, Array | bool]
    fits: Array


class ShapedRows:
    """Makes wide rows of the packets of one message, as `plan` places their fields, which is the plan of a packet that has
    all of them. `reason` says why it cannot; else it is empty.
    """

    def __init__(self, shapes: Shapes, plan: p.MessagePlan) -> None:
        self._places = FieldPlaces(shapes)
        self._tail = plan.tail
        *fixed, (least, most) = shapes.sizes
        self._is_open = most is None
        self.reason = ""
        if plan.lengths_by or most not in (least, None) or any(low != high for low, high in fixed):
            self.reason = "fields of several sizes beside fields that are there by bits"
        #: Where each field stands in a wide row, and what stands there when it is absent, if that matters.
        self._layout: list[tuple[int, bytes]] = []
        at = self._places.start
        for size, _ in shapes.sizes:
            blank = bytearray(size)
            inside = [constant for constant in plan.constants if at <= constant.offset < at + size]
            for constant in inside:
                blank[constant.offset - at] |= constant.value
            is_counted = any(at <= node.offset <= at + size for _, node in plan.lists)
            self._layout.append((at, bytes(blank) if inside or is_counted else b""))
            at += size
        self._end = at
        moving = [
            low if isinstance(body, Present) else 0
            for (low, _), (_, body) in zip(shapes.sizes, shapes.items, strict=True)
        ]
        #: Numbers of fields that move by multiples of their size, which divides the rows.
        self._aligned = {
            number
            for number, (size, most) in enumerate(shapes.sizes)
            if size in (1, 2, 4, 8) and most == size and not any(low % size for low in moving[:number])
        }

    def of(self, rows: PacketRows) -> WideRows:
        """Return the wide rows of packets."""
        flat, (count, width) = rows.data.reshape(-1), rows.data.shape
        starts = np.arange(0, count * width, width)
        places, end, _ = self._places.of(flat, starts)
        there = {name: place.there for name, place in zip(self._places.names, places, strict=True)}
        lengths = rows.lengths.astype(np.int64)
        behind = np.zeros(1, np.int64)
        fits = lengths - self._tail == end
        if self._is_open and places[-1].there is not False:
            behind = np.maximum(lengths - self._tail - end, 0) * places[-1].there
            fits = lengths - self._tail - behind == end
        wide = self._spread(rows, flat, starts, places, int(behind.max(initial=0)))
        more = np.broadcast_to(self._end + self._tail + behind, count)
        return WideRows(type(rows)(wide, more, rows.keys), there, fits)

    def _spread(
        self, rows: PacketRows, flat: Array, starts: Array, places: Sequence[FieldPlace], behind: int
    ) -> Array:
        """Return the bytes of wide rows; an open field has at most `behind` bytes more than its least size."""
        count, width = rows.data.shape
        fields = list(zip(places, self._layout, self._places.sizes, strict=True))
        absent = [
            (at, blank, place.there) for place, (at, blank), _ in fields if blank and place.there is not True
        ]
        is_moved = [
            place.there is not False and (isinstance(place.offset, np.ndarray) or place.offset != at)
            for place, (at, _), _ in fields
        ]
        if not any(is_moved) and not absent:
            return rows.reaching(self._end).data
        wide = np.empty((count, -(-(self._end + behind) // 8) * 8), np.uint8)
        # Fields that stand where a packet with all fields has them, and the header.
        same = min(width, self._layout[is_moved.index(True)][0] if any(is_moved) else wide.shape[1])
        if same:
            _cells(wide, 0, same)[...] = _cells(rows.data, 0, same)
        for number, ((place, (at, _), (size, most)), moved) in enumerate(zip(fields, is_moved, strict=True)):
            if most is None:
                size += behind
                flat = np.append(flat, np.zeros(size, np.uint8))  # the last row has less than that
            if not moved or not 0 < size <= len(flat):
                continue
            to = _cells(wide, at, size)
            if width == 8 and size in (1, 2, 4, 8):
                shift = np.multiply(place.offset, 8, dtype=np.uint64)
                to.view(f"<u{size}")[...] = rows.data.view("<u8").ravel() >> shift
                continue
            if number in self._aligned:
                first = at % size
                cells = flat[first : len(flat) - (-first % size)].view(f"V{size}")
                to[...] = cells.take(starts + (place.offset - first) >> size.bit_length() - 1, mode="clip")
                continue
            cells = np.ndarray(len(flat) - size + 1, f"V{size}", flat, strides=(1,))
            to[...] = cells[np.minimum(starts + place.offset, len(cells) - 1)]
        for at, blank, there in absent:
            wide[~there if isinstance(there, np.ndarray) else slice(None), at : at + len(blank)] = list(blank)
        return wide


def _cells(rows: Array, at: int, size: int) -> Array:
    """Return bytes [at, at + size) of each row as one cell."""
    return np.ndarray(len(rows), f"V{size}", rows, at, (rows.shape[1],))
