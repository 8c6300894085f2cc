"""What a simulated VESC does, whatever carries its packets: a motor, set-points with their time-out, values.

1. Every set-point, and ALIVE, restarts the time-out; when it is over the motor is released (vedderb/bldc timeout.c).
2. Speed follows each kind of set-point with a time constant of its own; no load, no friction. These are choices.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, tau
from typing import Any

from aces_bus.device import Twin
from aces_bus.protocol import Record
from aces_bus.runtime.clock import Timer
from aces_devices.wheel_model import TurningWheel
from aces_protocols.vesc_uart.spec import FAULTS, VALUES

#: Without a set-point for so long the motor is released (s): the factory's.
TIMEOUT_S = 1.0
#: The motor: rad/s at full duty, rad/s a A when nothing holds it, s to follow.
SPEED, PER_AMPERE = 600.0, 30.0
DRIVEN_S, PUSHED_S, BRAKED_S, FREE_S = 0.05, 0.5, 0.1, 0.5
#: A greater current than this is limited to it, as firmware limits by its settings (A). A choice.
MOST_CURRENT = 120.0
#: Volts of the supply; °C.
SUPPLY, WARM = 48.2, 31.0
#: Firmware 6.05 on hardware "60".
FIRMWARE = {"major": 6, "minor": 5, "hardware": "60", "more": bytes(range(12)) + bytes(7)}
#: Set-points: message → what the motor does then, and the field that says how much.
SET_POINTS: Mapping[str, tuple[str, str]] = {
    "SetDuty": ("duty", "duty"),  # a share of the supply; 0 shorts the motor
    "SetCurrent": ("current", "current"),  # 0 releases the motor
    "SetBrakeCurrent": ("brake", "current"),
    "SetHandbrake": ("hold", "current"),
    "SetSpeed": ("speed", "speed"),  # turns of the field a minute
    "SetPosition": ("position", "position"),  # of the encoder (°); it is there at once
}
#: How it can misbehave beyond what all twins do; the amount of `trip` is the fault's number.
MISBEHAVIOUR = {
    "trip": "reports a fault, over_temperature_fet (or the number said), and releases the motor while it lasts",
    "jam": "the motor does not turn, and takes what current it is given",
    "deaf": "answers, and takes no set-points",
}
TRIP = {"trip": FAULTS["over_temperature_fet"]}


class VescModel:
    """A controller and its motor: `mode`, `given` (what the last set-point said), `fault_name`, `position(now)` (rad)."""

    def __init__(self, twin: Twin, number: int) -> None:
        self.clock, self.faults, self.number = twin.clock, twin.active_faults, number
        joint = twin.joints[0] if twin.joints else None
        self._direction = joint.direction if joint else 1
        self._zero = (joint.zero or 0.0) if joint else 0.0
        self._ratio = (joint.ratio if joint else None) or 1.0
        self.pole_pairs = int(twin.config.settings.get("pole_pairs", 7))
        now = self.clock.now()
        self.motor = TurningWheel(now)
        if joint is not None:
            start = self._direction * twin.world.start_of(joint.name) + self._zero
            self.motor.place(now, start * self._ratio)
            twin.world.joints[joint.name] = self
        #: No two controllers are equally warm (°C).
        self.warm = round(WARM + twin.random.uniform(-3.0, 3.0), 1)
        self._late: Timer | None = None
        self.mode, self.given = "free", 0.0
        self.boot()

    def boot(self) -> None:
        """Boot: released. The motor stays where it is; counters begin at 0."""
        self._start = self.motor.position(self.clock.now())
        self.release()

    def position(self, now: int) -> float:
        """Return where the joint is (rad)."""
        return self._direction * (self.motor.position(now) / self._ratio - self._zero)

    @property
    def fault_name(self) -> str:
        """The fault that it reports."""
        number = round(self.faults.get("trip", 0))
        return next((name for name, fault in FAULTS.items() if fault == number), "none")

    def lead(self) -> None:
        """Have the motor do what the last set-point said."""
        now, given = self.clock.now(), self.given
        mode = "free" if "trip" in self.faults else self.mode
        match mode:
            case "duty":
                self.motor.lead(now, SPEED * given, DRIVEN_S)
            case "current":
                speed = max(-SPEED, min(SPEED, PER_AMPERE * given))
                self.motor.lead(now, speed, PUSHED_S if given else FREE_S)
            case "speed":
                self.motor.lead(now, given * tau / 60 / self.pole_pairs, DRIVEN_S)
            case "position":
                turn = (given / 360 * tau - self.motor.position(now) + tau / 2) % tau - tau / 2
                self.motor.place(now, self.motor.position(now) + turn)
            case "brake" | "hold":
                self.motor.lead(now, 0.0, BRAKED_S)
            case _:
                self.motor.lead(now, 0.0, FREE_S)
        if "jam" in self.faults:
            self.motor.block(now)

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
        """Return the motor current (A), as far as there is one."""
        if self.fault_name != "none" or self.mode not in ("current", "brake", "hold"):
            return 0.0
        if self.mode == "current":
            return self.given
        speed = self.motor.speed(self.clock.now())
        return -self.given if speed > 1.0 else self.given if speed < -1.0 else 0.0

    @property
    def values(self) -> dict[str, Any]:
        """Present measurements, by the names of VALUES."""
        now = self.clock.now()
        turned = self.motor.position(now)
        speed = self.motor.speed(now)
        count = round((turned - self._start) / tau * 6 * self.pole_pairs)
        found: dict[str, Any] = dict.fromkeys(VALUES, 0)
        found |= {
            "fet_temperature": self.warm,
            "motor_temperature": self.warm,
            "motor_current": self.current(),
            "duty": max(-1.0, min(1.0, speed / SPEED)),
            "speed": round(speed * 60 / tau * self.pole_pairs),
            "voltage": SUPPLY,
            "tachometer": count,
            "tachometer_abs": abs(count),
            "fault": self.fault_name,
            "position": turned / tau * 360 % 360,
            "controller": self.number,
            "mosfet_temperatures": [self.warm] * 3,
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
