"""A table of frames, or of packets, sorted by slots: every message is a slice of it.

The sort is stable, so a message's frames stay in the order of the capture.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ...frame_table import FrameFlag, FrameTable, rows_at
from ..declare.message import Message
from ..declare.transport import Transport
from .reassemble import CarriedTable
from .rows import PacketRows, RowDecoder
from .table import Array, Column, ColumnKind, MessageTable, by_message, lost_table, object_array


class MessageCandidate(NamedTuple):
    """A message of one of the variants, with what decodes it."""

    message: Message
    decoder: RowDecoder
    protocol: str
    #: The number of its variant.
    wire: int
    #: Whether replies hang on it, or it uses up a request: its frames are the live scanner's.
    is_live: bool


class SlotBatch:
    """A table of frames in the order of their slots; the sorted columns are made once."""

    def __init__(
        self,
        table: FrameTable,
        slots: Array,
        numbers: Array,
        top: int,
        transport: Transport | None = None,
        carried: CarriedTable | None = None,
    ) -> None:
        self.table = table
        self._slots, self._top = slots, top
        #: Each slot that occurs, with its part of the sorted columns.
        self.slices: list[tuple[int, int, int]]
        self._is_sorted = slots.strides == (0,) or bool((slots[0] == slots).all())
        if self._is_sorted:
            self.slices = [(int(slots[0]), 0, len(slots))]
        else:
            ends = np.cumsum(np.bincount(slots, minlength=top)).tolist()
            self.slices = [
                (slot, start, end) for slot, (start, end) in enumerate(pairwise([0, *ends])) if end > start
            ]
        #: Where the frames are packets: of which transport, and what they are made of.
        self.transport, self.carried = transport, carried
        #: The frames' numbers in the capture, in the table's order.
        self.numbers = numbers

    @cached_property
    def order(self) -> Array:
        """The places of the frames, slot behind slot."""
        slots = self._slots
        if self._is_sorted:
            return np.arange(len(slots))
        return np.argsort(slots.astype(np.uint16) if self._top < 1 << 16 else slots, kind="stable")

    # The sorted columns, made when some message of the table is decoded.

    @cached_property
    def _row(self) -> Array:
        first, last = self.numbers[[0, -1]]
        if last - first == len(self.numbers) - 1:  # they rise: none is left out
            rising: Array = self.order + first
            return rising
        return self._in_order(self.numbers)

    @cached_property
    def _data(self) -> Array:
        return self.table.data if self._is_sorted else rows_at(self.table.data, self.order)

    @cached_property
    def _lengths(self) -> Array:
        flags = self.table.flags
        length = self._in_order(self.table.length)
        if int(np.bitwise_or.reduce(flags)) & FrameFlag.REMOTE:
            # A remote frame's number is what it asks for; data it has none.
            return np.where(flags[self.order] & FrameFlag.REMOTE, 0, length)
        return length

    @cached_property
    def _keys(self) -> Array:
        return self._in_order(self.table.key)

    @cached_property
    def _time(self) -> Array:
        return self._in_order(self.table.time)

    @cached_property
    def _channel(self) -> Array:
        return self._in_order(self.table.channel)

    @cached_property
    def _rx(self) -> Array:
        flags = self.table.flags
        is_said = int(np.bitwise_or.reduce(flags)) & (FrameFlag.RX | FrameFlag.TX)
        return self._in_order(_way(flags)) if is_said else np.full(len(flags), 2, np.uint8)

    def _in_order(self, column: Array) -> Array:
        """Return a column in the order of slots; one that is the same throughout, as most are, costs little."""
        if self._is_sorted:
            return column
        first = column[0]
        if first == column[-1] and (column == first).all():
            return np.broadcast_to(first, column.shape)
        found: Array = column.take(self.order)  # a fifth quicker than an index
        return found

    def some(self, start: int, end: int, which: Array | None) -> Array:
        """Return the places of those of [start, end) that are named (None: all)."""
        places = self.order[start:end]
        return places if which is None else places[which]

    def frames_of(self, places: Any) -> int:
        """Return how many frames there are at some places."""
        counts = (
            self.carried.counts[places] if self.carried is not None else np.ones(np.shape(places), np.int64)
        )
        return int(counts.sum())

    def rows(self, start: int, end: int) -> PacketRows:
        """Return the frames [start, end) as rows."""
        return PacketRows(self._data[start:end], self._lengths[start:end], self._keys[start:end])

    def message_table(
        self, start: int, end: int, which: Array | None, candidate: MessageCandidate, rows: PacketRows
    ) -> MessageTable:
        """Return the table of the frames `which` (None: all) of [start, end), whose bytes are `rows`."""

        def some(column: Array) -> Array:
            part = column[start:end]
            return part if which is None else part[which]

        message, decoder, protocol, *_ = candidate

        def make(kind: ColumnKind) -> Column:
            return decoder.column(kind, rows)

        return MessageTable(
            protocol,
            message.name,
            message.direction,
            False,
            some(self._time),
            some(self._channel),
            self.table.channels,
            some(self._keys),
            some(self._row),
            some(self._rx),
            decoder.kinds,
            make,
            message.doc,
            frames=None if self.carried is None else self.carried.counts[self.some(start, end, which)],
            first_time=None
            if self.carried is None
            else self.carried.first_time[self.some(start, end, which)],
        )


def table_of_lost(table: FrameTable, rows: Array, places: Array, reasons: Sequence[str]) -> MessageTable:
    """Return the table of frames that are lost, by their places, in the order of the capture."""
    by_place = np.argsort(places, kind="stable")
    places = places[by_place]
    some = table.take(places)
    return lost_table(
        object_array(reasons)[by_place],
        lambda: object_array([frame.data for frame in some.frames()]),
        is_stream=False,
        time=some.time,
        channel=some.channel,
        channels=some.channels,
        key=some.key,
        row=rows[places],
        rx=_way(some.flags),
    )


def _way(flags: Array) -> Array:
    """Return 1 for received, 0 for sent, 2 where it is not said."""
    return np.where(flags & FrameFlag.RX, 1, np.where(flags & FrameFlag.TX, 0, 2)).astype(np.uint8)


def merge_tables(tables: Iterable[MessageTable]) -> list[MessageTable]:
    """Merge tables to one a message, in the order of the capture."""
    merged: list[MessageTable] = []
    for some in by_message(tables):
        whole = MessageTable.concat(some)
        merged.append(whole if len(some) == 1 else whole.take(np.argsort(whole.row, kind="stable")))
    return merged


__all__ = ["MessageCandidate", "SlotBatch", "merge_tables", "table_of_lost"]
