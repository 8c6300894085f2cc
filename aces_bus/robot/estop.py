"""The enable chain of a robot's file: e-stop inputs, homing, brakes, and the reduced speed. It is not a safety function.

1. An input that is silent, unreadable or older than its stated time counts as pressed; so does any value that is not clear.
2. A pressed input stops every device of a rig that drives, bars the door for set-points, and fails what enables or moves.
3. Clearing an input starts nothing: controllers stay stopped, and the door stays shut, until they are released.
4. Inputs are looked at when their value is received, and by a timer, because silence brings no value.

Before it is opened nothing is known of any input, and all are pressed; what has not been received within its stated time
after the opening trips. All of it runs on the clock's thread.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from math import isfinite
from typing import TYPE_CHECKING, Final

from ..device.config import DeviceConfig, Input
from ..device.device import Device
from ..device.events import DeviceEvent, Kind
from ..device.host import PROBED
from ..device.reading import UNKNOWN
from ..device.station import BusEndpoint
from ..device.stopping import stop_devices
from ..errors import CallerError, NotStoppedError, UnknownNameError
from ..protocol.record import FieldValue
from .keys import Keyboard, character_of

if TYPE_CHECKING:
    from ..device.signals import Signal
    from ..device.ticket import Job
    from ..runtime.clock import Timer
    from .rig import Rig

#: Longest and shortest time between two looks at the inputs (ns); at the least four looks fit into a stated time.
LOOK_NS, LEAST_NS, LOOKS = 20_000_000, 2_000_000, 4
#: What is said of inputs before their bus is opened.
NOT_YET: Final = "nothing was received of it yet"


def objection(entry: Input, value: FieldValue) -> str:
    """Return why a value that was read does not count as clear; "" where it does.

    >>> objection(Input(signal="IO.panel", clear=True), False), objection(Input(signal="IO.word", bit=2, pressed=1), 0b011)
    ('reads False', '')
    """
    if entry.bit is not None:
        if not isinstance(value, int):
            return f"reads {value!r}, which has no bits"
        value = value >> entry.bit & 1
    if entry.clear is not None:
        return "" if _kind(value) == _kind(entry.clear) and value == entry.clear else f"reads {value!r}"
    if isinstance(value, (tuple, list, set, frozenset)):
        return f"reads {entry.pressed!r}" if entry.pressed in value else ""
    if _kind(value) != _kind(entry.pressed):
        return f"reads {value!r}, which cannot be compared with {entry.pressed!r}"
    return f"reads {value!r}" if value == entry.pressed else ""


def _kind(value: FieldValue) -> str:
    """Return what a value can be compared with; numbers that are not finite with nothing."""
    if isinstance(value, (bool, int, float)):
        return "number" if isfinite(value) else "no number"
    return "text" if isinstance(value, str) else "other"


class _Listener(Device):
    """A device that only receives one field of one message: the input of a message."""

    def setup(self) -> None:
        """Declare the field as a signal."""
        self.add_signal("value", of=self.config.settings["of"])


class _SignalInput:
    """An input that is a signal of a device."""

    def __init__(self, name: str, entry: Input, device: Device, signal: Signal) -> None:
        self.name, self.one, self.device, self.signal = name, entry, device, signal
        self.stale_ns = round(entry.stale_after_s * 1e9)

    @property
    def is_unread(self) -> bool:
        """True if the signal was never received, as is allowed for its stated time after the opening."""
        return self.signal.instant is None and not self.device.is_silent

    def why(self, now: int) -> str:
        """Return why it counts as pressed; "" while it is clear."""
        signal = self.signal
        if self.device.is_silent:
            return f"{self.device.name} is silent"
        if signal.instant is None or signal.last is UNKNOWN:
            return f"{signal.name}: {NOT_YET}"
        age = now - signal.instant
        if age > self.stale_ns:
            return f"{signal.name} is {age / 1e9:.3f} s old, and may be {self.one.stale_after_s:g} s (stale_after_s)"
        found = objection(self.one, signal.last)
        return f"{signal.name} {found}" if found else ""


class _KeyInput:
    """An input that is a key of the keyboard: pressed once, until the key that clears it."""

    is_unread = False
    stale_ns = LOOKS * LOOK_NS

    def __init__(self, name: str, entry: Input, keyboard: Keyboard) -> None:
        self.name, self.one, self.keyboard = name, entry, keyboard
        self._is_pressed = False
        keyboard.takers.append(self._take)

    def _take(self, character: str) -> None:
        if character == character_of(self.one.key or ""):
            self._is_pressed = True
        elif character == character_of(str(self.one.clear)):
            self._is_pressed = False

    def why(self, now: int) -> str:
        """Return why it counts as pressed; "" while it is clear."""
        if self.keyboard.failure:
            return f"no key can be read: {self.keyboard.failure}"
        return f"key {self.one.key} was pressed ({self.one.clear} clears it)" if self._is_pressed else ""


AnyInput = _SignalInput | _KeyInput


class EnableChain:
    """What a robot's file has stand between a program and motion; `Rig.chain` is it."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.clock = rig, rig.clock
        self._keyboard = Keyboard()
        made = {
            path: self._input(path, entry) for path, entry in rig.robot.inputs.items() if self._is_there(path)
        }
        self._estops = [entry for path, entry in made.items() if path[0] == "estop"]
        self._brakes = {path[1]: entry for path, entry in made.items() if path[0] == "joints"}
        self._reduces = made.get(("reduced", "input"))
        #: Input → why it counts as pressed; before the opening all do.
        self.pressed: dict[str, str] = {estop.name: NOT_YET for estop in self._estops}
        #: Inputs of which nothing was received yet, within their time.
        self.waits_for = set(self.pressed)
        #: Called with why, when an input trips or another program stops: what a run does beside stopping its devices.
        self.tripped: list[Callable[[str], None]] = []
        self._was_tripped = False
        self._opened_at = 0
        self._stopping: Job | None = None
        self._is_looking = False
        self._next: Timer | None = None
        self._period = max(LEAST_NS, min([LOOK_NS, *(entry.stale_ns // LOOKS for entry in made.values())]))
        if made:
            for host in rig.hosts.values():
                host.when_open.append(self._opened)
                host.when_closed.append(self._closed)
        if self.pressed:
            rig.door.bar(self._reason())
        for device in rig.devices.values():
            device.interlock = self._interlock_of(device)
        self._reduce()

    def _is_there(self, path: tuple[str, ...]) -> bool:
        """Return whether an input is of this part of the robot: brakes of joints that are not connected are not."""
        joint = self.rig.robot.joints[path[1]] if path[0] == "joints" else None
        return joint is None or joint.device in self.rig.devices

    def _input(self, path: tuple[str, ...], entry: Input) -> AnyInput:
        name = path[1] if path[0] != "reduced" else "reduced"
        if entry.key is not None:
            return _KeyInput(name, entry, self._keyboard)
        device, signal = self._signal(" ".join(path), entry)
        names, stated = device.names_of(signal), entry.pressed if entry.clear is None else entry.clear
        if names and isinstance(stated, str) and stated not in names:
            unknown = UnknownNameError(f"value of {signal.name}", stated, names)
            raise CallerError(f"{self.rig.robot.name}: {' '.join(path)}: {unknown}")
        if path[0] != "joints":
            signal.listeners.append(lambda value, instant: self.look())
        return _SignalInput(name, entry, device, signal)

    def _signal(self, name: str, entry: Input) -> tuple[Device, Signal]:
        """Return the signal of an input, asked for often enough; raises `CallerError` for what this robot has not."""
        rig = self.rig
        if entry.signal is not None:
            try:
                whole = rig.whole(entry.signal)
            except UnknownNameError as error:
                raise CallerError(f"{rig.robot.name}: {name}: {error}") from None
            device = next(device for device in rig.devices.values() if whole in device.signals)
            if whole not in device.readable:
                raise CallerError(f"{name}: {whole} can only be set: {device.name} does not report it")
            tick = 1 / device.host.rate_hz if device.host.rate_hz else 0.0
            periods = [poll.every_s or tick for poll in device.polls_of(whole)]
            wanted = max(tick, entry.stale_after_s / LOOKS)
            if periods and min(periods) > wanted:
                device.refresh_every(whole, wanted)
            return device, device.signals[whole]
        host = rig.hosts.get(entry.bus or "")
        protocol = entry.protocol or rig.robot.buses[entry.bus or ""].protocol
        if host is None or protocol not in host.variants:
            raise CallerError(
                f"{name}: no active device of bus {entry.bus} speaks {protocol}, so that {entry.message} is not received"
            )
        config = DeviceConfig(
            name=name, driver="", bus=host.name, credentials=entry.credentials, settings={"of": entry.message}
        )
        listener = _Listener(host, config, PROBED, host.variants[protocol])
        BusEndpoint.add(host, listener)
        return listener, listener.signals[f"{name}.value"]

    # ------------------------------------------------------------------ looking

    def _opened(self) -> None:
        """Begin to watch the inputs, when the first bus is open."""
        if not self._is_looking:
            self._is_looking = True
            self._opened_at = self.clock.now()
            self.waits_for = {estop.name for estop in self._estops}
            if self._keyboard.takers:
                self._keyboard.open()
            self._next = self.clock.call_in(self._period, self._again)

    def _closed(self) -> None:
        if not any(host.is_open for host in self.rig.hosts.values()):
            self._is_looking = False
            if self._next is not None:
                self._next.cancel()
            self._keyboard.close()

    def _again(self) -> None:
        if self._is_looking:
            self._next = self.clock.call_in(self._period, self._again)
            self.look()

    def look(self) -> None:
        """Look at all inputs now; what has become pressed trips."""
        now = self.clock.now()
        if self._keyboard.takers:
            self._keyboard.look()
        new: list[str] = []
        for estop in self._estops:
            name, why = estop.name, estop.why(now)
            is_waiting = name in self.waits_for
            if is_waiting and why and estop.is_unread and now - self._opened_at <= estop.stale_ns:
                continue
            self.waits_for.discard(name)
            was_clear = is_waiting or name not in self.pressed
            if not why:
                if self.pressed.pop(name, None) is not None and not is_waiting:
                    self._say("estop clear", name)
                continue
            self.pressed[name] = why
            if was_clear:
                new.append(name)
        if new:
            self._trip(new)
        elif not self.pressed and self.rig.door.barred:
            self.rig.door.barred = ""
            if not self._was_tripped:
                self.rig.door.release()
        self._reduce()

    def _reduce(self) -> None:
        """Scale the limits of speed, as the file or an input says."""
        stated, door = self.rig.robot.reduced, self.rig.door
        if stated is None:
            return
        why = "" if self._reduces is None else self._reduces.why(self.clock.now())
        scale = stated.scale if stated.active or why else 1.0
        if scale == door.scale:
            return
        door.reduce(scale)
        if self._is_looking:
            self._say(
                "reduced" if scale < 1.0 else "full speed",
                "reduced",
                f"{scale:g} of every speed; {why}".rstrip("; "),
            )

    def _say(self, kind: Kind, name: str, detail: str = "") -> None:
        self.rig.events.emit(DeviceEvent(kind, self.clock.now(), "", name, detail))

    # ------------------------------------------------------------------ stopping

    def _reason(self) -> str:
        return "e-stop " + "; ".join(f"{name}: {why}" for name, why in self.pressed.items())

    def _trip(self, names: Iterable[str]) -> None:
        """Stop what is driven, before anybody is told."""
        self._was_tripped = True
        reason = self._reason()
        self.rig.door.bar(reason)
        devices = self.rig.devices.values()
        if any(device.is_driven for device in devices):
            self._stop(devices)
        for trip in self.tripped:
            trip(reason)
        for name in names:
            self._say("estop", name, self.pressed[name])

    def _stop(self, devices: Iterable[Device]) -> None:
        """Stop devices, again and again while an input is pressed and a bus is open, until each has confirmed it."""
        if self._stopping is not None and not self._stopping.is_over:
            self._stopping.cancel()
        stopping = self._stopping = stop_devices(self.clock, f"{self.rig.robot.name} e-stop", devices)

        def over(_: object) -> None:
            error = stopping.error
            if self._stopping is not stopping or not isinstance(error, NotStoppedError):
                return
            left = [self.rig.devices[name] for name in error.devices]
            for device in left:
                device.emit_event("not stopped", error.devices[device.name])
            if self.pressed and self._is_looking:
                self._stop(left)

        stopping.then(over)

    # ------------------------------------------------------------------ enabling

    def missing(self, devices: Collection[Device], action: str = "enable") -> list[str]:
        """Return what stands between these devices and an action that enables or moves them, in the order of the chain.

        E-stop, another program's stop, joints that are not homed (unless the action homes), brakes.
        """
        now = self.clock.now()
        found = [f"e-stop {name}: {why}" for name, why in self.pressed.items()]
        if self.rig.stopped_by:
            found.append(f"stopped by {self.rig.stopped_by}: release it first")
        joints = [joint for device in devices for joint in device.joints]
        if action != "home" and self.rig.robot.estop:
            door = self.rig.door
            unhomed = [] if door.takes_unhomed else door.unhomed
            found += [f"{joint.name} is not homed (action home)" for joint in joints if joint.name in unhomed]
        for joint in joints:
            brake = self._brakes.get(joint.name)
            why = brake.why(now) if brake is not None else ""
            if why:
                found.append(f"brake of {joint.name}: {why}")
        return found

    def _interlock_of(self, device: Device) -> Callable[[str], str]:
        return lambda action: "; ".join(self.missing([device], action))
