"""Tables put together: those of several captures, by time, with channels under new names; parts of one, by their places.

1. All tables that come out share one `Channels`; equal names are one channel, whichever file they are from.
2. Frames of one capture keep their order, also by time: a frame that is earlier than one before it comes right behind that.
3. Memory holds a table of each capture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from .._lazy import np
from ..frame_table import Channels, FrameTable, Ints, widened


class Relabel:
    """The channels of several captures as those of one, with new names for some.

    >>> from aces_bus import Frame
    >>> relabel = Relabel({"can0": "drive"})
    >>> relabel(FrameTable.from_frames([Frame(1, channel="can0"), Frame(1, channel="can1")])).channels.names
    ['drive', 'can1']
    """

    def __init__(self, names: Mapping[str | None, str]) -> None:
        self.names = dict(names)
        self.channels = Channels()
        #: Names that occurred, as they are in the captures.
        self.seen: set[str | None] = set()
        self._of: Channels | None = None
        self._row: list[int] = []

    def __call__(self, table: FrameTable) -> FrameTable:
        """Return the same frames with the channels of all."""
        if table.channels is not self._of:
            self._of, self._row = table.channels, []
        for name in table.channels.names[len(self._row) :]:
            self.seen.add(name)
            self._row.append(self.channels.number(self.names.get(name, name)))
        channel = np.array(self._row or [0], np.uint16)[table.channel]
        return FrameTable(table.time, channel, table.id, table.flags, table.length, table.data, self.channels)


#: Rows, and what to sort them by, which never goes down.
KeyedTable = tuple[Ints, FrameTable]


class Merge:
    """Tables of several sources as those of a single one."""

    @staticmethod
    def by_time(
        captures: Sequence[Iterable[FrameTable]], relabel: Relabel | None = None
    ) -> Iterator[FrameTable]:
        """Return the tables of several captures as those of one, by time; of equal times the first capture's come first.

        >>> from aces_bus import Frame
        >>> a = FrameTable.from_frames([Frame(1, timestamp=0.0), Frame(1, timestamp=2.0)])
        >>> b = FrameTable.from_frames([Frame(2, timestamp=1.0), Frame(2, timestamp=3.0)])
        >>> [int(id) for table in Merge.by_time([[a], [b]]) for id in table.id]
        [1, 2, 1, 2]
        """
        shared = relabel or Relabel({})
        return Merge.by_key([_keyed(tables, shared) for tables in captures])

    @staticmethod
    def by_key(sources: Iterable[Iterator[KeyedTable]]) -> Iterator[FrameTable]:
        """Yield the tables of several sources as those of one, in the order of their keys; of equal keys the first
        source's first.

        None of the tables is empty, and all share their `channels`.
        """
        live = [(source, piece) for source in sources if (piece := next(source, None)) is not None]
        while len(live) > 1:
            ends = [int(key[-1]) for _, (key, _) in live]
            edge = min(ends)
            # Behind the piece that ends first there may be more with its key: they come before those of the next sources.
            first = ends.index(edge)
            parts: list[KeyedTable] = []
            rest: list[tuple[Iterator[KeyedTable], KeyedTable]] = []
            for place, (source, (key, table)) in enumerate(live):
                end = int(np.searchsorted(key, edge, "right" if place <= first else "left"))
                if end:
                    parts.append((key[:end], table.take(slice(0, end))))
                after = (key[end:], table.take(slice(end, None))) if end < len(key) else next(source, None)
                if after is not None:
                    rest.append((source, after))
            live = rest
            order = np.argsort(np.concatenate([key for key, _ in parts]), kind="stable")
            places = np.empty(len(order), np.int64)
            places[order] = np.arange(len(order))
            bounds = np.cumsum([len(key) for key, _ in parts])[:-1]
            yield Merge.in_order(len(order), np.split(places, bounds), [table for _, table in parts])
        for source, (_, table) in live:
            yield table
            yield from (more for _, more in source)

    @staticmethod
    def in_order(total: int, places: Sequence[Ints], parts: Sequence[FrameTable]) -> FrameTable:
        """Return the rows of `parts`, which are at `places` (each going up, none twice) among `total`, as one table.

        Places without a row are closed up.
        """
        if len(parts) == 1:
            return parts[0]
        count = sum(map(len, parts))
        if count < total:
            taken = np.zeros(total, np.int64)
            for here in places:
                taken[here] = 1
            row = np.cumsum(taken) - 1
            places = [row[here] for here in places]
        width = max(part.data.shape[1] for part in parts)

        def column(of: Callable[[FrameTable], Ints]) -> Ints:
            out: Ints = np.empty(count, of(parts[0]).dtype)
            for here, part in zip(places, parts, strict=True):
                out[here] = of(part)
            return out

        item = np.dtype(
            "<u8" if width == 8 else (np.void, width)
        )  # whole rows are moved faster than their bytes
        return FrameTable(
            column(lambda part: part.time),
            column(lambda part: part.channel),
            column(lambda part: part.id),
            column(lambda part: part.flags),
            column(lambda part: part.length),
            column(lambda part: widened(part.data, width).view(item)[:, 0])
            .view(np.uint8)
            .reshape(count, width),
            parts[0].channels,
        )


def _keyed(tables: Iterable[FrameTable], relabel: Relabel) -> Iterator[KeyedTable]:
    """Yield the tables by time, which never goes back: an earlier frame comes right behind the one before, as does one
    without.
    """
    latest = -(1 << 63)
    for table in tables:
        if len(table):
            key = np.maximum(np.maximum.accumulate(table.time), latest)
            latest = int(key[-1])
            yield key, relabel(table)
