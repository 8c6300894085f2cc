"""What the frames of each identifier are like, without knowing what they mean.

1. Frames of remote requests have no data, and count by their number alone.
2. Memory is bounded: `MOST_IDENTIFIERS` profiles of some 20 KB (of 64-byte frames 140 KB); what is beyond is counted.
3. A gap, a flip and a visit are between two frames of one identifier inside one window.
"""

from __future__ import annotations

from aces_bus import FrameTable
from aces_bus._lazy import np
from aces_bus.frame_table import Ints, widened
from aces_bus.frames import REMOTE
from aces_tools.reading.traffic import FrameCount, IdentifierCounts


class IdentifierTraffic(FrameCount):
    """The frames of one identifier on one side. Arrays by byte have `width` entries, as long as the longest frame."""

    def __init__(self, windows: int, *, has_data: bool = True) -> None:
        super().__init__()
        self.has_data = has_data
        self.width = 0
        #: Of each byte: how many frames had each value, and how often it became so: (width, 256).
        self.values: Ints = np.zeros((0, 256), np.uint32)
        self.visits: Ints = np.zeros((0, 256), np.uint32)
        #: How often each bit flipped from one frame to the next: (width, 8), the lowest bit first.
        self.flips: Ints = np.zeros((0, 8), np.int64)
        #: Of each window: bits that were seen set, and seen clear: (windows, width).
        self.ones: Ints = np.zeros((windows, 0), np.uint8)
        self.zeros: Ints = np.zeros((windows, 0), np.uint8)
        self._before: tuple[Ints, int] | None = None

    def add(self, data: Ints, lengths: Ints, times: Ints, windows: Ints) -> None:
        """Add frames in order: bytes (n, 8 or 64), their number, instants, and each one's window."""
        follows = self.count(times, lengths, windows)
        self._widen(int(lengths.max()) if self.has_data else 0)
        width = self.width
        before_data, before_length = self._before or (data[0], 0)
        self._before = data[-1], int(lengths[-1])
        if not width:
            return
        before_lengths = np.concatenate(([before_length], lengths[:-1]))
        some = np.unique(windows).tolist()
        before = widened(before_data[None], width)[0]
        # By byte: a column is contiguous once it is turned, and a byte at a time stays in the processor's cache.
        columns = np.ascontiguousarray(widened(data, width)[:, :width].T)
        shortest = min(int(lengths.min()), int(before_lengths.min()))
        for byte, column in enumerate(columns):
            there = None if byte < shortest else lengths > byte
            both = follows if there is None else follows & there & (before_lengths > byte)
            flipped = column ^ np.concatenate((before[byte : byte + 1], column[:-1]))
            present = column if there is None else column[there]
            self.values[byte] += _tally(present)
            flipped = np.where(both, flipped, 0)
            begun = (flipped != 0) | ~both
            self.visits[byte] += _tally(column[begun if there is None else begun & there])
            self.flips[byte] += BITS_OF_VALUES @ _tally(flipped[flipped != 0])
            for window in some:
                mine = (
                    present
                    if len(some) == 1
                    else column[(windows == window) if there is None else there & (windows == window)]
                )
                self.ones[window, byte] |= np.bitwise_or.reduce(mine, initial=0)
                self.zeros[window, byte] |= ~np.bitwise_and.reduce(mine, initial=0xFF)

    def _widen(self, width: int) -> None:
        more = width - self.width
        if more > 0:
            self.width = width
            self.values = np.pad(self.values, ((0, more), (0, 0)))
            self.visits = np.pad(self.visits, ((0, more), (0, 0)))
            self.flips = np.pad(self.flips, ((0, more), (0, 0)))
            self.ones = np.pad(self.ones, ((0, 0), (0, more)))
            self.zeros = np.pad(self.zeros, ((0, 0), (0, more)))


#: Which of the 256 values of a byte have bit 0 set, bit 1, …: (8, 256).
BITS_OF_VALUES: Ints = np.arange(256) >> np.arange(8)[:, None] & 1


def _tally(values: Ints) -> Ints:
    """Return how often each of the 256 values of a byte occurs."""
    counts: Ints = np.bincount(values, minlength=256).astype(np.uint32)
    return counts


class TrafficProfile:
    """The frames of one side: of a recording, or of its windows."""

    def __init__(self, windows: int = 1) -> None:
        self.identifiers = IdentifierCounts(
            lambda identifier: IdentifierTraffic(windows, has_data=not identifier.key & REMOTE)
        )

    @property
    def frames(self) -> int:
        """All of them, those of identifiers for which there was no room as well."""
        return self.identifiers.frames

    def add(self, table: FrameTable, windows: Ints) -> None:
        """Add frames, and the window of each; -1 for none."""
        if not (windows >= 0).all():
            rows = np.flatnonzero(windows >= 0)
            table, windows = table.take(rows), windows[rows]
        for found, rows in self.identifiers.groups(table):
            found.add(table.data[rows], table.length[rows], table.time[rows], windows[rows])
