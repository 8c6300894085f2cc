"""Damiao DM motors: a joint with stiffness, damping and torque, or by position or velocity.

1. What numbers mean is in the motor: PMAX, VMAX, TMAX (registers 21 to 23) are read before anything is believed or enabled.
2. A command is answered by a feedback, as a question is: in a tick that sends one nothing else is asked.
3. Without stiffness and damping (the joint's `gains`, or the signals `kp` and `kd`) nothing holds: both are 0 at first.
4. The motor's own time-out (register 9) switches it off when commands stay out.

Sources: see the spec.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from aces_bus.device import Driver, HostLoss, Job, Poll, Steps, Ticket
from aces_bus.device.host_loss import Outcome
from aces_bus.device.settings import described, settings_of
from aces_bus.errors import AcesError, CallerError, DeviceError, UnknownNameError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_protocols.damiao.spec import INTEGERS, KD_MAX, KP_MAX, MODELS, READ_ONLY, REGISTERS, SHARE

from ..mit_motor import MitMotor, Ranges
from ..scanning import Scan, scan_numbers
from .twin import DamiaoTwin

#: Units of register 9 (s).
TIMEOUT_UNIT_S = 50e-6
#: The motor's time-out where the robot's file does not say: ten ticks, and at least this (s).
WATCHDOG_S = 0.1
#: Speed on the way in modes that need one and joints that state none (rad/s).
USUAL_SPEED = 1.0
#: Mode → its number in register 10.
NUMBERS: Mapping[str, int] = {"mit": 1, "position_velocity": 2, "velocity": 3, "force_position": 4}
#: A motor whose ranges could not be read is asked for them again after so long (ns).
RETRY_NS = 1_000_000_000
#: Statuses that are not a fault.
_WELL = ("disabled", "enabled")


def whole(ranges: tuple[float, float, float]) -> Ranges:
    """Return all ranges: stiffness and damping have the same in every model."""
    return (*ranges, KP_MAX, KD_MAX)


class DamiaoSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    mode: Annotated[
        Literal["mit", "position_velocity", "velocity", "force_position"] | None,
        Meta(description="how it is controlled; when absent mit, for joints that are set by speed velocity"),
    ] = None
    ranges: Annotated[
        tuple[float, float, float] | None,
        Meta(
            description="PMAX, VMAX, TMAX for who only listens; when absent those of the model (they are read where asked)"
        ),
    ] = None
    timeout_s: (
        Annotated[
            float,
            Meta(
                ge=0,
                description="the motor's time-out (s), 0: none; when absent ten ticks, at least 0.1 s; none without a rate",
            ),
        ]
        | None
    ) = None
    current_limit: Annotated[
        float, Meta(ge=0, le=1, description="share of the current in force_position, 0.1 when absent")
    ] = 0.1
    master: Annotated[
        int,
        Meta(ge=0, le=0x1F, description="what it answers under (register 7), for its twin; 0 when absent"),
    ] = 0


class Damiao(MitMotor):
    """One motor. Signals of the joint: position, velocity, torque, kp, kd; of the motor: status and temperatures."""

    protocol = "damiao"
    streams = ("Command", "PositionVelocity", "Velocity", "ForcePosition")
    polls = (
        Poll(
            "AskFeedback", "Feedback", {"how": 0}, timeout_s=0.02, asked_by=dict.fromkeys(streams, "Feedback")
        ),
    )
    modes: ClassVar = {
        "mit": {name: f"Command.{name}" for name in ("position", "velocity", "torque", "kp", "kd")},
        "position_velocity": {"position": "PositionVelocity.position"},
        "velocity": {"velocity": "Velocity.velocity"},
        "force_position": {"position": "ForcePosition.position"},
    }
    usual_modes: ClassVar = {"position": "mit", "speed": "velocity", "current": "mit"}
    actions: ClassVar = {
        **MitMotor.motor_actions,
        "clear_error": "clear the fault; the motor stays off",
        "set_zero": "the present position is 0 of the motor from now on; confirm=true",
        "read": "read a register by its name or number",
        "write": "write a register, until it is switched off; confirm=true",
        "registers": "read all registers",
        "store": "keep the registers for good; confirm=true",
    }
    asking: ClassVar = ("read", "registers")
    when_host_is_lost = HostLoss(
        "limp", "Damiao DM-J manuals, register 9 (TIMEOUT, 50 µs) and status D (lost communication)", WATCHDOG_S,
        "`enable` sets its time-out (`timeout_s`); a bus without ticks leaves it as it is stored",
    )  # fmt: skip

    def setup(self) -> None:
        """Declare the signals of the motor; its ranges are not known yet."""
        settings = self.settings = settings_of(self.name, DamiaoSettings, self.config.settings)
        self.declare(mode=settings.mode)
        dialect = str(self.variant.dialect)
        model = self.config.model or (dialect if dialect != SHARE else None)
        if model is not None and model not in MODELS:
            raise UnknownNameError(f"model of {self.name}", model, MODELS)
        filed = settings.ranges or (MODELS[model] if model is not None else None)
        #: As the robot's file says.
        self._filed = None if filed is None else whole(filed)
        spec = whole((1.0, 1.0, 1.0) if dialect == SHARE else MODELS[dialect])
        self._tried_at = -RETRY_NS
        self.declare_mit(spec, self._filed if self.host.passive else None)
        self.add_signal(
            "status", of="Feedback.status", to_si=str, doc="on, off, or its fault", source="MIT frame, byte 0"
        )
        for name, part, doc in (
            ("temperature", "mos", "of the transistors"),
            ("motor_temperature", "rotor", "of the windings"),
        ):
            of = f"Feedback.{part}_temperature"
            self.add_signal(name, unit="°C", of=of, doc=doc, source="MIT frame, bytes 6, 7")

    def read_ranges(self) -> Steps:
        """Yield steps that read PMAX, VMAX and TMAX. Raise `DeviceError` for ranges that are not positive."""
        found: list[float] = []
        for name in ("position_max", "velocity_max", "torque_max"):
            found.append((yield self.read(name)))
        if not all(0 < value < 1e6 for value in found):
            raise DeviceError(f"{self.name}: its ranges PMAX, VMAX, TMAX are {found}: they must be positive")
        ranges = whole((found[0], found[1], found[2]))
        if self._filed is not None and any(
            abs(actual - other) > 1e-3 * other for actual, other in zip(ranges, self._filed, strict=True)
        ):
            self.emit_event(
                "alarm",
                f"its ranges are {', '.join(f'{number:g}' for number in ranges[:3])}; the robot's file means"
                f" {', '.join(f'{number:g}' for number in self._filed[:3])}. The motor's count",
            )
        if ranges != self.ranges:
            self.know(ranges)

    def start(self) -> Job:
        """Read what its numbers mean; again when it comes later."""
        self._tried_at = self.clock.now()

        def steps(job: Job) -> Steps:
            try:
                yield from self.read_ranges()
            except AcesError:
                if self.last_received is not None:
                    raise

        return self.job("start", steps)

    def received(self, record: Record, instant: int) -> None:
        """Take from a feedback whether the motor is on."""
        if type(record).__name__ != "Feedback":
            return
        status = str(record.status)
        self.shows(status == "enabled", () if status in _WELL else (status,))
        if self.ranges is None and not self.host.passive and instant - self._tried_at > RETRY_NS:
            self.start()

    # ------------------------------------------------------------------ switching

    @property
    def timeout_s(self) -> float | None:
        """The time-out that `enable` sets (s); None: it leaves that as it is stored."""
        wait_s, rate = self.settings.timeout_s, self.host.rate_hz
        return max(WATCHDOG_S, 10 / rate) if wait_s is None and rate else wait_s

    @property
    def host_loss(self) -> HostLoss:
        """As declared, after its time-out."""
        loss, wait_s = self.when_host_is_lost, self.timeout_s
        if wait_s:
            return replace(loss, after_s=wait_s)
        does: Outcome = "unknown" if wait_s is None else "goes on"
        return replace(loss, does=does, after_s=None, detail="timeout_s sets a time-out")

    @property
    def fed_within_s(self) -> float | None:
        """Its time-out, which every command feeds."""
        return self.timeout_s or None

    def bring_up(self, job: Job) -> Steps:
        """Return its ranges, its mode, its time-out; then on."""
        job.text = "registers"
        yield from self.read_ranges()
        number = NUMBERS[self.mode]
        if (yield self.read("control_mode")) != number:
            yield self.write("control_mode", number, confirm=True)
        timeout_s = self.timeout_s
        if timeout_s is not None:
            yield self.write("timeout", round(timeout_s / TIMEOUT_UNIT_S), confirm=True)
        yield self.ask_state()
        job.progress, job.text = 0.8, "on"
        yield self.ask("Enable", reply="Feedback")

    def completed(self, message: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Return the speed on the way, and the share of the current, in modes that have them."""
        if message not in ("PositionVelocity", "ForcePosition"):
            return fields
        joint = self.joint
        speed = (joint.nominal_speed or joint.max_speed or USUAL_SPEED) if joint is not None else USUAL_SPEED
        more: dict[str, Any] = {"velocity_limit": abs(self.scale.raw_speed(speed))}
        if message == "ForcePosition":
            more = {
                "velocity_limit": min(100.0, more["velocity_limit"]),
                "current_limit": self.settings.current_limit,
            }
        return {**fields, **more}

    def switch_off(self) -> Ticket:
        """Switch off; the answer confirms it."""
        return self.send_now("Disable", reply="Feedback")

    def ask_state(self) -> Ticket:
        """Ask for a feedback."""
        return self.ask("AskFeedback", reply="Feedback", how=0)

    # ------------------------------------------------------------------ actions

    def clear_error(self) -> Ticket:
        """Clear the fault."""
        return self.ask("ClearError", reply="Feedback")

    def set_zero(self, confirm: bool) -> Job:
        """Make the present position the motor's 0, also after power-off. Fails while the motor is on."""
        if confirm is not True:
            raise CallerError(f"{self.name}: say confirm=True; its old zero is lost")

        def steps(job: Job) -> Steps:
            yield self.ask_state()
            self.check_off("zero can be set")
            yield self.ask("SetZero", reply="Feedback")
            self.epoch += 1

        return self.job("set zero", steps)

    def _register(self, register: str | int) -> tuple[int, str]:
        """Return its number, and whether it holds a float or an integer."""
        number = REGISTERS.get(register) if isinstance(register, str) else int(register)
        if number is None and isinstance(register, str) and register.isdigit():
            number = int(register)
        if number is None or number not in REGISTERS.values():
            raise UnknownNameError(f"register of {self.name}", str(register), REGISTERS)
        return number, "Integer" if number in INTEGERS else "Float"

    def read(self, register: str | int) -> Job:
        """Read a register: its value, in the motor's unit. Raises `UnknownNameError`."""
        number, kind = self._register(register)

        def steps(job: Job) -> Steps:
            answer = yield self.ask(f"Read{kind}", reply=f"Read{kind}Reply", register=number)
            return answer.value

        return self.job(f"read {register}", steps)

    def write(self, register: str | int, value: float, confirm: bool) -> Job:
        """Write a register, until the motor is switched off. Fails with `DeviceError` when it answers another value."""
        number, kind = self._register(register)
        if number in READ_ONLY:
            raise CallerError(f"{self.name}: register {register} can only be read")
        if confirm is not True:
            raise CallerError(f"{self.name}: say confirm=True; a register can change what all numbers mean")

        def steps(job: Job) -> Steps:
            given = float(value) if kind == "Float" else int(value)
            answer = yield self.ask(f"Write{kind}", reply=f"Write{kind}Reply", register=number, value=given)
            if abs(answer.value - given) > 1e-5 * abs(given):
                raise DeviceError(
                    f"{self.name}: register {register} was written {given}, and is {answer.value}"
                )

        return self.job(f"write {register}", steps)

    def registers(self) -> Job:
        """Read all registers that it answers: name → value."""

        def steps(job: Job) -> Steps:
            found: dict[str, FieldValue] = {}
            for index, name in enumerate(REGISTERS):
                job.progress, job.text = index / len(REGISTERS), name
                try:
                    found[name] = yield self.read(name)
                except AcesError:
                    if not found:
                        raise
            return found

        return self.job("registers", steps)

    def store(self, confirm: bool) -> Job:
        """Keep the registers for good. Fails while it is on."""
        if confirm is not True:
            raise CallerError(
                f"{self.name}: say confirm=True; what was written so far outlives power-off then"
            )

        def steps(job: Job) -> Steps:
            yield self.ask_state()
            self.check_off("registers can be stored")
            yield self.send("Store", how=1)

        return self.job("store", steps)


def _scan(name: str) -> Scan:
    """Ask numbers 1 to 15 for a feedback."""
    return scan_numbers(
        name,
        "DM",
        "motor",
        range(1, 16),
        "AskFeedback",
        reply="Feedback",
        timeout_s=0.05,
        retries=2,
        known=lambda feedback: {"settings": {"master": feedback.master} if feedback.master else {}},
        how=0,
    )


#: A joint a mode; two models, of which one says other ranges than its file.
EXAMPLE = """
name = "damiao"
rate_hz = 20

[buses]
arm = { link = "can", protocol = "damiao", bitrate = 1_000_000 }

[devices]
DM1 = { driver = "damiao", bus = "arm", credentials = { motor = 1 }, model = "4340", settings = { master = 0x11 } }
DM2 = { driver = "damiao", bus = "arm", credentials = { motor = 2 }, settings = { mode = "position_velocity" } }
DM3 = { driver = "damiao", bus = "arm", credentials = { motor = 3 }, model = "4310" }

[joints]
ELBOW = { device = "DM1", direction = -1, zero = 0.2, lower = -1.5, upper = 1.5, max_speed = 6, gains = { kp = 60, kd = 2 } }
WRIST = { device = "DM2", lower = -1, upper = 1, nominal_speed = 3 }
WHEEL = { device = "DM3", type = "continuous", command = "speed", max_speed = 20 }
"""

FD_EXAMPLE = EXAMPLE.replace('"damiao"', '"damiao_fd"')

driver = Driver(
    "damiao",
    device=Damiao,
    twin=DamiaoTwin,
    example=EXAMPLE,
    doc="Damiao DM motor: a joint with stiffness, damping and torque (MIT), or by position or velocity.",
    source="python-damiao-driver; DM_CAN.py; openarm_can; motorcontrol",
    scan=_scan("damiao"),
    settings=described(DamiaoSettings),
)

fd_driver = Driver(
    "damiao_fd",
    device=Damiao,
    twin=DamiaoTwin,
    speaks="damiao_fd",
    example=FD_EXAMPLE,
    doc="Damiao DM motor on CAN FD, as an OpenArm has them: a joint as `damiao` has it.",
    source="openarm_can; python-damiao-driver; DM_CAN.py; motorcontrol",
    scan=_scan("damiao_fd"),
    settings=described(DamiaoSettings),
)
