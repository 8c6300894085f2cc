"""The transport protocol of SAE J1939-21: 9 to 1785 bytes, to all (BAM) or to one (RTS/CTS).

Facts: TP.CM (PGN EC00) opens a session and steers it, TP.DT (PGN EB00) has a number from 1 on and seven bytes; a data
frame says no PGN, it belongs to the session of its source and destination. Control bytes, fields and times are those of
can-j1939 2.0.12 (`j1939_21.py`).
Choice: data frames may come again and late, as a receiver that misses one asks for it anew. A packet's priority is that of
its TP.CM. A session's frames are judged as a bystander sees them: what steers it (CTS, acknowledgement) is counted apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from ...errors import FieldError
from ..keys import EXTENDED
from .pattern import IdField, IdPattern
from .transport import FrameKind, FrameNumber, FramePart, Transport

#: Everybody: the destination of what is broadcast.
EVERYBODY = 0xFF
#: PDU formats of what opens and steers sessions, and of their data.
CONNECTION, DATA = 0xEC, 0xEB
#: Control bytes of the first one.
RTS, CTS, END, BAM, ABORT = 16, 17, 19, 32, 255
STEERING = {CTS: "clear to send", END: "end of message"}
_ABORTS = {1: "busy", 2: "no resources", 3: "timed out", 4: "clear to send during data"}
#: Parameter groups below this PDU format are sent to one address.
BROADCAST = 0xF0
#: Bytes of a packet; frames of up to 8 are no packets.
LEAST, MOST, PIECE = 9, 1785, 7
#: Between two frames of a broadcast (s): 50 to 200 ms (J1939-21, Tb of can-j1939).
PAUSE_S = 0.05
#: Priority of data frames (J1939-21).
_LOWEST = 7
_OF_CONNECTION, _OF_DATA = (
    IdField("priority", range(8)) << 26
    | number << 16
    | IdField("destination", range(256)) << 8
    | IdField("source", range(256))
    for number in (CONNECTION, DATA)
)


@dataclass(frozen=True)
class J1939Transport(Transport):
    """Parameter groups of more than 8 bytes, by the transport protocol of J1939-21 (ISO 11783-3); shorter ones are frames.

    Messages have the identifier of their parameter group: `id=Priority << 26 | 0xFEEC << 8 | Source`. Let the priority be a
    field: packets have that of the frame that opens them, mostly 7. Devices and twins send packets to all, with pauses of
    50 ms. One to a single address is sent with a handshake (`aces_bus.device.J1939Sender`); `encode` gives its frames as a
    bystander sees them.

    `timeout_s` is that between two frames of a session (T3, 1.25 s).
    """

    title: ClassVar[str] = "J1939 transport"

    fd: bool = field(default=False, init=False, repr=False)
    address: int = field(default=0, init=False, repr=False)
    pad: int | None = field(default=None, init=False, repr=False)
    max_size: int = MOST
    timeout_s: float = 1.25
    kinds: tuple[FrameKind, ...] = field(
        default=(
            FrameKind("first", "broadcast announcement", ((FrameNumber(0), BAM),), 8, least=LEAST, most=MOST),
            FrameKind("first", "request to send", ((FrameNumber(0), RTS),), 8, least=LEAST, most=MOST),
            *(FrameKind("control", name, ((FrameNumber(0), byte),), 8) for byte, name in STEERING.items()),
            FrameKind("next", "data transfer", (), number=FrameNumber(0)),
        ),
        init=False,
        repr=False,
    )
    modulo: int = field(default=256, init=False, repr=False)
    first_number: int = field(default=1, init=False, repr=False)
    any_order: bool = field(default=True, init=False, repr=False)

    @property
    def min_size(self) -> int:
        return 0

    @property
    def patterns(self) -> tuple[tuple[IdPattern, bool], ...]:
        return ((_OF_CONNECTION, True), (_OF_DATA, True))

    def part(self, key: int, data: bytes) -> FramePart:
        """What a frame is: of a parameter group itself, or of a session."""
        group = key >> 16 & 0x3FF
        source, destination = key & 0xFF, key >> 8 & 0xFF
        if group == DATA:
            if len(data) < 2:
                return FramePart("bad", reason="malformed: length")
            return FramePart("next", (source, destination), data[1:], number=data[0])
        if group != CONNECTION:
            return FramePart("single", (source, destination, group), data, key)
        if len(data) < 8:
            return FramePart("bad", reason="malformed: length")
        if data[0] in STEERING:
            return FramePart("control", reason=f"control: {STEERING[data[0]]}")
        if data[0] == ABORT:
            why = _ABORTS.get(data[1], f"reason {data[1]}")
            # Mostly the receiver aborts: of the session that comes the other way.
            return FramePart(
                "abort", (destination, source), reason=f"control: abort, {why}", other=(source, destination)
            )
        if data[0] not in (RTS, BAM) or (data[0] == BAM) != (destination == EVERYBODY):
            return FramePart("bad", reason=f"malformed: no frame of {self.title}")
        size, count = int.from_bytes(data[1:3], "little"), data[3]
        if not LEAST <= size <= MOST or count != -(-size // PIECE):
            return FramePart("bad", reason="malformed: length")
        if size > self.max_size:
            return FramePart("bad", reason="malformed: too long")
        number = int.from_bytes(data[5:8], "little")
        if number >> 8 & 0xFF < BROADCAST:
            number = number & ~0xFF | destination
        packet = key & (EXTENDED | 7 << 26) | (number & 0x3FFFF) << 8 | source
        return FramePart("first", (source, destination), b"", packet, size)

    def refuses(self, key: int) -> str:
        """Packets to one address, to which a receiver's answers belong."""
        to_all = key >> 8 & 0xFF == EVERYBODY
        return "" if to_all else "a packet to one address takes a handshake, which devices do not keep"

    def pause_s(self, key: int) -> float:
        """That of a broadcast."""
        return PAUSE_S

    def in_turn(self, key: int) -> int:
        """A sender's data frames do not say which of its packets to the same address they are of, whatever the priority."""
        return key & ~(7 << 26)

    def split(self, key: int, data: bytes, sequence: int = 0, extra: bytes = b"") -> list[tuple[int, bytes]]:
        """The frames of a packet: one, or those of a session without what the receiver says."""
        if len(data) > self.max_size:
            raise FieldError(f"a packet of {len(data)} bytes; {self.title} has {self.max_size} at most")
        if len(data) < LEAST:
            return [(key, data)]
        number, source = key >> 8 & 0x3FFFF, key & 0xFF
        destination = EVERYBODY
        if number >> 8 & 0xFF < BROADCAST:
            number, destination = number & ~0xFF, number & 0xFF
        pieces = [data[at : at + PIECE] for at in range(0, len(data), PIECE)]
        opening = BAM if destination == EVERYBODY else RTS
        head = (
            bytes([opening])
            + len(data).to_bytes(2, "little")
            + bytes([len(pieces), 0xFF])
            + number.to_bytes(3, "little")
        )
        to = EXTENDED | destination << 8 | source
        frames = [(to | key & 7 << 26 | CONNECTION << 16, head)]
        for index, piece in enumerate(pieces, 1):
            frames.append((to | _LOWEST << 26 | DATA << 16, bytes([index]) + piece.ljust(PIECE, b"\xff")))
        return frames


__all__ = ["J1939Transport"]
