"""How long each side was looked at, and so what it would have seen, had nothing changed.

1. All that is in a side's times counts, also what is left out of the comparison: that nothing of a kind came says something
   only where somebody was looking.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from aces_bus._lazy import np
from aces_bus.frame_table import NO_TIME, Ints


class WatchedTime:
    """How long a side was looked at: frames (of a line: messages), and the time from each window's first to its last."""

    def __init__(self, windows: int = 1) -> None:
        self.frames = 0
        self._first: Ints = np.full(windows, np.iinfo(np.int64).max, np.int64)
        self._last: Ints = np.full(windows, NO_TIME, np.int64)

    def add(self, times: Ints, windows: Ints) -> None:
        """Add instants (ns), and the window of each; -1 for none."""
        inside = windows >= 0
        self.frames += int(np.count_nonzero(inside))
        known = inside & (times != NO_TIME)
        np.minimum.at(self._first, windows[known], times[known])
        np.maximum.at(self._last, windows[known], times[known])

    @property
    def seconds(self) -> float | None:
        """Total length of the windows (s); None without times."""
        seen = self._last != NO_TIME
        return float((self._last - self._first)[seen].sum()) / 1e9 if seen.any() else None


@dataclass(frozen=True)
class Exposure:
    """How much of the same each side would have seen, had nothing changed: seconds, or where there are no times frames."""

    a: float
    b: float
    is_time: bool

    @classmethod
    def of(cls, a: WatchedTime, b: WatchedTime) -> Exposure:
        """Return the exposure of two sides; frames count where one side has no times, or all of its frames at
        one instant.
        """
        if a.seconds and b.seconds:
            return cls(a.seconds, b.seconds, True)
        return cls(float(a.frames), float(b.frames), False)

    def lone_score(self, kind: Literal["appears", "vanishes"], frames: int) -> float:
        """Return how sure it is that the other side would have had one of these frames, too, if they came as often there.

        Of a rate that gives n frames here, none comes there with probability exp(-n x there / here). Where a side has
        seen nothing at all, nothing is sure.
        """
        here, there = (self.b, self.a) if kind == "appears" else (self.a, self.b)
        return -math.expm1(-frames * there / here) if here and there else 0.5
