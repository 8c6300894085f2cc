"""Position, velocity and time, their covariances, and vectors to bases."""

from __future__ import annotations

from construct import Byte, Construct, Int16sl, Int16ul, Int32ul

from aces_bus.protocol import BitLayout, Enumeration, Flags, Quantity, Reserved, bits

from .base import MODE, double, sbf_block, sbf_groups, sbf_revisions, single, u2
from .examples import EXAMPLES

SYSTEMS = {"gps": 0, "galileo": 1, "glonass": 3, "beidou": 4, "qzss": 5, "atomichron": 100, "unknown": 255}
_reference = Quantity(Int16ul, unknown=[0xFFFF], doc="Base station, or PRN of a geostationary satellite.")

#: Of both PVT blocks, between velocity and the fields of later revisions.
_CLOCK: tuple[Construct, ...] = (
    "course" / single("°", "Over ground."),
    "clock_bias" / double("ms"),
    "clock_drift" / single("ppm"),
    "time_system" / Enumeration(Byte, SYSTEMS),
    "datum" / Quantity(Byte, unknown=[255]),
    "satellites" / Quantity(Byte, unknown=[255]),
    "corrections"
    / BitLayout(
        1,
        "orbit_clock" / bits(1),
        "range" / bits(1),
        "ionosphere" / bits(1),
        "orbit_accuracy" / bits(1),
        "precision_approach" / bits(1),
        "rtk" / Enumeration(bits(2), unknown=0, physical_base=1, virtual_base=2, ssr=3),
    ),
    "reference" / _reference,
    "correction_age" / u2("s", 0.01),
    "signals" / Int32ul,
    "alerts"
    / BitLayout(
        1,
        "raim" / Enumeration(bits(2), not_active=0, passed=1, failed=2),
        "hpca_failed" / bits(1),
        "ionospheric_storm" / bits(1),
        "signal_authentication" / bits(1, at=5),
        "message_authentication" / bits(1, at=6),
    ),
)
_REVISION_1: tuple[Construct, ...] = (
    "bases" / Byte,
    "ppp"
    / BitLayout(
        2,
        "seed_age" / Quantity(bits(12), unit="s"),
        "seed" / Enumeration(bits(3, at=13), none=0, manual=1, dgps=2, rtk_fixed=3),
    ),
)
_REVISION_2: tuple[Construct, ...] = (
    "latency" / u2("s", 1e-4),
    "horizontal_accuracy" / u2("m", 0.01),
    "vertical_accuracy" / u2("m", 0.01),
    "misc"
    / BitLayout(
        1,
        "base_arp" / bits(1),
        "phase_centre" / bits(1),
        "arp_offset" / Enumeration(bits(2, at=6), unknown=0, zero=1, not_zero=2),
    ),
)
_PLACES = {
    "PVTCartesian": (4006, ("x", "y", "z"), ("m", "m", "m"), ("vx", "vy", "vz")),
    "PVTGeodetic": (
        4007,
        ("latitude", "longitude", "height"),
        ("rad", "rad", "m"),
        ("v_north", "v_east", "v_up"),
    ),
}
for _name, (_number, _place, _units, _velocity) in _PLACES.items():
    _first = (
        *MODE,
        *(axis / double(unit) for axis, unit in zip(_place, _units, strict=True)),
        "undulation" / single("m"),
        *(axis / single("m/s") for axis in _velocity),
        *_CLOCK,
    )
    sbf_revisions(
        _name,
        _number,
        *_first,
        later={1: _REVISION_1, 2: _REVISION_2},
        doc=f"Position, velocity and time ({', '.join(_place)}).",
    )

for _name, _number, _axes, _unit in (
    ("PosCovCartesian", 5905, "xyzb", "m²"),
    ("PosCovGeodetic", 5906, ("lat", "lon", "height", "b"), "m²"),
    ("VelCovCartesian", 5907, ("vx", "vy", "vz", "dt"), "m²/s²"),
    ("VelCovGeodetic", 5908, ("vn", "ve", "vu", "dt"), "m²/s²"),
):
    _pairs = [(axis, axis) for axis in _axes]
    _pairs += [(a, b) for at, a in enumerate(_axes) for b in _axes[at + 1 :]]
    sbf_block(
        _name,
        _number,
        *MODE,
        *(f"{a}_{b}" / single(_unit) for a, b in _pairs),
        doc=f"Covariances of {'position' if _name[0] == 'P' else 'velocity'} and clock.",
        examples=EXAMPLES[_name],
    )

_dop = Quantity(Int16ul, scale=0.01, unknown=[0])
sbf_block(
    "DOP",
    4001,
    "satellites" / Quantity(Byte, unknown=[0]),
    "reserved" / Reserved(1),
    *(name / _dop for name in ("pdop", "tdop", "hdop", "vdop")),
    "hpl" / single("m"),
    "vpl" / single("m"),
    doc="Dilution of precision, and protection levels.",
    examples=EXAMPLES["DOP"],
)
sbf_block("EndOfPVT", 5921, doc="All of this epoch's position was sent.", examples=EXAMPLES["EndOfPVT"])


def _vectors(name: str, number: int, axes: tuple[str, ...]) -> None:
    """Declare the vectors to bases."""
    vector = (
        "satellites" / Byte,
        "error" / MODE[1].subcon,
        "mode" / MODE[0].subcon,
        "misc" / Flags(Byte, base_arp=0, phase_centre=1),
        *(axis / double("m") for axis in axes),
        *(f"v_{axis}" / single("m/s") for axis in axes),
        "azimuth" / u2("°", 0.01),
        "elevation" / Quantity(Int16sl, unit="°", scale=0.01, unknown=[-0x8000]),
        "reference" / _reference,
        "correction_age" / u2("s", 0.01),
        "signals" / Int32ul,
    )
    sbf_groups(
        name,
        number,
        "vectors",
        vector,
        doc="Vectors from the receiver to its bases.",
        examples=EXAMPLES[name],
    )


_vectors("BaseVectorCart", 4043, ("dx", "dy", "dz"))
_vectors("BaseVectorGeod", 4028, ("east", "north", "up"))
