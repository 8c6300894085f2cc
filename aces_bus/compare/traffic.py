"""What the frames of each identifier are like, without knowing what they mean.

1. Frames of remote requests have no data, and count by their number alone.
2. Memory is bounded: `MOST_IDENTIFIERS` profiles of some 20 KB (of 64-byte frames 140 KB); what is beyond is counted.
3. A gap, a flip and a visit are between two frames of one identifier inside one window.
"""

from __future__ import annotations

from typing import NamedTuple

from .._lazy import np
from ..frame_table import ERROR, KEY_EXTENDED, KEY_FD, KEY_REMOTE, NO_TIME, FrameTable, Ints, widened
from .gaps import GapCounts

#: Identifiers that have a profile; a bus that works has fewer.
MOST_IDENTIFIERS = 4096


class BusIdentifier(NamedTuple):
    """A channel's name (None: the recording has none), a key of `aces_bus.protocol.keys`, whether it is an error frame's."""

    channel: str | None
    key: int
    is_error: bool = False

    @property
    def number(self) -> int:
        """The identifier's 11 or 29 bits."""
        return self.key & 0x1FFF_FFFF

    @property
    def is_extended(self) -> bool:
        """Whether it has 29 bits."""
        return bool(self.key & KEY_EXTENDED)

    @property
    def digits(self) -> str:
        """The identifier as candump writes it: three digits, or eight of 29 bits."""
        return f"{self.number:0{8 if self.is_extended else 3}X}"

    def __str__(self) -> str:
        """The digits, and what is unusual."""
        marks = (("remote", self.key & KEY_REMOTE), ("FD", self.key & KEY_FD), ("error", self.is_error))
        return " ".join([self.digits, *(mark for mark, is_set in marks if is_set)])


def identifier_groups(table: FrameTable) -> list[tuple[BusIdentifier, Ints]]:
    """The rows of each identifier of a table, in order."""
    if not len(table):
        return []
    is_error = (table.flags & ERROR != 0).astype(np.uint64)
    slots = is_error << np.uint64(48) | table.channel.astype(np.uint64) << np.uint64(32) | table.key
    order = np.argsort(slots, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(slots[order])) + 1)
    firsts = [int(rows[0]) for rows in groups]
    return [
        (
            BusIdentifier(
                table.channels.names[int(table.channel[first])],
                int(table.key[first]),
                bool(table.flags[first] & ERROR),
            ),
            rows,
        )
        for first, rows in zip(firsts, groups, strict=True)
    ]


class IdentifierTraffic:
    """The frames of one identifier on one side. Arrays by byte have `width` entries, as long as the longest frame."""

    def __init__(self, windows: int, *, has_data: bool = True) -> None:
        self.has_data = has_data
        self.frames = 0
        self.gaps = GapCounts()
        #: How many frames had each length.
        self.lengths: Ints = np.zeros(65, np.int64)
        self.width = 0
        #: Of each byte: how many frames had each value, and how often it became so: (width, 256).
        self.values: Ints = np.zeros((0, 256), np.uint32)
        self.visits: Ints = np.zeros((0, 256), np.uint32)
        #: How often each bit flipped from one frame to the next: (width, 8), the lowest bit first.
        self.flips: Ints = np.zeros((0, 8), np.int64)
        #: Of each window: bits that were seen set, and seen clear: (windows, width).
        self.ones: Ints = np.zeros((windows, 0), np.uint8)
        self.zeros: Ints = np.zeros((windows, 0), np.uint8)
        self._last: tuple[int, int, Ints, int] | None = None

    def add(self, data: Ints, lengths: Ints, times: Ints, windows: Ints) -> None:
        """More frames in order: bytes (n, 8 or 64), their number, instants, and each one's window."""
        n = len(data)
        self.frames += n
        self.lengths += np.bincount(lengths, minlength=65)
        self._widen(int(lengths.max()) if self.has_data else 0)
        width = self.width
        before_time, before_window, before_data, before_length = self._last or (NO_TIME, -1, data[0], 0)
        previous_times = np.concatenate(([before_time], times[:-1]))
        previous_windows = np.concatenate(([before_window], windows[:-1]))
        follows = previous_windows == windows
        timed = follows & (times != NO_TIME) & (previous_times != NO_TIME)
        self.gaps.add((times - previous_times)[timed])
        self._last = int(times[-1]), int(windows[-1]), data[-1], int(lengths[-1])
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
            self.flips[byte] += _BITS_OF_VALUES @ _tally(flipped[flipped != 0])
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

    @property
    def period_ms(self) -> float | None:
        """The median time from one frame to the next, None where there are no times or too few frames."""
        median = self.gaps.median_ns
        return None if median is None else median / 1e6


#: Which of the 256 values of a byte have bit 0 set, bit 1, …: (8, 256).
_BITS_OF_VALUES: Ints = np.arange(256) >> np.arange(8)[:, None] & 1


def _tally(values: Ints) -> Ints:
    """How often each of the 256 values of a byte occurs."""
    counts: Ints = np.bincount(values, minlength=256).astype(np.uint32)
    return counts


class TrafficProfile:
    """The frames of one side: of a recording, or of its windows."""

    def __init__(self, windows: int = 1) -> None:
        self.windows = windows
        self.frames = 0
        #: Frames of identifiers for which there was no room.
        self.beyond = 0
        self.identifiers: dict[BusIdentifier, IdentifierTraffic] = {}
        self._first: Ints = np.full(windows, np.iinfo(np.int64).max, np.int64)
        self._last: Ints = np.full(windows, NO_TIME, np.int64)

    @property
    def seconds(self) -> float | None:
        """How long the windows are together, from the first frame of each to its last; None without times."""
        seen = self._last != NO_TIME
        return float((self._last - self._first)[seen].sum()) / 1e9 if seen.any() else None

    def add(self, table: FrameTable, windows: Ints) -> None:
        """Frames, and the window that each is in; -1 is none."""
        if not (windows >= 0).all():
            rows = np.flatnonzero(windows >= 0)
            table, windows = table.take(rows), windows[rows]
        if not len(table):
            return
        self.frames += len(table)
        known = table.time != NO_TIME
        np.minimum.at(self._first, windows[known], table.time[known])
        np.maximum.at(self._last, windows[known], table.time[known])
        for identifier, rows in identifier_groups(table):
            found = self.identifiers.get(identifier)
            if found is None:
                if len(self.identifiers) >= MOST_IDENTIFIERS:
                    self.beyond += len(rows)
                    continue
                has_data = not identifier.key & KEY_REMOTE
                found = self.identifiers[identifier] = IdentifierTraffic(self.windows, has_data=has_data)
            found.add(table.data[rows], table.length[rows], table.time[rows], windows[rows])
