"""Dynamixel protocol 1.0, as the RX-10, RX-28 and RX-64 servos of MiniHubo speak it.

Source: Robotis RX-28 manual (instruction and status packets, control table), checked against recordings of two servos.
"""

from __future__ import annotations

from math import pi

from construct import Byte, Const, GreedyBytes, GreedyRange, Int16ul, Struct, this

from aces_bus.protocol import Enumeration, Flags, InvertedSum, Protocol

robotis = Protocol(
    "robotis",
    link="serial",
    baud=1_000_000,
    broadcast={"id": 0xFE},
    doc="Dynamixel protocol 1.0: half-duplex RS-485, several servos on one line.",
    source="Robotis RX-28 manual; recordings of two servos",
)

packet = robotis.framing(
    sync=b"\xff\xff",
    not_next=b"\xff",  # id 0xFF cannot occur: of FF FF FF the last two are the header
    header=Struct("id" / Byte, "length" / Byte),
    size=this.length + 4,
    max_size=259,
    gap=0.1,  # a longer pause inside a packet resets the servo's receiver
    check=InvertedSum(),
)

# ---------------------------------------------------------------------- instructions

Ping = packet("Ping", direction="to device", payload=Struct(Const(0x01, Byte)), doc="Ask for a status.", source="RX-28 manual, PING")
Read = packet(
    "Read",
    direction="to device",
    payload=Struct(Const(0x02, Byte), "start" / Byte, "count" / Byte),
    doc="Ask for `count` bytes of the control table.",
    source="RX-28 manual, READ_DATA",
)
Write = packet(
    "Write",
    direction="to device",
    payload=Struct(Const(0x03, Byte), "start" / Byte, "data" / GreedyBytes),
    doc="Write bytes of the control table.",
    source="RX-28 manual, WRITE_DATA",
)
RegWrite = packet(
    "RegWrite",
    direction="to device",
    payload=Struct(Const(0x04, Byte), "start" / Byte, "data" / GreedyBytes),
    doc="Write, held back until Action.",
    source="RX-28 manual, REG_WRITE",
)
Action = packet(
    "Action", direction="to device", payload=Struct(Const(0x05, Byte)), doc="Carry out what RegWrite held back.", source="RX-28 manual, ACTION"
)
Reset = packet(
    "Reset", direction="to device", payload=Struct(Const(0x06, Byte)), doc="Back to factory defaults.", source="RX-28 manual, RESET"
)
Status = packet(
    "Status",
    direction="from device",
    reply_to=(Ping, Read, Write, RegWrite, Action, Reset),
    over=("Ping", "Read", "Write", "RegWrite", "Action", "Reset", "SyncWrite"),
    within=0.5,
    payload=Struct(
        "error" / Flags(Byte, voltage=0, angle_limit=1, overheating=2, range=3, checksum=4, overload=5, instruction=6),
        "parameters" / GreedyBytes,
    ),
    doc="A servo's answer: its error bits and the bytes asked for.",
    source="RX-28 manual, status packet",
)
