"""What moves a joint: references, home searches (0x11), open-loop PWM (0x0D).

1. A magnitude wider than its field is refused. The programs that drove the robots cut its high bits off instead.
"""

from __future__ import annotations

from math import pi

from construct import Array, Byte, Default, Int8sl, Int16sl, Int16ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, Quantity, SignMagnitude, Split, Tuple, bits

from .base import BEFORE_D15, D08, HOME_SEARCH_D08, SM24, Board, channels, command, hubo
from .commands import ControlMode

# ---------------------------------------------------------------------- references

Reference = hubo.message(
    "Reference",
    id=0x010 + Board,
    direction="to device",
    dialect=BEFORE_D15,
    when=channels(1, 2),
    payload=Struct("position" / Array(2, SM24)),
    doc="Position set-points. On a one-channel board repeat the first one.",
    source="X2; acesHubo; hubo-ach; HuboCan (it and acesHubo send 0 as a missing second one)",
    examples=[
        ("010#56 7C 00 E0 3E 80", {"board": 0, "position": [31830, -16096]}),
        ("011#BC 31 80 BC 31 80", {"board": 1, "position": [-12732, -12732]}),
    ],
)
Reference3D08 = hubo.message(
    "Reference3D08",
    id=0x010 + Board,
    direction="to device",
    dialect=D08,
    when=channels(3),
    payload=Struct("position" / Array(3, Quantity(Int16sl, unit="count"))),
    doc="Position set-points of a three-channel board.",
    source="X2; acesHubo (a signed cast, so two's complement)",
    examples=[("030#FF FF 2E FB 00 00", {"board": 0x20, "position": [-1, -1234, 0]})],
)
ReferenceHand = hubo.message(
    "ReferenceHand",
    id=0x010 + Board,
    direction="to device",
    dialect="D12",
    when=channels("hand"),
    payload=Struct(
        "position" / SM24,
        "finger" / Array(2, Quantity(SignMagnitude(8), scale=0.01, unit="A", raw_range=(-10, 10))),
    ),
    doc="Wrist roll and the current of both fingers of a DRC-Hubo hand, as in control mode `hybrid`.",
    source="hubo-ach",
    examples=[("034#BC 31 80 05 85", {"board": 0x24, "position": -12732, "finger": [0.05, -0.05]})],
)
ReferenceHandPosition = hubo.message(
    "ReferenceHandPosition",
    id=0x010 + Board,
    direction="to device",
    dialect="D12",
    when=channels("hand"),
    after=ControlMode.where(mode="position"),
    overrides="ReferenceHand",
    payload=Struct("position" / SM24, "finger" / Array(2, Int8sl)),
    doc="Wrist roll and finger positions, while the board's control mode is known to be `position`.",
    source="hubo-ach",
    examples=[
        ("034#BC 31 80 19 E7", {"board": 0x24, "position": -12732, "finger": [25, -25]}, "001#24 10 00")
    ],
)
ReferenceNeck = hubo.message(
    "ReferenceNeck",
    id=0x010 + Board,
    direction="to device",
    dialect="D12",
    when=channels("neck"),
    payload=Struct(
        "position"
        / Array(3, Quantity(Int16ul, unit="rad", scale=2 * pi / 4096, offset=-pi, raw_range=(0, 4095)))
    ),
    doc="Angles of the three neck servos of DRC-Hubo.",
    source="hubo-ach (its daemon scales by 4095, its reader and its servo program by 4096)",
    examples=[("032#00 08 00 0C 00 04", {"board": 0x22, "position": [0.0, pi / 2, -pi / 2]})],
)

# ---------------------------------------------------------------------- 0x11: home search

Home = command(
    "Home",
    opcode=0x11,
    dialect="D12",
    payload=BitLayout(
        6,
        "stored" / Default(bits(1, 1), 1),
        "motor" / Enumeration(bits(4, 4), motor_1=1, motor_2=2, motor_3=3, motor_4=4, motor_5=5, all=0xF),
    ),
    doc="Search home with the settings stored in the board; hubo-ach sends no reference for 3 s after it.",
    source="hubo-ach; HuboCan",
    examples=[
        ("001#05 11 12 00 00 00 00 00", {"board": 5, "stored": 1, "motor": "motor_1"}),
        ("001#00 11 22 00 00 00 00 00", {"board": 0, "stored": 1, "motor": "motor_2"}),
        ("001#00 11 F2 00 00 00 00 00", {"board": 0, "stored": 1, "motor": "all"}),
    ],
)


def _offset(low: int, high: int, top: int) -> Quantity:
    """Return a home offset of 19 bits and sign: bits 0–7 are byte `low`, 8–15 byte `high`, the rest from bit `top` on."""
    return Quantity(SignMagnitude(Split((8 * low, 8), (8 * high, 8), (top, 4))), unit="count")


def _revolutions(byte: int) -> Quantity:
    return Quantity(bits(8, 8 * byte), scale=0.1, unit="turn")


HomeD08 = command(
    "HomeD08",
    opcode=0x11,
    dialect="D08",
    when=channels(1, 2),
    # d[3] is the high byte of the first offset, d[4] the low one; bytes count from d[2] here.
    payload=BitLayout(6, *HOME_SEARCH_D08, "offset" / Tuple(_offset(2, 1, 40), _offset(4, 3, 44))),
    doc="Search one motor's home and go to the offset, which becomes zero; the other motor stays in run state.",
    source="X2; acesHubo (high byte first, as it ran on the robot)",
    examples=[
        (
            "001#00 11 11 48 A8 00 00 08",
            {"board": 0, "direction": "ccw", "motor": "motor_1", "offset": [-18600, 0]},
        ),
        (
            "001#00 11 20 00 00 3A 98 00",
            {"board": 0, "direction": "cw", "motor": "motor_2", "offset": [0, 15000]},
        ),
        (
            "001#09 11 20 00 00 38 80 10",
            {"board": 9, "direction": "cw", "motor": "motor_2", "offset": [0, 80000]},
        ),
    ],
)
HomeD08X = command(
    "HomeD08X",
    opcode=0x11,
    dialect="D08X",
    when=channels(1, 2),
    payload=BitLayout(6, *HOME_SEARCH_D08, "offset" / Tuple(_offset(1, 2, 40), _offset(3, 4, 44))),
    doc="HomeD08 with the low byte first.",
    source="X2",
    examples=[
        (
            "001#00 11 11 A8 48 00 00 08",
            {"board": 0, "direction": "ccw", "motor": "motor_1", "offset": [-18600, 0]},
        ),
        (
            "001#00 11 20 00 00 98 3A 00",
            {"board": 0, "direction": "cw", "motor": "motor_2", "offset": [0, 15000]},
        ),
    ],
)
Home3D08 = command(
    "Home3D08",
    opcode=0x11,
    dialect="D08",
    when=channels(3),
    payload=BitLayout(
        5,
        *HOME_SEARCH_D08,
        "pulses" / Quantity(Split((16, 8), (8, 8)), unit="count"),
        "revolutions" / Tuple(_revolutions(3), _revolutions(4)),
    ),
    doc="Home search of a three-channel board: pulses of motor 0, which has the switch, and turns of the others.",
    source="X2; acesHubo (high byte first; it sends 5 turns always)",
    examples=[
        (
            "001#20 11 11 19 40 32 32",
            {
                "board": 0x20,
                "direction": "ccw",
                "motor": "motor_1",
                "pulses": 6464,
                "revolutions": [5.0, 5.0],
            },
        )
    ],
)
Home3D08X = command(
    "Home3D08X",
    opcode=0x11,
    dialect="D08X",
    when=channels(3),
    payload=BitLayout(
        5,
        *HOME_SEARCH_D08,
        "pulses" / Quantity(bits(16, 8), unit="count"),
        "revolutions" / Tuple(_revolutions(3), _revolutions(4)),
    ),
    doc="Home3D08 with the low byte first.",
    source="X2",
    examples=[
        (
            "001#20 11 11 40 19 0A 0A",
            {
                "board": 0x20,
                "direction": "ccw",
                "motor": "motor_1",
                "pulses": 6464,
                "revolutions": [1.0, 1.0],
            },
        )
    ],
)
Home5D08 = command(
    "Home5D08",
    opcode=0x11,
    dialect=D08,
    when=channels(5),
    payload=Struct("power" / Array(5, Byte)),
    doc="Drive all fingers with this power, each the same.",
    source="acesHubo",
    examples=[("001#24 11 04 04 04 04 04", {"board": 0x24, "power": [4, 4, 4, 4, 4]})],
)

# ---------------------------------------------------------------------- 0x0D: open-loop PWM

#: The third byte says which form follows.
pwm = hubo.family(
    Struct("board" / Byte, "opcode" / Byte, "mode" / Enumeration(Byte, off=0, on=1, fine=3)),
    id=0x001,
    direction="to device",
)
_SIGN = {"plus": 0, "minus": 1}

PwmD08 = pwm(
    "PwmD08",
    opcode=0x0D,
    mode=(0, 1),
    dialect=D08,
    when=channels(1, 2),
    payload=BitLayout(
        4,
        "direction" / Tuple(Enumeration(bits(8, 0), _SIGN), Enumeration(bits(8, 16), _SIGN)),
        "duty" / Tuple(bits(8, 8), bits(8, 24)),
    ),
    doc="Drive both motors with a duty, in unknown steps.",
    source="X1; X2",
    examples=[
        (
            "001#00 0D 01 00 05 01 06",
            {"board": 0, "mode": "on", "direction": ["plus", "minus"], "duty": [5, 6]},
        )
    ],
)
Pwm3D08 = pwm(
    "Pwm3D08",
    opcode=0x0D,
    mode=(0, 1),
    dialect=D08,
    when=channels(3),
    payload=BitLayout(
        5,
        # Motor 1 has a byte of its own, motors 2 and 3 share one.
        "direction"
        / Tuple(*(Enumeration(bits(width, at), _SIGN) for width, at in ((8, 0), (4, 16), (4, 20)))),
        "duty" / Tuple(bits(8, 8), bits(8, 24), bits(8, 32)),
    ),
    doc="Drive three motors with a duty, in unknown steps.",
    source="X2",
    examples=[
        (
            "001#20 0D 01 01 05 10 06 07",
            {"board": 0x20, "mode": "on", "direction": ["minus", "plus", "minus"], "duty": [5, 6, 7]},
        )
    ],
)
PwmFingersD08 = pwm(
    "PwmFingersD08",
    opcode=0x0D,
    mode=(0, 1),
    dialect=D08,
    when=channels(5),
    payload=BitLayout(5, "duty" / Tuple(*(SignMagnitude(bits(5, 8 * finger)) for finger in range(5)))),
    doc="Drive the fingers with a duty in −15…15: the only way to move them.",
    source="acesHubo",
    examples=[
        ("001#24 0D 00 00 00 00 00 00", {"board": 0x24, "mode": "off", "duty": [0, 0, 0, 0, 0]}),
        ("001#24 0D 01 04 14 0F 1F 00", {"board": 0x24, "mode": "on", "duty": [4, -4, 15, -15, 0]}),
    ],
)
_WAY = {"cw": 0, "ccw": 1}
Pwm = pwm(
    "Pwm",
    opcode=0x0D,
    mode=(0, 1),
    dialect="D12",
    when=channels(1, 2),
    payload=BitLayout(
        5,
        "direction" / Tuple(Enumeration(bits(8, 0), _WAY), Enumeration(bits(8, 16), _WAY)),
        "duty"
        / Tuple(
            Quantity(bits(8, 8), unit="%", range=(0, 100)), Quantity(bits(8, 24), unit="%", range=(0, 100))
        ),
    ),
    doc="Drive both motors with a duty.",
    source="hubo-ach (it never tried this on a robot)",
    examples=[
        (
            "001#00 0D 01 00 05 01 64 00",
            {"board": 0, "mode": "on", "direction": ["cw", "ccw"], "duty": [5, 100]},
        )
    ],
)


def _fine(byte: int) -> Quantity:
    """Return a duty of 0.1 %: sign in bit 0 of `byte`, bits 8–11 in its high nibble, bits 0–7 in the next byte."""
    at = 8 * byte
    return Quantity(
        SignMagnitude(Split((at + 8, 8), (at + 4, 4), (at, 1))), scale=0.1, unit="%", raw_range=(-1000, 1000)
    )


PwmFine = pwm(
    "PwmFine",
    opcode=0x0D,
    mode=3,
    dialect="D12",
    when=channels(1, 2),
    payload=BitLayout(4, "duty" / Tuple(_fine(0), _fine(2))),
    doc="Drive both motors with a duty in steps of 0.1 %; negative is clockwise.",
    source="hubo-ach",
    examples=[("001#00 0D 03 10 2C 31 E8", {"board": 0, "duty": [30.0, -100.0]})],
)
Pwm3 = pwm(
    "Pwm3",
    opcode=0x0D,
    mode=(0, 1),
    dialect="D12",
    when=channels(3, "hand"),
    payload=Struct("duty" / Array(3, Quantity(SignMagnitude(8), unit="%", range=(-100, 100)))),
    doc="Drive three motors with a duty.",
    source="hubo-ach (whose own helper loses the sign)",
    examples=[("001#24 0D 01 19 99 00", {"board": 0x24, "mode": "on", "duty": [25, -25, 0]})],
)
PwmFingers = pwm(
    "PwmFingers",
    opcode=0x0D,
    mode=(0, 1),
    dialect="D12",
    when=channels(5),
    payload=Struct("duty" / Array(5, Quantity(SignMagnitude(8), unit="%", range=(-100, 100)))),
    doc="Drive the fingers of a Hubo 2+ hand: they have no reference.",
    source="hubo-ach",
    examples=[
        ("001#24 0D 01 00 19 99 64 E4", {"board": 0x24, "mode": "on", "duty": [0, 25, -25, 100, -100]})
    ],
)
