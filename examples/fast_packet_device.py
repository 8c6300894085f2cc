"""A wind and position box on NMEA 2000, as a file for `-p`: one fast packet, one with a list, one message of one frame.

    aces decode boat.log -p examples/fast_packet_device.py

Source: the fields of PGN 129029, 129540 and 130306 in canboat's table (shortened); the values are invented.
"""

from __future__ import annotations

from typing import Any

from construct import Array, Byte, Int16sl, Int16ul, Int32sl, Struct, this

from aces_bus.protocol import FastPacket, IdField, Protocol, Quantity, Reserved, top

fast_packet_device = Protocol(
    "fast_packet_device", link="can", bitrate=250_000, doc="A wind and position box.", source="canboat"
)
Source = IdField("source", range(254))
fast = FastPacket()


def group(name: str, number: int, payload: Any, **more: Any) -> None:
    identifier = 3 << 26 | number << 8 | Source
    fast_packet_device.message(name, id=identifier, extended=True, payload=payload, **more)


group(
    "Position",
    129029,
    Struct(
        "sid" / Byte,
        "latitude" / Quantity(Int32sl, unit="°", scale=1e-7),
        "longitude" / Quantity(Int32sl, unit="°", scale=1e-7),
        "satellites" / Quantity(Byte, unknown=top(3)),
    ),
    transport=fast,
    doc="Where the boat is.",
    examples=[
        (
            ["0DF80505#00 0A 01 C0 85 5D 20 40", "0DF80505#01 23 05 06 09 FF FF FF"],
            {"source": 5, "sid": 1, "latitude": 54.3, "longitude": 10.1, "satellites": 9},
        )
    ],
)
Seen = Struct("number" / Byte, "elevation" / Quantity(Int16sl, unit="rad", scale=1e-4))
group(
    "Satellites",
    129540,
    Struct("sid" / Byte, "count" / Byte, "satellites" / Array(this.count, Seen)),
    transport=fast,
    doc="The satellites in view.",
)
group(
    "Wind",
    130306,
    Struct(
        "sid" / Byte,
        "speed" / Quantity(Int16ul, unit="m/s", scale=0.01),
        "angle" / Quantity(Int16ul, unit="rad", scale=1e-4),
        "reference" / Byte,
        "reserved" / Reserved(2),
    ),
    doc="The wind.",
    examples=[("0DFD0205#01 EE 02 E0 2E 02 00 00", {"source": 5, "speed": 7.5, "angle": 1.2})],
)

if __name__ == "__main__":
    encoder = fast_packet_device.variant().encoder
    here = {"source": 5, "latitude": 54.3, "longitude": 10.1, "satellites": 9}
    where, again = (encoder.next("Position", sid=sid, **here) for sid in (1, 2))
    wind = encoder.next("Wind", source=5, sid=1, speed=7.5, angle=1.2, reference=2)
    scanner = fast_packet_device.scanner(include_unknown=True)
    for record in scanner.feed([where[0], wind, where[1], *again[:1]]) + scanner.close():
        print(record, len(record.meta.frames) or 1)
    print(scanner.counts)
