"""Modbus RTU with a Robotiq FT 300 force sensor on the line.

What it asks of the language: packets that end by silence; requests and answers that only their direction tells apart;
answers whose meaning is that of their request; a second framing, of a free-running stream, on the same line.

Sources: pymodbus `framer/rtu.py`, `pdu`; ros-industrial/robotiq `rq_sensor_com.cpp`; Robotiq FT 300 manual.
Deviations: the pause of 1.5 characters inside a packet that spoils it is not looked at; counts of bytes are given
when building, like any field.
"""

from __future__ import annotations

from construct import Array, Byte, Const, Int16sb, Int16sl, Int16ub, Struct, this

from aces_bus.protocol import Crc, Enumeration, Protocol, Quantity

modbus_like = Protocol(
    "modbus_like",
    link="serial",
    baud=19_200,
    broadcast={"unit": 0},
    doc="Modbus RTU registers and the stream of an FT 300.",
    source="pymodbus framer/rtu.py",
)

# The stream first: it knows its size, and so never waits for silence.
modbus_like.framing(
    name="stream", sync=b"\x20\x4e", size=16, gap=0.08, check=Crc("CRC16-MODBUS", over=slice(0, -2))
)(
    "ForceTorque",
    direction="from device",
    payload=Struct(
        "force" / Array(3, Quantity(Int16sl, scale=0.01, unit="N")),
        "torque" / Array(3, Quantity(Int16sl, scale=0.001, unit="N·m")),
    ),
    doc="Force and torque, 100 times a second.",
    source="FT 300 manual, data stream",
)

packet = modbus_like.framing(
    name="rtu",
    header=Struct("unit" / Byte, "function" / Byte),
    end="silence",
    gap=0.00175,
    max_size=256,
    check=Crc("CRC16-MODBUS"),
)

#: Reading holding registers, reading input registers.
READ = {"function": (0x03, 0x04)}

Read = packet(
    "Read",
    direction="to device",
    match=READ,
    payload=Struct("start" / Int16ub, "count" / Int16ub),
    doc="Ask for registers.",
    source="pymodbus pdu, functions 3 and 4",
)
ReadAnswer = packet(
    "ReadAnswer",
    direction="from device",
    match=READ,
    reply_to=Read,
    payload=Struct("size" / Byte, "registers" / Array(this.size // 2, Int16ub)),
    doc="The registers asked for; which, the request knows.",
    source="pymodbus pdu, functions 3 and 4",
)
packet(
    "ReadForceTorque",
    direction="from device",
    match={"function": 0x03},
    reply_to=Read.where(start=180, count=6),
    overrides="ReadAnswer",
    payload=Struct(
        Const(12, Byte),
        "force" / Array(3, Quantity(Int16sb, scale=0.01, unit="N")),
        "torque" / Array(3, Quantity(Int16sb, scale=0.001, unit="N·m")),
    ),
    doc="Registers 180 to 185 of an FT 300.",
    source="FT 300 manual, registers",
)
packet(
    "Write",
    match={"function": 0x06},
    payload=Struct("start" / Int16ub, "value" / Int16ub),
    doc="Write one register; the answer is the same bytes.",
    source="pymodbus pdu, function 6",
)
WriteMany = packet(
    "WriteMany",
    direction="to device",
    match={"function": 0x10},
    payload=Struct(
        "start" / Int16ub, "count" / Int16ub, "size" / Byte, "registers" / Array(this.count, Int16ub)
    ),
    doc="Write registers.",
    source="pymodbus pdu, function 16",
)
packet(
    "WriteManyAnswer",
    direction="from device",
    match={"function": 0x10},
    reply_to=WriteMany,
    payload=Struct("start" / Int16ub, "count" / Int16ub),
    doc="Registers were written.",
    source="pymodbus pdu, function 16",
)
packet(
    "Refusal",
    direction="from device",
    match={"function": (0x83, 0x84, 0x86, 0x90)},
    payload=Struct(
        "reason"
        / Enumeration(Byte, function=1, address=2, value=3, device=4, acknowledge=5, busy=6, parity=8)
    ),
    doc="A request was refused.",
    source="pymodbus pdu, exceptions",
)
