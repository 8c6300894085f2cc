"""Damiao DM motors: the frame of MIT's mini-cheetah, three modes beside it, registers.

1. MIT frames have numbers that span a range: ±PMAX, ±VMAX, ±TMAX, which are registers 21 to 23 of the motor. The dialect
   `share` leaves them as shares of that (-1 to 1), which is true of every motor; the dialect of a model makes SI of them.
2. Enable, Disable, SetZero and ClearError are legal commands, too (everything at its maximum); motors test for them first.
3. A feedback can have a register reply's bytes: a reply is what answers a request.

Sources: bgkatz/motorcontrol `Core/Src/can.c`, `math_ops.c` (the MIT frame); cmjang/DM_Control_Python `DM_CAN.py`;
enactic/openarm_can `src/openarm/damiao_motor`; jia-xie/python-damiao-driver `docs/concept`, `damiao_motor/core/motor.py`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from construct import Byte, Const, Default, Float32l, GreedyBytes, Int8ul, Int16ul, Int32ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, IdField, Protocol, Quantity, Reserved, bits
from aces_protocols.mit_frame import span

#: Model → PMAX (rad), VMAX (rad/s), TMAX (N·m), as python-damiao-driver has them; see the README for who says otherwise.
MODELS: dict[str, tuple[float, float, float]] = {
    "3507": (12.566, 50, 5), "4310": (12.5, 30, 10), "4310P": (12.5, 50, 10), "4340": (12.5, 10, 28),
    "4340P": (12.5, 10, 28), "6006": (12.5, 45, 20), "8006": (12.5, 45, 40), "8009": (12.5, 45, 54),
    "10010L": (12.5, 25, 200), "10010": (12.5, 20, 200), "H3510": (12.5, 280, 1), "G6215": (12.5, 45, 10),
    "H6220": (12.5, 45, 10), "JH11": (12.5, 10, 12), "6248P": (12.566, 20, 120),
}  # fmt: skip
#: Stiffness (N·m/rad) and damping (N·m·s/rad) that the MIT frame can say, of every model.
KP_MAX, KD_MAX = 500.0, 5.0
SHARE = "share"
#: The models that have a dialect: those of arms that are sold with them. Others are read as shares.
DIALECTS = ("4310", "4340", "8009")

JX, DC = "python-damiao-driver docs/concept, motor.py", "DM_CAN.py; python-damiao-driver motor.py"

Motor = IdField("motor", range(1, 16), doc="its number (register 8); a feedback has room for four bits")
#: Register 7: what a motor answers under. 0 from the factory; by custom 0x10 + its number.
Master = IdField("master", (0x000, *range(0x010, 0x020)), doc="what it answers under (register 7)")
STATUS = {
    "disabled": 0x0, "enabled": 0x1, "over_voltage": 0x8, "under_voltage": 0x9, "over_current": 0xA,
    "mos_over_temperature": 0xB, "rotor_over_temperature": 0xC, "lost_communication": 0xD, "overload": 0xE,
}  # fmt: skip


# ---------------------------------------------------------------------- MIT frames

#: What one command and one feedback mean, by model: of 2**n − 1 steps they are 5241, −273 and 613, and −2623, 409 and −411
#: from the middle. kp is step 409 of 500 N·m/rad, kd step 245 of 5 N·m·s/rad.
_GAINS = {"kp": 49.93894993894994, "kd": 0.29914529914529914}
_COMMANDS: dict[str, dict[str, float]] = {
    SHARE: {"position": 0.0799725338, "velocity": -0.0666666667, "torque": 0.149694750, **_GAINS},
    "4310": {"position": 0.9996566720, "velocity": -2.0, "torque": 1.49694750, **_GAINS},
    "4340": {"position": 0.9996566720, "velocity": -0.666666667, "torque": 4.19145299, **_GAINS},
    "8009": {"position": 0.9996566720, "velocity": -3.0, "torque": 8.08351648, **_GAINS},
}
_FEEDBACKS: dict[str, dict[str, float]] = {
    SHARE: {"position": -0.0400244144, "velocity": 0.0998778999, "torque": -0.100366300},
    "4310": {"position": -0.500305180, "velocity": 2.99633700, "torque": -1.00366300},
    "4340": {"position": -0.500305180, "velocity": 0.998778999, "torque": -2.81025641},
    "8009": {"position": -0.500305180, "velocity": 4.49450549, "torque": -5.41978022},
}

# ---------------------------------------------------------------------- registers

REGISTERS: dict[str, int] = {
    "under_voltage": 0, "torque_constant": 1, "over_temperature": 2, "over_current": 3, "acceleration": 4, "deceleration": 5,
    "max_speed": 6, "master_id": 7, "can_id": 8, "timeout": 9, "control_mode": 10, "friction": 11, "inertia": 12,
    "hardware_version": 13, "software_version": 14, "serial_number": 15, "pole_pairs": 16, "resistance": 17,
    "inductance": 18, "flux": 19, "gear_ratio": 20, "position_max": 21, "velocity_max": 22, "torque_max": 23,
    "current_bandwidth": 24, "velocity_kp": 25, "velocity_ki": 26, "position_kp": 27, "position_ki": 28, "over_voltage": 29,
    "gear_efficiency": 30, "velocity_damping": 31, "velocity_bandwidth": 32, "current_gain": 33, "velocity_gain": 34,
    "baud_code": 35, "sub_version": 36, "u_offset": 50, "v_offset": 51, "k1": 52, "k2": 53, "angle_offset": 54,
    "direction": 55, "motor_angle_offset": 56, "max_current": 59, "supply_voltage": 60, "board_temperature": 61,
    "motor_temperature": 62, "u_current_offset": 63, "v_current_offset": 64, "w_current_offset": 65, "motor_position": 80,
    "output_position": 81,
}  # fmt: skip
#: Those that hold an integer; all others hold a float.
INTEGERS = (*range(7, 11), *range(13, 17), 35, 36)
FLOATS = tuple(number for number in range(82) if number not in INTEGERS)
#: Those that can only be read (python-damiao-driver).
READ_ONLY = frozenset((*range(11, 21), 36, *range(50, 82)))
#: How long a reply may take (s); the rest is for adapters.
WITHIN = 0.1
_EXAMPLES: dict[str, list[Any]] = {
    "ReadFloat": [("7FF#01 00 33 15 00 00 00 00", {"motor": 1, "register": "position_max"})],
    "ReadFloatReply": [
        (
            "011#01 00 33 15 00 00 48 41",
            {"register": "position_max", "value": 12.5},
            "7FF#01 00 33 15 00 00 00 00",
        )
    ],
    "WriteFloat": [("7FF#0F 00 55 05 00 00 20 C0", {"motor": 15, "register": "deceleration", "value": -2.5})],
    "WriteFloatReply": [
        (
            "01F#0F 00 55 05 00 00 20 C0",
            {"master": 0x1F, "register": "deceleration", "value": -2.5},
            "7FF#0F 00 55 05 00 00 20 C0",
        )
    ],
    "ReadInteger": [("7FF#01 00 33 09 00 00 00 00", {"motor": 1, "register": "timeout"})],
    "ReadIntegerReply": [
        (
            "011#01 00 33 09 20 4E 00 00",
            {"register": "timeout", "value": 20_000},
            "7FF#01 00 33 09 00 00 00 00",
        )
    ],
    "WriteInteger": [("7FF#01 00 55 0A 02 00 00 00", {"register": "control_mode", "value": 2})],
    "WriteIntegerReply": [
        (
            "011#01 00 55 0A 02 00 00 00",
            {"register": "control_mode", "value": 2},
            "7FF#01 00 55 0A 02 00 00 00",
        )
    ],
}

# ---------------------------------------------------------------------- the protocol


def declared(name: str, *, fd: bool) -> Protocol:
    """Return the protocol under a name: the same frames, as classic CAN or as CAN FD."""
    made = Protocol(
        name,
        link="can",
        bitrate=1_000_000,
        dialects={
            SHARE: "any model: position, velocity and torque as shares of PMAX, VMAX, TMAX",
            **{name: "±{:g} rad, ±{:g} rad/s, ±{:g} N·m".format(*MODELS[name]) for name in DIALECTS},
        },
        dialect=SHARE,
        doc=f"Damiao DM motors{' on CAN FD' if fd else ''}: MIT frame, position, velocity and force modes, registers.",
        source="python-damiao-driver docs/concept; DM_CAN.py; motorcontrol can.c",
    )

    def shown(examples: list[Any]) -> list[Any]:
        """Return worked examples in the format of this protocol's frames."""
        return [
            tuple(part.replace("#", "##1") if isinstance(part, str) and fd else part for part in example)
            for example in examples
        ]

    message = partial(made.message, fd=fd)

    for model, (position, velocity, torque), units in (
        (SHARE, (1.0, 1.0, 1.0), ("", "", "")),
        *((name, MODELS[name], ("rad", "rad/s", "N·m")) for name in DIALECTS),
    ):
        message(
            "Command",
            id=0x000 + Motor,
            direction="to device",
            dialect=model,
            payload=BitLayout(
                8,
                "position" / span(16, position, units[0]),
                "velocity" / span(12, velocity, units[1]),
                "kp" / span(12, KP_MAX, "N·m/rad", low=0),
                "kd" / span(12, KD_MAX, "N·m·s/rad", low=0),
                "torque" / span(12, torque, units[2]),
                order="msb",
            ),
            doc="Torque = kp × (position error) + kd × (velocity error) + torque.",
            source="motorcontrol can.c, unpack_cmd; python-damiao-driver motor.py",
            examples=shown([("001#8A 3C 77 71 99 0F 59 32", {"motor": 1, **_COMMANDS[model]})]),
        )
        message(
            "Feedback",
            id=0x000 + Master,
            direction="from device",
            dialect=model,
            prefix=Struct("head" / Byte),
            match={"head": Motor | IdField("status", range(16), names=STATUS) << 4},
            payload=BitLayout(
                7,
                "position" / span(16, position, units[0]),
                "velocity" / span(12, velocity, units[1]),
                "torque" / span(12, torque, units[2]),
                "mos_temperature" / Quantity(bits(8), unit="°C"),
                "rotor_temperature" / Quantity(bits(8), unit="°C"),
                order="msb",
            ),
            doc="The answer to every command.",
            source="python-damiao-driver motor.py",
            examples=shown([
                (
                    "011#11 7A E0 8C C7 32 23 29",
                    {"master": 0x11, "motor": 1, "status": "enabled", "mos_temperature": 35, "rotor_temperature": 41}
                    | _FEEDBACKS[model],
                )
            ]),
        )  # fmt: skip

    for name, last, doc, example in (
        ("Enable", 0xFC, "Switch the motor on.", "001#FF FF FF FF FF FF FF FC"),
        ("Disable", 0xFD, "Switch the motor off.", "001#FF FF FF FF FF FF FF FD"),
        ("SetZero", 0xFE, "The present position becomes zero.", "001#FF FF FF FF FF FF FF FE"),
        ("ClearError", 0xFB, "Clear the error.", "001#FF FF FF FF FF FF FF FB"),
    ):
        message(
            name,
            id=0x000 + Motor,
            direction="to device",
            payload=Struct(Const(b"\xff" * 7 + bytes([last]))),
            overrides="Command",  # motors test for it first
            doc=doc,
            source="motorcontrol main.c; DM_CAN.py",
            examples=shown([(example, {"motor": 1})]),
        )

    # ---------------------------------------------------------------------- other modes

    message(
        "PositionVelocity",
        id=0x100 + Motor,
        direction="to device",
        payload=Struct(
            "position" / Quantity(Float32l, unit="rad"), "velocity_limit" / Quantity(Float32l, unit="rad/s")
        ),
        doc="Go to a position, no faster than the limit.",
        source=DC,
        examples=shown(
            [("101#00 00 C0 3F 00 00 00 40", {"motor": 1, "position": 1.5, "velocity_limit": 2.0})]
        ),
    )
    message(
        "Velocity",
        id=0x200 + Motor,
        direction="to device",
        length=(4, 8),  # openarm_can sends 4 bytes, the others pad with zeros
        payload=Struct("velocity" / Quantity(Float32l, unit="rad/s"), "padding" / Default(GreedyBytes, b"")),
        doc="Turn so fast.",
        source="DM_CAN.py; openarm_can dm_motor_control.cpp",
        examples=shown([("201#00 00 40 C0", {"motor": 1, "velocity": -3.0})]),
    )
    message(
        "ForcePosition",
        id=0x300 + Motor,
        direction="to device",
        payload=Struct(
            "position" / Quantity(Float32l, unit="rad"),
            "velocity_limit" / Quantity(Int16ul, scale=0.01, unit="rad/s", range=(0, 100)),
            "current_limit" / Quantity(Int16ul, scale=0.0001, range=(0, 1)),
        ),
        doc="Go to a position with a limited share of the current.",
        source=DC,
        examples=shown(
            [
                (
                    "301#00 00 C0 3F C8 00 C4 09",
                    {"motor": 1, "position": 1.5, "velocity_limit": 2.0, "current_limit": 0.25},
                )
            ]
        ),
    )

    for name, opcode in (("Read", 0x33), ("Write", 0x55)):
        access = made.family(
            fd=fd,
            prefix=Struct("motor" / Int16ul, "opcode" / Byte, "register" / Enumeration(Int8ul, REGISTERS)),
            source=DC,
        )
        for kind, numbers, value in (("Float", FLOATS, Float32l), ("Integer", INTEGERS, Int32ul)):
            request = access(
                f"{name}{kind}",
                id=0x7FF,
                direction="to device",
                motor=Motor,
                opcode=opcode,
                register=numbers,
                payload=Struct("value" / value) if name == "Write" else Struct("padding" / Reserved(4)),
                doc=f"{name} a register" + (", until the motor is switched off." if name == "Write" else "."),
                examples=shown(_EXAMPLES[f"{name}{kind}"]),
            )
            access(
                f"{name}{kind}Reply",
                id=0x000 + Master,
                direction="from device",
                motor=Motor,
                opcode=opcode,
                register=numbers,
                reply_to=request,  # a feedback can have the same bytes
                within=WITHIN,
                overrides="Feedback",
                payload=Struct("value" / value),
                doc="What the register holds.",
                examples=shown(_EXAMPLES[f"{name}{kind}Reply"]),
            )

    for name, opcode, rest, doc, source, examples in (
        (
            "Store",
            0xAA,
            (0x00, 0x01),
            "Keep the registers for good; while the motor is off.",
            "DM_CAN.py (0), python-damiao-driver (1)",
            [
                ("7FF#01 00 AA 00 00 00 00 00", {"motor": 1, "how": 0}),
                ("7FF#01 00 AA 01 00 00 00 00", {"motor": 1, "how": 1}),
            ],
        ),
        (
            "AskFeedback",
            0xCC,
            (0x00,),
            "Ask for a feedback.",
            JX,
            [("7FF#0F 00 CC 00 00 00 00 00", {"motor": 15})],
        ),
    ):
        message(
            name,
            id=0x7FF,
            direction="to device",
            prefix=Struct("motor" / Int16ul, "opcode" / Byte, "how" / Byte),
            match={"motor": Motor, "opcode": opcode, "how": rest},
            payload=Struct("padding" / Reserved(4)),
            doc=doc,
            source=source,
            examples=shown(examples),
        )
    return made


damiao = declared("damiao", fd=False)
