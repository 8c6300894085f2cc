"""NMEA 0183 in under 100 lines: the sentences of satellite receivers and compasses that a robot reads.

Written from the README and the tutorial alone. Each example is a sentence that pynmeagps parses to the same values.
Sentences without a check are not accepted, a position's hemisphere is a field of its own, and makers' own sentences
(`$P…`) are unknown.

    aces decode session.bin -p examples/nmea0183.py

Source: the published standard, as semuconsulting/pynmeagps has it (`nmeatypes_get.py`, `nmeahelpers.py`).
"""

from __future__ import annotations

from typing import Any

from construct import Bytes, Struct

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

nmea0183 = Protocol("nmea0183", link="serial", baud=4800, source="NMEA 0183; pynmeagps nmeatypes_get.py")

# $ | talker, type | ,field,field… | *check | CR LF. The standard says 82 characters; receivers exceed it.
sentence = nmea0183.framing(
    sync=b"$", end=b"\r\n", not_inside=b"$\n", check=Xor(text="*{:02X}"), max_size=120, gap=1.0
).family(Struct("talker" / Text(2), "type" / Bytes(3)), direction="from device")


def declare(line: bytes, doc: str, *fields: Any, optional: int = 0, **values: Any) -> None:
    """A sentence, named as its type is in the example `line`. What newer receivers append is kept in `more`."""
    sentence(
        line[3:6].decode(),
        type=line[3:6],
        payload=Delimited(",", *fields, lead=True, optional=optional, more=True),
        doc=doc,
        examples=[(line + b"\r\n", values)],
    )


def number(name: str, unit: str = "") -> Any:
    return name / AsciiNumber(unit=unit)


def integer(name: str) -> Any:
    return name / AsciiInteger(digits=2)


def text(name: str, doc: str = "always the same letter, or nothing") -> Any:
    return name / AsciiText(doc=doc)


# fmt: off
TIME = text("time", "hhmmss.ss, UTC")
STATUS = "status" / AsciiEnumeration({"valid": "A", "void": "V"})
MODE = "mode" / AsciiEnumeration(
    {"autonomous": "A", "differential": "D", "estimated": "E", "rtk_float": "F", "rtk": "R", "none": "N"})
POSITION = ("latitude" / AsciiDegrees(width=2), "north_south" / AsciiEnumeration({"north": "N", "south": "S"}),
            "longitude" / AsciiDegrees(width=3), "east_west" / AsciiEnumeration({"east": "E", "west": "W"}))
QUALITY = {"none": "0", "gps": "1", "dgps": "2", "rtk": "4", "rtk_float": "5", "dead_reckoning": "6"}

declare(b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47", "Position and height above the sea.",
        TIME, *POSITION, "quality" / AsciiEnumeration(QUALITY), integer("satellites"), number("hdop"),
        number("altitude", "m"), text("altitude_unit"), number("geoid", "m"), text("geoid_unit"),
        number("age", "s"), text("station", "of the corrections"),
        latitude=48.1173, longitude=11.516667, quality="gps", satellites=8, altitude=545.4, age=None)
declare(b"$GNRMC,103607.00,A,5327.03942,N,00214.42462,W,0.046,,060321,,,A,V*0F", "Position, speed, date.",
        TIME, STATUS, *POSITION, number("speed", "kn"), number("course", "°"), text("date", "ddmmyy"),
        number("variation", "°"), text("variation_sign", "E or W"), MODE, text("navigation", "its status"), optional=2,
        status="valid", latitude=53.450657, east_west="west", speed=0.046, course=None, date="060321")
declare(b"$GNVTG,103.85,T,92.79,M,0.14,N,0.25,K,D*00", "Course and speed over ground, each twice.",
        number("course", "°"), text("t"), number("magnetic_course", "°"), text("m"),
        number("speed", "kn"), text("n"), number("speed_kmh", "km/h"), text("k"), MODE, optional=1,
        course=103.85, magnetic_course=92.79, speed=0.14, speed_kmh=0.25, mode="differential")
declare(b"$GNGSA,A,3,23,31,10,,,,,,,,,,1.87,1.12,1.49,1*03", "Satellites in use, and how well they are spread.",
        "selection" / AsciiEnumeration({"automatic": "A", "manual": "M"}), "fix" / AsciiInteger(),
        *(integer(f"satellite_{n}") for n in range(1, 13)), number("pdop"), number("hdop"), number("vdop"),
        text("system", "1 GPS, 2 GLONASS, 3 Galileo"), optional=1,
        fix=3, satellite_1=23, satellite_3=10, satellite_4=None, pdop=1.87, vdop=1.49)
declare(b"$GPGSV,1,1,02,10,63,137,17,07,61,098,15,1*64", "Satellites in view: four texts each in `more`.",
        "sentences" / AsciiInteger(), "sentence" / AsciiInteger(), integer("in_view"),
        in_view=2, more=["10", "63", "137", "17", "07", "61", "098", "15", "1"])
declare(b"$GNGLL,5327.04319,S,00214.41396,E,223232.00,A,A*68", "Position alone.",
        *POSITION, TIME, STATUS, MODE, optional=1, latitude=53.45072, north_south="south", mode="autonomous")
declare(b"$GPHDT,274.07,T*03", "True heading.", number("heading", "°"), text("t"), heading=274.07)
