"""Byte stuffing: how a framing keeps its marks out of the data.

1. `stuff` and `unstuff` are inverse; `unstuff` raises `ValueError` for bytes that `stuff` cannot have made, so that a
   packet has one form on the wire and survives a round trip.
"""

from __future__ import annotations

import msgspec


class Stuffing:
    """Turns data into the bytes on the wire, and back."""

    #: Whether header and check are on the wire as they are, and only what is between is stuffed.
    is_inside = False

    @property
    def describe(self) -> str:
        """Kind of stuffing, in words for people."""
        return f"stuffed ({type(self).__name__})"

    def stuff(self, data: bytes) -> bytes:
        raise NotImplementedError

    def unstuff(self, wire: bytes) -> bytes:
        """Return the data; raises `ValueError` when no data gives these bytes."""
        raise NotImplementedError

    def largest(self, size: int) -> int:
        """Return how many bytes `size` bytes of data may become."""
        raise NotImplementedError


class Insert(Stuffing, msgspec.Struct, frozen=True):
    """After each `pattern` in the data one byte `byte` is inserted (Dynamixel 2: FF FF FD → FF FF FD FD)."""

    pattern: bytes
    byte: bytes
    is_inside = True

    def stuff(self, data: bytes) -> bytes:
        return data.replace(self.pattern, self.pattern + self.byte)

    def unstuff(self, wire: bytes) -> bytes:
        data = wire.replace(self.pattern + self.byte, self.pattern)
        if self.pattern in wire and self.stuff(data) != wire:
            raise ValueError("stuffing")
        return data

    def largest(self, size: int) -> int:
        return size + size // len(self.pattern)


class CutZeros(Stuffing, msgspec.Struct, frozen=True):
    """Zeros at the end of the data are not sent, but for the first `least` bytes (MAVLink 2).

    Who reads gives them back up to the size of the message's own fields (`Framing.logical`), whether they were cut or not.
    """

    least: int = 1
    is_inside = True

    @property
    def describe(self) -> str:
        return "without the zeros at the end of the data"

    def stuff(self, data: bytes) -> bytes:
        return data[: self.least] + data[self.least :].rstrip(b"\0")

    def unstuff(self, wire: bytes) -> bytes:
        return wire

    def largest(self, size: int) -> int:
        return size


class Slip(Stuffing, msgspec.Struct, frozen=True):
    """SLIP (RFC 1055): C0 ends a packet; C0 in the data is DB DC, DB is DB DD."""

    def stuff(self, data: bytes) -> bytes:
        return data.replace(b"\xdb", b"\xdb\xdd").replace(b"\xc0", b"\xdb\xdc")

    def unstuff(self, wire: bytes) -> bytes:
        data = wire.replace(b"\xdb\xdc", b"\xc0").replace(b"\xdb\xdd", b"\xdb")
        if b"\xdb" in wire and self.stuff(data) != wire:
            raise ValueError("SLIP escape")
        return data

    def largest(self, size: int) -> int:
        return 2 * size


class Cobs(Stuffing, msgspec.Struct, frozen=True):
    """COBS: no zero byte inside; each block is led by 1 + its length, 255 meaning 254 bytes and no zero behind them."""

    def stuff(self, data: bytes) -> bytes:
        out = bytearray()
        blocks = data.split(b"\0")
        for number, block in enumerate(blocks):
            last = number == len(blocks) - 1
            while len(block) >= 254:
                out += b"\xff" + block[:254]
                block = block[254:]
                if not block and last:
                    return bytes(out)
            out += bytes([len(block) + 1]) + block
        return bytes(out)

    def unstuff(self, wire: bytes) -> bytes:
        out = bytearray()
        at = 0
        while at < len(wire):
            code = wire[at]
            block = wire[at + 1 : at + code]
            if code == 0 or len(block) != code - 1:
                raise ValueError("COBS block")
            out += block
            at += code
            if code < 255 and at < len(wire):
                out.append(0)
        data = bytes(out)
        if self.stuff(data) != wire:
            raise ValueError("COBS block")
        return data

    def largest(self, size: int) -> int:
        return size + size // 254 + 1
