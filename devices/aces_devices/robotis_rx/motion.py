"""How a simulated servo turns: where it is at any instant, computed on request.

1. The same goals at the same instants give the same motion; asking changes nothing.
2. Angles are counts of 300°/1023, as fractions; counter-clockwise is positive.

The drive is the punch plus (distance − margin) ÷ slope, at most the torque limit; the speed is the drive's share of the
greatest speed, at most the speed that was set. So it runs at a constant speed, slows down exponentially within the
slope, and ends near the margin. There is no inertia and no load. A choice: the vendor's manual draws the compliance
curve and says nothing of dynamics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from aces_protocols.robotis.control_table import ANGLE, SPEED

TOP = 1023
#: Counts a second at one count of moving speed: 0.111 rpm.
PER_SPEED = SPEED * 6 / ANGLE
#: The greatest speed (counts of moving speed): 60 rpm, an RX-28 at 12 V about. A choice of this model.
FREE = 540
#: A whole turn, in counts.
TURN = 360 / ANGLE
#: It rests a count before the margin: a recorded servo rests 2 counts from its goal, at a margin of 1 and no load.
REST = 1
#: What rounding leaves of a count.
HAIR = 1e-9


@dataclass
class ShaftMotion:
    """One servo's shaft. After a change of anything, call `settle` first, then change it."""

    at: float = 512.0
    since: int = 0
    goal: float = 512.0
    is_driven: bool = False
    is_jammed: bool = False
    #: As registers have them: moving speed (0: none set), torque limit, punch, compliance by direction (cw, ccw).
    speed: int = 0
    limit: int = TOP
    punch: int = 32
    margin: tuple[int, int] = (0, 0)
    slope: tuple[int, int] = (32, 32)
    #: Endless turn: share of the torque, counter-clockwise positive; None: it goes to its goal.
    duty: float | None = None

    def settle(self, now: int) -> None:
        """Make `now` the instant that motion is counted from."""
        self.at, self.since = self.position(now), now

    def position(self, now: int) -> float:
        """Return the position (counts); in endless turn it wraps at a whole turn."""
        left = max(0, now - self.since) / 1e9
        if not self.is_driven or self.is_jammed or not left:
            return self.at
        if self.duty is not None:
            return (self.at + self._duty_speed() * left) % TURN
        gap = self.goal - self.at
        return self.goal - math.copysign(self._gap_after(abs(gap), gap > 0, left), gap) if gap else self.at

    def speed_at(self, now: int) -> float:
        """Return how fast it turns (counts a second)."""
        if not self.is_driven or self.is_jammed:
            return 0.0
        if self.duty is not None:
            return self._duty_speed()
        gap = self.goal - self.position(now)
        drive = self._drive(abs(gap), gap > 0)
        return math.copysign(min(drive * self._free(), self._top()), gap) if drive else 0.0

    def drive_at(self, now: int) -> float:
        """Return the share of the torque that it turns, or holds, with; counter-clockwise positive."""
        if not self.is_driven:
            return 0.0
        most = self.limit / TOP
        if self.duty is not None:
            return max(-most, min(most, self.duty))
        gap = self.goal - self.position(now)
        if self.is_jammed and abs(gap) > self._rest(gap > 0):
            return math.copysign(most, gap)
        return math.copysign(self._drive(abs(gap), gap > 0), gap)

    def is_moving(self, now: int) -> bool:
        """Return whether it is on its way to its goal, or would be if nothing held it."""
        if not self.is_driven or self.limit == 0:
            return False
        if self.duty is not None:
            return bool(self.duty)
        gap = self.goal - self.position(now)
        return abs(gap) > self._rest(gap > 0) + HAIR

    # ------------------------------------------------------------------ the curve

    def _rest(self, is_ccw: bool) -> int:
        return self.margin[is_ccw] + REST

    def _free(self) -> float:
        return FREE * PER_SPEED

    def _top(self) -> float:
        """Return the greatest allowed speed (counts a second)."""
        most = self._free() * self.limit / TOP
        return min(most, self.speed * PER_SPEED) if self.speed else most

    def _duty_speed(self) -> float:
        assert self.duty is not None
        most = self.limit / TOP
        return max(-most, min(most, self.duty)) * self._free()

    def _drive(self, gap: float, is_ccw: bool) -> float:
        over = gap - self.margin[is_ccw]
        return (
            0.0
            if over <= REST + HAIR
            else min(self.limit / TOP, self.punch / TOP + over / STEPS[self.slope[is_ccw]])
        )

    def _gap_after(self, gap: float, is_ccw: bool, left: float) -> float:
        """Return what is left of a distance after some seconds."""
        margin, top, free = self.margin[is_ccw], self._top(), self._free()
        slope, punch = STEPS[self.slope[is_ccw]], self.punch / TOP
        if gap <= margin + REST or top <= 0:
            return gap
        # At a constant speed, down to where the drive asks for less.
        bend = margin + max(0.0, slope * (top / free - punch))
        if gap > bend:
            if left * top < gap - bend:
                return max(float(margin + REST), gap - left * top)
            left -= (gap - bend) / top
            gap = bend
        # From there: d(gap)/dt = −free · (punch + (gap − margin) ÷ slope).
        rest = (gap - margin + slope * punch) * math.exp(-free * left / slope) - slope * punch
        return max(float(REST), rest) + margin


def _step(slope: int) -> int:
    return max((step for step in (4, 8, 16, 32, 64, 128, 254) if step <= slope), default=4)


#: What a compliance slope acts as: 4, 8, 16, 32, 64, 128 or 254 (RX-28 manual).
STEPS = tuple(_step(slope) for slope in range(256))
