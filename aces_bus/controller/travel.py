"""The limits of a joint, watched by what is measured of it, whatever it is commanded by.

1. At a bound nothing pushes further out: speeds, torques, currents and duties outward become 0. A speed is lowered on the
   way there, so that the joint stops at the bound; one that must not turn faster is not accelerated any more.
2. Past a bound by more than `MARGIN`, or measured for `FAST_NS` faster than `FASTEST` times its speed, the joint trips,
   once. An old value of its speed is not a second one: a bus that is held up makes no joint fast.
3. A joint that begins outside of its limits may come back; it trips when it gets further out.
4. A joint with limits is not pushed while it is not known where it is: before the first answer, and when the last one is
   stale. One that nobody commands is not watched: it may be
   pushed by hand, search its home or hang.

Theory of rule 1: what is measured is a poll and a reply old, and a set-point leaves with the next tick. So the speed
towards a bound is at most what is left of the way in `APPROACH_S`, which is longer than these, and what the stated
acceleration can stop within it. A joint goes past its bound by no more than v·(poll + reply + tick) + v²/2a.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal
from typing import Protocol as Interface

from ..device.reading import UNKNOWN
from .limiter import PUSHES, Bounds

if TYPE_CHECKING:
    from ..device.config import Robot
    from ..device.device import Device
    from ..device.signals import Signal

#: How far (by unit) past a bound a joint trips: further than noise and a controller's overshoot.
MARGIN = {"rad": 0.05, "m": 0.005}
#: How many times its largest speed a joint may be measured at: estimates of speed are noisy, and controllers overshoot.
FASTEST = 1.5
#: How long (ns), in one direction: an encoder that jumps, as when a board reboots, is not a joint that turns.
FAST_NS = 100_000_000
#: A joint comes no nearer to its bound than in this time (s).
APPROACH_S = 0.1


class WatchedLine(Interface):
    """The part of a line of the door that the travel reads."""

    signal: Signal
    given: Any
    epoch: int
    tripped: str
    is_supervised: bool

    def hand_over(self, value: Any) -> None: ...

    def refuse_more(self, reason: str) -> None: ...


class Travel:
    """One joint: where it is and how fast, against its limits (`bounds`: positions, speed, acceleration)."""

    __slots__ = (
        "_allowed",
        "_epoch",
        "_fast_since",
        "_is_past",
        "_is_up",
        "_lines",
        "_lower",
        "_margin",
        "_position",
        "_pushing",
        "_upper",
        "_velocity",
        "bounds",
        "device",
        "name",
        "speed",
    )

    def __init__(
        self,
        name: str,
        device: Device,
        bounds: Bounds,
        lines: Iterable[WatchedLine],
        unit: Literal["rad", "m"],
    ) -> None:
        self.name, self.device, self.bounds = name, device, bounds
        #: Its largest speed now: the door scales it where speed is reduced.
        self.speed = bounds.rate
        self._lines = tuple(lines)
        self._pushing = tuple(line for line in self._lines if is_push(line.signal))
        self._position = device.signals[f"{name}.position"]
        speed = f"{name}.velocity"
        self._velocity = device.signals[speed] if speed in device.readable else None
        self._margin = MARGIN[unit]
        self._lower, self._upper = bounds.lower - self._margin, bounds.upper + self._margin
        self._epoch = device.epoch
        #: How far beyond the margin it may be: further than 0 while it comes back; None: not looked at yet.
        self._allowed: float | None = None
        self._is_past = False
        #: When it was first measured to be too fast in the present direction, upwards or not (ns); None: it is not.
        self._fast_since: int | None = None
        self._is_up = False

    # ------------------------------------------------------------------ what may push it

    def allowed(self, signal: Signal, value: float) -> float:
        """Return the part of a speed or push that may leave now."""
        bounds, here = self.bounds, self._position.value
        has_bounds = bounds.lower > -math.inf or bounds.upper < math.inf
        if has_bounds and here is UNKNOWN:
            if value:
                self.device.emit_event("limited", f"{signal.name}: 0 until it is known where {self.name} is")
            return 0.0
        most = least = math.inf
        if has_bounds:
            most, least = self._most(signal, bounds.upper - here), self._most(signal, here - bounds.lower)
        velocity: Any = UNKNOWN if self._velocity is None else self._velocity.last
        if velocity is not UNKNOWN and not signal.name.endswith(".velocity"):
            most = 0.0 if velocity >= self.speed else most
            least = 0.0 if velocity <= -self.speed else least
        given = max(-least, min(most, value))
        if given != value:
            self.device.emit_event(
                "limited", f"{signal.name}: {given:g} instead of {value:g} {signal.unit}, at {self._where()}"
            )
        return given

    def _most(self, signal: Signal, room: float) -> float:
        """Return the largest value towards a bound that is `room` away."""
        if room <= 0.0:
            return 0.0
        if not signal.name.endswith(".velocity"):
            return math.inf
        return min(room / APPROACH_S, math.sqrt(2.0 * self.bounds.acceleration * room))

    def _where(self) -> str:
        here, velocity = self._position.last, None if self._velocity is None else self._velocity.last
        place = "an unknown position" if here is UNKNOWN else f"{here:.4g} {self._position.unit}"
        if velocity is None or velocity is UNKNOWN:
            return place
        return f"{place} and {velocity:.3g} {self._velocity_unit}"

    @property
    def _velocity_unit(self) -> str:
        return "" if self._velocity is None else self._velocity.unit

    @property
    def is_pushed(self) -> bool:
        """True while a speed or push other than 0 is set."""
        return any(line.given for line in self._pushing if line.epoch == self.device.epoch)

    # ------------------------------------------------------------------ in each tick

    def look(self) -> None:
        """Take back what pushes further out; trip what is past its limits."""
        device, here = self.device, self._position.last
        for line in self._pushing:
            given = line.given
            if given and line.epoch == device.epoch:
                allowed = self.allowed(line.signal, given)
                if allowed != given:
                    line.given = allowed
                    line.hand_over(allowed)
        velocity: Any = 0.0 if self._velocity is None else self._velocity.last
        most = self.speed * FASTEST
        if velocity is UNKNOWN or -most <= velocity <= most:
            self._fast_since, is_fast = None, False
        else:
            is_fast = self._is_fast_for_long(velocity > 0.0)
        is_out = here is not UNKNOWN and not self._lower <= here <= self._upper
        if not (is_fast or is_out):
            self._allowed, self._is_past = 0.0, False
            return
        is_commanded = any(line.given is not None and line.epoch == device.epoch for line in self._lines)
        if self._epoch != device.epoch or not is_commanded:
            self._epoch, self._allowed, self._is_past = device.epoch, None, False
        if not is_commanded:
            return
        reason = f"turns at {velocity:.3g} {self._velocity_unit}: at most {self.speed:g}" if is_fast else ""
        if is_out:
            excess = max(here - self._upper, self._lower - here)
            allowed = excess + self._margin if self._allowed is None else self._allowed
            self._allowed = min(allowed, excess + self._margin)
            if excess > allowed:
                low, high = self.bounds.lower, self.bounds.upper
                reason = f"is at {here:.4g} {self._position.unit}, past its limits {low:g} to {high:g}"
        if reason and not self._is_past:
            self._is_past = True
            self._trip("too fast" if is_fast else "past limit", f"{self.name} {reason}")

    def _is_fast_for_long(self, is_up: bool) -> bool:
        """Return whether it was measured to turn too fast in this direction for `FAST_NS`."""
        instant = 0 if self._velocity is None or self._velocity.instant is None else self._velocity.instant
        if self._fast_since is None or is_up != self._is_up:
            self._is_up, self._fast_since = is_up, instant
        return instant - self._fast_since >= FAST_NS

    def _trip(self, kind: Literal["too fast", "past limit"], reason: str) -> None:
        if not any(line.is_supervised for line in self._lines):
            for line in self._lines:
                line.refuse_more(reason)
        self.device.emit_event(kind, reason)


def is_push(signal: Signal) -> bool:
    """Return whether a signal pushes its joint on, or lets it turn."""
    return signal.name.rpartition(".")[2] in PUSHES


def travel_of(robot: Robot) -> dict[str, Bounds]:
    """Return by joint its limits of position, its largest speed and its largest acceleration, in every mode of command."""
    found = {
        joint.name: Bounds(
            -math.inf if joint.lower is None else joint.lower,
            math.inf if joint.upper is None else joint.upper,
            joint.max_speed or math.inf,
            joint.max_acceleration or math.inf,
        )
        for joint in robot.joints.values()
        if joint.active
    }
    return {
        name: bounds for name, bounds in found.items() if bounds != Bounds(acceleration=bounds.acceleration)
    }
