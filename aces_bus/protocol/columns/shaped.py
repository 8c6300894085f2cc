"""Columns of fields that are there by bits: finds their places in many packets, and reads them there.

1. Of each packet it says what `Shapes` says of one; how many shapes there are among the packets costs nothing.
2. In a wide row each field stands where a packet with all fields has it; what is not there is any bytes, but the fields in
   `blanks`, which then are as they must be.
3. Numbers are read where they are. Rows are made wide when something else is asked for: bits, bytes, lists, constants.
4. Where packets have all fields (or all but the last ones), their rows are the wide ones already.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from math import gcd
from operator import itemgetter
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
    """The place of a field: the packets that have it (1, else 0; a bool for all of them), and its offset in each packet."""

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
        #: The bytes that are needed to begin with.
        self.reach = max((head.offset + head.size for head in self._heads), default=0)

    def of(
        self, data: Array, starts: Array, width: int = 0
    ) -> tuple[list[FieldPlace], Array | int, Array | int]:
        """Return the places of the fields in packets that begin at `starts` (`width` apart, unless it is 0), where the last
        field ends, and how many bytes say so: of a packet that is cut off before these, places are any.
        """

        def numbers_at(offset: Any, size: int, order: str) -> Array:
            if isinstance(offset, int) and offset + size <= width and size in (1, 2, 4, 8):
                kind = f"{'<' if order == 'little' else '>'}u{size}"
                found: Array = np.ndarray((len(starts),), kind, data, offset, (width,))
            else:
                found = number_at(data, starts + offset, size, order)
            return found.astype(np.uint32 if size <= 4 else np.uint64)

        masks = {head.name: _Mask(numbers_at(head.offset, head.size, head.order)) for head in self._heads}
        end: Any = self.start
        known: Any = self.reach
        places: list[FieldPlace] = []
        for name, (size, _), wire, present in zip(
            self.names, self.sizes, self._wires, self._present, strict=True
        ):
            there = True if present is None else masks[present.selector].has(present.bit)
            places.append(FieldPlace(there, end))
            if wire is not None:
                number = numbers_at(end, wire.size, wire.order)
                masks[name] = _Mask(number if there is True else number * there)
                known = np.maximum(known, there * (end + size))
            if there is not False:
                end = end + (size if there is True else there * size)
        return places, end, known


class _Mask:
    """The numbers of packets, unsigned, whose bits say what is there."""

    def __init__(self, numbers: Array) -> None:
        self._numbers = numbers
        self._some, self._all = (
            int(join.reduce(numbers)) if len(numbers) else 0 for join in (np.bitwise_or, np.bitwise_and)
        )

    def has(self, bit: int) -> Array | bool:
        """Return in which numbers a bit is set, as 1 or 0 (uint32); a bool where it is in all of them or in none."""
        if self._all >> bit & 1 or not self._some >> bit & 1:
            return bool(self._all >> bit & 1)
        return (self._numbers >> bit & 1).astype(np.uint32, copy=False)


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
        self.places = FieldPlaces(shapes)
        self._tail = plan.tail
        *fixed, (least, most) = shapes.sizes
        self._is_open = most is None
        self.reason = ""
        if plan.lengths_by or most not in (least, None) or any(low != high for low, high in fixed):
            self.reason = "fields of several sizes beside fields that are there by bits"
        #: Where each field stands in a wide row, and what stands there when it is absent, if that matters.
        self.layout: list[tuple[int, bytes]] = []
        at = self.places.start
        for size, _ in shapes.sizes:
            blank = bytearray(size)
            inside = [constant for constant in plan.constants if at <= constant.offset < at + size]
            for constant in inside:
                blank[constant.offset - at] |= constant.value
            is_counted = any(at <= node.offset <= at + size for _, node in plan.lists)
            self.layout.append((at, bytes(blank) if inside or is_counted else b""))
            at += size
        self.end = at
        moving = [
            low if isinstance(body, Present) else 0
            for (low, _), (_, body) in zip(shapes.sizes, shapes.items, strict=True)
        ]
        #: Of each field, a number of bytes that divides all distances by which it moves.
        self.steps = [gcd(*moving[:number]) for number in range(len(moving))]

    def of(self, rows: PacketRows) -> WideRows:
        """Return the wide rows of packets."""
        count, width = rows.data.shape
        # uint32 where it is enough: half as many bytes to compute with.
        kind = np.uint32 if count * width < 1 << 31 else np.int64
        starts: Array = np.arange(0, count * width, width, dtype=kind)
        places, end, _ = self.places.of(rows.data.reshape(-1), starts, width)
        there = {name: place.there for name, place in zip(self.places.names, places, strict=True)}
        end, most = end + self._tail, 0
        more: Any = self.end + self._tail
        if self._is_open and places[-1].there is not False:
            behind = np.maximum(rows.lengths.astype(np.int64) - end, 0) * places[-1].there
            end, more, most = end + behind, more + behind, int(behind.max(initial=0))
        fits = rows.lengths == end
        moved = MovedFields(self, rows, starts, places, most)
        return WideRows(type(rows)(moved, np.broadcast_to(more, count), rows.keys), there, fits)


class MovedFields:
    """The fields of packets by the offsets that they have in wide rows; an open field has at most `behind` bytes more than
    its least size.
    """

    def __init__(
        self, shaped: ShapedRows, rows: PacketRows, starts: Array, places: Sequence[FieldPlace], behind: int
    ) -> None:
        self._shaped, self._rows, self._starts, self._places = shaped, rows, starts, places
        self._behind = behind
        self._flat = rows.data.reshape(-1)
        #: Where the rows begin, counted in numbers of a size.
        self._counted: dict[int, Array] = {}
        self._is_moved = [
            place.there is not False and (isinstance(place.offset, np.ndarray) or place.offset != at)
            for place, (at, _) in zip(places, shaped.layout, strict=True)
        ]

    def whole(self, dtype: Any, offset: int) -> Array:
        """Return the numbers at a byte offset of wide rows; 0 where the field is not there."""
        shaped, rows, size = self._shaped, self._rows, np.dtype(dtype).itemsize
        number = bisect_right(shaped.layout, offset, key=itemgetter(0)) - 1
        there = self._places[number].there if number >= 0 else True
        if there is False:
            return np.zeros(len(rows), dtype)
        kind = f"<u{size}"
        if number < 0 or not self._is_moved[number]:
            found = rows.reaching(offset + size).whole(dtype, offset)
        else:
            found = self._gathered(kind, number, offset, size).view(dtype)
        if there is True:
            return found
        cleared: Array = np.multiply(found.view(kind), there, dtype=kind, casting="unsafe")
        return cleared.view(dtype)

    def _gathered(self, kind: str, number: int, offset: int, size: int) -> Array:
        """Return the numbers at an offset of wide rows in a field that does not stand there in all packets."""
        rows, flat, place = self._rows, self._flat, self._places[number].offset
        inside, first, down = offset - self._shaped.layout[number][0], offset % size, size.bit_length() - 1
        if rows.data.shape[1] == 8:
            shift = np.multiply(place + inside, 8, dtype=np.uint64)
            return (rows.data.view("<u8").ravel() >> shift).astype(kind)
        if self._shaped.steps[number] % size:
            cells = np.ndarray(len(flat) - size + 1, kind, flat, strides=(1,))
            moved: Array = cells[np.minimum(self._starts + (place + inside), len(cells) - 1)]
            return moved
        if size not in self._counted:
            self._counted[size] = self._starts >> down
        cells = flat[first : len(flat) - (-first % size)].view(kind)
        index = (place + inside - first if inside != first else place) >> down  # not below 0 on the way
        return cells.take((self._counted[size] + index).astype(np.intp), mode="clip")

    def spread(self) -> Array:
        """Return the bytes of wide rows."""
        shaped, rows, flat, behind = self._shaped, self._rows, self._flat, self._behind
        count, width = rows.data.shape
        fields = list(zip(self._places, shaped.layout, shaped.places.sizes, strict=True))
        absent = [
            (at, blank, place.there) for place, (at, blank), _ in fields if blank and place.there is not True
        ]
        if not any(self._is_moved) and not absent:
            return rows.reaching(shaped.end).data
        wide = np.empty((count, -(-(shaped.end + behind) // 8) * 8), np.uint8)
        # Fields that stand where a packet with all fields has them, and the header.
        same = shaped.layout[self._is_moved.index(True)][0] if any(self._is_moved) else wide.shape[1]
        if same := min(width, same):
            _cells(wide, 0, same)[...] = _cells(rows.data, 0, same)
        for (place, (at, _), (size, most)), moved in zip(fields, self._is_moved, strict=True):
            if most is None:
                size += behind
                flat = np.append(flat, np.zeros(size, np.uint8))  # the last row has less than that
            if not moved or not 0 < size <= len(flat):
                continue
            to = _cells(wide, at, size)
            if size == most and size in (1, 2, 4, 8):
                to.view(f"<u{size}")[...] = self.whole(f"<u{size}", at)
            else:
                cells = np.ndarray(len(flat) - size + 1, f"V{size}", flat, strides=(1,))
                to[...] = cells[np.minimum(self._starts + place.offset, len(cells) - 1)]
        for at, blank, there in absent:
            wide[there == 0 if isinstance(there, np.ndarray) else slice(None), at : at + len(blank)] = list(
                blank
            )
        return wide


def _cells(rows: Array, at: int, size: int) -> Array:
    """Return bytes [at, at + size) of each row as one cell."""
    return np.ndarray(len(rows), f"V{size}", rows, at, (rows.shape[1],))
