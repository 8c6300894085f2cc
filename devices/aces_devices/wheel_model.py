"""Simulated wheels: one whose speed follows a goal with one time constant, one that turns steadily.

1. Exact, and lazy: it is solved, not stepped, and nothing is computed until it is asked for.
2. SI: rad, rad/s, s; instants in ns.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from math import exp

#: The time that a measured speed is the mean of (ns). A choice.
WINDOW_NS = 10_000_000


class TurningWheel:
    """A wheel at rest: `lead` it to a speed, `position` (rad) and `speed` (rad/s) at an instant (ns)."""

    __slots__ = ("_angle", "_at", "_goal", "_speed", "_tau")

    def __init__(self, now: int) -> None:
        self._at, self._angle, self._speed, self._goal, self._tau = now, 0.0, 0.0, 0.0, 1.0

    def _sync(self, now: int) -> None:
        if now <= self._at:
            return
        time = (now - self._at) / 1e9
        left = exp(-time / self._tau)
        gone = self._speed - self._goal
        self._angle += self._goal * time + gone * self._tau * (1 - left)
        self._speed = self._goal + gone * left
        self._at = now

    def lead(self, now: int, speed: float, time_constant: float) -> None:
        """Lead it to this speed from now on, with this time constant (s)."""
        self._sync(now)
        self._goal, self._tau = speed, time_constant

    def block(self, now: int) -> None:
        """Stop it where it is."""
        self._sync(now)
        self._speed = self._goal = 0.0

    def place(self, now: int, angle: float) -> None:
        """Put it to an angle, at rest."""
        self.block(now)
        self._angle = angle

    def position(self, now: int) -> float:
        """Return where it is (rad)."""
        self._sync(now)
        return self._angle

    def speed(self, now: int) -> float:
        """Return how fast it turns (rad/s)."""
        self._sync(now)
        return self._speed


@dataclass
class SteadyShaft:
    """A shaft that turns to its goal at its greatest speed, or on at a speed, in counts. Before a change, call `settle`.

    A measured speed is the mean of `WINDOW_NS`, as of counts of an encoder.
    """

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
