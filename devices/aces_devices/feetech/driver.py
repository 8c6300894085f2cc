"""Feetech's STS, SMS and SCS servos: what they have beyond what all servos have.

1. A servo follows positions, or (STS, SMS) speeds; as the mode survives power-off, none is changed by itself.
2. What survives power-off is written between an open and a locked `lock`.
3. They have no watchdog: one whose host is gone holds its goal, or goes on turning.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

from aces_bus.device import HostLoss, Job, Robot, Steps
from aces_bus.device.config import DeviceConfig
from aces_bus.device.host import Host
from aces_bus.errors import CallerError
from aces_bus.protocol import Record, Variant
from aces_bus.protocol.record import FieldValue
from aces_protocols.feetech.control_table import ERRORS, SCS_ANGLE, STS_ANGLE
from aces_protocols.feetech.models import MODEL_NAMES
from aces_protocols.feetech.spec import scs_table, sts_table
from aces_protocols.robotis.fields import from_directed, to_directed

from ..servos.driver import ACTIONS, BROADCAST, ServoDevice

#: Counts a second that a set-point of speed may have (the register's sign bit is 15).
FASTEST = 0x7FFF
#: The greatest torque (0.1 %).
FULL = 1000
#: A count of the current (A).
CURRENT_A = 6.5e-3


def series_of(config: DeviceConfig) -> str:
    """Return the series whose control table a servo has, by its model in the robot's file; STS if that says none."""
    model = MODEL_NAMES.get(config.model or "")
    return "STS" if model is None else model.series


class Feetech(ServoDevice):
    """One STS, SMS or SCS servo."""

    protocol = "feetech"
    when_host_is_lost = HostLoss(
        "goes on",
        "Feetech STS and SCS memory tables: no time-out",
        detail="it holds its goal with torque on, or turns on",
    )
    registers = sts_table
    eeprom = range(40)
    together_overhead = 8
    together_read = "SyncRead"
    together_fields: ClassVar[Mapping[str, FieldValue]] = {"id": BROADCAST}
    streamed = frozenset(("goal_position",))
    remembers = frozenset(("torque_enable", "acceleration", "torque_limit"))
    shutdown_register = "unload_condition"
    start_span = ("model_number", "operating_mode")
    health_span = ("torque_enable", "present_current")
    error_bits = ERRORS
    goals_by_command: Mapping[str, str] = {"position": "goal_position", "speed": "goal_speed"}
    mode_register = "operating_mode"
    level_offset = 1
    actions: ClassVar[Mapping[str, str]] = {
        **{name: text for name, text in ACTIONS.items() if name != "factory_reset"},
        "set_mode": "have it in the mode that its joint is commanded by; with confirm=true",
        "home_here": "make the present position the middle of its turn (STS, SMS); with confirm=true",
    }

    def __init__(self, host: Host, config: DeviceConfig, robot: Robot, variant: Variant) -> None:
        #: Whose control table it has: "STS" or "SCS".
        self.series = series_of(config)
        if self.series == "SCS":
            self.registers, self.together_read = scs_table, ""
            self.mode_register, self.start_span = "", ("model_number", "unload_condition")
            self.goals_by_command = {"position": "goal_position"}
            self.health_span = ("torque_enable", "moving")
        self.turn = 4096 if self.series == "STS" else 1024
        self.count_rad = math.radians(STS_ANGLE if self.series == "STS" else SCS_ANGLE)
        self.speed_count_rad_s = self.count_rad
        super().__init__(host, config, robot, variant)

    # ------------------------------------------------------------------ a family's own

    def command_of_joint(self) -> str:
        """Return what the robot's file says; a joint that turns without end has no positions here."""
        joint = self.joints[0] if self.joints else None
        if joint is not None and joint.type == "continuous" and joint.command == "position":
            raise CallerError(
                f'{self.name}: a joint that turns without end takes speeds here: command = "speed"'
            )
        return super().command_of_joint()

    def wanted_mode(self) -> str:
        """Return position or velocity."""
        return "velocity" if self.command == "speed" else "position"

    def range_counts(self) -> tuple[int, int]:
        """Return one turn."""
        return 0, self.turn - 1

    def speed_limit_counts(self) -> int:
        """Return what the register takes."""
        return FASTEST

    def signed(self, raw: int) -> int:
        """Return counts with bit 15 as their sign."""
        return from_directed(raw, 15)

    def unsigned(self, count: int) -> int:
        """Return counts with their sign in bit 15."""
        return to_directed(count, 15)

    def declare_more(self, owner: str, motion: Mapping[str, Any], health: Mapping[str, Any]) -> None:
        """Load, current, limits of speed and torque."""
        direction, speed_step = self.direction, self.speed_step
        self.register_signal(
            "load",
            "present_load",
            to_si=lambda raw: from_directed(raw, 10) / FULL * direction + 0.0,
            doc="The drive as a share of the greatest, -1 to 1.",
            **motion,
        )
        if self.command == "position":
            self.register_signal(
                "speed_limit",
                "goal_speed",
                to_si=lambda raw: abs(self.signed(raw)) * speed_step,
                set="goal_speed",
                to_raw=lambda value: max(1, round(value / speed_step)) if value else 0,
                unit="rad/s",
                lower=0.0,
                upper=FASTEST * speed_step,
                doc="Speed on the way to a goal; 0: as fast as it can.",
                **health,
            )
        if self.series == "STS":
            self.register_signal(
                "current",
                "present_current",
                to_si=lambda raw: raw * CURRENT_A,
                unit="A",
                doc="The motor's current, without a direction.",
                **health,
            )
            self.declare_torque_limit(FULL)

    def learned(self, table: Mapping[str, int]) -> None:
        """Limit the joint to the servo's own limits."""
        self.limit_to(table["min_position_limit"], table["max_position_limit"])

    def refusal(self, record: Record) -> str:
        """Return no reason: a status of these servos says nothing about the request."""
        return ""

    # ------------------------------------------------------------------ what survives power-off

    def unlock(self) -> Steps:
        """Return what is written from now on survives power-off."""
        yield super().write("lock", "open")

    def lock(self) -> Steps:
        """Yield steps after which written values are lost without power."""
        yield super().write("lock", "locked")

    def write(self, name: str, value: Any, *, confirm: bool = False, raw: bool = False) -> Job:
        """Do what `RegisterDevice.write` does; what survives power-off is written unlocked, and locked again."""
        writing = super().write
        codec = self.codec(name)
        if codec.address not in self.eeprom:
            return writing(name, value, confirm=confirm, raw=raw)
        codec.raw(value, is_raw=raw)
        self.check_write(name, confirm)

        def steps(job: Job) -> Steps:
            yield from self.unlock()
            yield writing(name, value, confirm=confirm, raw=raw)
            yield from self.lock()

        return self.job(f"write {name}", steps)

    def check_write(self, name: str, confirm: bool = False) -> None:
        """Do what `RegisterDevice.check_write` does; what survives power-off is written without torque only."""
        super().check_write(name, confirm)
        if self.codec(name).address in self.eeprom and self.cached("torque_enable", raw=True) == 1:
            raise CallerError(
                f"{self.name}: register {name} survives power-off: disable the servo before it is written"
            )

    def home_here(self, *, confirm: bool) -> Job:
        """Make the present position the middle of its turn (count 2047), by `homing_offset`. Raises `CallerError`."""
        if self.series != "STS":
            raise CallerError(f"{self.name}: SCS servos have no homing offset")
        middle = self.turn // 2 - 1
        self.check_write("homing_offset", confirm)

        def steps(job: Job) -> Steps:
            offset = yield self.read("homing_offset", raw=True)
            here = yield self.read("present_position", raw=True)
            sensor = (self.signed(here) + from_directed(offset, 11)) % self.turn
            # The register has 11 bits and a sign: of a whole turn both ends are a count short.
            wanted = max(-middle, min(middle, sensor - middle))
            yield self.write("homing_offset", to_directed(wanted, 11), confirm=True, raw=True)

        return self.job("home here", steps)
