"""The twin of a Damiao motor: MIT's law and three other modes, registers, faults, its time-out.

1. Every command of the mode in `control_mode` is answered by a feedback; commands of other modes are ignored
   (python-damiao-driver, motor-control-modes).
2. Registers are kept until the motor is switched off, or for good by Store. A new zero is kept for good at once.
3. Without a command for longer than `timeout` (units of 50 µs; 0: for ever) the motor goes off: lost_communication.
"""

from __future__ import annotations

import math
from random import Random
from typing import ClassVar

from aces_bus.device import Twin, on
from aces_bus.device.single_motor import JointScale
from aces_bus.protocol import Record
from aces_bus.runtime.clock import Timer
from aces_protocols.damiao.spec import INTEGERS, MODELS, READ_ONLY, REGISTERS, SHARE, Master

from ..joint_model import AMBIENT, JAM, MotorModel, jam, joint_of

#: The motor's ranges where the robot's file has no model: those of a 4310.
USUAL = MODELS["4310"]
#: What position modes hold with (N·m/rad), and velocity modes (N·m·s/rad): choices.
STIFFNESS, DAMPING = 80.0, 2.0
#: Numbers of the registers that the twin itself reads.
_MASTER, _CAN_ID = REGISTERS["master_id"], REGISTERS["can_id"]
_TIMEOUT, _MODE, _BAUD_CODE = REGISTERS["timeout"], REGISTERS["control_mode"], REGISTERS["baud_code"]
#: Those of position, velocity and torque at the ends of their ranges, in this order.
_RANGES = tuple(REGISTERS[name] for name in ("position_max", "velocity_max", "torque_max"))
_ANGLES = (REGISTERS["motor_position"], REGISTERS["output_position"])
#: Unit of `timeout` (ns), and the baud code of 1 Mbit/s.
_TIMEOUT_NS, _1_MBIT = 50_000, 4
_MODES = {1: "Command", 2: "PositionVelocity", 3: "Velocity", 4: "ForcePosition"}
_FAULTS = (
    "over_voltage",
    "under_voltage",
    "over_current",
    "mos_over_temperature",
    "rotor_over_temperature",
    "overload",
)


class DamiaoTwin(Twin):
    """One motor. `registers` holds its registers by number, `status` what its feedbacks say."""

    protocol = "damiao"
    faults: ClassVar = JAM | {
        name: f"status {name}: it is off, and stays so until the error is cleared" for name in _FAULTS
    }
    reply_delay_ns = 30_000
    stored: dict[int, float] | None = None
    #: What is added to the motor's angle, as zero was set (rad).
    offset = 0.0

    def setup(self) -> None:
        """Begin disabled, at the joint's place, with the stored registers or those of a new motor."""
        dialect = str(self.variant.dialect)
        self._spec = (1.0, 1.0, 1.0) if dialect == SHARE else MODELS[dialect]
        if self.stored is None:
            self.stored = self._new_registers()
        self.registers = dict(self.stored)
        self.scale = JointScale.of(self.joints[0] if self.joints else None)
        _, most_speed, most_torque = (self.registers[number] for number in _RANGES)
        model = MotorModel(
            speed=most_speed / self.scale.ratio,
            stall_current=10.0,
            torque_constant=most_torque * self.scale.ratio / 10.0,
        )
        self.motor = joint_of(self, model)
        self.status = "disabled"
        self._watch: Timer | None = None

    def _new_registers(self) -> dict[int, float]:
        """Return the registers of a motor that was never configured, with the ranges of its model."""
        settings = self.config.settings
        ranges = settings.get("ranges") or MODELS.get(self.config.model or "", USUAL)
        return {
            **dict.fromkeys(REGISTERS.values(), 0.0),
            _MASTER: settings.get("master", 0),
            _CAN_ID: self.credentials["motor"],
            _MODE: 1,
            _BAUD_CODE: _1_MBIT,
            **dict(zip(_RANGES, ranges, strict=True)),
        }

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """See `Twin.fault`."""
        super().fault(name, amount, on=on)
        jam(self, self.motor)

    def draw(self, dice: Random, share: float = 1.0) -> None:
        """Draw an angle within the motor's range, and a temperature."""
        angle = dice.uniform(-1.0, 1.0) * share * self.registers[_RANGES[0]]
        self.motor.place(self.clock.now(), self.scale.angle(angle - self.offset))
        self.motor.temperature = AMBIENT + dice.uniform(0.0, 100.0) * share

    # ------------------------------------------------------------------ what it says

    @property
    def angle(self) -> float:
        """Position of the motor (rad)."""
        return self.scale.raw_angle(self.motor.position(self.clock.now())) + self.offset

    def feedback(self) -> None:
        """Send position, velocity and torque (limited to the ranges), temperatures and status."""
        for fault in _FAULTS:
            if fault in self.active_faults:
                self.go_off(fault)
        angle, scale, motor = self.angle, self.scale, self.motor
        measured = (angle, scale.raw_speed(motor.v), scale.raw_torque(motor.torque))
        shares = [
            max(-unit, min(unit, value / self.registers[number] * unit))
            for number, value, unit in zip(_RANGES, measured, self._spec, strict=True)
        ]
        self.reply(
            "Feedback", master=int(self.registers[_MASTER]), status=self.status, position=shares[0], velocity=shares[1],
            torque=shares[2], mos_temperature=round(AMBIENT), rotor_temperature=min(255, round(motor.temperature)),
        )  # fmt: skip

    # ------------------------------------------------------------------ switching

    def go_off(self, status: str = "disabled") -> None:
        """Switch the motor off, with this status: it gives way."""
        self.status = status
        self.motor.free(self.clock.now())
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None

    @on("Enable")
    def enable(self, request: Record) -> None:
        """Switch on without torque, unless there is a fault."""
        if self.status == "disabled":
            self.status = "enabled"
            self.motor.impede(self.clock.now(), 0.0, 0.0, 0.0, 0.0, 0.0)
            self.watch_over()
        self.feedback()

    @on("Disable")
    def disable(self, request: Record) -> None:
        """Switch off; keep a fault."""
        if self.status == "enabled":
            self.go_off()
        self.feedback()

    @on("ClearError")
    def clear(self, request: Record) -> None:
        """Switch off and clear the fault."""
        self.go_off()
        self.feedback()

    @on("SetZero")
    def zero(self, request: Record) -> None:
        """Make here 0."""
        self.offset -= self.angle
        self.feedback()

    @on("AskFeedback")
    def asked(self, request: Record) -> None:
        """Answer with a feedback."""
        self.feedback()

    def watch_over(self) -> None:
        """Restart the time-out: a command has come."""
        if self._watch is not None:
            self._watch.cancel()
        wait = round(self.registers[_TIMEOUT] * _TIMEOUT_NS)
        self._watch = self.clock.call_in(wait, self.lost) if wait else None

    def lost(self) -> None:
        """Go off: no command came for too long."""
        if self.is_powered and self.status == "enabled":
            self.go_off("lost_communication")

    def power(self, on: bool) -> None:
        """See `Twin.power`."""
        if not on:
            self.go_off()
        super().power(on)

    # ------------------------------------------------------------------ commands

    def received(self, record: Record, instant: int) -> None:
        """Carry out a command of the present mode; ignore commands of others."""
        if type(record).__name__ != _MODES[int(self.registers[_MODE])]:
            return
        if self.status == "enabled":
            self.watch_over()
            self.drive(record, instant)
        self.feedback()

    def drive(self, record: Record, now: int) -> None:
        """Carry a command out."""
        scale, motor = self.scale, self.motor
        match type(record).__name__:
            case "Command":
                raw = [
                    getattr(record, name) * self.registers[number] / unit
                    for name, number, unit in zip(
                        ("position", "velocity", "torque"), _RANGES, self._spec, strict=True
                    )
                ]
                goal, speed, torque = (
                    scale.angle(raw[0] - self.offset),
                    scale.speed(raw[1]),
                    scale.torque(raw[2]),
                )
                motor.impede(now, goal, speed, scale.gain(record.kp), scale.gain(record.kd), torque)
            case "Velocity":
                motor.impede(now, 0.0, scale.speed(record.velocity), 0.0, scale.gain(DAMPING), 0.0)
            case _:
                goal = scale.angle(record.position - self.offset)
                motor.impede(now, goal, 0.0, scale.gain(STIFFNESS), scale.gain(DAMPING), 0.0)

    # ------------------------------------------------------------------ registers

    @on("ReadFloat", "ReadInteger")
    def read(self, request: Record) -> None:
        """Answer with the value of a register; registers that the motor does not have are not answered."""
        self.answer(request, "Read")

    @on("WriteFloat", "WriteInteger")
    def write(self, request: Record) -> None:
        """Take a valid value for a writable register; answer with the register's value."""
        number = REGISTERS.get(request.register)
        if number is not None and number not in READ_ONLY and self._can_be(number, request.value):
            self.registers[number] = request.value
        self.answer(request, "Write")

    def _can_be(self, number: int, value: float) -> bool:
        """Return whether a value is valid: an existing mode, an identifier that answers can have, a number that fits."""
        if number == _MODE:
            return value in _MODES
        if number == _MASTER:
            return value in Master.values
        return number not in INTEGERS or (math.isfinite(value) and 0 <= value < 1 << 32)

    def answer(self, request: Record, verb: str) -> None:
        """Answer a request with its register."""
        number = REGISTERS.get(request.register)
        if number is None:
            return
        value = self.angle if number in _ANGLES else self.registers[number]
        kind, value = ("Integer", int(value)) if number in INTEGERS else ("Float", float(value))
        self.reply(f"{verb}{kind}Reply", master=int(self.registers[_MASTER]), register=number, value=value)

    @on("Store")
    def store(self, request: Record) -> None:
        """Keep the registers; while it is off."""
        if self.status != "enabled":
            self.stored = dict(self.registers)
