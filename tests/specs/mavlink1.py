"""MAVLink 1: the messages that every autopilot sends.

What it asks of the language: a CRC that ends with one extra byte, another for each message, so that a receiver with
other message definitions refuses the packet.

Sources: ArduPilot/pymavlink `mavgen_python.py`, `mavparse.py`, `mavcrc.py`; mavlink/mavlink `minimal.xml`,
`common.xml`. Fields stand in wire order: by size, largest first. Deviation: the sequence number counts all packets of
a sender, not those of one message, and so is a plain field, not a `Counter`.
"""

from __future__ import annotations

from typing import Any

from construct import (
    Array,
    Byte,
    Const,
    Float32l,
    Int8sl,
    Int8ul,
    Int16sl,
    Int16ul,
    Int32sl,
    Int32ul,
    Int64ul,
    Struct,
    this,
)

from aces_bus.protocol import Crc, Enumeration, Extra, Flags, Protocol, Quantity, Text

mavlink1 = Protocol(
    "mavlink1",
    link="serial",
    baud=57_600,
    doc="MAVLink 1.0: autopilots and ground stations.",
    source="mavlink common.xml",
)

packet = mavlink1.framing(
    sync=b"\xfe",
    header=Struct("length" / Byte, "sequence" / Byte, "system" / Byte, "component" / Byte, "message" / Byte),
    size=this.length + 8,
    max_size=263,
    gap=0.5,
    check=Crc("CRC16-MCRF4XX", over=(slice(1, -2), Extra())),
)


def message(name: str, number: int, extra: int, payload: Any, doc: str) -> None:
    packet(
        name,
        match={"message": number},
        check_extra=bytes([extra]),
        payload=payload,
        doc=doc,
        source=f"common.xml, {number}",
    )


def lat_lon() -> Quantity:
    return Quantity(Int32sl, scale=1e-7, unit="°")


def mm() -> Quantity:
    return Quantity(Int32sl, unit="mm")


RAD, RAD_S = Quantity(Float32l, unit="rad"), Quantity(Float32l, unit="rad/s")
MS = Quantity(Int32ul, unit="ms", doc="Time since boot.")

message(
    "Heartbeat",
    0,
    50,
    Struct(
        "custom_mode" / Int32ul,
        "type" / Byte,
        "autopilot" / Byte,
        "base_mode" / Flags(Byte, custom=0, test=1, auto=2, guided=3, stabilize=4, hil=5, manual=6, armed=7),
        "status"
        / Enumeration(
            Byte,
            uninit=0,
            boot=1,
            calibrating=2,
            standby=3,
            active=4,
            critical=5,
            emergency=6,
            power_off=7,
            termination=8,
        ),
        Const(3, Byte),  # version
    ),
    "The sender is alive, and what it is.",
)
message(
    "SysStatus",
    1,
    124,
    Struct(
        "sensors_present" / Flags(Int32ul),
        "sensors_enabled" / Flags(Int32ul),
        "sensors_health" / Flags(Int32ul),
        "load" / Quantity(Int16ul, scale=0.1, unit="%"),
        "voltage" / Quantity(Int16ul, unit="mV", unknown=(0xFFFF,)),
        "current" / Quantity(Int16sl, unit="cA", unknown=(-1,)),
        "drop_rate" / Quantity(Int16ul, scale=0.01, unit="%"),
        "errors_comm" / Int16ul,
        "errors" / Array(4, Int16ul),
        "battery" / Quantity(Int8sl, unit="%", unknown=(-1,)),
    ),
    "Load, battery and link of a system.",
)
message(
    "ParamValue",
    22,
    220,
    Struct("value" / Float32l, "count" / Int16ul, "index" / Int16ul, "id" / Text(16), "type" / Byte),
    "One parameter; integers stand in the bits of the float.",
)
message(
    "GpsRawInt",
    24,
    24,
    Struct(
        "time" / Quantity(Int64ul, unit="µs"),
        "lat" / lat_lon(),
        "lon" / lat_lon(),
        "alt" / mm(),
        "eph" / Quantity(Int16ul, scale=0.01, unknown=(0xFFFF,)),
        "epv" / Quantity(Int16ul, scale=0.01, unknown=(0xFFFF,)),
        "velocity" / Quantity(Int16ul, unit="cm/s", unknown=(0xFFFF,)),
        "course" / Quantity(Int16ul, scale=0.01, unit="°", unknown=(0xFFFF,)),
        "fix" / Enumeration(Byte, no_gps=0, no_fix=1, fix_2d=2, fix_3d=3, dgps=4, rtk_float=5, rtk_fixed=6),
        "satellites" / Quantity(Int8ul, unknown=(0xFF,)),
    ),
    "The receiver's own position.",
)
message(
    "ScaledImu",
    26,
    170,
    Struct(
        "time" / MS,
        "accel" / Array(3, Quantity(Int16sl, unit="mg")),
        "gyro" / Array(3, Quantity(Int16sl, unit="mrad/s")),
        "mag" / Array(3, Quantity(Int16sl, unit="mgauss")),
    ),
    "Inertial measurements in units.",
)
message(
    "Attitude",
    30,
    39,
    Struct(
        "time" / MS,
        "roll" / RAD,
        "pitch" / RAD,
        "yaw" / RAD,
        "roll_rate" / RAD_S,
        "pitch_rate" / RAD_S,
        "yaw_rate" / RAD_S,
    ),
    "Euler angles and rates.",
)
message(
    "AttitudeQuaternion",
    31,
    246,
    Struct("time" / MS, "quaternion" / Array(4, Float32l), "rates" / Array(3, RAD_S)),
    "Attitude as w, x, y, z, and rates.",
)
message(
    "GlobalPositionInt",
    33,
    104,
    Struct(
        "time" / MS,
        "lat" / lat_lon(),
        "lon" / lat_lon(),
        "alt" / mm(),
        "relative_alt" / mm(),
        "velocity" / Array(3, Quantity(Int16sl, unit="cm/s")),
        "heading" / Quantity(Int16ul, scale=0.01, unit="°", unknown=(0xFFFF,)),
    ),
    "The fused position.",
)
message(
    "CommandLong",
    76,
    152,
    Struct(
        "params" / Array(7, Float32l),
        "command" / Int16ul,
        "target_system" / Byte,
        "target_component" / Byte,
        "confirmation" / Byte,
    ),
    "Do something, with seven parameters.",
)
message(
    "CommandAck",
    77,
    143,
    Struct(
        "command" / Int16ul,
        "result"
        / Enumeration(
            Byte,
            accepted=0,
            temporarily_rejected=1,
            denied=2,
            unsupported=3,
            failed=4,
            in_progress=5,
            cancelled=6,
        ),
    ),
    "What became of a command.",
)
