"""Transfers with a tail byte: DroneCAN (UAVCAN v0) and Cyphal/CAN (UAVCAN v1).

Facts: the last byte of each frame has start of transfer (bit 7), end of transfer (bit 6), a toggle (bit 5) and the
transfer's number (bits 4–0). In v0 the toggle begins at 0 and a CRC-16/CCITT-FALSE is in front of a transfer of several
frames, little-endian, seeded by the type's signature; in v1 the toggle begins at 1, and the CRC is behind, big-endian,
without a seed (dronecan 1.0.27 `transport.py`; pycyphal 1.27.1 `transport/can/_session/`; Cyphal specification §4.2).
Choice: the zeros that fill up a frame of CAN FD are part of the transfer and of its message, for nothing in it says how many
they are. A spec ends with `Reserved(n)` where its fields alone are not a length that there is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import ClassVar, Literal

from ...errors import FieldError, SpecError
from ...frames import FD_LENGTHS
from .checks import Crc
from .place import caller
from .transport import AddedCheck, FrameKind, FrameNumber, Transport

_START, _END, _TOGGLE, _NUMBER = (FrameNumber(-1, mask) for mask in (0x80, 0x40, 0x20, 0x1F))
_CRC_BYTES = 2


@cache
def _added(version: int) -> AddedCheck:
    """Return CRC-16/CCITT-FALSE, by its other name; made when the first transfer needs it."""
    return AddedCheck(Crc("CRC16-IBM-3740", order="big" if version else "little"), is_in_front=not version)


@cache
def _crc() -> Callable[[bytes], int]:
    return _added(0).crc.engine


def _kinds(toggle: int) -> tuple[FrameKind, ...]:
    begins = ((_START, 1), (_TOGGLE, toggle))
    return (
        FrameKind("single", "single frame", (*begins, (_END, 1)), 0, 1, sequence=_NUMBER),
        FrameKind("first", "first frame", (*begins, (_END, 0)), 0, 1, sequence=_NUMBER),
        FrameKind("next", "next frame", ((_START, 0),), 0, 1, number=_TOGGLE, sequence=_NUMBER, last=_END),
    )


@dataclass(frozen=True)
class TailByte(Transport):
    """Transfers of DroneCAN (`version=0`) and Cyphal/CAN (`version=1`).

    `timeout_s` is 2 s between two frames, as usual in both. Of DroneCAN a message's `check_extra` is the signature of its
    type, 8 bytes with the lowest first; without it no transfer of several frames is right. With `fd` a message has a length
    that fills frames: it ends with `Reserved(n)`, or takes the zeros as `GreedyBytes`.
    """

    title: ClassVar[str] = "tail-byte transfer"

    timeout_s: float = 2.0
    version: Literal[0, 1] = 1
    address: int = field(default=0, init=False, repr=False)
    pad: int | None = field(default=None, init=False, repr=False)
    any_order: bool = field(default=False, init=False, repr=False)
    kinds: tuple[FrameKind, ...] = field(default=(), init=False, repr=False)
    modulo: int = field(default=2, init=False, repr=False)
    first_number: int = field(default=0, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.version not in (0, 1):
            raise SpecError(f"{caller()}: version is 0 (DroneCAN) or 1 (Cyphal), not {self.version!r}")
        object.__setattr__(self, "kinds", _kinds(self.version))
        object.__setattr__(self, "first_number", 1 - self.version)
        super().__post_init__()

    @property
    def overhead(self) -> int:
        return _CRC_BYTES

    @property
    def added_check(self) -> AddedCheck:
        return _added(self.version)

    def unwrapped(self, data: bytes, extra: bytes) -> bytes | None:
        """Return a transfer without its check; None where that is wrong."""
        if len(data) < _CRC_BYTES:
            return None
        if self.version:
            data, check = data[:-_CRC_BYTES], int.from_bytes(data[-_CRC_BYTES:], "big")
            return data if _crc()(data) == check else None
        check, data = int.from_bytes(data[:_CRC_BYTES], "little"), data[_CRC_BYTES:]
        return data if _crc()(extra + data) == check else None

    def carries(self, size: int) -> bool:
        """Return whether a transfer may have `size` bytes: in CAN FD its last frame must have a length that exists."""
        return not self.fd or self._last(size) + 1 in FD_LENGTHS

    def _last(self, size: int) -> int:
        """Return how many bytes of a transfer, with its check, are in its last frame."""
        room = self.frame_size - 1
        return size if size <= room else (size + _CRC_BYTES - 1) % room + 1

    def numbered_by(self, key: int) -> int:
        """Return the key that transfers are counted by: whatever their priority."""
        return key & ~(0x7 << 26 if self.version else 0x1F << 24)

    def split(self, key: int, data: bytes, sequence: int = 0, extra: bytes = b"") -> list[tuple[int, bytes]]:
        """Return the frames of a transfer; `sequence` is its number."""
        if len(data) > self.max_size or not self.carries(len(data)):
            raise FieldError(f"a packet of {len(data)} bytes, which {self.title} does not carry")
        room = self.frame_size - 1
        if len(data) > room:
            check = _crc()(data if self.version else extra + data)
            data = data + check.to_bytes(2, "big") if self.version else check.to_bytes(2, "little") + data
        pieces = [data[at : at + room] for at in range(0, max(1, len(data)), room)]
        last = len(pieces) - 1
        return [
            (
                key,
                piece
                + bytes([(not n) << 7 | (n == last) << 6 | (n + self.version & 1) << 5 | sequence & 0x1F]),
            )
            for n, piece in enumerate(pieces)
        ]


__all__ = ["TailByte"]
