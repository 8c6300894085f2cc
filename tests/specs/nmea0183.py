"""NMEA 0183 sentences of satellite receivers and compasses.

What it asks of the language: fields of characters, empty ones, missing ones, new ones; a talker inside the address; a
check written as two hex digits, a terminator.

Sources: semuconsulting/pynmeagps `nmeatypes_get.py`, `nmeahelpers.py`; the published standard.
Deviations: sentences without a check are not accepted. Times and dates stay texts, as
`103607.00` and `060321`. A position is degrees in one field and its letter in the next; the sign is for the user to
take. `!AIVDM` and makers' own sentences (`$P…`) are unknown.
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

nmea0183 = Protocol(
    "nmea0183",
    link="serial",
    baud=4800,
    doc="Sentences in ASCII: position, course, satellites, heading, time.",
    source="pynmeagps nmeatypes_get.py",
)

sentence = nmea0183.framing(
    sync=b"$",
    check=Xor(text="*{:02X}"),
    end=b"\r\n",
    not_inside=b"$\n",  # a sentence whose end was lost does not run on into the next
    max_size=128,  # the standard says 82 characters; receivers exceed it
    gap=1.0,
).family(prefix=Struct("talker" / Text(2), "type" / Bytes(3)), direction="from device")


def number(unit: str = "", digits: int | None = None) -> AsciiNumber:
    return AsciiNumber(unit=unit, digits=digits)


def time() -> Any:
    return "time" / AsciiText(doc="hhmmss.ss, UTC")


def position() -> tuple[Any, ...]:
    return (
        "lat" / AsciiDegrees(width=2),
        "lat_sign" / AsciiEnumeration({"north": "N", "south": "S"}),
        "lon" / AsciiDegrees(width=3),
        "lon_sign" / AsciiEnumeration({"east": "E", "west": "W"}),
    )


VALIDITY = {"valid": "A", "void": "V"}


def mode() -> Any:
    return "mode" / AsciiEnumeration(
        {
            "autonomous": "A",
            "differential": "D",
            "estimated": "E",
            "float": "F",
            "manual": "M",
            "none": "N",
            "rtk": "R",
            "simulator": "S",
        }
    )


def declare(name: str, *fields: Any, optional: int = 0, doc: str) -> None:
    sentence(
        name,
        type=name.encode(),
        payload=Delimited(",", *fields, lead=True, optional=optional, more=True),
        doc=doc,
        source=f"pynmeagps, {name}",
    )


declare(
    "GGA",
    time(),
    *position(),
    "quality"
    / AsciiEnumeration(
        {
            "none": "0",
            "gps": "1",
            "dgps": "2",
            "pps": "3",
            "rtk_fixed": "4",
            "rtk_float": "5",
            "dead_reckoning": "6",
        }
    ),
    "satellites" / AsciiInteger(digits=2),
    "hdop" / number(),
    "altitude" / number("m", 1),
    "altitude_unit" / AsciiText(),
    "separation" / number("m", 1),
    "separation_unit" / AsciiText(),
    "age" / number("s"),
    "station" / AsciiText(),
    doc="The fix: position, quality, altitude.",
)
declare(
    "RMC",
    time(),
    "status" / AsciiEnumeration(VALIDITY),
    *position(),
    "speed" / number("kn", 3),
    "course" / number("°", 2),
    "date" / AsciiText(doc="ddmmyy"),
    "variation" / number("°", 1),
    "variation_sign" / AsciiEnumeration({"east": "E", "west": "W"}),
    mode(),
    "navigation" / AsciiEnumeration({"safe": "S", "caution": "C", "unsafe": "U", "void": "V"}),
    optional=2,
    doc="The least a navigator needs.",
)
declare(
    "GSA",
    "selection" / AsciiEnumeration({"automatic": "A", "manual": "M"}),
    "fix" / AsciiEnumeration({"none": "1", "fix_2d": "2", "fix_3d": "3"}),
    *(f"satellite{n}" / AsciiInteger(digits=2) for n in range(1, 13)),
    "pdop" / number("", 2),
    "hdop" / number("", 2),
    "vdop" / number("", 2),
    "system" / AsciiText(doc="1 GPS, 2 GLONASS, 3 Galileo, 4 BeiDou"),
    optional=1,
    doc="The satellites in use.",
)
declare(
    "GSV",
    "messages" / AsciiInteger(),
    "number" / AsciiInteger(),
    "in_view" / AsciiInteger(digits=2),
    doc="The satellites in view, in several sentences; `more` holds number, elevation, azimuth and SNR of up to four.",
)
declare(
    "VTG",
    "course" / number("°", 2),
    "course_mark" / AsciiText(),
    "course_magnetic" / number("°", 2),
    "course_magnetic_mark" / AsciiText(),
    "speed" / number("kn", 2),
    "speed_mark" / AsciiText(),
    "speed_kmh" / number("km/h", 2),
    "speed_kmh_mark" / AsciiText(),
    mode(),
    optional=1,
    doc="Course and speed over ground.",
)
declare(
    "GLL",
    *position(),
    time(),
    "status" / AsciiEnumeration(VALIDITY),
    mode(),
    optional=1,
    doc="Position and time.",
)
declare("HDT", "heading" / number("°", 2), "heading_mark" / AsciiText(), doc="True heading.")
declare(
    "ZDA",
    time(),
    "day" / AsciiInteger(digits=2),
    "month" / AsciiInteger(digits=2),
    "year" / AsciiInteger(digits=4),
    "zone_hours" / AsciiInteger(digits=2),
    "zone_minutes" / AsciiInteger(digits=2),
    doc="Date and time.",
)
declare(
    "GST",
    time(),
    "rms" / number("", 1),
    "major" / number("m", 2),
    "minor" / number("m", 2),
    "orientation" / number("°", 1),
    "lat_deviation" / number("m", 2),
    "lon_deviation" / number("m", 2),
    "alt_deviation" / number("m", 2),
    doc="Statistics of the error.",
)
