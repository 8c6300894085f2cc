"""How a simulated servo with a steady speed turns: where it is at any instant, computed on request.

1. The same goals at the same instants give the same motion; asking changes nothing.
2. Positions are counts of the servo, as fractions, and speeds counts a second.

To a goal it turns at its speed limit, and stops there at once; otherwise it turns at the speed that it is driven with.
There is no inertia and no load. A choice: no sheet says anything of dynamics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


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

    def settle(self, now: int) -> None:
        """Make `now` (ns) the instant that motion is counted from."""
        self.at, self.since = self.position(now), now

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
        """Return how fast it turns."""
        return 0.0 if self.is_jammed else self.wanted_at(now)

    def wanted_at(self, now: int) -> float:
        """Return how fast it would turn if nothing held it."""
        if not self.is_driven:
            return 0.0
        if self.speed is not None:
            return self.speed
        gap = self.goal - self.position(now)
        return math.copysign(self.limit, gap) if gap else 0.0
