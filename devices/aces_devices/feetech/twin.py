"""The simulated STS or SCS servo: what it has beyond what all servos have.

Choices, where no sheet says anything, are in the README.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from aces_bus.device import on
from aces_bus.device.single_motor import JointScale
from aces_bus.protocol import Record
from aces_protocols.feetech.control_table import ERRORS, SCS_ANGLE, STS_ANGLE
from aces_protocols.feetech.models import MODEL_NAMES, MODELS
from aces_protocols.feetech.spec import scs_table, sts_table
from aces_protocols.robotis.fields import from_directed, to_directed

from ..joint_model import MotorModel
from ..servos.motion import DRAG, ServoShaft
from ..servos.twin import RegisterTable, ServoTwin
from .driver import FULL, series_of

RAM = 40
#: Choices: firmware 3.10, 7.4 V, 30 °C without load.
FIRMWARE, SUPPLY, WARMTH = (3, 10), 74, 30
#: The greatest speed (counts a second) of a turn of 4096: 50 rpm. A choice.
FREE = 3413
#: The motor: A blocked, N·m/A; stiffness (duty for a rad) and damping (s/rad) at the factory's gains: those of an STS3215 at
#: 7.4 V, about. Choices.
STALL_A, TORQUE_CONSTANT, STIFFNESS, DAMPING = 2.5, 0.76, 12.0, 0.2
#: mA a count of current, counts/s² a count of acceleration, the factory's gain.
CURRENT_A, PER_ACCELERATION, USUAL_GAIN = 6.5e-3, 100.0, 32
TABLES = {"STS": RegisterTable(sts_table), "SCS": RegisterTable(scs_table)}
#: ° a count.
ANGLES = {"STS": STS_ANGLE, "SCS": SCS_ANGLE}
VELOCITY = 1


class FeetechTwin(ServoTwin):
    """One servo. `table` is its memory; `self["goal_position"]` a register's raw number."""

    protocol = "feetech"
    ram_start = RAM
    level_offset = 1
    faults: ClassVar[Mapping[str, str]] = {
        "hot": "is 5 °C above its highest temperature (or as hot as said, °C)",
        "low_voltage": "has 0.5 V less than its lowest voltage (or as much as said, V)",
        "jam": "cannot turn: where it should, it pushes until it is overloaded",
        "overload": "reports an overload",
    }

    def setup(self) -> None:
        """Begin with the control table of the servo's series."""
        self.series = series_of(self.config)
        self.places = TABLES[self.series]
        self.turn = 4096 if self.series == "STS" else 1024
        super().setup()

    def make(self) -> None:
        """Make it as delivered, with the speed, delay, level and mode that the robot's file means."""
        self._factory()
        self.tune()
        self["return_delay"] = round(self.settings.return_delay_us / 2)
        self["status_return_level"] = max(0, self.settings.status_return_level - self.level_offset)
        joint = self.joints[0] if self.joints else None
        #: Counts are the sensor's: without the homing offset.
        scale = JointScale.of(joint, 1.0 / math.radians(ANGLES[self.series]))
        start = self.turn / 2
        if joint is not None:
            self.world.joints[joint.name] = self
            if joint.command == "speed":
                self["operating_mode"] = VELOCITY
            start = scale.raw_angle(self.world.start_of(joint.name))
            start = max(0.0, min(self.turn - 1.0, start))
        motor = MotorModel(
            speed=math.tau * FREE / 4096 * (1.0 + DRAG),
            stall_current=STALL_A,
            friction=0.008,
            heating=0.15,
            cooling=120.0,
            torque_constant=TORQUE_CONSTANT,
            drag=DRAG,
        )
        self.motion = ServoShaft(self, motor, scale, start, stiffness=STIFFNESS, damping=DAMPING)
        #: What is there after power-off: of the table below the RAM, what was written unlocked.
        self["id"] = self.credentials["id"]
        self._saved = bytes(self.table[:RAM])

    def _factory(self) -> None:
        self.load_defaults(0, RAM)
        model = MODEL_NAMES.get(self.config.model or "", MODELS[0])
        self["model_number"] = model.number
        self["firmware_major"], self["firmware_minor"] = FIRMWARE

    def begin(self) -> None:
        """Load the saved registers and the RAM's defaults; the goal is the present place."""
        super().begin()
        self.motion.settle(self.clock.now())
        self.table[:RAM] = self._saved
        self.load_defaults(RAM, len(self.table))
        if self.series == "STS":
            self["torque_limit"] = self["max_torque"]
        self["goal_position"] = self._shown(round(self.motion.at))
        self.apply()

    @property
    def last_count(self) -> int:
        """The last position of a turn, in counts of its shaft."""
        return self.turn - 1

    # ------------------------------------------------------------------ motion

    @property
    def offset(self) -> int:
        """The homing offset (counts): taken off the sensor's position."""
        if self.series != "STS":
            return 0
        return from_directed(self["homing_offset"], 11)

    def _shown(self, count: int) -> int:
        return (count - self.offset) % self.turn

    def position(self, now: int) -> float:
        """Return the joint's angle (rad), as its position register has it."""
        return self.motion.scale.angle(self.motion.position(now) - self.offset)

    def turn_by_hand(self, position: float) -> None:
        """Turn the joint by hand to an angle (rad): it goes there at once, unless its torque is on."""
        if not self["torque_enable"]:
            self.motion.settle(self.clock.now())
            self.motion.at = self.motion.scale.raw_angle(position) + self.offset

    def before_write(self) -> None:
        """Settle the motion up to now."""
        self.motion.settle(self.clock.now())

    def after_write(self, touched: range) -> None:
        """Keep what is below the RAM, if it is unlocked."""
        if touched.start < RAM and not self["lock"]:
            self._saved = bytes(self.table[:RAM])

    def apply(self) -> None:
        """Apply the registers to the motion."""
        motion = self.motion
        motion.is_driven = bool(self["torque_enable"])
        motion.is_jammed = "jam" in self.active_faults
        free = FREE * self.turn / 4096
        speed = from_directed(self["goal_speed"], 15)
        motion.limit = min(free, abs(speed)) if speed else free
        low, high = self["min_position_limit"], self["max_position_limit"]
        goal = from_directed(self["goal_position"], 15)
        motion.goal = float((max(low, min(high, goal)) if low < high else goal) + self.offset)
        is_wheel = self.series == "STS" and self["operating_mode"] == VELOCITY
        motion.speed = max(-free, min(free, float(speed))) if is_wheel else None
        motion.acceleration = self["acceleration"] * PER_ACCELERATION or math.inf
        per_rad = motion.scale.ratio
        motion.stiffness = STIFFNESS * per_rad * self["p_gain"] / USUAL_GAIN
        motion.damping = DAMPING * per_rad * self["d_gain"] / USUAL_GAIN
        motion.strength = (self["torque_limit"] if self.series == "STS" else self["max_torque"]) / FULL
        motion.apply(self.clock.now())

    def measure(self) -> int:
        """Bring what is measured up to date; the error bits that hold now."""
        now = self.clock.now()
        motion, faults = self.motion, self.active_faults
        if motion.is_jammed is not ("jam" in faults):
            self.apply()
        speed = motion.speed_at(now)
        self["present_position"] = self._shown(round(motion.at))
        self["present_speed"] = to_directed(round(speed), 15)
        self["present_load"] = to_directed(round(motion.drive * FULL), 10)
        if self.series == "STS":
            self["present_current"] = round(abs(motion.load) * STALL_A / CURRENT_A)
        self["moving"] = bool(round(speed))
        errors = self.alarms(
            ERRORS,
            pushes=motion.pushes,
            hottest="max_temperature",
            lowest="min_voltage",
            highest="max_voltage",
            supply=SUPPLY,
            warmth=round(WARMTH + motion.warming),
        )
        self["status"] = errors
        if errors & self["unload_condition"] and self["torque_enable"]:
            self["torque_enable"] = 0
            self.apply()
        return errors

    # ------------------------------------------------------------------ instructions

    def refused(self, why: str) -> int:
        """Say nothing: no bit of a status is about the request, and what is refused is not done."""
        return 0

    def with_errors(self, refusal: int, errors: int) -> int:
        """Return the servo's errors."""
        return refusal | errors

    @on("SyncRead")
    def answer_together(self, request: Record) -> None:
        """Answer after the servos that are asked before; SCS servos do not know it."""
        if self.series == "STS":
            self.answer_in_turn([(number, request.start, request.count) for number in request.ids])

    @on("Reset")
    def reset(self, request: Record) -> None:
        """Set all as from the factory, save the id."""
        self.answer(request)
        number = self["id"]
        self._factory()
        self["id"] = number
        self._saved = bytes(self.table[:RAM])
        self.begin()
