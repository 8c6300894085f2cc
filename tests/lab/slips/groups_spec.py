"""An inertial sensor whose mask says which fields a packet has, each in its place by its bit."""

from __future__ import annotations

from construct import Byte, Float32l, Int16ul, Int32ul, Int64ul, Struct

from aces_bus.protocol import Crc, Present, Protocol, Quantity

groups = Protocol("groups", link="serial", baud=921_600, source="VectorNav binary output")
packet = groups.framing(
    sync=b"\xfa",
    header=Struct("group" / Byte, "fields" / Int16ul),
    size="fields",
    max_size=128,
    gap=0.05,
    check=Crc("CRC16-XMODEM", order="big", over=slice(1, -2)),
)
packet(
    "Output",
    match={"group": 1},
    direction="from device",
    payload=Struct(
        "time" / Present("fields", 0, Quantity(Int64ul, unit="s", scale=1e-9)),
        "counter" / Present("fields", 1, Int32ul),
        "angles"
        / Present(
            "fields",
            2,
            Struct(
                "yaw" / Quantity(Float32l, unit="°", range=(-180, 180)),
                "pitch" / Quantity(Float32l, unit="°", range=(-90, 90)),
                "roll" / Quantity(Float32l, unit="°", range=(-180, 180)),
            ),
        ),
        "rate"
        / Present(
            "fields",
            3,
            Struct(*(axis / Quantity(Float32l, unit="rad/s", range=(-35, 35)) for axis in ("x", "y", "z"))),
        ),
        "temperature" / Present("fields", 4, Quantity(Float32l, unit="°C", range=(-40, 85))),
        "pressure" / Present("fields", 5, Quantity(Float32l, unit="kPa", range=(10, 120))),
        "status" / Present("fields", 6, Int16ul),
    ),
)
