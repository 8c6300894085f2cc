"""CyberGear and RobStride motors, their private protocol: identifiers of 29 bits, the MIT law, parameters, faults.

1. An identifier is type << 24 | data << 8 | target: the data have the numbers of motor and host, states, the torque of a
   command.
2. Position, velocity, torque and gains span ranges of the model, which the motor does not tell: the dialect `robstride` has
   shares of them (-1 to 1), a model's dialect has SI.
3. Motors are 0x01 to 0x7F, hosts 0x80 to 0xFF (but 0xFE): so requests and answers of parameters differ by their identifiers.

Sources: belovictor/cybergear-docs `instructionmanual.md` (the vendor's manual, translated); ROBSTRIDE-DYNAMICS/
Robstride-Dynamics-Python-SDK `robstride_dynamics/*.py`; RobStride/SampleProgram `RS/Robstride.h`; kscalelabs/robstride
`src/{protocol,actuator_types}.rs`; han-xudong/pyCyberGear `Protocol_Specification_CN.docx`.
"""

from __future__ import annotations

from math import pi
from typing import Any

from construct import Byte, Const, Construct, Float32l, Int16sl, Int16ul, Int32ul, Int64ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, Flags, IdField, Protocol, Quantity, Reserved, bits
from aces_protocols.mit_frame import span

Ranges = tuple[float, float, float, float, float]
#: Model → position (rad), velocity (rad/s), torque (N·m), kp (N·m/rad), kd (N·m·s/rad) at full scale.
MODELS: dict[str, Ranges] = {
    "CyberGear": (4 * pi, 30, 12, 500, 5),
    "RS01": (4 * pi, 44, 17, 500, 5),
    "RS02": (4 * pi, 44, 17, 500, 5),
    "RS04": (4 * pi, 15, 120, 5000, 100),
}
#: Models whose sources disagree and do not decide it: what they say. They need a robot file's own ranges.
UNDECIDED = {
    "RS00": "velocity 33 or 50 rad/s, torque 14 or 17 N·m",
    "RS03": "velocity 20, 33 or 50 rad/s",
    "RS05": "velocity 33 or 50 rad/s, torque 5.5 or 17 N·m",
    "RS06": "position 4π or 112.5 rad, velocity 20 or 50 rad/s, torque 36 or 60 N·m",
}
SHARE, FAMILY = "robstride", "cybergear"
#: Dialect → its ranges.
DIALECTS: dict[str, Ranges] = {
    SHARE: (1.0, 1.0, 1.0, 1.0, 1.0),
    FAMILY: MODELS["CyberGear"],
    "RS02": MODELS["RS02"],
}

robstride = Protocol(
    "robstride",
    link="can",
    bitrate=1_000_000,
    dialects={
        SHARE: "RobStride motors of any model: shares of their ranges",
        FAMILY: "CyberGear: ±4π rad, ±30 rad/s, ±12 N·m",
        "RS02": "RobStride 02 (and 01): ±4π rad, ±44 rad/s, ±17 N·m",
    },
    dialect=SHARE,
    doc="CyberGear and RobStride motors, private protocol.",
    source="cybergear-docs instructionmanual.md; Robstride-Dynamics-Python-SDK; kscalelabs/robstride",
)

CG, RS = "cybergear-docs instructionmanual.md", "Robstride-Dynamics-Python-SDK protocol.py, table.py"
#: Whom an answer that says an id is for.
ANYBODY = 0xFE

Motor = IdField("motor", range(1, 0x80), doc="the motor's number, 0x7F from the factory")
Host = IdField("host", (*range(0x80, ANYBODY), 0xFF), doc="who asks, and is answered; 0xFD by custom")


def asks(kind: int, name: str, payload: Construct, **more: Any) -> Any:
    """Return a message to a motor: its type, who asks, the motor."""
    more.setdefault("source", CG)
    return robstride.message(
        name, id=kind << 24 | Host << 8 | Motor, extended=True, direction="to device", payload=payload, **more
    )


# ---------------------------------------------------------------------- motion

EMPTY = Struct("padding" / Reserved(8))
STATES = {"reset": 0, "calibration": 1, "run": 2}
_MOTION: dict[str, list[Any]] = {
    SHARE: [
        (
            "0185547F#8A 2F 77 77 0F 5C 33 33",
            {"motor": 0x7F, "position": 0.0795757992, "velocity": -0.0666666667, "kp": 0.0599984741, "kd": 0.2,
                "torque": 0.0416418708},
        )
    ],
    FAMILY: [
        (
            "0185547F#8A 2F 77 77 0F 5C 33 33",
            {"motor": 0x7F, "position": 0.9999789845713458, "velocity": -2.0, "kp": 29.999237048905165,
                "kd": 1.0, "torque": 0.4997024490730144,},
        )
    ],
    "RS02": [
        ("0183C27F#8A 2E 7A 2D 0F 5C 33 33", {"velocity": -2.0014343480582895, "torque": 0.49935149156938863})
    ],
}  # fmt: skip
_STATUS: dict[str, list[Any]] = {
    SHARE: [
        (
            "02B105FD#8A 2F 77 77 85 54 01 3B",
            {
                "host": 0xFD, "motor": 5, "state": "run", "uncalibrated": 1, "stalled": 1, "magnetic_encoder": 0,
                "over_temperature": 0, "over_current": 0, "under_voltage": 1, "position": 0.0795757992,
                "velocity": -0.0666666667, "torque": 0.0416418708, "temperature": 31.5,
            },
        )
    ],
    FAMILY: [
        (
            "02847FFD#8A 2F 77 77 85 54 01 3B",
            {"host": 0xFD, "motor": 0x7F, "state": "run", "over_temperature": 1, "under_voltage": 0, "temperature": 31.5},
        )
    ],
    "RS02": [
        (
            "024A05FD#8A 2E 7A 2D 83 C2 01 3B",
            {
                "host": 0xFD, "motor": 5, "state": "calibration", "uncalibrated": 0, "stalled": 0, "magnetic_encoder": 1,
                "over_temperature": 0, "over_current": 1, "under_voltage": 0, "position": 0.999595482,
                "velocity": -2.00143435, "torque": 0.499351492, "temperature": 31.5,
            },
        )
    ],
}  # fmt: skip

for dialect, (position, velocity, torque, kp, kd) in DIALECTS.items():
    units = ("",) * 5 if dialect == SHARE else ("rad", "rad/s", "N·m", "N·m/rad", "N·m·s/rad")
    given = IdField("torque", range(0x10000), unit=units[2], scale=2 * torque / 0xFFFF, offset=-torque)
    robstride.message(
        "Command",
        id=1 << 24 | given << 8 | Motor,
        extended=True,
        direction="to device",
        dialect=dialect,
        payload=BitLayout(
            8,
            "position" / span(16, position, units[0]),
            "velocity" / span(16, velocity, units[1]),
            "kp" / span(16, kp, units[3], low=0),
            "kd" / span(16, kd, units[4], low=0),
            order="msb",
        ),
        doc="Torque = kp × (position error) + kd × (velocity error) + torque; in run mode `motion`.",
        source=CG,
        examples=_MOTION[dialect],
    )
    robstride.message(
        "Feedback",
        id=2 << 24
        | IdField("state", range(4), names=STATES) << 22
        | IdField("uncalibrated", range(2)) << 21
        | IdField("stalled" if dialect != FAMILY else "hall_encoder", range(2)) << 20
        | IdField("magnetic_encoder", range(2)) << 19
        | IdField("over_temperature", range(2)) << 18
        | IdField("over_current", range(2)) << 17
        | IdField("under_voltage", range(2)) << 16
        | Motor << 8
        | Host,
        extended=True,
        direction="from device",
        dialect=dialect,
        payload=BitLayout(
            8,
            "position" / span(16, position, units[0]),
            "velocity" / span(16, velocity, units[1]),
            "torque" / span(16, torque, units[2]),
            "temperature" / Quantity(bits(16), unit="°C", scale=0.1),
            order="msb",
        ),
        doc="The answer to every command; its state and faults are in the identifier.",
        source=CG if dialect == FAMILY else RS,
        examples=_STATUS[dialect],
    )

asks(
    3,
    "Enable",
    EMPTY,
    doc="Switch the motor on.",
    examples=[("0300FD7F#00 00 00 00 00 00 00 00", {"host": 0xFD})],
)
asks(
    4,
    "Stop",
    Struct("clear" / Byte, "padding" / Reserved(7)),
    doc="Switch it off; clear 1: clear the faults, too.",
    examples=[("0400FD7F#01 00 00 00 00 00 00 00", {"host": 0xFD, "motor": 0x7F, "clear": 1})],
)
asks(
    6,
    "SetZero",
    Struct("confirm" / Byte, "padding" / Reserved(7)),
    doc="The present position becomes zero (CyberGear: until power-off); confirm is 1.",
    examples=[("0600FD7F#01 00 00 00 00 00 00 00", {"host": 0xFD, "motor": 0x7F, "confirm": 1})],
)

# ---------------------------------------------------------------------- who is there

asks(
    0,
    "GetId",
    EMPTY,
    doc="Ask for the unique id.",
    examples=[("0000FD7F#00 00 00 00 00 00 00 00", {"motor": 0x7F})],
)
robstride.message(
    "Id",
    id=0 << 24 | Motor << 8 | ANYBODY,
    extended=True,
    direction="from device",
    payload=Struct("unique_id" / Int64ul),
    doc="A motor's unique id: the answer to GetId and SetId.",
    examples=[("00007FFE#01 02 03 04 05 06 07 88", {"motor": 0x7F, "unique_id": 0x8807060504030201})],
    source=CG,
)
robstride.message(
    "SetId",
    id=7 << 24 | IdField("new_motor", range(1, 0x80)) << 16 | Host << 8 | Motor,
    extended=True,
    direction="to device",
    payload=Struct("confirm" / Byte, "padding" / Reserved(7)),
    doc="Give the motor another number.",
    examples=[
        ("0705FD7F#01 00 00 00 00 00 00 00", {"new_motor": 5, "host": 0xFD, "motor": 0x7F, "confirm": 1})
    ],
    source=CG,
)

# ---------------------------------------------------------------------- parameters

RUN_MODES = {"motion": 0, "position": 1, "speed": 2, "current": 3, "zero": 4, "cyclic_position": 5}
#: Name → index, by the type that it holds.
FLOATS: dict[str, int] = {
    "iq_ref": 0x7006, "spd_ref": 0x700A, "limit_torque": 0x700B, "cur_kp": 0x7010, "cur_ki": 0x7011, "cur_filt_gain": 0x7014,
    "loc_ref": 0x7016, "limit_spd": 0x7017, "limit_cur": 0x7018, "mech_pos": 0x7019, "iqf": 0x701A, "mech_vel": 0x701B,
    "vbus": 0x701C, "loc_kp": 0x701E, "spd_kp": 0x701F, "spd_ki": 0x7020, "spd_filt_gain": 0x7021, "acc": 0x7022,
    "vel_max": 0x7024, "acc_set": 0x7025,
}  # fmt: skip
BYTES: dict[str, int] = {"run_mode": 0x7005, "zero_sta": 0x7029}
SHORTS: dict[str, int] = {"rotation": 0x701D}
LONGS: dict[str, int] = {"report_period": 0x7026, "can_timeout": 0x7028}
READ_ONLY = frozenset(("mech_pos", "iqf", "mech_vel", "vbus", "rotation"))
PARAMETERS = FLOATS | BYTES | SHORTS | LONGS
#: Kind → the names it holds, and how the four bytes of a value are read.
KINDS: dict[str, tuple[dict[str, int], Any]] = {
    "Float": (FLOATS, Struct("value" / Float32l)),
    "Byte": (BYTES, Struct("value" / Byte, "padding" / Reserved(3))),
    "Short": (SHORTS, Struct("value" / Int16sl, "padding" / Reserved(2))),
    "Long": (LONGS, Struct("value" / Int32ul)),
}
_INDEX = ("index" / Enumeration(Int16ul, PARAMETERS), "gap" / Reserved(2))

asks(
    17,
    "ReadParameter",
    Struct(*_INDEX, "padding" / Reserved(4)),
    doc="Ask for a parameter.",
    examples=[("1100FD7F#19 70 00 00 00 00 00 00", {"host": 0xFD, "motor": 0x7F, "index": "mech_pos"})],
)
_VALUES: dict[str, list[Any]] = {
    "FloatParameter": [
        ("11007FFD#19 70 00 00 00 00 40 BF", {"motor": 0x7F, "index": "mech_pos", "value": -0.75}),
        ("11017FFD#19 70 00 00 00 00 00 00", {"motor": 0x7F, "index": "mech_pos", "status": "error"}),
    ],
    "ByteParameter": [("110001FD#05 70 00 00 02 00 00 00", {"motor": 1, "index": "run_mode", "value": 2})],
    "ShortParameter": [("110001FD#1D 70 00 00 18 FC 00 00", {"motor": 1, "index": "rotation", "value": -1000})],
    "LongParameter": [("110001FD#28 70 00 00 20 4E 01 00", {"motor": 1, "index": "can_timeout", "value": 85_536})],
    "WriteFloat": [("1200FD01#16 70 00 00 00 00 C0 BF", {"motor": 1, "index": "loc_ref", "value": -1.5})],
    "WriteByte": [("1200FD01#05 70 00 00 01 00 00 00", {"motor": 1, "index": "run_mode", "value": 1})],
    "WriteShort": [("1200FD01#1D 70 00 00 FE FF 00 00", {"motor": 1, "index": "rotation", "value": -2})],
    "WriteLong": [("1200FD01#28 70 00 00 20 4E 01 00", {"motor": 1, "index": "can_timeout", "value": 85_536})],
}  # fmt: skip
for kind, (names, value) in KINDS.items():
    shared: dict[str, Any] = {
        "extended": True,
        "prefix": Struct(*_INDEX),
        "match": {"index": tuple(names.values())},
        "payload": value,
        "source": CG + "; " + RS,
    }
    robstride.message(
        f"{kind}Parameter",
        id=17 << 24 | IdField("status", range(2), names={"ok": 0, "error": 1}) << 16 | Motor << 8 | Host,
        direction="from device",
        doc="A parameter's value; with status `error` it means nothing (kscalelabs).",
        examples=_VALUES[f"{kind}Parameter"],
        **shared,
    )
    robstride.message(
        f"Write{kind}",
        id=18 << 24 | Host << 8 | Motor,
        direction="to device",
        doc="Write a parameter, until power-off; answered by a Feedback. The run mode changes while it is stopped only.",
        examples=_VALUES[f"Write{kind}"],
        **shared,
    )

# ---------------------------------------------------------------------- faults, speed of the bus, keeping

robstride.message(
    "FaultReport",
    id=21 << 24 | Motor << 8 | Host,
    extended=True,
    direction="from device",
    payload=Struct(
        "faults"
        / Flags(
            Int32ul, motor_over_temperature=0, driver=1, under_voltage=2, over_voltage=3, phase_b_over_current=4,
            phase_c_over_current=5, uncalibrated=7, overload=8, phase_a_over_current=16,
        ),
        "warnings" / Flags(Int32ul, motor_over_temperature=0),
    ),
    doc="Faults and warnings, by itself when one comes.",
    examples=[
        (
            "15007FFD#04 00 01 00 01 00 00 00",
            {
                "motor": 0x7F, "host": 0xFD, "faults": ["under_voltage", "phase_a_over_current"],
                "warnings": ["motor_over_temperature"],
            },
        )
    ],
    source=CG,
)  # fmt: skip
RATES = {"1M": 1, "500k": 2, "250k": 3, "125k": 4}
asks(
    22,
    "SetBaud",
    Struct("rate" / Enumeration(Byte, RATES), "padding" / Reserved(7)),
    dialect=FAMILY,
    doc="Another bit rate, from the next power-on.",
    examples=[("1600FD7F#02 00 00 00 00 00 00 00", {"motor": 0x7F, "rate": "500k"})],
)
asks(
    22,
    "Save",
    Struct(Const(bytes(range(1, 9)))),
    dialect=(SHARE, "RS02"),
    doc="Keep the parameters for good.",
    examples=[("1600FD7F#01 02 03 04 05 06 07 08", {"host": 0xFD, "motor": 0x7F})],
    source=RS,
)
asks(
    23,
    "SetBaud",
    Struct("rate" / Enumeration(Byte, RATES), "padding" / Reserved(7)),
    dialect=(SHARE, "RS02"),
    doc="Another bit rate.",
    examples=[("1700FD7F#03 00 00 00 00 00 00 00", {"motor": 0x7F, "rate": "250k"})],
    source=RS,
)
