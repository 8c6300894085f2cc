"""Xsens (Movella) MTi 600 series, Avior and Sirius on CAN: acceleration, rate of turn, orientation and more, a frame each.

1. Which messages come, how often and by which identifier is set over the sensor's serial port; these are the identifiers
   that it has from the factory. CAN is off until it is set.
2. Numbers have the highest byte first, in fixed point. No value stands for "not available": `Status` says how the sensor is.

Source: Xsens, MTi 600-series MT CAN Protocol Documentation, MT1604P rev. A (16 Sept 2019); bits of `Status` as in the MT
Low Level Communication Protocol Documentation, MT0101P. README.md says what they leave open.
"""

from __future__ import annotations

from typing import Any

from construct import Byte, Int16sb, Int16ub, Int32sb, Int32ub, Struct

from aces_bus.protocol import Enumeration, Flags, Protocol, Quantity

xsens_can = Protocol(
    "xsens_can",
    link="can",
    bitrate=250_000,
    doc="Xsens MTi 600 series: an IMU, VRU or AHRS on CAN.",
    source="Xsens MT1604P rev. A",
)


def _message(name: str, number: int, section: str, *fields: Any, doc: str, examples: Any = ()) -> None:
    """Declare what the sensor sends."""
    xsens_can.message(
        name, id=number, direction="from device", payload=Struct(*fields), doc=doc, source=f"MT1604P §{section}",
        examples=examples,
    )  # fmt: skip


def _three(unit: str, bits: int, names: str = "x y z") -> list[Any]:
    """Declare three numbers of `2**-bits` of a unit."""
    return [name / Quantity(Int16sb, unit=unit, scale=2**-bits) for name in names.split()]


def _four() -> list[Any]:
    """Declare a quaternion, its real part first."""
    return [name / Quantity(Int16sb, scale=1 / 32767) for name in ("q0", "q1", "q2", "q3")]


_message("Error", 0x001, "6.1.1", "code" / Enumeration(Byte, output_buffer_overflow=1), doc="A message was dropped.",
    examples=[("001#01", {"code": "output_buffer_overflow"})])  # fmt: skip
_message("SampleTime", 0x005, "6.1.2", "time" / Quantity(Int32ub, unit="µs", doc="begins again at 2³²"),
    doc="When the values of this group were sampled.", examples=[("005#00 0F 42 40", {"time": 1_000_000})])  # fmt: skip
_message("GroupCounter", 0x006, "6.1.3", "count" / Int16ub, doc="The number of this group of messages.",
    examples=[("006#01 02", {"count": 258})])  # fmt: skip
_message(
    "Status", 0x011, "6.2.1",
    "flags" / Flags(Int32ub, self_test=0, filter_valid=1, gnss_fix=2, clip_acc_x=8, clip_acc_y=9, clip_acc_z=10,
        clip_gyr_x=11, clip_gyr_y=12, clip_gyr_z=13, clip_mag_x=14, clip_mag_y=15, clip_mag_z=16, clipping=19),
    doc="Whether the self-test was passed, the filter is valid, and what is beyond its range.",
    examples=[("011#00 08 01 03", {"flags": ["self_test", "filter_valid", "clip_acc_x", "clipping"]})],
)  # fmt: skip
_message("Quaternion", 0x021, "6.3.1", *_four(), doc="Orientation, sensor to earth.",
    examples=[("021#7F FF 00 00 00 00 80 01", {"q0": 1.0, "q1": 0.0, "q2": 0.0, "q3": -1.0})])  # fmt: skip
_message("EulerAngles", 0x022, "6.3.2", *_three("°", 7, "roll pitch yaw"), doc="Orientation: yaw, then pitch, then roll.",
    examples=[("022#5A 00 D3 00 00 01", {"roll": 180.0, "pitch": -90.0, "yaw": 0.0078125})])  # fmt: skip
_message("RateOfTurn", 0x032, "6.4.2", *_three("rad/s", 9), doc="Rate of turn about the sensor's axes.",
    examples=[("032#46 00 FE 00 00 01", {"x": 35.0, "y": -1.0, "z": 2**-9})])  # fmt: skip
_message("DeltaQ", 0x033, "6.4.3", *_four(), doc="Turn since the group before.",
    examples=[("033#7F FF 00 01 00 00 00 00", {"q0": 1.0, "q1": 1 / 32767})])  # fmt: skip
_message("Acceleration", 0x034, "6.4.4", *_three("m/s²", 8), doc="Acceleration along the sensor's axes, gravity among it.",
    examples=[("034#CF 09 64 00 09 D0", {"x": -12535 / 256, "y": 100.0, "z": 9.8125})])  # fmt: skip
_message("FreeAcceleration", 0x035, "6.4.5", *_three("m/s²", 8), doc="Acceleration in the earth's axes, without gravity.",
    examples=[("035#00 80 FF 80 00 00", {"x": 0.5, "y": -0.5, "z": 0.0})])  # fmt: skip
_message("MagneticField", 0x041, "6.5.1", *_three("", 10), doc="Magnetic field, 1 where the sensor was calibrated.",
    examples=[("041#02 00 00 00 FC 00", {"x": 0.5, "y": 0.0, "z": -1.0})])  # fmt: skip
_message("Temperature", 0x051, "6.6.1", "temperature" / Quantity(Int16sb, unit="°C", scale=2**-8), doc="Of the sensor.",
    examples=[("051#19 80", {"temperature": 25.5})])  # fmt: skip
_message("Pressure", 0x052, "6.6.2", "pressure" / Quantity(Int32ub, unit="Pa", scale=2**-15), doc="Of the air.",
    examples=[("052#C5 E6 80 00", {"pressure": 101325.0})])  # fmt: skip
_message("Position", 0x071, "6.8.1", "latitude" / Quantity(Int32sb, unit="°", scale=2**-24),
    "longitude" / Quantity(Int32sb, unit="°", scale=2**-23), doc="MTi-670, 680: place.",
    examples=[("071#34 80 00 00 02 C0 00 00", {"latitude": 52.5, "longitude": 5.5})])  # fmt: skip
_message("Velocity", 0x076, "6.8.3", *_three("m/s", 6), doc="MTi-670, 680: velocity.",
    examples=[("076#00 40 FF C0 00 00", {"x": 1.0, "y": -1.0, "z": 0.0})])  # fmt: skip

__all__ = ["xsens_can"]
