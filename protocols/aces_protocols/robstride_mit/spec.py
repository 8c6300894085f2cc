"""RobStride motors, their MIT protocol: identifiers of 11 bits, MIT's frame, a few commands of eight bytes.

1. Position, velocity and torque span ranges of the model, which the motor does not tell: the dialect `share` has shares of
   them (-1 to 1), `RS00` has SI.
2. Commands that begin with six bytes 0xFF are legal MIT frames, too (everything at its maximum); motors test for them first.
3. Feedbacks and faults come under the master's number, 0 from the factory; another one is not read here. The motor that
   answers is in the first byte. A list of faults answers `ReadFaults` and ends with three zeros, which in a feedback would
   be a temperature of 0 °C.

Sources: RobStride's RS00 manual (260112), MIT protocol, commands 1 to 11 and both answers; huggingface/lerobot
`src/lerobot/motors/robstride/{robstride,tables}.py`.
"""

from __future__ import annotations

from construct import Byte, Const, Float32l, Int32ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, Flags, IdField, Protocol, Quantity, bits
from aces_protocols.mit_frame import span

Ranges = tuple[float, float, float]
#: Model → position (rad), velocity (rad/s), torque (N·m) at full scale, where the manual and LeRobot agree.
MODELS: dict[str, Ranges] = {"RS00": (12.57, 33, 14), "RS01": (12.57, 44, 17)}
#: Stiffness (N·m/rad) and damping (N·m·s/rad) at full scale of these models.
KP_MAX, KD_MAX = 500.0, 5.0
SHARE = "share"
#: Dialect → its ranges.
DIALECTS: dict[str, Ranges] = {SHARE: (1.0, 1.0, 1.0), "RS00": MODELS["RS00"]}
MANUAL, LEROBOT = "RS00 manual, MIT protocol", "lerobot motors/robstride/robstride.py"

robstride_mit = Protocol(
    "robstride_mit",
    link="can",
    bitrate=1_000_000,
    dialects={
        SHARE: "any model: position, velocity, torque, kp and kd as shares of their ranges",
        "RS00": "±12.57 rad, ±33 rad/s, ±14 N·m, 500 N·m/rad, 5 N·m·s/rad",
    },
    dialect=SHARE,
    doc="RobStride motors, MIT protocol (11-bit identifiers).",
    source="RS00 manual, MIT protocol; lerobot motors/robstride",
)

Motor = IdField("motor", range(1, 0x80), doc="the motor's number, 1 from the factory")
#: What answers come under.
MASTER = 0x000
#: How long an answer may take (s); the rest is for adapters.
WITHIN = 0.1
MODES = {"mit": 0, "position": 1, "speed": 2}
PROTOCOLS = {"private": 0, "canopen": 1, "mit": 2}
#: One command of 30°, kp 10, kd 0.5, as LeRobot sends it to motor 5, and one feedback: 2730, 0, 82, 409 and 0 steps.
_COMMAND = {
    SHARE: (0.0416418708, 0.0200244200, 0.0998778999),
    "RS00": (0.5234383154, 10.0122100, 0.499389499),
}
_FEEDBACK = {
    SHARE: (-0.0400244144, 0.0998778999, -0.100366300),
    "RS00": (-0.503106889, 3.29597070, -1.40512821),
}

for dialect, (position, velocity, torque) in DIALECTS.items():
    is_share = dialect == SHARE
    units = ("",) * 5 if is_share else ("rad", "rad/s", "N·m", "N·m/rad", "N·m·s/rad")
    kp, kd = (1.0, 1.0) if is_share else (KP_MAX, KD_MAX)
    told, known = _COMMAND[dialect], _FEEDBACK[dialect]
    robstride_mit.message(
        "Command",
        id=0x000 + Motor,
        direction="to device",
        dialect=dialect,
        payload=BitLayout(
            8,
            "position" / span(16, position, units[0]),
            "velocity" / span(12, velocity, units[1]),
            "kp" / span(12, kp, units[3], low=0),
            "kd" / span(12, kd, units[4], low=0),
            "torque" / span(12, torque, units[2]),
            order="msb",
        ),
        doc="Torque = kp × (position error) + kd × (velocity error) + torque; in mode `mit`.",
        source=f"{MANUAL}, command 3; {LEROBOT}",
        examples=[
            ("005#85 54 80 00 52 19 98 00", {"motor": 5, "position": told[0], "kp": told[1], "kd": told[2]})
        ],
    )
    robstride_mit.message(
        "Feedback",
        id=MASTER,
        direction="from device",
        dialect=dialect,
        prefix=Struct("head" / Byte),
        match={"head": Motor},
        payload=BitLayout(
            7,
            "position" / span(16, position, units[0]),
            "velocity" / span(12, velocity, units[1]),
            "torque" / span(12, torque, units[2]),
            "temperature" / Quantity(bits(16), unit="°C", scale=0.1),
            order="msb",
        ),
        doc="The answer to commands but `ReadFaults`, `SetNumber`, `SetProtocol`; whether the motor is on is not in it.",
        source=f"{MANUAL}, answer 1; {LEROBOT}",
        examples=[
            (
                "000#05 7A E0 8C C7 32 01 3B",
                {
                    "motor": 5,
                    "position": known[0],
                    "velocity": known[1],
                    "torque": known[2],
                    "temperature": 31.5,
                },
            )
        ],
    )


def declare_command(
    name: str,
    payload: Struct,
    doc: str,
    number: int,
    example: tuple[str, dict[str, object]],
    prefix: Struct | None = None,
    match: dict[str, tuple[int, ...]] | None = None,
) -> None:
    """Declare a command of eight bytes that begins with 0xFF, which motors test for before MIT's frame."""
    robstride_mit.message(
        name,
        id=0x000 + Motor,
        direction="to device",
        payload=payload,
        overrides="Command",
        doc=doc,
        source=f"{MANUAL}, command {number}",
        examples=[example],
        prefix=prefix,
        match=match,
    )


FULL = Const(b"\xff" * 6)
for name, last, number, doc in (
    ("Enable", 0xFC, 1, "Switch the motor on."),
    ("Disable", 0xFD, 2, "Switch the motor off."),
    ("SetZero", 0xFE, 4, "The present position becomes zero."),
    ("ClearFaults", 0xFB, 5, "Clear the faults."),
):
    declare_command(
        name,
        Struct(Const(b"\xff" * 7 + bytes((last,)))),
        doc,
        number,
        (f"005#FF FF FF FF FF FF FF {last:X}", {"motor": 5}),
    )
declare_command(
    "ReadFaults",
    Struct(Const(b"\xff" * 6 + b"\x00\xfb")),
    "Ask for the faults.",
    5,
    ("005#FF FF FF FF FF FF 00 FB", {"motor": 5}),
)
declare_command(
    "SetMode",
    Struct(Const(b"\xfc")),
    "Another mode.",
    6,
    ("005#FF FF FF FF FF FF 02 FC", {"motor": 5, "mode": "speed"}),
    prefix=Struct(FULL, "mode" / Enumeration(Byte, MODES)),
    match={"mode": tuple(MODES.values())},
)
declare_command(
    "SetNumber",
    Struct(FULL, "new_motor" / Byte, Const(b"\xfa")),
    "Give the motor another number.",
    7,
    ("005#FF FF FF FF FF FF 09 FA", {"motor": 5, "new_motor": 9}),
)
declare_command(
    "SetProtocol",
    Struct(Const(b"\xfd")),
    "Another protocol, from the next power-on.",
    8,
    ("005#FF FF FF FF FF FF 00 FD", {"motor": 5, "protocol": "private"}),
    prefix=Struct(FULL, "protocol" / Enumeration(Byte, PROTOCOLS)),
    match={"protocol": tuple(PROTOCOLS.values())},
)
for name, page, number, more, unit, value in (
    (
        "Position",
        0x100,
        10,
        "velocity_limit",
        "rad/s",
        "Go to a position, no faster than the limit; in mode `position`.",
    ),
    (
        "Velocity",
        0x200,
        11,
        "current_limit",
        "A",
        "Turn so fast, with no more current than the limit; in mode `speed`.",
    ),
):
    robstride_mit.message(
        name,
        id=page + Motor,
        direction="to device",
        payload=Struct(
            name.lower() / Quantity(Float32l, unit="rad" if name == "Position" else "rad/s"),
            more / Quantity(Float32l, unit=unit),
        ),
        doc=value,
        source=f"{MANUAL}, command {number}",
        examples=[(f"{page + 5:X}#00 00 C0 3F 00 00 00 40", {"motor": 5, name.lower(): 1.5, more: 2.0})],
    )

robstride_mit.message(
    "Faults",
    id=MASTER,
    direction="from device",
    prefix=Struct("head" / Byte),
    match={"head": Motor},
    payload=Struct(
        "faults"
        / Flags(
            Int32ul, over_temperature=0, driver=1, under_voltage=2, over_voltage=3, phase_b_over_current=4,
            phase_c_over_current=5, uncalibrated=7, unknown_hardware=8, position_lost=9, stalled=14,
            phase_a_over_current=16,
        ),
        Const(bytes(3)),
    ),
    reply_to=robstride_mit.messages["ReadFaults"],
    within=WITHIN,
    overrides="Feedback",
    doc="The faults that the motor has: the answer to `ReadFaults`.",
    source=f"{MANUAL}, command 5; the zeros: {LEROBOT}",
    examples=[
        (
            "000#05 04 00 01 00 00 00 00",
            {"motor": 5, "faults": ["under_voltage", "phase_a_over_current"]},
            "005#FF FF FF FF FF FF 00 FB",
        )
    ],
)  # fmt: skip
