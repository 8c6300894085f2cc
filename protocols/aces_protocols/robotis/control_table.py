"""The control table of RX servos: every register, line by line as the vendor's sheet has it.

1. Units are the sheet's: °, rpm, V, °C, µs, baud, and % where the sheet counts 1/1023. Ranges and defaults are raw.
2. Angles grow counter-clockwise: 0° is count 0, 150° is count 512 (the centre), 300° is count 1023.
3. Bytes that the sheet leaves out stay out: 0x0A, 0x13–0x17, 0x2D.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from construct import Byte, Int16ul

from aces_bus.errors import FieldError
from aces_bus.protocol import Enumeration, Field, Flags
from aces_bus.protocol.declare.registers import RegisterMap

from .fields import TOLERANCE, Directed, switch

#: Error bits of a status packet; the alarm registers are masks of the same bits.
ERRORS = {
    "voltage": 0,
    "angle_limit": 1,
    "overheating": 2,
    "range": 3,
    "checksum": 4,
    "overload": 5,
    "instruction": 6,
}

ANGLE = 300 / 1023  # ° a count
SPEED = 0.111  # rpm a count
SHARE = 100 / 1023  # % a count
VOLT = 0.1  # V a count


class BaudRate(Field):
    """baud = 2 000 000 / (number + 1).

    A rate is taken for the nearest number when that is off by less than 3 %, which is what a receiver tolerates: the
    factory's 34 is 57 142.9 baud and listed as 57 600.

    >>> BaudRate(Byte).parse(bytes([1])), BaudRate(Byte).build(57_600)
    (1000000.0, b'"')
    """

    CLOCK = 2_000_000

    def to_physical(self, raw: Any) -> Any:
        return self.CLOCK / (raw + 1)

    def to_raw(self, value: Any, path: str = "") -> Any:
        if not isinstance(value, (int, float)) or not value > 0:
            raise FieldError(f"{path}: {value!r} is not a rate in baud")
        number = round(self.CLOCK / value) - 1
        if not 0 <= number <= 0xFF or abs(self.to_physical(number) / value - 1) >= TOLERANCE:
            near = self.to_physical(min(max(number, 0), 0xFF))
            raise FieldError(
                f"{path}: no setting is within 3 % of {value!r} baud; the nearest is {near:.0f} baud"
            )
        return number


def add_registers(table: RegisterMap) -> None:
    """Declare all registers in `table`."""
    add = partial(table.add, source="RX-28 manual, control table")
    angle = partial(add, unit="°", scale=ANGLE, range=(0, 1023))
    share = partial(add, unit="%", scale=SHARE, range=(0, 1023))

    # ------------------------------------------------------------------ EEPROM
    add(
        "model_number",
        0x00,
        Enumeration(Int16ul, {"RX-10": 10, "RX-28": 28, "RX-64": 64}),
        access="read",
        doc="Which servo it is.",
    )
    add("firmware_version", 0x02, Byte, access="read", doc="Version of the firmware.")
    add("id", 0x03, Byte, range=(0, 253), default=1, doc="The servo's identifier on its line.")
    add("baud_rate", 0x04, BaudRate(Byte), unit="baud", default=34, doc="Speed of the line.")
    add(
        "return_delay",
        0x05,
        Byte,
        unit="µs",
        scale=2,
        range=(0, 254),
        default=250,
        doc="How long a servo waits before its status.",
    )
    angle("cw_angle_limit", 0x06, Int16ul, default=0, doc="Least goal. Both limits 0: endless turn.")
    angle("ccw_angle_limit", 0x08, Int16ul, default=1023, doc="Greatest goal. Both limits 0: endless turn.")
    add("highest_temperature", 0x0B, Byte, unit="°C", default=80, doc="Above it: error bit `overheating`.")
    add("lowest_voltage", 0x0C, Byte, unit="V", scale=VOLT, default=60, doc="Below it: error bit `voltage`.")
    add(
        "highest_voltage", 0x0D, Byte, unit="V", scale=VOLT, default=240, doc="Above it: error bit `voltage`."
    )
    share("max_torque", 0x0E, Int16ul, doc="Copied to `torque_limit` at power-up.")
    add(
        "status_return_level",
        0x10,
        Enumeration(Byte, none=0, read_only=1, all=2),
        doc="Which instructions are answered: none, Read alone, or all. Ping always is.",
    )
    add("alarm_led", 0x11, Flags(Byte, ERRORS), default=36, doc="Errors that make the LED blink.")
    add("alarm_shutdown", 0x12, Flags(Byte, ERRORS), default=36, doc="Errors that switch the torque off.")

    # ------------------------------------------------------------------ RAM
    add("torque_enable", 0x18, switch(), doc="Whether the motor is driven.")
    add("led", 0x19, switch(), doc="The LED.")
    for side, margin, slope in (("cw", 0x1A, 0x1C), ("ccw", 0x1B, 0x1D)):
        add(
            f"{side}_compliance_margin",
            margin,
            Byte,
            unit="°",
            scale=ANGLE,
            range=(0, 254),
            default=0,
            doc="How far from the goal nothing is done yet.",
        )
        add(
            f"{side}_compliance_slope",
            slope,
            Byte,
            range=(1, 254),
            default=32,
            doc="How gently torque falls near the goal; it acts in steps: 4, 8, 16, 32, 64, 128, 254.",
        )
    angle("goal_position", 0x1E, Int16ul, doc="Where to go.")
    add(
        "moving_speed",
        0x20,
        Int16ul,
        unit="rpm",
        scale=SPEED,
        range=(0, 1023),
        doc="Speed on the way; 0 is not a speed control. In endless turn, raw: bits 0–9 torque, bit 10 clockwise.",
    )
    share("torque_limit", 0x22, Int16ul, doc="Greatest torque; a copy of `max_torque` at power-up.")
    angle("present_position", 0x24, Int16ul, access="read", doc="Where it is.")
    add(
        "present_speed",
        0x26,
        Directed(Int16ul),
        unit="rpm",
        scale=SPEED,
        access="read",
        doc="How fast it turns; clockwise is negative. Bit 10 as direction is usual, but not in the manual.",
    )
    add(
        "present_load",
        0x28,
        Directed(Int16ul),
        unit="%",
        scale=SHARE,
        access="read",
        doc="Load, as a share of the greatest torque; clockwise is negative.",
    )
    add("present_voltage", 0x2A, Byte, unit="V", scale=VOLT, access="read", doc="Supply voltage.")
    add("present_temperature", 0x2B, Byte, unit="°C", access="read", doc="Inside the servo.")
    add(
        "registered_instruction",
        0x2C,
        Byte,
        access="read",
        doc="Not 0 while a RegWrite waits for its Action.",
    )
    add("moving", 0x2E, switch("no", "yes"), access="read", doc="Whether it is on its way to a goal.")
    add(
        "lock",
        0x2F,
        switch("open", "locked"),
        doc="Locked: only 0x18–0x23 stay writable, until power-off.",
    )
    add("punch", 0x30, Int16ul, range=(32, 1023), default=32, doc="Least drive of the motor.")
