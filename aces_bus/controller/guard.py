"""The guard below a controller: limits of position, rate and acceleration, and the dead-man.

1. What leaves a guard is finite and within the limits of position, always; within the rate too, from one call to the next;
   and within the acceleration, unless that would lead past a limit of position. A joint that begins outside of its limits
   is led inside by the same rules, and never further out.
2. A feasible motion passes unchanged, to the last bit. What is changed is counted per state, and reported once a while.
3. What is not a finite number does not leave, and feeds no dead-man; five of them in a row for one state are a fault, which
   trips unless a supervisor decides otherwise.
4. When no set-points come for `dead_man_s`, or `trip` is called, the declared action follows: "hold" (come to a stand
   within the limits, and stay), "zero duty" or "disable" (no set-points any more; who drives the devices reads `tripped`
   and acts). The dead-man's hold ends with the next set-points; every other trip is latched until `release`.
5. A state that is not given for `unnamed_s`, while others are, stands still, and is reported once ("unnamed"): a speed, a
   torque, a current and a duty become 0, a position stays.
6. Nothing here waits or raises for a value.

Theory. With velocities in units of a·dt, stopping from w takes whole steps: the largest w that still stops within the
distance m (in units of a·dt²) is m/(n+1) + n/2 with n the largest whole number of n(n+1)/2 ≤ m. That bounds the velocity
towards a limit of position. Where the set-points themselves are too fast, the same bound on the distance to them, beside
their own velocity, catches up without overshoot.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

from ..errors import CallerError
from ..state.errors import raise_first
from .base import NOTHING, StateLike, known_value
from .events import ControlEvent, Listeners
from .trip import ACTIONS, HOLDING, Action, Clipped, Trip

if TYPE_CHECKING:
    from ..device.config import Robot

#: A state that is clipped for long is reported so often.
REPORT_EVERY_NS = 1_000_000_000
#: Trips that are kept for a cycle.
MOST_PENDING = 1_000
#: So many set-points of one state in a row that are not finite numbers stop motion.
NOT_FINITE_TRIPS = 5
#: States of one guard; a controller may make names up for ever.
MOST_LINES = 10_000
#: How fast (unit/s) a position is led for which no file states a speed, by its unit: no joint jumps within a frame.
USUAL_SPEED = {"rad": 1.0, "m": 0.1}
#: What pushes a joint on, or turns it: the last part of a state's name. At rest it is 0.
PUSHES = frozenset(("velocity", "torque", "current", "duty"))
_INFINITY = math.inf


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


class SetpointDoor(Protocol):
    """What a guard asks of the door that its set-points leave by (`Door`)."""

    @property
    def whole(self) -> Callable[[str], str]:
        """The whole name of a signal; raises `UnknownNameError`."""
        ...

    def claim(self, name: str, owner: str, *, is_supervised: bool = False) -> None:
        """Make `owner` the only writer of a signal; raises `CallerError` if it has another owner."""
        ...


def _reach(distance: float, quantum: float) -> float:
    """Return the largest step towards something `distance` away that can still stop there; `quantum` is a·dt²."""
    if distance <= 0.0:
        return 0.0
    m = distance / quantum
    n = int(0.5 * (math.sqrt(1.0 + 8.0 * m) - 1.0)) if m < 1e12 else 0
    return distance if n == 0 and m < 1e12 else (m / (n + 1) + 0.5 * n) * quantum if n else _INFINITY


class _Line:
    """One state's guard: the last set-point that left, its step, and the last that was asked for."""

    __slots__ = (
        "acceleration",
        "asked",
        "clipped",
        "given",
        "in_a_row",
        "is_unnamed",
        "lower",
        "name",
        "named_ns",
        "rate",
        "reported_ns",
        "rest",
        "step",
        "upper",
        "utmost",
    )

    def __init__(self, name: str, bounds: Bounds) -> None:
        self.name = name
        self.lower, self.upper = bounds.lower, bounds.upper
        self.rate, self.acceleration = bounds.rate, bounds.acceleration
        self.utmost = bounds.rate * (1 + 1e-9)  # a hair more is rounding
        self.given: float | None = None
        self.asked = 0.0
        self.step = 0.0  # of the last cycle, per second
        self.clipped = Clipped()
        self.in_a_row = 0  # not finite
        self.reported_ns = -REPORT_EVERY_NS
        self.rest = bounds.rest
        #: When it was given last (ns), and whether it has been missed since.
        self.named_ns, self.is_unnamed = 0, False

    def pass_on(self, wanted: float, dt: float) -> float:
        """Return the set-point that leaves, `dt` seconds after the last."""
        before = self.given
        # Nearly every set-point: as asked, far enough from the limits to stop.
        if before is not None and self.lower <= wanted <= self.upper:
            if wanted == before and not self.step:
                self.asked = wanted
                return wanted
            speed = (wanted - before) / dt
            if -self.utmost <= speed <= self.utmost:
                acceleration = self.acceleration
                if acceleration == _INFINITY:
                    self.step, self.given, self.asked = speed, wanted, wanted
                    return wanted
                size = speed if speed > 0.0 else -speed
                # A hair more is rounding of the differences.
                most = acceleration * dt * (1 + 1e-9) + 1e-9 * size
                # Who is behind must arrive slowly enough to stay with the set-points.
                if -most <= speed - self.step <= most and (before == self.asked or size <= acceleration * dt):
                    room = self.upper - before if speed > 0.0 else before - self.lower
                    if size * (size / (2.0 * acceleration) + dt) <= room or (
                        size * dt <= _reach(room, acceleration * dt * dt) * (1 + 1e-9)
                    ):
                        self.step, self.given, self.asked = speed, wanted, wanted
                        return wanted
        goal = self.lower if wanted < self.lower else self.upper if wanted > self.upper else wanted
        if goal != wanted:
            self.clipped.position += 1
        if before is None:
            self.given = self.asked = goal
            return goal
        return self._limited(goal, before, (goal - before) / dt, dt)

    def _limited(self, goal: float, before: float, speed: float, dt: float) -> float:
        acceleration, rate = self.acceleration, self.rate
        own = (goal - self.asked) / dt  # the set-points' own velocity
        self.asked = goal
        new = speed
        if not -self.utmost <= new <= self.utmost:
            self.clipped.rate += 1
            new = rate if new > 0 else -rate
        if acceleration < _INFINITY:
            quantum = acceleration * dt * dt
            behind = goal - before - own * dt
            catch_up = math.copysign(_reach(abs(behind), quantum) / dt, behind) + own
            bounded = (
                max(-rate, min(rate, catch_up)) if abs(catch_up) < abs(new) or catch_up * new < 0 else new
            )
            most = acceleration * dt
            low, high = self.step - most, self.step + most
            bounded = low if bounded < low else high if bounded > high else bounded
            if abs(bounded - new) * dt > 1e-12 * (1 + abs(goal)):
                self.clipped.acceleration += 1
            new = bounded
            # Whatever the rest says, it must be able to stop before the limits of position.
            up = _reach(self.upper - before, quantum) / dt if self.upper < _INFINITY else _INFINITY
            down = _reach(before - self.lower, quantum) / dt if self.lower > -_INFINITY else _INFINITY
            new = up if new > up else -down if new < -down else new
            new = rate if new > rate else -rate if new < -rate else new
        given = before + new * dt
        given = self._inside(given, before)
        if abs(given - goal) <= 1e-12 * (1 + abs(goal)):
            given = goal  # met again, to the last bit
        self.step, self.given = (given - before) / dt, given
        return given

    def _inside(self, given: float, before: float) -> float:
        """Return the value within the limits of position; from outside of them, no further outside."""
        if given < self.lower:
            return given if given >= before else min(before, self.lower)
        if given > self.upper:
            return given if given <= before else max(before, self.upper)
        return given

    def stand(self, dt: float) -> float | None:
        """Take one more step towards standing still."""
        before = self.given
        if before is None:
            return None
        if self.rest is not None:
            way = self.rest - before
            most = self.rate * dt
            given = self.rest if abs(way) <= most else before + math.copysign(most, way)
            self.step, self.given, self.asked = 0.0, given, given
            return given
        most = self.acceleration * dt
        speed = self.step
        speed = 0.0 if abs(speed) <= most else speed - math.copysign(most, speed)
        given = before + speed * dt
        given = self._inside(given, before)
        self.step, self.given = (given - before) / dt, given
        self.asked = given
        return given


class Guard:
    """Limits and dead-man for the set-points of one controller, stepped at its rate.

    >>> guard = Guard({"LKP": Bounds(-1.0, 1.0, rate=2.0)}, period_s=0.1, dead_man_s=0.5)
    >>> guard.apply(0, {"LKP": 0.0}), guard.apply(100_000_000, {"LKP": 5.0})
    ({'LKP': 0.0}, {'LKP': 0.2})
    >>> guard.clipped("LKP").rate
    1
    >>> guard.tick(700_000_000), guard.tripped.reason
    ({'LKP': 0.2}, 'no set-points for 600 ms')

    `apply(now, setpoints)` when there are some, `tick(now)` when there are none; both give what may go down. `states` of
    the same names, where bound, say where the first set-point starts from; without them the first is believed.
    States without bounds are refused and counted (`refused`), unless `unlisted="pass"`; finite they must be in any case.
    `dead_man_s` None: no dead-man. `unnamed_s`: how long a state may be left out before it stands still; None: for ever.
    """

    def __init__(
        self,
        bounds: Mapping[str, Bounds],
        *,
        period_s: float,
        dead_man_s: float | None = 0.1,
        action: Action = "hold",
        unlisted: Literal["refuse", "pass"] = "refuse",
        unnamed_s: float | None = None,
        name: str = "guard",
    ) -> None:
        raise_first(
            CallerError,
            (not 0 < period_s < math.inf, f"{name}: period_s = {period_s!r} is not a period"),
            (
                dead_man_s is not None and not dead_man_s > period_s,
                f"{name}: dead_man_s = {dead_man_s!r} must be more than the period, {period_s} s",
            ),
            (action not in ACTIONS, f"{name}: the action is one of {', '.join(ACTIONS)}, not {action!r}"),
        )
        self.name, self.period_s = name, period_s
        self.action: Action = action
        self.unlisted = unlisted
        self.tripped: Trip | None = None
        self.trips = self.swallowed = self.unanchored = 0
        self.refused: dict[str, int] = {}
        self.listeners = Listeners()
        #: Who decides what the fault "not finite" leads to; None: it trips.
        self.fault: Callable[[ControlEvent], None] | None = None
        self._dead_man = None if dead_man_s is None else round(dead_man_s * 1e9)
        self._unnamed = None if unnamed_s is None else round(unnamed_s * 1e9)
        self._lines = {state: _Line(state, limit) for state, limit in bounds.items()}
        self._states: Mapping[str, StateLike] = {}
        self._door: SetpointDoor | None = None
        #: The lines by all names that they were given set-points by, and by the whole names of their signals.
        self._by_name = dict(self._lines)
        self._by_signal: dict[str, _Line] = {}
        self._last: int | None = None  # ns of the last call that gave set-points
        self._received: int | None = None  # ns of the last set-points that came
        self._pending: deque[tuple[str, Action | None, str]] = deque(maxlen=2 * MOST_PENDING)

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Take the states whose present values the first set-points start from.

        Those of a rig also say which names are one signal, and have the door that this guard's set-points leave by.
        """
        self._states = states
        self._door = getattr(states, "door", None)
        if self._door is not None:
            self._by_signal = {self._door.whole(name): line for name, line in self._lines.items()}

    def clipped(self, state: str) -> Clipped:
        """Return what was changed of a state's set-points."""
        return self._by_name[state].clipped if state in self._by_name else Clipped()

    @property
    def clips(self) -> dict[str, Clipped]:
        """The same for all states of which something was changed."""
        return {line.name: line.clipped for line in self._lines.values() if line.clipped.total}

    @property
    def bounds(self) -> dict[str, Bounds]:
        """The limits of the set-points of each state."""
        lines = self._lines.values()
        return {x.name: Bounds(x.lower, x.upper, x.rate, x.acceleration, x.rest) for x in lines}

    def forget(self) -> None:
        """Begin anew: the next set-points start from the present values. A trip stays."""
        for line in self._lines.values():
            line.given, line.step = None, 0.0
        self._last = self._received = None

    def trip(self, reason: str, action: Action | None = None, *, source: str = "") -> None:
        """Stop motion at the next `apply` or `tick`; may be called from any thread. `source`: whose fault it was."""
        # The first reasons are worth keeping, and the strictest action.
        if len(self._pending) < MOST_PENDING or (action or self.action) == ACTIONS[-1]:
            self._pending.append((reason, action, source))

    def release(self) -> None:
        """Let set-points through again. After a hold they go on from there; else from the present values."""
        held = self.tripped is not None and self.tripped.action in HOLDING
        self.tripped = None
        self._pending.clear()
        self._received = None
        if not held:
            self.forget()

    # ---- every cycle ------------------------------------------------------------------------------------------------

    def apply(self, now: int, setpoints: Mapping[str, float]) -> Mapping[str, float]:
        """Return those set-points that may be sent at the instant `now` (ns), limited."""
        if not setpoints:
            return self.tick(now)
        if self._pending:
            self._obey(now)
        if self.tripped is not None:
            if self.tripped.latched:
                self.swallowed += len(setpoints)
                return self._stand(now) if self.tripped.action in HOLDING else NOTHING
            reason, self.tripped = self.tripped.reason, None
            self.listeners.emit(ControlEvent("late", now, self.name, f"set-points again after: {reason}"))
        dt = self._elapsed(now)
        self._last = now
        lines = self._by_name
        out: dict[str, float] = {}
        anything: Mapping[str, Any] = setpoints  # a controller may give anything
        for name, wanted in anything.items():
            line = lines.get(name)
            if line is None:
                line = self._unknown_line(name)
                if line is None:
                    continue
            try:
                is_finite = -_INFINITY < wanted < _INFINITY
            except TypeError:
                is_finite = False
            if not is_finite:
                self._refuse(line, now)
                continue
            line.in_a_row = 0
            line.named_ns = now
            if line.given is None:
                self._anchor(line)
            out[name] = given = line.pass_on(wanted, dt)
            if given != wanted:
                self._emit(line, now, "clipped")
        if self._unnamed is not None and len(out) < len(self._lines):
            self._still_unnamed(now, dt, out, self._unnamed)
        if out or self._received is None:  # what is not a number feeds no dead-man
            self._received = now
        return self.tick(now) if self._pending else out

    def _still_unnamed(self, now: int, dt: float, out: dict[str, float], limit: int) -> None:
        """Lead the states that were given once, and have not been for long, to where they stand still."""
        for line in self._lines.values():
            before = line.given
            if before is None or now - line.named_ns <= limit:
                line.is_unnamed = False
                continue
            if not line.is_unnamed:
                line.is_unnamed = True
                so_long = f"no set-point for {(now - line.named_ns) / 1e6:.0f} ms while others come"
                event = ControlEvent("unnamed", now, self.name, f"{line.name}: {so_long}; it stands still")
                self.listeners.emit(event)
                if self.fault is not None:
                    self.fault(event)
            given = line.stand(dt)
            if given is not None and given != before:
                out[line.name] = given

    def _refuse(self, line: _Line, now: int) -> None:
        """Drop a set-point that is not a finite number; several in a row stop motion."""
        line.clipped.not_finite += 1
        line.in_a_row += 1
        self._emit(line, now, "not finite")
        if line.in_a_row % NOT_FINITE_TRIPS == 0:
            why = f"{line.name}: {line.in_a_row} set-points in a row were not finite numbers"
            if self.fault is None:
                self.trip(why)
            else:
                self.fault(ControlEvent("not finite", now, self.name, why))

    def tick(self, now: int) -> Mapping[str, float]:
        """Return a cycle without set-points: whether the dead-man acts, and what goes down if it holds."""
        if self._pending:
            self._obey(now)
        if self.tripped is None:
            received, limit = self._received, self._dead_man
            if received is None or limit is None or now - received <= limit:
                return NOTHING
            reason = f"no set-points for {(now - received) / 1e6:.0f} ms"
            self._stop(Trip(now, self.action, reason, self.action != "hold"))
        assert self.tripped is not None
        return self._stand(now) if self.tripped.action in HOLDING else NOTHING

    def _elapsed(self, now: int) -> float:
        """Return the seconds since the last set-points left; after a pause at most two periods, so that a
        pause allows no jump.
        """
        if self._last is None:
            return self.period_s
        return max(min((now - self._last) / 1e9, 2 * self.period_s), 1e-3 * self.period_s)

    def _stand(self, now: int) -> Mapping[str, float]:
        dt = self._elapsed(now)
        self._last = now
        out: dict[str, float] = {}
        for line in self._lines.values():
            given = line.stand(dt)
            if given is not None:
                out[line.name] = given
        return out

    def _anchor(self, line: _Line) -> None:
        """Begin the first set-point of a state at the present value; from then on this controller owns the signal."""
        if self._door is not None:
            self._door.claim(line.name, self.name, is_supervised=True)
        present = known_value(self._states.get(line.name))
        if present is None:
            self.unanchored += 1
        else:
            line.given = line.asked = present

    def _unknown_line(self, name: str) -> _Line | None:
        whole = name if self._door is None else self._door.whole(name)
        line = self._by_signal.get(whole)
        if line is not None:  # another name of a signal that has bounds
            if line.given is None:
                line.name = name
            self._by_name[name] = line
            return line
        if self.unlisted == "pass" and len(self._lines) < MOST_LINES:
            bounds = Bounds(rest=0.0 if whole.rpartition(".")[2] in PUSHES else None)
            line = self._by_name[name] = self._by_signal[whole] = self._lines[name] = _Line(name, bounds)
            return line
        if name in self.refused or len(self.refused) < MOST_LINES:
            self.refused[name] = self.refused.get(name, 0) + 1
        return None

    def _obey(self, now: int) -> None:
        reason, action, source = self._pending.popleft()
        wanted: Action = action or self.action
        for more, other, whose in self._pending:  # the strictest of what came together
            if ACTIONS.index(other or self.action) > ACTIONS.index(wanted):
                reason, wanted, source = more, other or self.action, whose
        self._pending.clear()
        if self.tripped is None or ACTIONS.index(wanted) > ACTIONS.index(self.tripped.action):
            self._stop(Trip(now, wanted, reason, source=source))
        elif not self.tripped.latched:  # the dead-man held already; now it is asked for, too
            self.tripped = Trip(now, self.tripped.action, reason)

    def _stop(self, trip: Trip) -> None:
        self.tripped = trip
        self.trips += 1
        self.listeners.emit(ControlEvent("trip", trip.instant, self.name, f"{trip.action}: {trip.reason}"))

    def _emit(self, line: _Line, now: int, kind: str) -> None:
        if now - line.reported_ns >= REPORT_EVERY_NS:
            line.reported_ns = now
            c = line.clipped
            counts = f"position {c.position}, rate {c.rate}, acceleration {c.acceleration}, not finite {c.not_finite}"
            self.listeners.emit(ControlEvent(kind, now, self.name, f"{line.name} ({counts})"))


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
