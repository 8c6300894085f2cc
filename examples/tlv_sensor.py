"""A weather station that sends what it measured as tagged items, in under 80 lines.

Each packet has as many items as there is something to say; a station with newer firmware sends kinds that this page does
not know, and those stay bytes. Its memory is a list of groups of one shape.

    aces decode station.bin -p examples/tlv_sensor.py --message Report --format csv
    aces plot station.bin -p examples/tlv_sensor.py Report.items.temperature 'History.hours.wind:.'

Source: made up for this page; the shape is that of many sensors' serial protocols.
"""

from __future__ import annotations

from construct import Byte, Float32b, GreedyRange, Int16sb, Int16ub, Int32ub, Struct, this

from aces_bus.protocol import Crc, Enumeration, Flags, Items, Protocol, Quantity, Text

tlv_sensor = Protocol("tlv_sensor", link="serial", baud=57_600, doc="A weather station.")

# 7E A5 | type, length of the payload | payload | CRC over type to payload
packet = tlv_sensor.framing(
    sync=b"\x7e\xa5",
    header=Struct("type" / Byte, "length" / Byte),
    size=this.length + 6,
    max_size=261,
    gap=0.1,
    check=Crc("CRC16-XMODEM"),
)

TEMPERATURE = Quantity(Int16sb, unit="°C", scale=0.01, unknown=[-0x8000], doc="2 m above the ground")
WIND = Struct(
    "speed" / Quantity(Int16ub, unit="m/s", scale=0.1),
    "from_direction" / Quantity(Int16ub, unit="°"),
    "quality" / Enumeration(Byte, good=0, iced=1, calm=2),
)

packet(
    "Report",
    match={"type": 1},
    direction="from device",
    payload=Struct(
        "uptime" / Quantity(Int32ub, unit="s"),
        "items"
        / Items(
            tag=Byte,
            size=Byte,
            kinds={
                "temperature": (0x01, TEMPERATURE),
                "pressure": (0x02, Quantity(Float32b, unit="hPa")),
                "wind": (0x10, WIND),
                "alarms": (0x20, Flags(Byte, frost=0, storm=1, battery=7)),
                "note": (0x7F, Text()),
            },
        ),
    ),
    doc="What was measured since the last report.",
    examples=[
        ("7E A5 01 13 00 00 00 3C 01 02 FF 38 10 05 00 7B 01 0E 00 42 02 AB CD 7C F6", {
            "uptime": 60, "items": [
                {"kind": "temperature", "data": -2},
                {"kind": "wind", "data": {"speed": 12.3, "from_direction": 270, "quality": "good"}},
                {"kind": 0x42, "data": b"\xab\xcd", "reason": "unknown"}]}),
    ],
)  # fmt: skip

packet(
    "History",
    match={"type": 2},
    direction="from device",
    payload=Struct(
        "hours" / GreedyRange(Struct("temperature" / TEMPERATURE, "wind" / Quantity(Byte, unit="m/s")))
    ),
    doc="The last hours, the latest first.",
    examples=[
        ("7E A5 02 06 00 64 03 80 00 05 7A 4E", {"hours": [{"temperature": 1, "wind": 3}, {"wind": 5}]})
    ],
)
packet("GetHistory", match={"type": 3}, direction="to device", payload=Struct("hours" / Byte))
