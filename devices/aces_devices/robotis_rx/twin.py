"""The simulated RX servo: what it has beyond what all servos have.

Source: Robotis RX-28 manual; where it is silent, see the README's choices.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from aces_bus.device import on
from aces_bus.device.single_motor import JointScale
from aces_bus.protocol import Record
from aces_protocols.robotis.control_table import ERRORS
from aces_protocols.robotis.fields import to_directed
from aces_protocols.robotis.spec import control_table

from ..servos.registers import RegisterCodec
from ..servos.twin import READ, WRITE, RegisterTable, ServoTwin
from .driver import CLOCKWISE, STEP, TOP, UNLOCKED, signed
from .motion import FREE, PER_SPEED, ShaftMotion

EEPROM = 0x18
MODELS = {"RX-10": 10, "RX-28": 28, "RX-64": 64}
#: What a servo of the recordings has: firmware 0x17, 11.1 V, 37 °C.
FIRMWARE, SUPPLY, WARMTH = 0x17, 111, 37
#: So long after its own status a servo answers nothing that it does not understand (ns): on a line with a second one of
#: its id, their statuses would answer each other for ever. A choice.
QUIET_NS = 3_000_000
PING_CODE, READ_CODE = 1, 2


class RobotisRXTwin(ServoTwin):
    """One servo. `table` is its memory; `self["goal_position"]` a register's raw number."""

    protocol = "robotis"
    places = RegisterTable(control_table)
    ram_start = EEPROM
    faults: ClassVar[Mapping[str, str]] = {
        "hot": "is 5 °C above its highest temperature (or as hot as said, °C)",
        "low_voltage": "has 0.5 V less than its lowest voltage (or as much as said, V)",
        "jam": "cannot turn: where it should, it pushes until it is overloaded",
        "overload": "reports an overload",
    }

    def make(self) -> None:
        """Make it as delivered, with the speed, delay and level of the file, and the joint where the world has it."""
        self._factory()
        self.tune()
        self["model_number"] = MODELS.get(self.config.model or "", 28)
        self["return_delay"] = round(self.settings.return_delay_us / 2)
        self["status_return_level"] = self.settings.status_return_level
        joint = self.joints[0] if self.joints else None
        if joint is not None:
            self.world.joints[joint.name] = self
            if joint.command == "duty" or joint.type == "continuous":
                self["ccw_angle_limit"] = 0
        scale, start = JointScale.of(joint, 1.0 / STEP), 512.0
        if joint is not None:
            start = max(0.0, min(float(TOP), scale.raw_angle(self.world.start_of(joint.name))))
        self.motion = ShaftMotion(self, scale, start)

    def _factory(self) -> None:
        self.load_defaults(0, EEPROM)
        self["max_torque"] = TOP
        self["firmware_version"] = FIRMWARE

    def begin(self) -> None:
        """Load the RAM's defaults; the goal is the present place."""
        self.blinks = False
        super().begin()
        self.load_defaults(EEPROM, len(self.table))
        self["torque_limit"] = self["max_torque"]
        self.motion.settle(self.clock.now())
        self["goal_position"] = min(TOP, round(self.motion.at))
        self.apply()

    @property
    def last_count(self) -> int:
        """The last position of a turn, in counts of its shaft."""
        return TOP

    # ------------------------------------------------------------------ motion

    def load_table(self, table: bytes) -> None:
        """Do what `ServoTwin.load_table` does; it is where that was read."""
        super().load_table(table)
        self.motion.settle(self.clock.now())
        self.motion.at = float(self["present_position"])
        self.apply()

    def position(self, now: int) -> float:
        """Return the joint's angle (rad)."""
        return self.motion.scale.angle(self.motion.position(now))

    @property
    def is_endless(self) -> bool:
        """True if the servo turns without end: both angle limits are 0."""
        return not any(self.table[0x06:0x0A])

    def before_write(self) -> None:
        """Settle the motion up to now."""
        self.motion.settle(self.clock.now())

    def apply(self) -> None:
        """Apply the registers to the motion."""
        motion, law = self.motion, self.motion.law
        motion.is_driven = bool(self["torque_enable"])
        motion.is_jammed = "jam" in self.active_faults
        law.limit, law.punch = min(TOP, self["torque_limit"]), self["punch"]
        law.margin = (self["cw_compliance_margin"], self["ccw_compliance_margin"])
        law.slope = (self["cw_compliance_slope"], self["ccw_compliance_slope"])
        speed = self["moving_speed"]
        motion.duty = signed(speed) / TOP if self.is_endless else None
        law.speed = speed & TOP
        law.goal = float(self["goal_position"])
        motion.apply(self.clock.now())

    def measure(self) -> int:
        """Bring what is measured up to date; the error bits that hold now."""
        now = self.clock.now()
        motion, faults = self.motion, self.active_faults
        if motion.is_jammed is not ("jam" in faults):
            self.apply()
        self["present_position"] = max(0, min(TOP, round(motion.position(now))))
        speed, drive = motion.speed_at(now), motion.drive_at(now)
        self["present_speed"] = to_directed(round(max(-FREE, min(FREE, speed / PER_SPEED))), 10)
        self["present_load"] = to_directed(round(drive * TOP), 10)
        moves = motion.is_moving(now)
        self["moving"] = moves
        self["registered_instruction"] = self.is_holding
        bits = self.alarms(
            ERRORS,
            pushes=motion.pushes,
            hottest="highest_temperature",
            lowest="lowest_voltage",
            highest="highest_voltage",
            supply=SUPPLY,
            warmth=round(WARMTH + motion.warming),
        )
        self.blinks = bool(bits & self["alarm_led"])
        if bits & self["alarm_shutdown"] and self["torque_enable"]:
            self["torque_enable"] = 0
            self.apply()
        return bits

    # ------------------------------------------------------------------ instructions

    def refused(self, why: str) -> int:
        """Return the error bit of a refusal."""
        return 1 << ERRORS[why] if why else 0

    def with_errors(self, refusal: int, errors: int) -> int:
        """Return errors and alarms as bits of one byte."""
        return refusal | errors

    def wrong_place(self, address: int, codec: RegisterCodec | None) -> str:
        """Return the error of an address: locked, or read only."""
        if self["lock"] and address not in UNLOCKED:
            return "range"
        return super().wrong_place(address, codec)

    def wrong_value(self, name: str, value: int) -> str:
        """Return the error of a value: a goal outside the angle limits; in endless turn the moving speed has
        a direction.
        """
        if name == "moving_speed" and self.is_endless:
            return "" if value <= CLOCKWISE | TOP else "range"
        why = super().wrong_value(name, value)
        if why or name != "goal_position" or self.is_endless:
            return why
        return "" if self["cw_angle_limit"] <= value <= self["ccw_angle_limit"] else "angle_limit"

    @on("Reset")
    def reset(self, request: Record) -> None:
        """Set all as from the factory."""
        self.answer(request, WRITE)
        self._factory()
        self.begin()
        self.twins.renumber(self, id=self["id"])

    def not_understood(self, data: bytes, reason: str) -> None:
        """Answer a packet with a wrong checksum, or with an unknown instruction, with that error."""
        if len(data) < 6 or data[2] != self.credentials["id"] or not self.is_powered or not self.is_tuned:
            return
        if self.clock.now() - self.spoke_at < QUIET_NS or not data[4]:
            return  # another servo's status, which has its error bits where an instruction has its code
        size = data[3] + 4
        if reason == "malformed: checksum" and 6 <= size <= len(data):
            if data[4] != PING_CODE:
                self.answer(None, READ if data[4] == READ_CODE else WRITE, "checksum")
        elif reason == "unknown" and size == len(data):
            self.answer(None, WRITE, "instruction")
