"""What a simulated VESC does, whatever carries its packets: a motor, set-points with their time-out, values.

1. Every set-point, and ALIVE, restarts the time-out; when it is over the motor is released (vedderb/bldc timeout.c).
2. The motor is one of `joint_model`; loops of speed and position hold it. Its sizes, and where it gets too hot, are choices.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, tau
from typing import Any

from aces_bus.device import Twin
from aces_bus.device.single_motor import JointScale
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_bus.runtime.clock import Timer
from aces_devices.joint_model import AMBIENT, MotorModel, PacedGoal, joint_of
from aces_protocols.vesc_uart.spec import FAULTS, VALUES

#: Without a set-point for so long the motor is released (s): the factory's.
TIMEOUT_S = 1.0
#: The motor: rad/s at full duty, and N·m/A, which is the supply (V) over that.
SPEED, TORQUE_CONSTANT = 600.0, 0.08
#: Stiffness (1/rad) and damping (s/rad) of its loops, as shares of what full duty gives at its speed.
SPEED_LOOP, POSITION_LOOP, BRAKE = (300.0, 20.0), (133.0, 6.6), (0.0, 20.0)
#: A greater current than this is limited to it, as firmware limits by its settings (A). A choice.
MOST_CURRENT = 120.0
#: Volts of the supply and its resistance (ohm); °C without load, and above which it is in a fault; the least supply (V).
SUPPLY, RESISTANCE, WARM, HOTTEST, LEAST = 48.2, 0.02, 31.0, 100.0, 12.0
#: Firmware 6.05 on hardware "60".
FIRMWARE = {"major": 6, "minor": 5, "hardware": "60", "more": bytes(range(12)) + bytes(7)}
#: Set-points: message → what the motor does then, and the field that says how much.
SET_POINTS: Mapping[str, tuple[str, str]] = {
    "SetDuty": ("duty", "duty"),  # a share of the supply; 0 shorts the motor
    "SetCurrent": ("current", "current"),  # 0 releases the motor
    "SetBrakeCurrent": ("brake", "current"),
    "SetHandbrake": ("hold", "current"),
    "SetSpeed": ("speed", "speed"),  # turns of the field a minute
    "SetPosition": ("position", "position"),  # of the encoder (°)
}
#: How it can misbehave beyond what all twins do; the amount of `trip` is the fault's number.
MISBEHAVIOUR = {
    "trip": "reports a fault, over_temperature_fet (or the number said), and releases the motor while it lasts",
    "jam": "the motor does not turn, and takes what current it is given",
    "hot": "the motor is at 120 °C (or as hot as said), and cools: over_temperature_motor until it has",
    "brown_out": "the supply has 8 V (or as much as said): under_voltage until it is back",
    "deaf": "answers, and takes no set-points",
}
TRIP = {"trip": FAULTS["over_temperature_fet"], "hot": 120.0, "brown_out": 8.0}


class VescModel:
    """A controller and its motor: `mode`, `given` (what the last set-point said), `fault_name`, `position(now)` (rad)."""

    def __init__(self, twin: Twin, number: int) -> None:
        self.clock, self.faults, self.number = twin.clock, twin.active_faults, number
        self.scale = JointScale.of(twin.joints[0] if twin.joints else None)
        self.pole_pairs = int(twin.config.settings.get("pole_pairs", 7))
        self.motor = joint_of(
            twin,
            MotorModel(
                speed=SPEED,
                time_constant=0.083,
                stall_current=MOST_CURRENT,
                friction=0.003,
                heating=0.001,
                cooling=120.0,
                torque_constant=TORQUE_CONSTANT,
            ).behind(self.scale.ratio),
        )
        #: No two controllers are equally warm (°C).
        self.warm = round(WARM + twin.random.uniform(-3.0, 3.0), 1)
        self._late: Timer | None = None
        self.mode, self.given = "free", 0.0
        self.boot()

    def boot(self) -> None:
        """Boot: released. The motor stays where it is; counters begin at 0."""
        self._start = self.turned
        self.release()

    @property
    def turned(self) -> float:
        """The motor's angle (rad)."""
        return self.scale.raw_angle(self.motor.position(self.clock.now()))

    @property
    def voltage(self) -> float:
        """The supply (V), which sinks with the current that is drawn."""
        drawn = max(0.0, self.motor.duty * self.motor.current)
        return float(self.faults.get("brown_out", SUPPLY)) - RESISTANCE * drawn

    @property
    def fault_name(self) -> str:
        """The fault that it reports."""
        if "trip" not in self.faults:
            if self.motor.temperature > HOTTEST:
                return "over_temperature_motor"
            return "under_voltage" if self.voltage < LEAST else "none"
        number = round(self.faults["trip"])
        return next((name for name, fault in FAULTS.items() if fault == number), "none")

    def lead(self) -> None:
        """Have the motor do what the last set-point said."""
        now, given, motor, scale = self.clock.now(), self.given, self.motor, self.scale
        motor.sync(now)
        motor.jammed = "jam" in self.faults
        match "free" if self.fault_name != "none" else self.mode:
            case "duty":
                motor.drive(now, scale.direction * given)
            case "current" if given:
                motor.push(now, scale.direction * given)
            case "speed":
                speed = scale.speed(given * tau / 60 / self.pole_pairs)
                motor.obey(now, self._loop(SPEED_LOOP, None, speed=speed))
            case "position":
                turned = self.turned
                turn = (given / 360 * tau - turned + tau / 2) % tau - tau / 2
                motor.obey(now, self._loop(POSITION_LOOP, scale.angle(turned + turn)))
            case "brake":
                motor.obey(now, self._loop(BRAKE, None, abs(given) / MOST_CURRENT))
            case "hold":
                motor.obey(now, self._loop(POSITION_LOOP, motor.q, abs(given) / MOST_CURRENT))
            case _:
                motor.free(now)

    def _loop(
        self, gains: tuple[float, float], goal: float | None, most: float = inf, *, speed: float = 0.0
    ) -> PacedGoal:
        """Return the loop that holds a goal (rad) or a speed (rad/s) of the joint with a share of the greatest current."""
        motor = self.motor
        usual = 1.0 / motor.motor.speed
        return PacedGoal(
            goal=motor.q,
            target=goal,
            pace=speed if goal is None else inf,
            rate=speed,
            stiffness=gains[0] * usual,
            damping=gains[1] * usual,
            limit=most,
            emf=usual,
        )

    def set(self, request: Record) -> None:
        """Take a set-point."""
        if "deaf" in self.faults:
            return
        self.mode, field = SET_POINTS[type(request).__name__]
        given = float(getattr(request, field))
        most = {"duty": 1.0, "current": MOST_CURRENT, "speed": SPEED * 60 / tau * self.pole_pairs}.get(
            field, inf
        )
        self.given = max(-most, min(most, given))
        self.lead()
        self.keep_alive()

    def keep_alive(self) -> None:
        """Restart the time-out."""
        if self._late is not None:
            self._late.cancel()
        self._late = self.clock.call_in(round(TIMEOUT_S * 1e9), self.release)

    def release(self) -> None:
        """Release the motor: the time-out, or the end of power."""
        if self._late is not None:
            self._late.cancel()
        self._late = None
        self.mode = "free"
        self.given = 0.0
        self.lead()

    def current(self) -> float:
        """Return the motor current (A)."""
        self.motor.sync(self.clock.now())
        return self.scale.direction * self.motor.current

    @property
    def values(self) -> dict[str, Any]:
        """Present measurements, by the names of VALUES."""
        turned, motor = self.turned, self.motor
        speed = self.scale.raw_speed(motor.v)
        if self.fault_name != "none" and motor.mode != "free":
            self.lead()
        count = round((turned - self._start) / tau * 6 * self.pole_pairs)
        warm = round(self.warm + (motor.temperature - AMBIENT) / 2, 1)
        found: dict[str, FieldValue] = dict.fromkeys(VALUES, 0)
        found |= {
            "fet_temperature": warm,
            "motor_temperature": round(self.warm + motor.temperature - AMBIENT, 1),
            "motor_current": self.current(),
            "input_current": motor.duty * motor.current,
            "duty": max(-1.0, min(1.0, speed / SPEED))
            if motor.mode == "free"
            else self.scale.direction * motor.duty,
            "speed": round(speed * 60 / tau * self.pole_pairs),
            "voltage": self.voltage,
            "tachometer": count,
            "tachometer_abs": abs(count),
            "fault": self.fault_name,
            "position": turned / tau * 360 % 360,
            "controller": self.number,
            "mosfet_temperatures": [warm] * 3,
        }
        return found

    def answer(self, request: Record) -> tuple[str, dict[str, Any]] | None:
        """Carry a packet out; the message and fields of its answer, None where it has none."""
        match type(request).__name__:
            case "GetSelected":
                values = self.values
                wanted = {
                    name: values[name] if request.mask >> bit & 1 else None for bit, name in enumerate(VALUES)
                }
                return "Selected", {"mask": request.mask, **wanted}
            case "GetValues":
                return "Values", self.values
            case "GetFirmware":
                return "Firmware", FIRMWARE
            case "Alive":
                self.keep_alive()
            case name if name in SET_POINTS:
                self.set(request)
            case _:
                pass
        return None
