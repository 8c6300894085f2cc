"""The twin of a CyberGear or RobStride motor: the MIT law, three other run modes, parameters, faults.

1. Every command, Enable, Stop, SetZero and write is answered by a feedback to the host that sent it; a Command names no
   host, and is answered to the last one that did.
2. The run mode changes while it is stopped only (instructionmanual.md); zero is lost at power-off.
3. In state run, without a message for longer than can_timeout (units of 50 µs; 0: for ever), it is off (RobStride manuals).
4. Models without ranges of their own have those of `ranges` in the robot's file, else an RS02's.
"""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import ClassVar

from aces_bus.device import Twin, on
from aces_bus.device.single_motor import JointScale
from aces_bus.protocol import Record
from aces_bus.runtime.clock import Timer
from aces_protocols.robstride.spec import BYTES, DIALECTS, FAMILY, KINDS, MODELS, READ_ONLY

from ..joint_model import AMBIENT, JAM, MotorModel, jam, joint_of

#: What position mode holds with (N·m/rad), speed mode (N·m·s/rad), and N·m an A: choices.
STIFFNESS, DAMPING, TORQUE_CONSTANT = 120.0, 4.0, 1.2
VOLTAGE = 24.0
#: The unit of can_timeout (ns).
TIMEOUT_UNIT_NS = 50_000
_KIND = {name: kind for kind, (names, _) in KINDS.items() for name in names}
_FAULTS = ("under_voltage", "over_current", "over_temperature", "magnetic_encoder", "uncalibrated")


class RobstrideMotor(Twin):
    """What the twins of both protocols have: a motor with a zero, on or off, with faults that switch it off.

    `spec` has what the spec's numbers are at full scale, `ranges` what those of the motor are; `choose_ranges` sets both.
    """

    faults: ClassVar = JAM | {name: f"reports {name}, and is off until it is cleared" for name in _FAULTS}
    reply_delay_ns = 30_000
    spec: Sequence[float]
    ranges: Sequence[float]

    def choose_ranges(self) -> None:
        """Set `spec` and `ranges`, as dialect, model and settings say."""
        raise NotImplementedError

    def setup(self) -> None:
        """Begin stopped, with the motor's own zero."""
        self.choose_ranges()
        self.scale = JointScale.of(self.joints[0] if self.joints else None)
        speed, torque = self.ranges[1] / self.scale.ratio, self.ranges[2] * self.scale.ratio
        self.motor = joint_of(
            self,
            MotorModel(speed=speed, stall_current=torque / TORQUE_CONSTANT, torque_constant=TORQUE_CONSTANT),
        )
        self.state, self.offset = "reset", 0.0
        self.failed: frozenset[str] = frozenset()

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """See `Twin.fault`."""
        super().fault(name, amount, on=on)
        jam(self, self.motor)

    def draw(self, dice: Random, share: float = 1.0) -> None:
        """Turn it to an angle of its whole range, and have it warm."""
        angle = dice.uniform(-1.0, 1.0) * share * self.ranges[0]
        self.motor.place(self.clock.now(), self.scale.angle(angle - self.offset))
        self.motor.temperature = AMBIENT + dice.uniform(0.0, 100.0) * share

    @property
    def angle(self) -> float:
        """Position of the motor (rad)."""
        return self.scale.raw_angle(self.motor.position(self.clock.now())) + self.offset

    def measured(self) -> list[float]:
        """Return position, velocity and torque in the numbers of the spec, limited to its ranges."""
        angle, scale, motor = self.angle, self.scale, self.motor
        raw = (angle, scale.raw_speed(motor.v), scale.raw_torque(motor.torque))
        return [
            max(-unit, min(unit, value / whole * unit))
            for value, whole, unit in zip(raw, self.ranges, self.spec, strict=False)
        ]

    def new_faults(self) -> frozenset[str]:
        """Switch off at faults that are new, and return them."""
        new = frozenset(fault for fault in _FAULTS if fault in self.active_faults) - self.failed
        if new:
            self.failed |= new
            self.go_off()
        return new

    def go_off(self) -> None:
        """Give way."""
        self.state = "reset"
        self.motor.free(self.clock.now())

    def power(self, on: bool) -> None:
        """See `Twin.power`."""
        if not on:
            self.go_off()
        super().power(on)

    def impede(self, request: Record) -> None:
        """Apply the MIT law of a command."""
        position, velocity, torque, kp, kd = (
            getattr(request, name) * whole / unit
            for name, whole, unit in zip(
                ("position", "velocity", "torque", "kp", "kd"), self.ranges, self.spec, strict=True
            )
        )
        scale = self.scale
        goal, speed = scale.angle(position - self.offset), scale.speed(velocity)
        self.motor.impede(self.clock.now(), goal, speed, scale.gain(kp), scale.gain(kd), scale.torque(torque))

    def go_to(self, angle: float) -> None:
        """Hold an angle of the motor (rad)."""
        scale = self.scale
        goal = scale.angle(angle - self.offset)
        self.motor.impede(self.clock.now(), goal, 0.0, scale.gain(STIFFNESS), scale.gain(DAMPING), 0.0)

    def turn(self, speed: float) -> None:
        """Turn so fast (rad/s at the motor)."""
        scale = self.scale
        self.motor.impede(self.clock.now(), 0.0, scale.speed(speed), 0.0, scale.gain(DAMPING), 0.0)


class RobstrideTwin(RobstrideMotor):
    """One motor on the private protocol. `parameters` by name; `state` is reset or run."""

    protocol = "robstride"

    def choose_ranges(self) -> None:
        """See `RobstrideMotor.choose_ranges`."""
        dialect = str(self.variant.dialect)
        self.spec = DIALECTS[dialect]
        model = "CyberGear" if dialect == FAMILY else dialect
        self.ranges = self.config.settings.get("ranges") or MODELS.get(
            self.config.model or model, MODELS["RS02"]
        )

    def setup(self) -> None:
        """Begin stopped, in run mode motion."""
        super().setup()
        self.host = 0xFD
        self.parameters: dict[str, float] = dict.fromkeys(_KIND, 0.0)
        self._watch: Timer | None = None

    # ------------------------------------------------------------------ what it says

    def look(self) -> None:
        """Switch off at a new fault, and report it."""
        new = self.new_faults()
        if new:
            bits = [fault for fault in new if fault in ("under_voltage", "uncalibrated")]
            self.reply("FaultReport", host=self.host, faults=bits, warnings=[])

    def feedback(self, request: Record | None = None) -> None:
        """Send position, velocity, torque, temperature; state and faults."""
        self.host = getattr(request, "host", self.host)
        self.look()
        shares = self.measured()
        fields = self.variant["Feedback"].fields
        faults = {
            name: int(name in self.failed) for name in (*_FAULTS, "hall_encoder", "stalled") if name in fields
        }
        self.reply(
            "Feedback", host=self.host, state=self.state, position=shares[0], velocity=shares[1], torque=shares[2],
            temperature=self.motor.temperature, **faults,
        )  # fmt: skip

    @on("GetId")
    def identify(self, request: Record) -> None:
        """Answer with its unique id."""
        self.reply("Id", unique_id=0x1122334455667700 | self.credentials["motor"])

    @on("SetId")
    def renumber(self, request: Record) -> None:
        """Take another number."""
        self.twins.renumber(self, motor=request.new_motor)
        self.identify(request)

    # ------------------------------------------------------------------ its time-out

    def receive(self, record: Record, instant: int) -> None:
        """See `Twin.receive`; with each message the time-out begins anew."""
        super().receive(record, instant)
        if self._watch is not None:
            self._watch.cancel()
        wait = round(self.parameters["can_timeout"] * TIMEOUT_UNIT_NS)
        self._watch = self.clock.call_in(wait, self.lost) if wait and self.state == "run" else None

    def lost(self) -> None:
        """Go off: no message came for too long."""
        if self.is_powered and self.state == "run":
            self.go_off()

    # ------------------------------------------------------------------ switching

    @on("Enable")
    def enable(self, request: Record) -> None:
        """Switch on, without torque, unless there is a fault."""
        self.look()
        if not self.failed and self.state != "run":
            self.state = "run"
            for name in ("loc_ref", "spd_ref", "iq_ref"):
                self.parameters[name] = self.angle if name == "loc_ref" else 0.0
            self.motor.impede(self.clock.now(), 0.0, 0.0, 0.0, 0.0, 0.0)
            self.drive()
        self.feedback(request)

    @on("Stop")
    def halt(self, request: Record) -> None:
        """Switch off; with clear 1 clear faults."""
        self.go_off()
        if request.clear == 1:
            self.failed = frozenset()
        self.feedback(request)

    @on("SetZero")
    def zero(self, request: Record) -> None:
        """Make here 0."""
        self.offset -= self.angle
        self.feedback(request)

    @on("Command")
    def command(self, request: Record) -> None:
        """Apply the MIT law, in run mode motion."""
        if self.state == "run" and self.parameters["run_mode"] == 0:
            self.impede(request)
        self.feedback()

    def drive(self) -> None:
        """Do what the parameters of the run mode say."""
        now, scale, given = self.clock.now(), self.scale, self.parameters
        match given["run_mode"]:
            case 1:
                self.go_to(given["loc_ref"])
            case 2:
                self.turn(given["spd_ref"])
            case 3:
                self.motor.impede(
                    now, 0.0, 0.0, 0.0, 0.0, scale.direction * given["iq_ref"] * TORQUE_CONSTANT
                )
            case _:
                pass

    # ------------------------------------------------------------------ parameters

    def value(self, name: str) -> float:
        """Return a parameter, measured where it is."""
        motor, scale = self.motor, self.scale
        motor.sync(self.clock.now())
        match name:
            case "mech_pos":
                return self.angle
            case "mech_vel":
                return scale.raw_speed(motor.v)
            case "iqf":
                return scale.direction * motor.current
            case "vbus":
                return VOLTAGE
            case _:
                return self.parameters[name]

    @on("ReadParameter")
    def read(self, request: Record) -> None:
        """Answer with a parameter; an unknown parameter is an error."""
        name = request.index
        kind = _KIND.get(name)
        if kind is None:
            return
        value = self.value(name)
        self.reply(
            f"{kind}Parameter",
            host=request.host,
            status="ok",
            index=name,
            value=value if kind == "Float" else int(value),
        )

    @on("WriteFloat", "WriteByte", "WriteShort", "WriteLong")
    def write(self, request: Record) -> None:
        """Take it; the run mode while it is stopped only."""
        name = request.index
        is_late = name in BYTES and self.state == "run"
        if name in self.parameters and name not in READ_ONLY and not is_late:
            self.parameters[name] = request.value
            if self.state == "run":
                self.drive()
        self.feedback(request)
