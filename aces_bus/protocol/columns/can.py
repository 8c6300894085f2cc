"""CAN frames to columns: whole tables of frames at once.

1. The answer is the live scanner's, value for value and bin for bin; frames that hang on others (requests, replies, modes)
   or have no columns go through the live scanner itself, in their order. Of a key that requests share with other messages,
   the frames of requests do.
2. Frames are sorted by what they may be, not by identifier: one sort a table, then every message is a slice.

The sort is stable, so a message's frames stay in the order of the capture. What an identifier may be is looked up once:
in an array for 11-bit identifiers, in a sorted list for all other keys. Frames of a transport are a slice, too: its packets
are a table like that of frames, which goes the same way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np

from ...frame_table import ERROR, RX, TX, UNUSUAL, FrameTable, rows_at
from ...frame_table import REMOTE as REMOTE_FLAG
from ..counts import ScanCounts, sum_counts
from ..declare.ambiguity import ordered
from ..declare.message import Direction, Message
from ..declare.protocol import Variant
from ..declare.transport import Transport
from ..live.can import CanScanner
from ..live.channels import ChannelScanners
from ..live.decide import REMEMBERED
from .key_numbers import KeyNumbers, few_keys
from .reassemble import CarriedTable, ColumnReassembler
from .rows import PacketRows, RowDecoder
from .scanner import RecordColumns
from .table import Array, Column, ColumnKind, MessageTable, by_message, lost_table, object_array

STANDARD = 0x800

# What a slot's frames are, beside the messages that have decoders.
_UNKNOWN, _ERROR, _LIVE = range(3)


class _Candidate(NamedTuple):
    """A message of one of the variants, with what decodes it."""

    message: Message
    decoder: RowDecoder
    protocol: str
    #: The number of its variant.
    wire: int
    #: Whether replies hang on it, or it uses up a request: its frames are the live scanner's.
    is_live: bool


class _Lost(NamedTuple):
    """Frames that are no message: their places in the table and the reason of each."""

    places: Array
    reasons: list[str]


#: A rolling counter of one device: protocol's place, message, field, channel, key.
_Who = tuple[int, str, str, str | None, int]


@dataclass
class Handover:
    """What one process leaves to another when they share a capture; see `CanColumns.hand_over`. It can be pickled."""

    counts: ScanCounts
    #: Frames that hang on others, and their numbers in the piece.
    deferred: list[tuple[FrameTable, Array]]
    #: Of each rolling counter: its first and last value in the piece, and its modulus.
    counters: dict[_Who, tuple[int, int, int]]
    frames: int


class _KeySlots:
    """The slots of keys; what each is, `slot_of` says once."""

    def __init__(self, slot_of: Callable[[int], int]) -> None:
        self._slot = slot_of
        #: Slots of 11-bit data frames; −1 not looked up yet.
        self._standard = np.full(STANDARD, -1, np.int32)
        #: All other keys that were looked up, and their slots.
        self._keys = KeyNumbers()
        self._slots = np.empty(0, np.int32)
        self._by_place = self._slots

    def of(self, table: FrameTable) -> Array:
        """The slot of each frame, int32 (n,)."""
        flags = table.flags
        any_flags = int(np.bitwise_or.reduce(flags)) if len(flags) else 0
        if len(self._keys) < REMEMBERED and not any_flags & ERROR and (few := few_keys(table.key)):
            slots = self._other_slots(few.present())
            if (slots == slots[0]).all():
                return np.broadcast_to(slots[0], len(table))
        if not any_flags & UNUSUAL:
            return self._standard_slots(table.id)
        key = table.key
        if (flags[0] == flags).all() and not any_flags & ERROR:
            return self._other_slots(key)
        slots = np.empty(len(table), np.int32)
        plain = (flags & UNUSUAL) == 0
        slots[plain] = self._standard_slots(table.id[plain])
        errors = (flags & ERROR) != 0
        slots[errors] = _ERROR
        others = ~(plain | errors)
        if others.any():
            slots[others] = self._other_slots(key[others])
        return slots

    def _standard_slots(self, identifiers: Array) -> Array:
        if len(identifiers) and int(identifiers.max()) >= STANDARD:
            return self._other_slots(identifiers)  # no frame of a bus, but a table may hold it
        slots: Array = self._standard.take(identifiers)
        if len(slots) and int(slots.min()) < 0:
            is_new = np.zeros(STANDARD, bool)
            is_new[identifiers] = True
            for key in np.flatnonzero(is_new & (self._standard < 0)).tolist():
                self._standard[key] = self._slot(key)
            slots = self._standard.take(identifiers)
        return slots

    def _other_slots(self, keys: Array) -> Array:
        if len(self._keys) < REMEMBERED:
            places = self._keys.places(keys)
            if len(new := self._keys.known[len(self._slots) :]):
                slots = [self._slot(key) for key in new.tolist()]
                self._slots = np.concatenate([self._slots, np.array(slots, np.int32)])
                self._by_place = self._keys.by_place(self._slots)
            found: Array = self._by_place.take(places)
            return found
        unique, inverse = np.unique(keys, return_inverse=True)
        return np.array([self._slot(key) for key in unique.tolist()], np.int32)[inverse]


class _Carrier:
    """A transport in columns: its packets under way, and the slots of the keys of packets."""

    def __init__(
        self, transport: Transport, slot_of: Callable[[int], int], extra_of: Callable[[int], bytes]
    ) -> None:
        self.transport = transport
        self.reassembler = ColumnReassembler(transport, extra_of)
        self.slots = _KeySlots(slot_of)


class CanColumns:
    """The column scanner of CAN; made by `make_column_scanner`.

    Several processes can share a capture: each has a scanner with `defer`, which leaves frames that hang on others
    alone, and one process, given every `hand_over` in the order of the capture, decodes these (`adopt`).
    """

    link = "can"

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: Direction | Literal["both"] | None = None,
        include_unknown: bool = False,
        raw: bool = False,
        defer: bool = False,
    ) -> None:
        self.variants = tuple(variants)
        self._defer = defer
        self._deferred: list[tuple[FrameTable, Array]] = []
        self.include_unknown = include_unknown
        self.raw = raw
        # What takes the slow way: it also gives the reasons of losses.
        self._scanner = CanScanner(variants, direction=direction, include_unknown=True, raw=raw)
        self._slow = RecordColumns(variants, include_unknown=True, raw=raw, scanner=self._scanner)
        self._wires = self._scanner.wires
        self._candidates: list[tuple[_Candidate, ...]] = [(), (), ()]
        self._by_names: dict[tuple[tuple[int, str], ...], int] = {}
        self._decoders: dict[tuple[int, str], _Candidate] = {}
        self._slots = _KeySlots(self._slot)
        #: The transports whose packets are decoded in columns, by their slots.
        self._carriers: dict[int, _Carrier] = {}
        self._counts = ScanCounts()
        self._fed = 0
        self._reasons: dict[tuple[Transport | None, int, int], str] = {}
        self._counters: dict[_Who, tuple[int, int, int]] = {}

    @property
    def contested(self) -> Mapping[int, tuple[str, str]]:
        """Keys that two protocols claim, with their names, first the one that wins."""
        return self._scanner.contested

    @property
    def counts(self) -> ScanCounts:
        """Where every frame went so far."""
        live = self._scanner.counts
        own = self._counts
        both = sum_counts((own, live))
        both.pending += sum(carrier.reassembler.pending for carrier in self._carriers.values())
        both.total = both.decoded + both.pending + sum(both.reasons.values())
        return both

    # ------------------------------------------------------------------ which messages a key may be

    def _slot(self, key: int, transport: Transport | None = None) -> int:
        """The slot of a key: the messages that it may be, in the order in which they are tried. Of a frame that a transport
        carries, the transport; with `transport` the key is that of its packets."""
        if transport is None and (carried := self._scanner.transport_of(key)) is not None:
            return self._carrier_slot(carried)
        names: list[tuple[int, str]] = []
        for number, wire in enumerate(self._wires):
            for message in ordered(wire.candidates(key, transport)):
                if message.name in wire.contextual or self._candidate(number, message).decoder.reason:
                    return _LIVE
                names.append((number, message.name))
        if not names:
            return _UNKNOWN
        chosen = tuple(names)
        if all(self._decoders[name].is_live for name in chosen):
            return _LIVE
        if chosen not in self._by_names:
            self._by_names[chosen] = len(self._candidates)
            self._candidates.append(tuple(self._decoders[name] for name in chosen))
        return self._by_names[chosen]

    def _is_live(self, number: int, message: Message) -> bool:
        """Whether a message hangs on others, or has no columns."""
        candidate = self._candidate(number, message)
        is_contextual = message.name in self._wires[number].contextual
        return candidate.is_live or is_contextual or bool(candidate.decoder.reason)

    def _carrier_slot(self, transport: Transport) -> int:
        """The slot of a transport's frames. Where one of its messages is decided by the live scanner, so are all of them: in
        which order packets are whole, frames say."""
        known = next((slot for slot, one in self._carriers.items() if one.transport == transport), None)
        if known is not None:
            return known
        for number, wire in enumerate(self._wires):
            if any(m.transport == transport and self._is_live(number, m) for m in wire.messages):
                return _LIVE
        slot = len(self._candidates)
        self._candidates.append(())
        self._carriers[slot] = _Carrier(
            transport,
            lambda key: self._slot(key, transport),
            lru_cache(REMEMBERED)(partial(self._extra_of, transport)),
        )
        return slot

    def _extra_of(self, transport: Transport, key: int) -> bytes:
        """The `check_extra` of the first message that a packet's key may be of."""
        candidates = (m for wire in self._wires for m in wire.candidates(key, transport))
        return next((m.check_extra for m in candidates), b"")

    def _candidate(self, number: int, message: Message) -> _Candidate:
        name = (number, message.name)
        if name not in self._decoders:
            variant = self.variants[number]
            decoder = RowDecoder(message.plan, raw=self.raw, message=message)
            context = self._wires[number].context
            is_live = message.name in context.requests or message.name in context.answers
            self._decoders[name] = _Candidate(message, decoder, variant.name, number, is_live)
        return self._decoders[name]

    # ------------------------------------------------------------------ feeding

    def feed(self, table: FrameTable, rows: Array | None = None, /) -> list[MessageTable]:
        """The tables of a piece of a capture, one a message that occurs in it.

        `rows` are the frames' numbers in the capture, rising; by default they go on where the last piece ended.
        """
        if not len(table):
            return []
        slots = self._slots.of(table)
        if rows is None:
            rows = np.arange(self._fed, self._fed + len(table))
        self._fed += len(table)
        batch = _Batch(table, slots, rows, len(self._candidates))
        lost: list[_Lost] = []
        tables: list[MessageTable] = []
        older: list[MessageTable] = []
        live: list[Array] = []
        for slot, start, end in batch.slices:
            if slot == _LIVE or (self._defer and slot in self._carriers):
                live.append(batch.order[start:end])
            elif slot in self._carriers:
                some, numbers = table, rows
                if end - start < len(table):
                    places = batch.order[start:end]
                    some, numbers = table.take(places), rows[places]
                self._carried(self._carriers[slot], some, numbers, tables, older)
            elif slot in (_UNKNOWN, _ERROR):
                self._lose(
                    batch, batch.order[start:end], "unknown" if slot == _UNKNOWN else "error frame", lost
                )
            else:
                live += self._decode(batch, start, end, self._candidates[slot], tables, lost)
        if live:
            places = live[0] if len(live) == 1 else np.sort(np.concatenate(live))
            self._live(batch, places, tables, lost, older)
        out = merge_tables(tables)
        if self.include_unknown and (lost or older):
            out += merge_tables([*older, self._lost_table(batch, lost)] if lost else older)
        return out

    def _lose(self, batch: _Batch, places: Array, reason: str, lost: list[_Lost]) -> None:
        self._counts.lose(batch.frames_of(places), reason)
        if self.include_unknown:
            lost.append(_Lost(places, [reason] * len(places)))

    def _carried(
        self,
        carrier: _Carrier,
        table: FrameTable,
        rows: Array,
        tables: list[MessageTable],
        older: list[MessageTable],
    ) -> None:
        """Frames of a transport, `rows` of the capture: packets go the way of frames; `older` are losses."""
        decided = carrier.reassembler.feed(table, rows)
        lost: list[tuple[Array, list[str]]] = [(decided.lost, decided.reasons)]
        for reason, number in Counter(decided.reasons).items():
            self._counts.lose(number, reason)
        for carried in decided.packets:
            lost += self._packets(carrier, carried, tables)
        if self.include_unknown:
            places = np.concatenate([places for places, _ in lost])
            if len(places):
                reasons = [reason for _, some in lost for reason in some]
                older.append(_losses(decided.table, decided.rows, places, reasons))

    def _packets(
        self, carrier: _Carrier, carried: CarriedTable, tables: list[MessageTable]
    ) -> list[tuple[Array, list[str]]]:
        """Packets of a transport: their messages, and the frames of those that are none."""
        slots = carrier.slots.of(carried.packets)
        batch = _Batch(
            carried.packets, slots, carried.rows, len(self._candidates), carrier.transport, carried
        )
        lost: list[_Lost] = []
        for slot, start, end in batch.slices:
            if slot == _UNKNOWN:
                self._lose(batch, batch.order[start:end], "unknown", lost)
            else:
                self._decode(batch, start, end, self._candidates[slot], tables, lost)
        return [
            (carried.frames_of(place), [reason] * int(carried.counts[place]))
            for one in lost
            for place, reason in zip(one.places.tolist(), one.reasons, strict=True)
        ]

    def close(self) -> list[MessageTable]:
        """The end of a capture: frames of packets that are not whole are pending. Other frames are whole."""
        tables = self._slow.close()
        for carrier in self._carriers.values():
            left, rows = carrier.reassembler.close()
            self._counts.pending += len(rows)
            if len(rows):
                tables.append(_losses(left, rows, np.arange(len(rows)), ["pending"] * len(rows)))
        return merge_tables(tables) if self.include_unknown else []

    def _decode(
        self,
        batch: _Batch,
        start: int,
        end: int,
        candidates: tuple[_Candidate, ...],
        tables: list[MessageTable],
        lost: list[_Lost],
    ) -> list[Array]:
        """The frames [start, end) of the sorted batch, which may be these messages. Gives the places of those that are left
        to the live scanner."""
        live: list[Array] = []
        rows: PacketRows = batch.rows(start, end).reaching(max(c.decoder.extent for c in candidates))
        left: Array | None = None  # places in [start, end) that no message has accepted yet; None: all
        for candidate in candidates:
            good = candidate.decoder.accepts(rows)
            if good is None:
                if candidate.is_live:
                    live.append(batch.some(start, end, left))
                else:
                    self._add(batch, start, end, left, candidate, rows, tables)
                return live
            if good.any():
                mine = np.flatnonzero(good)
                taken = mine if left is None else left[mine]
                if candidate.is_live:
                    live.append(batch.some(start, end, taken))
                else:
                    self._add(batch, start, end, taken, candidate, rows.take(mine), tables)
                rest = np.flatnonzero(~good)
                left = rest if left is None else left[rest]
                rows = rows.take(rest)
        places = batch.some(start, end, left)
        reasons = self._why(candidates, rows, batch.transport)
        for place, reason in zip(places.tolist(), reasons, strict=True):
            self._counts.lose(batch.frames_of(place), reason)
        lost.append(_Lost(places, reasons))
        return live

    def _add(
        self,
        batch: _Batch,
        start: int,
        end: int,
        which: Array | None,
        candidate: _Candidate,
        rows: PacketRows,
        tables: list[MessageTable],
    ) -> None:
        table = batch.message_table(start, end, which, candidate, rows)
        self._counts.records += len(rows)
        self._counts.decoded += (
            len(rows) if batch.transport is None else batch.frames_of(batch.some(start, end, which))
        )
        if candidate.message.counters:
            self._count_missed(candidate, table, rows)
        tables.append(table)

    def _live(
        self,
        batch: _Batch,
        places: Array,
        tables: list[MessageTable],
        lost: list[_Lost],
        older: list[MessageTable],
    ) -> None:
        """Frames that the live scanner decides, in their order; `older` are losses of frames of earlier pieces."""
        some = batch.table.take(places)
        if self._defer:
            self._deferred.append((some, batch.numbers[places]))
            return
        for table in self._slow.frames(some, batch.numbers[places]):
            if table.message:
                tables.append(table)
            elif self.include_unknown:
                is_old = table.row < batch.numbers[0]
                if is_old.any():
                    older.append(table.take(np.flatnonzero(is_old)))
                    table = table.take(np.flatnonzero(~is_old))
                lost.append(_Lost(np.searchsorted(batch.numbers, table.row), table["reason"].values.tolist()))

    # ------------------------------------------------------------------ losses

    def _why(
        self, candidates: tuple[_Candidate, ...], rows: PacketRows, transport: Transport | None
    ) -> list[str]:
        """Why frames, or packets of a transport, are none of the messages that their identifier allows."""
        by_length = not any(c.decoder.plan.constants or c.decoder.plan.one_of for c in candidates)
        out = []
        width = rows.data.shape[1]
        raw = rows.data.tobytes()
        pairs = zip(rows.keys.tolist(), rows.lengths.tolist(), strict=True)
        for index, (key, length) in enumerate(pairs):
            known = by_length and not any(
                c.decoder.plan.lengths is None or length in c.decoder.plan.lengths for c in candidates
            )
            reason = self._reasons.get((transport, key, length)) if known else None
            if reason is None:
                data = raw[index * width : index * width + length]
                reasons = [wire.reason(key, data, transport) for wire in self._wires]
                reason = next((r for r in reasons if r != "unknown"), "unknown")
                if known and len(self._reasons) < REMEMBERED:
                    self._reasons[transport, key, length] = reason
            out.append(reason)
        return out

    def _lost_table(self, batch: _Batch, lost: Sequence[_Lost]) -> MessageTable:
        places = np.concatenate([one.places for one in lost])
        return _losses(batch.table, batch.numbers, places, [reason for one in lost for reason in one.reasons])

    # ------------------------------------------------------------------ rolling counters

    def _count_missed(self, candidate: _Candidate, table: MessageTable, rows: PacketRows) -> None:
        """What the rolling counters of a message say was missed, by channel and key."""
        message = candidate.message
        raw = candidate.decoder if self.raw else RowDecoder(candidate.decoder.plan, raw=True, message=message)
        kinds = {kind.name: kind for kind in raw.kinds}
        who = table.channel.astype(np.uint64) << np.uint64(32) | table.key.astype(np.uint64)
        for name, modulo in message.counters.items():
            values = raw.column(kinds[name], rows).values.astype(np.int64)
            for one in np.unique(who).tolist():
                mine = values[who == one]
                self._counts.missed += int(((mine[1:] - mine[:-1] - 1) % modulo).sum())
                channel = table.channels.names[one >> 32]
                place = (candidate.wire, message.name, name, channel, one & 0xFFFF_FFFF)
                self._go_on(place, int(mine[0]), int(mine[-1]), modulo)

    def _go_on(self, place: _Who, first: int, last: int, modulo: int) -> None:
        """A counter goes on from what was last seen of it."""
        known = self._counters.get(place)
        if known is not None:
            self._counts.missed += (first - known[1] - 1) % modulo
        if known is not None or len(self._counters) < REMEMBERED:
            self._counters[place] = (first if known is None else known[0], last, modulo)

    # ------------------------------------------------------------------ several processes

    def hand_over(self) -> Handover:
        """What has been seen since the last call, for `adopt`; this scanner then begins anew."""
        given = Handover(self._counts, self._deferred, self._counters, self._fed)
        self._counts, self._deferred, self._counters, self._fed = ScanCounts(), [], {}, 0
        return given

    def adopt(self, given: Handover, first: int | None = None) -> list[MessageTable]:
        """Go on behind a piece that another process has decoded: the tables of the frames that it left.

        `first` is the number in the capture of the piece's first frame, by default where the last piece ended.
        """
        if first is None:
            first = self._fed
        self._counts.decoded += given.counts.decoded
        self._counts.records += given.counts.records
        self._counts.missed += given.counts.missed
        for reason, number in given.counts.reasons.items():
            self._counts.lose(number, reason)
        for place, (first, last, modulo) in given.counters.items():
            self._go_on(place, first, last, modulo)
        tables: list[MessageTable] = []
        fed = self._fed
        for table, rows in given.deferred:
            tables += self.feed(table, rows + first)
        self._fed = fed + given.frames
        return merge_tables(tables)


class _Batch:
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
        return self._in_order(self.numbers)

    @cached_property
    def _data(self) -> Array:
        return self.table.data if self._is_sorted else rows_at(self.table.data, self.order)

    @cached_property
    def _lengths(self) -> Array:
        flags = self.table.flags
        length = self._in_order(self.table.length)
        if int(np.bitwise_or.reduce(flags)) & REMOTE_FLAG:
            # A remote frame's number is what it asks for; data it has none.
            return np.where(flags[self.order] & REMOTE_FLAG, 0, length)
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
        is_said = int(np.bitwise_or.reduce(flags)) & (RX | TX)
        return self._in_order(_way(flags)) if is_said else np.full(len(flags), 2, np.uint8)

    def _in_order(self, column: Array) -> Array:
        """A column in the order of slots; one that is the same throughout, as most are, costs little."""
        if self._is_sorted:
            return column
        first = column[0]
        if first == column[-1] and (column == first).all():
            return np.broadcast_to(first, column.shape)
        found: Array = column[self.order]
        return found

    def some(self, start: int, end: int, which: Array | None) -> Array:
        """The places of those of [start, end) that are named (None: all)."""
        places = self.order[start:end]
        return places if which is None else places[which]

    def frames_of(self, places: Any) -> int:
        """How many frames there are at some places."""
        counts = (
            self.carried.counts[places] if self.carried is not None else np.ones(np.shape(places), np.int64)
        )
        return int(counts.sum())

    def rows(self, start: int, end: int) -> PacketRows:
        """The frames [start, end) as rows."""
        return PacketRows(self._data[start:end], self._lengths[start:end], self._keys[start:end])

    def message_table(
        self, start: int, end: int, which: Array | None, candidate: _Candidate, rows: PacketRows
    ) -> MessageTable:
        """The table of the frames `which` (None: all) of [start, end), whose bytes are `rows`."""

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


def _losses(table: FrameTable, rows: Array, places: Array, reasons: Sequence[str]) -> MessageTable:
    """The table of frames that are lost, by their places, in the order of the capture."""
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
    """1 received, 0 sent, 2 not said."""
    return np.where(flags & RX, 1, np.where(flags & TX, 0, 2)).astype(np.uint8)


def merge_tables(tables: Iterable[MessageTable]) -> list[MessageTable]:
    """One table a message, in the order of the capture."""
    merged: list[MessageTable] = []
    for some in by_message(tables):
        whole = MessageTable.concat(some)
        merged.append(whole if len(some) == 1 else whole.take(np.argsort(whole.row, kind="stable")))
    return merged


class ChannelColumns(ChannelScanners[CanColumns]):
    """The column scanner of several channels; made by `make_column_scanner` when a protocol is bound to one."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: Direction | Literal["both"] | None = None,
        include_unknown: bool = False,
        raw: bool = False,
        defer: bool = False,
    ) -> None:
        super().__init__(
            variants,
            lambda mine: CanColumns(
                mine, direction=direction, include_unknown=include_unknown, raw=raw, defer=defer
            ),
        )
        self._fed = 0

    def hand_over(self) -> dict[str | None, Handover]:
        """What has been seen since the last call, by channel; see `CanColumns.hand_over`."""
        given = {channel: scanner.hand_over() for channel, scanner in self._scanners.items()}
        frames, self._fed = self._fed, 0
        return {channel: replace(one, frames=frames) for channel, one in given.items()}

    def adopt(self, given: Mapping[str | None, Handover]) -> list[MessageTable]:
        """Go on behind a piece that another process has decoded: the tables of the frames that it left."""
        tables: list[MessageTable] = []
        for channel, one in given.items():
            scanner = self.of(channel)
            tables += scanner.adopt(one, self._fed)
        self._fed += max((one.frames for one in given.values()), default=0)
        return merge_tables(tables)

    def feed(self, table: FrameTable, /) -> list[MessageTable]:
        """The tables of a piece of a capture, one a message that occurs in it."""
        tables: list[MessageTable] = []
        for number in np.unique(table.channel).tolist():
            places: Array = np.flatnonzero(table.channel == number)
            scanner = self.of(table.channels.names[number])
            tables += scanner.feed(table.take(places), places + self._fed)
        self._fed += len(table)
        return merge_tables(tables)

    def close(self) -> list[MessageTable]:
        """The end of a capture; see `CanColumns.close`."""
        return merge_tables(table for scanner in self._scanners.values() for table in scanner.close())
