"""The twin of a RobStride motor on its MIT protocol: the MIT law, position and speed, faults.

1. Every command is answered by a feedback, under the master's number 0; the mode changes while the motor is off only.
2. It has no time-out: that is set by the private protocol, and off from the factory (RS00 manual, parameter 0x7028).
3. Models without ranges of their own have those of `ranges` in the robot's file, else an RS00's.
"""

from __future__ import annotations

from aces_bus.device import on
from aces_bus.protocol import Record
from aces_protocols.robstride_mit.spec import DIALECTS, KD_MAX, KP_MAX, MODELS, SHARE

from .twin import RobstrideMotor

#: Faults of the twin → the bits of the list that it answers.
BITS = {
    "under_voltage": "under_voltage",
    "over_current": "phase_a_over_current",
    "over_temperature": "over_temperature",
    "magnetic_encoder": "position_lost",
    "uncalibrated": "uncalibrated",
}


class RobstrideMitTwin(RobstrideMotor):
    """One motor on the MIT protocol; `state` is reset or run, `mode` what it takes set-points for."""

    protocol = "robstride_mit"

    def choose_ranges(self) -> None:
        """See `RobstrideMotor.choose_ranges`."""
        dialect = str(self.variant.dialect)
        gains = (1.0, 1.0) if dialect == SHARE else (KP_MAX, KD_MAX)
        self.spec = (*DIALECTS[dialect], *gains)
        usual = (*MODELS.get(self.config.model or "", MODELS["RS00"]), KP_MAX, KD_MAX)
        self.ranges = self.config.settings.get("ranges") or usual

    def setup(self) -> None:
        """Begin stopped, in mode `mit`."""
        super().setup()
        self.mode = "mit"

    def feedback(self) -> None:
        """Send position, velocity, torque and temperature."""
        self.new_faults()
        position, velocity, torque = self.measured()
        self.reply(
            "Feedback",
            position=position,
            velocity=velocity,
            torque=torque,
            temperature=self.motor.temperature,
        )

    @on("Enable")
    def enable(self, request: Record) -> None:
        """Switch on, without torque, unless there is a fault."""
        self.new_faults()
        if not self.failed and self.state != "run":
            self.state = "run"
            self.motor.impede(self.clock.now(), 0.0, 0.0, 0.0, 0.0, 0.0)
        self.feedback()

    @on("Disable")
    def disable(self, request: Record) -> None:
        """Switch off."""
        self.go_off()
        self.feedback()

    @on("SetZero")
    def zero(self, request: Record) -> None:
        """Make here 0; not in mode `position`."""
        if self.mode != "position":
            self.offset -= self.angle
        self.feedback()

    @on("ClearFaults")
    def clear(self, request: Record) -> None:
        """Clear the faults."""
        self.failed = frozenset()
        self.feedback()

    @on("ReadFaults")
    def list_faults(self, request: Record) -> None:
        """Answer with the faults."""
        self.new_faults()
        self.reply("Faults", faults=[BITS[name] for name in sorted(self.failed)])

    @on("SetMode")
    def change_mode(self, request: Record) -> None:
        """Take another mode, while it is off."""
        if self.state != "run":
            self.mode = str(request.mode)
        self.feedback()

    @on("Command")
    def command(self, request: Record) -> None:
        """Apply the MIT law, in mode `mit`."""
        if self.state == "run" and self.mode == "mit":
            self.impede(request)
        self.feedback()

    @on("Position")
    def position_command(self, request: Record) -> None:
        """Hold a position, in mode `position`; the limit of the velocity is not simulated."""
        if self.state == "run" and self.mode == "position":
            self.go_to(request.position)
        self.feedback()

    @on("Velocity")
    def velocity_command(self, request: Record) -> None:
        """Turn, in mode `speed`; the limit of the current is not simulated."""
        if self.state == "run" and self.mode == "speed":
            self.turn(request.velocity)
        self.feedback()
