"""The one door of set-points: those of controllers, the command line, UDP, zenoh and scripts all leave by it.

1. It is keyed by signal: "RHP", an alias of it and "RHP.position" are one line, with one owner.
2. What leaves is finite and within the limits of position, and from one tick of its bus to the next within the rate. A
   set-point further away is a goal; the way there begins where the joint is, and takes its time. A joint that begins
   outside of its limits is led inside by the same rule.
3. While it is not known where a joint is, or its device has a hold-off, goals wait. A device that drops its set-points (a
   stop, a reboot, enabling) drops the goals too: the next begins where the joint is then.
4. A joint with limits is watched by what is measured of it, whatever it is commanded by (`travel`).
5. A joint whose driver knows that it is not homed takes no set-points, unless its file or the run says otherwise
   (`takes_unhomed`): where it says it is, it is not.
6. A joint that does not follow, and a signal whose set-points are not finite again and again, trip. What a controller
   owns is stopped by its supervisor, which gets the event; any other device is stopped here, and refuses until `release`.
7. All of it runs on the clock's thread, in the ticks of the buses.
8. While the door is barred (an e-stop) nothing leaves, and nothing is released. `scale` (reduced speed) multiplies every
   limit of speed: the rate at which positions are led, and set-points of speeds, those that have left included.

Theory of rule 6: where a joint lags (a filter, a slow loop), it is where it was sent a moment ago. So the error is the
distance to the nearest set-point of the last `time_s`, not to the newest: a lag shorter than that is none. A joint that
takes its own time on a long way (a servo with a speed of its own) comes nearer meanwhile; one that is held up does not.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..device.reading import UNKNOWN
from ..device.stopping import stop_devices
from ..errors import AcesError, CallerError
from .guard import NOT_FINITE_TRIPS, USUAL_SPEED, Bounds
from .travel import Travel, is_push
from .trip import Clipped

if TYPE_CHECKING:
    from ..device.config import Joint, Robot
    from ..device.device import Device
    from ..device.host import Host
    from ..device.signals import Signal
    from ..runtime.clock import EventClock

#: A bus without ticks moves goals on so often (ns).
PERIOD_NS = 10_000_000
#: Time (ns) between two looks at whether joints follow.
LOOK_NS = 50_000_000
#: A goal that is so far away (s at the largest rate) is reported as limited.
FAR_S = 0.1
#: Following error of a revolute joint whose file says nothing: rad, s. Boards that report jams and reboots do so within
#: 1.3 s (jam_time and period of the status, Hubo D12): they know better what it is, and are first.
USUAL_ERROR_RAD, USUAL_TIME_S = 0.2, 1.5
#: So much of the bound nearer, within the time, is on its way.
PROGRESS = 0.1
#: The largest number that is one: a signal without limits has these.
LARGEST = sys.float_info.max
_INFINITY = math.inf
#: Units of signals that are speeds.
SPEEDS = ("rad/s", "m/s")
NOT_HOMED = "is not homed, so that it is not known where it is: home it first, or say --unhomed (needs_homing = false)"


@dataclass(frozen=True)
class Following:
    """When a joint does not follow: it is further than `error` (rad, m) from all that it was set to in the last `time_s`,
    and has come no nearer meanwhile.
    """

    error: float
    time_s: float = USUAL_TIME_S


def following_of(robot: Robot) -> dict[str, Following]:
    """Return by joint what the file says: `following_error` (0: never) and `following_time_s`.

    Only joints that are set by position are in it.

    A revolute joint whose file says nothing has 0.2 rad and 1.5 s: boards of some firmwares never report a jam, and what
    stays 11° from where it was sent is held up, whatever its gains. Others have none: no bound fits all wheels and slides.
    """
    return {joint.name: found for joint in robot.joints.values() if (found := _following(joint)) is not None}


def _following(joint: Joint) -> Following | None:
    if joint.command != "position" or not joint.active:
        return None
    error = joint.following_error
    if error is None:
        error = USUAL_ERROR_RAD if joint.type == "revolute" else 0.0
    return Following(error, joint.following_time_s or USUAL_TIME_S) if error else None


class _Line:
    """One signal: what is wanted of it, and what has left."""

    __slots__ = (
        "active",
        "bounds",
        "counts",
        "device",
        "door",
        "epoch",
        "following",
        "full_rate",
        "given",
        "goal",
        "homed",
        "in_a_row",
        "is_led",
        "is_supervised",
        "is_ticked",
        "lower",
        "owner",
        "rate",
        "recent",
        "signal",
        "travel",
        "tripped",
        "upper",
        "utmost",
    )

    def __init__(self, door: Door, device: Device, signal: Signal, active: dict[_Line, None]) -> None:
        self.door, self.device, self.signal, self.active = door, device, signal, active
        self.bounds = door.bounds.get(signal.name) or _usual_bounds(signal)
        self.is_ticked = device.host.is_ticked
        #: Its rate (unit/s) where speed is not reduced.
        self.full_rate = self.bounds.rate
        self.take_rate()
        self.following = door.following.get(signal.name)
        self.owner, self.is_supervised = "", False
        #: Why no set-points are taken; "" while they are.
        self.tripped = ""
        self.counts = Clipped()
        self.in_a_row = 0
        #: Where it is to go, and what left last; None: nothing is wanted, nothing has left since it began anew.
        #: Numbers of whatever type they were given in.
        self.goal: Any = None
        self.given: Any = None
        #: Whether its joint is homed, where that is needed and its driver knows it.
        self.homed: Signal | None = None
        #: What may push its joint on, where the joint has limits and this signal pushes it.
        self.travel: Travel | None = None
        #: What left and where it was then, with the instants (ns), as far back as rule 6 looks.
        self.recent: deque[tuple[int, float, Any]] = deque()
        self.begin_anew()

    def take_rate(self) -> None:
        """Lead it no faster than its full rate, times the door's scale."""
        self.rate = self.full_rate * self.door.scale
        self.utmost = self.rate * (1 + 1e-9)  # a hair more is rounding
        self.is_led = self.rate < _INFINITY

    def begin_anew(self) -> None:
        """Forget what was wanted: the next set-point begins where the joint is, within the limits of then."""
        self.goal = self.given = None
        self.epoch = self.device.epoch
        self.recent.clear()
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
        if self.is_led:
            self.goal = value
            self.active[self] = None
            if not self.is_ticked:
                device.host.wake()
        else:
            self.given = value
            self.hand_over(value)

    def _limited(self, value: Any) -> Any:
        """Return what is wanted instead; raises where nothing can be."""
        if self.tripped:
            raise CallerError(
                f"{self.signal.name}: {self.tripped}; it takes no set-points until it is released"
            )
        if not -_INFINITY < value < _INFINITY:
            self._refuse(value)
        if self.epoch != self.device.epoch:
            self.begin_anew()
        if self.lower <= value <= self.upper:
            return value
        self.counts.position += 1
        if self.signal.limit is not None:
            value = self.signal.limit(self.signal, value)  # which reports it
        limited = min(max(value, self.lower), self.upper)
        if limited != value and self.door.scale < 1.0:
            self.device.emit_event(
                "limited",
                f"{self.signal.name}: {value:g} is beyond the reduced {limited:g} {self.signal.unit}",
            )
        return limited

    def slow_down(self) -> None:
        """Apply new limits to a speed that has been sent or is on its way."""
        self.take_rate()
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
            before = present
            self.recent.clear()
        most = self.utmost * dt
        distance = goal - before
        if -most <= distance <= most:
            self.given = goal
            self.hand_over(goal)
            return True
        if self.given is None or abs(distance) > self.rate * FAR_S:
            self.counts.rate += 1
            if abs(distance) > self.rate * FAR_S:
                device.emit_event(
                    "limited",
                    f"{self.signal.name}: {goal:g} is {abs(distance) / self.rate:.2g} s away"
                    f" at {self.rate:g} {self.signal.unit}/s",
                )
        self.given = given = before + math.copysign(self.rate * dt, distance)
        self.hand_over(given)
        return False

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
        given, watched = self.given, self.following
        if given is None or watched is None:
            return
        if self.epoch != self.device.epoch:
            self.begin_anew()
            return
        recent, actual = self.recent, self.signal.last
        recent.append((now, given, actual))
        since = now - round(watched.time_s * 1e9)
        if len(recent) > 1 and recent[1][0] <= since:
            recent.popleft()
        if actual is not UNKNOWN and -watched.error <= given - actual <= watched.error:
            return
        if not self.device.is_followed(self.signal) or self.signal.is_stale:
            recent.clear()
            return
        error = min(abs(value - actual) for _, value, _ in recent)
        then = recent[0][2]
        nearer = 0.0 if then is UNKNOWN else abs(given - then) - abs(given - actual)
        if error > watched.error and recent[0][0] <= since and nearer < PROGRESS * watched.error:
            recent.clear()
            self._trip(
                "following error",
                f"{self.signal.name} stays at {actual:.3g} {self.signal.unit}, {error:.2g} from all that it was set to in"
                f" the last {watched.time_s:g} s (now {given:.3g})",
            )

    def _trip(self, kind: Any, reason: str) -> None:
        if not self.is_supervised:
            self.refuse_more(reason)
        self.device.emit_event(kind, reason)


def _usual_bounds(signal: Signal) -> Bounds:
    """Return those of a signal for which no file states any: a position is led."""
    is_position = signal.name.endswith(".position")
    return Bounds(rate=USUAL_SPEED.get(signal.unit, _INFINITY) if is_position else _INFINITY)


class _BusLines:
    """The lines of one bus, stepped in its ticks, before set-points are gathered."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.active: dict[_Line, None] = {}
        self.watched: list[_Line] = []
        self.travels: list[Travel] = []
        self._is_ticked = host.is_ticked
        self._period = round(1e9 / host.rate_hz) if host.is_ticked and host.rate_hz else PERIOD_NS
        #: A tick that is late may make up for itself, not for a pause.
        self._most = (2 if self._is_ticked else 1) * self._period
        self._last = host.clock.now() - self._period
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
            self.host.clock.call_in(self._period, self._again)
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
            if goal is not None and before is not None and line.epoch == device.epoch:
                signal, most = line.signal, line.utmost * dt
                if -most <= goal - before <= most and device.takes(signal):
                    line.given = goal
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


class Door:
    """The set-points of a rig's devices; `Rig.door` is it. Signals and states lead here by themselves.

    `bounds` and `following` are by the whole name of a signal, `travel` by the name of a joint, `whole` makes the whole name
    of any.
    """

    def __init__(
        self,
        clock: EventClock,
        devices: Iterable[Device],
        bounds: Mapping[str, Bounds],
        following: Mapping[str, Following],
        whole: Callable[[str], str],
        travel: Mapping[str, Bounds] | None = None,
    ) -> None:
        self.clock, self.bounds, self.following, self.whole = clock, bounds, following, whole
        #: Why nothing leaves at all; "" while it may.
        self.barred = ""
        #: What every limit of speed is multiplied with.
        self.scale = 1.0
        #: Called with each change of who gives what, and of limits: what changed, its device, in words.
        self.noted: Callable[[str, Device, str], None] = lambda what, device, detail: None
        #: Whether joints take set-points that are known not to be homed.
        self.takes_unhomed = False
        self._lines: dict[str, _Line] = {}
        self._travels: list[Travel] = []
        buses: dict[Host, _BusLines] = {}
        for device in devices:
            bus = buses.get(device.host)
            if bus is None:
                bus = buses[device.host] = _BusLines(device.host)
            for name, signal in device.signals.items():
                if signal.limit is None:  # it can never be set
                    continue
                line = self._lines[name] = _Line(self, device, signal, bus.active)
                signal.door = line.set
                if line.following is not None and name in device.readable:
                    bus.watched.append(line)
            for joint in device.joints:
                self._need_home(joint, device)
                limits = (travel or {}).get(joint.name)
                if limits is not None and f"{joint.name}.position" in device.readable:
                    bus.travels.append(self._watch(joint, device, limits))

    def _need_home(self, joint: Joint, device: Device) -> None:
        """Have a joint that must be homed, and whose driver knows whether it is, take no set-points before."""
        homed = device.signals.get(f"{joint.name}.homed")
        if joint.needs_homing and homed is not None:
            for name in device.signals:
                if name in self._lines and name.partition(".")[0] == joint.name:
                    self._lines[name].homed = homed

    @property
    def unhomed(self) -> list[str]:
        """The joints that take no set-points, as they are not homed or it is not known yet whether they are."""
        lines = self._lines.values()
        found = [line.homed.name for line in lines if line.homed is not None and line.homed.last is not True]
        return sorted({name.partition(".")[0] for name in found})

    def _watch(self, joint: Joint, device: Device, limits: Bounds) -> Travel:
        """Watch a joint by what is measured of it."""
        lines = [line for name, line in self._lines.items() if name.partition(".")[0] == joint.name]
        made = Travel(joint.name, device, limits, lines, "m" if joint.type == "prismatic" else "rad")
        self._travels.append(made)
        for line in lines:
            if is_push(line.signal):
                line.travel = made
        return made

    def _line(self, name: str) -> _Line:
        whole = self.whole(name)
        if whole not in self._lines:
            raise CallerError(f"{whole!r} is read-only")
        return self._lines[whole]

    # ------------------------------------------------------------------ who writes

    def claim(self, name: str, owner: str, *, is_supervised: bool = False) -> None:
        """Give this signal to `owner`, who alone gives its set-points from now on.

        Where it `is_supervised`, trips are its supervisor's.

        Raises `CallerError` naming both where it has another owner, `UnknownNameError` for a signal that there is not.
        """
        line = self._line(name)
        if line.owner not in ("", owner):
            raise CallerError(
                f"{line.signal.name}: {line.owner} and {owner} both give its set-points; one of them must not"
            )
        if line.owner != owner:
            self.noted("owner", line.device, f"{line.signal.name}: {owner}")
        line.owner, line.is_supervised = owner, is_supervised
        if is_supervised:
            line.tripped = ""  # its supervisor's affair

    def give_up(self, owner: str) -> None:
        """Release all signals that `owner` owns."""
        for line in self._lines.values():
            if line.owner == owner:
                self.noted("owner", line.device, f"{line.signal.name}: nobody")
                line.owner, line.is_supervised, line.tripped = "", False, self.barred

    @property
    def owners(self) -> dict[str, str]:
        """The signals that have an owner, with its name."""
        return {name: line.owner for name, line in self._lines.items() if line.owner}

    def writer(self, name: str) -> Callable[[Any], None]:
        """Return what the owner of a signal calls with its set-points; it raises as `Signal.set`."""
        return self._line(name).give

    # ------------------------------------------------------------------ how

    def pace(self, name: str, rate: float) -> None:
        """Lead this signal no faster than `rate` (unit/s) from now on."""
        line = self._line(name)
        if rate < line.full_rate:
            line.full_rate = rate
            line.take_rate()
            self.noted("limits", line.device, f"{line.signal.name}: at most {rate:g} {line.signal.unit}/s")

    def reduce(self, scale: float) -> None:
        """Multiply every limit of speed with this from now on: 1 is full speed."""
        if scale != self.scale:
            self.scale = scale
            for line in self._lines.values():
                line.slow_down()
            for travel in self._travels:
                travel.speed = travel.bounds.rate * scale

    def counts(self, name: str) -> Clipped:
        """Return what was changed of a signal's set-points, and how many were refused."""
        return self._line(name).counts

    def goal(self, name: str) -> float | None:
        """Return where a signal is on its way to; None: nowhere, what was wanted has left."""
        line = self._line(name)
        return float(line.goal) if line in line.active and line.goal is not None else None

    @property
    def goals(self) -> dict[str, float]:
        """The signals that are on their way, and where to."""
        lines = self._lines.items()
        return {
            name: float(line.goal) for name, line in lines if line.goal is not None and line in line.active
        }

    def given(self, name: str) -> float | None:
        """Return the last set-point that left; None: none since its device began anew."""
        given = self._line(name).given
        return None if given is None else float(given)

    # ------------------------------------------------------------------ trips

    @property
    def tripped(self) -> dict[str, str]:
        """The signals that take no set-points, with why."""
        return {name: line.tripped for name, line in self._lines.items() if line.tripped}

    def bar(self, reason: str) -> None:
        """Let nothing leave from now on, until `barred` is empty again and it has been released; goals are dropped."""
        self.barred = reason
        self.trip(reason)

    def trip(self, reason: str) -> None:
        """Drop all goals; signals without a supervisor take no set-points until `release`."""
        for line in self._lines.values():
            line.begin_anew()
            if not line.is_supervised:
                line.tripped = reason

    def release(self) -> None:
        """Take set-points again, once the cause has been looked into; each begins where its joint is.

        Raises `CallerError` while the door is barred.
        """
        if self.barred:
            raise CallerError(f"nothing can be released: {self.barred}")
        for line in self._lines.values():
            if line.tripped:
                line.tripped, line.in_a_row = "", 0
                line.begin_anew()

    def stop(self, device: Device) -> None:
        """Stop a device; that it has not stopped is reported."""

        def over(stopping: Any) -> None:
            error: AcesError | None = stopping.error
            if error is not None:
                device.emit_event("not stopped", str(error))

        stop_devices(self.clock, device.name, [device]).then(over)
