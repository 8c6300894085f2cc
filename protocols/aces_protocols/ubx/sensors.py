"""What the sensors beside the receiver measure, and what is made of it: ESF."""

from __future__ import annotations

from construct import Array, Byte, Const, If, Int16ul, Int32sl, Int32ul, Struct, this

from aces_bus.protocol import BitLayout, Enumeration, Flags, Quantity, Reserved, bits

from .base import ITOW, packet

packet(
    "EsfMeas",
    direction="from device",
    match={"group": 0x10, "number": 0x02},
    payload=Struct(
        "time_tag" / Int32ul,
        "flags"
        / BitLayout(
            2,
            "time_mark_sent" / bits(2),
            "time_mark_edge" / bits(1),
            "has_calibration_tag" / bits(1),
            "count" / bits(5, at=11),
        ),
        "provider" / Int16ul,
        "data"
        / Array(
            this.flags.count,
            BitLayout(
                4,
                "value" / bits(24, signed=True),
                "kind"
                / Enumeration(
                    bits(6),
                    gyro_z=5, wheel_front_left=6, wheel_front_right=7, wheel_rear_left=8, wheel_rear_right=9, wheel=10,
                    speed=11, gyro_temperature=12, gyro_y=13, gyro_x=14, accel_x=16, accel_y=17, accel_z=18,
                ),
            ),
        ),
        "calibration_tag" / If(this.flags.has_calibration_tag, Int32ul),
    ),
    doc="Sensor data: gyro 2⁻¹² °/s, acceleration 2⁻¹⁰ m/s², speed 1e-3 m/s, wheel ticks.",
    source="pyubx2, ESF-MEAS",
    examples=[
        (
            "B5 62 10 02 10 00 E8 03 00 00 00 10 00 00 00 10 00 05 00 FC FF 10 3D 6E",
            {
                "time_tag": 1000,
                "data": [
                    {"value": 4096, "kind": "gyro_z", "reserved": 0},
                    {"value": -1024, "kind": "accel_x", "reserved": 0},
                ],
                "calibration_tag": None,
            },
        ),
        (
            "B5 62 10 02 10 00 E8 03 00 00 08 08 00 00 C4 09 00 0B 09 03 00 00 01 AE",
            {"data": [{"value": 2500, "kind": "speed", "reserved": 0}], "calibration_tag": 777},
        ),
    ],
)  # fmt: skip

packet(
    "EsfIns",
    direction="from device",
    match={"group": 0x10, "number": 0x15},
    payload=Struct(
        "bitfield"
        / BitLayout(
            4,
            "version" / bits(8),
            "rate_valid" / Flags(bits(3), x=0, y=1, z=2),
            "accel_valid" / Flags(bits(3), x=0, y=1, z=2),
        ),
        "reserved0" / Reserved(4),
        "itow" / ITOW,
        "rate" / Array(3, Quantity(Int32sl, scale=1e-3, unit="°/s")),
        "accel" / Array(3, Quantity(Int32sl, scale=0.01, unit="m/s²")),
    ),
    doc="Compensated rates and accelerations of the vehicle.",
    source="pyubx2, ESF-INS",
    examples=[
        (
            "B5 62 10 15 24 00 01 0F 00 00 00 00 00 00 00 CA 5B 07 60 E3 16 00 70 2F FC FF 00 00 00 00 B0 04 00 00 78 EC FF"
            "FF CC 80 FE FF D7 E4",
            {"itow": 123_456_000, "rate": [1500.0, -250.0, 0.0], "accel": [12.0, -50.0, -981.0]},
        )
    ],
)

packet(
    "EsfStatus",
    direction="from device",
    match={"group": 0x10, "number": 0x10},
    payload=Struct(
        "itow" / ITOW,
        Const(2, Byte),  # version
        "init_status" / Reserved(2),
        "reserved0" / Reserved(5),
        "fusion_mode" / Byte,
        "reserved1" / Reserved(2),
        "count" / Byte,
        "sensors"
        / Array(
            this.count,
            Struct(
                "state" / BitLayout(1, "kind" / bits(6), "used" / bits(1), "ready" / bits(1)),
                "calibration" / BitLayout(1, "calibrated" / bits(2), "time" / bits(2)),
                "rate" / Quantity(Byte, unit="Hz"),
                "faults" / Flags(Byte, measurement=0, time_tag=1, missing=2, noisy=3),
            ),
        ),
    ),
    doc="State of the sensor fusion.",
    source="pyubx2, ESF-STATUS",
    examples=[
        (
            "B5 62 10 10 18 00 00 CA 5B 07 02 00 00 00 00 00 00 00 01 00 00 02 C5 0E 0A 00 8B 05 05 00 DB BC",
            {"itow": 123_456_000, "fusion_mode": 1, "count": 2},
        )
    ],
)
