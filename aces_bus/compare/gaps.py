"""Times from one frame to the next, counted in bounded memory.

1. A gap falls into one of `BINS` bins that are each 2 % wide; a bin knows the mean of its gaps, so that the period of a
   message that is sent periodically comes out exact.
"""

from __future__ import annotations

import math

from .._lazy import np
from ..frame_table import Ints

#: The first bin begins here (ns); each is so much wider than the one before; the last one ends at a day.
FIRST_NS, STEP, BINS = 1000, 1.02, 1272
#: Two samples of n gaps each differ by more than this over √(n/2) in one of a thousand cases where they are of one kind
#: (Smirnov, Annals of Mathematical Statistics 19, 1948).
SMIRNOV = 1.95


class GapCounts:
    """Gaps (ns) by their size."""

    def __init__(self) -> None:
        self.count = 0
        self._counts: Ints = np.zeros(BINS, np.int64)
        self._sums: Ints = np.zeros(BINS, np.float64)

    def add(self, gaps_ns: Ints) -> None:
        """Count gaps; frames of one instant have none."""
        gaps = gaps_ns[gaps_ns > 0].astype(np.float64)
        if not len(gaps):
            return
        places = (np.log(np.maximum(gaps, FIRST_NS) / FIRST_NS) * (1 / math.log(STEP))).astype(np.int64)
        places = np.minimum(places, BINS - 1)
        self.count += len(gaps)
        self._counts += np.bincount(places, minlength=BINS)
        self._sums += np.bincount(places, gaps, minlength=BINS)

    @property
    def median_ns(self) -> float | None:
        """The median gap, None where there are fewer than two."""
        if self.count < 2:
            return None
        at = int(np.searchsorted(np.cumsum(self._counts), (self.count + 1) // 2))
        return float(self._sums[at] / self._counts[at])

    def differs_by(self, other: GapCounts) -> float:
        """The largest difference of the two distributions' cumulative shares; 0 where it may be chance."""
        if not self.count or not other.count:
            return 0.0
        mine, theirs = (np.cumsum(one._counts) / one.count for one in (self, other))
        found = float(np.abs(mine - theirs).max())
        return found if found > SMIRNOV * math.sqrt(1 / self.count + 1 / other.count) else 0.0
