"""Hiwonder's LX-16A bus servos: a joint by angle, or a wheel by its share of full drive.

1. What is written is not answered: whether the motor is driven is asked for with the position, in turn.
2. A set-point is reached within a tick, so that the servo moves steadily; without ticks as fast as it can.
3. It has no watchdog: it goes to its last angle and holds, and as a wheel it turns on.

Source: pylx16a 1.1.1; Hiwonder LX-16A protocol.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

from aces_bus.device import Driver, HostLoss, Job, Poll, SingleMotor, Steps, Ticket
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue
from aces_protocols.lx16a.spec import LONGEST_MS, SERVOS

from ..scanning import scan_numbers
from .twin import Lx16aTwin

#: How long an answer may take (s), and how often health is asked for (s).
ANSWER_S, HEALTH_S = 0.02, 0.5
DEGREES = math.degrees(1.0)


class Lx16a(SingleMotor):
    """One servo. Signals of the joint: position, or duty (−1 … 1); of the servo: voltage, temperature."""

    protocol = "lx16a"
    streams = ("Move", "SetMode")
    modes: ClassVar = {"position": {"position": "Move.angle"}, "motor": {"duty": "SetMode.speed"}}
    usual_modes: ClassVar = {"position": "position", "duty": "motor"}
    actions: ClassVar = {
        **SingleMotor.motor_actions,
        "limits": "read the limits of angle, voltage and temperature",
    }
    asking: ClassVar = ("limits",)
    when_host_is_lost = HostLoss("goes on", "LX-16A protocol: no command has a time-out")

    def setup(self) -> None:
        """Add the joint's position or duty, and the servo's health."""
        self.declare(per_rad=DEGREES)
        joint, scale = self.joint, self.scale
        ends = sorted((scale.angle(0.0), scale.angle(240.0)))
        self.add_motor_signal(
            "position",
            unit="rad",
            of="Position.angle",
            to_si=scale.angle,
            from_si=lambda value: max(0.0, min(240.0, scale.raw_angle(float(value)))),
            lower=ends[0] if joint is None or joint.lower is None else max(ends[0], joint.lower),
            upper=ends[1] if joint is None or joint.upper is None else min(ends[1], joint.upper),
            doc="where the joint is, within 240° of the servo",
            source="pylx16a, commands 1 and 28",
        )
        most = min(1.0, joint.max_duty or 1.0) if joint is not None else 1.0
        if self.mode == "motor":
            self.add_motor_signal(
                "duty",
                from_si=lambda value: round(scale.direction * 1000 * float(value)),
                lower=-most,
                upper=most,
                doc="share of full drive; its sign is the direction",
                source="pylx16a, command 29",
            )
        slow: dict[str, Any] = {"stale_s": 5 * HEALTH_S, "source": "pylx16a"}
        self.add_signal("voltage", unit="V", of="Voltage.voltage", to_si=float, doc="supply", **slow)
        self.add_signal(
            "temperature", unit="°C", of="Temperature.temperature", to_si=float, doc="inside", **slow
        )
        self.polls = [
            Poll("GetPosition", "Position", timeout_s=ANSWER_S),
            Poll("GetTorque", "Torque", every_s=HEALTH_S / 5, timeout_s=ANSWER_S),
            Poll("GetVoltage", "Voltage", every_s=HEALTH_S, timeout_s=ANSWER_S),
            Poll("GetTemperature", "Temperature", every_s=HEALTH_S, timeout_s=ANSWER_S),
        ]

    def received(self, record: Record, instant: int) -> None:
        """Take from an answer whether the motor is driven."""
        if type(record).__name__ == "Torque":
            self.shows(record.torque == "on")

    def completed(self, message: str, fields: dict[str, FieldValue]) -> dict[str, FieldValue]:
        """Add how long a move takes, and the mode that a share of full drive is for."""
        if message == "Move":
            rate = self.host.rate_hz
            return {**fields, "time": min(LONGEST_MS, round(1000 / rate)) if rate else 0}
        return {**fields, "mode": "motor"} if message == "SetMode" else fields

    # ------------------------------------------------------------------ switching

    def bring_up(self, job: Job) -> Steps:
        """Yield steps that set its mode at rest, and drive the motor."""
        yield self.send("SetMode", mode=self.mode, speed=0)
        yield self.ask("GetPosition", reply="Position", timeout_s=ANSWER_S)
        yield self.send("SetTorque", torque="on")
        yield self.ask_state()

    def stay(self) -> None:
        """Hold the present position, or stand still."""
        if self.mode == "motor":
            self.want("SetMode", "speed", 0)
        elif (here := self.signals[f"{self.owner}.position"].last) is not None:
            self.want("Move", "angle", self.raw_of("position", here))

    def switch_off(self) -> Ticket:
        """Let it give way."""
        return self.send_now("SetTorque", torque="off")

    def ask_state(self) -> Ticket:
        """Ask whether the motor is driven."""
        return self.ask("GetTorque", reply="Torque", timeout_s=ANSWER_S)

    # ------------------------------------------------------------------ actions

    def limits(self) -> Job:
        """Read the limits: {"angle": (°, °), "voltage": (V, V), "temperature": °C}."""

        def steps(job: Job) -> Steps:
            angle = yield self.ask("GetLimits", reply="Limits", timeout_s=ANSWER_S)
            volts = yield self.ask("GetVoltageLimits", reply="VoltageLimits", timeout_s=ANSWER_S)
            heat = yield self.ask("GetTemperatureLimit", reply="TemperatureLimit", timeout_s=ANSWER_S)
            return {
                "angle": (angle.lower, angle.upper),
                "voltage": (volts.lowest, volts.highest),
                "temperature": heat.highest,
            }

        return self.job("limits", steps)


EXAMPLE = """
name = "lx16a"
rate_hz = 20

[buses]
line = { link = "serial", protocol = "lx16a", baud = 115_200 }

[devices]
S1 = { driver = "lx16a", bus = "line", credentials = { id = 1 } }
S2 = { driver = "lx16a", bus = "line", credentials = { id = 2 } }

[joints]
ELBOW = { device = "S1", direction = -1, zero = 2.09, lower = -1.5, upper = 1.5 }
WHEEL = { device = "S2", type = "continuous", command = "duty", max_duty = 0.8 }
"""

driver = Driver(
    "lx16a",
    device=Lx16a,
    twin=Lx16aTwin,
    example=EXAMPLE,
    doc="Hiwonder LX-16A bus servo: a joint by angle, or a wheel by its share of full drive.",
    source="pylx16a 1.1.1; Hiwonder LX-16A protocol",
    scan=scan_numbers("lx16a", "LX", "id", SERVOS, "GetId", reply="Id", timeout_s=ANSWER_S),
)
__all__ = ["driver"]
