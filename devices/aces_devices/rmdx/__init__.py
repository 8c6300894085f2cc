"""MyActuator RMD-X motors (also RMD-L, RMD-H): a joint by position, speed or current.

1. The motor obeys every command of motion at once; no command enables it: it is on when it has answered such a command, and
   off when it has answered ShutDown. The driver sends none before `enable`, and none after an error, a reset or silence,
   until `enable` is called again.
2. A command of motion is answered with current and speed; in a tick that sends none they are asked for.
3. Without a time-out (`watchdog_s`) it carries out its last command for ever.

Source: MyActuator motion protocol V4.2; see the spec.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Any, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Driver, HostLoss, Job, Poll, SingleMotor, Steps, Ticket
from aces_bus.device.settings import described, settings_of
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError, DeviceError
from aces_bus.protocol import Record
from aces_protocols.rmdx.spec import GAINS, MOTORS

from ..scanning import scan_numbers
from .twin import RmdxTwin

DEGREES = math.degrees(1.0)
#: How long an answer may take, and how often health is asked for (s).
ANSWER_S, HEALTH_S = 0.02, 0.2
#: On the way to a position the motor may be faster than its set-points, which the door leads, by this factor.
FASTER = 1.5
#: Of joints that state no largest speed (rad/s).
USUAL_SPEED = 1.0
#: Largest value of `max_speed` (°/s).
MOST_SPEED = 0xFFFF


class RmdxSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    watchdog_s: (
        Annotated[
            float,
            Meta(
                gt=0,
                le=60,
                description="the motor's own time-out (s): `enable` sets it, once a run, and the motor keeps it for good;"
                " when absent it stays as it is, off from the factory",
            ),
        ]
        | None
    ) = None


class Rmdx(SingleMotor):
    """One motor. Signals of the joint: position, velocity, current; of the motor: voltage, temperature, brake."""

    protocol = "rmdx"
    streams = ("SetPosition", "SetSpeed", "SetCurrent")
    modes: ClassVar = {
        "position": {"position": "SetPosition.position"},
        "speed": {"velocity": "SetSpeed.speed"},
        "current": {"current": "SetCurrent.current"},
    }
    usual_modes: ClassVar = {"position": "position", "speed": "speed", "current": "current"}
    actions: ClassVar = {
        **SingleMotor.motor_actions,
        "release_brake": "open the holding brake: a joint that nothing drives falls",
        "lock_brake": "switch off, and close the holding brake",
        "gains": "read the gains of its controllers",
        "model": "ask for model and date of its software",
        "reset": "boot it anew; it is off then",
    }
    asking: ClassVar = ("gains", "model")
    when_host_is_lost = HostLoss(
        "goes on",
        "MyActuator motion protocol V4.2 §2.30",
        detail="its time-out is off from the factory; with `watchdog_s` its output is cut, and a brake closes",
    )

    def setup(self) -> None:
        """Add the signals and polls."""
        self.settings = settings_of(self.name, RmdxSettings, self.config.settings)
        self.declare(per_rad=DEGREES)
        self.is_on = False
        #: Whether the time-out was set in this run; its run time (ms) when it last said it.
        self._is_watched, self._ran = False, 0
        joint, scale, slow = self.joint, self.scale, 5 * HEALTH_S
        self.add_motor_signal(
            "position",
            unit="rad",
            of="Angle.angle",
            to_si=scale.angle,
            from_si=scale.raw_angle,
            lower=joint.lower if joint is not None else None,
            upper=joint.upper if joint is not None else None,
            doc="where the joint is",
            source="commands 92, A4",
        )
        speed = joint.max_speed if joint is not None else None
        self.velocity = self.add_motor_signal(
            "velocity",
            unit="rad/s",
            of="Status2.speed",
            read_from=("Motion",),
            to_si=scale.speed,
            from_si=scale.raw_speed,
            lower=None if speed is None else -speed,
            upper=speed,
            doc="how fast it turns, in steps of 1°/s at the motor",
            source="commands 9C, A2",
        )
        most = joint.max_current if joint is not None else None
        self.current = self.add_motor_signal(
            "current",
            unit="A",
            of="Status2.current",
            read_from=("Motion",),
            to_si=self._signed,
            from_si=self._signed,
            lower=None if most is None else -most,
            upper=most,
            doc="torque current",
            source="commands 9C, A1",
        )
        for name, unit, to_si, doc in (
            ("voltage", "V", float, "supply"),
            ("temperature", "°C", float, "of the motor"),
            ("brake", "", str, "locked or released"),
        ):
            self.add_signal(
                name, unit=unit, of=f"Status1.{name}", to_si=to_si, stale_s=slow, doc=doc, source="command 9A"
            )
        self.polls = [
            Poll("GetAngle", "Angle", timeout_s=ANSWER_S),
            Poll("GetStatus2", "Status2", timeout_s=ANSWER_S, asked_by=dict.fromkeys(self.streams, "Motion")),
            Poll("GetStatus1", "Status1", every_s=HEALTH_S, timeout_s=ANSWER_S),
            Poll("GetRunTime", "RunTime", every_s=HEALTH_S, timeout_s=ANSWER_S),
        ]

    def _signed(self, value: Any) -> float:
        return self.scale.direction * float(value) + 0.0

    # ------------------------------------------------------------------ up

    def received(self, record: Record, instant: int) -> None:
        """Take from answers whether the motor is on, its errors, and whether it was reset."""
        match type(record).__name__:
            case "Motion":
                self.velocity.update(self.scale.speed(record.speed), instant)
                self.current.update(self._signed(record.current), instant)
                if self._is_wanted and not self.faults:
                    self.shows(True)
            case "ShutDownDone" | "LockBrakeDone":
                self.shows(False, self.faults)
            case "Status1":
                self.shows(bool(self.is_on) and not record.errors, set(record.errors))
            case "RunTime":
                before, self._ran = self._ran, record.time
                if record.time < before:
                    if self.is_on:  # a set-point that came behind the reset has closed a loop again
                        self.switch_off()
                    self.rebooted(f"it has run for {record.time / 1000:g} s")
            case _:
                pass

    def no_reply(self, ticket: Ticket) -> None:
        """Note that a silent motor may have rebooted and must be enabled anew."""
        if self.is_on and self.misses >= self.silent_after:
            self.is_on = False
            self.end_set_points()

    def forget(self) -> None:
        """Forget all that was known; it is off then."""
        super().forget()
        self.is_on = False

    def takes(self, signal: Signal) -> bool | None:
        """Return False until it is on."""
        return super().takes(signal) if self.is_on else False

    # ------------------------------------------------------------------ switching

    @property
    def host_loss(self) -> HostLoss:
        """As declared; with a time-out it is off."""
        loss, wait_s = self.when_host_is_lost, self.settings.watchdog_s
        if wait_s is None:
            return loss
        return replace(
            loss,
            does="limp",
            after_s=wait_s,
            detail="`enable` sets its time-out; a brake closes, where it has one",
        )

    @property
    def fed_within_s(self) -> float | None:
        """Its time-out, which any frame feeds."""
        return self.settings.watchdog_s

    def _present(self) -> dict[str, float]:
        """Return the set-point that keeps it where it is, in the mode's own field."""
        ((name, path),) = self.modes[self.mode].items()
        value = 0.0
        if name == "position":
            here = self.signals[f"{self.owner}.position"].value
            if not isinstance(here, float):
                raise DeviceError(f"{self.name}: it does not say where it is")
            value = self.raw_of(name, here)
        return {path.partition(".")[2]: value}

    def bring_up(self, job: Job) -> Steps:
        """Yield steps that read errors and angle, set the time-out, and give a set-point at the present place."""
        yield self.ask("GetStatus1", reply="Status1", timeout_s=ANSWER_S)
        if self.faults:
            return
        yield self.ask("GetAngle", reply="Angle", timeout_s=ANSWER_S)
        if self.settings.watchdog_s is not None and not self._is_watched:
            wait_ms = round(self.settings.watchdog_s * 1000)
            yield self.ask("SetTimeout", reply="SetTimeoutDone", timeout_s=ANSWER_S, timeout=wait_ms)
            self._is_watched = True
        if self.mode == "current":
            yield self.release_brake()
        message = next(iter(self.modes[self.mode].values())).partition(".")[0]
        given = self.completed(message, dict(self._present()))
        yield self.ask(message, reply="Motion", timeout_s=ANSWER_S, **given)

    def stay(self) -> None:
        """Hold the present position; no speed, no current."""
        message = next(iter(self.modes[self.mode].values())).partition(".")[0]
        for field, value in self._present().items():
            self.want(message, field, value)

    def completed(self, message: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Add the largest speed on the way to a position."""
        if message != "SetPosition":
            return fields
        speed = (self.joint.max_speed if self.joint is not None else None) or USUAL_SPEED
        most = math.ceil(FASTER * abs(self.scale.raw_speed(speed)))
        return {**fields, "max_speed": max(1, min(MOST_SPEED, most))}

    def switch_off(self) -> Ticket:
        """Switch its output off."""
        return self.send_now("ShutDown")

    def ask_state(self) -> Ticket:
        """Switch it off once more: only the answer to that says that it is off."""
        return self.ask("ShutDown", reply="ShutDownDone", timeout_s=ANSWER_S, confirms=True)

    # ------------------------------------------------------------------ actions

    def release_brake(self) -> Ticket:
        """Open the holding brake."""
        return self.ask("ReleaseBrake", reply="ReleaseBrakeDone", timeout_s=ANSWER_S)

    def lock_brake(self) -> Job:
        """Switch off, and close the holding brake."""

        def steps(job: Job) -> Steps:
            yield self.stop_motion()
            yield self.ask("LockBrake", reply="LockBrakeDone", timeout_s=ANSWER_S)

        return self.job("lock the brake", steps)

    def gains(self) -> Job:
        """Read the gains: name → value, of V3 as whole numbers."""

        def steps(job: Job) -> Steps:
            if self.variant.dialect == "3":
                record = yield self.ask("GetGains", reply="Gains", timeout_s=ANSWER_S)
                return {name: getattr(record, name) for name in GAINS if name != "position_kd"}
            found: dict[str, float] = {}
            for name in GAINS:
                record = yield self.ask("GetGain", reply="Gain", timeout_s=ANSWER_S, gain=name)
                if record.gain != name:
                    raise DeviceError(f"{self.name}: asked for {name}, it answers {record.gain}")
                found[name] = record.value
            return found

        return self.job("gains", steps)

    def model(self) -> Job:
        """Ask who it is: "X8S2V10, 20220206"."""

        def steps(job: Job) -> Steps:
            model = yield self.ask("GetModel", reply="Model", timeout_s=ANSWER_S)
            version = yield self.ask("GetVersion", reply="Version", timeout_s=ANSWER_S)
            return f"{model.model}, {version.date}"

        return self.job("model", steps)

    def reset(self) -> Ticket:
        """Boot it anew. Raises `CallerError` while it is on."""
        if self.is_on:
            raise CallerError(f"{self.name}: it is on; disable it first")
        return self.send("Reset")


EXAMPLE = """
name = "rmdx"
rate_hz = 50

[buses]
arm = { link = "can", protocol = "rmdx", bitrate = 1_000_000 }
old = { link = "can", protocol = "rmdx", dialect = "3", bitrate = 1_000_000 }

[devices]
M1 = { driver = "rmdx", bus = "arm", credentials = { id = 1 }, settings = { watchdog_s = 0.3 } }
M2 = { driver = "rmdx", bus = "arm", credentials = { id = 2 } }
M32 = { driver = "rmdx", bus = "old", credentials = { id = 32 } }

[joints]
SHOULDER = { device = "M1", direction = -1, zero = 0.2, lower = -1.5, upper = 1.5, max_speed = 4 }
WINCH = { device = "M2", type = "continuous", command = "current", max_current = 5 }
WHEEL = { device = "M32", type = "continuous", command = "speed", max_speed = 10 }
"""

driver = Driver(
    "rmdx",
    device=Rmdx,
    twin=RmdxTwin,
    example=EXAMPLE,
    doc="MyActuator RMD-X, RMD-L or RMD-H motor: a joint by position, speed or current.",
    source="MyActuator motion protocol V4.2",
    scan=scan_numbers("rmdx", "RMD", "id", MOTORS, "GetModel", reply="Model", timeout_s=ANSWER_S),
    settings=described(RmdxSettings),
)
__all__ = ["driver"]
