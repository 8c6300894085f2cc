"""The transport protocol of SAE J1939-21: 9 to 1785 bytes, to all (BAM) or to one (RTS/CTS).

Facts: TP.CM (PGN EC00) opens a session and steers it, TP.DT (PGN EB00) has a number from 1 on and seven bytes; a data
frame says no PGN, it belongs to the session of its source and destination. Control bytes, fields and times are those of
can-j1939 2.0.12 (`j1939_21.py`); reasons of an abort from 5 on are those of Linux (`j1939-priv.h`).
Choice: data frames to one address may come again and late, as a receiver that misses one asks for it anew; those of a
broadcast have one order and T1 (0.75 s) between them, or the frames of two broadcasts would become one packet. A packet's
priority is that of its TP.CM. A session's frames are judged as a bystander sees them: what steers it (CTS, acknowledgement)
is counted apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from ...errors import FieldError
from ...frames import EXTENDED
from .handshake import AnswerTimes, GivenUp, Steering
from .pattern import IdField, IdPattern
from .transport import FrameKind, FrameNumber, FramePart, Transport

if TYPE_CHECKING:
    from .message import Message

#: Everybody: the destination of what is broadcast.
EVERYBODY = 0xFF
#: PDU formats of what opens and steers sessions, and of their data.
CONNECTION, DATA = 0xEC, 0xEB
#: Control bytes of the first one.
RTS, CTS, END, BAM, ABORT = 16, 17, 19, 32, 255
STEERING = {CTS: "clear to send", END: "end of message"}
_ABORTS = {
    1: "busy",
    2: "no resources",
    3: "timed out",
    4: "clear to send during data",
    5: "asked too often",
    6: "unexpected data",
    7: "bad number",
    8: "number twice",
    9: "too long",
}
_GIVEN_UP: dict[GivenUp, int] = {
    "busy": 1,
    "overtaken": 2,
    "timed out": 3,
    "asked too often": 5,
    "contradiction": 7,
}
#: Parameter groups below this PDU format are sent to one address.
BROADCAST = 0xF0
#: Bytes of a packet; frames of up to 8 are not packets.
LEAST, MOST, PIECE = 9, 1785, 7
#: Between two frames of a broadcast (s): 50 to 200 ms (J1939-21, Tb of can-j1939).
PAUSE_S = 0.05
#: T4, T2, T1 (s): a sender that was told to wait; a receiver, for the first frame it asked for, and for the next one.
_HOLD_S, _BEGIN_S, _NEXT_S = 1.05, 1.25, 0.75
#: Priority of data frames, and of what steers (J1939-21).
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
    field: packets have that of the frame that opens them, mostly 7. Devices, twins and `PacketSender` send packets to all
    with pauses of 50 ms, and those to one address with the handshake of RTS, CTS and acknowledgement; they answer those that
    come to an address of theirs. `encode` gives their frames as a bystander sees them.

    `timeout_s` is that between two frames of a session, and the sender's for an answer (T3, 1.25 s); between two frames of
    a broadcast it is 0.75 s at most (T1).
    """

    title: ClassVar[str] = "J1939 transport"
    broadcast_gap_s: ClassVar[float] = _NEXT_S

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
        """Return what a frame is: of a parameter group itself, or of a session."""
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
            # Mostly the receiver aborts: of the session that comes the other way.
            why = f"control: abort, {_why_aborted(data)}"
            return FramePart("abort", (destination, source), reason=why, other=(source, destination))
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
        return FramePart("first", (source, destination), b"", packet, size, is_broadcast=data[0] == BAM)

    def pause_s(self, key: int) -> float:
        """Return the pause of a broadcast."""
        return PAUSE_S

    def in_turn(self, key: int) -> int:
        """Return the key without priority: a sender's data frames do not say which packet to an address they
        belong to.
        """
        return key & ~(7 << 26)

    @property
    def answer_times(self) -> AnswerTimes:
        """T3, T4, T2 and T1 of J1939-21."""
        return AnswerTimes(self.timeout_s, _HOLD_S, _BEGIN_S, _NEXT_S)

    def go_ahead(self, key: int, data: bytes, start: int = 1, frames: int = 0) -> tuple[int, bytes] | None:
        """Clear to send: for as many frames as are lacking, and no more than the request to send allows."""
        if not self._is_request(key, data):
            return None
        left = data[3] - start + 1
        head = bytes([CTS, min(frames or left, left, data[4] or 1), start])
        return _back(key), head + b"\xff\xff" + data[5:8]

    def acknowledgement(self, key: int, data: bytes) -> tuple[int, bytes] | None:
        """End of message, of packets to one address."""
        if not self._is_request(key, data):
            return None
        return _back(key), bytes([END]) + data[1:4] + b"\xff" + data[5:8]

    def abort(self, key: int, data: bytes, why: GivenUp, *, by_sender: bool) -> tuple[int, bytes] | None:
        """Return a connection abort, with the reason as a number."""
        if not self._is_request(key, data):
            return None
        to = _back(_back(key)) if by_sender else _back(key)
        return to, bytes([ABORT, _GIVEN_UP[why]]) + b"\xff\xff\xff" + data[5:8]

    def steering(self, key: int, data: bytes) -> Steering | None:
        """Return what a receiver says: clear to send (no frames: wait), end of message, abort."""
        if key >> 16 & 0x3FF != CONNECTION or len(data) < 8:
            return None
        to, of_group = _back(key), ((5, data[5:8]),)
        if data[0] == CTS:
            return Steering("on" if data[1] else "wait", to, data[1], start=data[2], opening=of_group)
        if data[0] == END:
            return Steering("done", to, opening=((1, data[1:4]), *of_group))
        if data[0] == ABORT:
            why = f"its receiver aborted: {_why_aborted(data)}"
            return Steering("stop", to, opening=of_group, reason=why)
        return None

    def is_for(
        self, key: int, data: bytes, message: Message, known: Mapping[str, object], sent: Iterable[Message]
    ) -> bool:
        """Return whether the session's destination is an address of the receiver's own.

        That is the source of what it sends, or the destination of the message, as far as constants or `known` fields say
        them, of messages with a direction: a packet to an address that may be another's is not let go on.
        """
        if not super().is_for(key, data, message, known, sent):
            return False
        own = {
            _byte_of(carried.identifier, 0, known)
            for carried in sent
            if carried.extended and carried.direction is not None
        }
        if message.direction is not None and message.identifier.constant >> 16 & 0xFF < BROADCAST:
            own.add(_byte_of(message.identifier, 8, known))
        return key >> 8 & 0xFF in own

    def _is_request(self, key: int, data: bytes) -> bool:
        """Return whether a frame opens a packet to one address."""
        return self.part(key, data).role == "first" and data[0] == RTS

    def split(self, key: int, data: bytes, sequence: int = 0, extra: bytes = b"") -> list[tuple[int, bytes]]:
        """Return the frames of a packet: one, or those of a session without what the receiver says."""
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


def _back(key: int) -> int:
    """Return the key of a connection frame that goes the other way."""
    return EXTENDED | _LOWEST << 26 | CONNECTION << 16 | (key & 0xFF) << 8 | key >> 8 & 0xFF


def _byte_of(pattern: IdPattern, shift: int, known: Mapping[str, object]) -> int | None:
    """Return the byte of an identifier from bit `shift` on; None where a field in it is not known."""
    number, mask = pattern.constant, 0xFF << shift
    for capture in pattern.captures:
        if capture.bits << capture.shift & mask:
            value = known.get(capture.name)
            if not isinstance(value, int):
                return None
            number += value << capture.shift
    return (number & mask) >> shift


def _why_aborted(data: bytes) -> str:
    return _ABORTS.get(data[1], f"reason {data[1]}")


__all__ = ["J1939Transport"]
