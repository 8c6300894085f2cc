"""Commands that store a setting in a board of D12, identifier 0x001; `parameters` reads most of them back.

1. A channel inside an opcode counts from 0 (hubo-ach; it doubts this itself, and no robot has proved it).
2. hubo-ach marks what it never tried on a robot; the README lists it.
"""

from __future__ import annotations

from construct import Array, Byte, Const, Int16ul, Int32sl, Struct

from aces_bus.protocol import BitLayout, Enumeration, Flags, IdField, Quantity, bits

from .base import CW_CCW, HOMING_MODES, Milliseconds, Percent, command

#: Opcodes that carry their channel: opcode = base + channel.
Channel = IdField("channel", range(5), doc="motor channel, from 0")

# ---------------------------------------------------------------------- 0x20–0x6F: parameters of D12

DeadZone = command(
    "DeadZone",
    # Channel 4 would be 0x24, which is GetParameters.
    opcode=0x20 + IdField("channel", range(4), doc="motor channel, from 0"),
    dialect="D12",
    payload=Struct("dead_zone" / Byte),
    doc="Dead zone of a motor's PWM.",
    source="hubo-ach",
    examples=[("001#24 23 07", {"board": 0x24, "channel": 3, "dead_zone": 7})],
)
HomeSearch = command(
    "HomeSearch",
    opcode=0x30 + Channel,
    dialect="D12",
    payload=Struct(
        "limit" / Quantity(Byte, unit="turn"),
        "direction" / Enumeration(Byte, CW_CCW),
        "offset" / Quantity(Int32sl, unit="count"),
    ),
    doc="Home search: at most so many motor turns, where to, and how far the home is from the index.",
    source="hubo-ach",
    examples=[
        (
            "001#0A 30 14 00 14 05 00 00",
            {"board": 0x0A, "channel": 0, "limit": 20, "direction": "cw", "offset": 1300},
        ),
        (
            "001#0A 30 14 01 EC FA FF FF",
            {"board": 0x0A, "channel": 0, "limit": 20, "direction": "ccw", "offset": -1300},
        ),
    ],
)
EncoderResolution = command(
    "EncoderResolution",
    opcode=0x38 + Channel,
    dialect="D12",
    payload=BitLayout(
        2,
        "resolution" / Quantity(bits(14), unit="count"),
        "auto_scale" / bits(1),
        "direction" / Enumeration(bits(1), ccw=0, cw=1),
    ),
    doc="Encoder counts of a motor turn, and the motor's direction.",
    source="hubo-ach",
    examples=[
        (
            "001#00 39 A0 CF",
            {"board": 0, "channel": 1, "resolution": 4000, "auto_scale": 1, "direction": "cw"},
        )
    ],
)
MaxSpeed = command(
    "MaxSpeed",
    opcode=0x40 + Channel,
    dialect="D12",
    payload=Struct("acceleration" / Int16ul, "velocity" / Int16ul),
    doc="Largest acceleration and velocity, in unknown units.",
    source="hubo-ach",
    examples=[
        ("001#03 41 D0 07 E8 03", {"board": 3, "channel": 1, "acceleration": 2000, "velocity": 1000}),
        ("001#03 41 FF FF FE FF", {"board": 3, "channel": 1, "acceleration": 65535, "velocity": 65534}),
    ],
)
_LIMIT = Struct("options" / Flags(Byte, enable=0, update=1), "limit" / Quantity(Int32sl, unit="count"))
LowerLimit = command(
    "LowerLimit",
    opcode=0x50 + Channel,
    dialect="D12",
    payload=_LIMIT,
    doc="Lower position limit; `update` writes the value, `enable` switches the limit on.",
    source="hubo-ach",
    examples=[
        (
            "001#23 50 03 F1 67 FD FF",
            {"board": 0x23, "channel": 0, "options": ["enable", "update"], "limit": -169999},
        )
    ],
)
UpperLimit = command(
    "UpperLimit",
    opcode=0x56 + Channel,
    dialect="D12",
    payload=_LIMIT,
    doc="Upper position limit; `update` writes the value, `enable` switches the limit on.",
    source="hubo-ach",
    examples=[("001#23 56 00 10 98 02 00", {"board": 0x23, "channel": 0, "options": [], "limit": 170000})],
)
HomingSpeed = command(
    "HomingSpeed",
    opcode=0x60 + Channel,
    dialect="D12",
    payload=Struct(
        "acceleration" / Quantity(Byte, scale=0.01),
        "velocity_to_switch" / Byte,
        "velocity_to_offset" / Byte,
        "mode" / Enumeration(Byte, HOMING_MODES),
        "duty" / Percent,
    ),
    doc="How a home search moves and where it stops.",
    source="hubo-ach",
    examples=[
        (
            "001#00 61 96 0A 05 02 1E",
            {
                "board": 0,
                "channel": 1,
                "acceleration": 1.5,
                "velocity_to_switch": 10,
                "velocity_to_offset": 5,
                "mode": "mechanical_stop",
                "duty": 30,
            },
        )
    ],
)
GainOverride = command(
    "GainOverride",
    opcode=0x6F,
    dialect="D12",
    payload=Struct("gain" / Array(2, Quantity(Byte, unit="%")), "time" / Quantity(Int16ul, unit="ms")),
    doc="Scale the gains of channels 0 and 1 within so much time.",
    source="hubo-ach",
    examples=[
        ("001#03 6F 32 64 E8 03", {"board": 3, "gain": [50, 100], "time": 1000}),
        ("001#03 6F 32 64 FF FF", {"board": 3, "gain": [50, 100], "time": 65535}),
    ],
)

# ---------------------------------------------------------------------- 0xE0–0xFA: the board itself

SetBoardNumber = command(
    "SetBoardNumber",
    opcode=0xF0,
    dialect="D12",
    payload=Struct("number" / Byte, "period" / Milliseconds),
    doc="Give the board another number. Dangerous: two boards with one number cannot be distinguished again.",
    source="hubo-ach (disabled there)",
    examples=[("001#03 F0 07 0A", {"board": 3, "number": 7, "period": 10})],
)
JamLimits = command(
    "JamLimits",
    opcode=0xF2,
    dialect="D12",
    payload=Struct(
        "jam_time" / Quantity(Int16ul, unit="ms"),
        "saturation_time" / Quantity(Int16ul, unit="ms"),
        "limit_duty" / Percent,
        "jam_duty" / Percent,
    ),
    doc="When a motor counts as jammed or its PWM as saturated.",
    source="hubo-ach",
    examples=[
        (
            "001#00 F2 E8 03 F4 01 32 14",
            {"board": 0, "jam_time": 1000, "saturation_time": 500, "limit_duty": 50, "jam_duty": 20},
        ),
        (
            "001#00 F2 FF FF FE FF 64 64",
            {"board": 0, "jam_time": 65535, "saturation_time": 65534, "limit_duty": 100, "jam_duty": 100},
        ),
    ],
)
ErrorBounds = command(
    "ErrorBounds",
    opcode=0xF3,
    dialect="D12",
    payload=Struct("max_step" / Int16ul, "max_error" / Int16ul, "temperature" / Int16ul),
    doc="Largest step of the input, largest position error, temperature of the warning; units unknown.",
    source="hubo-ach",
    examples=[
        (
            "001#03 F3 D0 07 20 4E 50 00",
            {"board": 3, "max_step": 2000, "max_error": 20000, "temperature": 80},
        ),
        (
            "001#03 F3 FF FF FE FF FD FF",
            {"board": 3, "max_step": 65535, "max_error": 65534, "temperature": 65533},
        ),
    ],
)
InitBoard = command(
    "InitBoard",
    opcode=0xFA,
    dialect="D12",
    doc="Load the board's default parameters.",
    source="hubo-ach",
    examples=[("001#03 FA", {"board": 3})],
)
InitSensor = command(
    "InitSensor",
    opcode=0xFA,
    dialect="D12",
    payload=Struct(Const(0xAA, Byte)),
    doc="Initialise a force/torque board.",
    source="hubo-ach; RoboWorld2018",
    examples=[("001#30 FA AA", {"board": 0x30})],
)
