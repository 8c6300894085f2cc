"""The guard below a controller: the dead-man, and the trips; limits of position, rate and acceleration.

1. What leaves a guard is finite, and within its bounds (`limiter`). Where it leaves by the door, the door holds it to
   them, in the ticks of the bus; without one (a replay, a controller by itself) the guard does, from one call to the next.
2. What is changed is counted per state, and reported once a while.
3. What is not a finite number does not leave, and feeds no dead-man; five of them in a row for one state are a fault, which
   trips unless a supervisor decides otherwise.
4. When no set-points come for `dead_man_s`, or `trip` is called, the declared action follows: "hold" (come to a stand
   within the limits, and stay), "zero duty" or "disable" (no set-points any more; who drives the devices reads `tripped`
   and acts). The dead-man's hold ends with the next set-points; every other trip is latched until `release`.
5. A state that is not given for `unnamed_s`, while others are, stands still, and is reported once ("unnamed"): a speed, a
   torque, a current and a duty become 0, a position stays.
6. Nothing here waits or raises for a value.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Literal, Protocol

from ..errors import CallerError
from ..state.errors import raise_first
from .base import NOTHING, StateLike, known_value
from .events import ControlEvent, Listeners
from .limiter import INFINITY, NOT_FINITE_TRIPS, Bounds, Limiter, rest_of
from .trip import ACTIONS, HOLDING, Action, Clipped, Trip

#: A state that is clipped for long is reported so often.
REPORT_EVERY_NS = 1_000_000_000
#: Trips that are kept for a cycle.
MOST_PENDING = 1_000
#: States of one guard; a controller may make names up for ever.
MOST_LINES = 10_000


class SetpointDoor(Protocol):
    """What a guard asks of the door that its set-points leave by (`Door`)."""

    @property
    def whole(self) -> Callable[[str], str]:
        """The whole name of a signal; raises `UnknownNameError`."""
        ...

    def claim(
        self, name: str, owner: str, *, is_supervised: bool = False, bounds: Bounds | None = None
    ) -> Clipped:
        """Make `owner` the only writer of a signal, within `bounds`; raises `CallerError` if it has another owner."""
        ...

    def hold(self, name: str) -> None:
        """Have a signal stand still."""
        ...

    def limits(self, name: str) -> Bounds:
        """Return what its set-points are held to."""
        ...


class _Line(Limiter):
    """One state: its limiter, and when it was given."""

    __slots__ = ("bounds", "in_a_row", "is_unnamed", "name", "named_ns", "reported_ns", "said")

    def __init__(self, name: str, bounds: Bounds) -> None:
        super().__init__(bounds)
        self.name, self.bounds = name, bounds
        self.in_a_row = 0  # not finite
        self.reported_ns = -REPORT_EVERY_NS
        #: How many of its set-points had been changed when that was last reported.
        self.said = 0
        #: When it was given last (ns), and whether it has been missed since.
        self.named_ns, self.is_unnamed = 0, False

    def stand(self, dt: float) -> Any:
        """Take one more step towards standing still; None before the first set-point."""
        goal = self.resting(dt)
        if goal is not None:
            self.asked = goal
            goal = self.advance(goal, dt)
            self.limited_by = ""
        return goal


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
        #: Whether it holds set-points to its bounds itself, although it has a door: nothing leaves by that.
        self.is_dry = False
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
        return self._by_name[state].counts if state in self._by_name else Clipped()

    @property
    def clips(self) -> dict[str, Clipped]:
        """The same for all states of which something was changed."""
        return {line.name: line.counts for line in self._lines.values() if line.counts.total}

    @property
    def bounds(self) -> dict[str, Bounds]:
        """The limits of the set-points of each state."""
        door = self._limiting
        return {
            line.name: line.bounds if door is None or line.given is None else door.limits(line.name)
            for line in self._lines.values()
        }

    @property
    def _limiting(self) -> SetpointDoor | None:
        """The door that holds set-points to the bounds; None: it is done here."""
        return None if self.is_dry else self._door

    def forget(self) -> None:
        """Begin anew: the next set-points start from the present values. A trip stays."""
        for line in self._lines.values():
            line.given, line.speed = None, 0.0
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
        lines, door = self._by_name, self._limiting
        out: dict[str, float] = {}
        anything: Mapping[str, Any] = setpoints  # a controller may give anything
        for name, wanted in anything.items():
            line = lines.get(name)
            if line is None:
                line = self._unknown_line(name)
                if line is None:
                    continue
            try:
                is_finite = -INFINITY < wanted < INFINITY
            except TypeError:
                is_finite = False
            if not is_finite:
                self._refuse(line, now)
                continue
            line.in_a_row = 0
            line.named_ns = now
            if line.given is None:
                self._anchor(line)
            if door is None:
                out[name] = given = line.pass_on(wanted, dt)
                is_changed = given != wanted
            else:  # which has counted what it changed of the last ones
                out[name] = line.given = wanted
                is_changed = now - line.reported_ns >= REPORT_EVERY_NS and line.counts.total != line.said
            if is_changed:
                self._emit(line, now, "clipped")
        if self._unnamed is not None and len(out) < len(self._lines):
            self._still_unnamed(now, dt, out, self._unnamed)
        if out or self._received is None:  # what is not a number feeds no dead-man
            self._received = now
        return self.tick(now) if self._pending else out

    def _still_unnamed(self, now: int, dt: float, out: dict[str, float], limit: int) -> None:
        """Lead the states that were given once, and have not been for long, to where they stand still."""
        door = self._limiting
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
                if door is not None:
                    door.hold(line.name)
            if door is None and (given := line.stand(dt)) != before:
                out[line.name] = given

    def _refuse(self, line: _Line, now: int) -> None:
        """Drop a set-point that is not a finite number; several in a row stop motion."""
        line.counts.not_finite += 1
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
        given = [line for line in self._lines.values() if line.given is not None]
        if (door := self._limiting) is not None:
            for line in given:
                door.hold(line.name)
            return NOTHING
        return {line.name: line.stand(dt) for line in given}

    def _anchor(self, line: _Line) -> None:
        """Begin the first set-point of a state at the present value; from then on this controller owns the signal."""
        if self._door is not None:
            counts = self._door.claim(line.name, self.name, is_supervised=True, bounds=line.bounds)
            if not (self.is_dry or counts is line.counts):
                counts.not_finite += line.counts.not_finite
                line.counts = counts
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
            bounds = Bounds(rest=rest_of(whole))
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
            c = line.counts
            line.said = c.total
            counts = f"position {c.position}, rate {c.rate}, acceleration {c.acceleration}, not finite {c.not_finite}"
            self.listeners.emit(ControlEvent(kind, now, self.name, f"{line.name} ({counts})"))
