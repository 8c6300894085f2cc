"""Packets in SLIP frames (RFC 1055).

What it asks of the language: stuffing around the whole packet, header and check included; a mark that closes packets
and may also open them, so that empty packets are nothing.
"""

from __future__ import annotations

from construct import Array, Byte, Int16sb, Int32ub, Struct

from aces_bus.protocol import Crc, Protocol, Quantity, Slip, Text

slip = Protocol("slip", link="serial", baud=115_200, doc="An invented sensor behind SLIP.", source="RFC 1055")

packet = slip.framing(
    header=Struct("kind" / Byte),
    end=b"\xc0",
    stuffing=Slip(),
    check=Crc("CRC16-IBM-3740", order="big"),
    max_size=160,
    gap=0.5,
)

packet(
    "Sample",
    match={"kind": 0xC0},  # a mark inside the data, always stuffed
    direction="from device",
    payload=Struct(
        "time" / Quantity(Int32ub, unit="µs"), "accel" / Array(3, Quantity(Int16sb, scale=1 / 4096, unit="g"))
    ),
    doc="One sample.",
)
packet(
    "Log",
    match={"kind": 0x01},
    direction="from device",
    payload=Struct("text" / Text()),
    doc="A line of text.",
)
packet("Start", match={"kind": 0xDB}, direction="to device", doc="Send samples.")
