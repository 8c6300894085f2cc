"""The limiter of set-points: limits of position, rate and acceleration, from one set-point to the next.

1. What leaves is within the limits of position and within the rate, always; within the acceleration too, unless that would
   lead past a limit of position. What begins outside of its limits is led inside by the same rules, never further out.
2. A feasible motion passes unchanged, to the last bit; what is changed is counted.

The door has a limiter for each signal. A guard has its own only where its set-points do not leave by a door.

Theory. With velocities in units of a·dt, stopping from w takes whole steps: the largest w that still stops within the
distance m (in units of a·dt²) is m/(n+1) + n/2 with n the largest whole number of n(n+1)/2 ≤ m. That bounds the velocity
towards a limit of position. Where the set-points themselves are too fast, the same bound on the distance to them, beside
their own velocity, catches up without overshoot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from ..errors import CallerError
from .trip import Clipped

if TYPE_CHECKING:
    from ..device.config import Robot

#: So many set-points of one state in a row that are not finite numbers stop motion.
NOT_FINITE_TRIPS = 5
#: How fast (unit/s) a position is led for which no file states a speed, by its unit: no joint jumps within a frame.
USUAL_SPEED = {"rad": 1.0, "m": 0.1}
#: What pushes a joint on, or turns it: the last part of a state's name. At rest it is 0.
PUSHES = frozenset(("velocity", "torque", "current", "duty"))
INFINITY = math.inf


@dataclass(frozen=True)
class Bounds:
    """The limits of a state's set-points: unit, unit/s, unit/s². Infinity says "not limited".

    `rest` is the set-point at which it stands still; None: any, as of a position.
    """

    lower: float = -math.inf
    upper: float = math.inf
    rate: float = math.inf
    acceleration: float = math.inf
    rest: float | None = None

    def __post_init__(self) -> None:
        if not (self.lower <= self.upper and self.rate > 0 and self.acceleration > 0):
            raise CallerError(
                f"{self}: lower must not be above upper, and rate and acceleration must be above 0"
            )

    def within(self, other: Bounds) -> Bounds:
        """Return what keeps both; raises `CallerError` where nothing can."""
        return Bounds(
            max(self.lower, other.lower),
            min(self.upper, other.upper),
            min(self.rate, other.rate),
            min(self.acceleration, other.acceleration),
            self.rest if other.rest is None else other.rest,
        )


def rest_of(name: str) -> float | None:
    """Return the set-point at which a signal of this name stands still; None: any."""
    return 0.0 if name.rpartition(".")[2] in PUSHES else None


def _reach(distance: float, quantum: float) -> float:
    """Return the largest step towards something `distance` away that can still stop there; `quantum` is a·dt²."""
    if distance <= 0.0:
        return 0.0
    m = distance / quantum
    n = int(0.5 * (math.sqrt(1.0 + 8.0 * m) - 1.0)) if m < 1e12 else 0
    return distance if n == 0 and m < 1e12 else (m / (n + 1) + 0.5 * n) * quantum if n else INFINITY


class Limiter:
    """One signal's set-points: the last that left, its velocity, and the last that was asked for."""

    __slots__ = (
        "acceleration",
        "asked",
        "counts",
        "given",
        "limited_by",
        "lower",
        "rate",
        "rest",
        "speed",
        "upper",
        "utmost",
    )

    def __init__(self, bounds: Bounds) -> None:
        self.counts = Clipped()
        self.lower, self.upper = bounds.lower, bounds.upper
        self.acceleration, self.rest = bounds.acceleration, bounds.rest
        self.take_rate(bounds.rate)
        #: What left last; None: nothing since it began anew. A number of whatever type it was given in.
        self.given: Any = None
        #: What was wanted then, and the velocity (unit/s) it left with.
        self.asked: Any = 0.0
        self.speed = 0.0
        #: What kept the last one from its goal; "": nothing did.
        self.limited_by: Literal["", "rate", "acceleration"] = ""

    def take_rate(self, rate: float) -> None:
        """Lead no faster than `rate` (unit/s) from now on."""
        self.rate = rate
        self.utmost = rate * (1 + 1e-9)  # a hair more is rounding

    def pass_on(self, wanted: float, dt: float) -> float:
        """Return the set-point that leaves for the one that is wanted, `dt` seconds after the last."""
        before = self.given
        # Nearly every set-point: as asked, far enough from the limits to stop.
        if before is not None and self.lower <= wanted <= self.upper:
            if wanted == before and not self.speed:
                self.asked = wanted
                return wanted
            speed = (wanted - before) / dt
            if -self.utmost <= speed <= self.utmost:
                acceleration = self.acceleration
                if acceleration == INFINITY:
                    self.speed, self.given, self.asked = speed, wanted, wanted
                    return wanted
                size = speed if speed > 0.0 else -speed
                # A hair more is rounding of the differences.
                most = acceleration * dt * (1 + 1e-9) + 1e-9 * size
                # Who is behind must arrive slowly enough to stay with the set-points.
                if -most <= speed - self.speed <= most and (
                    before == self.asked or size <= acceleration * dt
                ):
                    room = self.upper - before if speed > 0.0 else before - self.lower
                    if size * (size / (2.0 * acceleration) + dt) <= room or (
                        size * dt <= _reach(room, acceleration * dt * dt) * (1 + 1e-9)
                    ):
                        self.speed, self.given, self.asked = speed, wanted, wanted
                        return wanted
        goal = self.within(wanted)
        if before is None:
            self.given = self.asked = goal
            return goal  # type: ignore[no-any-return]
        given = self.advance(goal, dt)
        self.count()
        return given

    def count(self) -> None:
        """Count a set-point that was limited on its way."""
        if self.limited_by == "rate":
            self.counts.rate += 1
        elif self.limited_by:
            self.counts.acceleration += 1
        self.limited_by = ""

    def within(self, wanted: Any) -> Any:
        """Return what is wanted, or the limit of position that it is beyond; that is counted."""
        if self.lower <= wanted <= self.upper:
            return wanted
        self.counts.position += 1
        return self.lower if wanted < self.lower else self.upper

    def advance(self, goal: float, dt: float) -> float:
        """Return the next set-point on the way to a goal within the limits, `dt` seconds after the last."""
        before = self.given
        acceleration, rate = self.acceleration, self.rate
        own = (goal - self.asked) / dt  # the set-points' own velocity
        self.asked = goal
        new = (goal - before) / dt
        if not -self.utmost <= new <= self.utmost:
            self.limited_by = "rate"
            new = rate if new > 0 else -rate
        if acceleration < INFINITY:
            quantum = acceleration * dt * dt
            behind = goal - before - own * dt
            catch_up = math.copysign(_reach(abs(behind), quantum) / dt, behind) + own
            bounded = (
                max(-rate, min(rate, catch_up)) if abs(catch_up) < abs(new) or catch_up * new < 0 else new
            )
            most = acceleration * dt
            low, high = self.speed - most, self.speed + most
            bounded = low if bounded < low else high if bounded > high else bounded
            if abs(bounded - new) * dt > 1e-12 * (1 + abs(goal)):
                self.limited_by = "acceleration"
            new = bounded
            # Whatever the rest says, it must be able to stop before the limits of position.
            up = _reach(self.upper - before, quantum) / dt if self.upper < INFINITY else INFINITY
            down = _reach(before - self.lower, quantum) / dt if self.lower > -INFINITY else INFINITY
            new = up if new > up else -down if new < -down else new
            new = rate if new > rate else -rate if new < -rate else new
        given = self._inside(before + new * dt, before)
        if abs(given - goal) <= 1e-12 * (1 + abs(goal)):
            given = goal  # met again, to the last bit
        self.speed, self.given = (given - before) / dt, given
        return given

    def _inside(self, given: float, before: float) -> float:
        """Return the value within the limits of position; from outside of them, no further outside."""
        if given < self.lower:
            return given if given >= before else min(before, self.lower)
        if given > self.upper:
            return given if given <= before else max(before, self.upper)
        return given

    def resting(self, dt: float) -> Any:
        """Return the set-point at which it stands still soonest, in steps of `dt` seconds; None before the first."""
        if self.rest is not None and self.given is not None:
            return self.rest
        size = abs(self.speed)
        if self.given is None or size <= self.acceleration * dt:
            return self.given
        braking = size * (size / self.acceleration - dt) / 2.0
        return self._inside(self.given + math.copysign(braking, self.speed), self.given)


def bounds_of(robot: Robot, *, nominal: bool = False, acceleration: bool = False) -> dict[str, Bounds]:
    """Return bounds of a robot's active joints, as far as its file states them: its largest speeds, or its
    `nominal` ones.

    A joint that is set by position and has neither is led at `USUAL_SPEED`.
    Set-points are positions, speeds, currents (A) or duties, as each joint's `command` says. Accelerations are limited only
    where that is asked for: a file's are often those of its maker's own motion planner, and recorded walks go beyond them.
    """
    out: dict[str, Bounds] = {}
    for joint in robot.joints.values():
        if not joint.active:
            continue
        speed = _first(joint.nominal_speed if nominal else None, joint.max_speed, joint.nominal_speed)
        change = _first(
            joint.nominal_acceleration if nominal else None,
            joint.max_acceleration,
            joint.nominal_acceleration,
        )
        if joint.command == "position":
            lower = -math.inf if joint.lower is None else joint.lower
            upper = math.inf if joint.upper is None else joint.upper
            if speed == math.inf:
                speed = USUAL_SPEED["m" if joint.type == "prismatic" else "rad"]
            out[joint.name] = Bounds(lower, upper, speed, change if acceleration else math.inf)
        elif joint.command == "speed":
            out[joint.name] = Bounds(-speed, speed, change if acceleration else math.inf, rest=0.0)
        else:
            most = (joint.max_current if joint.command == "current" else joint.max_duty) or math.inf
            out[joint.name] = Bounds(-most, most, rest=0.0)
    return out


def _first(*known: float | None) -> float:
    """Return the first that is known; infinity when none is."""
    return next((number for number in known if number is not None), math.inf)
