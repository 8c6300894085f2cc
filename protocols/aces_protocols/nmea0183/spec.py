"""NMEA 0183, the sentences of satellite receivers and compasses.

1. A sentence without a check, or with a wrong one, is none. A line feed alone ends a sentence, too.
2. An empty field is unknown (`None`); what newer receivers append is kept as texts in `more`.
3. Numbers stay as they are written: degrees without their sign, times as `103607.00`, dates as `060321`.

Sources: the published standard; semuconsulting/pynmeagps `nmeatypes_get.py`, `nmeahelpers.py`.
"""

from __future__ import annotations

from typing import Any

from construct import Bytes, Construct, Struct

from aces_bus.protocol import (
    AsciiDegrees,
    AsciiEnumeration,
    AsciiInteger,
    AsciiNumber,
    AsciiText,
    Delimited,
    Protocol,
    Text,
    Xor,
)

nmea0183 = Protocol(
    "nmea0183",
    link="serial",
    baud=4800,
    doc="NMEA 0183: position, course, satellites, heading, time, as sentences of characters.",
    source="NMEA 0183; pynmeagps nmeatypes_get.py",
)

# $ | talker, type | ,field,field… | *check | CR LF
sentence = nmea0183.framing(
    sync=b"$",
    check=Xor(text="*{:02X}"),
    end=(b"\r\n", b"\n"),  # logs of computers often have line feeds alone
    not_inside=b"$",  # a sentence whose end was lost does not run on into the next
    max_size=128,  # the standard says 82 characters; receivers exceed it
    gap=1.0,
).family(prefix=Struct("talker" / Text(2), "type" / Bytes(3)), direction="from device")


def _declare(line: bytes, doc: str, *fields: Construct, optional: int = 0, **values: Any) -> None:
    """Declare a sentence, named as its type is in the example `line`, which means `values`."""
    name = line[3:6]
    sentence(
        name.decode(),
        type=name,
        payload=Delimited(",", *fields, lead=True, optional=optional, more=True),
        doc=doc,
        source=f"pynmeagps, {name.decode()}",
        examples=[(line + b"\r\n", values)],
    )


def _number(name: str, unit: str = "", digits: int | None = None) -> Construct:
    return name / AsciiNumber(unit=unit, digits=digits)


def _integer(name: str, digits: int = 1) -> Construct:
    return name / AsciiInteger(digits=digits)


def _mark(name: str) -> Construct:
    return name / AsciiText(doc="Always the same letter, or nothing.")


def _letters(name: str, **names: str) -> Construct:
    return name / AsciiEnumeration(names)


TIME = "time" / AsciiText(doc="hhmmss.ss, UTC")
#: u-blox' accuracy of a position: five digits of a minute are 2 cm.
POSITION = (
    "lat" / AsciiDegrees(width=2, digits=5),
    _letters("lat_sign", north="N", south="S"),
    "lon" / AsciiDegrees(width=3, digits=5),
    _letters("lon_sign", east="E", west="W"),
)
STATUS = _letters("status", valid="A", void="V")
MODE = _letters(
    "mode",
    autonomous="A",
    differential="D",
    estimated="E",
    rtk_float="F",
    manual="M",
    none="N",
    precise="P",
    rtk_fixed="R",
    simulator="S",
)
NAVIGATION = _letters("navigation", safe="S", caution="C", unsafe="U", void="V")
SYSTEM = "system" / AsciiText(doc="1 GPS, 2 GLONASS, 3 Galileo, 4 BeiDou, 5 QZSS")

_declare(
    b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47",
    "The fix: position, quality, altitude.",
    TIME,
    *POSITION,
    _letters(
        "quality", none="0", gps="1", dgps="2", pps="3", rtk_fixed="4", rtk_float="5", dead_reckoning="6"
    ),
    _integer("satellites", 2),
    _number("hdop"),
    _number("altitude", "m", 1),
    _mark("altitude_unit"),
    _number("separation", "m", 1),
    _mark("separation_unit"),
    _number("age", "s"),
    "station" / AsciiText(doc="Of the corrections."),
    talker="GP",
    time="123519",
    lat=48.1173,
    lat_sign="north",
    lon=11.516667,
    quality="gps",
    satellites=8,
    altitude=545.4,
    separation=46.9,
    age=None,
)
_declare(
    b"$GNRMC,103607.00,A,5327.03942,N,00214.42462,W,0.046,,060321,,,A,V*0F",
    "The least a navigator needs: position, speed, course, date.",
    TIME,
    STATUS,
    *POSITION,
    _number("speed", "kn", 3),
    _number("course", "°", 2),
    "date" / AsciiText(doc="ddmmyy"),
    _number("variation", "°", 1),
    _letters("variation_sign", east="E", west="W"),
    MODE,
    NAVIGATION,
    optional=2,
    talker="GN",
    status="valid",
    lat=53.450657,
    lon=2.24041,
    lon_sign="west",
    speed=0.046,
    course=None,
    date="060321",
    mode="autonomous",
    navigation="void",
)
_declare(
    b"$GNGSA,A,3,23,31,10,,,,,,,,,,1.87,1.12,1.49,1*03",
    "The satellites in use, and how well they are spread.",
    _letters("selection", automatic="A", manual="M"),
    _letters("fix", none="1", fix_2d="2", fix_3d="3"),
    *(_integer(f"satellite{n}", 2) for n in range(1, 13)),
    _number("pdop", "", 2),
    _number("hdop", "", 2),
    _number("vdop", "", 2),
    SYSTEM,
    optional=1,
    fix="fix_3d",
    satellite1=23,
    satellite3=10,
    satellite4=None,
    pdop=1.87,
    vdop=1.49,
    system="1",
)
_declare(
    b"$GPGSV,1,1,02,10,63,137,17,07,61,098,15,1*64",
    "The satellites in view, in several sentences: `more` has number, elevation, azimuth, SNR of each, then the signal.",
    _integer("messages"),
    _integer("number"),
    _integer("in_view", 2),
    in_view=2,
    more=["10", "63", "137", "17", "07", "61", "098", "15", "1"],
)
_declare(
    b"$GNVTG,103.85,T,92.79,M,0.14,N,0.25,K,D*00",
    "Course and speed over ground, each twice.",
    _number("course", "°", 2),
    _mark("course_mark"),
    _number("course_magnetic", "°", 2),
    _mark("course_magnetic_mark"),
    _number("speed", "kn", 3),
    _mark("speed_mark"),
    _number("speed_kmh", "km/h", 3),
    _mark("speed_kmh_mark"),
    MODE,
    optional=1,
    course=103.85,
    course_magnetic=92.79,
    speed=0.14,
    speed_kmh=0.25,
    mode="differential",
)
_declare(
    b"$GNGLL,5327.04319,S,00214.41396,E,223232.00,A,A*68",
    "Position and time.",
    *POSITION,
    TIME,
    STATUS,
    MODE,
    optional=1,
    lat=53.45072,
    lat_sign="south",
    time="223232.00",
    mode="autonomous",
)
_declare(
    b"$GNGNS,103607.00,5327.03942,N,00214.42462,W,AANN,06,5.88,56.0,48.5,,,V*34",
    "The fix of several systems; `modes` has a letter for each.",
    TIME,
    *POSITION,
    "modes" / AsciiText(),
    _integer("satellites", 2),
    _number("hdop"),
    _number("altitude", "m", 1),
    _number("separation", "m", 1),
    _number("age", "s"),
    "station" / AsciiText(doc="Of the corrections."),
    NAVIGATION,
    optional=1,
    modes="AANN",
    satellites=6,
    hdop=5.88,
    altitude=56.0,
)
_declare(
    b"$GNGST,103607.00,38,60,38,89,15,24,31*63",
    "Statistics of the error: standard deviations.",
    TIME,
    _number("rms"),
    _number("major", "m"),
    _number("minor", "m"),
    _number("orientation", "°"),
    _number("lat_deviation", "m", 3),
    _number("lon_deviation", "m", 3),
    _number("alt_deviation", "m", 3),
    rms=38,
    orientation=89,
    lat_deviation=15,
    lon_deviation=24,
    alt_deviation=31,
)
_declare(
    b"$GNZDA,103607.00,06,03,2021,00,00*7F",
    "Date and time.",
    TIME,
    _integer("day", 2),
    _integer("month", 2),
    _integer("year", 4),
    _integer("zone_hours", 2),
    _integer("zone_minutes", 2),
    time="103607.00",
    day=6,
    month=3,
    year=2021,
)
_declare(
    b"$GPHDT,274.07,T*03", "True heading.", _number("heading", "°", 2), _mark("heading_mark"), heading=274.07
)
_declare(
    b"$GPHDM,223.12,M*05",
    "Magnetic heading.",
    _number("heading", "°", 2),
    _mark("heading_mark"),
    heading=223.12,
)
_declare(
    b"$IIHDG,70.6,,,,W*2F",
    "Magnetic heading, deviation of the compass, variation of the place.",
    _number("heading", "°", 1),
    _number("deviation", "°", 1),
    _letters("deviation_sign", east="E", west="W"),
    _number("variation", "°", 1),
    _letters("variation_sign", east="E", west="W"),
    heading=70.6,
    deviation=None,
    variation_sign="west",
)
_declare(
    b"$IIROT,-7.3,A*0F",
    "Rate of turn, positive to starboard.",
    _number("rate", "°/min", 1),
    STATUS,
    rate=-7.3,
    status="valid",
)
