"""Packets without their framing, as CAN carries them.

1. What is framed here is what a UART would have carried: one spec reads both.
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import Any, Literal

from aces_bus import Unknown

from .spec import long, short, vesc_uart

#: From here on a packet has two bytes of length.
LONG_FROM = 256


def framed(packet: bytes) -> bytes:
    """Return a packet as a UART has it.

    >>> framed(b"\\x04").hex(" ")
    '02 01 04 40 84 03'
    """
    size = len(packet)
    head = short.sync + bytes((size,)) if size < LONG_FROM else long.sync + size.to_bytes(2, "big")
    return head + packet + crc_hqx(packet, 0).to_bytes(2, "big") + b"\x03"


def packet_of(message: str, **fields: Any) -> bytes:
    """Return the packet of a message. Raises `FieldError` as encoders do.

    >>> packet_of("GetSelected", mask=0x81C0).hex(" ")
    '32 00 00 81 c0'
    """
    packet: bytes = vesc_uart.encode(message, **fields)
    return packet[2:-3] if packet.startswith(short.sync) else packet[3:-3]


class PacketReader:
    """Reads packets that go one way: `read` gives the record, or None for what is unknown."""

    def __init__(self, direction: Literal["to device", "from device"]) -> None:
        self._scanner = vesc_uart.scanner(direction=direction)

    def read(self, packet: bytes) -> Any:
        """Return the record of a packet."""
        found = [record for record in self._scanner.feed(framed(packet)) if not isinstance(record, Unknown)]
        return found[0] if found else None
