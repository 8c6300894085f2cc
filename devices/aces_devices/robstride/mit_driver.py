"""RobStride motors on their MIT protocol: a joint with stiffness, damping and torque.

1. A feedback does not say whether the motor is on. It counts as on when `Enable` was answered and no fault was reported, and
   as off when `Disable` was answered: one that lost its power for a moment is off, and this driver cannot tell.
2. Nothing watches over it: its time-out is set by the private protocol (`robstride`, `can_timeout`), off from the factory.
3. While no command is sent it is asked for its place by `SetMode`, with the mode that it has: that alone is answered by a
   feedback and neither switches nor clears anything.

Sources: see the spec.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

from aces_bus.device import Driver, HostLoss, Job, Poll, Steps, Ticket
from aces_bus.device.settings import described, settings_of
from aces_bus.errors import UnknownNameError
from aces_bus.protocol import Record
from aces_protocols.robstride_mit.spec import DIALECTS, KD_MAX, KP_MAX, MODELS, SHARE

from ..mit_motor import MitMotor
from ..scanning import scan_numbers
from .mit_twin import RobstrideMitTwin

#: How long an answer may take (s).
ANSWER_S = 0.02


class RobstrideMitSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    ranges: Annotated[
        tuple[float, float, float, float, float] | None,
        Meta(description="position, velocity, torque, kp, kd at full scale, where the model does not say it"),
    ] = None
    health_s: Annotated[
        float, Meta(gt=0, description="how often faults are asked for (s), 0.2 when absent")
    ] = 0.2


class RobstrideMit(MitMotor):
    """One motor. Signals of the joint: position, velocity, torque, kp, kd; of the motor: temperature."""

    protocol = "robstride_mit"
    streams = ("Command",)
    modes: ClassVar = {
        "mit": {name: f"Command.{name}" for name in ("position", "velocity", "torque", "kp", "kd")}
    }
    usual_modes: ClassVar = {"position": "mit", "current": "mit"}
    actions: ClassVar = {
        "enable": MitMotor.motor_actions["enable"],
        "disable": MitMotor.motor_actions["disable"],
        "clear_faults": "clear its faults, while it is off",
        "set_zero": "the present position is 0 of the motor, while it is off",
    }
    when_host_is_lost = HostLoss(
        "goes on", "RS00 manual, MIT protocol, and parameter 0x7028 (canTimeout, 0 from the factory)",
        detail="its time-out is set by the private protocol alone (`robstride`, can_timeout)",
    )  # fmt: skip

    def setup(self) -> None:
        """Declare the signals of the motor."""
        settings = self.settings = settings_of(self.name, RobstrideMitSettings, self.config.settings)
        self.declare()
        dialect = str(self.variant.dialect)
        model = self.config.model or (dialect if dialect in MODELS else None)
        if settings.ranges is None and model not in MODELS:
            raise UnknownNameError(
                f"model of {self.name}, without settings ranges", model or "(none is stated)", MODELS
            )
        gains = (1.0, 1.0) if dialect == SHARE else (KP_MAX, KD_MAX)
        ranges = settings.ranges or (*MODELS[str(model)], KP_MAX, KD_MAX)
        self.declare_mit((*DIALECTS[dialect], *gains), ranges)
        self.add_signal(
            "temperature", unit="°C", of="Feedback.temperature", doc="of the windings", source="MIT protocol"
        )
        self.polls = [
            Poll(
                "SetMode", "Feedback", {"mode": "mit"}, timeout_s=ANSWER_S, asked_by={"Command": "Feedback"}
            ),
            Poll("ReadFaults", "Faults", {}, settings.health_s, ANSWER_S),
        ]

    def received(self, record: Record, instant: int) -> None:
        """Take faults: with one the motor is off."""
        if type(record).__name__ == "Faults":
            self.shows(bool(self.is_on) and not record.faults, record.faults)

    def bring_up(self, job: Job) -> Steps:
        """Yield steps that switch the motor off, set its mode and switch it on."""
        yield from self._off()
        yield self.ask("SetMode", reply="Feedback", timeout_s=ANSWER_S, mode="mit")
        yield self.ask("ReadFaults", reply="Faults", timeout_s=ANSWER_S)
        if self.faults:
            return  # `enable` names them
        yield self.ask("Enable", reply="Feedback", timeout_s=ANSWER_S)
        self.shows(True, self.faults)

    def _off(self) -> Steps:
        yield self.ask("Disable", reply="Feedback", timeout_s=ANSWER_S)
        self.shows(False, self.faults)

    def switch_off(self) -> Ticket:
        """Switch off; the answer says that it has taken it."""
        return self.send_now("Disable", reply="Feedback", timeout_s=ANSWER_S)

    def ask_state(self) -> Job:
        """Switch it off, which is the only state that it can be brought to say."""
        return self.job("switch off", lambda job: self._off())

    # ------------------------------------------------------------------ actions

    def clear_faults(self) -> Job:
        """Clear its faults. Fails with `DeviceError` unless it is off."""

        def steps(job: Job) -> Steps:
            self.check_off("its faults can be cleared")
            yield self.ask("ClearFaults", reply="Feedback", timeout_s=ANSWER_S)
            yield self.ask("ReadFaults", reply="Faults", timeout_s=ANSWER_S)

        return self.job("clear faults", steps)

    def set_zero(self) -> Job:
        """Make the present position the motor's 0. Fails with `DeviceError` unless it is off."""

        def steps(job: Job) -> Steps:
            self.check_off("zero can be set")
            yield self.ask("SetZero", reply="Feedback", timeout_s=ANSWER_S)
            self.epoch += 1

        return self.job("set zero", steps)


EXAMPLE = """
name = "robstride_mit"
rate_hz = 20

[buses]
leg = { link = "can", protocol = "robstride_mit", bitrate = 1_000_000 }

[devices]
M1 = { driver = "robstride_mit", bus = "leg", credentials = { motor = 1 }, model = "RS00" }
M2 = { driver = "robstride_mit", bus = "leg", credentials = { motor = 9 }, settings = { ranges = [12.57, 44, 17, 500, 5] } }

[joints]
HIP = { device = "M1", direction = -1, zero = 0.2, lower = -1.5, upper = 1.5, max_speed = 6, gains = { kp = 60, kd = 2 } }
KNEE = { device = "M2", lower = -1, upper = 1, gains = { kp = 60, kd = 2 } }
"""

mit_driver = Driver(
    "robstride_mit",
    device=RobstrideMit,
    twin=RobstrideMitTwin,
    example=EXAMPLE,
    doc="RobStride motor on its MIT protocol: a joint with stiffness, damping and torque.",
    source="RS00 manual, MIT protocol; lerobot motors/robstride",
    # Its faults, which changes nothing.
    scan=scan_numbers(
        "robstride_mit", "RS", "motor", range(1, 0x80), "ReadFaults", reply="Faults", timeout_s=0.03
    ),
    settings=described(RobstrideMitSettings),
)
