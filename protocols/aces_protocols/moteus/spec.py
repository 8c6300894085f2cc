"""mjbots moteus brushless servo controllers: registers on CAN FD, in sub-frames.

1. A frame to a device writes registers, then reads others; `Query` wants an answer, `Command` none.
2. The host is number 0, as in mjbots' own programs: the identifier then says which way a frame goes.
3. Identifiers above 0x7FF need extended frames; below, a device sends and expects standard ones.

Facts: mjbots/moteus docs/protocol/can.md and registers.md.
"""

from __future__ import annotations

from math import nan
from typing import Any

from construct import Struct

from aces_bus.protocol import IdField, Protocol

from .subframes import Subframes

#: Everybody, as a destination.
BROADCAST = 0x7F
#: The bit of the identifier that asks for a reply.
REPLY_WANTED = 0x8000

moteus = Protocol(
    "moteus",
    link="can",
    bitrate=1_000_000,
    broadcast={"id": BROADCAST},
    doc="mjbots moteus brushless servo controllers on CAN FD.",
    source="mjbots/moteus docs/protocol/can.md, registers.md",
)

_PAYLOAD = Struct("subframes" / Subframes() * "what is written, read or answered, see subframes.py")
_CAN = "mjbots/moteus docs/protocol/can.md"


def _item(kind: str, data: Any) -> dict[str, Any]:
    return {"kind": kind, "data": data, "reason": None}


_STOP = _item("write_i8", {"mode": "stopped"})
_MODE = _item("write_i8", {"mode": "position"})
#: What mjbots' own programs ask for: mode i8, position, velocity, torque f32; voltage, temperature, fault i8.
DEFAULT_QUERY = [
    _item("read_i8", ["mode"]),
    _item("read_f32", ["position", "velocity", "torque"]),
    _item("read_i8", ["voltage", "temperature", "fault"]),
]

Destination = IdField("id", range(1, 128), doc="the device, 0x7F: all")

Command = moteus.message(
    "Command",
    id=0x0000 + Destination,
    fd=True,
    direction="to device",
    payload=_PAYLOAD,
    doc="Write registers; nothing is answered.",
    source=_CAN,
    examples=[
        ("001##1 01 00 00", {"id": 1, "subframes": [_STOP]}),
        (
            "001##1 01 00 0A 06 20 88 13 00 80 05 25 64 00 50 50 50",
            {
                "id": 1,
                "subframes": [
                    _MODE,
                    _item("write_i16", {"command_position": 0.5, "command_velocity": nan}),
                    _item("write_i16", {"command_position_max_torque": 1.0}),
                    _item("nop", 3),
                ],
            },
        ),
        (
            "001##1 01 00 0A 0E 20 00 00 C0 7F CD CC CC 3D 0D 27 00 00 C0 7F 50",
            {
                "id": 1,
                "subframes": [
                    _MODE,
                    _item("write_f32", {"command_position": nan, "command_velocity": 0.10000000149011612}),
                    _item("write_f32", {"command_timeout": nan}),
                    _item("nop", 1),
                ],
            },
        ),
    ],
)
Query = moteus.message(
    "Query",
    id=REPLY_WANTED + Destination,
    extended=True,
    fd=True,
    direction="to device",
    payload=_PAYLOAD,
    doc="Write registers and read others; `Reply` has what was read.",
    source=_CAN,
    examples=[
        ("00008001##1 11 00 1F 01 13 0D", {"id": 1, "subframes": DEFAULT_QUERY}),
        (
            "00008001##1 01 00 0A 07 20 60 00 20 01 50 FF 14 04 00 13 0D",
            {
                "id": 1,
                "subframes": [
                    _MODE,
                    _item(
                        "write_i16",
                        {
                            "command_position": 0.0096,
                            "command_velocity": 0.072,
                            "command_feedforward_torque": -1.76,
                        },
                    ),
                    _item("read_i16", ["mode", "position", "velocity", "torque"]),
                    _item("read_i8", ["voltage", "temperature", "fault"]),
                ],
            },
        ),
    ],
)
Reply = moteus.message(
    "Reply",
    id=IdField("id", range(1, 8), doc="the device") << 8,
    fd=True,
    direction="from device",
    payload=_PAYLOAD,
    doc="What was read, of a device whose number is below 8.",
    source=_CAN,
    examples=[
        (
            "100##1 24 04 00 0A 00 50 00 00 01 70 FF 23 0D 18 14 00",
            {
                "id": 1,
                "subframes": [
                    _item(
                        "reply_i16",
                        {"mode": "position", "position": 0.008, "velocity": 0.064, "torque": -1.44},
                    ),
                    _item("reply_i8", {"voltage": 12.0, "temperature": 20.0, "fault": "none"}),
                ],
            },
        ),
    ],
)
ReplyExtended = moteus.message(
    "ReplyExtended",
    id=IdField("id", range(8, 127), doc="the device") << 8,
    extended=True,
    fd=True,
    direction="from device",
    payload=_PAYLOAD,
    doc="What was read, of a device whose number is 8 or more.",
    source=_CAN,
    examples=[
        ("00000B00##1 21 00 0B", {"id": 11, "subframes": [_item("reply_i8", {"mode": "position_timeout"})]})
    ],
)
#: The message with which a device answers.
REPLIES = ("Reply", "ReplyExtended")
