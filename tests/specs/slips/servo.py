"""A servo on CAN, node and command in the identifier, written without worked examples but two."""

from __future__ import annotations

from typing import Any

from construct import Byte, Float32l, Int16sl, Int16ul, Int32sl, Int32ul, Struct

from aces_bus.protocol import Enumeration, Flags, IdField, Protocol, Quantity

servo = Protocol("servo", link="can", bitrate=500_000)
Node = IdField("node", range(1, 16))


def at(command: int) -> Any:
    return Node << 5 | command


Heartbeat = servo.message(
    "Heartbeat",
    id=at(0x01),
    direction="from device",
    payload=Struct(
        "errors" / Flags(Int32ul, current=0, voltage=1, encoder=5),
        "state" / Enumeration(Byte, idle=1, calibrate=3, closed_loop=8),
        "life" / Byte,
    ),
)
Estimates = servo.message(
    "Estimates",
    id=at(0x09),
    direction="from device",
    payload=Struct(
        "position" / Quantity(Float32l, unit="turn"), "velocity" / Quantity(Float32l, unit="turn/s")
    ),
)
Ask = servo.message("Ask", id=at(0x0F), remote=True, direction="to device", examples=[("06F#R", {"node": 3})])
Counts = servo.message(
    "Counts",
    id=at(0x0A),
    direction="from device",
    payload=Struct("count" / Int32sl, "fine" / Int16sl, "rest" / Int16ul),
)
Current = servo.message(
    "Current",
    id=at(0x14),
    direction="from device",
    payload=Struct(
        "target" / Quantity(Int16sl, unit="A", scale=0.01),
        "measured" / Quantity(Int16sl, unit="A", scale=0.01),
        "temperature" / Quantity(Int16sl, unit="°C", scale=0.1, range=(-40, 150)),
    ),
)
SetPosition = servo.message(
    "SetPosition",
    id=at(0x0C),
    direction="to device",
    payload=Struct(
        "position" / Quantity(Float32l, unit="turn"),
        "feedforward" / Quantity(Int16sl, unit="turn/s", scale=0.001),
    ),
    examples=[("06C#00 00 C0 3F FA 00", {"node": 3, "position": 1.5, "feedforward": 0.25})],
)
