"""A receiver's blocks: the CRC in front of what it covers, times and positions, groups that say their size."""

from __future__ import annotations

from construct import Array, Byte, Bytes, Float32l, Float64l, Int16ul, Int32ul, Int64sl, Struct, this

from aces_bus.protocol import Crc, Enumeration, Protocol, Quantity, Reserved

blocks = Protocol("blocks", link="serial", baud=115_200, source="SBF reference guide")
block = blocks.framing(
    sync=b"$@",
    header=Struct("crc" / Int16ul, "kind" / Int16ul, "length" / Int16ul),
    size=this.length + 0,
    max_size=512,
    gap=0.5,
    check=Crc("CRC16-XMODEM", field="crc", over=slice(4, None)),
)
NEVER = -2e10
block(
    "Position",
    match={"kind": 4007},
    direction="from device",
    payload=Struct(
        "tow" / Quantity(Int32ul, unit="s", scale=0.001, unknown=(0xFFFFFFFF,)),
        "week" / Int16ul,
        "mode" / Enumeration(Byte, none=0, alone=1, differential=2, fixed=3),
        "error" / Byte,
        "latitude" / Quantity(Float64l, unit="rad", unknown=(NEVER,), range=(-1.6, 1.6)),
        "longitude" / Quantity(Float64l, unit="rad", unknown=(NEVER,), range=(-3.2, 3.2)),
        "height" / Quantity(Float64l, unit="m", unknown=(NEVER,), range=(-500, 9000)),
        "speed" / Quantity(Float32l, unit="m/s", range=(0, 600)),
        "satellites" / Byte,
        "padding" / Reserved(3),
    ),
)
block(
    "Velocity",
    match={"kind": 5908},
    direction="from device",
    payload=Struct(
        "tow" / Quantity(Int32ul, unit="s", scale=0.001),
        "week" / Int16ul,
        "accuracy" / Quantity(Int16ul, unit="m/s", scale=0.001),
        "north" / Quantity(Float32l, unit="m/s", range=(-100, 100)),
        "east" / Quantity(Float32l, unit="m/s", range=(-100, 100)),
        "up" / Quantity(Float32l, unit="m/s", range=(-100, 100)),
    ),
)
block(
    "Satellites",
    match={"kind": 4013},
    direction="from device",
    payload=Struct(
        "tow" / Quantity(Int32ul, unit="s", scale=0.001),
        "week" / Int16ul,
        "count" / Byte,
        "group_size" / Byte,
        "satellites"
        / Array(
            this.count,
            Struct(
                "number" / Byte,
                "elevation" / Quantity(Byte, unit="°", range=(0, 90)),
                "azimuth" / Quantity(Int16ul, unit="°", range=(0, 360)),
                "cn0" / Quantity(Int16ul, unit="dBHz", scale=0.25, range=(0, 70)),
                "more" / Bytes(this._.group_size - 6),
            ),
        ),
    ),
)
block(
    "Clock",
    match={"kind": 5911},
    direction="from device",
    payload=Struct(
        "tow" / Quantity(Int32ul, unit="s", scale=0.001),
        "bias" / Quantity(Int64sl, unit="s", scale=1e-12),
        "rest" / Reserved(4),
    ),
)
