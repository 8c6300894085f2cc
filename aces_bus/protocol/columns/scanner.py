"""Column scanners: a capture's frames or bytes in, one table a message out.

1. A column scanner gives what the live scanner gives, value for value; only faster, and as columns.
2. Pieces may be cut anywhere: requests, modes, counters and incomplete packets carry on to the next `feed`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from ...frame_table import Channels, FrameTable, to_ns
from ...frames import key_of
from ..counts import ScanCounts
from ..declare.fields import FlagSet
from ..declare.message import GivenWay
from ..declare.protocol import Variant
from ..generate.load import OnDemand
from ..live.scanner import Scanner, make_scanner
from ..plan import nodes as p
from ..record import FieldValue, Record, Unknown, WayStep, getter, plain_value, protocol_name_of
from ..record_plans import message_of
from .table import Array, Column, ColumnKind, MessageTable, dtype_of, kinds_of, lost_table, object_array


class ColumnScanner(Protocol):
    """What both kinds do; `feed` takes a `FrameTable` (CAN) or bytes (streams)."""

    @property
    def link(self) -> str:
        """`can`, `serial` or `datagram`."""
        ...

    def feed(self, traffic: Any, /) -> list[MessageTable]:
        """Decode a piece of a capture; return its tables, one a message that occurs in it, in declared order."""
        ...

    def close(self) -> list[MessageTable]:
        """End the capture; return the last tables."""
        ...

    @property
    def counts(self) -> ScanCounts:
        """Number of bytes or frames so far by their outcome."""
        ...


def _lost_table(
    unknown: Sequence[Unknown], rows: Array, channels: Channels, *, is_stream: bool
) -> MessageTable:
    n = len(unknown)
    metas = [item.meta for item in unknown]
    if is_stream:
        key = np.fromiter((meta.offset or 0 for meta in metas), np.int64, n)
    else:
        keys = (
            key_of(meta.identifier or 0, extended=meta.extended, remote=meta.remote, fd=meta.fd)
            for meta in metas
        )
        key = np.fromiter(keys, np.uint32, n)
    return lost_table(
        object_array([item.reason for item in unknown]),
        lambda: object_array([meta.raw for meta in metas]),
        is_stream=is_stream,
        time=np.fromiter((to_ns(meta.time) for meta in metas), np.int64, n),
        channel=np.fromiter((channels.number(meta.channel) for meta in metas), np.uint16, n),
        channels=channels,
        key=key,
        row=rows,
        rx=np.fromiter((2 if meta.is_rx is None else bool(meta.is_rx) for meta in metas), np.uint8, n),
        size=np.fromiter((meta.size or 0 for meta in metas), np.int64, n) if is_stream else None,
    )


class RecordColumns:
    """The column scanner that goes through the live one: for whatever has no faster way. See `make_column_scanner`."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: GivenWay | None = None,
        include_unknown: bool = False,
        raw: bool = False,
        scanner: Scanner | None = None,
    ) -> None:
        self.include_unknown = include_unknown
        #: One that gives everything; by default the live one of these variants.
        self.scanner = scanner or make_scanner(variants, direction=direction, include_unknown=True, raw=raw)
        self.link = self.scanner.link
        self.channels = Channels()
        self._rows = 0
        #: By record type, made when its first record comes.
        self._gatherers: OnDemand[type[Record], Gatherer] = OnDemand(
            lambda kind: Gatherer(kind, message_of(kind).plan, raw=raw)
        )

    @property
    def counts(self) -> ScanCounts:
        """Number of bytes or frames so far by their outcome."""
        return self.scanner.counts

    def feed(self, traffic: Any, /) -> list[MessageTable]:
        """Decode a piece of a capture; return its tables."""
        if isinstance(traffic, FrameTable):
            rows = np.arange(self._rows, self._rows + len(traffic))
            self._rows += len(traffic)
            return self.frames(traffic, rows)
        return self.tables(self.scanner.feed(traffic), None)

    def close(self) -> list[MessageTable]:
        """End the capture; return the last tables."""
        scanner: Any = self.scanner
        if getattr(scanner, "has_transports", False):
            items, origins = scanner.close_numbered()
            return self.tables(items, np.array(origins, np.int64))
        return self.tables(self.scanner.close(), None)

    def frames(self, table: FrameTable, rows: Array) -> list[MessageTable]:
        """Return the tables of frames that are `rows` of the capture, in rising order. Instants stay exact."""
        self.channels = table.channels
        scanner: Any = self.scanner
        frames = table.frames()
        if not getattr(scanner, "has_transports", False):
            tables = self.tables(scanner.feed(frames), rows)
            return [replace(made, time=table.time[np.searchsorted(rows, made.row)]) for made in tables]
        items, origins = scanner.feed_numbered(frames, rows.tolist())
        return [_timed(made, table, rows) for made in self.tables(items, np.array(origins, np.int64))]

    def tables(self, items: Sequence[Any], rows: Array | None) -> list[MessageTable]:
        """Return records and `Unknown`s as tables; `rows` are their numbers, None for a stream's (their offsets)."""
        by_kind: dict[Any, list[int]] = {}
        for index, item in enumerate(items):
            by_kind.setdefault(type(item), []).append(index)
        tables = []
        for kind, indices in by_kind.items():
            some = [items[index] for index in indices]
            gatherer = None if kind is Unknown else self._gatherers[kind]
            if gatherer is None and not self.include_unknown:
                continue
            if rows is not None:
                numbers: Array = rows[indices]
            else:
                offsets = (item.meta.offset or 0 if gatherer is None else item._key for item in some)
                numbers = np.fromiter(offsets, np.int64, len(some))
            if gatherer is None:
                tables.append(_lost_table(some, numbers, self.channels, is_stream=rows is None))
            else:
                tables.append(gatherer.table(some, numbers, self.channels))
        return tables


def _timed(made: MessageTable, table: FrameTable, rows: Array) -> MessageTable:
    """Return a table with the exact instants of its frames, as far as they are among `rows`."""
    places = np.minimum(np.searchsorted(rows, made.row), len(rows) - 1)
    return replace(made, time=np.where(rows[places] == made.row, table.time[places], made.time))


def make_column_scanner(
    variants: Sequence[Variant],
    *,
    direction: GivenWay | None = None,
    include_unknown: bool = False,
    raw: bool = False,
) -> ColumnScanner:
    """Return a column scanner for the protocols of one wire; arguments and errors are those of `make_scanner`.

    With `include_unknown` there is also a table named "" of what was not decoded, with the columns `reason` and `raw`.
    """
    from .can import CanColumns
    from .can_channels import ChannelColumns
    from .stream import StreamColumns

    kind: Any = StreamColumns
    if variants and variants[0].link == "can":
        kind = ChannelColumns if any(variant.channel is not None for variant in variants) else CanColumns
    made: ColumnScanner = kind(variants, direction=direction, include_unknown=include_unknown, raw=raw)
    return made


class Gatherer:
    """Makes the tables of one message from its records."""

    def __init__(self, kind: type[Record], plan: p.MessagePlan, *, raw: bool) -> None:
        self.record = kind
        self.plan = plan
        self.kinds = kinds_of(plan, raw)
        self._fillers = {leaf.path: _filler(leaf.way, dtype_of(leaf.node, raw)) for leaf in plan.columns}

    def table(self, records: Sequence[Any], rows: Array, channels: Channels) -> MessageTable:
        """Return the records, of which `rows` are the numbers in the capture; of a stream the packets' offsets."""
        n = len(records)
        message = message_of(self.record)
        is_stream, is_carried = message.framing is not None, message.transport is not None
        fillers = self._fillers
        return MessageTable(
            protocol=protocol_name_of(self.record),
            message=self.record.__name__,
            direction=message.direction,
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
            frames=np.fromiter((len(r._raw.frames) for r in records), np.int64, n) if is_carried else None,
            first_time=np.fromiter((to_ns(r._raw.first_time) for r in records), np.int64, n)
            if is_carried
            else None,
        )


def _numbers_of_flags(value: FieldValue) -> Any:
    """Return the flags of groups as plain numbers, as those of a column of one value are."""
    if not isinstance(value, list):
        return value
    return [int(flags) if isinstance(flags, FlagSet) else flags for flags in value]


def _filler(way: tuple[WayStep, ...], dtype: Any) -> Callable[[ColumnKind, Sequence[Any]], Column]:
    get = getter(way)

    def fill(kind: ColumnKind, records: Sequence[Any]) -> Column:
        values = [get(record) for record in records]
        absent = None
        if any(value is None for value in values):
            absent = np.array([value is None for value in values], bool)
        if dtype is None:
            found = [plain_value(value) for value in values]
            return Column(kind, object_array([_numbers_of_flags(value) for value in found]), absent)
        if kind.names is not None:
            numbers = {name: number for number, name in kind.names.items()}
            values = [numbers[value] if isinstance(value, str) else value for value in values]
        if absent is not None:
            values = [0 if value is None else value for value in values]
        return Column(kind, np.array(values, dtype), absent)

    return fill
