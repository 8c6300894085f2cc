"""The twin of an RMD motor: current, speed and position loops, a holding brake, a time-out.

1. Every request is answered by its own command; `Reset` and `SetBitrate` are not.
2. It begins with the brake closed and no loop. Speed and position open the brake, a current does not (V4.2 §2.19).
3. With an error no loop is closed, and what asks for motion is answered with the state as it is.
4. What is written "for good" outlives power-off; gains that are not stored do not.

`max_speed` of a position is not modelled, and a SetReport is not carried out. The dynamics are choices.
"""

from __future__ import annotations

import math
from random import Random
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.device.single_motor import JointScale
from aces_bus.protocol import Record
from aces_bus.runtime.clock import Timer
from aces_protocols.rmdx.spec import ERRORS, GAINS

from ..joint_model import AMBIENT, MotorModel, joint_of

#: At the output (rad/s, A, N·m/A): an RMD-X8 has about as much.
SPEED, STALL_A, TORQUE_CONSTANT = 20.0, 30.0, 2.0
#: What holds a position (N·m/rad) and a speed (N·m·s/rad); supply (V); counts of the encoder a turn: choices.
STIFFNESS, DAMPING, SUPPLY, COUNTS = 150.0, 5.0, 48.0, 65_536
MODEL, VERSION = "X8S2V10", 20_220_206
DEGREES = math.degrees(1.0)
REPORTED = ("stall", "low_voltage", "over_voltage", "over_current", "over_temperature")


def _int16(value: float) -> int:
    return max(-0x8000, min(0x7FFF, round(value)))


class RmdxTwin(Twin):
    """One motor. `kept` outlives power-off; `mode` is the loop that is closed, "" where none is."""

    protocol = "rmdx"
    faults: ClassVar = {name: f"reports {name}, and is off while it does" for name in REPORTED}
    reply_delay_ns = 100_000

    def setup(self) -> None:
        """Begin with the brake closed."""
        self.scale = JointScale.of(self.joints[0] if self.joints else None, DEGREES)
        if "kept" not in self.__dict__:
            self.kept: dict[str, Any] = {
                "timeout": 0, "offset": 0, "gains": dict.fromkeys(GAINS, 100), "accelerations": {},
            }  # fmt: skip
        self.gains: dict[str, float] = dict(self.kept["gains"])
        self.motor = joint_of(
            self,
            MotorModel(
                speed=SPEED / self.scale.ratio,
                stall_current=STALL_A,
                torque_constant=TORQUE_CONSTANT * self.scale.ratio,
            ),
        )
        self.mode, self.started = "", self.clock.now()
        self._watch: Timer | None = None
        self.lock(True)

    def draw(self, dice: Random, share: float = 1.0) -> None:
        """Turn it, within half a turn either way, and have it warm."""
        released, self.motor.jammed = self.motor.jammed, False
        self.motor.place(self.clock.now(), self.scale.angle(dice.uniform(-180.0, 180.0) * share))
        self.motor.jammed = released
        self.motor.temperature = AMBIENT + dice.uniform(0.0, 60.0) * share

    # ------------------------------------------------------------------ state

    @property
    def angle(self) -> float:
        """The angle of the output (°)."""
        return self.scale.raw_angle(self.motor.position(self.clock.now()))

    @property
    def count(self) -> int:
        """The encoder, from its zero."""
        return round(self.angle / 360 * COUNTS)

    @property
    def errors(self) -> list[str]:
        """The errors that it reports, by name."""
        return [name for name in ERRORS if name in self.active_faults]

    def lock(self, on: bool) -> None:
        """Close or open the brake; closed, it holds where it is."""
        self.motor.sync(self.clock.now())
        self.motor.jammed = on

    def go_off(self) -> None:
        """Close no loop."""
        self.mode = ""
        self.motor.free(self.clock.now())

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """See `Twin.fault`; with an error it is off."""
        super().fault(name, amount, on=on)
        if self.errors:
            self.go_off()

    def power(self, on: bool) -> None:
        """See `Twin.power`; without power the brake closes."""
        if not on:
            self.go_off()
            self.lock(True)
        super().power(on)

    def receive(self, record: Record, instant: int) -> None:
        """See `Twin.receive`; with each message the time-out begins anew."""
        super().receive(record, instant)
        if self._watch is not None:
            self._watch.cancel()
        wait = round(self.kept["timeout"] * 1e6)
        self._watch = self.clock.call_in(wait, self.lost) if wait else None

    def lost(self) -> None:
        """Switch off and close the brake: nothing came for too long (V4.2 §2.30)."""
        if self.is_powered:
            self.go_off()
            self.lock(True)

    def _close(self, mode: str) -> bool:
        """Close a loop, unless there is an error; speed and position open the brake."""
        if self.errors:
            return False
        self.mode = mode
        if mode != "current":
            self.lock(False)
        return True

    def _seek(self, angle: float) -> None:
        stiffness, damping = self.scale.gain(STIFFNESS), self.scale.gain(DAMPING)
        self.motor.impede(self.clock.now(), self.scale.angle(angle), 0.0, stiffness, damping, 0.0)

    # ------------------------------------------------------------------ motion

    def measured(self) -> dict[str, Any]:
        """Return temperature, current and speed, as an answer has them."""
        motor, scale = self.motor, self.scale
        motor.sync(self.clock.now())
        amperes = scale.direction * motor.current if self.mode else 0.0
        return {
            "temperature": max(-128, min(127, round(motor.temperature))),
            "current": max(-327.0, min(327.0, amperes)),
            "speed": _int16(scale.raw_speed(motor.v)),
        }

    def move(self, command: int) -> None:
        """Answer a command of motion."""
        self.reply("Motion", command=command, position=_int16(self.angle), **self.measured())

    @on("SetCurrent")
    def take_current(self, request: Record) -> None:
        """Drive the motor with a current."""
        if self._close("current"):
            self.motor.push(self.clock.now(), self.scale.direction * request.current)
        self.move(0xA1)

    @on("SetSpeed")
    def take_speed(self, request: Record) -> None:
        """Turn."""
        if self._close("speed"):
            damping = self.scale.gain(10 * DAMPING)
            self.motor.impede(self.clock.now(), 0.0, self.scale.speed(request.speed), 0.0, damping, 0.0)
        self.move(0xA2)

    @on("SetPosition")
    def take_position(self, request: Record) -> None:
        """Go to an angle."""
        if self._close("position"):
            self._seek(request.position)
        self.move(0xA4)

    @on("SetTurnPosition")
    def take_turn_position(self, request: Record) -> None:
        """Go to an angle within this turn, in a direction."""
        if self._close("position"):
            way = (request.position - self.angle) % 360
            self._seek(self.angle + (way if request.direction == "clockwise" else way - 360))
        self.reply("TurnMotion", encoder=self.count & 0xFFFF, **self.measured())

    @on("Increment")
    def take_increment(self, request: Record) -> None:
        """Go on by an angle."""
        if self._close("position"):
            self._seek(self.angle + request.position)
        self.move(0xA8)

    @on("ShutDown")
    def shut_down(self, request: Record) -> None:
        """Close no loop."""
        self.go_off()
        self.reply("ShutDownDone")

    @on("Stop")
    def stand_still(self, request: Record) -> None:
        """Hold where it is, if a loop is closed."""
        if self.mode:
            self.mode = "speed"
            self._seek(self.angle)
        self.reply("StopDone")

    @on("Run")
    def go_on(self, request: Record) -> None:
        """Answer; what was stopped needs a new command."""
        self.reply("RunDone")

    @on("ReleaseBrake")
    def release(self, request: Record) -> None:
        """Open the brake."""
        self.lock(False)
        self.reply("ReleaseBrakeDone")

    @on("LockBrake")
    def close_brake(self, request: Record) -> None:
        """Close the brake; the motor can no longer run."""
        self.go_off()
        self.lock(True)
        self.reply("LockBrakeDone")

    # ------------------------------------------------------------------ what it says

    @on("GetStatus1")
    def send_status(self, request: Record) -> None:
        """Send temperature, brake, supply and errors."""
        brake = "locked" if self.motor.jammed else "released"
        self.reply(
            "Status1",
            temperature=self.measured()["temperature"],
            brake=brake,
            voltage=SUPPLY,
            errors=self.errors,
        )

    @on("GetStatus2")
    def send_motion(self, request: Record) -> None:
        """Send current, speed and angle."""
        self.reply("Status2", position=_int16(self.angle), **self.measured())

    @on("GetStatus3")
    def send_phases(self, request: Record) -> None:
        """Send currents of the phases, which add up to 0."""
        found = self.measured()
        amperes, turn = found["current"], math.radians(self.angle)
        phases: dict[str, Any] = {
            name: amperes * math.cos(turn + number * math.tau / 3) for number, name in enumerate("abc")
        }
        self.reply("Status3", temperature=found["temperature"], **phases)

    @on("GetAngle")
    def send_angle(self, request: Record) -> None:
        """Send the angle."""
        self.reply("Angle", angle=self.angle)

    @on("GetTurnAngle")
    def send_turn_angle(self, request: Record) -> None:
        """Send the angle within a turn."""
        self.reply("TurnAngle", angle=round(self.angle * 100) % 36_000 / 100)

    @on("GetEncoder")
    def send_encoder(self, request: Record) -> None:
        """Send the encoder."""
        self.reply("Encoder", count=self.count)

    @on("GetRawEncoder")
    def send_raw_encoder(self, request: Record) -> None:
        """Send the encoder without its zero."""
        self.reply("RawEncoder", count=self.count + self.kept["offset"])

    @on("GetEncoderZero")
    def send_encoder_zero(self, request: Record) -> None:
        """Send the zero of the encoder."""
        self.reply("EncoderZero", count=self.kept["offset"])

    @on("GetTurnEncoder")
    def send_turn_encoder(self, request: Record) -> None:
        """Send the encoder within a turn."""
        count, offset = self.count, self.kept["offset"]
        self.reply("TurnEncoder", count=count & 0xFFFF, raw=count + offset & 0xFFFF, offset=offset & 0xFFFF)

    @on("GetMode")
    def send_mode(self, request: Record) -> None:
        """Send the loop that is closed; 0, a choice, where none is."""
        self.reply("Mode", mode=self.mode or 0)

    @on("GetPower")
    def send_power(self, request: Record) -> None:
        """Send the power."""
        self.reply("Power", power=abs(self.measured()["current"]) * SUPPLY)

    @on("GetRunTime")
    def send_run_time(self, request: Record) -> None:
        """Send how long it has run (ms)."""
        self.reply("RunTime", time=(self.clock.now() - self.started) // 1_000_000 & 0xFFFF_FFFF)

    @on("GetVersion")
    def send_version(self, request: Record) -> None:
        """Send the date of its software."""
        self.reply("Version", date=VERSION)

    @on("GetModel")
    def send_model(self, request: Record) -> None:
        """Send its model."""
        self.reply("Model", model=MODEL)

    # ------------------------------------------------------------------ settings

    @on("GetAcceleration")
    def send_acceleration(self, request: Record) -> None:
        """Send an acceleration; 10,000 °/s² from the factory, a choice."""
        kept = self.kept["accelerations"].get(str(request.kind), 10_000)
        self.reply("Acceleration", kind=request.kind, acceleration=kept)

    @on("SetAcceleration")
    def take_acceleration(self, request: Record) -> None:
        """Keep an acceleration."""
        self.kept["accelerations"][str(request.kind)] = request.acceleration
        self.reply("SetAccelerationDone", kind=request.kind, acceleration=request.acceleration)

    @on("GetGain")
    def send_gain(self, request: Record) -> None:
        """Send a gain (V4)."""
        self.reply("Gain", gain=request.gain, value=float(self.gains.get(str(request.gain), 0.0)))

    @on("SetGain", "StoreGain")
    def take_gain(self, request: Record) -> None:
        """Take a gain (V4)."""
        self._take({str(request.gain): request.value}, request)
        self.reply(f"{type(request).__name__}Done", gain=request.gain, value=request.value)

    @on("GetGains")
    def send_gains(self, request: Record) -> None:
        """Send the six gains (V3)."""
        self.reply("Gains", **self._six())

    @on("SetGains", "StoreGains")
    def take_gains(self, request: Record) -> None:
        """Take the six gains (V3)."""
        self._take({name: getattr(request, name) for name in self._six()}, request)
        self.reply(f"{type(request).__name__}Done", **self._six())

    def _take(self, gains: dict[str, float], request: Record) -> None:
        self.gains |= gains
        if type(request).__name__.startswith("Store"):
            self.kept["gains"] = dict(self.gains)

    def _six(self) -> dict[str, int]:
        return {name: round(self.gains[name]) & 0xFF for name in GAINS if name != "position_kd"}

    @on("SetEncoderZero")
    def take_zero(self, request: Record) -> None:
        """Keep another zero of the encoder."""
        self.kept["offset"] = request.count
        self.reply("SetEncoderZeroDone", count=request.count)

    @on("ZeroHere")
    def zero_here(self, request: Record) -> None:
        """Keep the present angle as its zero; its angles begin there after a reset, which this twin leaves out."""
        self.kept["offset"] += self.count
        self.reply("ZeroHereDone", count=self.kept["offset"])

    @on("Reset")
    def reset(self, request: Record) -> None:
        """Boot anew."""
        self.go_off()
        self.gains = dict(self.kept["gains"])
        self.started = self.clock.now()

    @on("SetTimeout")
    def take_timeout(self, request: Record) -> None:
        """Keep a time-out."""
        self.kept["timeout"] = request.timeout
        self.reply("SetTimeoutDone", timeout=request.timeout)

    @on("Function")
    def take_function(self, request: Record) -> None:
        """Answer; another identifier is taken at once, the others are not modelled."""
        self.reply("FunctionDone", function=request.function, value=request.value)
        if request.function == "set_id" and 1 <= request.value <= 32:
            self.twins.renumber(self, id=request.value)
