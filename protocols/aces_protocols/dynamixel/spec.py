"""Dynamixel protocol 2.0, as the X series speaks it.

1. Instructions and statuses are told apart by their bytes: a status has 0x55 where an instruction has its code.
2. Stuffing is inside a packet whose length counts it; the CRC is over what is on the wire, from the first FF.
3. A joint answer to FastSyncRead is taken apart by what its request asked for; the one to FastBulkRead stays bytes.

Source: ROBOTIS e-manual, protocol 2.0; worked examples from there and from DynamixelSDK. Doubts are in the README beside.
"""

from __future__ import annotations

from typing import Any

from construct import Byte, Bytes, Const, Construct, GreedyBytes, GreedyRange, Int16ul, Struct, this

from aces_bus.protocol import BitLayout, Crc, Enumeration, Insert, Message, Protocol, bits

from .control_table import add_x_registers

BROADCAST = 0xFE
#: Identifiers of single servos; 0xFD and 0xFF cannot occur.
SERVOS = range(0xFD)

dynamixel = Protocol(
    "dynamixel",
    link="serial",
    baud=57_600,  # as they leave the factory; see the register `baud_rate`
    half_duplex=True,
    broadcast={"id": BROADCAST},
    doc="Dynamixel protocol 2.0: half-duplex TTL or RS-485, several servos on one line.",
    source="ROBOTIS e-manual, protocol 2.0",
)

CRC = Crc("CRC16-UMTS", over=slice(0, -2))

packet = dynamixel.framing(
    sync=b"\xff\xff\xfd\x00",
    header=Struct("id" / Byte, "length" / Int16ul),
    size=this.length + 7,
    max_size=1024,  # what DynamixelSDK sends and takes at most
    gap=0.1,
    stuffing=Insert(b"\xff\xff\xfd", b"\xfd"),
    check=CRC,
)

# ---------------------------------------------------------------------- instructions

#: A stretch of the control table.
AREA = ("start" / Int16ul, "count" / Int16ul)
WRITTEN = ("start" / Int16ul, "data" / GreedyBytes)
AREAS = "areas" / GreedyRange(Struct("id" / Byte, *AREA))

#: A worked example: bytes, and what they mean.
_Example = tuple[str, dict[str, Any]]


def instruction(
    name: str, code: int, *fields: Construct, doc: str, examples: list[_Example], everybody: bool = False
) -> Message:
    """Declare an instruction; `everybody`: it is addressed to all, and names its servos inside."""
    return packet(
        name,
        direction="to device",
        match={"id": BROADCAST} if everybody else {},
        payload=Struct(Const(code, Byte), *fields),
        doc=doc,
        source=f"ROBOTIS e-manual, protocol 2.0, instruction {code:#04x}",
        examples=examples,
    )


Ping = instruction(
    "Ping",
    0x01,
    doc="Ask who is there: answered whatever the status return level, when broadcast by all in turn.",
    examples=[("FF FF FD 00 01 03 00 01 19 4E", {"id": 1})],
)
Read = instruction(
    "Read",
    0x02,
    *AREA,
    doc="Ask for `count` bytes of the control table.",
    examples=[("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15", {"id": 1, "start": 132, "count": 4})],
)
Write = instruction(
    "Write",
    0x03,
    *WRITTEN,
    doc="Write bytes of the control table.",
    examples=[
        ("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89", {"id": 1, "start": 116, "data": b"\0\2\0\0"}),
        ("FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD 00 21 E7", {"start": 116, "data": b"\xff\xff\xfd\0"}),
    ],
)
RegWrite = instruction(
    "RegWrite",
    0x04,
    *WRITTEN,
    doc="Write, held back until Action.",
    examples=[("FF FF FD 00 01 09 00 04 74 00 00 08 00 00 31 0E", {"start": 116, "data": b"\0\x08\0\0"})],
)
Action = instruction(
    "Action",
    0x05,
    doc="Carry out what RegWrite held back.",
    examples=[("FF FF FD 00 FE 03 00 05 2A C2", {"id": BROADCAST})],
)
FactoryReset = instruction(
    "FactoryReset",
    0x06,
    "keep" / Enumeration(Byte, nothing=0xFF, id=0x01, id_and_baud=0x02),
    doc="Back to factory defaults.",
    examples=[("FF FF FD 00 01 04 00 06 02 AB E6", {"keep": "id_and_baud"})],
)
Reboot = instruction(
    "Reboot",
    0x08,
    doc="Restart: torque off, RAM as at power-up, errors cleared.",
    examples=[("FF FF FD 00 01 03 00 08 2F 4E", {"id": 1})],
)
Clear = instruction(
    "Clear",
    0x10,
    Const(b"\x01\x44\x58\x4c\x22"),
    doc="Forget full turns: the present position is within one turn again.",
    examples=[("FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC", {"id": 1})],
)
SyncRead = instruction(
    "SyncRead",
    0x82,
    *AREA,
    "ids" / GreedyRange(Byte),
    doc="Ask several servos for the same area; they answer in turn.",
    everybody=True,
    examples=[("FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA", {"start": 132, "count": 4, "ids": [1, 2]})],
)
SyncWrite = instruction(
    "SyncWrite",
    0x83,
    "start" / Int16ul,
    "size" / Int16ul,
    "servos" / GreedyRange(Struct("id" / Byte, "data" / Bytes(this._.size))),
    doc="Write the same `size` bytes of the control table in many servos, each its own values. Never answered.",
    everybody=True,
    examples=[
        (
            "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
            {
                "start": 116,
                "size": 4,
                "servos": [{"id": 1, "data": b"\x96\0\0\0"}, {"id": 2, "data": b"\xaa\0\0\0"}],
            },
        )
    ],
)
FastSyncRead = instruction(
    "FastSyncRead",
    0x8A,
    *AREA,
    "ids" / GreedyRange(Byte),
    doc="SyncRead with one joint answer.",
    everybody=True,
    examples=[("FF FF FD 00 FE 09 00 8A 84 00 04 00 01 02 4D 72", {"start": 132, "count": 4, "ids": [1, 2]})],
)
BulkRead = instruction(
    "BulkRead",
    0x92,
    AREAS,
    doc="Ask several servos for an area each; they answer in turn.",
    everybody=True,
    examples=[
        (
            "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
            {"areas": [{"id": 1, "start": 144, "count": 2}, {"id": 2, "start": 146, "count": 1}]},
        )
    ],
)
BulkWrite = instruction(
    "BulkWrite",
    0x93,
    "servos" / GreedyRange(Struct("id" / Byte, *AREA, "data" / Bytes(this.count))),
    doc="Write an area each in several servos. Never answered.",
    everybody=True,
    examples=[
        (
            "FF FF FD 00 FE 12 00 93 01 74 00 04 00 00 08 00 00 02 41 00 01 00 01 6F E1",
            {
                "servos": [
                    {"id": 1, "start": 116, "count": 4, "data": b"\0\x08\0\0"},
                    {"id": 2, "start": 65, "count": 1, "data": b"\x01"},
                ]
            },
        )
    ],
)
FastBulkRead = instruction(
    "FastBulkRead",
    0x9A,
    AREAS,
    doc="BulkRead with one joint answer.",
    everybody=True,
    examples=[
        (
            "FF FF FD 00 FE 0D 00 9A 01 84 00 04 00 02 92 00 01 00 F9 56",
            {"areas": [{"id": 1, "start": 132, "count": 4}, {"id": 2, "start": 146, "count": 1}]},
        )
    ],
)

# ---------------------------------------------------------------------- status

#: What is wrong with an instruction, by its number in a status.
REFUSALS = {
    "none": 0,
    "result_fail": 1,
    "instruction": 2,
    "crc": 3,
    "data_range": 4,
    "data_length": 5,
    "data_limit": 6,
    "access": 7,
}


def error() -> Any:
    """Return the error byte: what is wrong with the instruction, and whether register 70 has something to say."""
    return "error" / BitLayout(1, "code" / Enumeration(bits(7), REFUSALS), "alert" / bits(1))


FINE = {"code": "none", "alert": 0}

Status = packet(
    "Status",
    direction="from device",
    match={"id": SERVOS},
    payload=Struct(Const(0x55, Byte), error(), "parameters" / GreedyBytes),
    doc="A servo's answer: the bytes asked for; to a Ping model and firmware. `alert`: see register 70.",
    source="ROBOTIS e-manual, protocol 2.0, status packet",
    examples=[
        (
            "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D",
            {"id": 1, "error": FINE, "parameters": b"\x06\x04\x26"},
        ),
        (
            "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0",
            {"id": 1, "parameters": b"\xa6\0\0\0"},
        ),
        (
            "FF FF FD 00 01 04 00 55 84 B9 0F",
            {"error": {"code": "data_range", "alert": 1}, "parameters": b""},
        ),
    ],
)
FastStatus = packet(
    "FastStatus",
    direction="from device",
    match={"id": BROADCAST},
    payload=Struct(Const(0x55, Byte), error(), "parameters" / GreedyBytes),
    doc="A joint answer as bytes: id, data, check of the first servo, then error, id, data, check of each other one.",
    source="ROBOTIS e-manual, protocol 2.0, fast bulk read",
    examples=[
        (
            "FF FF FD 00 FE 0E 00 55 00 01 00 08 00 00 C7 05 00 02 1A 8E 06",
            {"error": FINE, "parameters": bytes.fromhex("01 00080000 C705 00 02 1A")},
        )
    ],
)
FastSyncStatus = packet(
    "FastSyncStatus",
    direction="from device",
    match={"id": BROADCAST},
    reply_to=FastSyncRead.where(count=range(1, 256)),
    within=0.5,
    overrides="FastStatus",
    payload=Struct(
        Const(0x55, Byte),
        "first" / Struct(error(), "id" / Byte, "data" / Bytes(this._._.count)),
        "others"
        / GreedyRange(Struct("check" / Int16ul, error(), "id" / Byte, "data" / Bytes(this._._.count))),
    ),
    doc="The joint answer to FastSyncRead; `check` is of the packet up to there. A missing servo leaves it short.",
    source="ROBOTIS e-manual, protocol 2.0, fast sync read",
    examples=[
        (
            "FF FF FD 00 FE 11 00 55 00 01 A6 00 00 00 74 3B 00 02 1F 08 00 00 1C 36",
            {"first": {"error": FINE, "id": 1, "data": b"\xa6\0\0\0"}},
            "FF FF FD 00 FE 09 00 8A 84 00 04 00 01 02 4D 72",
        )
    ],
)

# ---------------------------------------------------------------------- control table

control_table = dynamixel.registers(
    read=Read,
    write=Write,
    sync=SyncWrite,
    reply="Status.parameters",
    doc="Control table of the X series: EEPROM 0–63, RAM 64–147; words are little-endian. Models differ: `models.py`.",
)
add_x_registers(control_table)
