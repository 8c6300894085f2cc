"""The control tables of STS and SMS servos, and of SCS servos: a line a register.

1. Units are the sheet's: °, V, °C, µs, ms, %, counts a second. Ranges and defaults are raw.
2. Numbers with a sign have it in a bit of its own; which one is said where they are declared.

Source: LeRobot motors/feetech/tables.py, FTServo_Python; what is marked "sheet" in the README is of neither.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from construct import Byte, Int16ub, Int16ul

from aces_bus.protocol import Enumeration, Flags
from aces_bus.protocol.declare.registers import RegisterMap
from aces_protocols.robotis.fields import Directed, RateTable, switch

from .models import MODELS

#: Error bits of a status packet, of the register `status`, and of the masks `unload_condition` and `led_condition`.
ERRORS = {"voltage": 0, "sensor": 1, "overheating": 2, "current": 3, "overload": 5}
MODES = {"position": 0, "velocity": 1, "pwm": 2, "step": 3}
#: Settings of the line's speed; from the sixth on as Feetech's own kit has them.
RATES = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)

VOLT = 0.1  # V a count
SHARE = 0.1  # % a count
STS_ANGLE = 360 / 4096  # ° a count
SCS_ANGLE = 300 / 1024  # ° a count, of SCS0009 about
CURRENT = 6.5  # mA a count


def _add_common(table: RegisterMap, add: Any, word: Any, angle: float, series: str) -> None:
    """Add the registers that both series have, up to the controller's gains."""
    read = partial(add, access="read")
    read("firmware_major", 0, Byte, doc="Version of the firmware.")
    read("firmware_minor", 1, Byte, doc="Version of the firmware, behind the point.")
    read(
        "model_number",
        3,
        Enumeration(word, {m.name: m.number for m in MODELS if m.series == series}),
        doc="Which servo it is.",
    )
    add("id", 5, Byte, range=(0, 253), default=1, doc="The servo's identifier on its line.")
    add("baud_rate", 6, RateTable(Byte, RATES), unit="baud", default=0, doc="Speed of the line.")
    add(
        "return_delay", 7, Byte, unit="µs", scale=2, range=(0, 254), default=250, doc="Pause before a status."
    )
    add(
        "status_return_level",
        8,
        Enumeration(Byte, read_only=0, all=1),
        default=1,
        doc="Which instructions are answered: Read and Ping alone, or all.",
    )
    top = round(360 / STS_ANGLE) - 1 if angle == STS_ANGLE else 1023
    add("min_position_limit", 9, word, unit="°", scale=angle, range=(0, top), default=0, doc="Least goal.")
    add(
        "max_position_limit",
        11,
        word,
        unit="°",
        scale=angle,
        range=(0, top),
        default=top,
        doc="Greatest goal.",
    )
    add(
        "max_temperature",
        13,
        Byte,
        unit="°C",
        range=(0, 100),
        default=70,
        doc="Above it: error `overheating`.",
    )
    add("max_voltage", 14, Byte, unit="V", scale=VOLT, default=140, doc="Above it: error `voltage`.")
    add("min_voltage", 15, Byte, unit="V", scale=VOLT, default=40, doc="Below it: error `voltage`.")
    add("max_torque", 16, word, unit="%", scale=SHARE, range=(0, 1000), default=1000, doc="Greatest torque.")
    add("phase", 18, Byte, doc="Flags of the maker; bit 4 set: positions beyond one turn.")
    add("unload_condition", 19, Flags(Byte, ERRORS), default=44, doc="Errors that switch the torque off.")
    add("led_condition", 20, Flags(Byte, ERRORS), default=47, doc="Errors that make the LED blink.")
    add("p_gain", 21, Byte, default=32, doc="Gain of the position controller.")
    add("d_gain", 22, Byte, default=32, doc="Damping of the position controller.")
    add("i_gain", 23, Byte, default=0, doc="Integral gain of the position controller.")
    add("minimum_force", 24, word, unit="%", scale=SHARE, range=(0, 1000), doc="Least drive of the motor.")
    add(
        "cw_dead_zone",
        26,
        Byte,
        default=1,
        doc="How far from the goal nothing is done yet, clockwise (counts).",
    )
    add("ccw_dead_zone", 27, Byte, default=1, doc="The same, counter-clockwise (counts).")


def _add_measured(read: Any, word: Any, position: Any, speed: Any, load: Any, angle: float) -> None:
    """Add the measured registers."""
    read("present_position", 56, position, unit="°", scale=angle, doc="Where it is.")
    read("present_speed", 58, speed, doc="How fast it turns (counts a second).")
    read("present_load", 60, load, unit="%", scale=SHARE, doc="The drive as a share of the greatest.")
    read("present_voltage", 62, Byte, unit="V", scale=VOLT, doc="Supply voltage.")
    read("present_temperature", 63, Byte, unit="°C", doc="Inside the servo.")
    read("status", 65, Flags(Byte, ERRORS), doc="What is wrong.")
    read("moving", 66, switch("no", "yes"), doc="Whether it is on its way to a goal.")


def add_sts_registers(table: RegisterMap) -> None:
    """Declare the registers of STS and SMS servos."""
    add = partial(table.add, source="LeRobot motors/feetech, STS and SMS series")
    read = partial(add, access="read")
    signed = Directed(Int16ul, 15)
    _add_common(table, add, Int16ul, STS_ANGLE, "STS")
    add(
        "protection_current",
        28,
        Int16ul,
        unit="mA",
        scale=CURRENT,
        default=500,
        doc="Above it: error `current`.",
    )
    add("angular_resolution", 30, Byte, default=1, doc="Counts that a step of the sensor is.")
    add(
        "homing_offset",
        31,
        Directed(Int16ul, 11),
        unit="°",
        scale=STS_ANGLE,
        default=0,
        doc="Taken off the sensor's position; its sign is bit 11.",
    )
    add("operating_mode", 33, Enumeration(Byte, MODES), default=0, doc="What goals it follows.")
    add("protective_torque", 34, Byte, unit="%", default=20, doc="Torque after an overload.")
    add("protection_time", 35, Byte, unit="ms", scale=10, default=200, doc="How long an overload may last.")
    add("overload_torque", 36, Byte, unit="%", default=80, doc="Torque from which it counts as overloaded.")
    add("velocity_p_gain", 37, Byte, default=10, doc="Gain of the velocity controller.")
    add(
        "overcurrent_time",
        38,
        Byte,
        unit="ms",
        scale=10,
        default=200,
        doc="How long too much current may last.",
    )
    add("velocity_i_gain", 39, Byte, default=200, doc="Integral gain of the velocity controller.")
    add("torque_enable", 40, switch(), default=0, doc="Whether the motor is driven.")
    add(
        "acceleration",
        41,
        Byte,
        range=(0, 254),
        default=0,
        doc="On the way (100 counts/s²); 0: as much as it can.",
    )
    add("goal_position", 42, signed, unit="°", scale=STS_ANGLE, doc="Where to go; its sign is bit 15.")
    add("goal_time", 44, Int16ul, doc="Not used by the driver.")
    add(
        "goal_speed",
        46,
        signed,
        doc="Speed on the way, 0: none set; in velocity mode the goal (counts a second).",
    )
    add(
        "torque_limit",
        48,
        Int16ul,
        unit="%",
        scale=SHARE,
        range=(0, 1000),
        doc="A copy of `max_torque` at power-up.",
    )
    add(
        "lock",
        55,
        switch("open", "locked"),
        default=1,
        doc="Locked: what is written below 40 is lost without power.",
    )
    _add_measured(read, Int16ul, signed, signed, Directed(Int16ul, 10), STS_ANGLE)
    read("present_current", 69, Int16ul, unit="mA", scale=CURRENT, doc="The motor's current.")
    for name, address in (
        ("moving_threshold", 80),
        ("control_period", 81),
        ("velocity_unit", 82),
        ("hts", 83),
        ("maximum_velocity", 84),
        ("maximum_acceleration", 85),
        ("acceleration_multiplier", 86),
    ):
        add(name, address, Byte, doc="Of the maker, after the table that users have.")


def add_scs_registers(table: RegisterMap) -> None:
    """Declare the registers of SCS servos."""
    add = partial(table.add, source="LeRobot motors/feetech, SCS series")
    read = partial(add, access="read")
    _add_common(table, add, Int16ub, SCS_ANGLE, "SCS")
    add("protective_torque", 37, Byte, unit="%", default=20, doc="Torque after an overload.")
    add("protection_time", 38, Byte, unit="ms", scale=10, default=200, doc="How long an overload may last.")
    add("torque_enable", 40, switch(), default=0, doc="Whether the motor is driven.")
    add("acceleration", 41, Byte, default=0, doc="On the way; 0: as much as it can.")
    add("goal_position", 42, Int16ub, unit="°", scale=SCS_ANGLE, range=(0, 1023), doc="Where to go.")
    add("goal_time", 44, Int16ub, doc="Not used by the driver.")
    add("goal_speed", 46, Int16ub, range=(0, 0x7FFF), doc="Speed on the way (counts a second); 0: none set.")
    add(
        "lock",
        48,
        switch("open", "locked"),
        default=1,
        doc="Locked: what is written below 40 is lost without power.",
    )
    _add_measured(read, Int16ub, Int16ub, Directed(Int16ub, 15), Directed(Int16ub, 10), SCS_ANGLE)
