"""Robotis RX-10, RX-28 and RX-64: what they have beyond what all servos have."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from aces_bus.device import HostLoss
from aces_bus.errors import CallerError
from aces_protocols.robotis.control_table import ANGLE, ERRORS, SPEED
from aces_protocols.robotis.fields import from_directed
from aces_protocols.robotis.spec import control_table

from ..servos.driver import ServoDevice

#: rad a count: 300° are 1023 counts (RX-28 manual).
STEP = math.radians(ANGLE)
TOP = 1023
#: Bit 10 of speed, load and drive: clockwise (RX-28 manual).
CLOCKWISE = 0x400
#: What is added before an angle is cut to whole counts: the angle of a count gives that count.
HAIR = 1e-6
#: The largest SyncWrite packet that an RX-28's receive buffer takes (RX-28 manual).
RECEIVE_BUFFER = 143
#: FF FF, id, length, instruction, start, size; checksum.
AROUND = 8
#: While locked only these addresses stay writable (RX-28 manual).
UNLOCKED = range(0x18, 0x24)


def signed(raw: int) -> int:
    """Return bits 0–9, negative when bit 10 says clockwise."""
    return from_directed(raw, 10)


class RobotisRX(ServoDevice):
    """One RX servo."""

    protocol = "robotis"
    when_host_is_lost = HostLoss(
        "goes on",
        "RX-28 manual, control table: no time-out",
        detail="it holds its goal with torque on, or turns on",
    )
    registers = control_table
    eeprom = range(0x18)
    together_bytes = RECEIVE_BUFFER
    together_overhead = AROUND
    streamed = frozenset(("goal_position",))
    remembers = frozenset(
        (
            "torque_enable",
            "led",
            "moving_speed",
            "torque_limit",
            "lock",
            "punch",
            *(f"{side}_compliance_{what}" for side in ("cw", "ccw") for what in ("margin", "slope")),
        )
    )
    start_span = ("model_number", "alarm_shutdown")
    goals_by_command: Mapping[str, str] = {"position": "goal_position", "duty": "moving_speed"}
    error_bits = ERRORS
    of_request = frozenset(("angle_limit", "range", "checksum", "instruction"))
    count_rad = STEP
    speed_count_rad_s = SPEED * math.tau / 60

    def command_of_joint(self) -> str:
        """Return a joint that turns without end has a duty; others have positions."""
        joint = self.joints[0] if self.joints else None
        turns = joint is not None and (joint.command == "duty" or joint.type == "continuous")
        return "duty" if turns else "position"

    def range_counts(self) -> tuple[int, int]:
        """Return the counts of 0 to 300°."""
        return 0, TOP

    def signed(self, raw: int) -> int:
        """Return speed or load; bit 10 is clockwise."""
        return signed(raw)

    def at_count(self, raw: int) -> int:
        """Return a position, which has no sign; beyond 300° the servo cannot say where it is."""
        return min(raw, TOP)

    def goal_at(self, here: int) -> int:
        """Return the goal for the present place, within 300°."""
        return min(here, TOP)

    def counts(self, position: float) -> int:
        """Return the goal of a joint position (rad): cut to whole counts as MiniHubo's software does, clipped to 0…1023."""
        return max(0, min(TOP, int((self.direction * position + self.zero) / self.step + HAIR)))

    def drive(self, duty: float) -> int:
        """Return the moving speed of a torque share in endless turn: magnitude, and bit 10 for clockwise."""
        size = min(TOP, round(abs(duty) * TOP))
        return size | CLOCKWISE if duty * self.direction < 0 and size else size

    def declare_more(self, owner: str, motion: Mapping[str, Any], health: Mapping[str, Any]) -> None:
        """Load; duty in endless turn, else the speed limit; torque limit."""
        direction, speed_step = self.direction, self.speed_step
        self.register_signal(
            "load",
            "present_load",
            to_si=lambda raw: signed(raw) / TOP * direction + 0.0,
            doc="The drive as a share of the greatest torque, -1 to 1.",
            **motion,
        )
        if self.command == "duty":
            self.register_signal(
                "duty",
                "moving_speed",
                to_si=lambda raw: signed(raw) / TOP * direction + 0.0,
                set="moving_speed",
                to_raw=self.drive,
                lower=-1.0,
                upper=1.0,
                doc="Endless turn: the torque as a share of the greatest.",
                **health,
            )
        else:
            self.register_signal(
                "speed_limit",
                "moving_speed",
                to_si=lambda raw: (raw & TOP) * speed_step,
                set="moving_speed",
                to_raw=lambda value: max(1, min(TOP, round(value / speed_step))) if value else 0,
                unit="rad/s",
                lower=0.0,
                upper=TOP * speed_step,
                doc="Speed on the way to a goal; 0: as fast as it can.",
                **health,
            )
        self.declare_torque_limit(TOP)

    def learned(self, table: Mapping[str, int]) -> None:
        """Limit the joint to the servo's own limits; both 0 mean endless turn."""
        low, high = table["cw_angle_limit"], table["ccw_angle_limit"]
        turns = self.command == "duty"
        if (low == high == 0) != turns:
            self.emit_event(
                "alarm",
                "it turns without end (both angle limits are 0), the joint does not"
                if not turns
                else f"the joint turns without end, its servo from count {low} to {high}: set both angle limits to 0",
            )
        else:
            self.limit_to(low, high)

    def check_write(self, name: str, confirm: bool = False) -> None:
        """Raise `CallerError` for what can only be read, needs `confirm`, or is locked."""
        super().check_write(name, confirm)
        if self.cached("lock", raw=True) == 1 and self.codec(name).address not in UNLOCKED:
            raise CallerError(
                f"{self.name}: register {name} is locked until the servo is switched off; 0x18–0x23 can be written"
            )
