"""A part of Cyphal/CAN (UAVCAN v1).

What it asks of the language: transfers with a tail byte, whose check stands behind and may be torn apart by the end of a
frame; reserved bits of identifiers that senders set, and receivers ignore.

Source: Cyphal specification 1.0, §4.2, whose examples two of the worked ones are; pycyphal 1.27.1 sent the third.
"""

from __future__ import annotations

from construct import Byte, Bytes, GreedyBytes, Int32ul, Struct

from aces_bus.protocol import Enumeration, IdField, Protocol, Quantity, TailByte

cyphal_like = Protocol(
    "cyphal_like", link="can", bitrate=1_000_000, doc="Vehicles.", source="Cyphal specification 1.0"
)

Priority = IdField(
    "priority",
    range(8),
    names={
        "exceptional": 0,
        "immediate": 1,
        "fast": 2,
        "high": 3,
        "nominal": 4,
        "low": 5,
        "slow": 6,
        "optional": 7,
    },
)
#: Bits 22 and 21: senders set both.
Reserved = IdField("reserved_bits", range(4))
Node, Target = IdField("node", range(128)), IdField("target", range(128))
transfer = TailByte(version=1, max_size=400)


def subject(number: int) -> object:
    """The identifier of a subject."""
    return Priority << 26 | Reserved << 21 | number << 8 | Node


def service(number: int, *, request: bool) -> object:
    """The identifier of a service's request or answer."""
    return Priority << 26 | 1 << 25 | request << 24 | number << 14 | Target << 7 | Node


cyphal_like.message(
    "Heartbeat",
    transport=transfer,
    id=subject(7509),
    extended=True,
    payload=Struct(
        "uptime" / Quantity(Int32ul, unit="s"),
        "health" / Enumeration(Byte, nominal=0, advisory=1, caution=2, warning=3),
        "mode" / Enumeration(Byte, operational=0, initialization=1, maintenance=2, software_update=3),
        "vendor_specific_status_code" / Byte,
    ),
    doc="That a node is there.",
    examples=[
        (
            ["107D552A#00 00 00 00 00 01 A1 E0"],
            {
                "priority": "nominal",
                "node": 42,
                "uptime": 0,
                "mode": "initialization",
                "vendor_specific_status_code": 0xA1,
            },
        )
    ],
)
GetInfo = cyphal_like.message(
    "GetInfo",
    transport=transfer,
    id=service(430, request=True),
    extended=True,
    payload=Struct(),
    doc="Who are you?",
    examples=[(["136B957B#E1"], {"node": 123, "target": 42})],
)
cyphal_like.message(
    "Info",
    transport=transfer,
    id=service(430, request=False),
    extended=True,
    payload=Struct("protocol" / Bytes(2), "hardware" / Bytes(2), "software" / Bytes(2), "rest" / GreedyBytes),
    doc="Versions, the unique number and the name of a node.",
)
cyphal_like.message(
    "Array",
    transport=transfer,
    id=subject(4919),
    extended=True,
    payload=Struct("data" / GreedyBytes),
    doc="Bytes of some type.",
    examples=[
        (
            ["1073377B#01 02 03 04 05 06 07 A5", "1073377B#08 09 0A 2C 72 45"],
            {"node": 123, "data": bytes(range(1, 11))},
        ),
    ],
)
cyphal_like.message(
    "LongArray",
    transport=TailByte(version=1, fd=True, max_size=600),
    id=subject(4920),
    extended=True,
    payload=Struct("data" / GreedyBytes),
    doc="Bytes of some type in CAN FD, with the zeros that fill its frames up.",
)
