"""A part of NMEA 2000: fast packets beside messages of one frame.

What it asks of the language: packets whose frames come in any order, several of one sender at once, an identifier whose
parts are fields.

Source: the fields of the three parameter groups as canboat's table describes them; the bytes are our own.
"""

from __future__ import annotations

from construct import Array, Byte, Int16ul, Int32sl, Int64sl, Struct, this

from aces_bus.protocol import FastPacket, IdField, J1939Transport, Protocol, Quantity, Reserved

nmea2000_like = Protocol(
    "nmea2000_like", link="can", bitrate=250_000, doc="Instruments of boats.", source="canboat, pgns/"
)

Priority = IdField("priority", range(8))
Source = IdField("source", range(254))
fast = FastPacket(also=J1939Transport())

nmea2000_like.message(
    "Position",
    transport=fast,
    id=Priority << 26 | 129029 << 8 | Source,
    extended=True,
    payload=Struct(
        "sid" / Byte,
        "date" / Int16ul,
        "latitude" / Quantity(Int64sl, unit="°", scale=1e-16),
        "longitude" / Quantity(Int64sl, unit="°", scale=1e-16),
        "satellites" / Byte,
    ),
    doc="Where the boat is.",
    examples=[
        (
            [
                "0DF80505#00 14 07 10 4F 00 00 20",
                "0DF80505#01 2C 5F F6 1C 06 00 00",
                "0DF80505#02 9C F8 04 87 FE FE 08",
            ],
            {"priority": 3, "source": 5, "sid": 7, "date": 20240, "satellites": 8},
        )
    ],
)
nmea2000_like.message(
    "Satellites",
    transport=fast,
    id=Priority << 26 | 129540 << 8 | Source,
    extended=True,
    payload=Struct(
        "sid" / Byte,
        "count" / Byte,
        "satellites"
        / Array(this.count, Struct("number" / Byte, "elevation" / Quantity(Int32sl, unit="rad", scale=1e-4))),
    ),
    doc="Satellites in view.",
    examples=[
        (
            ["0DFA0405#00 02 AA 00 FF FF FF FF"],
            {"priority": 3, "source": 5, "sid": 170, "count": 0, "satellites": []},
        ),
    ],
)
nmea2000_like.message(
    "Wind",
    id=Priority << 26 | 130306 << 8 | Source,
    extended=True,
    payload=Struct(
        "sid" / Byte,
        "speed" / Quantity(Int16ul, unit="m/s", scale=0.01),
        "angle" / Quantity(Int16ul, unit="rad", scale=1e-4),
        "reference" / Byte,
        "reserved" / Reserved(2),
    ),
    doc="Wind, in one frame.",
    examples=[("09FD0205#01 10 27 10 27 02 00 00", {"source": 5, "speed": 100.0, "angle": 1.0})],
)
