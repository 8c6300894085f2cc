"""Where the receiver is, when, and by which satellites: NAV."""

from __future__ import annotations

from construct import (
    Array,
    Byte,
    Construct,
    Int8sl,
    Int16sl,
    Int16ul,
    Int32sl,
    Int32ul,
    Rebuild,
    Struct,
    len_,
    this,
)

from aces_bus.protocol import BitLayout, Enumeration, Flags, Quantity, Reserved, bits

from .base import ITOW, packet, poll


def _degrees(scale: float) -> Quantity:
    return Quantity(Int32sl, scale=scale, unit="°")


def mm(field: Construct = Int32sl) -> Quantity:
    return Quantity(field, unit="mm")


def mm_s(field: Construct = Int32sl) -> Quantity:
    return Quantity(field, unit="mm/s")


FIX = {"none": 0, "dead_reckoning": 1, "fix_2d": 2, "fix_3d": 3, "gnss_and_dead_reckoning": 4, "time_only": 5}

#: How the phase of the carrier is used (RTK).
CARRIER = {"none": 0, "float": 1, "fixed": 2}

packet(
    "NavPvt",
    direction="from device",
    match={"group": 0x01, "number": 0x07},
    payload=Struct(
        "itow" / ITOW,
        "year" / Int16ul,
        "month" / Byte,
        "day" / Byte,
        "hour" / Byte,
        "minute" / Byte,
        "second" / Byte,
        "valid" / Flags(Byte, date=0, time=1, fully_resolved=2, magnetic=3),
        "time_accuracy" / Quantity(Int32ul, unit="ns"),
        "nano" / Quantity(Int32sl, unit="ns", doc="Fraction of the second; can be negative."),
        "fix" / Enumeration(Byte, FIX),
        "flags"
        / BitLayout(
            1,
            "fix_ok" / bits(1),
            "differential" / bits(1),
            "power_save" / bits(3),
            "heading_valid" / bits(1),
            "carrier" / Enumeration(bits(2), CARRIER),
        ),
        "flags2" / Flags(Byte, confirmed_available=5, confirmed_date=6, confirmed_time=7),
        "satellites" / Byte,
        "lon" / _degrees(1e-7),
        "lat" / _degrees(1e-7),
        "height" / mm(),
        "height_msl" / mm(),
        "horizontal_accuracy" / mm(Int32ul),
        "vertical_accuracy" / mm(Int32ul),
        "velocity_north" / mm_s(),
        "velocity_east" / mm_s(),
        "velocity_down" / mm_s(),
        "ground_speed" / mm_s(),
        "heading_of_motion" / _degrees(1e-5),
        "speed_accuracy" / mm_s(Int32ul),
        "heading_accuracy" / Quantity(Int32ul, scale=1e-5, unit="°"),
        "pdop" / Quantity(Int16ul, scale=0.01),
        "flags3"
        / BitLayout(
            2,
            "invalid_position" / bits(1),
            "correction_age" / bits(4),
            "authenticated_time" / bits(1, at=13),
            "authenticated_message" / bits(1, at=14),
        ),
        "reserved0" / Reserved(4),
        "heading_of_vehicle" / _degrees(1e-5),
        "magnetic_declination" / Quantity(Int16sl, scale=0.01, unit="°"),
        "magnetic_accuracy" / Quantity(Int16ul, scale=0.01, unit="°"),
    ),
    doc="Position, velocity and time.",
    source="pyubx2, NAV-PVT",
    examples=[
        (
            "B5 62 01 07 5C 00 00 CA 5B 07 E8 07 03 0F 0A 11 24 37 19 00 00 00 2E FB FF FF 03 01 E0 0E 80 77 8E 06 00 38 9C"
            "1C 40 EF 07 00 78 3F 07 00 DC 05 00 00 98 08 00 00 64 00 00 00 CE FF FF FF 0A 00 00 00 70 00 00 00 F4 88 28 00"
            "2C 01 00 00 60 E3 16 00 78 00 00 00 00 00 00 00 00 00 00 00 FA 00 32 00 A0 D5",
            {
                "itow": 123_456_000,
                "year": 2024,
                "month": 3,
                "day": 15,
                "hour": 10,
                "minute": 17,
                "second": 36,
                "nano": -1234,
                "fix": "fix_3d",
                "lat": 48.0,
                "lon": 11.0,
                "satellites": 14,
                "height": 520_000,
                "height_msl": 475_000,
                "horizontal_accuracy": 1500,
                "vertical_accuracy": 2200,
                "velocity_north": 100,
                "velocity_east": -50,
                "velocity_down": 10,
                "ground_speed": 112,
                "heading_of_motion": 26.565,
                "speed_accuracy": 300,
                "pdop": 1.2,
                "magnetic_declination": 2.5,
                "magnetic_accuracy": 0.5,
            },
        )
    ],
)
packet("NavPvtPoll", **poll(0x01, 0x07, "B5 62 01 07 00 00 08 19"))

packet(
    "NavStatus",
    direction="from device",
    match={"group": 0x01, "number": 0x03},
    payload=Struct(
        "itow" / ITOW,
        "fix" / Enumeration(Byte, FIX),
        "flags" / Flags(Byte, fix_ok=0, differential=1, week_set=2, time_of_week_set=3),
        "fix_status"
        / BitLayout(1, "corrections" / bits(1), "carrier_valid" / bits(1), "map_matching" / bits(2, at=6)),
        "flags2"
        / BitLayout(
            1,
            "power_save" / bits(2),
            "spoofing" / Enumeration(bits(2, at=3), unknown=0, none=1, indicated=2, multiple=3),
            "carrier" / Enumeration(bits(2, at=6), CARRIER),
        ),
        "time_to_first_fix" / Quantity(Int32ul, unit="ms"),
        "uptime" / Quantity(Int32ul, unit="ms"),
    ),
    doc="State of the navigation.",
    source="pyubx2, NAV-STATUS",
    examples=[
        (
            "B5 62 01 03 10 00 00 CA 5B 07 03 DD 00 08 90 65 00 00 40 42 0F 00 AE AA",
            {
                "fix": "fix_3d",
                "time_to_first_fix": 26_000,
                "uptime": 1_000_000,
                "flags2": {"power_save": 0, "spoofing": "none", "carrier": "none", "reserved": 0},
            },
        )
    ],
)
packet("NavStatusPoll", **poll(0x01, 0x03, "B5 62 01 03 00 00 04 0D"))

packet(
    "NavRelPosNed",
    direction="from device",
    match={"group": 0x01, "number": 0x3C},
    payload=Struct(
        "version" / Byte,
        "reserved0" / Reserved(1),
        "station" / Int16ul,
        "itow" / ITOW,
        "position" / Array(3, Quantity(Int32sl, unit="cm", doc="North, east, down.")),
        "distance" / Quantity(Int32sl, unit="cm"),
        "heading" / _degrees(1e-5),
        "reserved1" / Reserved(4),
        "position_fine" / Array(3, Quantity(Int8sl, scale=0.1, unit="mm", doc="To be added to position.")),
        "distance_fine" / Quantity(Int8sl, scale=0.1, unit="mm"),
        "position_accuracy" / Array(3, Quantity(Int32ul, scale=0.1, unit="mm")),
        "distance_accuracy" / Quantity(Int32ul, scale=0.1, unit="mm"),
        "heading_accuracy" / Quantity(Int32ul, scale=1e-5, unit="°"),
        "reserved2" / Reserved(4),
        "flags"
        / BitLayout(
            4,
            "fix_ok" / bits(1),
            "differential" / bits(1),
            "position_valid" / bits(1),
            "carrier" / Enumeration(bits(2), CARRIER),
            "is_moving" / bits(1),
            "base_position_missing" / bits(1),
            "base_measurements_missing" / bits(1),
            "heading_valid" / bits(1),
            "normalised" / bits(1),
        ),
    ),
    doc="Position relative to a base station.",
    source="pyubx2, NAV-RELPOSNED",
    examples=[
        (
            "B5 62 01 3C 40 00 01 00 07 00 00 CA 5B 07 7B 00 00 00 D3 FF FF FF 06 00 00 00 83 00 00 00 6F A5 06 02 00 00 00"
            "00 00 00 00 00 64 00 00 00 5F 00 00 00 C8 00 00 00 64 00 00 00 4F C3 00 00 00 00 00 00 15 01 00 00 B8 C4",
            {
                "station": 7,
                "position": [123, -45, 6],
                "distance": 131,
                "heading": 339.89999,
                "position_accuracy": [10.0, 9.5, 20.0],
                "heading_accuracy": 0.49999,
            },
        )
    ],
)
packet("NavRelPosNedPoll", **poll(0x01, 0x3C, "B5 62 01 3C 00 00 3D B8"))

packet(
    "NavPosLlh",
    direction="from device",
    match={"group": 0x01, "number": 0x02},
    payload=Struct(
        "itow" / ITOW,
        "lon" / _degrees(1e-7),
        "lat" / _degrees(1e-7),
        "height" / mm(),
        "height_msl" / mm(),
        "horizontal_accuracy" / mm(Int32ul),
        "vertical_accuracy" / mm(Int32ul),
    ),
    doc="Position alone, as receivers before NavPvt have it.",
    source="pyubx2, NAV-POSLLH",
    examples=[
        (
            "B5 62 01 02 1C 00 00 CA 5B 07 80 77 8E 06 00 C8 63 E3 40 EF 07 00 78 3F 07 00 DC 05 00 00 98 08 00 00 59 9E",
            {"lon": 11.0, "lat": -48.0, "height": 520_000, "height_msl": 475_000, "vertical_accuracy": 2200},
        )
    ],
)
packet("NavPosLlhPoll", **poll(0x01, 0x02, "B5 62 01 02 00 00 03 0A"))

packet(
    "NavVelNed",
    direction="from device",
    match={"group": 0x01, "number": 0x12},
    payload=Struct(
        "itow" / ITOW,
        "velocity" / Array(3, Quantity(Int32sl, unit="cm/s", doc="North, east, down.")),
        "speed" / Quantity(Int32ul, unit="cm/s"),
        "ground_speed" / Quantity(Int32ul, unit="cm/s"),
        "heading_of_motion" / _degrees(1e-5),
        "speed_accuracy" / Quantity(Int32ul, unit="cm/s"),
        "heading_accuracy" / Quantity(Int32ul, scale=1e-5, unit="°"),
    ),
    doc="Velocity alone, as receivers before NavPvt have it.",
    source="pyubx2, NAV-VELNED",
    examples=[
        (
            "B5 62 01 12 24 00 00 CA 5B 07 0A 00 00 00 FB FF FF FF 01 00 00 00 0B 00 00 00 0B 00 00 00 0B C8 FC 01 03 00 00"
            "00 F0 49 02 00 8A 97",
            {"velocity": [10, -5, 1], "speed": 11, "heading_of_motion": 333.43499, "heading_accuracy": 1.5},
        )
    ],
)
packet("NavVelNedPoll", **poll(0x01, 0x12, "B5 62 01 12 00 00 13 3A"))

packet(
    "NavDop",
    direction="from device",
    match={"group": 0x01, "number": 0x04},
    payload=Struct(
        "itow" / ITOW,
        *(
            name / Quantity(Int16ul, scale=0.01)
            for name in ("gdop", "pdop", "tdop", "vdop", "hdop", "ndop", "edop")
        ),
    ),
    doc="How well the satellites are spread: dilution of precision.",
    source="pyubx2, NAV-DOP",
    examples=[
        (
            "B5 62 01 04 12 00 00 CA 5B 07 A0 00 78 00 5A 00 64 00 46 00 32 00 31 00 C2 27",
            {"gdop": 1.6, "pdop": 1.2, "tdop": 0.9, "vdop": 1.0, "hdop": 0.7, "ndop": 0.5, "edop": 0.49},
        )
    ],
)
packet("NavDopPoll", **poll(0x01, 0x04, "B5 62 01 04 00 00 05 10"))

packet(
    "NavTimeUtc",
    direction="from device",
    match={"group": 0x01, "number": 0x21},
    payload=Struct(
        "itow" / ITOW,
        "time_accuracy" / Quantity(Int32ul, unit="ns"),
        "nano" / Quantity(Int32sl, unit="ns", doc="Fraction of the second; can be negative."),
        "year" / Int16ul,
        "month" / Byte,
        "day" / Byte,
        "hour" / Byte,
        "minute" / Byte,
        "second" / Byte,
        "valid"
        / BitLayout(
            1,
            "time_of_week" / bits(1),
            "week" / bits(1),
            "utc" / bits(1),
            "authenticated" / bits(1),
            "standard" / bits(4),
        ),
    ),
    doc="Time alone.",
    source="pyubx2, NAV-TIMEUTC",
    examples=[
        (
            "B5 62 01 21 14 00 00 CA 5B 07 19 00 00 00 2E FB FF FF E8 07 03 0F 0A 11 24 37 19 B8",
            {"year": 2024, "second": 36, "nano": -1234, "time_accuracy": 25},
        )
    ],
)
packet("NavTimeUtcPoll", **poll(0x01, 0x21, "B5 62 01 21 00 00 22 67"))

packet(
    "NavSat",
    direction="from device",
    match={"group": 0x01, "number": 0x35},
    payload=Struct(
        "itow" / ITOW,
        "version" / Byte,
        "count" / Rebuild(Byte, len_(this.satellites)),
        "reserved0" / Reserved(2),
        "satellites"
        / Array(
            this.count,
            Struct(
                "system"
                / Enumeration(Byte, gps=0, sbas=1, galileo=2, beidou=3, imes=4, qzss=5, glonass=6, navic=7),
                "satellite" / Byte,
                "signal" / Quantity(Byte, unit="dB", doc="Carrier to noise density, over 1 Hz."),
                "elevation" / Quantity(Int8sl, unit="°"),
                "azimuth" / Quantity(Int16sl, unit="°"),
                "residual" / Quantity(Int16sl, scale=0.1, unit="m"),
                "state"
                / BitLayout(
                    4,
                    "quality" / bits(3),
                    "used" / bits(1),
                    "health" / Enumeration(bits(2), unknown=0, healthy=1, unhealthy=2),
                    "differential" / bits(1),
                    "smoothed" / bits(1),
                    "orbit_source" / bits(3),
                ),
            ),
        ),
    ),
    doc="The satellites that are received or expected.",
    source="pyubx2, NAV-SAT",
    examples=[
        (
            "B5 62 01 35 20 00 00 CA 5B 07 01 02 00 00 00 17 29 3F 89 00 F5 FF 1F 09 00 00 06 FF 00 FB 2D 01 00 00 20 00 00"
            "00 F7 F5",
            {"version": 1, "count": 2},
        )
    ],
)
packet("NavSatPoll", **poll(0x01, 0x35, "B5 62 01 35 00 00 36 A3"))
