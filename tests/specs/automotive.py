"""An invented car, typical in all that makes cars hard.

What it asks of the language: a check inside the message that also covers the identifier, or a data id that is not
sent; a rolling counter whose modulus is not a power of two; signals in both bit orders in one message; multiplexed
signals, in a bit layout and in a record.
"""

from __future__ import annotations

from construct import Array, Byte, Int16sl, Int16ul, Int32ul, Struct

from aces_bus.protocol import (
    BitLayout,
    Counter,
    Crc,
    Enumeration,
    Extra,
    Flags,
    IdBytes,
    Multiplexed,
    Protocol,
    Quantity,
    bits,
)

automotive = Protocol("automotive", link="can", bitrate=500_000, doc="Invented, with end-to-end protection.")

WheelSpeeds = automotive.message(
    "WheelSpeeds",
    id=0x1A0,
    payload=BitLayout(
        8,
        "check" / bits(8),
        "counter" / Counter(bits(4), modulo=15),
        "state" / Enumeration(bits(2), off=0, ok=1, degraded=2, failed=3),
        "front_left" / Quantity(bits(12, at=16), scale=0.0625, unit="km/h", unknown=(0xFFF,)),
        "front_right" / Quantity(bits(12), scale=0.0625, unit="km/h", unknown=(0xFFF,)),
        # Motorola order, as other suppliers have it: 12 bits from bit 0 of byte 5, highest first.
        "rear" / Quantity(bits(12, at=40, order="msb"), scale=0.0625, unit="km/h", unknown=(0xFFF,)),
        "slip" / Quantity(bits(8, at=56, signed=True), scale=0.5, unit="%"),
    ),
    check=Crc("CRC8-SAE-J1850", field="check", over=(IdBytes(2, "little"), slice(1, 8))),
    doc="Wheel speeds; the check covers the identifier, low byte first, and all data but itself.",
    source="in the manner of AUTOSAR E2E profile 1",
)

Steering = automotive.message(
    "Steering",
    id=0x0C2,
    payload=Struct(
        "angle" / Quantity(Int16sl, scale=0.1, unit="°", range=(-800, 800)),
        "rate" / Quantity(Int16sl, scale=0.5, unit="°/s"),
        "alive" / Counter(Byte),
        "check" / Byte,
    ),
    check=Crc("CRC8-SAE-J1850", field="check", over=(Extra(), slice(0, 5))),
    check_extra=b"\x2a\x01",
    doc="Steering angle; the check covers a data id that is not sent.",
    source="in the manner of AUTOSAR E2E profile 2",
)

Climate = automotive.message(
    "Climate",
    id=0x3D0,
    payload=BitLayout(
        4,
        "page" / Enumeration(bits(4), temperatures=0, fans=1, faults=5),
        "ignition" / bits(1),
        "inside" / Multiplexed("page", 0, Quantity(bits(10, at=8, signed=True), scale=0.1, unit="°C")),
        "outside" / Multiplexed("page", 0, Quantity(bits(10), scale=0.1, offset=-40, unit="°C")),
        "fan" / Multiplexed("page", 1, Quantity(bits(7, at=8), unit="%", range=(0, 100))),
        "flaps" / Multiplexed("page", (1, 2), Quantity(bits(8, at=16), unit="%")),
        "faults"
        / Multiplexed("page", 5, Flags(bits(16, at=8, order="msb"), sensor=0, compressor=3, leak=15)),
    ),
    doc="Signals by page, over the same bits.",
)

Diagnosis = automotive.message(
    "Diagnosis",
    id=0x6F0,
    payload=Struct(
        "kind" / Enumeration(Byte, odometer=1, voltages=2, build=3),
        "odometer" / Multiplexed("kind", 1, Quantity(Int32ul, scale=0.1, unit="km")),
        "voltages" / Multiplexed("kind", 2, Array(3, Quantity(Int16ul, scale=0.001, unit="V"))),
        "variant" / Multiplexed("kind", 3, Byte),
        "build" / Multiplexed("kind", 3, Int16ul),
    ),
    doc="A record whose length depends on its kind.",
)
