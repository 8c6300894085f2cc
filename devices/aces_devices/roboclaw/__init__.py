"""Basicmicro RoboClaw: two motors a controller, each a joint by duty, speed or position; up to eight controllers on a line.

1. The controller obeys every command of motion at once; no command enables it. The driver sends none before `enable`, and
   none after a fault or silence, until `enable` is called again.
2. An answer has no head: one controller of the line is asked at a time, also where it only acknowledges a set-point.
3. `enable` sets the serial time-out, with which it stops both motors when its host is gone.

Source: RoboClaw Series User Manual, Basicmicro; see the spec.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Device, Driver, HostLoss, Job, Poll, Steps, Ticket
from aces_bus.device.config import Joint
from aces_bus.device.host_loss import Outcome
from aces_bus.device.settings import described, settings_of
from aces_bus.device.signals import Signal
from aces_bus.device.single_motor import JointScale
from aces_bus.errors import CallerError, DeviceError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_protocols.roboclaw.spec import ADDRESSES, FULL_DUTY

from ..scanning import scan_numbers
from .twin import RoboclawTwin

#: How long an answer may take, and how often health is asked for (s).
ANSWER_S, HEALTH_S = 0.05, 0.5
#: The serial time-out where the robot's file does not say (s).
WATCHDOG_S = 1.0
#: Of joints that state none: speed (rad/s) and acceleration (rad/s²) on the way to a position.
USUAL_SPEED, USUAL_ACCELERATION = 1.0, 4.0
#: On the way to a position it speeds up more steeply than its set-points, which the door leads, by this factor.
STEEPER = 1.5
#: By the joint's `command`: its signal, and the message and field that set it.
MODES = {
    "duty": ("duty", "DriveDutyM{}", "duty"),
    "speed": ("velocity", "DriveSpeedM{}", "speed"),
    "position": ("position", "RampToM{}", "position"),
}


class RoboclawSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    timeout_s: (
        Annotated[
            float,
            Meta(
                ge=0,
                le=25.5,
                description="the serial time-out that `enable` sets (s), in steps of 0.1, 0: none; when absent 1, on buses"
                " with a rate",
            ),
        ]
        | None
    ) = None


@dataclass(frozen=True)
class RoboclawAxis:
    """One motor: its joint, and how its counts are the joint's angle."""

    motor: int
    joint: Joint
    scale: JointScale
    has_encoder: bool
    command: str


class Roboclaw(Device):
    """Signals of each joint: duty, current, with an encoder position, velocity; of the controller: voltage, temperature."""

    protocol = "roboclaw"
    one_at_a_time = True
    streams = tuple(message.format(motor) for motor in (1, 2) for _, message, _ in MODES.values())
    stream_replies: ClassVar = dict.fromkeys(streams, ("Done", ANSWER_S))
    actions: ClassVar = {
        "enable": "set the serial time-out, and follow set-points from now on",
        "disable": "stop both motors",
        "version": "ask for name and firmware",
        "gains": "read the gains of both speeds",
        "reset_encoders": "make the present positions zero, while it is disabled",
    }
    asking: ClassVar = ("version", "gains")
    when_host_is_lost = HostLoss(
        "limp",
        "RoboClaw Series User Manual, page 66 (command 14)",
        WATCHDOG_S,
        "`enable` sets its serial time-out (`timeout_s`): both motors stop; how, the manual does not say",
    )

    def setup(self) -> None:
        """Add signals and polls of the joints that there are."""
        given = settings_of(self.name, RoboclawSettings, self.config.settings).timeout_s
        usual = WATCHDOG_S if self.host.rate_hz else 0.0
        self.timeout_s = usual if given is None else given
        self.faults: frozenset[str] = frozenset()
        self.takes_set_points = False
        joints = {joint.channel: joint for joint in self.joints}
        if beyond := [joint.name for channel, joint in joints.items() if channel > 1]:
            raise CallerError(
                f"{self.name}: {beyond[0]} is beyond channel 1; a RoboClaw has channels 0 and 1"
            )
        self.axes = [self._axis(channel, joint) for channel, joint in sorted(joints.items())]
        for axis in self.axes:
            self._add_joint(axis)
        slow = 5 * HEALTH_S
        for name, unit, of, doc, source in (
            ("voltage", "V", "MainVoltage.voltage", "of the main battery", "command 24"),
            ("temperature", "°C", "Temperature.temperature", "of the board", "command 82"),
        ):
            self.add_signal(name, unit=unit, of=of, to_si=float, stale_s=slow, doc=doc, source=source)
        often = {
            "GetDuties": "Duties",
            "GetCurrents": "Currents",
            **({"GetEncoders": "Encoders", "GetRawSpeeds": "RawSpeeds"} if self._has_encoders else {}),
        }
        seldom = {"GetStatus": "Status", "GetMainVoltage": "MainVoltage", "GetTemperature": "Temperature"}
        self.polls = [
            *(Poll(ask, answer, timeout_s=ANSWER_S) for ask, answer in often.items()),
            *(Poll(ask, answer, every_s=HEALTH_S, timeout_s=ANSWER_S) for ask, answer in seldom.items()),
        ]

    @property
    def _has_encoders(self) -> bool:
        return any(axis.has_encoder for axis in self.axes)

    def _axis(self, channel: int, joint: Joint) -> RoboclawAxis:
        if joint.command not in MODES:
            raise CallerError(
                f"{self.name}: {joint.name} is set by {joint.command}, which a RoboClaw cannot; it can {', '.join(MODES)}"
            )
        if joint.encoder is None and joint.command != "duty":
            raise CallerError(
                f"{self.name}: {joint.name} is set by {joint.command}; say encoder = counts a turn of its motor"
            )
        scale = JointScale.of(joint, (joint.encoder or 1.0) / math.tau)
        return RoboclawAxis(channel + 1, joint, scale, joint.encoder is not None, joint.command)

    def _add_joint(self, axis: RoboclawAxis) -> None:
        joint, scale, motor = axis.joint, axis.scale, axis.motor
        speed, most = joint.max_speed, min(1.0, joint.max_duty or 1.0)

        def signed(value: Any) -> float:
            return scale.direction * float(value) + 0.0

        def add(name: str, of: str, from_si: Callable[[Any], Any], **more: Any) -> None:
            chosen, message, field = MODES[axis.command]
            path = f"{message.format(motor)}.{field}" if name == chosen else None
            self.add_signal(name, owner=joint.name, of=of, set=path, from_si=from_si, **more)

        add(
            "duty",
            f"Duties.m{motor}",
            lambda value: round(signed(value) * FULL_DUTY) / FULL_DUTY,
            to_si=signed,
            lower=-most,
            upper=most,
            doc="share of the supply; its sign is the direction",
            source="commands 48, 32",
        )
        add(
            "current",
            f"Currents.m{motor}",
            float,
            unit="A",
            to_si=signed,
            doc="of the motor",
            source="command 49",
        )
        if not axis.has_encoder:
            return
        add(
            "position",
            f"Encoders.m{motor}",
            lambda value: round(scale.raw_angle(float(value))),
            unit="rad",
            to_si=scale.angle,
            lower=joint.lower,
            upper=joint.upper,
            doc="where the joint is, by its encoder",
            source="commands 78, 65",
        )
        add(
            "velocity",
            f"RawSpeeds.m{motor}",
            lambda value: round(scale.raw_speed(float(value))),
            unit="rad/s",
            to_si=scale.speed,
            lower=None if speed is None else -speed,
            upper=speed,
            doc="how fast it turns, by the last 1/300 s",
            source="commands 79, 35",
        )

    def completed(self, message: str, fields: dict[str, FieldValue]) -> dict[str, FieldValue]:
        """Add speed and acceleration on the way to a position, which replaces the one before."""
        if not message.startswith("RampTo"):
            return fields
        axis = next(axis for axis in self.axes if message == f"RampToM{axis.motor}")
        joint = axis.joint
        speed = abs(axis.scale.raw_speed(joint.max_speed or USUAL_SPEED))
        ramp = STEEPER * abs(axis.scale.raw_speed(joint.max_acceleration or USUAL_ACCELERATION))
        rate = max(1, round(ramp))
        return {
            **fields,
            "speed": max(1, round(speed)),
            "acceleration": rate,
            "deceleration": rate,
            "at_once": 1,
        }

    # ------------------------------------------------------------------ what it says

    def received(self, record: Record, instant: int) -> None:
        """Take faults from its status; with a fault it follows no set-points."""
        if type(record).__name__ != "Status":
            return
        before = self.faults
        self.faults = frozenset(
            name
            for name in record.status
            if not name.startswith("warning") and not name.endswith("triggered")
        )
        self.emit_alarms(self.faults, before)
        if self.faults and self.takes_set_points:
            self._let_go()

    def no_reply(self, ticket: Ticket) -> None:
        """Note that a silent controller may have been switched off, and must be enabled anew."""
        if self.misses >= self.silent_after:
            self._let_go()

    def forget(self) -> None:
        """Forget all that was known; it is enabled anew."""
        super().forget()
        self.takes_set_points = False

    def _let_go(self) -> None:
        self.takes_set_points = False
        for message in self.streams:
            self.drop(message)

    # ------------------------------------------------------------------ switching

    @property
    def host_loss(self) -> HostLoss:
        """As declared; without a time-out it goes on."""
        if self.timeout_s:
            return replace(self.when_host_is_lost, after_s=self.timeout_s)
        return replace(self.when_host_is_lost, does="goes on", after_s=None, detail="it has no time-out here")

    @property
    def fed_within_s(self) -> float | None:
        """Its serial time-out, which any packet feeds."""
        return self.timeout_s or None

    @property
    def stop_leaves(self) -> Outcome:
        """Duty 0, which the manual does not say more of."""
        return "limp"

    def enable(self) -> Job:
        """Set the serial time-out, and follow set-points. Fails with `DeviceError` while the controller reports a fault."""
        self.end_led("enable")
        self.is_driven = True

        def steps(job: Job) -> Steps:
            if self.takes_set_points:
                return
            yield self.ask("GetStatus", reply="Status", timeout_s=ANSWER_S)
            if self.faults:
                raise DeviceError(f"{self.name}: {', '.join(sorted(self.faults))}; clear it first")
            yield self.ask(
                "SetSerialTimeout", reply="Done", timeout_s=ANSWER_S, timeout=round(self.timeout_s, 1)
            )
            if self._has_encoders:
                yield self.ask("GetEncoders", reply="Encoders", timeout_s=ANSWER_S)
            self.takes_set_points = True

        return self.lead("enable", steps)

    def disable(self) -> Ticket:
        """Stop both motors; set-points end."""
        return self.stop_motion()

    def stop_motion(self) -> Ticket:
        """Drive both motors with duty 0, at once; set-points end."""
        self.end_led()
        self._let_go()
        return self.send_now("DriveDuties", reply="Done", timeout_s=ANSWER_S, retries=2, m1=0, m2=0)

    def confirm_stopped(self) -> Job:
        """Ask for both duties; the job fails where one is not 0."""

        def steps(job: Job) -> Steps:
            record = yield self.ask("GetDuties", reply="Duties", timeout_s=ANSWER_S, confirms=True)
            on = [f"M{motor}" for motor, duty in ((1, record.m1), (2, record.m2)) if duty]
            if on:
                raise DeviceError(f"{self.name}: {', '.join(on)} is still driven")

        return self.job("look whether it is stopped", steps)

    def takes(self, signal: Signal) -> bool | None:
        """Return False until it is enabled."""
        return super().takes(signal) if self.takes_set_points else False

    # ------------------------------------------------------------------ actions

    def version(self) -> Ticket:
        """Ask for name and firmware: the record's `version`."""
        return self.ask("GetVersion", reply="Version", timeout_s=ANSWER_S)

    def gains(self) -> Job:
        """Read the gains of both speeds: {"M1": {"p": …, "i": …, "d": …, "full_speed": counts/s}, "M2": …}."""

        def steps(job: Job) -> Steps:
            found: dict[str, dict[str, float]] = {}
            for motor in (1, 2):
                answer = yield self.ask(
                    f"GetSpeedGainsM{motor}", reply=f"SpeedGainsM{motor}", timeout_s=ANSWER_S
                )
                found[f"M{motor}"] = {name: getattr(answer, name) for name in ("p", "i", "d", "full_speed")}
            return found

        return self.job("gains", steps)

    def reset_encoders(self) -> Ticket:
        """Set both encoders to 0. Raises `CallerError` while it is enabled."""
        if self.takes_set_points:
            raise CallerError(f"{self.name}: its encoders are set while it is disabled")
        return self.ask("ResetEncoders", reply="Done", timeout_s=ANSWER_S, retries=0)


EXAMPLE = """
name = "roboclaw"
rate_hz = 20

[buses]
line = { link = "serial", protocol = "roboclaw", baud = 460_800 }

[devices]
RC80 = { driver = "roboclaw", bus = "line", credentials = { address = 0x80 } }
RC81 = { driver = "roboclaw", bus = "line", credentials = { address = 0x81 }, settings = { timeout_s = 0.5 } }
RC87 = { driver = "roboclaw", bus = "line", credentials = { address = 0x87 } }

[joints]
LEFT = { device = "RC80", channel = 0, type = "continuous", command = "speed", encoder = 4096, max_speed = 20 }
RIGHT = { device = "RC80", channel = 1, type = "continuous", command = "speed", encoder = 4096, max_speed = 20 }
ARM = { device = "RC81", channel = 0, encoder = 2000, harmonic = 50, direction = -1, zero = 0.1, upper = 1.5, lower = -1.5 }
FAN = { device = "RC87", channel = 1, type = "continuous", command = "duty", max_duty = 0.8 }
"""

driver = Driver(
    "roboclaw",
    device=Roboclaw,
    twin=RoboclawTwin,
    example=EXAMPLE,
    doc="Basicmicro RoboClaw: two motors, each by duty, speed or position.",
    source="RoboClaw Series User Manual, Basicmicro",
    scan=scan_numbers(
        "roboclaw", "RC", "address", ADDRESSES, "GetVersion", reply="Version", timeout_s=ANSWER_S
    ),
    settings=described(RoboclawSettings),
)
__all__ = ["driver"]
