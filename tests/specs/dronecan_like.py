"""A part of DroneCAN (UAVCAN v0).

What it asks of the language: transfers with a tail byte, whose check is seeded by the type; services, whose requests and
answers are in the identifier; numbers of 14 bits, with the highest first.

Source: dronecan 1.0.27 (`dsdl_specs/uavcan/`), which sent the bytes of the worked examples.
"""

from __future__ import annotations

from construct import Byte, Float16l, GreedyBytes, Int16ul, Int32ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, IdField, Protocol, Quantity, TailByte, bits

dronecan_like = Protocol(
    "dronecan_like", link="can", bitrate=1_000_000, doc="Boards of drones.", source="dronecan.github.io"
)

Priority, Node, Target = (
    IdField("priority", range(32)),
    IdField("node", range(1, 128)),
    IdField("target", range(1, 128)),
)
transfer = TailByte(version=0, max_size=400)


def broadcast(number: int) -> object:
    """The identifier of a message type."""
    return Priority << 24 | number << 8 | Node


def service(number: int, *, request: bool) -> object:
    """The identifier of a service's request or answer."""
    return Priority << 24 | number << 16 | request << 15 | Target << 8 | 0x80 | Node


def signature(number: int) -> bytes:
    """A type's signature, as the check begins with it."""
    return number.to_bytes(8, "little")


dronecan_like.message(
    "NodeStatus",
    transport=transfer,
    id=broadcast(341),
    extended=True,
    check_extra=signature(0x0F0868D0C1A7C6F1),
    payload=Struct(
        "uptime" / Quantity(Int32ul, unit="s"),
        "state"
        / BitLayout(
            1,
            "health" / Enumeration(bits(2, at=6), ok=0, warning=1, error=2, critical=3),
            "mode"
            / Enumeration(bits(3, at=3), operational=0, initialising=1, maintenance=2, update=3, offline=7),
            "sub_mode" / bits(3, at=0),
        ),
        "vendor_code" / Int16ul,
    ),
    doc="That a node is there.",
    examples=[
        (
            ["1401552A#0A 00 00 00 00 34 12 C7"],
            {"priority": 20, "node": 42, "uptime": 10, "state": {"health": "ok"}, "vendor_code": 0x1234},
        )
    ],
)
dronecan_like.message(
    "EscStatus",
    transport=transfer,
    id=broadcast(1034),
    extended=True,
    check_extra=signature(0xA9AF28AEA2FBB254),
    payload=Struct(
        "errors" / Int32ul,
        "voltage" / Quantity(Float16l, unit="V"),
        "current" / Quantity(Float16l, unit="A"),
        "temperature" / Quantity(Float16l, unit="K"),
        "rest" / GreedyBytes,
    ),
    doc="What a motor's controller measures.",
    examples=[
        (
            ["10040A14#6F F2 01 00 00 00 00 83", "10040A14#4E 00 43 B0 5C 50 FB 23", "10040A14#D0 88 43"],
            {"priority": 16, "node": 20, "errors": 1, "voltage": 24.0, "current": 3.5, "temperature": 300.0},
        )
    ],
)
GetNodeInfo = dronecan_like.message(
    "GetNodeInfo",
    transport=transfer,
    id=service(1, request=True),
    extended=True,
    check_extra=signature(0xEE468A8121C46A9E),
    payload=Struct(),
    doc="Who are you?",
    examples=[(["1E01AAFF#C1"], {"priority": 30, "target": 42, "node": 127})],
)
dronecan_like.message(
    "NodeInfo",
    transport=transfer,
    id=service(1, request=False),
    extended=True,
    check_extra=signature(0xEE468A8121C46A9E),
    payload=Struct(
        "uptime" / Quantity(Int32ul, unit="s"),
        "health_and_mode" / Byte,
        "vendor_code" / Int16ul,
        "rest" / GreedyBytes,
    ),
    doc="Version, hardware and name of a node.",
)
