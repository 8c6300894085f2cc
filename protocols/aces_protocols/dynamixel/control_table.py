"""The control table of the X series, a line a register; its addresses agree in all models that `models.py` lists.

1. Units are the sheet's: °, rpm, V, °C, µs, ms, and % where the sheet counts 1/885. Ranges and defaults are raw.
2. Currents and the gains are raw: the unit of a current is the model's (`XModel.current_step_a`).
3. What only some models have (or what has another default in each) is here without a default.

Source: ROBOTIS e-manual, control tables of XM430-W350, XM540-W270, XL430-W250 and XL330-M288.
"""

from __future__ import annotations

from functools import partial

from construct import Byte, Int16sl, Int16ul, Int32sl, Int32ul

from aces_bus.protocol import Enumeration, Flags
from aces_bus.protocol.declare.registers import RegisterMap
from aces_protocols.robotis.fields import RateTable, switch

from .models import MODELS

#: Bits of `hardware_error`; `shutdown` is a mask of them.
HARDWARE_ERRORS = {"voltage": 0, "overheating": 2, "encoder": 3, "electrical_shock": 4, "overload": 5}
#: What `operating_mode` may be.
MODES = {
    "current": 0,
    "velocity": 1,
    "position": 3,
    "extended_position": 4,
    "current_based_position": 5,
    "pwm": 16,
}
RATES = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)

ANGLE = 360 / 4096  # ° a count
SPEED = 0.229  # rpm a count
ACCELERATION = 214.577  # rpm/min a count
SHARE = 100 / 885  # % a count
VOLT = 0.1  # V a count
#: `bus_watchdog` after it has stopped the servo: no goal is taken until 0 is written.
WATCHDOG_ERROR = 0xFF


def add_x_registers(table: RegisterMap) -> None:
    """Declare all registers in `table`."""
    add = partial(table.add, source="ROBOTIS e-manual, control table of the X series")
    read = partial(add, access="read")

    # ------------------------------------------------------------------ EEPROM: written with the torque off only
    read(
        "model_number", 0, Enumeration(Int16ul, {m.name: m.number for m in MODELS}), doc="Which servo it is."
    )
    read("model_information", 2, Int32ul, doc="Of the maker.")
    read("firmware_version", 6, Byte, doc="Version of the firmware.")
    add("id", 7, Byte, range=(0, 252), default=1, doc="The servo's identifier on its line.")
    add("baud_rate", 8, RateTable(Byte, RATES), unit="baud", default=1, doc="Speed of the line.")
    add(
        "return_delay", 9, Byte, unit="µs", scale=2, range=(0, 254), default=250, doc="Pause before a status."
    )
    add(
        "drive_mode",
        10,
        Flags(Byte, reverse=0, time_based_profile=2, torque_on_by_goal=3),
        default=0,
        doc="Reversed direction; profiles in ms; a goal switches the torque on.",
    )
    add("operating_mode", 11, Enumeration(Byte, MODES), default=3, doc="What goals it follows.")
    add("secondary_id", 12, Byte, default=255, doc="A second identifier, of a group; from 253 on: none.")
    add("protocol_type", 13, Byte, range=(1, 22), default=2, doc="Which protocol it speaks; 2 is this one.")
    add(
        "homing_offset",
        20,
        Int32sl,
        unit="°",
        scale=ANGLE,
        range=(-1_044_479, 1_044_479),
        default=0,
        doc="Added to the position.",
    )
    add(
        "moving_threshold",
        24,
        Int32ul,
        unit="rpm",
        scale=SPEED,
        range=(0, 1023),
        default=10,
        doc="Faster than this it counts as moving.",
    )
    add("temperature_limit", 31, Byte, unit="°C", range=(0, 100), doc="Above it: error `overheating`.")
    add("max_voltage_limit", 32, Int16ul, unit="V", scale=VOLT, doc="Above it: error `voltage`.")
    add("min_voltage_limit", 34, Int16ul, unit="V", scale=VOLT, doc="Below it: error `voltage`.")
    add("pwm_limit", 36, Int16ul, unit="%", scale=SHARE, range=(0, 885), default=885, doc="Greatest PWM.")
    add("current_limit", 38, Int16ul, doc="Greatest current, in the model's unit; not in XL430.")
    add(
        "velocity_limit", 44, Int32ul, unit="rpm", scale=SPEED, range=(0, 2047), doc="Greatest goal velocity."
    )
    add(
        "max_position_limit",
        48,
        Int32ul,
        unit="°",
        scale=ANGLE,
        range=(0, 4095),
        default=4095,
        doc="Greatest goal in position mode.",
    )
    add(
        "min_position_limit",
        52,
        Int32ul,
        unit="°",
        scale=ANGLE,
        range=(0, 4095),
        default=0,
        doc="Least goal in position mode.",
    )
    add(
        "startup_configuration",
        60,
        Byte,
        default=0,
        doc="Torque on at power-up, RAM from a backup; not in old firmware.",
    )
    add("shutdown", 63, Flags(Byte, HARDWARE_ERRORS), doc="Errors that switch the torque off.")

    # ------------------------------------------------------------------ RAM
    add("torque_enable", 64, switch(), default=0, doc="Whether the motor is driven.")
    add("led", 65, switch(), default=0, doc="The LED.")
    add(
        "status_return_level",
        68,
        Enumeration(Byte, none=0, read_only=1, all=2),
        default=2,
        doc="Which instructions are answered: none, Read alone, or all. Ping always is.",
    )
    read("registered_instruction", 69, Byte, default=0, doc="Not 0 while a RegWrite waits for its Action.")
    read(
        "hardware_error", 70, Flags(Byte, HARDWARE_ERRORS), default=0, doc="What is wrong; cleared by Reboot."
    )
    for name, address, what in (
        ("velocity_i_gain", 76, "raw ÷ 65536"),
        ("velocity_p_gain", 78, "raw ÷ 128"),
        ("position_d_gain", 80, "raw ÷ 16"),
        ("position_i_gain", 82, "raw ÷ 65536"),
        ("position_p_gain", 84, "raw ÷ 128"),
        ("feedforward_2nd_gain", 88, "raw ÷ 4"),
        ("feedforward_1st_gain", 90, "raw ÷ 4"),
    ):
        add(name, address, Int16ul, range=(0, 16_383), doc=f"Gain of the controller: {what}.")
    add(
        "bus_watchdog",
        98,
        Byte,
        unit="ms",
        scale=20,
        range=(0, 127),
        default=0,
        doc="Without an instruction for so long it stops, and takes no goal; 0: never, and clears that (raw 255).",
    )
    add(
        "goal_pwm",
        100,
        Int16sl,
        unit="%",
        scale=SHARE,
        range=(-885, 885),
        doc="PWM; in other modes its limit.",
    )
    add("goal_current", 102, Int16sl, range=(-2047, 2047), doc="Current, in the model's unit; not in XL430.")
    add("goal_velocity", 104, Int32sl, unit="rpm", scale=SPEED, range=(-2047, 2047), doc="How fast to turn.")
    add(
        "profile_acceleration",
        108,
        Int32ul,
        unit="rpm/min",
        scale=ACCELERATION,
        range=(0, 32_767),
        default=0,
        doc="Acceleration on the way; 0: none set.",
    )
    add(
        "profile_velocity",
        112,
        Int32ul,
        unit="rpm",
        scale=SPEED,
        range=(0, 32_767),
        default=0,
        doc="Speed on the way to a goal; 0: none set.",
    )
    add(
        "goal_position",
        116,
        Int32sl,
        unit="°",
        scale=ANGLE,
        range=(-1_048_575, 1_048_575),
        doc="Where to go.",
    )
    read("realtime_tick", 120, Int16ul, unit="ms", doc="Counts up to 32767, then from 0.")
    read("moving", 122, switch("no", "yes"), default=0, doc="Whether it is faster than `moving_threshold`.")
    read("moving_status", 123, Byte, default=0, doc="Of the profile: arrived, on its way, kind.")
    read("present_pwm", 124, Int16sl, unit="%", scale=SHARE, doc="PWM that it is driven with.")
    read("present_current", 126, Int16sl, doc="Current, in the model's unit; XL430: load in 0.1 %.")
    read("present_velocity", 128, Int32sl, unit="rpm", scale=SPEED, doc="How fast it turns.")
    read("present_position", 132, Int32sl, unit="°", scale=ANGLE, doc="Where it is.")
    read("velocity_trajectory", 136, Int32sl, unit="rpm", scale=SPEED, doc="Speed that the profile asks for.")
    read(
        "position_trajectory", 140, Int32sl, unit="°", scale=ANGLE, doc="Position that the profile asks for."
    )
    read("present_voltage", 144, Int16ul, unit="V", scale=VOLT, doc="Supply voltage.")
    read("present_temperature", 146, Byte, unit="°C", doc="Inside the servo.")
    read("backup_ready", 147, Byte, doc="Whether there is a backup; not in old firmware.")
