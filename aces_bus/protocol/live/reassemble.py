"""Frames to packets: what a scanner puts in front of its look-up where a transport carries messages.

1. Each frame comes out once: in a packet, or lost with a reason. Until then it is kept, and counted as pending.
2. What is kept is bounded: `senders` packets of `max_size` bytes.
3. The rule is that of `declare.transport.Transport`; `reference` carries it out once more, on whole inputs.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from typing import Any, NamedTuple

from ..declare.transport import FramePart, Transport


class CarriedFrame(NamedTuple):
    """A frame under way: itself, its number in what was fed, its data, its time."""

    frame: Any
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

    __slots__ = ("data", "frames", "part", "pieces", "room", "total")

    def __init__(self, part: FramePart, frame: CarriedFrame, room: int) -> None:
        self.part, self.room = part, room
        self.frames = [frame]
        #: The pieces behind the first frame's by their place, from 1 on.
        self.pieces: dict[int, bytes] = {}
        #: How many frames it has; 0 where only the last one says so.
        self.total = 0
        if part.size is not None and room > 0:
            self.total = 1 + max(0, -(-(part.size - len(part.data)) // room))

    @property
    def due(self) -> int:
        """The place of the first frame that is not there, from 0 on."""
        place = 1
        while place in self.pieces:
            place += 1
        return place

    def named(self, place: int) -> str:
        """A frame by its place, as people count."""
        return f"frame {place + 1} of {self.total}" if self.total else f"frame {place + 1}"

    def why(self, reason: str) -> str:
        """Why it is given up: frames that came without one before them say more than the occasion."""
        due = self.due
        is_gap = any(place > due for place in self.pieces)
        return f"malformed: {self.named(due)} missing" if is_gap else f"malformed: {reason}"

    def joined(self) -> bytes:
        data = self.part.data + b"".join(self.pieces[place] for place in sorted(self.pieces))
        return data if self.part.size is None else data[: self.part.size]


class Reassembler:
    """Makes packets of the frames of one transport; no I/O, no clock."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self._open: dict[Hashable, _Open] = {}
        #: Frames that are in packets under way.
        self.pending = 0

    def take(
        self, frame: Any, number: int, key: int, data: bytes, channel: Any, time: float | None
    ) -> list[Packet]:
        """What one more frame of the transport decides; `key` is without the flag of CAN FD."""
        transport = self.transport
        part = transport.part(key, data)
        mine = CarriedFrame(frame, number, data, time)
        role = part.role
        if role in ("bad", "control"):
            return [Packet([mine], part.reason)]
        who = (channel, part.session)
        if role == "abort" and who not in self._open:
            who = (channel, part.other)
        found = self._open.get(who)
        out: list[Packet] = []
        if found is not None:
            last = found.frames[-1].time
            if last is not None and time is not None and time - last > transport.timeout_s:
                out.append(self._give_up(who, found.why("timed out")))
                found = None
        if role == "next":
            if found is None:
                out.append(Packet([mine], "malformed: no first frame"))
            else:
                out += self._next(who, found, part, mine)
            return out
        if found is not None:
            out.append(self._give_up(who, found.why("aborted" if role == "abort" else "restarted")))
        if role == "abort":
            out.append(Packet([mine], part.reason, part.key, part.data))
        elif role == "single":
            out.append(Packet([mine], "", part.key, part.data))
        else:
            out += self._first(who, part, mine)
        return out

    def _first(self, who: Hashable, part: FramePart, mine: CarriedFrame) -> Iterator[Packet]:
        made = _Open(part, mine, self.transport.room(len(mine.data)))
        if part.is_last or (part.size is not None and made.total == 1):
            yield Packet(made.frames, "", part.key, made.joined())
            return
        if len(mine.data) not in self.transport.full_lengths:
            yield Packet([mine], "malformed: first frame is short")
            return
        if len(self._open) >= self.transport.senders:
            yield self._give_up(next(iter(self._open)), "malformed: too many senders at once")
        self._open[who] = made
        self.pending += 1

    def _next(self, who: Hashable, found: _Open, part: FramePart, mine: CarriedFrame) -> Iterator[Packet]:
        transport, pieces = self.transport, found.pieces
        if transport.any_order:
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
            yield self._give_up(who, f"malformed: {found.named(place)} {how}")
            return
        pieces[place] = part.data
        is_last = part.is_last or (found.total > 0 and place == found.total - 1)
        so_far = len(found.part.data) + found.room * place
        least = found.part.size - so_far + found.room if found.part.size is not None and is_last else 0
        if len(part.data) < least or (not is_last and len(part.data) != found.room):
            yield self._give_up(who, f"malformed: {found.named(place)} is short")
        elif (
            found.part.size is None
            and len(found.part.data) + sum(map(len, pieces.values())) > transport.longest + transport.overhead
        ):
            yield self._give_up(who, "malformed: too long")
        elif is_last if not found.total else len(pieces) == found.total - 1:
            del self._open[who]
            self.pending -= len(found.frames)
            yield Packet(found.frames, "", found.part.key, found.joined())

    def _give_up(self, who: Hashable, reason: str) -> Packet:
        lost = self._open.pop(who)
        self.pending -= len(lost.frames)
        return Packet(lost.frames, reason)

    def idle(self, time: float | None) -> list[Packet]:
        """The packets under way that are out of time at `time`; None: that nothing follows any more."""
        late = [
            (who, found)
            for who, found in self._open.items()
            if time is None
            or (found.frames[-1].time is not None and time - found.frames[-1].time > self.transport.timeout_s)
        ]
        return [self._give_up(who, found.why("timed out")) for who, found in late]

    def close(self) -> list[Packet]:
        """The frames of packets under way, which are pending for ever."""
        return [self._give_up(who, "pending") for who in list(self._open)]

    def reset(self) -> None:
        """Forget everything."""
        self._open.clear()
        self.pending = 0
