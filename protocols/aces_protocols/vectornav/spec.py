"""VectorNav VN-100, VN-200, VN-300 and their like: the binary output, all its groups by mask.

1. A byte says which groups of fields are in a packet, a mask of 16 bits for each group which fields; all masks come first.
   Fields are there by their bits, and the packet is as long as they are: it has no length of its own.
2. Angles are in degrees, positions in degrees and metres, in the frame of the field's name (NED, ECEF, body).
3. Fields that the manual gives a size and no name are bytes (`imu_12`, `attitude_10`, …), so that a packet with them is
   read.

Sources: VectorNav, VN-100 User Manual UM001 v2.22 (firmware 2.1.0.0), §4.3 and the group chapters, for framing, sizes (the
table of §4.3.6) and worked frames; VN-300 User Manual UM005 v2.22 for GPS and INS groups; UniStuttgart-INS/INSTINCT
`src/util/Vendor/VectorNav/BinaryOutputs/*.hpp` for what flags mean; vnproglib 1.2.0.0 `packet.cpp` for the size of bit 12 of
group 5.
"""

from __future__ import annotations

from construct import (
    Array,
    Byte,
    Bytes,
    Construct,
    Float32l,
    Float64l,
    Int8sl,
    Int16ul,
    Int32ul,
    Int64ul,
    Renamed,
    Struct,
)

from aces_bus.protocol import BitLayout, Crc, Enumeration, Flags, Present, Protocol, Quantity, bits

UM001, UM005 = "VectorNav VN-100 User Manual UM001 v2.22", "VectorNav VN-300 User Manual UM005 v2.22"
#: All fields of all groups are 1,209 bytes, with sync, masks and CRC.
MAX_SIZE = 1280

vectornav = Protocol(
    "vectornav",
    link="serial",
    baud=115_200,
    doc="VectorNav VN-100, VN-200, VN-300: inertial units with satellite navigation, binary output.",
    source=f"{UM001}; {UM005}",
)
_packet = vectornav.framing(
    sync=b"\xfa",
    header=Struct(
        "groups" / Flags(Byte, common=0, time=1, imu=2, gps=3, attitude=4, ins=5, gps2=6, extended=7)
    ),
    size="fields",
    max_size=MAX_SIZE,
    gap=0.1,
    check=Crc("CRC16-XMODEM", order="big"),
)


def _single(unit: str = "") -> Quantity:
    """Return a single-precision number."""
    return Quantity(Float32l, unit=unit)


def _three(unit: str = "") -> Construct:
    """Return three of them: x, y, z; north, east, down; yaw, pitch, roll."""
    return Array(3, _single(unit))


NS = Quantity(Int64ul, unit="ns")
LLA = Struct(
    "latitude" / Quantity(Float64l, unit="°"),
    "longitude" / Quantity(Float64l, unit="°"),
    "altitude" / Quantity(Float64l, unit="m"),
)
ECEF = Array(3, Quantity(Float64l, unit="m"))
UTC = Struct(
    "year" / Quantity(Int8sl, offset=2000),
    "month" / Byte,
    "day" / Byte,
    "hour" / Byte,
    "minute" / Byte,
    "second" / Byte,
    "ms" / Quantity(Int16ul, unit="ms"),
)
INS_STATUS = BitLayout(
    2,
    "mode" / Enumeration(bits(2), not_tracking=0, aligning=1, tracking=2, lost=3),
    "has_fix" / bits(1),
    "imu_error" / bits(1, at=4),
    "mag_pressure_error" / bits(1),
    "gnss_error" / bits(1),
    "heading_by_ins" / bits(1, at=8),
    "compass" / bits(1),
)
TIME_STATUS = Flags(Byte, time_ok=0, date_ok=1, utc_valid=2)
FIX = Enumeration(Byte, none=0, time_only=1, fix_2d=2, fix_3d=3, sbas=4, rtk_float=7, rtk_fixed=8)

COMMON: dict[int, Renamed] = {
    0: "time_startup" / NS,
    1: "time_gps" / NS,
    2: "time_sync_in" / NS,
    3: "ypr" / _three("°"),
    4: "quaternion" / Array(4, _single()),
    5: "angular_rate" / _three("rad/s"),
    6: "position" / LLA,
    7: "velocity" / _three("m/s"),
    8: "acceleration" / _three("m/s²"),
    9: "imu" / Struct("acceleration" / _three("m/s²"), "angular_rate" / _three("rad/s")),
    10: "mag_pressure"
    / Struct("mag" / _three("gauss"), "temperature" / _single("°C"), "pressure" / _single("kPa")),
    11: "delta" / Struct("time" / _single("s"), "theta" / _three("°"), "velocity" / _three("m/s")),
    12: "ins_status" / INS_STATUS,
    13: "sync_in_count" / Int32ul,
    14: "time_pps" / NS,
}
TIME: dict[int, Renamed] = {
    0: "startup" / NS,
    1: "gps" / NS,
    2: "gps_tow" / NS,
    3: "gps_week" / Int16ul,
    4: "sync_in" / NS,
    5: "pps" / NS,
    6: "utc" / UTC,
    7: "sync_in_count" / Int32ul,
    8: "sync_out_count" / Int32ul,
    9: "status" / TIME_STATUS,
    10: "10" / Bytes(1),
}
IMU: dict[int, Renamed] = {
    0: "status" / Int16ul,
    1: "raw_mag" / _three("gauss"),
    2: "raw_acceleration" / _three("m/s²"),
    3: "raw_rate" / _three("rad/s"),
    4: "temperature" / _single("°C"),
    5: "pressure" / _single("kPa"),
    6: "delta_theta" / Struct("time" / _single("s"), "theta" / _three("°")),
    7: "delta_velocity" / _three("m/s"),
    8: "mag" / _three("gauss"),
    9: "acceleration" / _three("m/s²"),
    10: "rate" / _three("rad/s"),
    11: "saturation"
    / Flags(
        Int16ul,
        mag_x=0,
        mag_y=1,
        mag_z=2,
        acceleration_x=3,
        acceleration_y=4,
        acceleration_z=5,
        rate_x=6,
        rate_y=7,
        rate_z=8,
        pressure=9,
    ),
    12: "12" / Bytes(40),
}
GPS: dict[int, Renamed] = {
    0: "utc" / UTC,
    1: "tow" / NS,
    2: "week" / Int16ul,
    3: "satellites" / Byte,
    4: "fix" / FIX,
    5: "lla" / LLA,
    6: "ecef" / ECEF,
    7: "velocity_ned" / _three("m/s"),
    8: "velocity_ecef" / _three("m/s"),
    9: "position_accuracy" / _three("m"),
    10: "velocity_accuracy" / _single("m/s"),
    11: "time_accuracy" / _single(),
    12: "time_info" / Struct("status" / TIME_STATUS, "leap_seconds" / Quantity(Int8sl, unit="s")),
    13: "dop"
    / Struct(*(name / _single() for name in ("gdop", "pdop", "tdop", "vdop", "hdop", "ndop", "edop"))),
}
ATTITUDE: dict[int, Renamed] = {
    0: "status" / Int16ul,
    1: "ypr" / _three("°"),
    2: "quaternion" / Array(4, _single()),
    3: "dcm" / Array(9, _single()),
    4: "mag_ned" / _three("gauss"),
    5: "acceleration_ned" / _three("m/s²"),
    6: "linear_body" / _three("m/s²"),
    7: "linear_ned" / _three("m/s²"),
    8: "ypr_accuracy" / _three("°"),
    9: "9" / Bytes(12),
    10: "10" / Bytes(28),
    11: "11" / Bytes(24),
    12: "12" / Bytes(12),
}
INS: dict[int, Renamed] = {
    0: "status" / INS_STATUS,
    1: "lla" / LLA,
    2: "ecef" / ECEF,
    3: "velocity_body" / _three("m/s"),
    4: "velocity_ned" / _three("m/s"),
    5: "velocity_ecef" / _three("m/s"),
    6: "mag_ecef" / _three("gauss"),
    7: "acceleration_ecef" / _three("m/s²"),
    8: "linear_ecef" / _three("m/s²"),
    9: "position_accuracy" / _single("m"),
    10: "velocity_accuracy" / _single("m/s"),
    11: "11" / Bytes(68),
    12: "12" / Bytes(64),
}
GROUPS: dict[str, dict[int, Renamed]] = {
    "common": COMMON,
    "time": TIME,
    "imu": IMU,
    "gps": GPS,
    "attitude": ATTITUDE,
    "ins": INS,
    "gps2": GPS,
}


def _fields() -> list[Construct]:
    """Return all masks, then all fields: those of a group are named after it."""
    masks: list[Construct] = [
        group / Present("groups", number, Int16ul) for number, group in enumerate(GROUPS)
    ]
    return masks + [
        f"{group}_{field.name}" / Present(group, bit, field.subcon)
        for group, fields in GROUPS.items()
        for bit, field in fields.items()
    ]


_packet(
    "Binary",
    direction="from device",
    payload=Struct(*_fields()),
    doc="Fields of the groups that are asked for.",
    source=f"{UM001} §4.3 and the group chapters",
    examples=[
        (
            "FA 01 08 00 93 50 2E 42 83 3E F1 3F 48 B5 04 BB 92 88",
            {"groups": ["common"], "common": 8, "common_ypr": [43.578686, 1.8847202, -2.0249654e-3]},
        ),
        (  # vnproglib 1.1, c/examples/uart_protocol
            "FA 01 09 00 70 05 00 03 0A 00 00 00 48 0E 2C 42 08 4C 37 C1 10 38 8B C2 D4 CB",
            {
                "groups": ["common"],
                "common": 9,
                "common_time_startup": 0x0A_0300_0570,
                "common_quaternion": None,
            },
        ),
    ],
)
