"""The slow truth about transports: which frames are one packet, asked anew of all its frames with every frame.

1. Nothing here is shared with the scanner's reassembly except the declaration (`declare.transport`).
2. What frames are is a function of the frames of one session since its first one (`judge_frames`); only the bound on packets
   under way looks at more.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

from ..keys import EXTENDED
from .packet import can_image
from .transport import FramePart, Transport


@dataclass(frozen=True)
class GivenFrame:
    """A frame of a transport: the frame, its number, its data and what it is."""

    frame: Any
    number: int
    data: bytes
    part: FramePart


@dataclass(frozen=True)
class DecidedFrames:
    """Frames about which there is nothing more to say: a packet, or with a reason frames that are lost."""

    frames: tuple[GivenFrame, ...]
    reason: str = ""
    key: int = 0
    data: bytes = b""


@dataclass(frozen=True)
class Judged:
    """What frames of a session are so far: `under way`, `whole` with the packet's bytes, or broken with a reason."""

    state: str
    reason: str = ""
    data: bytes = b""


def judge_frames(transport: Transport, given: Sequence[GivenFrame]) -> Judged:
    """What these frames are, of which the first one is a first frame and the others follow it."""
    first = given[0].part
    full = transport.room(len(given[0].data))
    count = None
    if first.size is not None and full > 0:
        missing = first.size - len(first.data)
        count = 1 if missing <= 0 else 1 + (missing + full - 1) // full
    if first.is_last or count == 1:
        return Judged("whole", data=_cut(first.data, first.size))
    if len(given[0].data) not in transport.lengths():
        return Judged("broken", "malformed: first frame is short")
    pieces: dict[int, FramePart] = {}
    for step, one in enumerate(given[1:], 1):
        number = one.part.number
        place = step
        if transport.any_order:
            place = next(k for k in range(1, transport.modulo + 1) if _number(transport, k) == number)
            if place in pieces:
                return Judged("broken", f"malformed: {_named(place, count)} twice")
            if count is not None and place >= count:
                return Judged("broken", f"malformed: {_named(place, count)} beyond its end")
        elif _number(transport, place) != number:
            return Judged("broken", f"malformed: {_named(place, count)} missing")
        pieces[place] = one.part
        ends = one.part.is_last or place + 1 == count
        if not ends and len(one.part.data) != full:
            return Judged("broken", f"malformed: {_named(place, count)} is short")
        if ends and first.size is not None:
            if len(one.part.data) < first.size - len(first.data) - (place - 1) * full:
                return Judged("broken", f"malformed: {_named(place, count)} is short")
        if (
            first.size is None
            and len(first.data) + sum(len(p.data) for p in pieces.values())
            > transport.longest + transport.overhead
        ):
            return Judged("broken", "malformed: too long")
        is_whole = len(pieces) + 1 == count if count is not None else ends
        if is_whole:
            data = first.data + b"".join(pieces[place].data for place in sorted(pieces))
            return Judged("whole", data=_cut(data, first.size))
    return Judged("under way")


def is_repeated(transport: Transport, given: Sequence[GivenFrame], more: GivenFrame) -> bool:
    """Whether a following frame is one that has come already."""
    if transport.any_order:
        known = [one.part for one in given[1:] if one.part.number == more.part.number]
        return any(part.data == more.part.data for part in known)
    return len(given) > 1 and given[-1].part.number == more.part.number and given[-1].data == more.data


def given_up(transport: Transport, given: Sequence[GivenFrame], reason: str) -> str:
    """Why frames that are not a whole packet are given up."""
    if transport.any_order:
        first = given[0].part
        full = transport.room(len(given[0].data))
        count = None if first.size is None else 1 + -(-(first.size - len(first.data)) // full)
        there = {one.part.number for one in given[1:]}
        for place in range(1, len(there) + 1):
            if _number(transport, place) not in there:
                return f"malformed: {_named(place, count)} missing"
    return f"malformed: {reason}"


def _number(transport: Transport, place: int) -> int:
    return (transport.first_number + place - 1) % transport.modulo


def _named(place: int, count: int | None) -> str:
    return f"frame {place + 1} of {count}" if count is not None else f"frame {place + 1}"


def _cut(data: bytes, size: int | None) -> bytes:
    return data if size is None else data[:size]


def packet_image(transport: Transport, decided: DecidedFrames, extra: bytes) -> bytes | None:
    """The image of a packet that `message.struct` parses; None where its check is wrong. `extra` seeds the check."""
    data: bytes | None = decided.data
    if len(decided.frames) > 1:
        data = transport.unwrapped(decided.data, extra)
    number = decided.key & 0x1FFF_FFFF
    return None if data is None else can_image(number, data, extended=bool(decided.key & EXTENDED))


@dataclass(frozen=True)
class CarriedPacket:
    """A whole packet with the attributes of a frame, for those who look at frames."""

    arbitration_id: int
    data: bytes
    is_extended_id: bool
    timestamp: float | None
    channel: str | None
    is_remote_frame: bool = False
    is_error_frame: bool = False
    is_fd: bool = False


def packet_frame(image: bytes, last: Any) -> CarriedPacket:
    """The packet of an image; `last` is the frame that made it whole."""
    word = int.from_bytes(image[:4], "big")
    return CarriedPacket(word & 0x1FFF_FFFF, image[5:], bool(word & EXTENDED), last.timestamp, last.channel)


class PacketRule:
    """The rule of one transport, frame by frame."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self.open: list[tuple[Hashable, list[GivenFrame]]] = []

    def decide(self, frame: Any, number: int, key: int, data: bytes) -> list[DecidedFrames]:
        """What one more frame decides."""
        part = self.transport.part(key, data)
        mine = GivenFrame(frame, number, data, part)
        if part.role in ("bad", "control"):
            return [DecidedFrames((mine,), part.reason)]
        who = (frame.channel, part.session)
        if part.role == "abort" and all(one[0] != who for one in self.open):
            who = (frame.channel, part.other)
        decided: list[DecidedFrames] = []
        before = next((one for one in self.open if one[0] == who), None)
        if before is not None and self._is_late(before[1][-1].frame.timestamp, frame.timestamp):
            decided.append(self._lost(before, "timed out"))
            before = None
        if part.role != "next" and before is not None:
            decided.append(self._lost(before, "aborted" if part.role == "abort" else "restarted"))
        if part.role == "abort":
            decided.append(DecidedFrames((mine,), part.reason, part.key, part.data))
        elif part.role == "single":
            decided.append(DecidedFrames((mine,), "", part.key, part.data))
        elif part.role == "first":
            decided += self._ended((who, [mine]))
        elif before is None:
            decided.append(DecidedFrames((mine,), "malformed: no first frame"))
        elif is_repeated(self.transport, before[1], mine):
            decided.append(DecidedFrames((mine,), "malformed: repeated"))
        else:
            before[1].append(mine)
            decided += self._ended(before)
        return decided

    def _ended(self, one: tuple[Hashable, list[GivenFrame]]) -> list[DecidedFrames]:
        """What frames are, if they are anything yet."""
        found = judge_frames(self.transport, one[1])
        if found.state != "under way":
            self.open = [other for other in self.open if other is not one]
            return [DecidedFrames(tuple(one[1]), found.reason, one[1][0].part.key, found.data)]
        decided: list[DecidedFrames] = []
        if len(one[1]) == 1:
            if len(self.open) == self.transport.senders:
                oldest = self.open.pop(0)
                decided.append(DecidedFrames(tuple(oldest[1]), "malformed: too many senders at once"))
            self.open.append(one)
        return decided

    def _lost(self, one: tuple[Hashable, list[GivenFrame]], reason: str) -> DecidedFrames:
        self.open.remove(one)
        return DecidedFrames(tuple(one[1]), given_up(self.transport, one[1], reason))

    def _is_late(self, last: float | None, time: float | None) -> bool:
        return last is not None and time is not None and time - last > self.transport.timeout_s

    def end(self) -> list[DecidedFrames]:
        """The frames that are pending at the end of the input."""
        left, self.open = self.open, []
        return [DecidedFrames(tuple(frames), "pending") for _, frames in left]
