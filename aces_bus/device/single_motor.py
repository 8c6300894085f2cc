"""A motor that is a node of its own: one joint, one mode at a time.

1. What the present mode takes can be set, and nothing else. While the motor is off, set-points are dropped, and reported.
2. Whether it is on is what the motor says, not what it was told. One that switches itself off loses its set-points.
3. It is enabled where it is; a stop ends its set-points and switches it off.

A driver declares its `modes` and signals, and says how to switch on (`bring_up`), what keeps it where it is (`stay`), how to
switch off (`switch_off`) and how to ask whether it is (`ask_state`); what its messages say goes to `shows`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

from ..errors import CallerError, DeviceError
from ..protocol.record import FieldValue
from .config import Joint
from .motor import MotorDevice
from .signals import Signal
from .ticket import Awaited, Job, Steps

#: How long switching on may take, s.
SWITCH_S = 2.0


@dataclass(frozen=True)
class JointScale:
    """A motor's own numbers and its joint's, in SI: angle of the motor = (direction × position + zero) × ratio.

    `per_rad`: the motor's units of angle a rad (1 / 2π where it counts turns). Torques are N·m on both sides.
    """

    per_rad: float = 1.0
    ratio: float = 1.0
    direction: int = 1
    zero: float = 0.0

    @classmethod
    def of(cls, joint: Joint | None, per_rad: float = 1.0) -> JointScale:
        """Return the scale of a joint, as its file says; without a joint the motor's own."""
        if joint is None:
            return cls(per_rad)
        return cls(per_rad, joint.ratio or 1.0, joint.direction, joint.zero or 0.0)

    def angle(self, raw: float) -> float:
        """Return the joint's position (rad)."""
        return self.direction * (raw / (self.per_rad * self.ratio) - self.zero) + 0.0  # no -0

    def raw_angle(self, position: float) -> float:
        """Return what the motor calls a position of its joint (rad)."""
        return (self.direction * position + self.zero) * self.ratio * self.per_rad

    def speed(self, raw: float) -> float:
        """Return the joint's velocity (rad/s)."""
        return self.direction * raw / (self.per_rad * self.ratio) + 0.0

    def raw_speed(self, velocity: float) -> float:
        """Return what the motor calls a velocity of its joint (rad/s)."""
        return self.direction * velocity * self.ratio * self.per_rad

    def torque(self, raw: float) -> float:
        """Return the torque at the joint (N·m) of one at the motor."""
        return self.direction * raw * self.ratio + 0.0

    def raw_torque(self, torque: float) -> float:
        """Return the torque at the motor (N·m) of one at the joint."""
        return self.direction * torque / self.ratio

    def gain(self, raw: float) -> float:
        """Return a stiffness or damping at the joint (N·m/rad, N·m·s/rad) of one at the motor."""
        return raw * self.ratio**2

    def raw_gain(self, gain: float) -> float:
        """Return a stiffness or damping at the motor (N·m/rad, N·m·s/rad) of one at the joint."""
        return gain / self.ratio**2


@dataclass(frozen=True)
class SingleAxis:
    """The axis of a motor that has one."""

    joint: Joint | None
    name: str
    channel: int = 0


class SingleMotor(MotorDevice[SingleAxis]):
    """One motor; see the module.

    `modes`: mode → signal → the field that sets it ("SetPosition.position"). `usual_modes`: the mode of a joint's `command`.
    """

    modes: ClassVar[Mapping[str, Mapping[str, str]]]
    usual_modes: ClassVar[Mapping[str, str]]
    #: What every such motor can do; a driver adds its own.
    motor_actions: ClassVar[Mapping[str, str]] = {
        "enable": "switch it on; it holds where it is",
        "disable": "switch it off; it gives way",
        "set_mode": "another mode, while it is off",
    }

    def declare(self, per_rad: float = 1.0, mode: str | None = None) -> None:
        """Know the joint, its scale and the mode (of the settings, else as the joint's `command` says).

        Raises `CallerError` for several joints, and for a mode that there is not.
        """
        if len(self.joints) > 1:
            names = ", ".join(joint.name for joint in self.joints)
            raise CallerError(f"{self.name}: one motor moves one joint, not {names}")
        self.joint = self.joints[0] if self.joints else None
        self.axes = [SingleAxis(self.joint, self.joint.name if self.joint is not None else self.name)]
        self.owner = self.axes[0].name
        self.scale = JointScale.of(self.joint, per_rad)
        command = self.joint.command if self.joint is not None else "position"
        usual = self.usual_modes.get(command)
        if mode is None and usual is None:
            raise CallerError(
                f"{self.name}: {self.owner} is set by {command}, which this motor cannot; it can"
                f" {', '.join(self.usual_modes)}"
            )
        self.mode = mode or usual or ""
        self._check_mode(self.mode)
        #: Whether it says that it is on; None: it has not said yet.
        self.is_on: bool | None = None
        #: The faults that it reports, by name.
        self.faults: frozenset[str] = frozenset()
        #: Whether it was enabled, and not stopped since.
        self._is_wanted = False
        self._given_as: dict[str, Callable[[Any], Any]] = {}
        for fields in self.modes.values():
            for path in fields.values():
                message, name = self._field(path)
                self._paths.setdefault(message, {})[name] = None

    def _check_mode(self, mode: str) -> None:
        if mode not in self.modes:
            raise CallerError(f"{self.name}: no mode {mode!r} (there are: {', '.join(self.modes)})")

    def add_motor_signal(self, name: str, *, from_si: Callable[[Any], Any] = float, **more: Any) -> Signal:
        """Add a signal of the joint; it can be set in the modes that name it. Arguments as those of `add_signal`."""
        self._given_as[name] = from_si
        can_be_set = any(name in fields for fields in self.modes.values())
        made = self.add_signal(
            name, owner=self.owner, setter=partial(self._give, name) if can_be_set else None, **more
        )
        if name not in self.modes[self.mode]:
            made.setter = None
        return made

    def _give(self, name: str, value: FieldValue) -> None:
        if not self.is_on:
            known = "is off" if self.is_on is False else "has not said yet whether it is on"
            self.emit_event("not sent", f"{self.owner} {known}: the set-point is dropped")
            return
        message, _, field = self.modes[self.mode][name].partition(".")
        self.want(message, field, self.raw_of(name, value))

    def raw_of(self, name: str, value: FieldValue) -> Any:
        """Return a set-point of a motor signal in the motor's own numbers."""
        return self._given_as[name](value)

    def takes(self, signal: Signal) -> bool | None:
        """Return True while the motor is on, None until it has said so: set-points wait."""
        return super().takes(signal) if self.is_on else self.is_on

    # ------------------------------------------------------------------ for drivers

    @abstractmethod
    def bring_up(self, job: Job) -> Steps:
        """Yield the steps before the motor can be switched on: mode, limits, a set-point at the present place."""

    @abstractmethod
    def stay(self) -> None:
        """Want (`want`) what keeps it where it is."""

    @abstractmethod
    def switch_off(self) -> Awaited:
        """Tell it now (`send_now`) to switch off."""

    @abstractmethod
    def ask_state(self) -> Awaited:
        """Have it say anew whether it is on."""

    def shows(self, is_on: bool, faults: Collection[str] = ()) -> None:
        """Note whether the motor reports itself on, and its faults."""
        was_on, self.is_on = self.is_on, is_on
        before, self.faults = self.faults, frozenset(faults)
        self.emit_alarms(self.faults, before, f"{self.owner}: ")
        if was_on and not is_on:
            self.end_set_points()
            if self._is_wanted and not self.faults:
                self.emit_event("alarm", f"{self.owner} has switched itself off")

    # ------------------------------------------------------------------ switching

    def end_set_points(self) -> None:
        """Forget what was set."""
        for message in self.streams:
            self.drop(message)

    def enable(self) -> Job:
        """Follow set-points from now on, beginning where the joint is. Fails with `DeviceError` when it stays off."""
        self.end_led("enable")
        self.is_driven = self._is_wanted = True

        def steps(job: Job) -> Steps:
            if self.is_on:
                return
            self.end_set_points()
            if self.faults:
                raise DeviceError(f"{self.name}: {', '.join(sorted(self.faults))}; clear it first")
            yield from self.bring_up(job)
            yield self.until(
                lambda: self.is_on is True or bool(self.faults), SWITCH_S, lambda: f"{self.owner} stays off"
            )
            if self.faults:
                raise DeviceError(f"{self.name} cannot be enabled: {', '.join(sorted(self.faults))}")
            self.stay()

        return self.lead("enable", steps)

    def disable(self) -> Awaited:
        """Switch it off; the joint gives way."""
        return self.stop_motion()

    def stop_motion(self) -> Awaited:
        """Switch it off at once; its set-points end."""
        self._is_wanted = False
        self.end_led()
        self.end_set_points()
        return self.switch_off()

    def confirm_stopped(self) -> Job:
        """Ask whether it is off."""
        return self.confirm_off(self.ask_state, lambda: [] if self.is_on is False else [self.owner])

    def set_mode(self, mode: str) -> None:
        """Choose the mode from the next `enable` on.

        Raises `CallerError` for one that is none, `DeviceError` while it is on.
        """
        self._check_mode(mode)
        self.check_off("its mode can be changed")
        self.mode = mode
        for name in self._given_as:
            whole = self.signals[f"{self.owner}.{name}"]
            if whole.limit is not None:
                whole.setter = partial(self._give, name) if name in self.modes[mode] else None

    def check_off(self, what: str) -> None:
        """Raise `DeviceError` unless it says that it is off."""
        if self.is_on is not False:
            raise DeviceError(f"{self.name}: {what} while it is off; disable it first")

    def forget(self) -> None:
        """Forget all that was known."""
        super().forget()
        self.is_on = None
