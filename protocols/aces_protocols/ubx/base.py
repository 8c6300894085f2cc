"""UBX: the protocol, its packets, and the quantities that several messages have."""

from __future__ import annotations

from typing import Any

from construct import Byte, Int16ul, Int32ul, Struct, this

from aces_bus.protocol import Fletcher, Protocol, Quantity

ubx = Protocol(
    "ubx",
    link="serial",
    baud=38_400,
    doc="u-blox receivers: navigation, sensor fusion, configuration.",
    source="pyubx2 ubxtypes_get.py",
)

#: Raw measurements of a hundred signals fit (RXM-RAWX: 16 + 32 each); the length field would allow 65,543 bytes.
MAX_SIZE = 4096

packet = ubx.framing(
    sync=b"\xb5\x62",
    header=Struct("group" / Byte, "number" / Byte, "length" / Int16ul),
    size=this.length + 8,
    max_size=MAX_SIZE,
    gap=0.5,
    check=Fletcher(),
)


def poll(group: int, number: int, example: str) -> dict[str, Any]:
    """Return what a poll is declared with: the identity of its answer, and no payload."""
    return {
        "direction": "to device",
        "match": {"group": group, "number": number},
        "doc": "Ask for one message.",
        "source": "pyubx2, poll messages",
        "examples": [(example, {})],
    }


ITOW = Quantity(Int32ul, unit="ms", doc="GPS time of week.")
