"""VectorNav's sentences: what the unit sends by itself, registers, commands and errors, as characters.

1. `$VN`, three letters, fields behind commas, `*`, the check as hexadecimal characters, CR LF. The check is over all between
   `$` and `*`: the exclusive or (dialect `xor`, as units are delivered) or the CRC of the binary output (`crc`). That
   is another protocol, `vectornav`.
2. Numbers are written with their sign and leading zeros by the unit; signs and leading zeros mean nothing.
3. A unit repeats a command as its answer, with the values of a register that was asked for, or sends an error. Values of a
   register are texts: what they are, the register says; those that the unit sends by itself are also sentences with fields.

Sources: VectorNav, VN-100 User Manual UM001 v2.22, §3 (framing, checks, commands, errors) and the chapters of the registers;
vnproglib 1.1 `packet.h` (`parseVNYPR` … `parseVNISE`) for order and meaning of the fields; `vectornav-vn200` 0.1 for the
registers; sentences recorded by others in `examples`.
"""

from __future__ import annotations

from construct import Bytes, Construct, Struct

from aces_bus.protocol import (
    AsciiEnumeration,
    AsciiInteger,
    AsciiNumber,
    AsciiText,
    Check,
    Crc,
    Delimited,
    Protocol,
    Xor,
)

#: The checks by dialect.
CHECKS: dict[str, Check] = {
    "xor": Xor(text="*{:02X}", over=slice(1, -5)),
    "crc": Crc("CRC16-XMODEM", text="*{:04X}", over=slice(1, -7)),
}
UNITS = "VectorNav VN-100, VN-200, VN-300"
MANUAL = "VectorNav VN-100 User Manual UM001 v2.22"
#: Codes of errors, in hexadecimal characters.
ERRORS = {
    "hard_fault": "01",
    "serial_buffer_overflow": "02",
    "invalid_checksum": "03",
    "invalid_command": "04",
    "not_enough_parameters": "05",
    "too_many_parameters": "06",
    "invalid_parameter": "07",
    "invalid_register": "08",
    "unauthorized_access": "09",
    "watchdog_reset": "0A",
    "output_buffer_overflow": "0B",
    "insufficient_baud_rate": "0C",
    "error_buffer_overflow": "FF",
}


def _number(name: str, unit: str = "", digits: int | None = None) -> Construct:
    return name / AsciiNumber(unit=unit, digits=digits)


def _three(name: str, unit: str, digits: int, axes: str = "xyz") -> tuple[Construct, ...]:
    return tuple(_number(f"{name}_{axis}", unit, digits) for axis in axes)


def _accuracies(axes: str) -> tuple[Construct, ...]:
    return (
        *_three("accuracy", "m", 3, axes),
        _number("speed_accuracy", "m/s", 3),
        _number("time_accuracy", "s"),
    )


ANGLES = (_number("yaw", "°", 3), _number("pitch", "°", 3), _number("roll", "°", 3))
QUATERNION = tuple(_number(f"q{n}", digits=6) for n in range(4))
MAG = _three("mag", "gauss", 4)
ACCELERATION = _three("acceleration", "m/s²", 3)
RATE = _three("rate", "rad/s", 6)
LLA = (_number("latitude", "°", 8), _number("longitude", "°", 8), _number("altitude", "m", 3))
POSITION = _three("position", "m", 3)
VELOCITY_NED = _three("velocity", "m/s", 3, "ned")
VELOCITY = _three("velocity", "m/s", 3)
FIX = (
    _number("time", "s", 6),
    "week" / AsciiInteger(digits=4),
    "fix" / AsciiInteger(),
    "satellites" / AsciiInteger(digits=2),
)
INS = (
    _number("time", "s", 6),
    "week" / AsciiInteger(digits=4),
    "status" / AsciiText(doc="four hexadecimal characters: the bits of `ins_status` of the binary output"),
    *ANGLES,
)
UNCERTAINTY = (
    _number("attitude_uncertainty", "°"),
    _number("position_uncertainty", "m"),
    _number("velocity_uncertainty", "m/s"),
)
#: What a unit sends by itself: by its letters, the register that has the same values, what it is, its fields.
OUTPUTS: dict[str, tuple[int, str, tuple[Construct, ...]]] = {
    "YPR": (8, "Attitude.", ANGLES),
    "QTN": (9, "Attitude as a quaternion, its scalar last.", QUATERNION),
    "QMR": (15, "Quaternion and compensated sensors.", (*QUATERNION, *MAG, *ACCELERATION, *RATE)),
    "MAG": (17, "The magnetic field, compensated.", MAG),
    "ACC": (18, "Acceleration, compensated.", ACCELERATION),
    "GYR": (19, "Angular rate, compensated.", RATE),
    "MAR": (20, "Compensated sensors.", (*MAG, *ACCELERATION, *RATE)),
    "YMR": (27, "Attitude and compensated sensors.", (*ANGLES, *MAG, *ACCELERATION, *RATE)),
    "IMU": (
        54,
        "Sensors, not compensated.",
        (*MAG, *ACCELERATION, *RATE, _number("temperature", "°C", 1), _number("pressure", "kPa", 3)),
    ),
    "GPS": (58, "The fix in degrees and metres.", (*FIX, *LLA, *VELOCITY_NED, *_accuracies("ned"))),
    "GPE": (59, "The fix in ECEF.", (*FIX, *POSITION, *VELOCITY, *_accuracies("xyz"))),
    "INS": (63, "The filter's solution in degrees and metres.", (*INS, *LLA, *VELOCITY_NED, *UNCERTAINTY)),
    "INE": (64, "The filter's solution in ECEF.", (*INS, *POSITION, *VELOCITY, *UNCERTAINTY)),
    "ISL": (
        72,
        "The filter's state in degrees and metres.",
        (*ANGLES, *LLA, *VELOCITY_NED, *ACCELERATION, *RATE),
    ),
    "ISE": (73, "The filter's state in ECEF.", (*ANGLES, *POSITION, *VELOCITY, *ACCELERATION, *RATE)),
    "DTV": (
        80,
        "Angles and velocities since the last one.",
        (_number("interval", "s", 6), *_three("theta", "°", 6), *_three("delta_velocity", "m/s", 6)),
    ),
    "YBA": (
        239,
        "Attitude, acceleration of the body without gravity, angular rate.",
        (*ANGLES, *ACCELERATION, *RATE),
    ),
    "YIA": (
        240,
        "Attitude, acceleration in NED without gravity, angular rate.",
        (*ANGLES, *_three("acceleration", "m/s²", 3, "ned"), *RATE),
    ),
}
#: Sentences recorded by others, by their letters; those of the dialect `xor`.
RECORDED: dict[str, tuple[bytes, dict[str, object]]] = {
    "YPR": (  # a VN-100's
        b"$VNYPR,-129.867,-000.355,-000.296*61\r\n",
        {"yaw": -129.867, "pitch": -0.355, "roll": -0.296},
    ),
    "INS": (  # a VN-200's, at its factory settings
        b"$VNINS,224159.474991,2048,8085,-149.042,+013.639,+010.915,+40.09623362,-088.20139124,+00204.179,"
        b"+000.023,+000.007,-000.248,20.5,02.5,0.20*6F\r\n",
        {"week": 2048, "status": "8085", "latitude": 40.09623362, "altitude": 204.179, "velocity_d": -0.248},
    ),
    "Error": (b"$VNERR,03*72\r\n", {"code": "invalid_checksum"}),  # the manual's
}


vectornav_text = Protocol(
    "vectornav_text",
    link="serial",
    baud=115_200,
    dialects={
        "xor": "the check is an exclusive or, as units are delivered",
        "crc": "the check is a CRC of 16 bits",
    },
    doc=f"{UNITS}: measurements, registers and commands as sentences of characters.",
    source=MANUAL,
)


def _declare(dialect: str) -> None:
    """Declare the sentences of a dialect; they have the same names in each."""
    sentence = vectornav_text.framing(
        sync=b"$VN", check=CHECKS[dialect], end=b"\r\n", not_inside=b"$", max_size=256, gap=0.1
    ).family(prefix=Struct("type" / Bytes(3)), dialect=dialect)

    def declare(name: str, letters: str, payload: Construct, doc: str, **more: object) -> None:
        known = [RECORDED[name]] if name in RECORDED and dialect == "xor" else []
        sentence(
            name,
            type=letters.encode(),
            payload=payload,
            doc=doc,
            examples=known,
            **{"source": MANUAL, **more},
        )

    def fields(*given: Construct, optional: int = 0, more: bool = False) -> Delimited:
        return Delimited(",", *given, lead=True, optional=optional, more=more)

    for letters, (register, doc, given) in OUTPUTS.items():
        source = f"{MANUAL}; vnproglib packet.h, parseVN{letters}"
        declare(
            letters,
            letters,
            fields(*given),
            f"{doc} Register {register}.",
            source=source,
            direction="from device",
        )
    number = "register" / AsciiInteger()
    declare(
        "ReadRegister",
        "RRG",
        fields(number, "value" / AsciiText(), optional=1, more=True),
        "Ask for a register; the unit's answer has its first value, and the others in `more`.",
    )
    declare(
        "WriteRegister",
        "WRG",
        fields(number, "value" / AsciiText(), more=True),
        "Set a register: its first value, the others in `more`. The unit repeats it as its answer.",
    )
    for name, letters, doc in (
        ("WriteSettings", "WNV", "Keep the registers over a reset."),
        ("RestoreFactorySettings", "RFS", "Take the factory's settings, and reset."),
        ("Reset", "RST", "Begin anew."),
        ("Tare", "TAR", "Make the present attitude zero."),
        ("SetGyroBias", "SGB", "Take the present rates as zero."),
    ):
        declare(name, letters, Struct(), f"{doc} The unit repeats it as its answer.")
    switch = "on" / AsciiEnumeration({"off": "0", "on": "1"})
    for name, letters, doc in (
        ("SendByItself", "ASY", "Whether the unit sends by itself."),
        ("KnownMagneticDisturbance", "KMD", "Whether a disturbance of the magnetic field is known."),
        ("KnownAccelerationDisturbance", "KAD", "Whether a disturbance of the acceleration is known."),
    ):
        declare(name, letters, fields(switch), f"{doc} The unit repeats it as its answer.")
    declare(
        "Error",
        "ERR",
        fields("code" / AsciiEnumeration(ERRORS), more=True),
        "What is wrong.",
        direction="from device",
    )


for _dialect in CHECKS:
    _declare(_dialect)
