"""Frames to packets: what a scanner puts in front of its look-up where a transport carries messages.

1. Each frame comes out once: in a packet, or lost with a reason. Until then it is kept, and counted as pending.
2. What is kept is bounded: `senders` packets of `max_size` bytes.
3. An acknowledged packet (`_Conversation`) with a fault stays, without frames, until its end: what follows is not a message.
4. The rule is that of `declare.transport.Transport`; `reference` carries it out once more, on whole inputs.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from typing import Any, NamedTuple

from ...frames import AnyFrame, ChannelName
from ..declare.transport import FramePart, Transport


class CarriedFrame(NamedTuple):
    """A frame under way: itself, its number in what was fed, its data, its time."""

    frame: AnyFrame
    number: int
    data: bytes
    time: float | None


class Packet(NamedTuple):
    """A whole packet and the frames that it came in; where `reason` is given, only frames, that are lost."""

    frames: list[CarriedFrame]
    reason: str
    key: int = 0
    data: bytes = b""


class _Open:
    """A packet under way."""

    __slots__ = ("data", "frames", "gap_s", "part", "pieces", "room", "total")

    def __init__(self, part: FramePart, frame: CarriedFrame, room: int, gap_s: float) -> None:
        self.part, self.room, self.gap_s = part, room, gap_s
        self.frames = [frame]
        #: The pieces behind the first frame's by their place, from 1 on.
        self.pieces: dict[int, bytes] = {}
        #: How many frames it has; 0 where only the last one says so.
        self.total = 0
        if part.size is not None and room > 0:
            self.total = 1 + max(0, -(-(part.size - len(part.data)) // room))

    @property
    def time(self) -> float | None:
        """When its last frame came."""
        return self.frames[-1].time

    @property
    def due(self) -> int:
        """The place of the first frame that is not there, from 0 on."""
        place = 1
        while place in self.pieces:
            place += 1
        return place

    def named(self, place: int) -> str:
        """Return a frame by its place, as people count."""
        return f"frame {place + 1} of {self.total}" if self.total else f"frame {place + 1}"

    def why(self, reason: str) -> str:
        """Say why it is given up: frames that came without one before them say more than the occasion."""
        due = self.due
        is_gap = any(place > due for place in self.pieces)
        return f"malformed: {self.named(due)} missing" if is_gap else f"malformed: {reason}"

    def joined(self) -> bytes:
        data = self.part.data + b"".join(self.pieces[place] for place in sorted(self.pieces))
        return data if self.part.size is None else data[: self.part.size]


#: What a frame may be to an acknowledged packet that is under way.
_SPOKEN = ("next", "ready", "taken", "end")
#: Why a packet is given up by a frame that ends it.
_ENDS: dict[str, str] = {"abort": "aborted", "over": "over"}


class _Conversation:
    """An acknowledged packet under way; or lost, without frames, until its session's end."""

    __slots__ = ("block", "count", "data", "frames", "gap_s", "is_lost", "parts", "time", "total")

    def __init__(self, part: FramePart, frame: CarriedFrame, room: int, gap_s: float) -> None:
        self.frames, self.parts, self.time, self.gap_s = [frame], [part], frame.time, gap_s
        self.is_lost = False
        #: The packet's bytes that the receiver has taken, and in how many next frames they came.
        self.data, self.count = bytearray(part.data), 0
        #: The pieces of this block by their numbers.
        self.block: dict[int, bytes] = {}
        #: How many frames have data, the first and the last one among them; 0 where no size is given.
        self.total = 0
        if part.size is not None:
            self.total = 2 + max(1, -(-(part.size - len(part.data)) // room))

    def lose(self) -> None:
        """Take it for lost from now on."""
        self.is_lost, self.frames = True, []
        self.parts = [FramePart("ready", self.parts[0].session, is_acknowledged=True)]
        self.data, self.block = bytearray(), {}

    def fault(self, part: FramePart, transport: Transport) -> str:
        """Take one more frame's part; what is wrong with the packet then."""
        role, block = part.role, self.block
        if role == "next" and self.parts[-1].role == "taken":
            del self.parts[1:]  # of the block before nothing is asked any more
        self.parts.append(part)
        if role == "ready":
            return "restarted" if block or self.count else ""
        if role == "next":
            if part.number in block:
                return f"{self.named(part.number)} twice"
            block[part.number] = part.data
        elif role == "taken":
            for number in range(1, part.number + 1):
                if number not in block:
                    return f"{self.named(number)} missing"
                self.data += block[number]
            self.count += part.number
            block.clear()
        else:
            del self.data[len(self.data) - part.number :]
            if self.parts[0].size not in (None, len(self.data)):
                return "length"
            if len(self.data) > transport.longest:
                return "too long"
            self.data += part.data
        return "too long" if len(self.frames) > transport.most_frames else ""

    def named(self, number: int) -> str:
        """Return a frame of this block by its number, as people count."""
        return f"frame {1 + self.count + number}" + (f" of {self.total}" if self.total else "")

    def why(self, reason: str) -> str:
        """Say why it is given up."""
        if reason == "over":
            reason = "acknowledgement missing" if self.block else f"{self.named(1)} missing"
        return f"malformed: {reason}"


class Reassembler:
    """Makes packets of the frames of one transport; no I/O, no clock."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self._open: dict[Hashable, _Open | _Conversation] = {}
        #: Frames that are in packets under way.
        self.pending = 0

    def take(
        self, frame: Any, number: int, key: int, data: bytes, channel: Any, time: float | None
    ) -> list[Packet]:
        """Take one more frame of the transport, and return what it decides; `key` is without the flag of CAN FD."""
        transport = self.transport
        out: list[Packet] = []
        part = self._within(key, data, channel, time, out) if transport.has_conversations else None
        if part is None:
            part = transport.part(key, data)
        mine = CarriedFrame(frame, number, data, time)
        role = part.role
        if role in ("bad", "control"):
            out.append(Packet([mine], part.reason))
            return out
        who = (channel, part.session)
        if role == "abort" and who not in self._open:
            who = (channel, part.other)
        found = self._open.get(who)
        if found is not None and self._is_late(found, time):
            out += self._give_up(who, found.why("timed out"))
            found = None
        # With a reason the frame opens a packet that is refused: what was under way before has ended.
        if isinstance(found, _Conversation) and role in _SPOKEN and not part.reason:
            out += self._spoken(who, found, part, mine)
            return out
        if role == "next":
            if isinstance(found, _Open):
                out += self._next(who, found, part, mine)
            else:
                out.append(Packet([mine], "malformed: no first frame"))
            return out
        if found is not None:
            out += self._give_up(who, found.why(_ENDS.get(role, "restarted")))
        if role in ("single", "first"):
            other = self._open.get((channel, part.other)) if part.other is not None else None
            if other is not None:
                out += self._give_up((channel, part.other), other.why("restarted"))
        if role in ("single", "abort", "over"):
            out.append(Packet([mine], part.reason, part.key, part.data))
        elif role == "first":
            out += self._first(who, part, mine)
        else:
            out.append(Packet([mine], part.reason or "malformed: no first frame"))
            lost = _Conversation(part, mine, 1, transport.timeout_s)
            lost.lose()
            out += self._opened(who, lost)
        return out

    def _within(
        self, key: int, data: bytes, channel: ChannelName, time: float | None, out: list[Packet]
    ) -> FramePart | None:
        """Return what a frame is to an acknowledged packet that is under way."""
        for session in self.transport.conversations(key):
            found = self._open.get((channel, session))
            if not isinstance(found, _Conversation):
                continue
            if self._is_late(found, time):
                out += self._give_up((channel, session), found.why("timed out"))
                continue
            part = self.transport.within(found.parts, key, data)
            if part is not None:
                return part
        return None

    def _is_late(self, found: _Open | _Conversation, time: float | None) -> bool:
        last = found.time
        return last is not None and time is not None and time - last > found.gap_s

    def _opened(self, who: Hashable, made: _Open | _Conversation) -> Iterator[Packet]:
        """Add a packet that is under way."""
        if len(self._open) >= self.transport.senders:
            yield from self._give_up(next(iter(self._open)), "malformed: too many senders at once")
        self._open[who] = made
        self.pending += len(made.frames)

    def _spoken(
        self, who: Hashable, found: _Conversation, part: FramePart, mine: CarriedFrame
    ) -> Iterator[Packet]:
        """Take one more frame of an acknowledged packet."""
        if found.is_lost:
            found.time = mine.time
            yield Packet([mine], "malformed: no first frame")
        elif found.parts[-1].role == part.role and found.frames[-1].data == mine.data:
            yield Packet([mine], "malformed: repeated")
        else:
            found.frames.append(mine)
            found.time = mine.time
            self.pending += 1
            fault = found.fault(part, self.transport)
            if fault:
                self.pending -= len(found.frames)
                yield Packet(found.frames, f"malformed: {fault}")
                found.lose()
            elif part.role == "end":
                del self._open[who]
                self.pending -= len(found.frames)
                yield Packet(found.frames, "", found.parts[0].key, bytes(found.data))

    def _first(self, who: Hashable, part: FramePart, mine: CarriedFrame) -> Iterator[Packet]:
        room, gap_s = self.transport.room(len(mine.data)), self.transport.gap_s(part)
        if part.is_acknowledged:
            yield from self._opened(who, _Conversation(part, mine, room, gap_s))
            return
        made = _Open(part, mine, room, gap_s)
        if part.is_last or (part.size is not None and made.total == 1):
            yield Packet(made.frames, "", part.key, made.joined())
            return
        if len(mine.data) not in self.transport.full_lengths:
            yield Packet([mine], "malformed: first frame is short")
            return
        yield from self._opened(who, made)

    def _next(self, who: Hashable, found: _Open, part: FramePart, mine: CarriedFrame) -> Iterator[Packet]:
        transport, pieces = self.transport, found.pieces
        if transport.any_order and not found.part.is_broadcast:
            place = (part.number - transport.first_number) % transport.modulo + 1
            is_repeated = place in pieces and pieces[place] == part.data
            is_wrong = found.total > 0 and place >= found.total
        else:
            due = len(pieces) + 1
            before = (transport.first_number + due - 2) % transport.modulo
            is_repeated = due > 1 and part.number == before and mine.data == found.frames[-1].data
            place, is_wrong = due, part.number != (transport.first_number + due - 1) % transport.modulo
        if is_repeated:
            yield Packet([mine], "malformed: repeated")
            return
        self.pending += 1
        found.frames.append(mine)
        if is_wrong or place in pieces:
            how = "twice" if place in pieces else "missing" if place == found.due else "beyond its end"
            yield from self._give_up(who, f"malformed: {found.named(place)} {how}")
            return
        pieces[place] = part.data
        is_last = part.is_last or (found.total > 0 and place == found.total - 1)
        so_far = len(found.part.data) + found.room * place
        least = found.part.size - so_far + found.room if found.part.size is not None and is_last else 0
        if len(part.data) < least or (not is_last and len(part.data) != found.room):
            yield from self._give_up(who, f"malformed: {found.named(place)} is short")
        elif is_last and not part.is_last and len(part.data) > least and transport.following.last is not None:
            yield from self._give_up(who, f"malformed: {found.named(place)} is too long")
        elif (
            found.part.size is None
            and len(found.part.data) + sum(map(len, pieces.values())) > transport.longest + transport.overhead
        ):
            yield from self._give_up(who, "malformed: too long")
        elif is_last if not found.total else len(pieces) == found.total - 1:
            del self._open[who]
            self.pending -= len(found.frames)
            yield Packet(found.frames, "", found.part.key, found.joined())

    def _give_up(self, who: Hashable, reason: str) -> list[Packet]:
        """Return the frames of a packet that is given up; none of one that is lost already."""
        lost = self._open.pop(who)
        self.pending -= len(lost.frames)
        return [Packet(lost.frames, reason)] if lost.frames else []

    def idle(self, time: float | None) -> list[Packet]:
        """Give up the packets under way that are out of time at `time` (None: all, nothing follows); return them."""
        late = [
            (who, found) for who, found in self._open.items() if time is None or self._is_late(found, time)
        ]
        return [packet for who, found in late for packet in self._give_up(who, found.why("timed out"))]

    def close(self) -> list[Packet]:
        """End the input; return the frames of packets under way, which stay pending."""
        return [packet for who in list(self._open) for packet in self._give_up(who, "pending")]

    @property
    def is_idle(self) -> bool:
        """True if no packet is under way, and no session is lost."""
        return not self._open

    def missing(self, channel: str | int | None, session: Hashable) -> list[int]:
        """Return the places of the frames that a packet under way lacks; of one of unknown size all that may follow."""
        found = self._open.get((channel, session))
        if not isinstance(found, _Open):
            return []
        end = found.total or found.due + self.transport.longest
        return [place for place in range(found.due, end) if place not in found.pieces]

    def under_way(self) -> list[CarriedFrame]:
        """Return the frames of packets under way."""
        return [frame for found in self._open.values() for frame in found.frames]

    def reset(self) -> None:
        """Forget everything."""
        self._open.clear()
        self.pending = 0
