"""Which message each of many packets is, and their tables.

1. A packet is what the live decider makes of it: the first message, in order of trial, that accepts it.
2. Messages that hang on requests, and the requests, are decided by the live decider itself, packet by packet, in order.
3. Memory: packets are in rows of 8, 16, 32, … bytes, so that a long one among short ones costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from ...frame_table import Channels, to_ns
from ..declare.message import Message
from ..generate.load import records_of
from ..generate.scan import Choice, choose
from ..live.decide import Decider
from .rows import PacketRows, row_decoder
from .scanner import Gatherer
from .table import Array, Column, ColumnKind, MessageTable, concat_columns, packet_rows, take_rows

#: How many bytes of rows are made at once.
ROWS = 1 << 24


class Batch:
    """Packets of one framing in a buffer: where they start (int64, rising), how long they are, their instants.

    `offset` is the buffer's place in the stream. `times` are instants in seconds, and `when` says which of them each packet
    has (None: all the first). `ready` are their rows, where they have been made.
    """

    def __init__(
        self,
        buffer: bytes,
        offset: int,
        starts: Array,
        sizes: Array,
        times: Sequence[float | None],
        when: Array | None = None,
        ready: Array | None = None,
    ) -> None:
        self.buffer = buffer
        self.data = np.frombuffer(buffer, np.uint8)
        self.starts = starts
        self.sizes = sizes
        self.keys = starts + offset
        self.times = times
        self.when = when
        self._ready = ready

    def __len__(self) -> int:
        return len(self.starts)

    def packets(self, which: Array) -> Iterator[tuple[int, bytes, int, float | None]]:
        """Yield (number, bytes, offset in the stream, seconds) of each of these packets."""
        buffer, first = self.buffer, self.times[0]
        starts, sizes = self.starts[which].tolist(), self.sizes[which].tolist()
        whens = self.when[which].tolist() if self.when is not None else None
        for place, (index, key) in enumerate(zip(which.tolist(), self.keys[which].tolist(), strict=True)):
            start = starts[place]
            time = first if whens is None else self.times[whens[place]]
            yield index, buffer[start : start + sizes[place]], key, time

    def instants(self, which: Array) -> Array:
        """Return the instants of packets, int64 nanoseconds."""
        if self.when is None:
            return np.full(len(which), to_ns(self.times[0]), np.int64)
        found: Array = np.array([to_ns(time) for time in self.times], np.int64)[self.when[which]]
        return found

    def rows(self, which: Array, least: int) -> list[tuple[Array, PacketRows]]:
        """Return these packets as rows of at least `least` bytes: (numbers of the packets, rows) of each width."""
        if not len(which):
            return []
        sizes = self.sizes[which] if len(which) < len(self) else self.sizes
        widest = -(-max(int(sizes.max()), least) // 8) * 8
        if self._ready is not None and self._ready.shape[1] >= least:
            return [(which, self._rows(which, self._ready.shape[1]))]
        if len(which) * widest <= max(2 * int(sizes.sum()), 1 << 16):
            classes = [which]
        else:
            scale = np.ceil(np.log2(np.maximum(sizes, 8))).astype(np.int64)
            classes = [which[scale == size_class] for size_class in np.unique(scale).tolist()]
        found = []
        for members in classes:
            width = -(-max(int(self.sizes[members].max()), least) // 8) * 8
            step = max(1, ROWS // width)
            found += [
                (some, self._rows(some, width))
                for some in (members[a : a + step] for a in range(0, len(members), step))
            ]
        return found

    def _rows(self, which: Array, width: int) -> PacketRows:
        if len(which) == len(self):
            starts, sizes, keys = self.starts, self.sizes, self.keys
        else:
            starts, sizes, keys = self.starts[which], self.sizes[which], self.keys[which]
        ready = self._ready
        if ready is not None and ready.shape[1] == width:
            return PacketRows(ready if len(which) == len(self) else take_rows(ready, which), sizes, keys)
        return PacketRows(packet_rows(self.buffer, starts, sizes, width), sizes, keys)


class _Kind:
    """One message: how its packets become a table."""

    def __init__(self, message: Message, decider: Decider, *, raw: bool) -> None:
        variant = decider.variant
        self.message = message
        self.plan = message.plan
        self.decoder = row_decoder(message, raw=raw)
        #: Asked of one packet after the other, where rows will not do.
        self.decode: Callable[..., Any] | None = (
            decider.decide([message]) if self.decoder.reason or message.counters else None
        )
        self.protocol = variant.name
        self.gatherer = Gatherer(records_of(variant)[message.name], self.plan, raw=raw)
        # Fields that are there only for some values of a selector may stand behind the packet's end.
        self.extent = self.decoder.extent if self.plan.lengths_by is not None else 0

    def column(self, kind: ColumnKind, rows: PacketRows) -> Column:
        """Return one column of these packets."""
        return self.decoder.column(kind, rows)

    def accepted(self, batch: Batch, which: Array, rows: PacketRows) -> tuple[Array | None, list[Any]]:
        """Return which packets are the message (None: all), and of a message that goes one by one their records."""
        if self.decode is None:
            return self.decoder.accepts(rows), []
        decode = self.decode
        found = [
            decode(packet, key, time, None, packet, None) for _, packet, key, time in batch.packets(which)
        ]
        good = np.array([record is not None for record in found], bool)
        return good, [record for record in found if record is not None]


#: Packets of one message: their numbers in the batch, and their rows or records.
_Part = tuple[Array, "PacketRows | list[Any]"]


class PacketTables:
    """Makes tables of packets of one framing; `decode` is the live decision among its messages."""

    def __init__(
        self,
        decider: Decider,
        messages: Sequence[Message],
        decode: Callable[..., Any],
        channels: Channels,
        *,
        raw: bool,
    ) -> None:
        self.decider = decider
        self._decode = decode
        self._channels = channels
        context = decider.context
        is_live = any(
            message.name in names
            for names in (decider.contextual, context.requests, context.answers)
            for message in messages
        )
        # Rolling counters count in the order of the stream, whatever their packets' heads say.
        is_live = is_live or any(message.counters for message in messages)
        self._kinds = {message.name: _Kind(message, decider, raw=raw) for message in messages}
        self._types = {kind.gatherer.record: kind for kind in self._kinds.values()}
        self._choice = None if is_live else choose([kind.plan for kind in self._kinds.values()])

    def tables(self, batch: Batch) -> tuple[list[MessageTable], Array, list[str]]:
        """Return (tables in declared order, numbers of the packets that are not a message, rising, the reason
        of each).
        """
        if not len(batch):
            return [], np.zeros(0, np.int64), []
        parts: dict[str, list[_Part]] = {}
        if self._choice is None:
            unknown, reasons = self._one_by_one(batch, parts)
            lost = np.array(unknown, np.int64)
        else:
            left: list[Array] = []
            self._decide(self._choice, batch, np.arange(len(batch)), parts, left)
            lost = np.sort(np.concatenate(left)) if left else np.zeros(0, np.int64)
            reasons = ["unknown"] * len(lost)
        tables = [
            self._table(kind, batch, parts[name]) for name, kind in self._kinds.items() if name in parts
        ]
        return tables, lost, reasons

    # ------------------------------------------------------------------ which message

    def _one_by_one(self, batch: Batch, parts: dict[str, list[_Part]]) -> tuple[list[int], list[str]]:
        decode, decider = self._decode, self.decider
        unknown: list[int] = []
        reasons: list[str] = []
        records: dict[type, tuple[list[int], list[Any]]] = {}
        for index, packet, key, time in batch.packets(np.arange(len(batch))):
            record = decode(packet, key, time, None, packet, None)
            if record is None:
                unknown.append(index)
                reasons.append(decider.need_of(key) or "unknown")
                continue
            some = records.setdefault(type(record), ([], []))
            some[0].append(index)
            some[1].append(record)
        for kind, (indices, found) in records.items():
            parts[self._types[kind].message.name] = [(np.array(indices, np.int64), found)]
        return unknown, reasons

    def _decide(
        self, choice: Choice, batch: Batch, which: Array, parts: dict[str, list[_Part]], left: list[Array]
    ) -> None:
        """Follow the choice by the bytes in which messages differ."""
        if choice.offset is None:
            self._try(choice.names, batch, which, parts, left)
            return
        sizes = batch.sizes[which]
        if int(sizes.min()) <= choice.offset:
            short = sizes <= choice.offset
            left.append(which[short])
            which = which[~short]
        values = batch.data.take(batch.starts[which] + choice.offset)
        present = np.bincount(values, minlength=256)
        for value, case in choice.cases:
            count = int(present[value])
            present[value] = 0
            if count:
                self._decide(
                    case, batch, which if count == len(which) else which[values == value], parts, left
                )
        if present.any():
            left.append(which[present.take(values) > 0])

    def _try(
        self,
        names: Sequence[str],
        batch: Batch,
        which: Array,
        parts: dict[str, list[_Part]],
        left: list[Array],
    ) -> None:
        """Try messages in order."""
        kinds = [self._kinds[name] for name in names]
        rest = batch.rows(which, max(kind.extent for kind in kinds))
        for kind in kinds:
            refused: list[tuple[Array, PacketRows]] = []
            mine: list[_Part] = []
            for some, rows in rest:
                good, records = kind.accepted(batch, some, rows)
                if good is None:
                    mine.append((some, rows))
                    continue
                if good.all():
                    mine.append((some, records if kind.decode is not None else rows))
                    continue
                if good.any():
                    chosen = np.flatnonzero(good)
                    mine.append((some[chosen], records if kind.decode is not None else rows.take(chosen)))
                other = np.flatnonzero(~good)
                refused.append((some[other], rows.take(other)))
            if mine:
                parts.setdefault(kind.message.name, []).extend(mine)
            rest = refused
        left.extend(some for some, _ in rest)

    # ------------------------------------------------------------------ tables

    def _table(self, kind: _Kind, batch: Batch, parts: list[_Part]) -> MessageTable:
        which = parts[0][0] if len(parts) == 1 else np.concatenate([some for some, _ in parts])
        order: Array | None = None
        if len(parts) > 1 and (which[1:] < which[:-1]).any():
            order = np.argsort(which)
            which = which[order]
        if kind.decode is not None or isinstance(parts[0][1], list):
            records = [record for _, some in parts for record in some]  # type: ignore[union-attr]
            if order is not None:
                records = [records[index] for index in order.tolist()]
            return kind.gatherer.table(records, batch.keys[which], self._channels)

        def make(column: ColumnKind) -> Column:
            pieces = [kind.column(column, rows) for _, rows in parts if isinstance(rows, PacketRows)]
            whole = concat_columns(column, pieces)
            if order is None:
                return whole
            return Column(column, whole.values[order], None if whole.absent is None else whole.absent[order])

        n = len(which)
        keys = batch.keys if n == len(batch) else batch.keys[which]
        return MessageTable(
            kind.protocol,
            kind.message.name,
            kind.message.direction,
            True,
            batch.instants(which),
            np.full(n, self._channels.number(None), np.uint16),
            self._channels,
            keys,
            keys,
            np.full(n, 2, np.uint8),
            kind.decoder.kinds,
            make,
            kind.plan.doc,
            batch.sizes if n == len(batch) else batch.sizes[which],
        )
