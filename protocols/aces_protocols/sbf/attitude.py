"""Attitude of several antennas, the solution of an inertial unit, and what external sensors measure."""

from __future__ import annotations

from construct import Array, Byte, Bytes, Const, Int16sl, Int16ul, Rebuild, Struct, Switch, len_, this

from aces_bus.protocol import BitLayout, Enumeration, Flags, Present, Quantity, Reserved, bits

from .base import double, sbf_block, single, u2
from .examples import EXAMPLES

MOSAIC, DRIVER = "mosaic-H Reference Guide 4.10.1", "septentrio_gnss_driver sbf_blocks.hpp, *.msg"
_baseline = Enumeration(bits(2), none=0, few_measurements=1)
_errors = "error" / BitLayout(1, "aux1" / _baseline, "aux2" / _baseline, "not_requested" / bits(1, at=7))

sbf_block(
    "AttEuler",
    5938,
    "satellites" / Quantity(Byte, unknown=[255]),
    _errors,
    "mode" / Enumeration(Int16ul, none=0, heading_pitch_float=1, heading_pitch_fixed=2, float=3, fixed=4),
    "info" / Byte,
    "reserved" / Reserved(1),
    *(name / single("°") for name in ("heading", "pitch", "roll")),
    *(name / single("°/s") for name in ("pitch_rate", "roll_rate", "heading_rate")),
    doc="Attitude by several antennas.",
    source=MOSAIC,
    examples=EXAMPLES["AttEuler"],
)
sbf_block(
    "AttCovEuler",
    5939,
    "reserved" / Reserved(1),
    _errors,
    *(
        name / single("°²")
        for name in (
            "heading_heading",
            "pitch_pitch",
            "roll_roll",
            "heading_pitch",
            "heading_roll",
            "pitch_roll",
        )
    ),
    doc="Covariances of the attitude.",
    source=MOSAIC,
    examples=EXAMPLES["AttCovEuler"],
)
sbf_block(
    "EndOfAtt",
    5943,
    doc="All of this epoch's attitude was sent.",
    source=MOSAIC,
    examples=EXAMPLES["EndOfAtt"],
)


def _three(unit: str, names: tuple[str, ...], suffix: str = "") -> Struct:
    return Struct(*(f"{name}{suffix}" / single(unit) for name in names))


def _inertial(name: str, number: int, is_geodetic: bool, doc: str) -> None:
    """Declare a solution of the inertial unit: bits of `parts` say what else is in it."""
    place = (
        (
            "latitude" / double("rad"),
            "longitude" / double("rad"),
            "height" / double("m"),
            "undulation" / single("m"),
        )
        if is_geodetic
        else tuple(axis / double("m") for axis in "xyz")
    )
    axes = ("latitude", "longitude", "height") if is_geodetic else ("x", "y", "z")
    speeds = ("v_east", "v_north", "v_up") if is_geodetic else ("vx", "vy", "vz")
    angles = ("heading", "pitch", "roll")

    def pairs(names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(
            f"{a}_{b}" for a, b in ((names[0], names[1]), (names[0], names[2]), (names[1], names[2]))
        )

    sbf_block(
        name,
        number,
        "gnss_mode" / Byte,
        "error" / Byte,
        "info" / Int16ul,
        "gnss_age" / u2("s", 0.01),
        *place,
        "accuracy" / u2("m", 0.01),
        "latency" / u2("s", 1e-4),
        "datum" / Quantity(Byte, unknown=[255]),
        "reserved" / Reserved(1),
        "parts"
        / Flags(
            Int16ul,
            position_deviation=0,
            attitude=1,
            attitude_deviation=2,
            velocity=3,
            velocity_deviation=4,
            position_covariance=5,
            attitude_covariance=6,
            velocity_covariance=7,
        ),
        "position_deviation" / Present("parts", 0, _three("m", axes)),
        "attitude" / Present("parts", 1, _three("°", angles)),
        "attitude_deviation" / Present("parts", 2, _three("°", angles)),
        "velocity" / Present("parts", 3, _three("m/s", speeds)),
        "velocity_deviation" / Present("parts", 4, _three("m/s", speeds)),
        "position_covariance" / Present("parts", 5, _three("m²", pairs(axes))),
        "attitude_covariance" / Present("parts", 6, _three("°²", pairs(angles))),
        "velocity_covariance" / Present("parts", 7, _three("m²/s²", pairs(speeds))),
        is_padded=False,
        doc=doc,
        source=DRIVER,
        examples=EXAMPLES[name],
    )


_inertial("INSNavCart", 4225, False, "Position, attitude and velocity of the inertial unit.")
_inertial("INSNavGeod", 4226, True, "Position, attitude and velocity of the inertial unit.")
_inertial("ExtEventINSNavCart", 4229, False, "The same at the instant of an external event.")
_inertial("ExtEventINSNavGeod", 4230, True, "The same at the instant of an external event.")

_KINDS = {"acceleration": 0, "angular_rate": 1, "info": 3, "velocity": 4, "zero_velocity": 20}
_measured = Switch(
    this.kind,
    {
        "acceleration": Struct(*(axis / double("m/s²") for axis in "xyz")),
        "angular_rate": Struct(*(axis / double("°/s") for axis in "xyz")),
        "info": Struct(
            "temperature" / Quantity(Int16sl, unit="°C", scale=0.01, unknown=[-0x8000]), "rest" / Bytes(22)
        ),
        "velocity": Struct(
            *(axis / single("m/s") for axis in "xyz"),
            *(f"deviation_{axis}" / single("m/s") for axis in "xyz"),
        ),
        "zero_velocity": Struct("flag" / double(""), "rest" / Bytes(16)),
    },
    default=Bytes(24),
)
sbf_block(
    "ExtSensorMeas",
    4050,
    "count" / Rebuild(Byte, len_(this.sets)),
    Const(b"\x1c"),
    "sets"
    / Array(
        this.count,
        Struct(
            "source" / Byte,
            "model" / Byte,
            "kind" / Enumeration(Byte, _KINDS),
            "info" / Byte,
            "data" / _measured,
        ),
    ),
    is_padded=False,
    doc="What external sensors measure.",
    source=DRIVER,
    examples=EXAMPLES["ExtSensorMeas"],
)
