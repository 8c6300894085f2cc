"""MyActuator (LK-TECH) RMD-X, RMD-L and RMD-H motors on CAN: motion protocol V3 and V4.

1. A request is 0x140 + id, its answer 0x240 + id; both have eight bytes, and the first is the command in both.
2. Nothing but the command tells answers apart, and nothing needs to: no request is answered by another command.
3. V3 has the six gains of the controllers in one frame, a byte each; V4.2 has a number of the gain and a float. The bytes
   do not tell which: each is a dialect.
4. Angles, speeds and currents are those of the output shaft.

Sources: "Servo Motor Control Protocol" V4.2 of 2024-05 for drivers V3 (MyActuator, Motor Motion Protocol V4.2-250208.pdf),
by section; 2b-t/myactuator_rmd for the gains of V3 and the power (0x71); nekormd 0.2.2 for 0x88.
"""

from __future__ import annotations

from typing import Any

from construct import (
    Byte,
    Bytes,
    Construct,
    Float32l,
    Int8sl,
    Int16sl,
    Int16ul,
    Int32sl,
    Int32ul,
    Struct,
)

from aces_bus.protocol import BitLayout, Enumeration, Flags, IdField, Protocol, Quantity, Reserved, Text, bits
from aces_protocols.mit_frame import span

#: Identifiers of motors (V4.2 §4.1).
MOTORS = range(1, 33)
MANUAL = "MyActuator motion protocol V4.2"

rmdx = Protocol(
    "rmdx",
    link="can",
    bitrate=1_000_000,
    dialects={"3": "motion protocol V3: six gains of a byte", "4": "motion protocol V4.2: gains by number"},
    dialect="4",
    doc="MyActuator RMD-X, RMD-L, RMD-H motors.",
    source="MyActuator motion protocol V4.2 (2024-05); 2b-t/myactuator_rmd",
)
Motor = IdField("id", MOTORS, doc="the motor's number, 1 to 32")
asked = rmdx.family(id=0x140 + Motor, prefix=Struct("command" / Byte), direction="to device", length=8)
answered = rmdx.family(id=0x240 + Motor, prefix=Struct("command" / Byte), direction="from device", length=8)

#: Errors of status 1 (§2.14.3), as bits.
ERRORS = {
    "stall": 1,
    "low_voltage": 2,
    "over_voltage": 3,
    "over_current": 4,
    "power_overrun": 6,
    "calibration_write": 7,
    "speeding": 8,
    "over_temperature": 12,
    "encoder_calibration": 13,
}
PLANNED = {
    "position_acceleration": 0,
    "position_deceleration": 1,
    "speed_acceleration": 2,
    "speed_deceleration": 3,
}
GAINS = {
    "current_kp": 1,
    "current_ki": 2,
    "speed_kp": 4,
    "speed_ki": 5,
    "position_kp": 7,
    "position_ki": 8,
    "position_kd": 9,
}
FUNCTIONS = {
    "clear_turns": 1,
    "id_filter": 2,
    "send_errors": 3,
    "save_turns": 4,
    "set_id": 5,
    "highest_angle": 6,
    "lowest_angle": 7,
}

_celsius = "temperature" / Quantity(Int8sl, unit="°C")
_angle = Quantity(Int32sl, unit="°", scale=0.01)
_limit = "max_speed" / Quantity(Int16ul, unit="°/s", doc="0: as fast as the controller wants (0xA4).")
_motion = (
    _celsius,
    "current" / Quantity(Int16sl, unit="A", scale=0.01),
    "speed" / Quantity(Int16sl, unit="°/s"),
)


def request(
    name: str, command: int, section: str, *fields: Construct, doc: str, examples: Any, **more: Any
) -> None:
    """Declare what the host sends."""
    source = more.pop("source", f"{MANUAL} §{section}")
    asked(name, command=command, payload=Struct(*fields), doc=doc, source=source, examples=examples, **more)


def answer(
    name: str, command: int, section: str, *fields: Construct, doc: str, examples: Any, **more: Any
) -> None:
    """Declare what a motor answers."""
    source = more.pop("source", f"{MANUAL} §{section}")
    answered(
        name, command=command, payload=Struct(*fields), doc=doc, source=source, examples=examples, **more
    )


def question(
    name: str,
    command: int,
    section: str,
    *fields: Construct,
    doc: str,
    example: str,
    values: dict[str, Any],
    **more: Any,
) -> None:
    """Declare `Get…`, which has the command alone, and its answer."""
    request(
        f"Get{name}",
        command,
        section,
        "zero" / Reserved(7),
        doc=f"Ask for {doc}.",
        examples=[(f"141#{command:02X} 00 00 00 00 00 00 00", {"id": 1})],
        **more,
    )
    answer(
        name,
        command,
        section,
        *fields,
        doc=f"{doc[0].upper()}{doc[1:]}.",
        examples=[(f"241#{example}", {"id": 1, **values})],
    )


def echoed(
    name: str,
    command: int,
    section: str,
    *fields: Construct,
    doc: str,
    example: str = "00 00 00 00 00 00 00",
    values: Any = (),
    **more: Any,
) -> None:
    """Declare a request and its answer `…Done`, which repeats it."""
    inside = fields or ("zero" / Reserved(7),)
    given = {"id": 1, **dict(values)}
    request(
        name, command, section, *inside, doc=doc, examples=[(f"141#{command:02X} {example}", given)], **more
    )
    answer(
        f"{name}Done",
        command,
        section,
        *inside,
        doc=f"The answer to {name}: what was sent.",
        examples=[(f"241#{command:02X} {example}", given)],
        **more,
    )


# ---------------------------------------------------------------------- motion

request(
    "SetCurrent",
    0xA1,
    "2.19",
    "zero" / Reserved(3),
    "current" / Quantity(Int16sl, unit="A", scale=0.01),
    "zero2" / Reserved(2),
    doc="Torque by current. It does not open the brake: ReleaseBrake does.",
    examples=[
        ("141#A1 00 00 00 64 00 00 00", {"id": 1, "current": 1.0}),
        ("141#A1 00 00 00 9C FF 00 00", {"id": 1, "current": -1.0}),
    ],
)
request(
    "SetSpeed",
    0xA2,
    "2.20",
    "zero" / Reserved(3),
    "speed" / Quantity(Int32sl, unit="°/s", scale=0.01),
    doc="Turn with a speed.",
    examples=[
        ("141#A2 00 00 00 10 27 00 00", {"id": 1, "speed": 100.0}),
        ("141#A2 00 00 00 F0 D8 FF FF", {"id": 1, "speed": -100.0}),
    ],
)
request(
    "SetPosition",
    0xA4,
    "2.21",
    "zero" / Reserved(1),
    _limit,
    "position" / _angle,
    doc="Go to an angle of many turns.",
    examples=[
        ("141#A4 00 F4 01 A0 8C 00 00", {"id": 1, "max_speed": 500, "position": 360.0}),
        ("141#A4 00 F4 01 60 73 FF FF", {"id": 1, "max_speed": 500, "position": -360.0}),
    ],
)
request(
    "SetTurnPosition",
    0xA6,
    "2.22",
    "direction" / Enumeration(Byte, clockwise=0, counterclockwise=1),
    _limit,
    "position" / Quantity(Int16ul, unit="°", scale=0.01, range=(0, 360)),
    "zero" / Reserved(2),
    doc="Go to an angle within a turn, in a direction.",
    examples=[
        (
            "141#A6 01 F4 01 A0 8C 00 00",
            {"direction": "counterclockwise", "max_speed": 500, "position": 360.0},
        )
    ],
)
request(
    "Increment",
    0xA8,
    "2.23",
    "zero" / Reserved(1),
    _limit,
    "position" / _angle,
    doc="Go on from here by an angle.",
    examples=[("141#A8 00 F4 01 60 73 FF FF", {"id": 1, "max_speed": 500, "position": -360.0})],
)
answered(
    "Motion",
    match={"command": {0xA1, 0xA2, 0xA4, 0xA8}},
    payload=Struct(*_motion, "position" / Quantity(Int16sl, unit="°")),
    doc="The answer to SetCurrent, SetSpeed, SetPosition and Increment.",
    source=f"{MANUAL} §2.19 to §2.21, §2.23",
    examples=[
        (
            "241#A1 32 64 00 F4 01 2D 00",
            {"command": 0xA1, "temperature": 50, "current": 1.0, "speed": 500, "position": 45},
        ),
        (
            "241#A2 32 9C FF 0C FE D3 FF",
            {"command": 0xA2, "temperature": 50, "current": -1.0, "speed": -500, "position": -45},
        ),
        ("241#A4 32 64 00 F4 01 2D 00", {"command": 0xA4, "position": 45}),
        ("241#A8 32 64 00 F4 01 2D 00", {"command": 0xA8, "position": 45}),
    ],
)
answer(
    "TurnMotion",
    0xA6,
    "2.22",
    *_motion,
    "encoder" / Quantity(Int16ul, unit="1"),
    doc="The answer to SetTurnPosition.",
    examples=[
        ("241#A6 32 64 00 F4 01 E8 03", {"temperature": 50, "current": 1.0, "speed": 500, "encoder": 1000})
    ],
)
echoed("ShutDown", 0x80, "2.17", doc="Switch the output off; no loop is closed any more.")
echoed("Stop", 0x81, "2.18", doc="Stand still, with the loop closed.")
echoed(
    "Run",
    0x88,
    "",
    doc="Go on after Stop; V4.2 does not have it.",
    dialect="3",
    source="nekormd 0.2.2, NekoRMD.init",
)
echoed("ReleaseBrake", 0x77, "2.26", doc="Open the holding brake.")
echoed("LockBrake", 0x78, "2.27", doc="Close the holding brake.")

# ---------------------------------------------------------------------- measured

question(
    "Status1",
    0x9A,
    "2.14",
    _celsius,
    "zero" / Reserved(1),
    "brake" / Enumeration(Byte, locked=0, released=1),
    "voltage" / Quantity(Int16ul, unit="V", scale=0.1),
    "errors" / Flags(Int16ul, ERRORS),
    doc="temperature, brake, supply and errors",
    example="9A 32 00 01 E5 01 04 00",
    values={"temperature": 50, "brake": "released", "voltage": 48.5, "errors": ["low_voltage"]},
)
question(
    "Status2",
    0x9C,
    "2.15",
    *_motion,
    "position" / Quantity(Int16sl, unit="°"),
    doc="current, speed and angle, coarse",
    example="9C 32 64 00 F4 01 2D 00",
    values={"temperature": 50, "current": 1.0, "speed": 500, "position": 45},
)
question(
    "Status3",
    0x9D,
    "2.16",
    _celsius,
    *(name / Quantity(Int16sl, unit="A", scale=0.01) for name in ("a", "b", "c")),
    doc="currents of the phases",
    example="9D 32 C2 0B 10 FA C0 F9",
    values={"a": 30.1, "b": -15.2, "c": -16.0},
)
question(
    "Angle",
    0x92,
    "2.12",
    "zero" / Reserved(3),
    "angle" / _angle,
    doc="the angle of the output, over many turns",
    example="92 00 00 00 A0 8C 00 00",
    values={"angle": 360.0},
)
question(
    "TurnAngle",
    0x94,
    "2.13",
    "zero" / Reserved(5),
    "angle" / Quantity(Int16ul, unit="°", scale=0.01),
    doc="the angle of the output within a turn",
    example="94 00 00 00 00 00 10 27",
    values={"angle": 100.0},
)
question(
    "Encoder",
    0x60,
    "2.6",
    "zero" / Reserved(3),
    "count" / Int32sl,
    doc="the encoder over many turns, from its zero",
    example="60 00 00 00 10 27 00 00",
    values={"count": 10_000},
)
question(
    "RawEncoder",
    0x61,
    "2.7",
    "zero" / Reserved(3),
    "count" / Int32sl,
    doc="the encoder over many turns, without its zero",
    example="61 00 00 00 10 27 00 00",
    values={"count": 10_000},
)
question(
    "EncoderZero",
    0x62,
    "2.8",
    "zero" / Reserved(3),
    "count" / Int32sl,
    doc="the zero of the encoder",
    example="62 00 00 00 10 27 00 00",
    values={"count": 10_000},
)
question(
    "TurnEncoder",
    0x90,
    "2.11",
    "zero" / Reserved(1),
    "count" / Int16ul,
    "raw" / Int16ul,
    "offset" / Int16ul,
    doc="the encoder within a turn, from its zero and without",
    example="90 00 33 08 BE 2C 8B 24",
    values={"count": 2099, "raw": 11_454, "offset": 9355},
)
question(
    "Mode",
    0x70,
    "2.24",
    "zero" / Reserved(6),
    "mode" / Enumeration(Byte, current=1, speed=2, position=3),
    doc="the loop that is closed",
    example="70 00 00 00 00 00 00 03",
    values={"mode": "position"},
)
question(
    "Power",
    0x71,
    "",
    "zero" / Reserved(5),
    "power" / Quantity(Int16ul, unit="W", scale=0.1),
    doc="the power",
    source="2b-t/myactuator_rmd, GetMotorPowerResponse",
    example="71 00 00 00 00 00 0A 00",
    values={"power": 1.0},
)
question(
    "RunTime",
    0xB1,
    "2.28",
    "zero" / Reserved(3),
    "time" / Quantity(Int32ul, unit="ms"),
    doc="how long it has run since it was reset",
    example="B1 00 00 00 00 00 00 10",
    values={"time": 268_435_456},
)
question(
    "Version",
    0xB2,
    "2.29",
    "zero" / Reserved(3),
    "date" / Int32ul,
    doc="the date of its software, as YYYYMMDD",
    example="B2 00 00 00 2E 89 34 01",
    values={"date": 20_220_206},
)
question(
    "Model",
    0xB5,
    "2.32",
    "model" / Text(7),
    doc="the model",
    example="B5 58 38 53 32 56 31 30",
    values={"model": "X8S2V10"},
)

# ---------------------------------------------------------------------- settings

_planned = "kind" / Enumeration(Byte, PLANNED)
_acceleration = "acceleration" / Quantity(Int32ul, unit="°/s²")
request(
    "GetAcceleration",
    0x42,
    "2.4",
    _planned,
    "zero" / Reserved(6),
    doc="Ask for an acceleration.",
    examples=[("141#42 01 00 00 00 00 00 00", {"kind": "position_deceleration"})],
)
answer(
    "Acceleration",
    0x42,
    "2.4",
    _planned,
    "zero" / Reserved(2),
    _acceleration,
    doc="An acceleration.",
    examples=[("241#42 01 00 00 10 27 00 00", {"kind": "position_deceleration", "acceleration": 10_000})],
)
echoed(
    "SetAcceleration",
    0x43,
    "2.5",
    _planned,
    "zero" / Reserved(2),
    "acceleration" / Quantity(Int32ul, unit="°/s²", range=(100, 60_000)),
    doc="Set an acceleration, for good.",
    example="01 00 00 10 27 00 00",
    values={"kind": "position_deceleration", "acceleration": 10_000},
)

_gain = ("gain" / Enumeration(Byte, GAINS), "zero" / Reserved(2), "value" / Float32l)
request(
    "GetGain",
    0x30,
    "2.1",
    "gain" / Enumeration(Byte, GAINS),
    "zero" / Reserved(6),
    doc="Ask for a gain.",
    dialect="4",
    examples=[("141#30 01 00 00 00 00 00 00", {"gain": "current_kp"})],
)
answer(
    "Gain",
    0x30,
    "2.1",
    *_gain,
    doc="A gain.",
    dialect="4",
    examples=[("241#30 01 00 00 00 00 80 3F", {"gain": "current_kp", "value": 1.0})],
)
for _name, _command, _section, _doc in (
    ("SetGain", 0x31, "2.2", "Set a gain, until power-off."),
    ("StoreGain", 0x32, "2.3", "Set a gain, for good."),
):
    echoed(
        _name,
        _command,
        _section,
        *_gain,
        doc=_doc,
        example="01 00 00 00 00 C0 3F",
        dialect="4",
        values={"gain": "current_kp", "value": 1.5},
    )
_gains = ("zero" / Reserved(1), *(name / Byte for name in GAINS if name != "position_kd"))
_V3: dict[str, Any] = {
    "dialect": "3",
    "source": "2b-t/myactuator_rmd, GetControllerGains, SetControllerGains",
}
_six = {
    "current_kp": 85,
    "current_ki": 25,
    "speed_kp": 85,
    "speed_ki": 25,
    "position_kp": 85,
    "position_ki": 25,
}
request(
    "GetGains",
    0x30,
    "",
    "zero" / Reserved(7),
    doc="Ask for the gains.",
    examples=[("141#30 00 00 00 00 00 00 00", {"id": 1})],
    **_V3,
)
answer(
    "Gains",
    0x30,
    "",
    *_gains,
    doc="The gains.",
    examples=[("241#30 00 55 19 55 19 55 19", {"id": 1, **_six})],
    **_V3,
)
echoed(
    "SetGains",
    0x31,
    "",
    *_gains,
    doc="Set the gains, until power-off.",
    example="00 55 19 55 19 55 19",
    values=_six,
    **_V3,
)
echoed(
    "StoreGains",
    0x32,
    "",
    *_gains,
    doc="Set the gains, for good.",
    example="00 55 19 55 19 55 19",
    values=_six,
    **_V3,
)

_count = ("zero" / Reserved(3), "count" / Int32sl)
echoed(
    "SetEncoderZero",
    0x63,
    "2.9",
    *_count,
    doc="Set the zero of the encoder, for good.",
    example="00 00 00 10 27 00 00",
    values={"count": 10_000},
)
request(
    "ZeroHere",
    0x64,
    "2.10",
    "zero" / Reserved(7),
    doc="Make the present angle its zero, for good, after Reset.",
    examples=[("141#64 00 00 00 00 00 00 00", {"id": 1})],
)
answer(
    "ZeroHereDone",
    0x64,
    "2.10",
    *_count,
    doc="The zero that ZeroHere has stored.",
    examples=[("241#64 00 00 00 10 27 00 00", {"count": 10_000})],
)
request(
    "Reset",
    0x76,
    "2.25",
    "zero" / Reserved(7),
    doc="Boot anew; it is not answered.",
    examples=[("141#76 00 00 00 00 00 00 00", {"id": 1})],
)
echoed(
    "SetTimeout",
    0xB3,
    "2.30",
    "zero" / Reserved(3),
    "timeout" / Quantity(Int32ul, unit="ms", doc="0: none."),
    doc="Switch the output off when nothing came for so long; kept for good.",
    example="00 00 00 E8 03 00 00",
    values={"timeout": 1000},
)
request(
    "SetBitrate",
    0xB4,
    "2.31",
    "zero" / Reserved(6),
    "bitrate" / Enumeration(Byte, {"500k": 0, "1M": 1}),
    doc="Set the bit rate, for good; what it answers is not defined.",
    examples=[("141#B4 00 00 00 00 00 00 01", {"bitrate": "1M"})],
)
request(
    "SetReport",
    0xB6,
    "2.33",
    "reported" / Byte,
    "enabled" / Enumeration(Byte, off=0, on=1),
    "period" / Quantity(Int16ul, unit="ms", scale=10),
    "zero" / Reserved(3),
    doc="Have it send an answer (0x60, 0x61, 0x62, 0x92, 0x9A, 0x9C, 0x9D) by itself; it answers nothing else then.",
    examples=[("141#B6 60 01 01 00 00 00 00", {"reported": 0x60, "enabled": "on", "period": 10})],
)
echoed(
    "Function",
    0x20,
    "2.34",
    "function" / Enumeration(Byte, FUNCTIONS),
    "zero" / Reserved(2),
    "value" / Int32sl,
    doc="A setting by its number.",
    example="02 00 00 01 00 00 00",
    values={"function": "id_filter", "value": 1},
)

# ---------------------------------------------------------------------- several motors, identifiers, motion mode

rmdx.message(
    "ToAll",
    id=0x280,
    direction="to device",
    payload=Struct("command" / Byte, "data" / Bytes(7)),
    doc="A command to all motors; each answers it.",
    source=f"{MANUAL} §3",
    examples=[("280#80 00 00 00 00 00 00 00", {"command": 0x80})],
)
only = rmdx.family(
    id=0x300,
    prefix=Struct("command" / Byte, "zero" / Reserved(1), "access" / Enumeration(Byte, write=0, read=1)),
)
only(
    "SetId",
    command=0x79,
    access=0,
    payload=Struct("zero2" / Reserved(4), "number" / Byte),
    doc="Set the identifier of the only motor on the bus, for good; its answer is the same.",
    source=f"{MANUAL} §4",
    examples=[("300#79 00 00 00 00 00 00 02", {"number": 2})],
)
only(
    "Id",
    command=0x79,
    access=1,
    payload=Struct("zero2" / Reserved(3), "answers" / Int16ul),
    doc="The identifier of its answers; 0 asks for it.",
    source=f"{MANUAL} §4",
    examples=[
        ("300#79 00 01 00 00 00 00 00", {"answers": 0}),
        ("300#79 00 01 00 00 00 42 02", {"answers": 0x242}),
    ],
)
rmdx.message(
    "Impede",
    id=0x400 + Motor,
    direction="to device",
    doc="Motion mode: stiffness, damping and torque.",
    payload=BitLayout(
        8,
        "position" / span(16, 12.5, "rad"),
        "velocity" / span(12, 45, "rad/s"),
        "kp" / span(12, 500, "N·m/rad", low=0),
        "kd" / span(12, 5, "N·m·s/rad", low=0),
        "torque" / span(12, 24, "N·m"),
        order="msb",
    ),
    source=f"{MANUAL} §5",
    examples=[
        (
            "401#E6 66 82 E0 52 33 3B 55",
            {
                "id": 1,
                "position": 58982 / 65535 * 25 - 12.5,
                "velocity": 2094 / 4095 * 90 - 45,
                "kp": 82 / 4095 * 500,
                "kd": 1.0,
                "torque": 2901 / 4095 * 48 - 24,
            },
        )
    ],
)
rmdx.message(
    "Impeding",
    id=0x500 + Motor,
    direction="from device",
    doc="The answer to Impede.",
    payload=BitLayout(
        8,
        "number" / bits(8),
        "position" / span(16, 12.5, "rad"),
        "velocity" / span(12, 45, "rad/s"),
        "torque" / span(12, 24, "N·m"),
        order="msb",
    ),
    source=f"{MANUAL} §5; its example prints 65 for the byte 66",
    examples=[
        (
            "501#01 E6 66 82 EB 55 00 00",
            {
                "id": 1,
                "number": 1,
                "position": 58982 / 65535 * 25 - 12.5,
                "velocity": 2094 / 4095 * 90 - 45,
                "torque": 2901 / 4095 * 48 - 24,
            },
        )
    ],
)

__all__ = ["ERRORS", "GAINS", "MOTORS", "rmdx"]
