"""What is sent how often, whether a setting was taken, versions: CFG, ACK, MON."""

from __future__ import annotations

from construct import Array, Byte, GreedyRange, Int16ul, Struct

from aces_bus.protocol import Enumeration, Quantity, Text

from .base import packet, poll

packet(
    "CfgMsg",
    match={"group": 0x06, "number": 0x01},
    payload=Struct("message_group" / Byte, "message_number" / Byte, "rate" / Byte),
    doc="How many solutions pass from one such message to the next on this port: a setting, or the answer to a poll.",
    source="pyubx2, CFG-MSG",
    examples=[("B5 62 06 01 03 00 01 07 01 13 51", {"message_group": 1, "message_number": 7, "rate": 1})],
)
packet(
    "CfgMsgPorts",
    match={"group": 0x06, "number": 0x01},
    payload=Struct("message_group" / Byte, "message_number" / Byte, "rates" / Array(6, Byte)),
    doc="The same on each of six ports: I²C, UART 1, UART 2, USB, SPI, and one that is reserved.",
    source="pyubx2, CFG-MSG",
    examples=[
        (
            "B5 62 06 01 08 00 01 07 00 01 00 02 00 00 1A E7",
            {"message_group": 1, "message_number": 7, "rates": [0, 1, 0, 2, 0, 0]},
        )
    ],
)
packet(
    "CfgMsgPoll",
    direction="to device",
    match={"group": 0x06, "number": 0x01},
    payload=Struct("message_group" / Byte, "message_number" / Byte),
    doc="Ask how often a message is sent.",
    source="pyubx2, CFG-MSG",
    examples=[("B5 62 06 01 02 00 01 07 11 3A", {"message_group": 1, "message_number": 7})],
)
packet(
    "CfgRate",
    match={"group": 0x06, "number": 0x08},
    payload=Struct(
        "period" / Quantity(Int16ul, unit="ms", doc="From measurement to measurement."),
        "measurements" / Quantity(Int16ul, doc="How many make one solution."),
        "time_reference" / Enumeration(Int16ul, utc=0, gps=1, glonass=2, beidou=3, galileo=4),
    ),
    doc="How often it measures and solves; to the receiver a setting, from it the answer to a poll.",
    source="pyubx2, CFG-RATE",
    examples=[
        (
            "B5 62 06 08 06 00 C8 00 01 00 00 00 DD 68",
            {"period": 200, "measurements": 1, "time_reference": "utc"},
        )
    ],
)
packet("CfgRatePoll", **poll(0x06, 0x08, "B5 62 06 08 00 00 0E 30"))
for name, number, doc, example in (
    ("Ack", 0x01, "A setting was taken.", "B5 62 05 01 02 00 06 01 0F 38"),
    ("Nak", 0x00, "A setting was refused.", "B5 62 05 00 02 00 06 01 0E 33"),
):
    packet(
        name,
        direction="from device",
        match={"group": 0x05, "number": number},
        payload=Struct("acked_group" / Byte, "acked_number" / Byte),
        doc=doc,
        source="pyubx2, ACK",
        examples=[(example, {"acked_group": 6, "acked_number": 1})],
    )

packet(
    "MonVer",
    direction="from device",
    match={"group": 0x0A, "number": 0x04},
    payload=Struct("software" / Text(30), "hardware" / Text(10), "extensions" / GreedyRange(Text(30))),
    doc="Versions of the receiver.",
    source="pyubx2, MON-VER",
    examples=[
        (
            "B5 62 0A 04 28 00 45 58 54 20 43 4F 52 45 20 31 2E 30 30 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 30"
            "30 31 39 30 30 30 30 00 00 D9 48",
            {"software": "EXT CORE 1.00", "hardware": "00190000", "extensions": []},
        )
    ],
)
packet("MonVerPoll", **poll(0x0A, 0x04, "B5 62 0A 04 00 00 0E 34"))
