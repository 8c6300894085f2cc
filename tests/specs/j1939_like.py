"""A part of J1939.

What it asks of the language: an extended identifier of three parts, patterns with more numbers than a table can hold,
one message for whatever the others do not claim, raw values that mean "not available".

Source: the published standard (general knowledge). A parameter group above 0xEFFF is broadcast; below, its low byte
is the destination.
"""

from __future__ import annotations

from construct import Byte, BytesInteger, GreedyBytes, Int16ul, Int32ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, IdField, Protocol, Quantity, Reserved, bits, top

j1939_like = Protocol(
    "j1939_like", link="can", bitrate=250_000, doc="Trucks and tractors.", source="SAE J1939-71"
)

Priority = IdField("priority", range(8))
Source = IdField("source_address", range(256))
Destination = IdField("destination", range(256))

Any = j1939_like.message(
    "ParameterGroup",
    id=Priority << 26 | IdField("pgn", range(1 << 18)) << 8 | Source,
    extended=True,
    payload=Struct("data" / GreedyBytes),
    doc="Any other parameter group; of one below 0xF000 the low byte is the destination.",
    source="J1939-21",
)
Request = j1939_like.message(
    "Request",
    id=Priority << 26 | 0xEA << 16 | Destination << 8 | Source,
    extended=True,
    overrides="ParameterGroup",
    payload=Struct("pgn" / BytesInteger(3, swapped=True)),
    doc="Ask for a parameter group.",
    source="J1939-21",
)
j1939_like.message(
    "EngineController1",
    id=Priority << 26 | 0xF004 << 8 | Source,
    extended=True,
    overrides="ParameterGroup",
    payload=Struct(
        "mode" / BitLayout(1, "torque_mode" / bits(4)),
        "torque_demand" / Quantity(Byte, offset=-125, unit="%", unknown=top(2)),
        "torque" / Quantity(Byte, offset=-125, unit="%", unknown=top(2)),
        "speed" / Quantity(Int16ul, scale=0.125, unit="rpm", unknown=top(2, bits=8)),
        "reserved0" / Reserved(3),
    ),
    doc="Engine speed and torque.",
    source="J1939-71, EEC1",
)
j1939_like.message(
    "VehicleDistance",
    id=Priority << 26 | 0xFEE0 << 8 | Source,
    extended=True,
    overrides="ParameterGroup",
    payload=Struct(
        "trip" / Quantity(Int32ul, scale=0.125, unit="km", unknown=top(2, bits=8)),
        "total" / Quantity(Int32ul, scale=0.125, unit="km", unknown=top(2, bits=8)),
    ),
    doc="Distance travelled.",
    source="J1939-71, VD",
)
j1939_like.message(
    "AddressClaimed",
    id=Priority << 26 | 0xEEFF << 8 | Source,
    extended=True,
    overrides="ParameterGroup",
    payload=BitLayout(
        8,
        "identity" / bits(21),
        "manufacturer" / bits(11),
        "instance" / bits(8),
        "function" / bits(8),
        "system" / bits(7, at=49),
        "system_instance" / bits(4),
        "industry"
        / Enumeration(bits(3), any=0, on_highway=1, agriculture=2, construction=3, marine=4, process=5),
        "arbitrary_address" / bits(1),
    ),
    doc="Who uses this address.",
    source="J1939-81",
)
