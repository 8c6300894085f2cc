"""Column scanners: a capture's frames or bytes in, one table a message out.

1. A column scanner gives what the live scanner gives, value for value; only faster, and as columns.
2. Pieces may be cut anywhere: requests, modes, counters and incomplete packets carry on to the next `feed`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, Protocol

import numpy as np

from ...frame_table import Channels, FrameTable
from ..counts import ScanCounts
from ..declare.message import Direction
from ..declare.protocol import Variant
from ..live.scanner import Scanner, make_scanner
from ..record import Record, Unknown
from .gather import Gatherer
from .table import Array, Column, ColumnKind, MessageTable


class ColumnScanner(Protocol):
    """What both kinds do; `feed` takes a `FrameTable` (CAN) or bytes (streams)."""

    @property
    def link(self) -> str:
        """`can`, `serial` or `datagram`."""
        ...

    def feed(self, words: Any, /) -> list[MessageTable]:
        """The tables of a piece of a capture, one a message that occurs in it, in declared order."""
        ...

    def close(self) -> list[MessageTable]:
        """The capture has ended."""
        ...

    @property
    def counts(self) -> ScanCounts:
        """Where every byte or frame went so far."""
        ...


#: The columns of the table of what was not decoded, named "" in `include_unknown` mode.
LOST = (
    ColumnKind("reason", doc="why it is no message", is_object=True),
    ColumnKind("raw", doc="data bytes of the frame, or the bytes of the stream", is_object=True),
)


def lost_table(
    unknown: Sequence[Unknown], rows: Array, channels: Channels, *, is_stream: bool
) -> MessageTable:
    """What was not decoded, as a table with the columns `reason` and `raw`."""
    from ...frame_table import to_ns
    from ..keys import key_of

    n = len(unknown)
    metas = [item.meta for item in unknown]
    columns = {
        "reason": _objects([item.reason for item in unknown]),
        "raw": _objects([meta.raw for meta in metas]),
    }
    if is_stream:
        key = np.fromiter((meta.offset or 0 for meta in metas), np.int64, n)
    else:
        key = np.fromiter(
            (
                key_of(meta.identifier or 0, extended=meta.extended, remote=meta.remote, fd=meta.fd)
                for meta in metas
            ),
            np.uint32,
            n,
        )
    return MessageTable(
        "",
        "",
        None,
        is_stream,
        np.fromiter((to_ns(meta.time) for meta in metas), np.int64, n),
        np.fromiter((channels.number(meta.channel) for meta in metas), np.uint16, n),
        channels,
        key,
        rows,
        np.fromiter((2 if meta.is_rx is None else bool(meta.is_rx) for meta in metas), np.uint8, n),
        LOST,
        lambda kind: Column(kind, columns[kind.name]),
        size=np.fromiter((meta.size or 0 for meta in metas), np.int64, n) if is_stream else None,
    )


def _objects(values: Sequence[Any]) -> Array:
    array = np.empty(len(values), object)
    array[:] = values
    return array


class RecordColumns:
    """The column scanner that goes through the live one: for whatever has no faster way. See `make_column_scanner`."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: Direction | Literal["both"] | None = None,
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
        self._raw = raw
        #: By record type, made when its first record comes.
        self._gatherers: dict[type[Record], Gatherer] = {}

    @property
    def counts(self) -> ScanCounts:
        """Where every byte or frame went so far."""
        return self.scanner.counts

    def feed(self, words: Any, /) -> list[MessageTable]:
        """The tables of a piece of a capture."""
        if isinstance(words, FrameTable):
            rows = np.arange(self._rows, self._rows + len(words))
            self._rows += len(words)
            return self.frames(words, rows)
        return self.tables(self.scanner.feed(words), None)

    def close(self) -> list[MessageTable]:
        """The capture has ended."""
        return self.tables(self.scanner.close(), None)

    def frames(self, table: FrameTable, rows: Array) -> list[MessageTable]:
        """The tables of frames that are `rows` of the capture, in rising order. Instants stay exact."""
        self.channels = table.channels
        tables = self.tables(self.scanner.feed(table.frames()), rows)
        return [replace(one, time=table.time[np.searchsorted(rows, one.row)]) for one in tables]

    def _gatherer(self, kind: type[Record]) -> Gatherer:
        found = self._gatherers.get(kind)
        if found is None:
            found = self._gatherers[kind] = Gatherer(kind, kind._declared.plan, raw=self._raw)
        return found

    def tables(self, items: Sequence[Any], rows: Array | None) -> list[MessageTable]:
        """Records and `Unknown`s as tables; `rows` are their numbers, None for a stream's (their offsets)."""
        by_kind: dict[Any, list[int]] = {}
        for index, item in enumerate(items):
            by_kind.setdefault(type(item), []).append(index)
        tables = []
        for kind, indices in by_kind.items():
            some = [items[index] for index in indices]
            gatherer = None if kind is Unknown else self._gatherer(kind)
            if gatherer is None and not self.include_unknown:
                continue
            if rows is not None:
                numbers: Array = rows[indices]
            else:
                offsets = (item.meta.offset or 0 if gatherer is None else item._key for item in some)
                numbers = np.fromiter(offsets, np.int64, len(some))
            if gatherer is None:
                tables.append(lost_table(some, numbers, self.channels, is_stream=rows is None))
            else:
                tables.append(gatherer.table(some, numbers, self.channels))
        return tables


def make_column_scanner(
    variants: Sequence[Variant],
    *,
    direction: Direction | Literal["both"] | None = None,
    include_unknown: bool = False,
    raw: bool = False,
) -> ColumnScanner:
    """A column scanner for the protocols of one wire; arguments and errors are those of `make_scanner`.

    With `include_unknown` there is also a table named "" of what was not decoded, with the columns `reason` and `raw`.
    """
    from ..live.channels import ChannelColumns
    from .can import CanColumns
    from .stream import StreamColumns

    kind: Any = StreamColumns
    if variants and variants[0].link == "can":
        kind = ChannelColumns if any(variant.channel is not None for variant in variants) else CanColumns
    made: ColumnScanner = kind(variants, direction=direction, include_unknown=include_unknown, raw=raw)
    return made
