"""The slow truth about transports: which frames are one packet, asked anew of all its frames with every frame.

1. Nothing here is shared with the scanner's reassembly except the declaration (`declare.transport`).
2. What frames are is a function of the frames of one session since its first one (`judge_frames`); only the bound on packets
   under way looks at more.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

from ...frames import EXTENDED, AnyFrame, ChannelName
from .packet import can_image
from .transport import FramePart, Transport


@dataclass(frozen=True)
class GivenFrame:
    """A frame of a transport: the frame, its number, its data and what it is."""

    frame: AnyFrame
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
    """Return what these frames are, of which the first one is a first frame and the others follow it."""
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
    for step, frame in enumerate(given[1:], 1):
        number = frame.part.number
        place = step
        if _is_any_order(transport, first):
            place = next(k for k in range(1, transport.modulo + 1) if _number(transport, k) == number)
            if place in pieces:
                return Judged("broken", f"malformed: {_named(place, count)} twice")
            if count is not None and place >= count:
                return Judged("broken", f"malformed: {_named(place, count)} beyond its end")
        elif _number(transport, place) != number:
            return Judged("broken", f"malformed: {_named(place, count)} missing")
        pieces[place] = frame.part
        ends = frame.part.is_last or place + 1 == count
        if not ends and len(frame.part.data) != full:
            return Judged("broken", f"malformed: {_named(place, count)} is short")
        if ends and first.size is not None:
            left = first.size - len(first.data) - (place - 1) * full
            if len(frame.part.data) < left:
                return Judged("broken", f"malformed: {_named(place, count)} is short")
            goes_on = transport.following.last is not None and not frame.part.is_last
            if goes_on and len(frame.part.data) > left:
                return Judged("broken", f"malformed: {_named(place, count)} is too long")
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


def judge_conversation(transport: Transport, given: Sequence[GivenFrame]) -> Judged:
    """Return what the frames of an acknowledged packet are, of which the first one is a first frame."""
    parts = [frame.part for frame in given]
    first, size = parts[0], parts[0].size
    taken: list[bytes] = []
    begin = 1  # where the present block begins
    for place, part in enumerate(parts):
        block = {earlier.number: earlier for earlier in parts[begin:place] if earlier.role == "next"}

        if part.role == "ready" and (block or taken):
            return Judged("broken", "malformed: restarted")
        if part.role == "next" and part.number in block:
            return Judged(
                "broken", f"malformed: {_named_data(transport, first, len(taken) + part.number)} twice"
            )
        if part.role == "taken":
            missing = [number for number in range(1, part.number + 1) if number not in block]
            if missing:
                lacks = _named_data(transport, first, len(taken) + missing[0])
                return Judged("broken", f"malformed: {lacks} missing")
            taken += [block[number].data for number in range(1, part.number + 1)]
            begin = place + 1
        if part.role == "end":
            whole = first.data + b"".join(taken)
            data = whole[: len(whole) - part.number]
            if size is not None and size != len(data):
                return Judged("broken", "malformed: length")
            if len(data) > transport.longest:
                return Judged("broken", "malformed: too long")
            return Judged("whole", data=data + part.data)
    if len(given) > transport.most_frames:
        return Judged("broken", "malformed: too long")
    return Judged("under way")


def conversation_given_up(transport: Transport, given: Sequence[GivenFrame]) -> str:
    """Say why an acknowledged packet is given up whose receiver says that it is over."""
    roles = [frame.part.role for frame in given]
    if roles[-1] == "next" or "next" in roles[_last_place(roles, "taken") :]:
        return "malformed: acknowledgement missing"
    taken = sum(frame.part.number for frame in given if frame.part.role == "taken")
    return f"malformed: {_named_data(transport, given[0].part, taken + 1)} missing"


def _last_place(roles: Sequence[str], role: str) -> int:
    return max((place for place, known in enumerate(roles) if known == role), default=0)


def _named_data(transport: Transport, first: FramePart, number: int) -> str:
    """Name a frame with data by its number (the first is 0): `frame 2 of 5`; without a size `frame 2`."""
    if first.size is None:
        return f"frame {number + 1}"
    left = first.size - len(first.data)
    following = -(-left // transport.room(transport.frame_size))
    return f"frame {number + 1} of {2 + max(1, following)}"  # with the first frame, and the one that ends the packet


def is_repeated(transport: Transport, given: Sequence[GivenFrame], more: GivenFrame) -> bool:
    """Return whether a following frame is one that has come already."""
    if given[0].part.is_acknowledged:
        return (given[-1].part.role, given[-1].data) == (more.part.role, more.data)
    if _is_any_order(transport, given[0].part):
        known = [frame.part for frame in given[1:] if frame.part.number == more.part.number]
        return any(part.data == more.part.data for part in known)
    return len(given) > 1 and given[-1].part.number == more.part.number and given[-1].data == more.data


def given_up(transport: Transport, given: Sequence[GivenFrame], reason: str) -> str:
    """Say why frames that are not a whole packet are given up."""
    first = given[0].part
    if _is_any_order(transport, first):
        full = transport.room(len(given[0].data))
        count = None if first.size is None else 1 + -(-(first.size - len(first.data)) // full)
        there = {frame.part.number for frame in given[1:]}
        for place in range(1, len(there) + 1):
            if _number(transport, place) not in there:
                return f"malformed: {_named(place, count)} missing"
    return f"malformed: {reason}"


def _is_any_order(transport: Transport, first: FramePart) -> bool:
    return transport.any_order and not first.is_broadcast


def _number(transport: Transport, place: int) -> int:
    return (transport.first_number + place - 1) % transport.modulo


def _named(place: int, count: int | None) -> str:
    return f"frame {place + 1} of {count}" if count is not None else f"frame {place + 1}"


def _cut(data: bytes, size: int | None) -> bytes:
    return data if size is None else data[:size]


def packet_image(transport: Transport, decided: DecidedFrames, extra: bytes) -> bytes | None:
    """Return the image of a packet that `message.struct` parses; None where its check is wrong. `extra` seeds the check."""
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
    """Return the packet of an image; `last` is the frame that made it whole."""
    word = int.from_bytes(image[:4], "big")
    return CarriedPacket(word & 0x1FFF_FFFF, image[5:], bool(word & EXTENDED), last.timestamp, last.channel)


@dataclass(eq=False)
class _Session:
    """The frames of a sender that belong together: a packet under way, or the last frame of a session that is lost."""

    #: Channel, and the session as the transport names it.
    who: Hashable
    frames: list[GivenFrame]

    @property
    def first(self) -> FramePart:
        return self.frames[0].part

    @property
    def is_lost(self) -> bool:
        """True if nothing is known of the packet: its frames have been given already."""
        return self.first.role != "first"

    def lose(self, last: GivenFrame) -> None:
        """Forget all frames; keep when the last one came."""
        part = FramePart("ready", last.part.session, is_acknowledged=True)
        self.frames = [GivenFrame(last.frame, last.number, last.data, part)]


class PacketRule:
    """The rule of one transport, frame by frame."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        #: Sessions in the order in which they began.
        self.open: list[_Session] = []

    def decide(self, frame: Any, number: int, key: int, data: bytes) -> list[DecidedFrames]:
        """Return what one more frame decides."""
        decided: list[DecidedFrames] = []
        for name in self.transport.conversations(key):
            session = self._session((frame.channel, name))
            if session is not None and session.first.is_acknowledged and self._is_late(session, frame):
                decided += self._lost(session, "timed out")
        part = self._within(frame.channel, key, data) or self.transport.part(key, data)
        mine = GivenFrame(frame, number, data, part)
        if part.role in ("bad", "control"):
            return [*decided, DecidedFrames((mine,), part.reason)]
        who = (frame.channel, part.session)
        if part.role == "abort" and self._session(who) is None:
            who = (frame.channel, part.other)
        before = self._session(who)
        if before is not None and self._is_late(before, frame):
            decided += self._lost(before, "timed out")
            before = None
        if part.role in ("next", "ready", "taken", "end"):
            return decided + self._followed(who, before, mine)
        if before is not None and part.role == "over" and not before.is_lost:
            self.open.remove(before)
            why = conversation_given_up(self.transport, before.frames)
            decided.append(DecidedFrames(tuple(before.frames), why))
        elif before is not None:
            decided += self._lost(before, "aborted" if part.role == "abort" else "restarted")
        if part.role in ("single", "first") and part.other is not None:
            beside = self._session((frame.channel, part.other))
            decided += self._lost(beside, "restarted") if beside is not None else []
        if part.role == "first":
            return decided + self._ended(_Session(who, [mine]))
        return [*decided, DecidedFrames((mine,), part.reason, part.key, part.data)]

    def _session(self, who: Hashable) -> _Session | None:
        return next((session for session in self.open if session.who == who), None)

    def _within(self, channel: ChannelName, key: int, data: bytes) -> FramePart | None:
        """Return what a frame is to an acknowledged packet that is under way, or lost."""
        for name in self.transport.conversations(key):
            session = self._session((channel, name))
            if session is not None and session.first.is_acknowledged:
                part = self.transport.within([frame.part for frame in session.frames], key, data)
                if part is not None:
                    return part
        return None

    def _followed(self, who: Hashable, before: _Session | None, mine: GivenFrame) -> list[DecidedFrames]:
        """Return what a frame decides that does not begin a packet; `before` is its session."""
        orphan = DecidedFrames((mine,), mine.part.reason or "malformed: no first frame")
        # With a reason the frame opens a packet that is refused.
        is_spoken = before is not None and before.first.is_acknowledged and not mine.part.reason
        if mine.part.role != "next" and not is_spoken:
            decided = self._lost(before, "restarted") if before is not None else []
            lost = _Session(who, [])
            lost.lose(mine)
            return [*decided, orphan, *self._enter(lost)]
        if before is None:
            return [orphan]
        if before.is_lost:
            before.lose(mine)
            return [orphan]
        if is_repeated(self.transport, before.frames, mine):
            return [DecidedFrames((mine,), "malformed: repeated")]
        before.frames.append(mine)
        return self._ended(before)

    def _ended(self, session: _Session) -> list[DecidedFrames]:
        """Return the packet that the frames of a session are, or why they are none; nothing while it is under way."""
        first, frames = session.first, session.frames
        judge = judge_conversation if first.is_acknowledged else judge_frames
        judged = judge(self.transport, frames)
        if judged.state == "under way":
            return self._enter(session) if len(frames) == 1 else []
        decided = DecidedFrames(tuple(frames), judged.reason, first.key, judged.data)
        if first.is_acknowledged and judged.state == "broken":
            session.lose(frames[-1])
        else:
            self.open = [other for other in self.open if other is not session]
        return [decided]

    def _enter(self, session: _Session) -> list[DecidedFrames]:
        """Add a session; where there are too many, give up the oldest and return its frames."""
        full = len(self.open) == self.transport.senders
        decided = self._lost(self.open[0], "too many senders at once", whole=True) if full else []
        self.open.append(session)
        return decided

    def _lost(self, session: _Session, reason: str, whole: bool = False) -> list[DecidedFrames]:
        """Give up a session; return its frames, but none of a session that is lost already."""
        self.open.remove(session)
        if session.is_lost:
            return []
        is_acknowledged = whole or session.first.is_acknowledged
        why = f"malformed: {reason}" if is_acknowledged else given_up(self.transport, session.frames, reason)
        return [DecidedFrames(tuple(session.frames), why)]

    def _is_late(self, session: _Session, frame: AnyFrame) -> bool:
        last, now = session.frames[-1].frame.timestamp, frame.timestamp
        return last is not None and now is not None and now - last > self.transport.gap_s(session.first)

    def end(self) -> list[DecidedFrames]:
        """End the input; return the frames that are pending."""
        left, self.open = self.open, []
        return [DecidedFrames(tuple(session.frames), "pending") for session in left if not session.is_lost]
