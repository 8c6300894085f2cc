"""Dialect D15: DRC-HUBO+ and later, as the vendor's program RoboWorld2018 speaks it.

1. Boards have numbers of their own, 0 (RHY) to 41, one command identifier each, and all one layout: no table says which
   board is what.
2. The opcode is byte 0; a channel, where there is one, follows and counts from 1.
3. Only what the source states is declared; what it leaves open is kept as `rest` or is not a message (see the README).
"""

from __future__ import annotations

from construct import Array, Byte, Bytes, Int16sl, Int16ul, Int32sl, Int32ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, Flags, IdField, Quantity, Reserved, bits

from .base import Milliseconds, Off, Rest, hubo

ROBOWORLD = "RoboWorld2018"
#: The smart power board's number; it answers where a motor board's encoder would.
POWER = 0x18
NUMBERS = range(42)

Motor = IdField("board", tuple(n for n in NUMBERS if n != POWER), doc="motor board")
PowerBoard = IdField("board", (POWER,), doc="smart power board")
#: Force/torque boards: sensor ids as in D12; their second frame is 2 higher.
ForceSensor = IdField("sensor", (1, 2, 6, 7), doc="sensor id")

command = hubo.family(Struct("opcode" / Byte), id=0x210 + Motor, direction="to device", dialect="D15")
power = hubo.family(
    Struct("number" / Byte, "opcode" / Byte),
    id=0x210 + PowerBoard,
    direction="to device",
    dialect="D15",
)
_COUNTS = Quantity(Int32sl, unit="count")

# ---------------------------------------------------------------------- to motor boards

ReferenceD15 = hubo.message(
    "ReferenceD15",
    id=0x010 + Motor,
    direction="to device",
    dialect="D15",
    payload=Struct("position" / Array(2, _COUNTS)),
    doc="Set-points of both channels, two's complement. Of a channel in current mode: 16 bits of current, then zeros.",
    source=ROBOWORLD,
    examples=[
        ("010#BC 31 00 00 44 CE FF FF", {"board": 0, "position": [12732, -12732]}),
        ("039#00 00 00 80 FF FF FF 7F", {"board": 41, "position": [-(2**31), 2**31 - 1]}),
    ],
)
GetBoardInfoD15 = command(
    "GetBoardInfoD15",
    opcode=0x01,
    payload=Struct("rest" / Rest),
    doc="Ask what the board is; BoardInfoD15 answers. Whether a period goes with it, as in D12, is not known.",
    source=ROBOWORLD,
    examples=[("213#01", {"board": 3})],
)
SendStatusD15 = command(
    "SendStatusD15",
    opcode=0x02,
    payload=Struct("rest" / Rest),
    doc="Ask for the status.",
    source=ROBOWORLD,
    examples=[("213#02", {"board": 3})],
)
SendEncoderD15 = command(
    "SendEncoderD15",
    opcode=0x03,
    payload=Struct("mode" / Enumeration(Byte, once=0, continuous=1)),
    doc="Ask for the encoder positions, once or from now on.",
    source=ROBOWORLD,
    examples=[
        ("210#03 01", {"board": 0, "mode": "continuous"}),
        ("239#03 00", {"board": 41, "mode": "once"}),
    ],
)
DriverSwitchD15 = command(
    "DriverSwitchD15",
    opcode=0x0B,
    payload=Struct("channel" / Byte, "state" / Off),
    doc="Switch a channel's motor driver (FET).",
    source=ROBOWORLD,
    examples=[("213#0B 01 01", {"board": 3, "channel": 1, "state": "on"})],
)
PwmD15 = command(
    "PwmD15",
    opcode=0x0D,
    payload=Struct(
        "motor"
        / Array(
            2,
            Struct(
                "mode"
                / Enumeration(
                    Byte, percent=1, per_mille=2, feed_forward_per_mille=3, feed_forward_milliampere=4
                ),
                "duty" / Int16sl,
            ),
        )
    ),
    doc="Open-loop duty, or what is added to the control's, of both channels; `mode` says its unit: %, 0.1 %, 0.1 %, mA.",
    source=ROBOWORLD,
    examples=[
        (
            "213#0D 02 32 00 04 0C FE",
            {
                "board": 3,
                "motor": [
                    {"mode": "per_mille", "duty": 50},
                    {"mode": "feed_forward_milliampere", "duty": -500},
                ],
            },
        )
    ],
)
ControlD15 = command(
    "ControlD15",
    opcode=0x0E,
    payload=Struct("channel" / Byte, "state" / Off),
    doc="Control a channel, or stop controlling it.",
    source=ROBOWORLD,
    examples=[("213#0E 02 00", {"board": 3, "channel": 2, "state": "off"})],
)
HomeD15 = command(
    "HomeD15",
    opcode=0x11,
    payload=Struct("channel" / Byte),
    doc="Search home with the settings stored in the board.",
    source=ROBOWORLD,
    examples=[("213#11 01", {"board": 3, "channel": 1})],
)
PositionModeD15 = command(
    "PositionModeD15",
    opcode=0x14,
    payload=Struct("channel" / Byte, "mode" / Enumeration(Byte, absolute=0, incremental=1)),
    doc="What a position set-point counts from.",
    source=ROBOWORLD,
    examples=[("213#14 01 01", {"board": 3, "channel": 1, "mode": "incremental"})],
)
MaxSpeedD15 = command(
    "MaxSpeedD15",
    opcode=0x40 + IdField("channel", (1, 2), doc="channel, from 1"),
    payload=Struct("acceleration" / Int16ul, "velocity" / Int16ul),
    doc="Largest acceleration and velocity of a channel, which is part of the opcode here only.",
    source=f"{ROBOWORLD} (fields as in D12: hubo-ach)",
    examples=[("213#42 E8 03 F4 01", {"board": 3, "channel": 2, "acceleration": 1000, "velocity": 500})],
)
ClearErrorD15 = command(
    "ClearErrorD15",
    opcode=0x75,
    payload=Struct("channel" / Byte),
    doc="Clear a channel's error bits.",
    source=ROBOWORLD,
    examples=[("213#75 01", {"board": 3, "channel": 1})],
)
SendTemperatureD15 = command(
    "SendTemperatureD15",
    opcode=0xA1,
    payload=Struct("rest" / Rest),
    doc="Ask for the temperatures.",
    source=ROBOWORLD,
    examples=[("213#A1", {"board": 3})],
)
FrictionD15 = command(
    "FrictionD15",
    opcode=(0xB0, 0xB1),
    payload=Struct("channel" / Byte, "rest" / Rest),
    doc="Friction compensation, two commands; their fields behind the channel are not known.",
    source=ROBOWORLD,
    examples=[("213#B0 01 01", {"board": 3, "opcode": 0xB0, "channel": 1, "rest": b"\x01"})],
)
MaxDutyD15 = command(
    "MaxDutyD15",
    opcode=0xB2,
    payload=Struct("channel" / Byte, "rest" / Rest),
    doc="Largest duty; its form behind the channel is not known.",
    source=ROBOWORLD,
    examples=[("213#B2 01 5A", {"board": 3, "channel": 1, "rest": b"\x5a"})],
)

# ---------------------------------------------------------------------- from motor boards

EncoderD15 = hubo.message(
    "EncoderD15",
    id=0x060 + Motor,
    direction="from device",
    dialect="D15",
    payload=Struct("position" / Array(2, _COUNTS)),
    doc="Encoder positions of both channels; comes by itself after a continuous request.",
    source=ROBOWORLD,
    examples=[("060#BC 31 00 00 44 CE FF FF", {"board": 0, "position": [12732, -12732]})],
)
#: What each motor says in a status: switches and home as D12 has them, errors and modes.
_MOTOR = BitLayout(
    3,
    "drive" / Flags(bits(4), driver_on=0, control_on=1, current_mode=2, limit_switch=3),
    "home" / Enumeration(bits(4), homed=6),
    "errors"
    / Flags(
        bits(8),
        jam=0,
        saturated=1,
        big_error=2,
        input_error=3,
        driver_fault=4,
        encoder_fail=5,
        current_difference=6,
        temperature_error=7,
    ),
    "modes"
    / Flags(
        bits(8),
        limit_1=0,
        limit_2=1,
        complementary=2,
        gain_override=3,
        friction_compensation=4,
        incremental=5,
        can_recovered=6,
        reply_ok=7,
    ),
)
StatusD15 = hubo.message(
    "StatusD15",
    id=0x150 + Motor,
    direction="from device",
    dialect="D15",
    length=(6, 7, 8),
    payload=Struct("motor" / Array(2, _MOTOR), "rest" / Rest),
    doc="State and errors of both motors, three bytes each. Bit 3 of the errors is the input here, D12's is the encoder.",
    source=ROBOWORLD,
    examples=[
        (
            "153#63 04 84 09 28 21",
            {
                "board": 3,
                "motor": [
                    {
                        "drive": ["driver_on", "control_on"],
                        "home": "homed",
                        "errors": ["big_error"],
                        "modes": ["complementary", "reply_ok"],
                    },
                    {
                        "drive": ["driver_on", "limit_switch"],
                        "home": 0,
                        "errors": ["input_error", "encoder_fail"],
                        "modes": ["limit_1", "incremental"],
                    },
                ],
            },
        )
    ],
)
StatusShortD15 = hubo.message(
    "StatusShortD15",
    id=0x150 + Motor,
    direction="from device",
    dialect="D15",
    length=(3, 4, 5),
    payload=Struct("motor" / Array(1, _MOTOR), "rest" / Rest),
    doc="StatusD15 of a board that leaves the second motor out.",
    source=f"{ROBOWORLD} (three bytes a motor)",
    examples=[
        (
            "153#03 00 80",
            {
                "board": 3,
                "motor": [
                    {
                        "drive": ["driver_on", "control_on"],
                        "home": 0,
                        "errors": [],
                        "modes": ["reply_ok"],
                    }
                ],
            },
        )
    ],
)
BoardInfoD15 = hubo.message(
    "BoardInfoD15",
    id=0x190 + Motor,
    direction="from device",
    dialect="D15",
    payload=Struct("period" / Milliseconds, "unknown" / Bytes(2), "version" / Int32ul, "rest" / Rest),
    doc="A board's period and the version of its firmware.",
    source=ROBOWORLD,
    examples=[
        ("193#05 00 00 4E 61 BC 00", {"board": 3, "period": 5, "version": 12_345_678}),
        ("193#05 00 00 4E 61 BC 00 01", {"board": 3, "period": 5, "version": 12_345_678, "rest": b"\x01"}),
    ],
)
_CELSIUS = Quantity(Int16ul, scale=0.1, unit="°C")
TemperatureD15 = hubo.message(
    "TemperatureD15",
    id=0x1C0 + Motor,
    direction="from device",
    dialect="D15",
    reply_to=SendTemperatureD15,
    length=(6, 7, 8),
    payload=Struct("board_temperature" / _CELSIUS, "motor" / Array(2, _CELSIUS), "rest" / Rest),
    doc="Temperatures of the board and of both motors; read as unsigned.",
    source=ROBOWORLD,
    examples=[
        ("1C3#9A 01 C2 01 FB 00", {"board": 3, "board_temperature": 41.0, "motor": [45.0, 25.1]}, "213#A1")
    ],
)

# ---------------------------------------------------------------------- the power board

PowerSwitchD15 = power(
    "PowerSwitchD15",
    number=POWER,
    opcode=0x81,
    payload=Struct("rest" / Rest),
    doc="12 V, 48 V sequencing, beeper and PC toggles; how they are said is not known.",
    source=ROBOWORLD,
    examples=[("228#18 81 01", {"board": POWER, "rest": b"\x01"})],
)
AlarmD15 = power(
    "AlarmD15",
    number=POWER,
    opcode=0x82,
    payload=Struct("sound" / Enumeration(Byte, off=0, sound_1=1, sound_2=2, sound_3=3, sound_4=4)),
    doc="Sound the alarm.",
    source=f"{ROBOWORLD} (sounds as in D12: hubo-ach)",
    examples=[("228#18 82 03", {"board": POWER, "sound": "sound_3"})],
)
BeepD15 = power(
    "BeepD15",
    number=POWER,
    opcode=0x83,
    payload=Struct("time" / Quantity(Byte, scale=0.1, unit="s")),
    doc="Beep for a time.",
    source=f"{ROBOWORLD} (unit as in D12: hubo-ach)",
    examples=[("228#18 83 03", {"board": POWER, "time": 0.3})],
)
PowerQueryD15 = power(
    "PowerQueryD15",
    number=POWER,
    opcode=(0xE0, 0xE1),
    doc="Ask for voltage and current; what 0xE1 asks for beyond that is not known.",
    source=ROBOWORLD,
    examples=[("228#18 E0", {"board": POWER, "opcode": 0xE0})],
)
PowerD15 = hubo.message(
    "PowerD15",
    id=0x060 + PowerBoard,
    direction="from device",
    dialect="D15",
    payload=Struct(
        "voltage" / Quantity(Int16ul, scale=0.01, unit="V"),
        "current" / Quantity(Int16ul, scale=0.01, unit="A"),
        "rest" / Rest,
    ),
    doc="The smart power board's reply.",
    source=ROBOWORLD,
    examples=[("078#C0 12 D2 04", {"board": POWER, "voltage": 48.0, "current": 12.34})],
)

# ---------------------------------------------------------------------- sensors

SensorRequestD15 = hubo.message(
    "SensorRequestD15",
    id=0x003,
    direction="to device",
    dialect="D15",
    payload=Struct("sensor" / Byte, "mode" / Byte, "rest" / Rest),
    doc="Ask one sensor, or all (0xFF); modes are taken to be D12's.",
    source=ROBOWORLD,
    examples=[("003#FF 02", {"sensor": 0xFF, "mode": 2})],
)
_MOMENT = Quantity(Int16sl, scale=-0.01, unit="N·m")
_FORCE = Quantity(Int16sl, scale=-0.1, unit="N")
ForceTorqueD15 = hubo.message(
    "ForceTorqueD15",
    id=0x040 + ForceSensor,
    direction="from device",
    dialect="D15",
    payload=Struct("lead" / Reserved(1), "mx" / _MOMENT, "my" / _MOMENT, "fz" / _FORCE, "rest" / Rest),
    doc="Force and torque: D12's fields a byte later and negated.",
    source=ROBOWORLD,
    examples=[
        ("041#00 7B 00 38 FE 37 F6", {"sensor": 1, "mx": -1.23, "my": 4.56, "fz": 250.5}),
        (
            "041#00 7B 00 38 FE 37 F6 5A",
            {"sensor": 1, "mx": -1.23, "my": 4.56, "fz": 250.5, "rest": b"\x5a"},
        ),
    ],
)
ForceTorqueLateralD15 = hubo.message(
    "ForceTorqueLateralD15",
    id=0x042 + ForceSensor,
    direction="from device",
    dialect="D15",
    payload=Struct("lead" / Reserved(1), "fx" / _FORCE, "fy" / _FORCE, "mz" / _MOMENT, "rest" / Rest),
    doc="The other three of a six-axis sensor; taken to lie and count as in the first frame.",
    source=ROBOWORLD,
    examples=[("043#00 9C FF 64 00 7B 00", {"sensor": 1, "fx": 10.0, "fy": -10.0, "mz": -1.23})],
)
