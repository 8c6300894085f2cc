"""The one door of set-points: those of controllers, the command line, UDP, zenoh and scripts all leave by it.

1. It is keyed by signal: "RHP", an alias of it and "RHP.position" are one line, with one owner.
2. What leaves is finite and, from one tick of its bus to the next, within the limits of position, rate and acceleration
   (`limiter`): those of the robot's file, and the narrower ones of its owner. A set-point further away is a goal; the way
   there begins where the joint is, and takes its time.
3. While it is not known where a joint is, or its device has a hold-off, goals wait. A device that drops its set-points (a
   stop, a reboot, enabling) drops the goals too: the next begins where the joint is then.
4. A joint with limits is watched by what is measured of it, whatever it is commanded by (`travel`).
5. A joint whose driver knows that it is not homed takes no set-points, unless its file or the run says otherwise
   (`takes_unhomed`): where it says it is, it is not.
6. A joint that does not follow (`following`), and a signal whose set-points are not finite again and again, trip. What a
   controller owns is stopped by its supervisor, which gets the event; any other device is stopped here, and refuses until
   `release`.
7. All of it runs on the clock's thread, in the ticks of the buses.
8. While the door is barred (an e-stop) nothing leaves, and nothing is released. `scale` (reduced speed) multiplies every
   limit of speed: the rate at which positions are led, and set-points of speeds, those that have left included.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ..device.stopping import stop_devices
from ..errors import AcesError, CallerError
from .following import Following
from .limiter import Bounds
from .line import BusLines, SetpointLine
from .travel import Travel, is_push
from .trip import Clipped

if TYPE_CHECKING:
    from ..device.config import Joint
    from ..device.device import Device
    from ..device.host import Host
    from ..runtime.clock import EventClock


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
        self._lines: dict[str, SetpointLine] = {}
        self._travels: list[Travel] = []
        buses: dict[Host, BusLines] = {}
        for device in devices:
            bus = buses.get(device.host)
            if bus is None:
                bus = buses[device.host] = BusLines(device.host)
            for name, signal in device.signals.items():
                if signal.limit is None:  # it can never be set
                    continue
                line = self._lines[name] = SetpointLine(self, device, signal, bus)
                signal.door = line.set
                if line.follower is not None and name in device.readable:
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

    def _line(self, name: str) -> SetpointLine:
        whole = self.whole(name)
        if whole not in self._lines:
            raise CallerError(f"{whole!r} is read-only")
        return self._lines[whole]

    # ------------------------------------------------------------------ who writes

    def claim(
        self, name: str, owner: str, *, is_supervised: bool = False, bounds: Bounds | None = None
    ) -> Clipped:
        """Give this signal to `owner`, who alone gives its set-points from now on; return what is changed of them.

        Where it `is_supervised`, trips are its supervisor's. `bounds` may be narrower than the file's, never wider.

        Raises `CallerError` naming both where it has another owner, and for bounds that no set-point can keep,
        `UnknownNameError` for a signal that there is not.
        """
        line = self._line(name)
        if line.owner not in ("", owner):
            raise CallerError(
                f"{line.signal.name}: {line.owner} and {owner} both give its set-points; one of them must not"
            )
        if bounds is not None:
            line.limit_by(line.stated.within(bounds))
        if line.owner != owner:
            self.noted("owner", line.device, f"{line.signal.name}: {owner}")
        line.owner, line.is_supervised = owner, is_supervised
        if is_supervised:
            line.tripped = ""  # its supervisor's affair
        return line.counts

    def give_up(self, owner: str) -> None:
        """Release all signals that `owner` owns."""
        for line in self._lines.values():
            if line.owner == owner:
                self.noted("owner", line.device, f"{line.signal.name}: nobody")
                line.owner, line.is_supervised, line.tripped = "", False, self.barred
                line.limit_by(line.stated)

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
        if rate < min(line.bounds.rate, line.paced):
            line.paced = rate
            line.scale_rate()
            self.noted("limits", line.device, f"{line.signal.name}: at most {rate:g} {line.signal.unit}/s")

    def reduce(self, scale: float) -> None:
        """Multiply every limit of speed with this from now on: 1 is full speed."""
        if scale != self.scale:
            self.scale = scale
            for line in self._lines.values():
                line.slow_down()
            for travel in self._travels:
                travel.speed = travel.bounds.rate * scale

    def hold(self, name: str) -> None:
        """Have a signal stand still where it is, within its acceleration: a position stays, what pushes goes to 0."""
        self._line(name).hold()

    def limits(self, name: str) -> Bounds:
        """Return what the set-points of a signal are held to, by the robot's file and its owner."""
        return self._line(name).bounds

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
