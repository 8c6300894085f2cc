"""Packets in COBS frames.

What it asks of the language: stuffing that changes every byte's place, a terminator of zero, a check before stuffing.

Source: Cheshire and Baker, Consistent Overhead Byte Stuffing. Deviations: of the two forms of a packet whose last
block is full only the shorter one is accepted; COBS/R is not.
"""

from __future__ import annotations

from construct import Byte, GreedyRange, Int16ul, Int32ul, Struct

from aces_bus.protocol import Cobs, Crc, Protocol, Quantity

cobs = Protocol(
    "cobs",
    link="serial",
    baud=921_600,
    doc="An invented logger behind COBS.",
    source="Cheshire and Baker 1999",
)

packet = cobs.framing(
    header=Struct("kind" / Byte, "sequence" / Byte),
    end=b"\0",
    stuffing=Cobs(),
    check=Crc("CRC32-ISO-HDLC"),
    max_size=600,
    gap=0.5,
)

packet(
    "Block",
    match={"kind": 0x00},
    payload=Struct("start" / Quantity(Int32ul, unit="ms"), "values" / GreedyRange(Int16ul)),
    doc="Values since `start`, one a millisecond.",
)
packet(
    "Alive", match={"kind": 0x01}, payload=Struct("uptime" / Quantity(Int32ul, unit="s")), doc="Still there."
)
