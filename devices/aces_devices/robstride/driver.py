"""CyberGear and RobStride motors: a joint with stiffness, damping and torque, or by position, speed or current.

1. The motor does not tell its ranges: the robot's file says its model, and a model that sources disagree about needs
   `ranges`.
2. Only what answers commands says whether it is on. While none is sent it is asked for parameters, which disturb
   nobody; to be asked whether it is on it would have to be stopped. Until it has said so it counts as off.
3. Its mode changes while it is stopped only: enabling stops it first.

Sources: see the spec.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import msgspec
from msgspec import Meta

from aces_bus.device import Driver, HostLoss, Job, Poll, Steps, Ticket
from aces_bus.device.settings import described, settings_of
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError, DeviceError, UnknownNameError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_protocols.robstride.spec import (
    DIALECTS,
    FAMILY,
    KINDS,
    MODELS,
    PARAMETERS,
    READ_ONLY,
    RUN_MODES,
    UNDECIDED,
)

from ..mit_motor import MitMotor
from ..scanning import scan_numbers
from .twin import RobstrideTwin

#: Bits of a feedback that are faults.
FAULTS = (
    "under_voltage",
    "over_current",
    "over_temperature",
    "magnetic_encoder",
    "hall_encoder",
    "stalled",
    "uncalibrated",
)
#: Mode → the parameter that is set.
TARGETS: Mapping[str, str] = {"position": "loc_ref", "speed": "spd_ref", "current": "iq_ref"}
#: The time-out where the robot's file does not say: ten ticks, and at least this (s); its unit (s).
WATCHDOG_S, TIMEOUT_UNIT_S = 0.1, 50e-6
#: How long an answer may take (s).
ANSWER_S = 0.02
#: A parameter's answer that is another's is asked for again, so often.
ANOTHERS = 3


class RobstrideSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    mode: Annotated[
        Literal["motion", "position", "speed", "current"] | None,
        Meta(description="how it is controlled; when absent motion, or what the joint's command says"),
    ] = None
    ranges: Annotated[
        tuple[float, float, float, float, float] | None,
        Meta(description="position, velocity, torque, kp, kd at full scale, where the model does not say it"),
    ] = None
    host: Annotated[
        int, Meta(ge=0x80, le=0xFF, description="the number that answers are sent to, 0xFD when absent")
    ] = 0xFD
    watchdog_s: (
        Annotated[
            float,
            Meta(
                ge=0,
                le=5,
                description="a RobStride's own time-out (s), 0: leave it as it is; when absent ten ticks, at least 0.1 s; a"
                " CyberGear has none",
            ),
        ]
        | None
    ) = None
    torque_limit: (
        Annotated[float, Meta(gt=0, description="limit_torque (N·m at the motor), as it is when absent")]
        | None
    ) = None
    health_s: Annotated[
        float,
        Meta(
            gt=0,
            description="how often velocity (while it is off), current and voltage are asked for (s), 0.2 when absent",
        ),
    ] = 0.2


class Robstride(MitMotor):
    """One motor. Signals of the joint: position, velocity, torque, kp, kd, current; of the motor: state and voltage."""

    protocol = "robstride"
    mit_mode = "motion"
    also_from: ClassVar = {"position": ("FloatParameter",), "velocity": ("FloatParameter",)}
    streams = ("Command", "WriteFloat")
    modes: ClassVar = {
        "motion": {name: f"Command.{name}" for name in ("position", "velocity", "torque", "kp", "kd")},
        "position": {"position": "WriteFloat.value"},
        "speed": {"velocity": "WriteFloat.value"},
        "current": {"current": "WriteFloat.value"},
    }
    usual_modes: ClassVar = {"position": "motion", "speed": "speed", "current": "current"}
    actions: ClassVar = {
        **MitMotor.motor_actions,
        "clear_faults": "stop it and clear its faults",
        "set_zero": "the present position is 0 of the motor (CyberGear: until power-off)",
        "read": "read a parameter by its name",
        "write": "write a parameter, until power-off; confirm=true",
        "unique_id": "ask for its unique id",
        "save": "keep the parameters for good (RobStride); confirm=true",
    }
    asking: ClassVar = ("read", "unique_id")
    when_host_is_lost = HostLoss(
        "limp", "RS03 manual §3.3.6, parameter 0x7028 (canTimeout, 20000 is 1 s, 0 from the factory)", WATCHDOG_S,
        "`enable` sets its time-out (`watchdog_s`); a CyberGear has none, and goes on",
    )  # fmt: skip

    def setup(self) -> None:
        """Declare the signals of the motor, and the parameters that are polled."""
        settings = self.settings = settings_of(self.name, RobstrideSettings, self.config.settings)
        self.declare(mode=settings.mode)
        dialect = str(self.variant.dialect)
        model = self.config.model or (
            "CyberGear" if dialect == FAMILY else dialect if dialect in MODELS else None
        )
        if settings.ranges is None and model in UNDECIDED:
            raise CallerError(
                f"{self.name}: the sources disagree about a {model} ({UNDECIDED[model]}): look into its manual, and say"
                " settings ranges = [position, velocity, torque, kp, kd]"
            )
        if settings.ranges is None and model not in MODELS:
            raise UnknownNameError(
                f"model of {self.name}", model or "(none is stated)", [*MODELS, *UNDECIDED]
            )
        self._alarms: frozenset[str] = frozenset()
        slow = max(0.5, 5 * settings.health_s)
        self.declare_mit(DIALECTS[dialect], settings.ranges or MODELS[str(model)], {"velocity": slow})
        direction = self.scale.direction
        self.current = self.add_motor_signal(
            "current", unit="A", from_si=lambda value: direction * float(value), read_from=("FloatParameter",), stale_s=slow,
            doc="the motor's", source="parameters 701A, 7006",
        )  # fmt: skip
        self.voltage = self.add_signal(
            "voltage",
            unit="V",
            read_from=("FloatParameter",),
            stale_s=slow,
            doc="supply",
            source="parameter 701C",
        )
        self.add_signal("state", of="Feedback.state", to_si=str, doc="reset, calibration or run, as of its last feedback",
            source="identifier of a feedback", stale_s=1e6)  # fmt: skip
        self.add_signal(
            "temperature",
            unit="°C",
            of="Feedback.temperature",
            doc="as of its last feedback",
            source="feedback",
            stale_s=1e6,
        )
        host = {"host": settings.host}
        self.polls = [
            Poll(
                "ReadParameter", "FloatParameter", {**host, "index": "mech_pos"}, timeout_s=ANSWER_S,
                asked_by=dict.fromkeys(self.streams, "Feedback"),
            ),
            *(
                Poll("ReadParameter", "FloatParameter", {**host, "index": index}, settings.health_s, ANSWER_S)
                for index in ("mech_vel", "iqf", "vbus")
            ),
        ]  # fmt: skip

    # ------------------------------------------------------------------ up

    def received(self, record: Record, instant: int) -> None:
        """Take from a feedback whether the motor is on; take position and state from parameters."""
        name = type(record).__name__
        if name == "Feedback":
            faults = {fault for fault in FAULTS if getattr(record, fault, 0)}
            self.shows(record.state == "run", faults)
        elif name == "FloatParameter" and record.status == "ok":
            value, scale = record.value, self.scale
            match str(record.index):
                case "mech_pos":
                    self.of_joint("position").update(scale.angle(value), instant)
                case "mech_vel":
                    self.of_joint("velocity").update(scale.speed(value), instant)
                case "iqf":
                    self.current.update(scale.direction * value, instant)
                case "vbus":
                    self.voltage.update(value, instant)
                case _:
                    pass
        elif name == "FaultReport":
            now = frozenset((*record.faults, *(f"{warning} (warning)" for warning in record.warnings)))
            before, self._alarms = self._alarms, now
            self.emit_alarms(now, before, f"{self.owner}: ")

    def takes(self, signal: Signal) -> bool | None:
        """Return False until it has said that it is on."""
        return super().takes(signal) if self.is_on else False

    # ------------------------------------------------------------------ switching

    @property
    def watchdog_s(self) -> float:
        """The time-out that `enable` sets (s); 0: it sets none."""
        wait_s, rate = self.settings.watchdog_s, self.host.rate_hz
        if self.variant.dialect == FAMILY:
            return 0.0
        return wait_s if wait_s is not None else max(WATCHDOG_S, 10 / rate) if rate else 0.0

    @property
    def host_loss(self) -> HostLoss:
        """As declared, after its time-out; one that `enable` does not set is off from the factory."""
        loss, wait_s = self.when_host_is_lost, self.watchdog_s
        if wait_s:
            return replace(loss, after_s=wait_s)
        none = "a CyberGear has no time-out"
        why = none if self.variant.dialect == FAMILY else "watchdog_s sets a time-out"
        return replace(loss, does="goes on", after_s=None, detail=why)

    @property
    def fed_within_s(self) -> float | None:
        """Its time-out, which every message to it feeds."""
        return self.watchdog_s or None

    def bring_up(self, job: Job) -> Steps:
        """Yield steps that stop the motor, set its mode, enable it and set its limits."""
        yield self.ask_state()
        number = RUN_MODES[self.mode]
        yield from self._written("run_mode", number)
        if self.watchdog_s:
            yield from self._written("can_timeout", round(self.watchdog_s / TIMEOUT_UNIT_S))
        if self.of_joint("position").instant is None:
            yield self.read("mech_pos")
        job.progress, job.text = 0.5, "on"
        yield self.ask("Enable", reply="Feedback", timeout_s=ANSWER_S, host=self.settings.host)
        joint, limit = self.joint, self.settings.torque_limit
        if limit is not None:
            yield from self._written("limit_torque", limit)
        if self.mode == "position" and joint is not None and joint.max_speed is not None:
            yield from self._written("limit_spd", abs(self.scale.raw_speed(joint.max_speed)))
        if self.mode in ("position", "speed") and joint is not None and joint.max_current is not None:
            yield from self._written("limit_cur", joint.max_current)

    def completed(self, message: str, fields: dict[str, FieldValue]) -> dict[str, FieldValue]:
        """Add the asking host, and the parameter of the mode's set-point."""
        if message == "WriteFloat":
            return {**fields, "host": self.settings.host, "index": TARGETS[self.mode]}
        return fields

    def switch_off(self) -> Ticket:
        """Stop; its answer says so."""
        return self.send_now("Stop", reply="Feedback", timeout_s=ANSWER_S, host=self.settings.host, clear=0)

    def ask_state(self) -> Ticket:
        """Stop it, which is what makes it say how it is."""
        return self.ask("Stop", reply="Feedback", timeout_s=ANSWER_S, host=self.settings.host, clear=0)

    # ------------------------------------------------------------------ actions

    def clear_faults(self) -> Ticket:
        """Stop it and clear its faults."""
        self.end_led()
        self.end_set_points()
        return self.ask("Stop", reply="Feedback", timeout_s=ANSWER_S, host=self.settings.host, clear=1)

    def set_zero(self) -> Job:
        """Make the present position the motor's 0. Fails unless the motor reports that it is off: disable it first."""

        def steps(job: Job) -> Steps:
            self.check_off("zero can be set")
            yield self.ask(
                "SetZero", reply="Feedback", timeout_s=ANSWER_S, host=self.settings.host, confirm=1
            )
            self.epoch += 1

        return self.job("set zero", steps)

    def _kind(self, name: str) -> str:
        for kind, (names, _) in KINDS.items():
            if name in names:
                return kind
        raise UnknownNameError(f"parameter of {self.name}", name, PARAMETERS)

    def read(self, name: str) -> Job:
        """Read a parameter: its value, in the motor's unit. Raises `UnknownNameError`; fails with `DeviceError`."""
        kind = self._kind(name)

        def steps(job: Job) -> Steps:
            for _ in range(ANOTHERS):
                answer = yield self.ask(
                    "ReadParameter",
                    reply=f"{kind}Parameter",
                    timeout_s=ANSWER_S,
                    host=self.settings.host,
                    index=name,
                )
                if answer.index == name:  # else it is the late answer to another question
                    if answer.status != "ok":
                        raise DeviceError(f"{self.name}: it does not give {name}")
                    return answer.value
            raise DeviceError(f"{self.name}: asked for {name}, it answers others")

        return self.job(f"read {name}", steps)

    def write(self, name: str, value: float, confirm: bool) -> Job:
        """Write a parameter, until power-off, and read it back. Raises `CallerError` for one that can only be read."""
        self._kind(name)
        if name in READ_ONLY:
            raise CallerError(f"{self.name}: {name} can only be read")
        if confirm is not True:
            raise CallerError(
                f"{self.name}: say confirm=True; a parameter can move the motor, or change its limits"
            )
        return self.job(f"write {name}", lambda job: self._written(name, value))

    def _written(self, name: str, value: float) -> Steps:
        kind = self._kind(name)
        given = float(value) if kind == "Float" else int(value)
        yield self.ask(
            f"Write{kind}",
            reply="Feedback",
            timeout_s=ANSWER_S,
            host=self.settings.host,
            index=name,
            value=given,
        )
        answer = yield self.read(name)
        if abs(answer - given) > 1e-5 * abs(given):
            raise DeviceError(f"{self.name}: {name} was written {given}, and is {answer}")

    def unique_id(self) -> Ticket:
        """Ask for its unique id: the record's `unique_id`."""
        return self.ask("GetId", reply="Id", timeout_s=ANSWER_S, host=self.settings.host)

    def save(self, confirm: bool) -> Ticket:
        """Keep the parameters for good. Raises `CallerError` for a CyberGear, whose type 22 is another command."""
        if self.variant.dialect == FAMILY:
            raise CallerError(
                f"{self.name}: a CyberGear keeps nothing by this command: there it sets the bit rate"
            )
        if confirm is not True:
            raise CallerError(
                f"{self.name}: say confirm=True; what was written so far outlives power-off then"
            )
        return self.send("Save", host=self.settings.host)


#: Both families.
EXAMPLE = """
name = "robstride"
rate_hz = 20

[buses]
new = { link = "can", protocol = "robstride", bitrate = 1_000_000 }
old = { link = "can", protocol = "robstride", dialect = "cybergear", bitrate = 1_000_000 }

[devices]
M1 = { driver = "robstride", bus = "new", credentials = { motor = 1 }, model = "RS04" }
M127 = { driver = "robstride", bus = "old", credentials = { motor = 127 } }

[joints]
HIP = { device = "M1", direction = -1, zero = 0.2, lower = -1.5, upper = 1.5, max_speed = 6, gains = { kp = 200, kd = 5 } }
WHEEL = { device = "M127", type = "continuous", command = "speed", max_speed = 20 }
"""

driver = Driver(
    "robstride",
    device=Robstride,
    twin=RobstrideTwin,
    example=EXAMPLE,
    doc="CyberGear or RobStride motor: a joint with stiffness, damping and torque, or by position, speed or current.",
    source="cybergear-docs; Robstride-Dynamics-Python-SDK; kscalelabs/robstride",
    # Its unique id.
    scan=scan_numbers(
        "robstride", "RS", "motor", range(1, 0x80), "GetId", reply="Id", timeout_s=0.03, host=0xFD
    ),
    settings=described(RobstrideSettings),
)
