"""Other framings beside their usual libraries: `make bench-framings`, or `python -m tests.bench.framings`.

Streams are repeated worked examples, fed in chunks of 4096 bytes; fields are parsed
on both sides. pymavlink computes its CRC in C when `fastcrc` is installed, which it asks for.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import partial
from typing import Any

from aces_bus.protocol import Protocol
from aces_protocols.nmea0183.spec import nmea0183
from aces_protocols.ubx.spec import ubx
from tests.bench.rows import fastest, optional
from tests.specs.cases import MAVLINK1
from tests.specs.mavlink1 import mavlink1

CHUNK = 4096


def worked(protocol: Protocol, *names: str) -> bytes:
    """The first worked example of each of these messages."""
    return b"".join(protocol[name].examples[0].packet.data for name in names)


SPECS = {protocol.name: protocol for protocol in (mavlink1, nmea0183, ubx)}
#: spec, target as a ratio, stream
STREAMS: dict[str, tuple[str, float, bytes]] = {
    "UBX: NAV-PVT, NAV-STATUS, ACK": ("ubx", 20, worked(ubx, *["NavPvt"] * 4, "NavStatus", "Ack") * 200),
    "MAVLink 1: ATTITUDE": ("mavlink1", 6, MAVLINK1[1].data * 20_000),
    "NMEA 0183: seven sentences": (
        "nmea0183",
        8,
        worked(nmea0183, "GGA", "RMC", "GSA", "GSV", "VTG", "GLL", "HDT") * 150,
    ),
}


def ours(name: str, data: bytes) -> int:
    """How many records the scanner finds."""
    scanner = SPECS[name].scanner(direction="both" if name == "mavlink1" else "from device")
    return sum(len(scanner.feed(data[at : at + CHUNK])) for at in range(0, len(data), CHUNK))


def peer(name: str, data: bytes) -> Callable[[], int] | None:
    """The same through the library that people use, or None where it is not installed."""
    if name == "mavlink1":
        common = optional("pymavlink.dialects.v10.common")
        if common is None:
            return None

        def mavlink() -> int:
            parser = common.MAVLink(None)
            parser.robust_parsing = True
            return sum(
                len(parser.parse_buffer(data[at : at + CHUNK]) or ()) for at in range(0, len(data), CHUNK)
            )

        return mavlink
    module = optional("pyubx2" if name == "ubx" else "pynmeagps")
    if module is None:
        return None
    reader: Any = module.UBXReader if name == "ubx" else module.NMEAReader
    options = {"protfilter": module.UBX_PROTOCOL} if name == "ubx" else {}
    return lambda: sum(1 for _ in reader(io.BytesIO(data), **options))


def main() -> None:
    """Print a line a framing: MB/s of both, their ratio, the target."""
    for title, (name, target, data) in STREAMS.items():
        other = peer(name, data)
        contenders: dict[str, Callable[[], object]] = {"aces": partial(ours, name, data)}
        if other is not None:
            contenders["peer"] = other
        best = {
            who: len(data) / seconds / 1e6
            for who, seconds in fastest(contenders, rounds=7, one_thread=True).items()
        }
        line = f"{title:32} aces {best['aces']:6.2f} MB/s"
        if other is not None:
            ratio = best["aces"] / best["peer"]
            line += f"  peer {best['peer']:6.3f} MB/s  {ratio:5.1f} ×  (target ≥ {target:g} ×)"
        else:
            line += "  (its library is not installed: pip install 'aces-bus[bench]')"
        print(line, flush=True)


if __name__ == "__main__":
    main()
