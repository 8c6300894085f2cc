"""Modbus RTU: registers and bits of any device, on a serial line with one master.

1. The function says how long a packet is, and which way it goes the rest: a request and its answer look alike.
2. An answer says neither what was read nor from where. `start` is its request's; registers that nobody asked for have no
   addresses (`UnaskedRegisters`), bits are unknown. Where `count` is not the number of values, the answer is late, and
   another request's.
3. Packets of functions that are not declared here end by silence. All others need none, so that a recording without times
   is read all the same.

Sources: the Modbus application protocol and serial line guide; pymodbus-dev/pymodbus `pymodbus/framer/rtu.py`,
`pymodbus/pdu/*`. The stream of `robotiq_ft300`: ros-industrial/robotiq `rq_sensor_com.cpp`.
"""

from __future__ import annotations

from typing import Any

from construct import Array, Byte, Construct, GreedyBytes, GreedyRange, Int16sl, Int16ub, Struct, this

from aces_bus.protocol import Crc, Enumeration, IdField, Protocol, Quantity

modbus = Protocol(
    "modbus",
    link="serial",
    baud=19_200,
    half_duplex=True,
    broadcast={"unit": 0},
    doc="Modbus RTU: registers and bits of any device.",
    source="Modbus application protocol; pymodbus framer/rtu.py, pdu",
)

#: How long a pause inside a packet may be, and how long the one behind it is at least (s). The standard has 1.75 ms, which
#: cannot be seen through adapters: they collect bytes for 16 ms.
GAP = 0.03
#: The longest packet (bytes).
MAX_SIZE = 256
#: Functions whose packets are declared, and those that may be used and are not.
READ_BITS, READ_REGISTERS = (1, 2), (3, 4)
OTHERS = (7, 8, 11, 12, 17, 20, 21, 24, 43, *range(65, 73), *range(100, 111))
#: The address and the number of what is read.
ADDRESSES, BITS, REGISTERS = range(0x10000), range(1, 2001), range(1, 126)

#: The stream of Robotiq's sensors, in place of unit 32, function 78: one that the standard leaves out.
_stream = modbus.framing(
    name="stream", sync=b"\x20\x4e", size=16, gap=GAP, check=Crc("CRC16-MODBUS", over=slice(0, -2))
)


def _framing(name: str, functions: tuple[int, ...], header: Struct | None = None, **ends: Any) -> Any:
    """Declare packets of these functions."""
    return modbus.framing(
        name=name,
        header=header or Struct("unit" / Byte, "function" / Byte),
        match={"function" if header is None else header.subcons[1].name: functions},
        check=Crc("CRC16-MODBUS"),
        gap=GAP,
        **ends,
    )


# Requests first: of what another program asks and is answered, they say which is which.
_asking = _framing("request", (*READ_BITS, *READ_REGISTERS), size=8)
_setting = _framing("setting", (5, 6), size=8)
_masking = _framing("masked setting", (22,), size=10)
_writing = _framing(
    "counted request",
    (15, 16),
    Struct("unit" / Byte, "function" / Byte, "start" / Int16ub, "count" / Int16ub, "size" / Byte),
    size=this.size + 9,
    max_size=MAX_SIZE,
)
_exchanging = _framing(
    "two-way request",
    (23,),
    Struct(
        "unit" / Byte, "function" / Byte, "start" / Int16ub, "count" / Int16ub, "write_start" / Int16ub,
        "write_count" / Int16ub, "size" / Byte,
    ),
    size=this.size + 13,
    max_size=MAX_SIZE,
)  # fmt: skip
_refusing = _framing("refusal", tuple(range(0x81, 0x100)), Struct("unit" / Byte, "code" / Byte), size=5)
_counted = _framing(
    "counted answer",
    (*READ_BITS, *READ_REGISTERS, 23),
    Struct("unit" / Byte, "function" / Byte, "size" / Byte),
    size=this.size + 5,
    max_size=MAX_SIZE,
)
_written = _framing("answer", (15, 16), size=8)
_silent = _framing("other function", OTHERS, end="silence", max_size=MAX_SIZE)

# ---------------------------------------------------------------------- reading

ReadBits = _asking(
    "ReadBits",
    direction="to device",
    match={"function": READ_BITS},
    payload=Struct("start" / Int16ub, "count" / Quantity(Int16ub, raw_range=(1, 2000))),
    doc="Ask for bits: coils (1) or discrete inputs (2).",
    source="Modbus application protocol 6.1, 6.2",
    examples=[("11 01 00 13 00 25 0E 84", {"unit": 17, "function": 1, "start": 19, "count": 37})],
)
ReadRegisters = _asking(
    "ReadRegisters",
    direction="to device",
    match={"function": READ_REGISTERS},
    payload=Struct("start" / Int16ub, "count" / Quantity(Int16ub, raw_range=(1, 125))),
    doc="Ask for registers: holding (3) or input registers (4).",
    source="Modbus application protocol 6.3, 6.4; FT 300-S manual",
    examples=[("09 03 00 B4 00 06 84 A6", {"unit": 9, "function": 3, "start": 180, "count": 6})],
)
ExchangeRegisters = _exchanging(
    "ExchangeRegisters",
    direction="to device",
    match={"function": 23},
    payload=Struct("registers" / GreedyRange(Int16ub)),
    doc="Write registers, then ask for others.",
    source="Modbus application protocol 6.17",
    examples=[
        (
            "11 17 00 03 00 06 00 0E 00 03 06 00 FF 00 FF 00 FF 4B 54",
            {"start": 3, "count": 6, "write_start": 14, "write_count": 3, "registers": [255, 255, 255]},
        )
    ],
)
Bits = _counted(
    "Bits",
    direction="from device",
    match={"function": READ_BITS},
    reply_to=ReadBits.where(start=ADDRESSES, count=BITS),
    payload=Struct("bits" / GreedyBytes),
    doc="The bits that were asked for: the first is the lowest of the first byte.",
    source="Modbus application protocol 6.1, 6.2",
    examples=[
        (
            "11 01 05 CD 6B B2 0E 1B 45 E6",
            {"start": 19, "count": 37, "bits": b"\xcd\x6b\xb2\x0e\x1b"},
            "11 01 00 13 00 25 0E 84",
        )
    ],
)
UnaskedRegisters = _counted(
    "UnaskedRegisters",
    direction="from device",
    match={"function": (*READ_REGISTERS, 23)},
    payload=Struct("registers" / GreedyRange(Int16ub)),
    doc="Registers whose request was not seen: which they are is not known.",
    source="Modbus application protocol 6.3, 6.4",
    examples=[("09 03 02 03 E8 59 3B", {"unit": 9, "registers": [1000]})],
)
Registers = _counted(
    "Registers",
    direction="from device",
    match={"function": (*READ_REGISTERS, 23)},
    reply_to=(
        ReadRegisters.where(start=ADDRESSES, count=REGISTERS),
        ExchangeRegisters.where(start=ADDRESSES, count=REGISTERS),
    ),
    overrides="UnaskedRegisters",
    payload=Struct("registers" / GreedyRange(Int16ub)),
    doc="The registers that were asked for, as they are on the wire: 16 bits each, without a sign.",
    source="Modbus application protocol 6.3, 6.4; FT 300-S manual",
    examples=[
        (
            "09 03 0C 03 E8 FF 06 13 88 00 64 FF EC 00 05 F5 B9",
            {"unit": 9, "start": 180, "count": 6, "registers": [1000, 0xFF06, 5000, 100, 0xFFEC, 5]},
            "09 03 00 B4 00 06 84 A6",
        )
    ],
)

# ---------------------------------------------------------------------- writing

_ONE_BIT = Struct("start" / Int16ub, "value" / Enumeration(Int16ub, off=0, on=0xFF00))
_ONE_REGISTER = Struct("start" / Int16ub, "value" / Int16ub)
_MASKED = Struct("start" / Int16ub, "and_mask" / Int16ub, "or_mask" / Int16ub)


def _echoed(
    framing: Any,
    number: int,
    ask: str,
    answer: str,
    payload: Construct,
    doc: str,
    example: str,
    **values: Any,
) -> Any:
    """Return a request whose answer is the same bytes."""
    shared = {"match": {"function": number}, "payload": payload, "source": "Modbus application protocol 6"}
    made = framing(ask, direction="to device", doc=doc, examples=[(example, values)], **shared)
    framing(
        answer,
        direction="from device",
        reply_to=made,
        doc="It was done; the same bytes as the request.",
        examples=[(example, values, example)],
        **shared,
    )
    return made


WriteBit = _echoed(
    _setting,
    5,
    "WriteBit",
    "BitWritten",
    _ONE_BIT,
    "Set a coil.",
    "11 05 00 AC FF 00 4E 8B",
    start=172,
    value="on",
)
WriteRegister = _echoed(
    _setting, 6, "WriteRegister", "RegisterWritten", _ONE_REGISTER, "Set a holding register.",
    "11 06 00 01 00 03 9A 9B", start=1, value=3,
)  # fmt: skip
MaskRegister = _echoed(
    _masking, 22, "MaskRegister", "RegisterMasked", _MASKED,
    "Set bits of a holding register: (old and and_mask) or (or_mask and not and_mask).",
    "11 16 00 04 00 F2 00 25 66 E2", start=4, and_mask=0xF2, or_mask=0x25,
)  # fmt: skip
WriteBits = _writing(
    "WriteBits",
    direction="to device",
    match={"function": 15},
    payload=Struct("bits" / GreedyBytes),
    doc="Set `count` coils; the first is the lowest of the first byte.",
    source="Modbus application protocol 6.11",
    examples=[("11 0F 00 13 00 0A 02 CD 01 BF 0B", {"start": 19, "count": 10, "bits": b"\xcd\x01"})],
)
WriteRegisters = _writing(
    "WriteRegisters",
    direction="to device",
    match={"function": 16},
    payload=Struct("registers" / GreedyRange(Int16ub)),
    doc="Set `count` holding registers.",
    source="Modbus application protocol 6.12; FT 300 manual",
    examples=[
        ("09 10 01 9A 00 01 02 02 00 CD CA", {"unit": 9, "start": 410, "count": 1, "registers": [0x0200]})
    ],
)
_DONE = Struct("start" / Int16ub, "count" / Int16ub)
_written(
    "BitsWritten",
    direction="from device",
    match={"function": 15},
    reply_to=WriteBits,
    payload=_DONE,
    doc="Coils were set.",
    source="Modbus application protocol 6.11",
    examples=[("11 0F 00 13 00 0A 26 99", {"start": 19, "count": 10}, "11 0F 00 13 00 0A 02 CD 01 BF 0B")],
)
_written(
    "RegistersWritten",
    direction="from device",
    match={"function": 16},
    reply_to=WriteRegisters,
    payload=_DONE,
    doc="Registers were set.",
    source="Modbus application protocol 6.12",
    examples=[("09 10 01 9A 00 01 21 52", {"start": 410, "count": 1}, "09 10 01 9A 00 01 02 02 00 CD CA")],
)

# ---------------------------------------------------------------------- the rest

Other = _silent(
    "Other",
    direction="to device",
    match={"function": OTHERS},
    payload=Struct("data" / GreedyBytes),
    doc="A function that is not declared here.",
    source="Modbus application protocol 5.1; 6.8 (diagnostics)",
    examples=[("11 08 00 00 A5 37 D8 1D", {"unit": 17, "function": 8, "data": b"\0\0\xa5\x37"})],
)
_silent(
    "OtherAnswer",
    direction="from device",
    match={"function": OTHERS},
    reply_to=Other,
    payload=Struct("data" / GreedyBytes),
    doc="The answer to such a function.",
    source="Modbus application protocol 5.1; 6.8 (diagnostics)",
    examples=[("11 08 00 00 A5 37 D8 1D", {"unit": 17, "data": b"\0\0\xa5\x37"}, "11 08 00 00 A5 37 D8 1D")],
)
_refusing(
    "Refusal",
    direction="from device",
    match={"code": 0x80 | IdField("function", range(1, 0x80), doc="that was asked for")},
    reply_to=(
        ReadBits, ReadRegisters, ExchangeRegisters, WriteBit, WriteRegister, MaskRegister, WriteBits, WriteRegisters, Other,
    ),
    payload=Struct(
        "reason"
        / Enumeration(
            Byte,
            function=1,
            address=2,
            value=3,
            device_failure=4,
            acknowledge=5,
            busy=6,
            memory_parity=8,
            gateway_path=10,
            gateway_target=11,
        )
    ),
    doc="A request was refused.",
    source="Modbus application protocol 7",
    examples=[("09 83 02 41 33", {"unit": 9, "function": 3, "reason": "address"}, "09 03 00 B4 00 06 84 A6")],
)  # fmt: skip
ForceTorque = _stream(
    "ForceTorque",
    direction="from device",
    payload=Struct(
        "force" / Array(3, Quantity(Int16sl, unit="N", scale=0.01)),  # aces: allow byte-order
        "torque" / Array(3, Quantity(Int16sl, unit="N·m", scale=0.001)),  # aces: allow byte-order
    ),
    doc="What a Robotiq FT 300 sends by itself, 100 times a second: the other byte order than its registers.",
    source="ros-industrial/robotiq rq_sensor_com.cpp; FT 300 manual",
    examples=[
        (
            "20 4E E8 03 06 FF 88 13 64 00 EC FF 05 00 8F F2",
            {"force": [10.0, -2.5, 50.0], "torque": [0.1, -0.02, 0.005]},
        )
    ],
)
