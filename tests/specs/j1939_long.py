"""A part of SAE J1939: parameter groups longer than a frame, to all and to one.

What it asks of the language: sessions under identifiers of their own, packets whose identifier is in them; messages of one
frame beside them.

Source: SAE J1939-21 as can-j1939 2.0.12 carries it out, which sent the sessions of the worked examples; J1939-73 (DM1).
"""

from __future__ import annotations

from construct import Array, Byte, GreedyBytes, GreedyRange, Int16ul, Struct

from aces_bus.protocol import BitLayout, IdField, J1939Transport, Protocol, Quantity, bits, top

j1939_long = Protocol("j1939_long", link="can", bitrate=250_000, doc="Heavy vehicles.", source="SAE J1939")

Priority, Source = IdField("priority", range(8)), IdField("source", range(254))
Destination = IdField("destination", range(256))
long = J1939Transport()

j1939_long.message(
    "VehicleIdentification",
    transport=long,
    id=Priority << 26 | 0xFEEC << 8 | Source,
    extended=True,
    payload=Struct("number" / GreedyBytes),
    doc="The vehicle's number, closed by an asterisk.",
    source="J1939-71, PGN 65260",
    examples=[
        (
            [
                "1CECFF00#20 12 00 03 FF EC FE 00",
                "1CEBFF00#01 31 58 4B 44 44 34 39",
                "1CEBFF00#02 58 30 41 4A 31 32 33",
                "1CEBFF00#03 34 35 36 2A FF FF FF",
            ],
            {"priority": 7, "source": 0, "number": b"1XKDD49X0AJ123456*"},
        )
    ],
)
j1939_long.message(
    "ActiveFaults",
    transport=long,
    id=Priority << 26 | 0xFECA << 8 | Source,
    extended=True,
    payload=Struct(
        "lamps" / Int16ul,
        "faults"
        / GreedyRange(
            BitLayout(
                4,
                "low" / bits(16, at=0),
                "high" / bits(3, at=21),
                "mode" / bits(5, at=16),
                "count" / bits(7, at=24),
                "conversion" / bits(1, at=31),
            )
        ),
    ),
    doc="Faults (DM1), two and more: one alone is a frame with two bytes behind it.",
    source="J1939-73, PGN 65226",
)
j1939_long.message(
    "Proprietary",
    transport=long,
    id=Priority << 26 | 0xEF00 << 8 | Destination << 8 | Source,
    extended=True,
    payload=Struct("data" / GreedyBytes),
    doc="Proprietary A: to one address.",
    source="J1939-21, PGN 61184",
    examples=[
        (
            [
                "1CECF900#10 0A 00 02 FF 00 EF 00",
                "1CEBF900#01 01 02 03 04 05 06 07",
                "1CEBF900#02 08 09 0A FF FF FF FF",
            ],
            {"priority": 7, "source": 0, "destination": 0xF9, "data": bytes(range(1, 11))},
        )
    ],
)
j1939_long.message(
    "EngineTemperature",
    id=Priority << 26 | 0xFEEE << 8 | Source,
    extended=True,
    payload=Struct(
        "coolant" / Quantity(Byte, unit="°C", offset=-40, unknown=top(1)),
        "rest" / Array(7, Byte),
    ),
    doc="One frame beside the packets.",
)
