"""The configuration of a moteus: values by name, of which a copy outlives power-off.

1. Names are those of mjbots/moteus docs/reference/configuration.md; a twin has those that it obeys, and those that name it.
2. A value written is obeyed at once, and kept for good only by `conf write`.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import nan, tau

#: The watchdog of a command that names none (s), the configured maximum torque (N·m), the fastest the motor turns (turn/s).
TIMEOUT_S, MAX_TORQUE, MAX_VELOCITY = 0.1, 12.0, 20.0
#: At the controller: amperes and N·m/A of its motor, stiffness (N·m/rad) and damping (N·m·s/rad) at a scale of 1. Choices.
CURRENT, TORQUE_CONSTANT, STIFFNESS, DAMPING = 30.0, MAX_TORQUE / 30.0, 120.0, 4.0
#: The highest temperature of the board (°C).
MOST_TEMPERATURE = 75.0
#: Sixteen bytes that name a controller; the last is its number. A choice.
UUID = bytes.fromhex("ace5b0a5000040008000000000000000")

#: Values of a new controller. Whole numbers are integers of the firmware, others floats of four bytes.
DEFAULTS: Mapping[str, float] = {
    "servopos.position_min": nan,
    "servopos.position_max": nan,
    "servo.pid_position.kp": STIFFNESS * tau,
    "servo.pid_position.kd": DAMPING * tau,
    "servo.default_velocity_limit": nan,
    "servo.default_accel_limit": nan,
    "servo.max_velocity": MAX_VELOCITY,
    "servo.max_current_A": CURRENT,
    "servo.fault_temperature": MOST_TEMPERATURE,
    "servo.default_timeout_s": TIMEOUT_S,
    "servo.timeout_mode": 12,
    "motor_position.output.offset": 0.0,
}
#: What a position timeout does: the modes of servo.timeout_mode that the twin has.
TIMEOUT_MODES = {0: "stopped", 12: "zero_velocity", 15: "brake"}


class Configuration(dict[str, float]):
    """The values of one controller by name, in the units of the reference."""

    def __init__(self, number: int) -> None:
        uuid = UUID[:-1] + bytes((number,))
        #: What is as it was made, and cannot be set to another value here.
        self.fixed: Mapping[str, float] = {
            "id.id": number,
            **{f"uuid.uuid.{place}": byte for place, byte in enumerate(uuid)},
        }
        super().__init__({**self.fixed, **DEFAULTS})

    def reset(self) -> None:
        """Take the values of a new controller."""
        self.update(DEFAULTS)

    def text_of(self, name: str) -> str:
        """Return a value as the console prints it."""
        value = self[name]
        return str(value) if isinstance(value, int) else f"{value:.9g}"

    def accept(self, name: str, text: str) -> bool:
        """Take a value that was given as text; return False for one that cannot be."""
        try:
            value = int(text) if isinstance(self[name], int) else float(text)
        except ValueError:
            return False
        if name in self.fixed:
            return value == self[name]
        if name == "servo.timeout_mode" and value not in TIMEOUT_MODES:
            return False
        self[name] = value
        return True
