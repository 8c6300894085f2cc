"""The MIT mini-cheetah motor frame and its relatives: T-motor AK in MIT mode, Damiao DM.

What it asks of the language: ranged numbers in n bits, most significant bit first; ranges that depend on the model;
special frames that are legal commands too; a motor's number inside a reply's bytes; registers whose replies look like
feedback.

A model is a dialect, as a bus usually has one kind of motor: `mit_motor:AK80_9`. On a mixed bus each motor belongs to
one variant by its configuration (`motors`: the numbers that exist), and the variants share a scanner.

Sources: bgkatz/motorcontrol `Core/Src/can.c`, `math_ops.c`; neurobionics/TMotorCANControl `mit_can.py`;
cmjang/DM_Control_Python `DM_CAN.py`; enactic/openarm_can; jia-xie/python-damiao-driver `docs/concept`.
Deviations: values outside a range are refused, not clamped; sending rounds to nearest, where most firmware truncates
(at most one count apart). Replies come under identifier 0; of Damiao motors, which are numbered up to 15 as a
feedback has room for four bits, also under 0x010…0x01F.
"""

from __future__ import annotations

from typing import Any

from construct import Byte, Const, Float32l, GreedyBytes, Int8ul, Int16ul, Int32ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, IdField, Protocol, Quantity, Reserved, bits

#: Model → position (rad), velocity (rad/s), torque (N·m); kp is 500 N·m/rad and kd 5 N·m·s/rad everywhere.
CHEETAH = {"mini_cheetah": (12.5, 65, 18)}  # motorcontrol, header
TMOTOR = {"AK80_9": (12.5, 50, 18), "AK10_9": (12.5, 50, 65)}  # TMotorCANControl
DAMIAO = {
    "DM4310": (12.5, 30, 10),
    "DM4340": (12.5, 10, 28),
}  # python-damiao-driver; registers 21…23 know better
MODELS = {**CHEETAH, **TMOTOR, **DAMIAO}

mit_motor = Protocol(
    "mit_motor",
    link="can",
    bitrate=1_000_000,
    dialects={name: f"±{p} rad, ±{v} rad/s, ±{t} N·m" for name, (p, v, t) in MODELS.items()},
    dialect="AK80_9",
    configurations={"all": {"motors": dict.fromkeys(range(1, 128), True)}},
    doc="Impedance control of a motor in one frame: position, velocity, stiffness, damping, torque.",
    source="bgkatz/motorcontrol can.c",
)
exists = mit_motor.configured("motors", by="motor")(True)

Motor = IdField("motor", range(1, 128))
DamiaoMotor = IdField("motor", range(1, 16))
#: Replies of all motors come under one configured number, or under one each beside the motors' own.
Master = IdField("master", (0x000, *range(0x010, 0x020)))


def span(width: int, limit: float, unit: str, *, low: float | None = None) -> Quantity:
    """A number that spans ±`limit` (or from `low`) in 2**width − 1 steps."""
    return Quantity.span(bits(width), -limit if low is None else low, limit, bits=width, unit=unit)


for model, (position, velocity, torque) in MODELS.items():
    mit_motor.message(
        "Command",
        id=0x000 + (DamiaoMotor if model in DAMIAO else Motor),
        direction="to device",
        dialect=model,
        when=exists,
        payload=BitLayout(
            8,
            "position" / span(16, position, "rad"),
            "velocity" / span(12, velocity, "rad/s"),
            "kp" / span(12, 500, "N·m/rad", low=0),
            "kd" / span(12, 5, "N·m·s/rad", low=0),
            "torque" / span(12, torque, "N·m"),
            order="msb",
        ),
        doc="Torque = kp × (position error) + kd × (velocity error) + torque.",
        source="motorcontrol can.c, unpack_cmd",
    )
    measured = (
        "position" / span(16, position, "rad"),
        "velocity" / span(12, velocity, "rad/s"),
        "torque" / span(12, torque, "N·m"),
    )
    if model in CHEETAH:
        mit_motor.message(
            "Feedback",
            id=0x000,
            direction="from device",
            dialect=model,
            when=exists,
            prefix=Struct("motor" / Byte),
            match={"motor": Motor},
            payload=BitLayout(
                6, *measured, "bus_voltage" / Quantity.span(bits(8), 0, 40, bits=8, unit="V"), order="msb"
            ),
            doc="The answer to every command.",
            source="motorcontrol can.c, pack_reply",
        )
    elif model in TMOTOR:
        mit_motor.message(
            "Feedback",
            id=0x000,
            direction="from device",
            dialect=model,
            when=exists,
            prefix=Struct("motor" / Byte),
            match={"motor": Motor},
            payload=BitLayout(
                7,
                *measured,
                "temperature" / Quantity(bits(8, signed=True), unit="°C"),
                "error"
                / Enumeration(
                    bits(8),
                    none=0,
                    over_temperature=1,
                    over_current=2,
                    over_voltage=3,
                    under_voltage=4,
                    encoder=5,
                ),
                order="msb",
            ),
            doc="The answer to every command; the torque is a current times the torque constant.",
            source="TMotorCANControl mit_can.py",
        )
    else:
        mit_motor.message(
            "Feedback",
            id=0x000 + Master,
            direction="from device",
            dialect=model,
            when=exists,
            prefix=Struct("head" / Byte),
            match={
                "head": DamiaoMotor
                | IdField(
                    "status",
                    range(16),
                    names={
                        "disabled": 0x0,
                        "enabled": 0x1,
                        "over_voltage": 0x8,
                        "under_voltage": 0x9,
                        "over_current": 0xA,
                        "mos_over_temperature": 0xB,
                        "rotor_over_temperature": 0xC,
                        "lost_communication": 0xD,
                        "overload": 0xE,
                    },
                )
                << 4
            },
            payload=BitLayout(
                7,
                *measured,
                "mos_temperature" / Quantity(bits(8), unit="°C"),
                "rotor_temperature" / Quantity(bits(8), unit="°C"),
                order="msb",
            ),
            doc="The answer to every command.",
            source="python-damiao-driver motor.py",
        )

# ---------------------------------------------------------------------- special frames: commands at full scale

for name, last, doc in (
    ("Enable", 0xFC, "Enter motor mode."),
    ("Disable", 0xFD, "Leave motor mode."),
    ("SetZero", 0xFE, "The present position becomes zero."),
):
    for models, motor in (((*CHEETAH, *TMOTOR), Motor), (DAMIAO, DamiaoMotor)):
        mit_motor.message(
            name,
            id=0x000 + motor,
            direction="to device",
            dialect=models,
            when=exists,
            payload=Struct(Const(b"\xff" * 7 + bytes([last]))),
            overrides="Command",  # firmware tests for it first
            doc=doc,
            source="motorcontrol main.c",
        )

# ---------------------------------------------------------------------- Damiao alone

damiao: dict[str, Any] = {"dialect": tuple(DAMIAO), "when": exists}

mit_motor.message(
    "ClearError",
    id=0x000 + DamiaoMotor,
    direction="to device",
    payload=Struct(Const(b"\xff" * 7 + b"\xfb")),
    overrides="Command",
    doc="Clear the error state.",
    source="DM_CAN.py",
    **damiao,
)
mit_motor.message(
    "PositionVelocity",
    id=0x100 + DamiaoMotor,
    direction="to device",
    payload=Struct(
        "position" / Quantity(Float32l, unit="rad"), "velocity_limit" / Quantity(Float32l, unit="rad/s")
    ),
    doc="Go to a position.",
    source="DM_CAN.py",
    **damiao,
)
mit_motor.message(
    "Velocity",
    id=0x200 + DamiaoMotor,
    direction="to device",
    length=(4, 8),  # openarm_can sends 4 bytes, DM_CAN.py pads with zeros
    payload=Struct("velocity" / Quantity(Float32l, unit="rad/s"), "padding" / GreedyBytes),
    doc="Turn at a velocity.",
    source="DM_CAN.py, openarm_can",
    **damiao,
)
mit_motor.message(
    "ForcePosition",
    id=0x300 + DamiaoMotor,
    direction="to device",
    payload=Struct(
        "position" / Quantity(Float32l, unit="rad"),
        "velocity_limit" / Quantity(Int16ul, scale=0.01, unit="rad/s", range=(0, 100)),
        "current_limit" / Quantity(Int16ul, scale=0.0001, range=(0, 1)),
    ),
    doc="Go to a position with limited current (1 is full).",
    source="DM_CAN.py",
    **damiao,
)

REGISTERS = Enumeration(
    Int8ul,
    under_voltage=0, torque_constant=1, over_temperature=2, over_current=3, acceleration=4, deceleration=5, max_speed=6,
    master_id=7, can_id=8, timeout=9, control_mode=10, damping=11, inertia=12, hardware=13, software=14,
    serial_number=15, pole_pairs=16, resistance=17, inductance=18, flux=19, gear=20, position_max=21, velocity_max=22,
    torque_max=23,
    current_bandwidth=24, velocity_kp=25, velocity_ki=26, position_kp=27, position_ki=28, over_voltage=29, baud_code=35,
    sub_version=36, position=80, output_position=81,
)  # fmt: skip
#: Registers that hold an integer; all others hold a float.
INTEGERS = (*range(7, 11), *range(13, 17), 35, 36)
FLOATS = tuple(n for n in range(82) if n not in INTEGERS)

for name, opcode in (("Read", 0x33), ("Write", 0x55)):
    ask = mit_motor.family(
        prefix=Struct("motor" / Int16ul, "opcode" / Byte, "register" / REGISTERS),
        **damiao,
        source="DM_CAN.py, read_motor_param",
    )
    for kind, numbers, value in (("Float", FLOATS, Float32l), ("Integer", INTEGERS, Int32ul)):
        request = ask(
            f"{name}{kind}",
            id=0x7FF,
            direction="to device",
            motor=DamiaoMotor,
            opcode=opcode,
            register=numbers,
            payload=Struct("value" / value) if name == "Write" else Struct("padding" / Reserved(4)),
            doc=f"{name} a register.",
        )
        ask(
            f"{name}{kind}Reply",
            id=0x000 + Master,
            direction="from device",
            motor=DamiaoMotor,
            opcode=opcode,
            register=numbers,
            reply_to=request,  # a feedback can have the same bytes
            within=0.1,
            overrides="Feedback",
            payload=Struct("value" / value),
            doc="What the register holds.",
        )
