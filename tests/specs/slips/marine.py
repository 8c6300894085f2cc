"""Single-frame NMEA 2000: priority, group and source in the identifier."""

from __future__ import annotations

from typing import Any

from construct import Byte, Int8sl, Int16sl, Int16ul, Int32sl, Int32ul, Struct

from aces_bus.protocol import BitLayout, Enumeration, Flags, IdField, Protocol, Quantity, bits

marine = Protocol("marine", link="can", bitrate=250_000)
Priority = IdField("priority", range(8))
Source = IdField("source", range(256))


def group(number: int) -> Any:
    return Priority << 26 | number << 8 | Source


Engine = marine.message(
    "Engine",
    id=group(0x1F200),
    extended=True,
    direction="from device",
    payload=Struct(
        "instance" / Byte,
        "speed" / Quantity(Int16ul, unit="rpm", scale=0.25),
        "boost" / Quantity(Int16ul, unit="hPa"),
        "trim" / Quantity(Int8sl, unit="%"),
    ),
    examples=[
        (
            "09F20023#00 40 1F E8 03 FE",
            {"priority": 2, "source": 0x23, "speed": 2000.0, "boost": 1000, "trim": -2},
        )
    ],
)
Attitude = marine.message(
    "Attitude",
    id=group(0x1F119),
    extended=True,
    direction="from device",
    payload=Struct(
        "sequence" / Byte,
        "yaw" / Quantity(Int16sl, unit="rad", scale=1e-4),
        "pitch" / Quantity(Int16sl, unit="rad", scale=1e-4),
        "roll" / Quantity(Int16sl, unit="rad", scale=1e-4),
    ),
)
Wind = marine.message(
    "Wind",
    id=group(0x1FD02),
    extended=True,
    direction="from device",
    payload=BitLayout(
        6,
        "sequence" / bits(8),
        "speed" / Quantity(bits(16), unit="m/s", scale=0.01),
        "angle" / Quantity(bits(16), unit="rad", scale=1e-4),
        "reference" / Enumeration(bits(3), true=0, magnetic=1, apparent=2),
    ),
)
Place = marine.message(
    "Place",
    id=group(0x1F801),
    extended=True,
    direction="from device",
    payload=Struct(
        "latitude" / Quantity(Int32sl, unit="°", scale=1e-7),
        "longitude" / Quantity(Int32sl, unit="°", scale=1e-7),
    ),
)
Depth = marine.message(
    "Depth",
    id=group(0x1F50B),
    extended=True,
    direction="from device",
    payload=Struct(
        "sequence" / Byte,
        "depth" / Quantity(Int32ul, unit="m", scale=0.01),
        "offset" / Quantity(Int16sl, unit="m", scale=0.001),
    ),
    examples=[
        ("0DF50B10#00 E8 03 00 00 9C FF", {"priority": 3, "source": 0x10, "depth": 10.0, "offset": -0.1})
    ],
)
Switches = marine.message(
    "Switches",
    id=group(0x1F20D),
    extended=True,
    direction="to device",
    payload=Struct("instance" / Byte, "on" / Flags(Byte, pump=0, light=1, horn=2)),
    examples=[("19F20D05#01 02", {"priority": 6, "source": 5, "instance": 1})],
)
