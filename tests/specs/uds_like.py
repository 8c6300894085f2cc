"""A part of UDS, diagnostics over ISO-TP.

What it asks of the language: a transport that names both identifiers, packets of any length, lists in them, a second
transport with addresses in the frames beside it.

Source: the published standards (ISO 14229-1, ISO 15765-2), general knowledge. Bytes of the worked examples as
python-can-isotp 2 sends them.
"""

from __future__ import annotations

from construct import Byte, Bytes, Const, GreedyBytes, GreedyRange, Int16ub, Struct

from aces_bus.protocol import Enumeration, IdField, IsoTp, Protocol

uds_like = Protocol("uds_like", link="can", bitrate=500_000, doc="Diagnostics of cars.", source="ISO 14229-1")

Ecu = IdField("ecu", range(8))
uds = IsoTp(to_device=0x7E0 + Ecu, from_device=0x7E8 + Ecu)

uds_like.message(
    "ReadData",
    transport=uds,
    direction="to device",
    payload=Struct(Const(0x22, Byte), "identifiers" / GreedyRange(Int16ub)),
    doc="Ask for values by their identifiers.",
    examples=[("7E0#03 22 F1 90", {"ecu": 0, "identifiers": [0xF190]})],
)
uds_like.message(
    "Data",
    transport=uds,
    direction="from device",
    payload=Struct(Const(0x62, Byte), "identifier" / Int16ub, "data" / GreedyBytes),
    doc="A value.",
    examples=[
        (
            ["7E8#10 14 62 F1 90 31 32 33", "7E8#21 34 35 36 37 38 39 30", "7E8#22 31 32 33 34 35 36 37"],
            {"ecu": 0, "identifier": 0xF190, "data": b"12345678901234567"},
        )
    ],
)
uds_like.message(
    "Refused",
    transport=uds,
    direction="from device",
    payload=Struct(
        Const(0x7F, Byte),
        "asked" / Byte,
        "why" / Enumeration(Byte, service_not_supported=0x11, out_of_range=0x31, response_pending=0x78),
    ),
    doc="A request was refused.",
    examples=[("7E9#03 7F 22 31", {"ecu": 1, "asked": 0x22, "why": "out_of_range"})],
)
uds_like.message(
    "Write",
    transport=IsoTp(addressing="extended", fd=True, senders=2, max_size=300, pad=0xAA),
    id=0x600 + IdField("tester", range(2)),
    payload=Struct("target" / Byte, Const(0x2E, Byte), "key" / Bytes(2), "data" / GreedyBytes),
    doc="Write a value, by another tester: CAN FD, the target's address in front of each frame.",
    examples=[
        ("600##0 55 04 2E 01 02 03 AA AA", {"tester": 0, "target": 0x55, "key": b"\1\2", "data": b"\3"}),
    ],
)
uds_like.message(
    "Heartbeat",
    id=0x700 + Ecu,
    payload=Struct("state" / Byte),
    doc="A frame beside the packets: it is there.",
)
