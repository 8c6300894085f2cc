"""How a simulated servo with a steady speed turns: where it is at any instant, computed on request.

1. The same goals at the same instants give the same motion; asking changes nothing.
2. Positions are counts of the servo, as fractions, and speeds counts a second.

To a goal it turns at its speed limit, and stops there at once; otherwise it turns at the speed that it is driven with.
There is no inertia and no load. A choice: no sheet says anything of dynamics. What it measures of its speed is the mean of
`WINDOW_NS`, as of counts of an encoder: a goal that moves on in small steps is followed at the mean speed of the steps.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

#: The time that a measured speed is the mean of (ns). A choice.
WINDOW_NS = 10_000_000


@dataclass
class SteadyShaft:
    """One servo's shaft. Before a change of anything, call `settle`."""

    at: float = 0.0
    since: int = 0
    goal: float = 0.0
    is_driven: bool = False
    is_jammed: bool = False
    #: The greatest speed on the way to a goal.
    limit: float = 0.0
    #: The speed that it turns with, without a goal; None: it goes to its goal.
    speed: float | None = None
    #: Instants (ns) at which motion changed, with where it was: the last before `WINDOW_NS`, and those since.
    _path: deque[tuple[int, float]] = field(default_factory=deque[tuple[int, float]])

    def settle(self, now: int) -> None:
        """Make `now` (ns) the instant that motion is counted from."""
        self.at, self.since = self.position(now), now
        self._path.append((now, self.at))
        self._forget(now)

    def _forget(self, now: int) -> None:
        path = self._path
        while len(path) > 1 and path[1][0] <= now - WINDOW_NS:
            path.popleft()

    def position(self, now: int) -> float:
        """Return where it is."""
        left = max(0, now - self.since) / 1e9
        if not self.is_driven or self.is_jammed:
            return self.at
        if self.speed is not None:
            return self.at + self.speed * left
        gap = self.goal - self.at
        return self.goal if abs(gap) <= self.limit * left else self.at + math.copysign(self.limit * left, gap)

    def speed_at(self, now: int) -> float:
        """Return how fast it turned in the last `WINDOW_NS`, as it measures it."""
        self._forget(now)
        begin, here, path = now - WINDOW_NS, self.position(now), self._path
        if begin >= self.since or not path:
            was = self.position(begin)
        else:
            (before, was), (after, then) = path[0], path[1] if len(path) > 1 else (self.since, self.at)
            if before < begin < after:  # on its way between these two
                was += (then - was) * (begin - before) / (after - before)
        most = max(self.limit, abs(self.speed or 0.0))  # its counts jump where its zero is set
        return max(-most, min(most, (here - was) / (WINDOW_NS / 1e9)))

    def wanted_at(self, now: int) -> float:
        """Return how fast it would turn if nothing held it."""
        if not self.is_driven:
            return 0.0
        if self.speed is not None:
            return self.speed
        gap = self.goal - self.position(now)
        return math.copysign(self.limit, gap) if gap else 0.0
