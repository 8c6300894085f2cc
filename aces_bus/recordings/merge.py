"""Tables put together: those of several captures, by time, with channels under new names; parts of one, by their places.

1. All tables that come out share one `Channels`; equal names are one channel, whichever file they are from.
2. Frames of one capture keep their order, also by time: a frame that is earlier than one before it comes right behind that.
3. Memory holds a table of each capture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from ..frame_table import Channels, FrameTable, Ints, widened


class Relabel:
    """The channels of several captures as those of one, with new names for some.

    >>> from aces_bus.frames import Frame
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
        """The same frames with the channels of all."""
        if table.channels is not self._of:
            self._of, self._row = table.channels, []
        for name in table.channels.names[len(self._row) :]:
            self.seen.add(name)
            self._row.append(self.channels.number(self.names.get(name, name)))
        channel = np.array(self._row or [0], np.uint16)[table.channel]
        return FrameTable(table.time, channel, table.id, table.flags, table.length, table.data, self.channels)


class _Buffer:
    """The tables of one capture, of which some frames were taken."""

    def __init__(self, tables: Iterator[FrameTable], relabel: Relabel) -> None:
        self._tables, self._relabel = tables, relabel
        self._table: FrameTable | None = None
        self._key: Ints = np.empty(0, np.int64)
        self._place = 0
        self._latest = -(1 << 63)
        self.fill()

    def fill(self) -> bool:
        """Whether there are frames; takes the next table when this one is used up."""
        while self._table is None or self._place == len(self._table):
            table = next(self._tables, None)
            if table is None:
                self._table = None
                return False
            if not len(table):
                continue
            self._table, self._place = self._relabel(table), 0
            # Never going back: an earlier frame comes right behind the one before, as does one without a time.
            self._key = np.maximum(np.maximum.accumulate(table.time), self._latest)
            self._latest = int(self._key[-1])
        return True

    @property
    def last(self) -> int:
        return self._latest

    def until(self, bound: int, inclusive: bool) -> tuple[FrameTable, Ints]:
        """The frames up to an instant, with it or without, and what to sort them by."""
        assert self._table is not None
        end = int(np.searchsorted(self._key, bound, "right" if inclusive else "left"))
        rows = slice(self._place, end)
        self._place = max(end, self._place)
        return self._table.take(rows), self._key[rows]


def merge_by_time(
    captures: Sequence[Iterable[FrameTable]], relabel: Relabel | None = None
) -> Iterator[FrameTable]:
    """The tables of several captures as those of one, by time; of equal times the first capture's come first.

    >>> from aces_bus.frames import Frame
    >>> a = FrameTable.from_frames([Frame(1, timestamp=0.0), Frame(1, timestamp=2.0)])
    >>> b = FrameTable.from_frames([Frame(2, timestamp=1.0), Frame(2, timestamp=3.0)])
    >>> [int(id) for table in merge_by_time([[a], [b]]) for id in table.id]
    [1, 2, 1, 2]
    """
    shared = relabel or Relabel({})
    buffers = [_Buffer(iter(tables), shared) for tables in captures]
    while buffers := [buffer for buffer in buffers if buffer.fill()]:
        # The capture whose table ends first may have more of that instant to come, which are before those of the captures
        # behind it.
        bound = min(buffer.last for buffer in buffers)
        ending = next(place for place, buffer in enumerate(buffers) if buffer.last == bound)
        parts = [buffer.until(bound, place <= ending) for place, buffer in enumerate(buffers)]
        table = FrameTable.concat([part for part, _ in parts])
        if len(parts) > 1:
            table = table.take(np.argsort(np.concatenate([key for _, key in parts]), kind="stable"))
        yield table


def merge_in_order(total: int, places: Sequence[Ints], parts: Sequence[FrameTable]) -> FrameTable:
    """The rows of `parts`, which stand at `places` (each going up, none twice) among `total`, as one table.

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

    item = np.dtype("<u8" if width == 8 else (np.void, width))  # whole rows are moved faster than their bytes
    return FrameTable(
        column(lambda part: part.time),
        column(lambda part: part.channel),
        column(lambda part: part.id),
        column(lambda part: part.flags),
        column(lambda part: part.length),
        column(lambda part: widened(part.data, width).view(item)[:, 0]).view(np.uint8).reshape(count, width),
        parts[0].channels,
    )
