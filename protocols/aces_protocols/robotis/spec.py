"""Dynamixel protocol 1.0, as the RX-10, RX-28 and RX-64 servos of MiniHubo speak it.

1. Instruction and status packets look alike; who spoke is known from `direction`, or from the request before (`both`).
2. A packet's bytes decide its length: a SyncWrite whose length is not 4 + n·(size + 1) is no message.

Source: Robotis RX-28 manual, checked against recordings of two servos. Deviations from both are in the README beside.
"""

from __future__ import annotations

from construct import Byte, Bytes, GreedyBytes, GreedyRange, Struct, this

from aces_bus.protocol import Flags, InvertedSum, Protocol

from .control_table import ERRORS, add_registers

BROADCAST = 0xFE
#: Identifiers of single servos; 0xFF cannot occur.
SERVOS = range(BROADCAST)

robotis = Protocol(
    "robotis",
    link="serial",
    baud=1_000_000,  # MiniHubo; a servo leaves the factory at 57 600 (see the register `baud_rate`)
    half_duplex=True,
    broadcast={"id": BROADCAST},
    doc="Dynamixel protocol 1.0: half-duplex RS-485, several servos on one line.",
    source="Robotis RX-28 manual; recordings of two servos",
)

packet = robotis.framing(
    sync=b"\xff\xff",
    not_next=b"\xff",  # of FF FF FF the last two are the header
    header=Struct("id" / Byte, "length" / Byte),
    size=this.length + 4,
    max_size=259,  # what the length byte allows; the RX-28 itself receives at most 143 bytes of a SyncWrite
    gap=0.1,  # a longer pause inside a packet resets the servo's receiver
    check=InvertedSum(),
)

# ---------------------------------------------------------------------- instructions

instruction = packet.family(Struct("instruction" / Byte), direction="to device")

Ping = instruction(
    "Ping",
    instruction=0x01,
    doc="Ask for a status, which comes whatever the status return level.",
    source="RX-28 manual, PING",
    examples=[("FF FF 01 02 01 FB", {"id": 1})],
)
Read = instruction(
    "Read",
    instruction=0x02,
    payload=Struct("start" / Byte, "count" / Byte),
    doc="Ask for `count` bytes of the control table.",
    source="RX-28 manual, READ_DATA",
    examples=[
        ("FF FF 01 04 02 00 32 C6", {"id": 1, "start": 0, "count": 50}),
        ("FF FF 01 04 02 2B 01 CC", {"id": 1, "start": 0x2B, "count": 1}),
    ],
)
Write = instruction(
    "Write",
    instruction=0x03,
    payload=Struct("start" / Byte, "data" / GreedyBytes),
    doc="Write bytes of the control table.",
    source="RX-28 manual, WRITE_DATA",
    examples=[
        ("FF FF 01 05 03 1E F6 01 E1", {"id": 1, "start": 0x1E, "data": b"\xf6\x01"}),
        ("FF FF FE 04 03 03 01 F6", {"id": BROADCAST, "start": 3, "data": b"\x01"}),
    ],
)
RegWrite = instruction(
    "RegWrite",
    instruction=0x04,
    payload=Struct("start" / Byte, "data" / GreedyBytes),
    doc="Write, held back until Action.",
    source="RX-28 manual, REG_WRITE",
    examples=[("FF FF 00 05 04 1E 00 00 D8", {"id": 0, "start": 0x1E, "data": bytes(2)})],
)
Action = instruction(
    "Action",
    instruction=0x05,
    doc="Carry out what RegWrite held back.",
    source="RX-28 manual, ACTION",
    examples=[("FF FF FE 02 05 FA", {"id": BROADCAST})],
)
Reset = instruction(
    "Reset",
    instruction=0x06,
    doc="Back to factory defaults.",
    source="RX-28 manual, RESET",
    examples=[("FF FF 00 02 06 F7", {"id": 0})],
)
SyncWrite = instruction(
    "SyncWrite",
    instruction=0x83,
    match={"id": BROADCAST},
    payload=Struct(
        "start" / Byte,
        "size" / Byte,
        "servos" / GreedyRange(Struct("id" / Byte, "data" / Bytes(this._.size))),
    ),
    doc="Write the same `size` bytes of the control table in many servos, each its own values. Never answered.",
    source="RX-28 manual, SYNC_WRITE",
    examples=[
        (
            "FF FF FE 0A 83 1E 02 47 10 02 60 00 02 99",
            {
                "start": 0x1E,
                "size": 2,
                "servos": [{"id": 71, "data": b"\x10\x02"}, {"id": 96, "data": b"\x00\x02"}],
            },
        )
    ],
)

# ---------------------------------------------------------------------- status

Status = packet(
    "Status",
    direction="from device",
    match={"id": SERVOS},
    # A broadcast is not answered, except that a Ping may be.
    reply_to=(Ping, *(request.where(id=SERVOS) for request in (Read, Write, RegWrite, Action, Reset))),
    overrides=("Ping", "Read", "Write", "RegWrite", "Action", "Reset"),
    # A servo waits 0.5 ms at most; the rest is for 259 bytes at 9600 baud and for adapters that collect bytes.
    within=0.5,
    payload=Struct("error" / Flags(Byte, ERRORS), "parameters" / GreedyBytes),
    doc="A servo's answer: its error bits and the bytes asked for.",
    source="RX-28 manual, status packet",
    examples=[
        ("FF FF 01 03 00 20 DB", {"id": 1, "error": [], "parameters": b"\x20"}, "FF FF 01 04 02 2B 01 CC"),
        ("FF FF 01 02 24 D8", {"id": 1, "error": ["overheating", "overload"], "parameters": b""}),
    ],
)

# ---------------------------------------------------------------------- control table

control_table = robotis.registers(
    read=Read,
    write=Write,
    sync=SyncWrite,
    doc="Control table of RX-10, RX-28 and RX-64: EEPROM 0x00–0x17, RAM 0x18–0x31; words are little-endian.",
)
add_registers(control_table)
