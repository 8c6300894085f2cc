"""NMEA 2000 fast packets: up to 223 bytes in up to 32 frames of one identifier.

Facts: byte 0 of each frame has the packet's sequence number in bits 7–5 and the frame's in bits 4–0; the first frame's
byte 1 is the size. A sender counts the sequence up with each packet of a PGN (canboat, `common/` and its goldens).
Choice: frames may come in any order behind the first, as canboat reads them; one without its first is malformed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from .transport import FrameKind, FrameNumber, Transport

_NUMBER, _SEQUENCE = FrameNumber(0, 0x1F), FrameNumber(0, 0xE0)


@dataclass(frozen=True)
class FastPacket(Transport):
    """NMEA 2000 fast packets: 6 bytes in the first frame, 7 in each other one.

    `timeout_s` is 750 ms between two frames of a packet (as for the transport of ISO 11783, T1). With
    `also=J1939Transport()` the same packets may come by that transport, too, as boats have it; longer ones are sent by it.
    """

    title: ClassVar[str] = "fast packet"

    fd: bool = field(default=False, init=False, repr=False)
    address: int = field(default=0, init=False, repr=False)
    pad: int | None = 0xFF
    max_size: int = 223
    timeout_s: float = 0.75
    also: Transport | None = field(default=None, kw_only=True, repr=False)
    kinds: tuple[FrameKind, ...] = field(
        default=(
            FrameKind(
                "first", "first frame", ((_NUMBER, 0),), 2, size=FrameNumber(1), most=223, sequence=_SEQUENCE
            ),
            FrameKind("next", "next frame", (), number=_NUMBER, sequence=_SEQUENCE),
        ),
        init=False,
        repr=False,
    )
    modulo: int = field(default=32, init=False, repr=False)
    first_number: int = field(default=1, init=False, repr=False)
    any_order: bool = field(default=True, init=False, repr=False)


__all__ = ["FastPacket"]
