"""A simulated wheel: its speed follows a goal with one time constant.

1. Exact, and lazy: it is solved, not stepped, and nothing is computed until it is asked for.
2. SI: rad, rad/s, s; instants in ns.
"""

from __future__ import annotations

from math import exp


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
