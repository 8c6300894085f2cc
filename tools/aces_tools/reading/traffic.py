"""Frames counted by identifier: how many, how far apart, how long; for summaries of recordings.

1. Memory is bounded: `MOST_IDENTIFIERS` counts, of which each has `EXACT` gaps and then bins; what is beyond is counted.
2. A gap is between two frames of one identifier and one window; frames of one instant have none.
3. So many gaps are kept as they are, and what is said of them is exact. More are counted in bins that are each 2 % wide and
   know their mean: the period of a message that is sent periodically still is exact, and what varies is off by 2 % at most.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Sequence
from typing import Generic, NamedTuple, TypeVar

from aces_bus import FrameTable
from aces_bus._lazy import np
from aces_bus.frame_table import NO_TIME, FrameFlag, Ints
from aces_bus.frames import EXTENDED, FD, REMOTE

#: Identifiers that are counted one by one; a bus that works has fewer.
MOST_IDENTIFIERS = 4096
#: Gaps of an identifier that are kept as they are.
EXACT = 1024
#: The first bin begins here (ns); each is so much wider than the one before; the last one ends at a day.
FIRST_NS, STEP, BINS = 1000, 1.02, 1272
#: Two samples of n gaps each differ by more than this over √(n/2) in one of a thousand cases where they are of one kind
#: (Smirnov, Annals of Mathematical Statistics 19, 1948).
SMIRNOV = 1.95


class BusIdentifier(NamedTuple):
    """A channel's name (None: the recording has none), a key of `aces_bus.frames`, whether it is an error frame's."""

    channel: str | None
    key: int
    is_error: bool = False

    @property
    def number(self) -> int:
        """The identifier's 11 or 29 bits."""
        return self.key & 0x1FFF_FFFF

    @property
    def is_extended(self) -> bool:
        """True if the identifier has 29 bits."""
        return bool(self.key & EXTENDED)

    @property
    def digits(self) -> str:
        """The identifier as candump writes it: three digits, or eight of 29 bits."""
        return f"{self.number:0{8 if self.is_extended else 3}X}"

    def __str__(self) -> str:
        """Return the digits, and what is unusual."""
        marks = (("remote", self.key & REMOTE), ("FD", self.key & FD), ("error", self.is_error))
        return " ".join([self.digits, *(mark for mark, is_set in marks if is_set)])


def rows_of_each(values: Ints) -> list[Ints]:
    """Return where each distinct value is: arrays of places in their order, those of the lowest value first."""
    if not len(values):
        return []
    values = values - values.min()
    if values.max() < 1 << 16:
        values = values.astype(np.uint16)  # of these NumPy sorts digits: several times faster
    order = np.argsort(values, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(values[order])) + 1)


def identifier_groups(table: FrameTable) -> list[tuple[BusIdentifier, Ints]]:
    """Return the rows of each identifier of a table, in order."""
    is_error = (table.flags & FrameFlag.ERROR != 0).astype(np.uint64)
    slots = is_error << np.uint64(48) | table.channel.astype(np.uint64) << np.uint64(32) | table.key
    groups = rows_of_each(slots)
    firsts = [int(rows[0]) for rows in groups]
    return [
        (
            BusIdentifier(
                table.channels.names[int(table.channel[first])],
                int(table.key[first]),
                bool(table.flags[first] & FrameFlag.ERROR),
            ),
            rows,
        )
        for first, rows in zip(firsts, groups, strict=True)
    ]


class GapCounts:
    """Times (ns) from one frame to the next, of which the first `exact` are kept as they are."""

    def __init__(self, exact: int = EXACT) -> None:
        self.count = 0
        self._exact = exact
        self._gaps = array("q")
        #: Once there are more: of each bin how many gaps it has, and their sum.
        self._bins: tuple[Ints, Ints] | None = None

    def add(self, gaps_ns: Ints) -> None:
        """Count gaps; those of frames of one instant are none."""
        gaps = gaps_ns[gaps_ns > 0]
        self.count += len(gaps)
        if self._bins is None and self.count <= self._exact:
            self._gaps.frombytes(gaps.astype(np.int64).tobytes())
            return
        if self._bins is None:
            gaps = np.concatenate((np.frombuffer(self._gaps, np.int64), gaps))
            self._bins = np.zeros(BINS, np.int64), np.zeros(BINS, np.float64)
            self._gaps = array("q")
        for bins, more in zip(self._bins, _binned(gaps), strict=True):
            bins += more

    def quantiles_ns(self, shares: Sequence[float]) -> list[float] | None:
        """Return gaps that these shares of all are not longer than; None where there are fewer than two."""
        if self.count < 2:
            return None
        if self._bins is None:
            return [float(gap) for gap in np.quantile(np.frombuffer(self._gaps, np.int64), shares)]
        counts, sums = self._bins
        ranks = np.ceil(np.array(shares) * self.count).clip(1)
        places = np.searchsorted(np.cumsum(counts), ranks)
        return [float(sums[at] / counts[at]) for at in places.tolist()]

    @property
    def median_ns(self) -> float | None:
        """The median gap, None where there are fewer than two."""
        found = self.quantiles_ns((0.5,))
        return None if found is None else found[0]

    def differs_by(self, other: GapCounts) -> float:
        """Return the largest difference of the two distributions' cumulative shares; 0 where it may be chance."""
        if not self.count or not other.count:
            return 0.0
        mine, theirs = (np.cumsum(side._counts) / side.count for side in (self, other))
        found = float(np.abs(mine - theirs).max())
        return found if found > SMIRNOV * math.sqrt(1 / self.count + 1 / other.count) else 0.0

    @property
    def _counts(self) -> Ints:
        return (self._bins or _binned(np.frombuffer(self._gaps, np.int64)))[0]


def _binned(gaps_ns: Ints) -> tuple[Ints, Ints]:
    gaps = gaps_ns.astype(np.float64)
    places = (np.log(np.maximum(gaps, FIRST_NS) / FIRST_NS) * (1 / math.log(STEP))).astype(np.int64)
    places = np.minimum(places, BINS - 1)
    return np.bincount(places, minlength=BINS), np.bincount(places, gaps, minlength=BINS)


class ArrivalCount:
    """How many of a kind came (frames of an identifier, messages of a device), and how far apart."""

    def __init__(self, exact: int = EXACT) -> None:
        self.frames = 0
        self.gaps = GapCounts(exact)
        self._last: tuple[int, int] = NO_TIME, -1

    def arrive(self, times: Ints, windows: Ints | None = None) -> Ints:
        """Count more, in order: their instants, and the window of each. Which of them follow another one of their window."""
        before, window = self._last
        self.frames += len(times)
        previous = np.concatenate(([before], times[:-1]))
        if windows is None:
            follows = np.ones(len(times), bool)
            follows[0] = window >= 0
        else:
            follows = np.concatenate(([window], windows[:-1])) == windows
        self.gaps.add((times - previous)[follows & (times != NO_TIME) & (previous != NO_TIME)])
        self._last = int(times[-1]), 0 if windows is None else int(windows[-1])
        return follows

    @property
    def period_ms(self) -> float | None:
        """The median time from one to the next, None where there are no times or too few."""
        median = self.gaps.median_ns
        return None if median is None else median / 1e6


class FrameCount(ArrivalCount):
    """How many frames of one identifier came, how far apart, and how long they are."""

    def __init__(self, exact: int = EXACT) -> None:
        super().__init__(exact)
        #: How many frames had each number of bytes.
        self.lengths: Ints = np.zeros(65, np.int64)

    def count(self, times: Ints, lengths: Ints, windows: Ints | None = None) -> Ints:
        """Count more frames, in order. Which of them follow another one of their window."""
        self.lengths += np.bincount(lengths, minlength=65)
        return self.arrive(times, windows)

    @property
    def lengths_seen(self) -> tuple[int, ...]:
        """The numbers of bytes that frames had, lowest first."""
        return tuple(np.flatnonzero(self.lengths).tolist())


C = TypeVar("C")


class IdentifierCounts(dict[BusIdentifier, C], Generic[C]):
    """What is counted of each identifier, made by `make` when its first frame comes."""

    def __init__(self, make: Callable[[BusIdentifier], C]) -> None:
        super().__init__()
        self._make = make
        #: All frames; and those of identifiers for which there was no room.
        self.frames = self.beyond = 0

    def groups(self, table: FrameTable) -> Iterator[tuple[C, Ints]]:
        """Yield the count of each identifier of a table, and the rows that it gets."""
        self.frames += len(table)
        for identifier, rows in identifier_groups(table):
            found = self.get(identifier)
            if found is None:
                if len(self) >= MOST_IDENTIFIERS:
                    self.beyond += len(rows)
                    continue
                found = self[identifier] = self._make(identifier)
            yield found, rows
