"""One signal of the door: what is wanted of it, and what has left; and the lines of one bus, which its ticks step.

What holds of them is said in `door`.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from ..device.reading import UNKNOWN
from ..errors import CallerError
from .following import Follower
from .limiter import INFINITY, NOT_FINITE_TRIPS, USUAL_SPEED, Bounds, Limiter, rest_of
from .travel import Travel

if TYPE_CHECKING:
    from ..device.device import Device
    from ..device.host import Host
    from ..device.signals import Signal
    from .door import Door

#: A bus without ticks moves goals on so often (ns).
PERIOD_NS = 10_000_000
#: Time (ns) between two looks at whether joints follow.
LOOK_NS = 50_000_000
#: A goal that is so far away (s at the largest rate) is reported as limited.
FAR_S = 0.1
#: The largest number that is one: a signal without limits has these.
LARGEST = sys.float_info.max
#: Units of signals that are speeds.
SPEEDS = ("rad/s", "m/s")
NOT_HOMED = "is not homed, so that it is not known where it is: home it first, or say --unhomed (needs_homing = false)"


class SetpointLine(Limiter):
    """One signal: its limiter, what is wanted of it, and who may say so."""

    __slots__ = (
        "active",
        "bounds",
        "device",
        "door",
        "epoch",
        "follower",
        "goal",
        "homed",
        "in_a_row",
        "is_led",
        "is_supervised",
        "is_ticked",
        "owner",
        "paced",
        "signal",
        "stated",
        "tick_s",
        "travel",
        "tripped",
    )

    def __init__(self, door: Door, device: Device, signal: Signal, bus: BusLines) -> None:
        self.door, self.device, self.signal = door, device, signal
        self.active, self.tick_s = bus.active, bus.period_ns / 1e9
        self.is_ticked = device.host.is_ticked
        #: Its limits without an owner, and now.
        self.stated = self.bounds = door.bounds.get(signal.name) or _usual_bounds(signal)
        super().__init__(self.bounds)
        #: The largest rate (unit/s) that the program has asked for.
        self.paced = INFINITY
        following = door.following.get(signal.name)
        self.follower = None if following is None else Follower(following, device, signal)
        self.owner, self.is_supervised = "", False
        #: Why no set-points are taken; "" while they are.
        self.tripped = ""
        self.in_a_row = 0
        #: Where it is to go; None: nothing is wanted. A number of whatever type it was given in.
        self.goal: Any = None
        #: Whether its joint is homed, where that is needed and its driver knows it.
        self.homed: Signal | None = None
        #: What may push its joint on, where the joint has limits and this signal pushes it.
        self.travel: Travel | None = None
        self.limit_by(self.stated)
        self.begin_anew()

    def limit_by(self, bounds: Bounds) -> None:
        """Limit what leaves by these from now on."""
        self.bounds = bounds
        self.acceleration, self.rest = bounds.acceleration, bounds.rest
        self.scale_rate()
        self.know_limits()

    def scale_rate(self) -> None:
        """Lead it no faster than its rate, times the door's scale."""
        self.take_rate(min(self.bounds.rate, self.paced) * self.door.scale)
        self.is_led = self.rate < INFINITY or self.acceleration < INFINITY

    def begin_anew(self) -> None:
        """Forget what was wanted: the next set-point begins where the joint is, within the limits of then."""
        self.goal = self.given = None
        self.speed, self.limited_by = 0.0, ""
        self.epoch = self.device.epoch
        if self.follower is not None:
            self.follower.forget()
        self.know_limits()

    def know_limits(self) -> None:
        """Take the limits of its set-points, as the file and the device state them; those of a speed are scaled."""
        low, high = self.signal.lower, self.signal.upper
        scale = self.door.scale if self.signal.unit in SPEEDS else 1.0
        self.lower = max(self.bounds.lower, -LARGEST if low is None else low) * scale
        self.upper = min(self.bounds.upper, LARGEST if high is None else high) * scale

    # ------------------------------------------------------------------ what is wanted

    def set(self, value: Any) -> None:
        """Take a set-point from a writer without a name: a script. Raises `CallerError` if the signal has an owner."""
        if self.owner:
            raise CallerError(
                f"{self.signal.name}: {self.owner} gives its set-points; nothing else can while it does"
            )
        if self._is_unhomed():
            raise CallerError(f"{self.signal.name}: {NOT_HOMED}")
        self.give(value)

    def _is_unhomed(self) -> bool:
        """Return whether its joint is known not to be homed, and has to be."""
        return self.homed is not None and self.homed.last is False and not self.door.takes_unhomed

    def give(self, value: Any) -> None:
        """Take a set-point from the owner. Raises `CallerError` for a value that is not a finite number, and
        after a trip.
        """
        device = self.device
        try:
            is_within = self.lower <= value <= self.upper
        except (TypeError, ValueError):
            self._give_other(value)
            return
        if not is_within or self.tripped or self.epoch != device.epoch:
            value = self._limited(value)
        if self.homed is not None and self._is_unhomed():
            device.emit_event("not homed", f"{self.signal.name}: {NOT_HOMED}")
            return
        if self.travel is not None:
            value = self._pushed(value, self.travel)
        self.in_a_row = 0
        if self.limited_by:  # the last one has not been reached
            self.count()
        self._lead_to(value)

    def _lead_to(self, value: Any) -> None:
        """Have it led there, or send it at once where no limit is on the way."""
        if self.is_led:
            self.goal = value
            self.active[self] = None
            if not self.is_ticked:
                self.device.host.wake()
        else:
            self.given = value
            self.hand_over(value)

    def hold(self) -> None:
        """Have it stand still where it is, within its acceleration: a position stays, what pushes goes to 0."""
        if self.epoch != self.device.epoch:
            self.begin_anew()
        self.goal = None
        if self.given is not None and not self.tripped:
            self.limited_by = ""
            self.asked = self.resting(self.tick_s)
            self._lead_to(self.asked)

    def _limited(self, value: Any) -> Any:
        """Return what is wanted instead; raises where nothing can be."""
        if self.tripped:
            raise CallerError(
                f"{self.signal.name}: {self.tripped}; it takes no set-points until it is released"
            )
        if not -INFINITY < value < INFINITY:
            self._refuse(value)
        if self.epoch != self.device.epoch:
            self.begin_anew()
        limited = self.within(value)
        if limited == value:
            return value
        if self.signal.limit is not None and not self.is_supervised:
            self.signal.limit(self.signal, value)  # which reports it
        if limited != value and self.door.scale < 1.0:
            self.device.emit_event(
                "limited",
                f"{self.signal.name}: {value:g} is beyond the reduced {limited:g} {self.signal.unit}",
            )
        return limited

    def slow_down(self) -> None:
        """Apply new limits to a speed that has been sent or is on its way."""
        self.scale_rate()
        if self.epoch != self.device.epoch:
            return
        self.know_limits()
        given, goal = self.given, self.goal
        if goal is not None and not self.lower <= goal <= self.upper:
            self.goal = min(max(goal, self.lower), self.upper)
        if given is not None and not self.lower <= given <= self.upper and self.device.takes(self.signal):
            self.given = min(max(given, self.lower), self.upper)
            self.hand_over(self.given)
            self.device.host.wake()

    def _pushed(self, value: float, travel: Travel) -> float:
        """Return as much of a speed or push as its joint's limits allow where it is."""
        allowed = travel.allowed(self.signal, value)
        if allowed != value:
            self.counts.position += 1
        if allowed and not self.is_ticked:
            self.device.host.wake()
        return allowed

    def refuse_more(self, reason: str) -> None:
        """Take no set-points until `Door.release`; stop its device."""
        self.tripped = reason
        self.begin_anew()
        self.door.stop(self.device)

    def _give_other(self, value: Any) -> None:
        """Take a name or a switch for a signal that is not a quantity: the driver checks it."""
        if self.is_led or self.signal.unit or self.signal.upper is not None:
            self._refuse(value)
        self.hand_over(value)

    def _refuse(self, value: Any) -> None:
        self.counts.not_finite += 1
        self.in_a_row += 1
        if self.in_a_row == NOT_FINITE_TRIPS:
            self._trip("refused", f"{self.in_a_row} set-points in a row were not finite numbers")
        raise CallerError(f"{self.signal.name}: {value!r} is not a set-point; give a finite number")

    # ------------------------------------------------------------------ in each tick

    def step(self, dt: float) -> bool:
        """Advance by one tick, `dt` seconds after the last; return whether the goal is reached."""
        device, goal = self.device, self.goal
        if self.epoch != device.epoch:
            self.begin_anew()
            return True
        if goal is None:
            return True
        takes = device.takes(self.signal)
        if takes is None:
            return False
        before = self.given
        if takes is False:
            self.given = self.goal = None
            self.hand_over(goal)  # what refuses it says why
            return True
        if self.homed is not None and self.homed.last is UNKNOWN and not self.door.takes_unhomed:
            device.emit_event("limited", f"{self.signal.name}: waits until it is known whether it is homed")
            if not self.is_ticked:
                device.refresh(self.homed.name)
            return False
        if self.homed is not None and self._is_unhomed():  # since the goal was given
            device.emit_event("not homed", f"{self.signal.name}: {NOT_HOMED}")
            self.goal = None
            return True
        if before is None:
            if self.signal.name not in device.readable:
                self.given = goal  # where it is cannot be known: the first one is believed
                self.hand_over(goal)
                return True
            present = self.signal.value
            if present is UNKNOWN:
                device.emit_event("limited", f"{self.signal.name}: waits until it is known where it is")
                if not self.is_ticked:
                    device.refresh(self.signal.name)  # nothing else asks
                return False
            before = self.given = self.asked = present
            if self.follower is not None:
                self.follower.forget()
        distance = goal - before
        if abs(distance) > self.rate * FAR_S and not self.is_supervised:
            device.emit_event(
                "limited",
                f"{self.signal.name}: {goal:g} is {abs(distance) / self.rate:.2g} s away"
                f" at {self.rate:g} {self.signal.unit}/s",
            )
        given = self.advance(goal, dt)
        self.hand_over(given)
        if given != goal or abs(self.speed) > self.acceleration * dt:
            return False
        self.speed, self.limited_by = 0.0, ""
        return True

    def hand_over(self, value: Any) -> None:
        """Give it to the driver, and say so to who listens."""
        signal = self.signal
        if signal.setter is None:
            self.device.emit_event("not sent", f"{signal.name} cannot be set now")
            return
        signal.setter(value)
        if signal.given:
            now = signal.clock.now()
            for listener in signal.given:
                listener(value, now)

    # ------------------------------------------------------------------ whether it follows

    def look(self, now: int) -> None:
        """Check that the joint is where it was sent."""
        if self.given is None or self.follower is None:
            return
        if self.epoch != self.device.epoch:
            self.begin_anew()
        elif why := self.follower.look(now, self.given):
            self._trip("following error", why)

    def _trip(self, kind: Any, reason: str) -> None:
        if not self.is_supervised:
            self.refuse_more(reason)
        self.device.emit_event(kind, reason)


def _usual_bounds(signal: Signal) -> Bounds:
    """Return those of a signal for which no file states any: a position is led."""
    is_position = signal.name.endswith(".position")
    rate = USUAL_SPEED.get(signal.unit, INFINITY) if is_position else INFINITY
    return Bounds(rate=rate, rest=rest_of(signal.name))


class BusLines:
    """The lines of one bus, stepped in its ticks, before set-points are gathered."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.active: dict[SetpointLine, None] = {}
        self.watched: list[SetpointLine] = []
        self.travels: list[Travel] = []
        self._is_ticked = host.is_ticked
        self.period_ns = round(1e9 / host.rate_hz) if host.is_ticked and host.rate_hz else PERIOD_NS
        #: A tick that is late may make up for itself, not for a pause.
        self._most = (2 if self._is_ticked else 1) * self.period_ns
        self._last = host.clock.now() - self.period_ns
        self._look_at = 0
        self._is_woken = False
        host.before_set_points.append(self.step)

    def step(self, now: int) -> None:
        """Lead set-points on by a tick that begins `now` (ns)."""
        dt = min(now - self._last, self._most) / 1e9
        self._last = now
        if self.active:
            if dt > 0.0:
                self._lead(dt)
        for travel in self.travels:
            travel.look()
        if not (self._is_ticked or self._is_woken) and (self.active or self._ask_where()):
            self._is_woken = True
            self.host.clock.call_in(self.period_ns, self._again)
        if now >= self._look_at:
            self._look_at = now + LOOK_NS
            for line in self.watched:
                line.look(now)

    def _lead(self, dt: float) -> None:
        lines = [*self.active]
        self.active.clear()
        for line in lines:
            # Nearly every one: on its way already, and what is wanted is within reach.
            goal, before, device = line.goal, line.given, line.device
            if (
                goal is not None
                and before is not None
                and line.epoch == device.epoch
                and line.acceleration == INFINITY
            ):
                signal, most = line.signal, line.utmost * dt
                if -most <= goal - before <= most and device.takes(signal):
                    line.given, line.limited_by = goal, ""
                    if signal.setter is None or signal.given:
                        line.hand_over(goal)
                    else:
                        signal.setter(goal)
                    continue
            if not line.step(dt):
                self.active[line] = None

    def _ask_where(self) -> bool:
        """Have a bus without ticks ask where joints are that are pushed; whether there are some."""
        pushed = [travel for travel in self.travels if travel.is_pushed]
        for travel in pushed:
            travel.device.refresh(f"{travel.name}.position")
        return bool(pushed)

    def _again(self) -> None:
        """Wake a bus without ticks while it has goals to approach, or joints that are pushed."""
        self._is_woken = False
        self.host.wake()
