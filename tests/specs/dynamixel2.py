"""Dynamixel protocol 2.0.

What it asks of the language: stuffing inside a packet whose length counts it, a CRC over the whole packet from its
first sync byte, lists of devices and of their data, answers whose layout depends on the question.

Sources: ROBOTIS e-manual `protocol2.md`; ROBOTIS-GIT/DynamixelSDK.
Deviations: the inner checks of a fast answer, each over the packet up to itself, are fields and not verified (the
last one is the packet's own, and is). A fast bulk answer needs the list of lengths in its question, which the
language cannot take from there: it is a plain `Status`. DynamixelSDK 4.1 neither stuffs what it sends nor unstuffs
fast answers.
"""

from __future__ import annotations

from typing import Any

from construct import Byte, Bytes, Const, GreedyBytes, GreedyRange, Int16ul, Int32ul, Struct, this

from aces_bus.protocol import BitLayout, Crc, Enumeration, Insert, Protocol, bits

dynamixel2 = Protocol(
    "dynamixel2",
    link="serial",
    baud=57_600,
    broadcast={"id": 0xFE},
    doc="Dynamixel protocol 2.0: half-duplex, several servos on one line.",
    source="ROBOTIS e-manual, protocol 2.0",
)

packet = dynamixel2.framing(
    sync=b"\xff\xff\xfd\x00",
    header=Struct("id" / Byte, "length" / Int16ul),
    size=this.length + 7,
    max_size=1024,
    gap=0.1,
    stuffing=Insert(b"\xff\xff\xfd", b"\xfd"),
    check=Crc("CRC16-UMTS", over=slice(0, -2)),
)


def instruction(name: str, code: int, *fields: Any, doc: str, everyone: bool = False) -> None:
    packet(
        name,
        direction="to device",
        match={"id": 0xFE} if everyone else {},
        payload=Struct(Const(code, Byte), *fields),
        doc=doc,
        source=f"protocol 2.0, instruction {code:#04x}",
    )


AREA = ("start" / Int16ul, "count" / Int16ul)
WRITE = ("start" / Int16ul, "data" / GreedyBytes)

instruction("Ping", 0x01, doc="Ask who is there.")
instruction("Read", 0x02, *AREA, doc="Ask for `count` bytes of the control table.")
instruction("Write", 0x03, *WRITE, doc="Write bytes of the control table.")
instruction("RegWrite", 0x04, *WRITE, doc="Write, held back until Action.")
instruction("Action", 0x05, doc="Carry out what RegWrite held back.")
instruction(
    "FactoryReset",
    0x06,
    "keep" / Enumeration(Byte, nothing=0xFF, id=0x01, id_and_baud=0x02),
    doc="Back to factory defaults.",
)
instruction("Reboot", 0x08, doc="Restart.")
instruction("Clear", 0x10, Const(b"\x01\x44\x58\x4c\x22"), doc="Forget full turns.")
instruction(
    "SyncRead", 0x82, *AREA, "ids" / GreedyRange(Byte), doc="The same area of several devices.", everyone=True
)
instruction(
    "SyncWrite",
    0x83,
    *AREA,
    "servos" / GreedyRange(Struct("id" / Byte, "data" / Bytes(this._.count))),
    doc="Other values to the same area of several devices.",
    everyone=True,
)
instruction(
    "FastSyncRead",
    0x8A,
    *AREA,
    "ids" / GreedyRange(Byte),
    doc="SyncRead with one joint answer.",
    everyone=True,
)
instruction(
    "BulkRead",
    0x92,
    "areas" / GreedyRange(Struct("id" / Byte, *AREA)),
    doc="Any area of several devices.",
    everyone=True,
)
instruction(
    "BulkWrite",
    0x93,
    "servos" / GreedyRange(Struct("id" / Byte, *AREA, "data" / Bytes(this.count))),
    doc="Values to any area of several devices.",
    everyone=True,
)
instruction(
    "FastBulkRead",
    0x9A,
    "areas" / GreedyRange(Struct("id" / Byte, *AREA)),
    doc="BulkRead with one joint answer.",
    everyone=True,
)

# ---------------------------------------------------------------------- status


def error(name: str = "error") -> Any:
    """The error byte: a number and the alert bit."""
    return name / BitLayout(
        1,
        "code"
        / Enumeration(
            bits(7),
            none=0,
            result_fail=1,
            instruction=2,
            crc=3,
            data_range=4,
            data_length=5,
            data_limit=6,
            access=7,
        ),
        "alert" / bits(1),
    )


Status = packet(
    "Status",
    direction="from device",
    payload=Struct(Const(0x55, Byte), error(), "parameters" / GreedyBytes),
    doc="A device's answer; `alert` means: look at register 70.",
    source="protocol 2.0, status packet",
)
packet(
    "PingStatus",
    direction="from device",
    reply_to="Ping",
    within=0.5,
    overrides="Status",
    payload=Struct(Const(0x55, Byte), error(), "model" / Int16ul, "firmware" / Byte),
    doc="The answer to a ping.",
    source="protocol 2.0, ping",
)
packet(
    "FastSyncStatus",
    direction="from device",
    match={"id": 0xFE},
    reply_to=dynamixel2["FastSyncRead"].where(count=range(1, 256)),
    within=0.5,
    overrides="Status",
    payload=Struct(
        Const(0x55, Byte),
        "first" / Struct(error(), "id" / Byte, "data" / Bytes(this._._.count)),
        "others"
        / GreedyRange(Struct("check" / Int16ul, error(), "id" / Byte, "data" / Bytes(this._._.count))),
    ),
    doc="The joint answer to FastSyncRead; `check` is of the packet up to there. A missing device leaves it short.",
    source="protocol 2.0, fast sync read",
)

# ---------------------------------------------------------------------- control table of the X series (a part)

control_table = dynamixel2.registers(read="Read", write="Write", doc="X series, XM430-W350")
control_table.add("model", 0, Int16ul, access="read", default=1020)
control_table.add("firmware", 6, Byte, access="read")
control_table.add("id", 7, Byte, range=(0, 252), default=1)
control_table.add("torque_enable", 64, Byte, range=(0, 1), default=0)
control_table.add("goal_position", 116, Int32ul, unit="°", scale=360 / 4096, range=(0, 4095))
control_table.add("present_position", 132, Int32ul, unit="°", scale=360 / 4096, access="read")
control_table.add("input_voltage", 144, Int16ul, unit="V", scale=0.1, access="read")
control_table.add("temperature", 146, Byte, unit="°C", access="read")
