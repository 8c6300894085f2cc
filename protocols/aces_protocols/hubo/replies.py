"""What motor and power boards answer, except status and parameters (see `status`, `parameters`).

1. Lengths are what was seen or what the programs accept; bytes behind the known ones are kept as `rest`.
"""

from __future__ import annotations

from math import pi

from construct import Array, Byte, GreedyRange, Int16sl, Int16ul, Int32sl, Struct

from aces_bus.protocol import BitLayout, IdField, Quantity, Tuple, bits

from .base import BEFORE_D15, D08, Board, Milliseconds, Rest, channels, hubo
from .commands import (
    GetBoardInfo,
    NameInfo,
    NameInfo3,
    NameInfo5,
    NameInfoSensor,
    PowerQuery,
    SendCurrent,
    SendEncoder,
    SendEncoderD08,
    SendPm,
)

_COUNTS32 = Quantity(Int32sl, unit="count")
_COUNTS16 = Quantity(Int16sl, unit="count")

# ---------------------------------------------------------------------- 0x060: encoders, power

Encoder = hubo.message(
    "Encoder",
    id=0x060 + Board,
    direction="from device",
    dialect=BEFORE_D15,
    when=channels(1, 2),
    reply_to=(SendEncoder, SendEncoderD08),
    payload=Struct("position" / Array(2, _COUNTS32)),
    doc="Encoder positions; a one-channel board has a second slot too.",
    source="X2; hubo-ach; HuboCan; RoboWorld2018",
    examples=[("060#BC 31 00 00 44 CE FF FF", {"board": 0, "position": [12732, -12732]})],
)
EncoderShort = hubo.message(
    "EncoderShort",
    id=0x060 + Board,
    direction="from device",
    dialect=BEFORE_D15,
    when=channels(1),
    length=range(4, 8),
    reply_to=(SendEncoder, SendEncoderD08),
    payload=Struct("position" / Array(1, _COUNTS32), "rest" / Rest),
    doc="Encoder position of a one-channel board that leaves the second slot out.",
    source="hubo-ach (only HuboCan insists on 8 bytes)",
    examples=[("062#44 CE FF FF", {"board": 2, "position": [-12732]})],
)
Encoder3 = hubo.message(
    "Encoder3",
    id=0x060 + Board,
    direction="from device",
    dialect=BEFORE_D15,
    when=channels(3, "hand"),
    length=range(6, 9),
    reply_to=(SendEncoder, SendEncoderD08),
    payload=Struct("position" / Array(3, _COUNTS16), "rest" / Rest),
    doc="Encoder positions of a three-channel board, a DRC-Hubo hand or the Hubo 2+ neck.",
    source="X2 (8 bytes, 6 of them used); hubo-ach; HuboCan",
    examples=[("080#FF FF 2E FB 00 00 00 00", {"board": 0x20, "position": [-1, -1234, 0], "rest": bytes(2)})],
)
Encoder5 = hubo.message(
    "Encoder5",
    id=0x060 + Board,
    direction="from device",
    dialect="D12",
    when=channels(5),
    reply_to=SendEncoder,
    payload=Struct("position" / Array(3, _COUNTS16)),
    doc="Encoder positions of channels 0–2 of a five-channel board.",
    source="hubo-ach; HuboCan",
    examples=[("084#FF FF 2E FB 01 00", {"board": 0x24, "position": [-1, -1234, 1]})],
)
Encoder5Upper = hubo.message(
    "Encoder5Upper",
    id=0x060 + Board,
    direction="from device",
    dialect="D12",
    when=channels(5),
    reply_to=SendEncoder,
    payload=Struct("position" / Array(2, _COUNTS16)),
    doc="Encoder positions of channels 3 and 4 of a five-channel board.",
    source="hubo-ach (HuboCan reads past the frame here)",
    examples=[("084#FF FF 2E FB", {"board": 0x24, "position": [-1, -1234]})],
)
EncoderNeck = hubo.message(
    "EncoderNeck",
    id=0x060 + Board,
    direction="from device",
    dialect="D12",
    when=channels("neck"),
    length=range(6, 9),
    reply_to=SendEncoder,
    payload=Struct(
        "position" / Array(3, Quantity(Int16sl, unit="rad", scale=2 * pi / 4096, offset=-pi)), "rest" / Rest
    ),
    doc="Angles of the three neck servos of DRC-Hubo.",
    source="hubo-ach",
    examples=[
        ("082#00 08 00 0C 00 04", {"board": 0x22, "position": [0.0, pi / 2, -pi / 2]}),
        ("082#FF FF 00 08 00 08", {"board": 0x22, "position": [-pi - 2 * pi / 4096, 0.0, 0.0]}),
    ],
)
Power = hubo.message(
    "Power",
    id=0x060 + Board,
    direction="from device",
    dialect="D12",
    when=channels("power"),
    length=range(6, 9),
    reply_to=PowerQuery,
    payload=Struct(
        "voltage" / Quantity(Int16ul, scale=0.01, unit="V"),
        "current" / Quantity(Int16ul, scale=0.01, unit="A"),
        "power" / Quantity(Int16ul, scale=0.1, unit="W"),
        "rest" / Rest,
    ),
    doc="The power board's reply, at 0x06E: an encoder's place.",
    source="hubo-ach (it reads them as signed)",
    examples=[
        ("06E#C0 12 D2 04 57 17", {"board": 0x0E, "voltage": 48.0, "current": 12.34, "power": 597.5}),
        ("06E#FF FF FE FF FD FF", {"board": 0x0E, "voltage": 655.35, "current": 655.34, "power": 6553.3}),
    ],
)

# ---------------------------------------------------------------------- 0x090, 0x120: replies of D08 only

CurrentD08 = hubo.message(
    "CurrentD08",
    id=0x090 + Board,
    direction="from device",
    dialect=D08,
    when=channels(1, 2),
    reply_to=SendCurrent,
    payload=Struct("current" / Array(2, Int32sl)),
    doc="Motor currents; their unit is unknown, and that they are signed a guess.",
    source="X1; X2",
    examples=[("093#BC 31 00 00 44 CE FF FF", {"board": 3, "current": [12732, -12732]})],
)
Pm = hubo.message(
    "Pm",
    id=0x120 + Board,
    direction="from device",
    dialect=D08,
    reply_to=SendPm,
    payload=BitLayout(
        8, "z_phase" / Tuple(Quantity(bits(16, 0), unit="count"), Quantity(bits(16, 32), unit="count"))
    ),
    doc="Encoder values at the z-phase.",
    source="X1",
    examples=[("120#84 0D 00 00 45 0F 00 00", {"board": 0, "z_phase": [3460, 3909]})],
)

# ---------------------------------------------------------------------- 0x190: what a board is

NameInfoReply = hubo.message(
    "NameInfoReply",
    id=0x190 + IdField("board", range(0x40), doc="motor or sensor board"),
    direction="from device",
    dialect=D08,
    length=(3, 4),
    reply_to=(NameInfo, NameInfo3, NameInfo5, NameInfoSensor),
    payload=Struct("period" / Milliseconds, "limit" / GreedyRange(Quantity(Byte, unit="turn"))),
    doc="A board's period and home search limits. acesHubo takes it as a sign of life and distrusts the limits.",
    source="X2 (3 bytes, also where it lists 4); acesHubo",
    examples=[
        ("190#0A 0A 0A", {"board": 0, "period": 10, "limit": [10, 10]}),
        ("1B0#0A 0A 05 05", {"board": 0x20, "period": 10, "limit": [10, 5, 5]}),
    ],
)
_INFO = Struct("period" / Milliseconds, "rest" / Rest)
BoardInfo = hubo.message(
    "BoardInfo",
    id=0x190 + Board,
    direction="from device",
    dialect="D12",
    reply_to=GetBoardInfo,
    payload=_INFO,
    doc="A motor board's period; RoboWorld2018 has the firmware's version in `rest`, bytes 3–6 of the frame.",
    source="hubo-ach canID.h; RoboWorld2018",
    examples=[("193#05 00 01", {"board": 3, "period": 5, "rest": b"\x00\x01"})],
)
SensorBoardInfo = hubo.message(
    "SensorBoardInfo",
    id=0x210 + IdField("board", range(0x30, 0x40), doc="sensor board"),
    direction="from device",
    dialect="D12",
    reply_to=GetBoardInfo,
    payload=_INFO,
    doc="BoardInfo of a sensor board, from 0x240 up.",
    source="hubo-ach canID.h",
    examples=[("240#05 00 01", {"board": 0x30, "period": 5, "rest": b"\x00\x01"})],
)
