"""UBX, the binary protocol of u-blox receivers.

What it asks of the language: a Fletcher pair, bit fields inside a little-endian record, polls that are told from
answers by their length alone, a count inside a bit field, an optional tail.

Source: semuconsulting/pyubx2 `ubxtypes_get.py`, `ubxtypes_decodes.py`; the kinds of sensor data are general
knowledge.
Deviations: the data of ESF-MEAS is read as signed, which most of its kinds are; the calibration tag, which pyubx2
shows as one more data word, is a field of its own. The count of a list is given when building, like any field.
"""

from __future__ import annotations

from typing import Any

from construct import (
    Array,
    Byte,
    Const,
    GreedyRange,
    If,
    Int8sl,
    Int16sl,
    Int16ul,
    Int32sl,
    Int32ul,
    Struct,
    this,
)

from aces_bus.protocol import (
    BitLayout,
    Enumeration,
    Flags,
    Fletcher,
    Protocol,
    Quantity,
    Reserved,
    Text,
    bits,
)

ubx = Protocol(
    "ubx",
    link="serial",
    baud=38_400,
    doc="u-blox receivers: navigation, sensor fusion, configuration.",
    source="pyubx2 ubxtypes_get.py",
)

packet = ubx.framing(
    sync=b"\xb5\x62",
    header=Struct("group" / Byte, "number" / Byte, "length" / Int16ul),
    size=this.length + 8,
    max_size=1024,  # the longest answers of usual receivers; the length field would allow 65 543
    gap=0.5,
    check=Fletcher(),
)


def poll(name: str, group: int, number: int) -> None:
    """A poll has the identity of its answer and no payload."""
    packet(
        name,
        direction="to device",
        match={"group": group, "number": number},
        doc="Ask for one message.",
        source="pyubx2, poll messages",
    )


def degrees(scale: float) -> Quantity:
    return Quantity(Int32sl, scale=scale, unit="°")


def mm(field: Any = Int32sl) -> Quantity:
    return Quantity(field, unit="mm")


def mm_s(field: Any = Int32sl) -> Quantity:
    return Quantity(field, unit="mm/s")


ITOW = Quantity(Int32ul, unit="ms", doc="GPS time of week.")
FIX = {"none": 0, "dead_reckoning": 1, "fix_2d": 2, "fix_3d": 3, "gnss_and_dead_reckoning": 4, "time_only": 5}

# ---------------------------------------------------------------------- NAV

NavPvt = packet(
    "NavPvt",
    direction="from device",
    match={"group": 0x01, "number": 0x07},
    payload=Struct(
        "itow" / ITOW,
        "year" / Int16ul,
        "month" / Byte,
        "day" / Byte,
        "hour" / Byte,
        "minute" / Byte,
        "second" / Byte,
        "valid" / Flags(Byte, date=0, time=1, fully_resolved=2, magnetic=3),
        "time_accuracy" / Quantity(Int32ul, unit="ns"),
        "nano" / Quantity(Int32sl, unit="ns", doc="Fraction of the second; can be negative."),
        "fix" / Enumeration(Byte, FIX),
        "flags"
        / BitLayout(
            1,
            "fix_ok" / bits(1),
            "differential" / bits(1),
            "power_save" / bits(3),
            "heading_valid" / bits(1),
            "carrier" / Enumeration(bits(2), none=0, float=1, fixed=2),
        ),
        "flags2" / Flags(Byte, confirmed_available=5, confirmed_date=6, confirmed_time=7),
        "satellites" / Byte,
        "lon" / degrees(1e-7),
        "lat" / degrees(1e-7),
        "height" / mm(),
        "height_msl" / mm(),
        "horizontal_accuracy" / mm(Int32ul),
        "vertical_accuracy" / mm(Int32ul),
        "velocity_north" / mm_s(),
        "velocity_east" / mm_s(),
        "velocity_down" / mm_s(),
        "ground_speed" / mm_s(),
        "heading_of_motion" / degrees(1e-5),
        "speed_accuracy" / mm_s(Int32ul),
        "heading_accuracy" / Quantity(Int32ul, scale=1e-5, unit="°"),
        "pdop" / Quantity(Int16ul, scale=0.01),
        "flags3"
        / BitLayout(
            2,
            "invalid_position" / bits(1),
            "correction_age" / bits(4),
            "authenticated_time" / bits(1, at=13),
            "authenticated_message" / bits(1, at=14),
        ),
        "reserved0" / Reserved(4),
        "heading_of_vehicle" / degrees(1e-5),
        "magnetic_declination" / Quantity(Int16sl, scale=0.01, unit="°"),
        "magnetic_accuracy" / Quantity(Int16ul, scale=0.01, unit="°"),
    ),
    doc="Position, velocity and time.",
    source="pyubx2, NAV-PVT",
)
poll("NavPvtPoll", 0x01, 0x07)

NavStatus = packet(
    "NavStatus",
    direction="from device",
    match={"group": 0x01, "number": 0x03},
    payload=Struct(
        "itow" / ITOW,
        "fix" / Enumeration(Byte, FIX),
        "flags" / Flags(Byte, fix_ok=0, differential=1, week_set=2, time_of_week_set=3),
        "fix_status"
        / BitLayout(1, "corrections" / bits(1), "carrier_valid" / bits(1), "map_matching" / bits(2, at=6)),
        "flags2"
        / BitLayout(
            1,
            "power_save" / bits(2),
            "spoofing" / Enumeration(bits(2, at=3), unknown=0, none=1, indicated=2, multiple=3),
            "carrier" / Enumeration(bits(2, at=6), none=0, float=1, fixed=2),
        ),
        "time_to_first_fix" / Quantity(Int32ul, unit="ms"),
        "uptime" / Quantity(Int32ul, unit="ms"),
    ),
    doc="State of the navigation.",
    source="pyubx2, NAV-STATUS",
)
poll("NavStatusPoll", 0x01, 0x03)

packet(
    "NavRelPosNed",
    direction="from device",
    match={"group": 0x01, "number": 0x3C},
    payload=Struct(
        "version" / Byte,
        "reserved0" / Reserved(1),
        "station" / Int16ul,
        "itow" / ITOW,
        "position" / Array(3, Quantity(Int32sl, unit="cm", doc="North, east, down.")),
        "distance" / Quantity(Int32sl, unit="cm"),
        "heading" / degrees(1e-5),
        "reserved1" / Reserved(4),
        "position_fine" / Array(3, Quantity(Int8sl, scale=0.1, unit="mm", doc="To be added to position.")),
        "distance_fine" / Quantity(Int8sl, scale=0.1, unit="mm"),
        "position_accuracy" / Array(3, Quantity(Int32ul, scale=0.1, unit="mm")),
        "distance_accuracy" / Quantity(Int32ul, scale=0.1, unit="mm"),
        "heading_accuracy" / Quantity(Int32ul, scale=1e-5, unit="°"),
        "reserved2" / Reserved(4),
        "flags" / Flags(Int32ul),
    ),
    doc="Position relative to a base station.",
    source="pyubx2, NAV-RELPOSNED",
)
poll("NavRelPosNedPoll", 0x01, 0x3C)

# ---------------------------------------------------------------------- ESF

EsfMeas = packet(
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
                "faults" / Flags(Byte),
            ),
        ),
    ),
    doc="State of the sensor fusion.",
    source="pyubx2, ESF-STATUS",
)

# ---------------------------------------------------------------------- CFG, ACK, MON

CfgMsg = packet(
    "CfgMsg",
    match={"group": 0x06, "number": 0x01},
    payload=Struct("message_group" / Byte, "message_number" / Byte, "rate" / Byte),
    doc="How often a message is sent on this port; to the receiver a setting, from it the answer to a poll.",
    source="pyubx2, CFG-MSG",
)
packet(
    "CfgMsgPorts",
    match={"group": 0x06, "number": 0x01},
    payload=Struct("message_group" / Byte, "message_number" / Byte, "rates" / Array(6, Byte)),
    doc="How often a message is sent on each of six ports.",
    source="pyubx2, CFG-MSG",
)
packet(
    "CfgMsgPoll",
    direction="to device",
    match={"group": 0x06, "number": 0x01},
    payload=Struct("message_group" / Byte, "message_number" / Byte),
    doc="Ask how often a message is sent.",
    source="pyubx2, CFG-MSG",
)
for name, number, doc in (("Ack", 0x01, "A setting was taken."), ("Nak", 0x00, "A setting was refused.")):
    packet(
        name,
        direction="from device",
        match={"group": 0x05, "number": number},
        payload=Struct("acked_group" / Byte, "acked_number" / Byte),
        doc=doc,
        source="pyubx2, ACK",
    )

packet(
    "MonVer",
    direction="from device",
    match={"group": 0x0A, "number": 0x04},
    payload=Struct("software" / Text(30), "hardware" / Text(10), "extensions" / GreedyRange(Text(30))),
    doc="Versions of the receiver.",
    source="pyubx2, MON-VER",
)
poll("MonVerPoll", 0x0A, 0x04)
