"""CAN frames to columns: whole tables of frames at once.

1. The answer is the live scanner's, value for value and bin for bin; frames that hang on others (requests, replies, modes)
   or have no columns go through the live scanner itself, in their order. Of a key that requests share with other messages,
   the frames of requests do.
2. Frames are sorted by what they may be (`key_slots`), not by identifier: one sort a table, then every message is a slice
   (`slot_batch`). Frames of a transport are a slice, too: its packets are a table like that of frames, which goes the same
   way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from ...frame_table import FrameTable
from ..counts import ScanCounts, sum_counts
from ..declare.ambiguity import ordered
from ..declare.message import GivenWay, Message
from ..declare.protocol import Variant
from ..declare.transport import Transport
from ..live.can import CanScanner
from ..live.decide import REMEMBERED
from .key_slots import ERROR_FRAME, LIVE, UNKNOWN, KeySlots
from .reassemble import CarriedTable, ColumnReassembler
from .rows import PacketRows, row_decoder
from .scanner import RecordColumns
from .slot_batch import MessageCandidate, SlotBatch, merge_tables, table_of_lost
from .table import Array, MessageTable


class _Lost(NamedTuple):
    """Frames that are not a message: their places in the table and the reason of each."""

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


class _Carrier:
    """A transport in columns: its packets under way, and the slots of the keys of packets."""

    def __init__(
        self, transport: Transport, slot_of: Callable[[int], int], extra_of: Callable[[int], bytes]
    ) -> None:
        self.transport = transport
        self.reassembler = ColumnReassembler(transport, extra_of)
        self.slots = KeySlots(slot_of)


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
        direction: GivenWay | None = None,
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
        self._candidates: list[tuple[MessageCandidate, ...]] = [(), (), ()]
        self._by_names: dict[tuple[tuple[int, str], ...], int] = {}
        self._decoders: dict[tuple[int, str], MessageCandidate] = {}
        self._slots = KeySlots(self._slot)
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
        """Number of frames so far by their outcome."""
        live = self._scanner.counts
        own = self._counts
        both = sum_counts((own, live))
        both.pending += sum(carrier.reassembler.pending for carrier in self._carriers.values())
        both.total = both.decoded + both.pending + sum(both.reasons.values())
        return both

    # ------------------------------------------------------------------ which messages a key may be

    def _slot(self, key: int, transport: Transport | None = None) -> int:
        """Return the slot of a key: the messages that it may be, in the order in which they are tried. Of a frame that
        a transport carries, the transport; with `transport` the key is that of its packets."""
        if transport is None and (carried := self._scanner.transport_of(key)) is not None:
            return self._carrier_slot(carried)
        names: list[tuple[int, str]] = []
        for number, wire in enumerate(self._wires):
            for message in ordered(wire.candidates(key, transport)):
                if message.name in wire.contextual or self._candidate(number, message).decoder.reason:
                    return LIVE
                names.append((number, message.name))
        if not names:
            return UNKNOWN
        chosen = tuple(names)
        if all(self._decoders[name].is_live for name in chosen):
            return LIVE
        if chosen not in self._by_names:
            self._by_names[chosen] = len(self._candidates)
            self._candidates.append(tuple(self._decoders[name] for name in chosen))
        return self._by_names[chosen]

    def _is_live(self, number: int, message: Message) -> bool:
        """Return whether a message hangs on others, or has no columns."""
        candidate = self._candidate(number, message)
        is_contextual = message.name in self._wires[number].contextual
        return candidate.is_live or is_contextual or bool(candidate.decoder.reason)

    def _carrier_slot(self, transport: Transport) -> int:
        """Return the slot of a transport's frames. Where one of its messages is decided by the live scanner, so are
        all of them: in which order packets are whole, frames say."""
        known = next(
            (slot for slot, carrier in self._carriers.items() if carrier.transport == transport), None
        )
        if known is not None:
            return known
        for number, wire in enumerate(self._wires):
            if any(transport in m.ways and self._is_live(number, m) for m in wire.messages):
                return LIVE
        slot = len(self._candidates)
        self._candidates.append(())
        self._carriers[slot] = _Carrier(
            transport,
            lambda key: self._slot(key, transport),
            lru_cache(REMEMBERED)(partial(self._extra_of, transport)),
        )
        return slot

    def _extra_of(self, transport: Transport, key: int) -> bytes:
        """Return the `check_extra` of the first message that a packet's key may be of."""
        candidates = (m for wire in self._wires for m in wire.candidates(key, transport))
        return next((m.check_extra for m in candidates), b"")

    def _candidate(self, number: int, message: Message) -> MessageCandidate:
        name = (number, message.name)
        if name not in self._decoders:
            variant = self.variants[number]
            decoder = row_decoder(message, raw=self.raw)
            context = self._wires[number].context
            is_live = message.name in context.requests or message.name in context.answers
            self._decoders[name] = MessageCandidate(message, decoder, variant.name, number, is_live)
        return self._decoders[name]

    # ------------------------------------------------------------------ feeding

    def feed(self, table: FrameTable, rows: Array | None = None, /) -> list[MessageTable]:
        """Decode a piece of a capture; return its tables, one a message that occurs in it.

        `rows` are the frames' numbers in the capture, rising; by default they go on where the last piece ended.
        """
        if not len(table):
            return []
        slots = self._slots.of(table)
        if rows is None:
            rows = np.arange(self._fed, self._fed + len(table))
        self._fed += len(table)
        batch = SlotBatch(table, slots, rows, len(self._candidates))
        lost: list[_Lost] = []
        tables: list[MessageTable] = []
        older: list[MessageTable] = []
        live: list[Array] = []
        for slot, start, end in batch.slices:
            if slot == LIVE or (self._defer and slot in self._carriers):
                live.append(batch.order[start:end])
            elif slot in self._carriers:
                some, numbers = table, rows
                if end - start < len(table):
                    places = batch.order[start:end]
                    some, numbers = table.take(places), rows[places]
                self._carried(self._carriers[slot], some, numbers, tables, older)
            elif slot in (UNKNOWN, ERROR_FRAME):
                self._lose(
                    batch, batch.order[start:end], "unknown" if slot == UNKNOWN else "error frame", lost
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

    def _lose(self, batch: SlotBatch, places: Array, reason: str, lost: list[_Lost]) -> None:
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
        """Decode frames of a transport, `rows` of the capture: packets go the way of frames; `older` are losses."""
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
                older.append(table_of_lost(decided.table, decided.rows, places, reasons))

    def _packets(
        self, carrier: _Carrier, carried: CarriedTable, tables: list[MessageTable]
    ) -> list[tuple[Array, list[str]]]:
        """Decode packets of a transport; return the frames of those that are not a message."""
        slots = carrier.slots.of(carried.packets)
        batch = SlotBatch(
            carried.packets, slots, carried.rows, len(self._candidates), carrier.transport, carried
        )
        lost: list[_Lost] = []
        for slot, start, end in batch.slices:
            if slot == UNKNOWN:
                self._lose(batch, batch.order[start:end], "unknown", lost)
            else:
                self._decode(batch, start, end, self._candidates[slot], tables, lost)
        return [
            (carried.frames_of(place), [reason] * int(carried.counts[place]))
            for loss in lost
            for place, reason in zip(loss.places.tolist(), loss.reasons, strict=True)
        ]

    def close(self) -> list[MessageTable]:
        """End a capture: frames of packets that are not whole are pending. Other frames are whole."""
        tables = self._slow.close()
        for carrier in self._carriers.values():
            left, rows = carrier.reassembler.close()
            self._counts.pending += len(rows)
            if len(rows):
                tables.append(table_of_lost(left, rows, np.arange(len(rows)), ["pending"] * len(rows)))
        return merge_tables(tables) if self.include_unknown else []

    def _decode(
        self,
        batch: SlotBatch,
        start: int,
        end: int,
        candidates: tuple[MessageCandidate, ...],
        tables: list[MessageTable],
        lost: list[_Lost],
    ) -> list[Array]:
        """Return the frames [start, end) of the sorted batch, which may be these messages. Gives the places of those
        that are left to the live scanner."""
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
        batch: SlotBatch,
        start: int,
        end: int,
        which: Array | None,
        candidate: MessageCandidate,
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
        batch: SlotBatch,
        places: Array,
        tables: list[MessageTable],
        lost: list[_Lost],
        older: list[MessageTable],
    ) -> None:
        """Decode frames by the live scanner, in their order; `older` are losses of frames of earlier pieces."""
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
        self, candidates: tuple[MessageCandidate, ...], rows: PacketRows, transport: Transport | None
    ) -> list[str]:
        """Say why frames, or packets of a transport, are not a message that their identifier allows."""
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

    def _lost_table(self, batch: SlotBatch, lost: Sequence[_Lost]) -> MessageTable:
        places = np.concatenate([loss.places for loss in lost])
        return table_of_lost(
            batch.table, batch.numbers, places, [reason for loss in lost for reason in loss.reasons]
        )

    # ------------------------------------------------------------------ rolling counters

    def _count_missed(self, candidate: MessageCandidate, table: MessageTable, rows: PacketRows) -> None:
        """Count the messages that rolling counters show as missed, by channel and key."""
        message = candidate.message
        raw = row_decoder(message, raw=True)
        kinds = {kind.name: kind for kind in raw.kinds}
        who = table.channel.astype(np.uint64) << np.uint64(32) | table.key.astype(np.uint64)
        for name, modulo in message.counters.items():
            values = raw.column(kinds[name], rows).values.astype(np.int64)
            for party in np.unique(who).tolist():
                mine = values[who == party]
                self._counts.missed += int(((mine[1:] - mine[:-1] - 1) % modulo).sum())
                channel = table.channels.names[party >> 32]
                place = (candidate.wire, message.name, name, channel, party & 0xFFFF_FFFF)
                self._go_on(place, int(mine[0]), int(mine[-1]), modulo)

    def _go_on(self, place: _Who, first: int, last: int, modulo: int) -> None:
        """Continue a counter from its last known value."""
        known = self._counters.get(place)
        if known is not None:
            self._counts.missed += (first - known[1] - 1) % modulo
        if known is not None or len(self._counters) < REMEMBERED:
            self._counters[place] = (first if known is None else known[0], last, modulo)

    # ------------------------------------------------------------------ several processes

    def hand_over(self) -> Handover:
        """Return what has been seen since the last call, for `adopt`; this scanner then begins anew."""
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
