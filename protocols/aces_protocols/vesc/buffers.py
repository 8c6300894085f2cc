"""Packets of `vesc_uart` on CAN: taken apart into frames, and put together again.

1. Up to six bytes go in one frame; more in pieces of seven, from offset 259 on of six, and a last frame with the check.
2. A controller has three buffers, and finds the one of a piece by its offset: interleaved senders can mix. So can ours.
3. A packet whose check does not hold is none; one whose length does not clears all buffers.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Iterator, Mapping
from typing import Any

from aces_bus.protocol import Record

#: The longest packet that one frame holds, the sizes of pieces, the first offset that is written in two bytes.
SHORT, NEAR, FAR, FAR_FROM = 6, 7, 6, 259
#: How many packets may be on their way to one receiver.
BUFFERS = 3
#: The longest packet of a controller.
MOST = 512


def check_of(packet: bytes | bytearray) -> bytes:
    """Return the check of a packet: CRC-16/XMODEM, high byte first.

    >>> check_of(b"123456789").hex()
    '31c3'
    """
    return crc_hqx(packet, 0).to_bytes(2, "big")


def can_pieces(
    packet: bytes, *, host: int, receiver: int, mode: int = 0
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the messages that carry a packet to a controller, with their fields; `receiver` is the controller.

    >>> [name for name, fields in can_pieces(bytes(14), host=0xC8, receiver=5)]
    ['FillBuffer', 'FillBuffer', 'LongRequest']
    """
    ends = ("ShortRequest", "LongRequest") if mode != 1 else ("ShortAnswer", "LongAnswer")
    who: Mapping[str, int] = {"host": host, **({"mode": mode} if mode != 1 else {})}
    if len(packet) <= SHORT:
        yield ends[0], {**who, "packet": packet}
        return
    at = 0
    while at < len(packet):
        size, name = (NEAR, "FillBuffer") if at < FAR_FROM else (FAR, "FillBufferFar")
        yield name, {"receiver": receiver, "offset": at, "data": packet[at : at + size]}
        at += size
    yield ends[1], {**who, "length": len(packet), "crc": check_of(packet)}


class Buffers:
    """The buffers of one receiver: `take` each of its records, which gives a packet where one is whole."""

    def __init__(self, receiver: int) -> None:
        self.receiver = receiver
        self._parts: list[bytearray] = []

    def take(self, record: Record) -> bytes | None:
        """Return the packet that a record ends, if it ends one."""
        match type(record).__name__:
            case "ShortRequest" | "ShortAnswer":
                return bytes(record.packet)
            case "FillBuffer" | "FillBufferFar" if record.receiver == self.receiver:
                self._fill(record.offset, record.data)
            case "LongRequest" | "LongAnswer":
                return self._whole(record.length, record.crc)
            case _:
                pass
        return None

    def _fill(self, offset: int, data: bytes) -> None:
        if not offset:
            self._parts = [*self._parts[1 - BUFFERS :], bytearray(data)]
            return
        for part in self._parts:
            if len(part) == offset and offset + len(data) <= MOST:
                part += data
                return

    def _whole(self, length: int, check: bytes) -> bytes | None:
        found = next((part for part in self._parts if len(part) == length), None)
        if found is None:
            self._parts.clear()
            return None
        self._parts.remove(found)
        return bytes(found) if check_of(found) == bytes(check) else None
