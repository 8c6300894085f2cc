"""The twin of a RoboClaw: two motors with encoders, settings that are read back, a serial time-out.

1. What is written is acknowledged and kept; what is asked is answered from what was kept or measured.
2. A motor has its speed at once, and stands at its position: there is no inertia, and gains and errors change nothing.
   Voltages, temperature, currents and full speed are choices.
3. Buffered commands are carried out at once, the last one counts.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

from aces_bus.device import Twin
from aces_bus.protocol import Record
from aces_bus.runtime.clock import Timer
from aces_protocols.roboclaw.spec import FULL_DUTY

from ..wheel_model import SteadyShaft

#: A choice: the speed at full duty (counts/s), as the factory's `full_speed` (manual, page 90).
FULL_SPEED = 44_000
#: Choices: V, V, °C, A at full duty.
MAIN, LOGIC, WARMTH, FULL_CURRENT = 24.0, 5.0, 25.1, 2.0
VERSION = "USB Roboclaw 2x7a v4.2.4"
SPEED_GAINS = {"p": 1.0, "i": 0.5, "d": 0.25, "full_speed": FULL_SPEED}
POSITION_GAINS = {
    "p": 0.0, "i": 0.0, "d": 0.0, "most_integral": 0, "deadzone": 0, "lowest": 0, "highest": 0,
}  # fmt: skip
#: What is read before it was written.
FACTORY: dict[str, dict[str, Any]] = {
    "SerialTimeout": {"timeout": 0.0},
    "MainVoltageLimits": {"lowest": 6.0, "highest": 34.0},
    "LogicVoltageLimits": {"lowest": 6.0, "highest": 34.0},
    "DefaultSpeeds": {"m1": 1.0, "m2": 1.0},
    "Deadband": {"backward": 2.5, "forward": 2.5},
    "DutyAccelerations": {"m1": 0, "m2": 0},
    "EncoderModes": {"m1": [], "m2": []},
    "SpeedErrorLimits": {"m1": 0, "m2": 0},
    "PositionErrorLimits": {"m1": 0, "m2": 0},
    **{
        f"{name}M{motor}": dict(values)
        for motor in (1, 2)
        for name, values in (
            ("SpeedGains", SPEED_GAINS),
            ("PositionGains", POSITION_GAINS),
            ("CurrentLimit", {"highest": 15.0, "lowest": 0.0}),
        )
    },
}
#: What is written for one motor, and read for both: the answer and the field.
_OF_BOTH = {
    "SetDutyAcceleration": ("DutyAccelerations", "acceleration"),
    "SetDefaultSpeed": ("DefaultSpeeds", "speed"),
    "SetEncoderMode": ("EncoderModes", "mode"),
}


class _Joint:
    """A motor as the robot's joint (rad)."""

    def __init__(self, twin: RoboclawTwin, motor: int, scale: tuple[int, float, float]) -> None:
        self._twin, self._motor, self._scale = twin, motor, scale

    def position(self, now: int) -> float:
        """Return where the joint is (rad)."""
        direction, zero, per_rad = self._scale
        return direction * (self._twin.shafts[self._motor].position(now) / per_rad - zero) + 0.0


class RoboclawTwin(Twin):
    """One controller. `kept` are its settings, `shafts` its motors (by 1 and 2, in counts)."""

    protocol = "roboclaw"
    faults: ClassVar = {
        "e_stop": "reports an emergency stop, and drives nothing",
        "hot": "reports that its board is too hot, and drives nothing",
    }

    def setup(self) -> None:
        """Begin at rest; settings are those of the factory, or as they were left."""
        if "kept" not in self.__dict__:
            self.kept = {name: dict(values) for name, values in FACTORY.items()}
            self.shafts = {1: SteadyShaft(), 2: SteadyShaft()}
            for joint in self.joints:
                motor = joint.channel + 1
                per_rad = (joint.ratio or 1.0) * (joint.encoder or math.tau) / math.tau
                scale = (joint.direction, joint.zero or 0.0, per_rad)
                start = self.world.start_of(joint.name, 0.0)
                self.shafts[motor].at = (joint.direction * start + scale[1]) * per_rad
                self.world.joints[joint.name] = _Joint(self, motor, scale)
        #: By motor: the duty that it is driven with; None: it turns with a speed, or to a position.
        self.duty: dict[int, float | None] = {1: 0.0, 2: 0.0}
        self.received_at = self.clock.now()
        self._watch: Timer | None = None
        self._stop_both()

    # ------------------------------------------------------------------ motion

    @property
    def _errors(self) -> list[str]:
        names = {"e_stop": "e_stop", "hot": "temperature"}
        return [name for fault, name in names.items() if fault in self.active_faults]

    def _drive(self, motor: int, *, duty: float | None = None, speed: float = 0.0) -> None:
        """Turn a motor with a duty, or with a speed (counts/s)."""
        shaft = self.shafts[motor]
        shaft.settle(self.clock.now())
        self.duty[motor] = duty
        shaft.limit = FULL_SPEED
        shaft.speed = speed if duty is None else duty * FULL_SPEED
        shaft.is_driven = not self._errors

    def _go(self, motor: int, position: float, speed: float) -> None:
        """Turn a motor to a position (counts), with a speed, and hold it."""
        shaft = self.shafts[motor]
        shaft.settle(self.clock.now())
        self.duty[motor], shaft.speed = None, None
        shaft.goal, shaft.limit = position, min(abs(speed) or FULL_SPEED, FULL_SPEED)
        shaft.is_driven = not self._errors

    def _stop_both(self) -> None:
        for motor in (1, 2):
            self._drive(motor, duty=0.0)

    def _duty_of(self, motor: int) -> float:
        duty = self.duty[motor]
        if duty is None:
            duty = self.shafts[motor].wanted_at(self.clock.now()) / FULL_SPEED
        return 0.0 if self._errors else max(-1.0, min(1.0, duty))

    # ------------------------------------------------------------------ the serial time-out

    def receive(self, record: Record, instant: int) -> None:
        """Take a packet to this controller; it feeds the time-out."""
        if self.is_powered:
            self.received_at = instant
            if self._errors:
                self._stop_both()
            self._watch_over()
        super().receive(record, instant)

    def _watch_over(self) -> None:
        wait_ns = round(self.kept["SerialTimeout"]["timeout"] * 1e9)
        if self._watch is None and wait_ns:
            self._watch = self.clock.call_at(self.received_at + wait_ns, self._is_late)

    def _is_late(self) -> None:
        self._watch = None
        wait_ns = round(self.kept["SerialTimeout"]["timeout"] * 1e9)
        if not self.is_powered or not wait_ns:
            return
        if self.clock.now() - self.received_at >= wait_ns:
            self._stop_both()
        else:
            self._watch_over()

    def power(self, on: bool) -> None:
        """See `Twin.power`; without power the motors stand."""
        if not on:
            self._stop_both()
        super().power(on)

    def stop(self) -> None:
        """End what repeats."""
        if self._watch is not None:
            self._watch.cancel()
        super().stop()

    # ------------------------------------------------------------------ requests

    def received(self, record: Record, instant: int) -> None:
        """Answer a question, or carry out what is written and acknowledge it."""
        name = type(record).__name__
        if name.startswith("Get"):
            self.reply(name[3:], **self._answer(name[3:]))
            return
        self._write(name, record)
        self.reply("Done")
        self._watch_over()

    def _answer(self, name: str) -> dict[str, Any]:
        now = self.clock.now()
        if name in self.kept:
            return self.kept[name]
        kind, _, motor = name.partition("M") if name[-2:] in ("M1", "M2") else (name, "", "")
        places = {motor: _counted(shaft.position(now)) for motor, shaft in self.shafts.items()}
        speeds = {motor: round(shaft.wanted_at(now)) for motor, shaft in self.shafts.items()}
        duties = {motor: self._duty_of(motor) for motor in self.shafts}
        if motor:
            one = int(motor)
            backward = speeds[one] < 0
            if kind == "Encoder":
                return {"position": places[one], "status": ["backward"] if backward else []}
            return {"speed": speeds[one], "backward": int(backward)}
        both: dict[str, dict[int, Any]] = {
            "Encoders": places,
            "RawSpeeds": speeds,
            "MeanSpeeds": speeds,
            "Duties": {motor: round(duty * FULL_DUTY) / FULL_DUTY for motor, duty in duties.items()},
            "Currents": {motor: round(FULL_CURRENT * duty, 2) for motor, duty in duties.items()},
            "Buffers": {1: 0x80, 2: 0x80},
            "SpeedErrors": {1: 0, 2: 0},
            "PositionErrors": {1: 0, 2: 0},
        }
        if name in both:
            return {f"m{motor}": value for motor, value in both[name].items()}
        single: dict[str, dict[str, Any]] = {
            "Version": {"version": VERSION},
            "MainVoltage": {"voltage": MAIN},
            "LogicVoltage": {"voltage": LOGIC},
            "Temperature": {"temperature": WARMTH},
            "Temperature2": {"temperature": WARMTH},
            "Status": {"status": self._errors},
        }
        return single[name]

    def _write(self, name: str, record: Any) -> None:
        motor = int(name[-1]) if name[-2:] in ("M1", "M2") else 0
        kind = name[:-2] if motor else name
        fields = {
            field: getattr(record, field) for field in type(record).__struct_fields__ if field[0] != "_"
        }
        if kind in _OF_BOTH:
            answer, field = _OF_BOTH[kind]
            self.kept[answer][f"m{motor}"] = fields[field]
        elif kind == "SetEncoder":
            self._place(motor, fields["position"])
        elif name == "ResetEncoders":
            for motor in self.shafts:
                self._place(motor, 0)
        elif name[:3] == "Set" and name[3:] in self.kept:
            self.kept[name[3:]] |= {key: fields[key] for key in self.kept[name[3:]] if key in fields}
        else:
            self._move(kind, motor, fields)

    def _place(self, motor: int, count: int) -> None:
        shaft = self.shafts[motor]
        shaft.settle(self.clock.now())
        shaft.at = shaft.goal = float(count)

    def _move(self, kind: str, motor: int, fields: dict[str, Any]) -> None:
        """Carry out a command of motion."""
        if kind.startswith(("Forward", "Backward")):
            self._drive(motor, duty=(1 if kind[0] == "F" else -1) * fields["speed"] / 127)
        elif kind == "BothWays":
            self._drive(motor, duty=(fields["speed"] - 64) / 64)
        elif kind.startswith("Mixed"):
            self._mix(kind[5:], fields["speed"])
        else:
            for number in (motor,) if motor else (1, 2):
                self._move_one(number, _of_motor(kind, fields, number))

    def _move_one(self, motor: int, fields: dict[str, Any]) -> None:
        now = self.clock.now()
        if "position" in fields:
            self._go(motor, fields["position"], fields.get("speed", FULL_SPEED))
        elif "distance" in fields:
            here = self.shafts[motor].position(now)
            self._go(motor, here + math.copysign(fields["distance"], fields["speed"]), fields["speed"])
        elif "duty" in fields:
            self._drive(motor, duty=fields["duty"])
        else:
            self._drive(motor, speed=fields["speed"])

    def _mix(self, kind: str, speed: int) -> None:
        """Drive or turn, both motors mixed."""
        drive, turn = getattr(self, "_mixed", (0.0, 0.0))
        match kind:
            case "Forward" | "Backward":
                drive = (1 if kind == "Forward" else -1) * speed / 127
            case "BothWays":
                drive = (speed - 64) / 64
            case "Right" | "Left":
                turn = (1 if kind == "Right" else -1) * speed / 127
            case _:
                turn = (speed - 64) / 64
        self._mixed = drive, turn
        for motor, duty in ((1, drive + turn), (2, drive - turn)):
            self._drive(motor, duty=max(-1.0, min(1.0, duty)))


def _counted(position: float) -> int:
    """Return what a counter of 32 bits says, which goes on at its other end."""
    return (round(position) + (1 << 31)) % (1 << 32) - (1 << 31)


#: What a field that has the name of its motor alone is.
_ALONE = {"DriveDuties": "duty", "GoBothTo": "position"}


def _of_motor(kind: str, fields: dict[str, Any], motor: int) -> dict[str, Any]:
    """Return the fields of one motor, without its number."""
    own = {name.removesuffix(f"_m{motor}"): value for name, value in fields.items()}
    if f"m{motor}" in own:
        own[_ALONE.get(kind, "speed")] = own[f"m{motor}"]
    return own
