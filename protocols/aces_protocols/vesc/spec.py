"""VESC motor controllers on CAN: set-points, limits, status, and packets in pieces.

1. Identifiers are 29 bits: packet << 8 | controller; numbers have the high byte first.
2. Packets of `vesc_uart` travel in one frame up to six bytes, else through buffers (`buffers.py`).
3. `mode` says which way they go: 1 is an answer.

Facts: vedderb/bldc `comm/comm_can.c`, `datatypes.h`, `documentation/comm_can.md` (firmware 5.03 to 7.01).
"""

from __future__ import annotations

from typing import Any

from construct import Byte, Bytes, GreedyBytes, Int16sb, Int16ub, Int32sb, Struct

from aces_bus.protocol import Enumeration, IdField, Protocol
from aces_protocols.vesc_uart.numbers import in_steps

#: Everybody, as a controller.
BROADCAST = 255
_SOURCE = "vedderb/bldc comm/comm_can.c"

vesc = Protocol(
    "vesc",
    link="can",
    bitrate=500_000,
    broadcast={"id": BROADCAST},
    doc="VESC motor controllers on CAN.",
    source="vedderb/bldc comm/comm_can.c, documentation/comm_can.md",
)

Controller = IdField("id", range(256), doc="the controller, 255: all")


def _to_device(packet: int, name: str, payload: Struct, doc: str, *examples: Any) -> None:
    vesc.message(
        name,
        id=packet << 8 | Controller,
        extended=True,
        direction="to device",
        payload=payload,
        doc=doc,
        source=_SOURCE,
        examples=examples,
    )


def _status(packet: int, name: str, payload: Struct, doc: str, *examples: Any) -> None:
    vesc.message(
        name,
        id=packet << 8 | IdField("id", range(255), doc="the controller that sends it"),
        extended=True,
        direction="from device",
        payload=payload,
        doc=doc,
        source=_SOURCE,
        examples=examples,
    )


# ---------------------------------------------------------------------- set-points: each restarts the controller's time-out

SHARE, AMPERE, DEGREE = 1e5, 1e3, 1e6
_WHOLE = (-1.0, 1.0)

_to_device(
    0,
    "SetDuty",
    Struct("duty" / in_steps(Int32sb, "", SHARE, range=_WHOLE)),
    "Drive at a share of the supply.",
    ("00000005#FF FF 9E 58", {"id": 5, "duty": -0.25}),
)
_to_device(
    1,
    "SetCurrent",
    Struct("current" / in_steps(Int32sb, "A", AMPERE)),
    "Drive with a motor current; 0 releases the motor.",
    ("00000117#00 00 C7 38", {"id": 0x17, "current": 51.0}),
)
_to_device(
    2,
    "SetBrakeCurrent",
    Struct("current" / in_steps(Int32sb, "A", AMPERE)),
    "Brake with a motor current.",
    ("00000205#00 00 13 88", {"id": 5, "current": 5.0}),
)
_to_device(
    3,
    "SetSpeed",
    Struct("speed" / in_steps(Int32sb, "rpm", 1)),
    "Hold an electrical speed: turns of the field, pole pairs × those of the motor.",
    ("00000305#00 00 0B B8", {"id": 5, "speed": 3000}),
)
_to_device(
    4,
    "SetPosition",
    Struct("position" / in_steps(Int32sb, "°", DEGREE)),
    "Hold an angle of the encoder; it is taken within a turn.",
    ("00000405#05 5D 4A 80", {"id": 5, "position": 90.0}),
)
_to_device(
    10,
    "SetCurrentRelative",
    Struct("current" / in_steps(Int32sb, "", SHARE, range=_WHOLE)),
    "Drive with a share of the maximum current; of the minimum where it opposes the motion.",
    ("00000A05#FF FF 9E 58", {"id": 5, "current": -0.25}),
)
_to_device(
    11,
    "SetBrakeRelative",
    Struct("current" / in_steps(Int32sb, "", SHARE, range=_WHOLE)),
    "Brake with a share of the minimum current.",
    ("00000B05#00 00 61 A8", {"id": 5, "current": 0.25}),
)
_to_device(
    12,
    "SetHandbrake",
    Struct("current" / in_steps(Int32sb, "A", AMPERE)),
    "Hold where it is, with a current.",
    ("00000C05#00 00 13 88", {"id": 5, "current": 5.0}),
)
_to_device(
    13,
    "SetHandbrakeRelative",
    Struct("current" / in_steps(Int32sb, "", SHARE, range=_WHOLE)),
    "Hold where it is, with a share of the minimum current.",
    ("00000D05#00 00 61 A8", {"id": 5, "current": 0.25}),
)

# ---------------------------------------------------------------------- settings

_LIMITS = Struct("minimum" / in_steps(Int32sb, "A", AMPERE), "maximum" / in_steps(Int32sb, "A", AMPERE))
for number, name, what in (
    (21, "LimitCurrent", "Limits of the motor current; the minimum is below 0"),
    (23, "LimitInputCurrent", "Limits of the supply's current; the minimum is below 0"),
):
    values = {"id": 5, "minimum": -30.0, "maximum": 60.0}
    for store, more in ((0, ", until it is switched off."), (1, ", stored.")):
        example = (f"0000{number + store:02X}05#FF FF 8A D0 00 00 EA 60", values)
        _to_device(number + store, name + "Stored" * store, _LIMITS, what + more, example)
_BATTERY = Struct("start" / in_steps(Int32sb, "V", 1e3), "end" / in_steps(Int32sb, "V", 1e3))
for store, more in ((0, ", until it is switched off."), (1, ", stored.")):
    _to_device(
        29 + store,
        "SetBatteryCut" + "Stored" * store,
        _BATTERY,
        "The supply at which it begins to give less, and that at which it gives nothing" + more,
        (f"0000{29 + store:02X}05#00 00 84 D0 00 00 75 30", {"id": 5, "start": 34.0, "end": 30.0}),
    )
_to_device(31, "Shutdown", Struct(), "Switch it off.", ("00001F05#", {"id": 5}))
_to_device(
    55,
    "SetPositionOffset",
    Struct("offset" / in_steps(Int32sb, "°", 1e4), "store" / Byte),
    "Move the encoder's zero.",
    ("00003705#00 0D BB A0 00", {"id": 5, "offset": 90.0, "store": 0}),
)

# ---------------------------------------------------------------------- who is there

_to_device(
    17,
    "Ping",
    Struct("host" / Byte),
    "Ask whether it is there; `host` is who asks.",
    ("00001105#C8", {"id": 5, "host": 0xC8}),
)
vesc.message(
    "Pong",
    id=18 << 8 | IdField("host", range(256), doc="who asked"),
    extended=True,
    direction="from device",
    payload=Struct("id" / Byte, "hardware" / Enumeration(Byte, vesc=0, bms=1, custom=2)),
    doc="The answer to a ping; to one of everybody it says 255.",
    source=_SOURCE,
    examples=[("000012C8#05 00", {"host": 0xC8, "id": 5, "hardware": "vesc"})],
)
_to_device(56, "PollPosition", Struct(), "Ask for the rotor's angle.", ("00003805#", {"id": 5}))
_status(
    56,
    "RotorPosition",
    Struct("position" / in_steps(Int32sb, "°", SHARE)),
    "The rotor's angle, when it was asked for.",
    ("00003805#00 89 54 40", {"id": 5, "position": 90.0}),
)

# ---------------------------------------------------------------------- status, by itself at the configured rates

_status(
    9,
    "Status",
    Struct(
        "speed" / in_steps(Int32sb, "rpm", 1) * "electrical",
        "current" / in_steps(Int16sb, "A", 10) * "of the motor",
        "duty" / in_steps(Int16sb, "", 1000),
    ),
    "Speed, current, duty.",
    ("00000905#FF FF FA 24 00 7B FF 83", {"id": 5, "speed": -1500, "current": 12.3, "duty": -0.125}),
)
_status(
    14,
    "Status2",
    Struct("used" / in_steps(Int32sb, "A·h", 1e4), "charged" / in_steps(Int32sb, "A·h", 1e4)),
    "Charge since it was switched on.",
    ("00000E05#00 00 30 39 00 00 00 64", {"id": 5, "used": 1.2345, "charged": 0.01}),
)
_status(
    15,
    "Status3",
    Struct("used" / in_steps(Int32sb, "W·h", 1e4), "charged" / in_steps(Int32sb, "W·h", 1e4)),
    "Energy since it was switched on.",
    ("00000F05#00 00 30 39 00 00 00 64", {"id": 5, "used": 1.2345, "charged": 0.01}),
)
_status(
    16,
    "Status4",
    Struct(
        "fet_temperature" / in_steps(Int16sb, "°C", 10),
        "motor_temperature" / in_steps(Int16sb, "°C", 10),
        "input_current" / in_steps(Int16sb, "A", 10),
        "position" / in_steps(Int16sb, "°", 50),
    ),
    "Temperatures, supply current, the encoder's angle.",
    (
        "00001005#01 9C 01 63 FF D3 11 94",
        {
            "id": 5,
            "fet_temperature": 41.2,
            "motor_temperature": 35.5,
            "input_current": -4.5,
            "position": 90.0,
        },
    ),
)
_status(
    27,
    "Status5",
    Struct(
        "tachometer" / Int32sb * "six a turn of the field",
        "voltage" / in_steps(Int16sb, "V", 10),
        "reserved" / Int16sb,
    ),
    "How far it has turned; the supply.",
    ("00001B05#00 00 02 58 01 E2 00 00", {"id": 5, "tachometer": 600, "voltage": 48.2}),
)
_status(
    58,
    "Status6",
    Struct(
        "adc1" / in_steps(Int16sb, "V", 1e3),
        "adc2" / in_steps(Int16sb, "V", 1e3),
        "adc3" / in_steps(Int16sb, "V", 1e3),
        "ppm" / in_steps(Int16sb, "", 1e3),
    ),
    "Inputs (firmware 6.00 and later).",
    ("00003A05#03 E8 07 D0 0B B8 FE 0C", {"id": 5, "adc1": 1.0, "adc2": 2.0, "adc3": 3.0, "ppm": -0.5}),
)

# ---------------------------------------------------------------------- packets of vesc_uart, in pieces

Receiver = IdField("receiver", range(256), doc="whose buffers: a controller, or the host that asked")
#: Of packets to a controller: 0 and 2 carry it out with and without an answer, 3 answers as if it were a request.
REQUESTS = (0, 2, 3)
ANSWER = 1

# aces: allow direction
vesc.message(
    "FillBuffer",
    id=5 << 8 | Receiver,
    extended=True,
    length=range(1, 9),
    payload=Struct("offset" / Byte, "data" / GreedyBytes),
    doc="A piece of a packet, of offsets up to 255.",
    source=_SOURCE,
    examples=[
        (
            "000005C8#00 32 00 00 81 C0 FF 83",
            {"receiver": 0xC8, "offset": 0, "data": bytes.fromhex("320000 81C0FF83")},
        ),
        ("000005C8#07 FF FF FA 24 01 E2 00", {"receiver": 0xC8, "offset": 7}),
    ],
)
# aces: allow direction
vesc.message(
    "FillBufferFar",
    id=6 << 8 | Receiver,
    extended=True,
    length=range(2, 9),
    payload=Struct("offset" / Int16ub, "data" / GreedyBytes),
    doc="A piece of a packet, of offsets from 256 on.",
    source=_SOURCE,
    examples=[("000006C8#01 03 AA BB CC DD EE FF", {"receiver": 0xC8, "offset": 259})],
)


def _piece(
    packet: int, to_device: bool, name: str, payload: Struct, length: Any, doc: str, *examples: Any
) -> None:
    """Declare the last frame of a packet, or its only frame: the identifier addresses, the first byte names
    the sender.
    """
    addressed, sender = ("id", "host") if to_device else ("host", "id")
    vesc.message(
        name,
        id=packet << 8 | IdField(addressed, range(256), doc="who gets it"),
        extended=True,
        direction="to device" if to_device else "from device",
        length=length,
        prefix=Struct(sender / Byte, "mode" / Byte),
        match={"mode": REQUESTS if to_device else ANSWER},
        payload=payload,
        doc=doc,
        source=_SOURCE,
        examples=examples,
    )


_SHORT = Struct("packet" / GreedyBytes)
_LONG = Struct("length" / Int16ub, "crc" / Bytes(2))
_piece(
    8,
    True,
    "ShortRequest",
    _SHORT,
    range(3, 9),
    "A packet of up to six bytes.",
    (
        "00000805#C8 00 32 00 00 81 C0",
        {"id": 5, "host": 0xC8, "mode": 0, "packet": bytes.fromhex("32 00 00 81 C0")},
    ),
)
_piece(
    8,
    False,
    "ShortAnswer",
    _SHORT,
    range(3, 9),
    "A packet of up to six bytes, asked for before.",
    (
        "000008C8#05 01 32 00 00 80 00 00",
        {"id": 5, "host": 0xC8, "packet": bytes.fromhex("32 00 00 80 00 00")},
    ),
)
_piece(
    7,
    True,
    "LongRequest",
    _LONG,
    None,
    "The packet that has been put into buffers, with its check.",
    (
        "00000705#C8 00 00 0E E7 97",
        {"id": 5, "host": 0xC8, "mode": 0, "length": 14, "crc": bytes.fromhex("E7 97")},
    ),
)
_piece(
    7,
    False,
    "LongAnswer",
    _LONG,
    None,
    "The answer that has been put into buffers, with its check.",
    ("000007C8#05 01 00 0E E7 97", {"id": 5, "host": 0xC8, "length": 14, "crc": bytes.fromhex("E7 97")}),
)
