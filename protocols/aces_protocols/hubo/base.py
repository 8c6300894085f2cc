"""The protocol itself and the words that its messages share; the messages are in the modules that `spec` gathers.

1. Every number on the wire is little-endian, except home offsets in dialect D08.
2. A message's name belongs to one layout: where dialects differ, the older one's name ends in its dialect.
3. Sources are named as in the README's table: X1, X2 and XN are sheets, the others programs.
"""

from __future__ import annotations

from construct import Byte, Default, GreedyBytes, Struct

from aces_bus.protocol import Enumeration, IdField, Protocol, Quantity, SignMagnitude, bits

from .boards import CONFIGURATIONS

hubo = Protocol(
    "hubo",
    link="can",
    bitrate=1_000_000,
    dialects={
        "D08": "Hubo 2 (2008–2011), as acesHubo drove it",
        "D08X": "Hubo 2 by the vendor's sheet alone: its byte order of home offsets and its places of status bytes",
        "D12": "Hubo 2+ and DRC-Hubo (2012–2014)",
        "D15": "DRC-HUBO+ and later (2015–), as RoboWorld2018 drives it",
    },
    dialect="D12",
    configurations=CONFIGURATIONS,
    configuration="hubo2plus",
    broadcast={"sensor": 0xFF},
    doc="Joint motor controllers, hands, power and sensor boards of the Hubo humanoids on two CAN buses.",
    source="HUBO2_CANprotocol.xls (X1, X2, XN); acesHubo; hubo-ach; HuboCan; RoboWorld2018",
)

#: Both readings of the older firmware.
D08 = ("D08", "D08X")
#: All that share the identifiers and board numbers of the first; D15 has its own (see `d15`).
BEFORE_D15 = (*D08, "D12")

#: identifier = base + board; motor boards have 0x00–0x2F, sensor boards 0x30–0x3F.
Board = IdField("board", range(0x30), doc="motor board")
#: identifier = base + sensor id.
Sensor = IdField("sensor", range(1, 16), doc="sensor id = board − 0x2F")

channels = hubo.configured("channels", by="board")
sensors = hubo.configured("sensors", by="sensor")

#: Every command's first bytes. One message an opcode.
command = hubo.family(
    Struct("board" / Byte, "opcode" / Byte), id=0x001, direction="to device", dialect=BEFORE_D15
)

#: Bytes behind the known ones: absent when we send, kept when we receive.
Rest = Default(GreedyBytes, b"")

#: Position in encoder counts of a one- or two-channel board's reference.
SM24 = Quantity(SignMagnitude(24, "little"), unit="count")
Off = Enumeration(Byte, off=0, on=1)
Milliseconds = Quantity(Byte, unit="ms")
Percent = Quantity(Byte, unit="%", range=(0, 100))
#: Search direction of homing.
CW_CCW = {"cw": 0, "ccw": 1}
#: Where a homing search stops.
HOMING_MODES = {"switch_and_index": 0, "switch": 1, "mechanical_stop": 2}
#: A home search of D08 in one byte: 0x10 or 0x11 for motor 1, 0x20 or 0x21 for motor 2, 0xC… and 0xD… without z-phase.
#: Motors are numbered as on the wire, from 1, so that `motor=1` is `motor_1`; what counts from 0 is called `channel`.
HOME_SEARCH_D08 = (
    "direction" / Enumeration(bits(1, 0), CW_CCW),
    "motor"
    / Enumeration(bits(4, 4), motor_1=1, motor_2=2, motor_1_without_index=0xC, motor_2_without_index=0xD),
)
