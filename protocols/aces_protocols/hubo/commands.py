"""Commands to motor and power boards, identifier 0x001: byte 0 is the board, byte 1 the opcode.

1. Messages stand in the order of their opcodes, as in the sheet.
2. Here is what asks, resets and switches. What moves is in `motion`, what is stored in a board in `settings`, what only
   sensor boards know in `sensors`.
"""

from __future__ import annotations

from construct import Array, Byte, Bytes, Int16ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, Quantity, Reserved, Split, Tuple, bits

from .base import D08, HOME_SEARCH_D08, Milliseconds, Off, Rest, channels, command

# ---------------------------------------------------------------------- 0x01: what a board is

NameInfo = command(
    "NameInfo",
    opcode=0x01,
    dialect=D08,
    when=channels(1, 2),
    payload=BitLayout(
        6,
        "period" / Quantity(bits(8), unit="ms"),
        "limit" / Tuple(Quantity(bits(8), unit="turn"), Quantity(bits(8), unit="turn")),
        # d[5] and d[6] are the low bytes, the nibbles of d[7] what is above them.
        "z_phase"
        / Tuple(
            Quantity(Split((24, 8), (40, 4)), unit="count"), Quantity(Split((32, 8), (44, 4)), unit="count")
        ),
    ),
    doc="Set the command period, the home search limits and the z-phase references; asks for NameInfoReply.",
    source="X2; acesHubo config.ops (the sheet's length of 5 is not what was sent)",
    examples=[
        (
            "001#00 01 0A 0A 0A 84 45 FD",
            {"board": 0, "period": 10, "limit": [10, 10], "z_phase": [3460, 3909]},
        ),
        (
            "001#08 01 0A 0F 05 D2 D8 5A",
            {"board": 8, "period": 10, "limit": [15, 5], "z_phase": [2770, 1496]},
        ),
    ],
)
NameInfo3 = command(
    "NameInfo3",
    opcode=0x01,
    dialect=D08,
    when=channels(3),
    payload=Struct(
        "period" / Milliseconds, "limit" / Array(3, Quantity(Byte, unit="turn")), "unused" / Reserved(1)
    ),
    doc="NameInfo for a three-channel board; the last byte was always 0.",
    source="acesHubo config.ops",
    examples=[
        ("001#20 01 0A 0A 0A 0A 00", {"board": 0x20, "period": 10, "limit": [10, 10, 10], "unused": b"\x00"}),
        ("001#21 01 0A 0A 05 05 00", {"board": 0x21, "period": 10, "limit": [10, 5, 5], "unused": b"\x00"}),
    ],
)
NameInfo5 = command(
    "NameInfo5",
    opcode=0x01,
    dialect=D08,
    when=channels(5),
    payload=Struct("period" / Milliseconds),
    doc="NameInfo for a hand.",
    source="acesHubo config.ops",
    examples=[("001#24 01 0A", {"board": 0x24, "period": 10})],
)
NameInfoSensor = command(
    "NameInfoSensor",
    opcode=0x01,
    dialect=D08,
    when=channels("foot", "ft", "imu"),
    payload=Struct("period" / Milliseconds, "tail" / Bytes(5)),
    doc="NameInfo for a sensor board; what its last five bytes mean is not known.",
    source="acesHubo config.ops",
    examples=[
        ("001#35 01 0A 00 38 72 12 00", {"board": 0x35, "period": 10, "tail": b"\x00\x38\x72\x12\x00"})
    ],
)
GetBoardInfo = command(
    "GetBoardInfo",
    opcode=0x01,
    dialect="D12",
    payload=Struct("period" / Milliseconds),
    doc="Set the board's CAN period and ask what it is.",
    source="hubo-ach canID.h (never sent by its daemon)",
    examples=[("001#03 01 05", {"board": 3, "period": 5})],
)

# ---------------------------------------------------------------------- 0x02–0x06: ask and reset

SendStatus = command(
    "SendStatus",
    opcode=0x02,
    length=(2, 3),
    payload=Struct("rest" / Rest),
    doc="Ask for the status. hubo-ach sends a third byte without meaning; leave it out.",
    source="X2; hubo-ach; HuboCan",
    examples=[("001#03 02", {"board": 3}), ("001#03 02 7F", {"board": 3, "rest": b"\x7f"})],
)
SendEncoderD08 = command(
    "SendEncoderD08",
    opcode=0x03,
    dialect=D08,
    doc="Ask for the encoder positions.",
    source="X2; acesHubo",
    examples=[("001#03 03", {"board": 3})],
)
SendEncoder = command(
    "SendEncoder",
    opcode=0x03,
    dialect="D12",
    payload=Struct("selector" / Enumeration(Byte, normal=0, upper=1)),
    doc="Ask for the encoder positions; `upper` are channels 3 and 4 of a five-channel board.",
    source="hubo-ach; HuboCan",
    examples=[("001#24 03 01", {"board": 0x24, "selector": "upper"})],
)
SendCurrent = command(
    "SendCurrent",
    opcode=0x04,
    doc="Ask for the motor currents.",
    source="X2; hubo-ach",
    examples=[("001#03 04", {"board": 3})],
)
SendPm = command(
    "SendPm",
    opcode=0x05,
    dialect=D08,
    doc="Ask for the z-phase encoder values.",
    source="X2",
    examples=[("001#03 05", {"board": 3})],
)
EncoderZeroD08 = command(
    "EncoderZeroD08",
    opcode=0x06,
    dialect=D08,
    payload=Struct("motor" / Enumeration(Byte, all=0, motor_1=1, motor_2=2, motor_3=3)),
    doc="Set encoders to zero.",
    source="X2 (X1 has the codes of a home search here)",
    examples=[("001#03 06 02", {"board": 3, "motor": "motor_2"})],
)
EncoderZero = command(
    "EncoderZero",
    opcode=0x06,
    dialect="D12",
    payload=Struct(
        "channel"
        / Enumeration(Byte, channel_0=0, channel_1=1, channel_2=2, channel_3=3, channel_4=4, all=0x0F)
    ),
    doc="Set encoders to zero; clears faults and error bits too.",
    source="hubo-ach",
    examples=[("001#03 06 0F", {"board": 3, "channel": "all"})],
)

# ---------------------------------------------------------------------- 0x07–0x13: gains and switches

_GAINS = Struct("kp" / Int16ul, "ki" / Int16ul, "kd" / Int16ul)
PositionGainA = command(
    "PositionGainA",
    opcode=0x07,
    payload=_GAINS,
    doc="Position gains of the first motor: roll on a three-channel board, all channels on one of D12.",
    source="X2; acesHubo; hubo-ach",
    examples=[
        ("001#00 07 C8 00 00 00 F4 01", {"board": 0, "kp": 200, "ki": 0, "kd": 500}),
        ("001#00 07 FF FF FE FF FD FF", {"board": 0, "kp": 65535, "ki": 65534, "kd": 65533}),
    ],
)
PositionGainB = command(
    "PositionGainB",
    opcode=0x08,
    payload=_GAINS,
    doc="Position gains of the second motor: pitch and yaw on a three-channel board of D08.",
    source="X2; acesHubo; hubo-ach",
    examples=[("001#00 08 C8 00 01 00 F4 01", {"board": 0, "kp": 200, "ki": 1, "kd": 500})],
)
TorqueGainA = command(
    "TorqueGainA",
    opcode=0x09,
    payload=_GAINS,
    doc="Torque (current) gains of the first motor.",
    source="X2; hubo-ach",
    examples=[("001#00 09 C8 00 01 00 F4 01", {"board": 0, "kp": 200, "ki": 1, "kd": 500})],
)
TorqueGainB = command(
    "TorqueGainB",
    opcode=0x0A,
    payload=_GAINS,
    doc="Torque (current) gains of the second motor.",
    source="X2; hubo-ach",
    examples=[("001#00 0A C8 00 01 00 F4 01", {"board": 0, "kp": 200, "ki": 1, "kd": 500})],
)
DriverSwitch = command(
    "DriverSwitch",
    opcode=0x0B,
    payload=Struct("state" / Off),
    doc="Switch the motor drivers (FETs); HIP enable in the sheet.",
    source="X2; acesHubo; hubo-ach",
    examples=[("001#03 0B 01", {"board": 3, "state": "on"})],
)
GoHome = command(
    "GoHome",
    opcode=0x0C,
    dialect=D08,
    payload=BitLayout(1, *HOME_SEARCH_D08),
    doc="Go home; the byte is the mode of a home search.",
    source="X2",
    examples=[("001#03 0C 11", {"board": 3, "direction": "ccw", "motor": "motor_1"})],
)
ControlOn = command(
    "ControlOn",
    opcode=0x0E,
    doc="Run: control the motors.",
    source="X2; acesHubo; hubo-ach; HuboCan",
    examples=[("001#03 0E", {"board": 3})],
)
ControlOff = command(
    "ControlOff",
    opcode=0x0F,
    doc="Stop controlling the motors.",
    source="X2; acesHubo; hubo-ach; HuboCan",
    examples=[("001#03 0F", {"board": 3})],
)
ControlModeD08 = command(
    "ControlModeD08",
    opcode=0x10,
    dialect=D08,
    payload=Struct("mode" / Enumeration(Byte, position=0, torque=1)),
    doc="What a reference means.",
    source="X2",
    examples=[("001#03 10 01", {"board": 3, "mode": "torque"})],
)
ControlMode = command(
    "ControlMode",
    opcode=0x10,
    dialect="D12",
    payload=Struct("mode" / Enumeration(Byte, position=0, current=1, hybrid=2)),
    doc="What a reference means; `hybrid` is wrist position and finger current of a DRC-Hubo hand.",
    source="hubo-ach",
    examples=[("001#24 10 02", {"board": 0x24, "mode": "hybrid"})],
)
CurrentLimit = command(
    "CurrentLimit",
    opcode=0x12,
    dialect=D08,
    payload=Struct("limit" / Int16ul),
    doc="Limit of the motor current, in unknown units.",
    source="X2",
    examples=[
        ("001#03 12 2C 01", {"board": 3, "limit": 300}),
        ("001#03 12 FF FF", {"board": 3, "limit": 65535}),
    ],
)
SwitchingMode = command(
    "SwitchingMode",
    opcode=0x13,
    dialect="D12",
    payload=Struct("mode" / Enumeration(Byte, complementary=0, non_complementary=1)),
    doc="How the bridge switches; non-complementary lets the motor wheel freely.",
    source="hubo-ach; RoboWorld2018",
    examples=[("001#03 13 01", {"board": 3, "mode": "non_complementary"})],
)
SwitchingModeShort = command(
    "SwitchingModeShort",
    opcode=0x13,
    dialect="D12",
    doc="SwitchingMode as hubo-ach sends it: its length of 2 drops the mode. Read only, do not send.",
    source="hubo-ach hubo-daemon.c",
    examples=[("001#03 13", {"board": 3})],
)

# ---------------------------------------------------------------------- 0x24–0xE0: requests and sounds of D12

GetParameters = command(
    "GetParameters",
    opcode=0x24,
    dialect="D12",
    payload=Struct("selector" / Byte),
    doc="Ask for a parameter block: 20, 21, 22 are the board's; 6 × channel + n (+ 5 from channel 3 on) is block n.",
    source="hubo-ach",
    examples=[("001#05 24 07", {"board": 5, "selector": 7})],
)
Alarm = command(
    "Alarm",
    opcode=0x82,
    dialect="D12",
    payload=Struct("sound" / Enumeration(Byte, off=0, sound_1=1, sound_2=2, sound_3=3, sound_4=4)),
    doc="Sound the alarm.",
    source="hubo-ach",
    examples=[("001#0E 82 03", {"board": 0x0E, "sound": "sound_3"})],
)
Beep = command(
    "Beep",
    opcode=0x83,
    dialect="D12",
    payload=Struct("time" / Quantity(Byte, scale=0.1, unit="s")),
    doc="Beep for a time.",
    source="hubo-ach",
    examples=[("001#0E 83 03", {"board": 0x0E, "time": 0.3})],
)
PowerQuery = command(
    "PowerQuery",
    opcode=0xE0,
    dialect="D12",
    when=channels("power"),
    doc="Ask the power board for voltage and current.",
    source="hubo-ach",
    examples=[("001#0E E0", {"board": 0x0E})],
)
