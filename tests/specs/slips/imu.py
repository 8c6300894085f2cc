"""An inertial unit on a serial line: two framings, a list of tagged items, fixed-point numbers."""

from __future__ import annotations

from construct import (
    Array,
    Byte,
    Const,
    Float32b,
    GreedyRange,
    Int8sb,
    Int16sb,
    Int16ub,
    Int32ub,
    Prefixed,
    Struct,
    this,
)

from aces_bus.protocol import BitLayout, Enumeration, Flags, Protocol, Quantity, Split, Sum, bits

imu = Protocol("imu", link="serial", baud=115_200)
short = imu.framing(
    sync=b"\xfa\xff",
    header=Struct("opcode" / Byte, "length" / Byte),
    size=this.length + 5,
    max_size=100,
    gap=0.1,
    check=Sum(over=slice(2, -1)),
)
extended = imu.framing(
    name="extended",
    sync=b"\xfa\xfe",
    header=Struct("opcode" / Byte, "length" / Int16ub),
    size=this.length + 6,
    max_size=600,
    gap=0.1,
    check=Sum(over=slice(2, -1)),
)

Configure = short(
    "Configure",
    match={"opcode": 0xC0},
    direction="to device",
    payload=Struct(
        "period" / Quantity(Int16ub, unit="ms", scale=0.1), "mode" / Enumeration(Byte, off=0, slow=1, fast=2)
    ),
    examples=[("FA FF C0 03 03 E8 02 B0", {"period": 100.0, "mode": "fast"})],
)
Configured = short(
    "Configured",
    match={"opcode": 0xC1},
    direction="from device",
    payload=Struct("period" / Quantity(Int16ub, unit="ms", scale=0.1)),
    examples=[("FA FF C1 02 03 E8 AE", {"period": 100.0})],
)
Motion = short(
    "Motion",
    match={"opcode": 0x32},
    direction="from device",
    payload=Struct(
        "time" / Quantity(Int32ub, unit="s", scale=0.0001),
        "acceleration" / Quantity(Int16sb, unit="m/s²", scale=0.001),
        "temperature" / Quantity(Int16sb, unit="°C", scale=0.01),
        "state" / Enumeration(Byte, align=0, navigate=1, fault=2),
    ),
)
Tilt = short(
    "Tilt",
    match={"opcode": 0x33},
    direction="from device",
    payload=Struct(
        "angle" / Quantity(Int16sb, unit="°", scale=0.01),
        "offset" / Int8sb,
        "status" / Flags(Byte, valid=0, clipped=1, gps=2),
    ),
    examples=[("FA FF 33 04 03 E8 FB 05 22", {"angle": 10.0, "offset": -5})],
)
Position = short(
    "Position",
    match={"opcode": 0x34},
    direction="from device",
    payload=BitLayout(
        6, "latitude" / Quantity(Split((16, 32), (0, 16), signed=True), unit="°", scale=2.0**-32)
    ),
)
Items = extended(
    "Items",
    match={"opcode": 0x36},
    direction="from device",
    payload=Struct(
        "items"
        / GreedyRange(
            Struct(
                "kind" / Int16ub,
                "data"
                / Prefixed(Byte, Struct("value" / Array(3, Quantity(Float32b, unit="Pa")), "status" / Byte)),
            )
        )
    ),
)
Level = short(
    "Level",
    match={"opcode": 0x35},
    direction="from device",
    payload=BitLayout(2, "level" / bits(16)),
)
Version = short(
    "Version",
    match={"opcode": 0x02},
    direction="from device",
    payload=Struct(Const(b"\x01"), "major" / Byte, "minor" / Byte),
    examples=[("FA FF 02 03 01 04 02 0C", {"major": 4, "minor": 2})],
)
