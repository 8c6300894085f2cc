"""How long the messages of a host's tick take at most: set-points and requests that leave together, and what they cause.

All of it happens once a tick, so that none of it meets itself, and an answer comes only after its request. An analysis
that knows this (here) says less than one of messages that know nothing of one another (`response.py`), and is still never
too low.

*Theory*. Let all frames of the tick before be over when a tick begins; which is so if the bound found here is no longer
than a tick, by induction. A frame f may take part in arbitration from an instant on that is S(f) at the latest. Look at
when frame r arrives, and at the instant u from which on the bus was never free of r and of what goes before r. What was
sent since u was not ready before u; so it is among the frames j with S(j) ≥ u, and each of these is sent once at most:

    R(r) ≤ u + blocking + Σ C(j) + C(r) + what others send meanwhile, j before r with S(j) ≥ u

u is an instant at which such a frame, or r, became ready. The right side grows with u between two S(j), so that it is
enough to look at u = S(j) ≤ S(r), and at u = S(r). What is not of the tick (devices that speak by themselves) comes in with
its period; what of it was left over when the tick began counts by its own response time.

In a FIFO a frame is ready when those before it have left; it competes as the least urgent of those.

When the tick begins (u = 0) nothing of it is on the bus yet, so that only what others send can block.

Where not all are over within a tick, the sentence holds for the frames whose rivals are: what is left over of less urgent
ones is one frame more that may be on the bus already. The others have no bound.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from aces_bus.errors import CallerError, UnknownNameError

from .messages import BusMessage, MessageSet, Queue
from .response import LONGEST_NS, MOST_TURNS, ResponseTime, response_times


@dataclass(frozen=True)
class RoundFrame:
    """One frame of a tick.

    `message` is what is sent (its `jitter_ns` counts from the tick, or from the end of `after`), `after` the name of the
    frame that causes it ("": the tick does). `period_ns` of the message is how often it is sent, a tick or some.
    """

    message: BusMessage
    after: str = ""


@dataclass(frozen=True)
class RoundTimes:
    """The response times (from the tick) of a tick's frames, and of what is sent beside, by name.

    `round_ns`: when the last frame of a tick has arrived at the latest. It is None, and so is the response time of a frame,
    where that may be after the next tick, or because something before it may.
    """

    frames: Mapping[str, ResponseTime]
    others: Mapping[str, ResponseTime]
    round_ns: int | None


def round_times(
    frames: Sequence[RoundFrame],
    others: MessageSet,
    tick_ns: int,
    *,
    queues: Mapping[str, Queue] | None = None,
) -> RoundTimes:
    """Return the worst-case response times of a tick's frames, in the order in which the tick queues them, among `others`.

    `others` also says the time of a bit and the errors, `queues` how the nodes of the tick's frames queue. Raises
    `CallerError` for two frames of one name, `UnknownNameError` for a cause that there is not.

    >>> us = 1_000
    >>> ask = BusMessage("ask", 1, 100 * us, 5_000 * us, node="host")
    >>> answer = BusMessage("answer", 2, 130 * us, 5_000 * us, jitter_ns=50 * us, node="board")
    >>> found = round_times([RoundFrame(ask), RoundFrame(answer, "ask")], MessageSet((), 1 * us), 5_000 * us)
    >>> found.frames["ask"].response_ns // us, found.frames["answer"].response_ns // us
    (100, 280)
    """
    names = [frame.message.name for frame in frames]
    if len(set(names)) < len(names):
        raise CallerError(
            f"two frames of a tick have one name: {next(n for n in names if names.count(n) > 1)}"
        )
    for frame in frames:
        if frame.after and frame.after not in names:
            raise UnknownNameError("frame of the tick", frame.after, names)
    return _Round(frames, others, tick_ns, {**others.queues, **(queues or {})}).settle()


class _Round:
    """One analysis: response times rise from what they are at least until they agree with one another."""

    def __init__(
        self,
        frames: Sequence[RoundFrame],
        others: MessageSet,
        tick_ns: int,
        queues: Mapping[str, Queue],
    ) -> None:
        self.frames, self.others, self.tick_ns = frames, others, tick_ns
        self.place = {frame.message.name: index for index, frame in enumerate(frames)}
        self.fifo = [queues.get(frame.message.node, "priority") == "fifo" for frame in frames]
        #: Of each, beside what it takes to come to the bus, how much later than its period it may be queued: one that is not
        #: sent in each tick may have to wait for the next one.
        self.slack = [tick_ns if frame.message.period_ns > tick_ns else 0 for frame in frames]
        #: When each is queued, when it may take part in arbitration, and when it has arrived: at the latest.
        self.queued = [frame.message.jitter_ns for frame in frames]
        self.ready = list(self.queued)
        self.arrived = [frame.message.jitter_ns + frame.message.wire_ns for frame in frames]
        #: Response times of the others.
        self.beside = {message.name: message.jitter_ns + message.wire_ns for message in others.messages}
        #: Whether frames of the tick before may be left over.
        self.has_leftovers = False
        self._rivals = [self._rivals_of(index) for index in range(len(frames))]

    def _causes(self, index: int) -> set[int]:
        """Return a frame and all that has to be over before it is queued."""
        found = {index}
        while (after := self.frames[index].after) and (index := self.place[after]) not in found:
            found.add(index)
        return found

    def _rivals_of(self, index: int) -> tuple[list[int], int, int]:
        """Return the frames that may go before a frame while it waits, the priority it competes with, and the
        longest frame that may be on the bus already.
        """
        frames = self.frames
        mine = frames[index].message
        own: list[int] = []
        if self.fifo[index]:
            together = [i for i, frame in enumerate(frames) if frame.message.node == mine.node and i != index]
            own = [
                i
                for i in together
                if index not in self._causes(i) and (frames[i].after or frames[index].after or i < index)
            ]
        priority = max([mine.priority, *(frames[i].message.priority for i in own)])
        rivals = list(own)
        blocking = 0
        for other, frame in enumerate(frames):
            if other == index or other in own:
                continue
            message = frame.message
            if self.fifo[index] and message.node == mine.node:
                continue  # it stands behind
            is_later = index in self._causes(other)  # what a frame causes is not there before it has arrived
            if message.priority > priority:
                blocking = max(blocking, 0 if is_later and not self.has_leftovers else message.wire_ns)
            elif not is_later:
                rivals.append(other)
        for beside in self.others.messages:
            if beside.priority > priority:
                blocking = max(blocking, beside.wire_ns)
        return rivals, priority, blocking

    def settle(self) -> RoundTimes:
        beside = self._settled()
        if max(self.arrived, default=0) > self.tick_ns:
            self.has_leftovers = True
            self._rivals = [self._rivals_of(index) for index in range(len(self.frames))]
            beside = self._settled()
        bound: list[int | None] = [end if end <= self.tick_ns else None for end in self.arrived]
        while True:
            before = bound.count(None)
            for index in range(len(self.frames)):
                if any(bound[other] is None for other in self._needed(index)):
                    bound[index] = None
            if bound.count(None) == before:
                break
        times = {
            frame.message.name: ResponseTime(
                frame.message, bound[index], self._rivals[index][2], bound[index]
            )
            for index, frame in enumerate(self.frames)
        }
        known = [end for end in bound if end is not None]
        return RoundTimes(times, beside, max(known, default=0) if len(known) == len(bound) else None)

    def _needed(self, index: int) -> set[int]:
        """Return the frames of the tick before that have to be over, that a frame's bound may hold."""
        rivals, priority, _ = self._rivals[index]
        node = self.frames[index].message.node
        return {*rivals, *self._causes(index)} | {
            other
            for other, frame in enumerate(self.frames)
            if frame.message.priority <= priority or (self.fifo[index] and frame.message.node == node)
        }

    def _settled(self) -> dict[str, ResponseTime]:
        """Have all response times rise until they agree; those of the others."""
        beside: dict[str, ResponseTime] = {}
        for _ in range(MOST_TURNS):
            before = (list(self.arrived), dict(self.beside))
            for index in range(len(self.frames)):
                self._look(index)
            beside = self._beside()
            if (self.arrived, self.beside) == before:
                return beside
        self.arrived = [LONGEST_NS + 1] * len(self.arrived)  # they drive one another up
        self.ready = list(self.arrived)
        return self._beside()

    def _look(self, index: int) -> None:
        frame = self.frames[index]
        message = frame.message
        self.queued[index] = message.jitter_ns + (self.arrived[self.place[frame.after]] if frame.after else 0)
        rivals, priority, blocking = self._rivals[index]
        beside = max(
            (other.wire_ns for other in self.others.messages if other.priority > priority), default=0
        )
        ready, queued = self.ready, self.queued
        # Of a FIFO's own frames it counts when they were queued, of others when they come to the bus.
        latest = {
            other: queued[other]
            if self.fifo[index] and self.frames[other].message.node == message.node
            else ready[other]
            for other in rivals
        }
        own = queued[index]
        worst = 0
        for begin in {own, *(instant for instant in latest.values() if instant <= own)}:
            counted = [other for other in rivals if latest[other] >= begin]
            lengths = [self.frames[other].message.wire_ns for other in counted]
            # When the tick begins, nothing of it is on the bus, and nothing of the one before.
            blocked = blocking if begin or self.has_leftovers else beside
            wait = self._wait(message, priority, blocked + sum(lengths), lengths)
            worst = max(worst, begin + wait + message.wire_ns)
        self.arrived[index] = max(self.arrived[index], worst)
        self.ready[index] = self.arrived[index] - message.wire_ns if self.fifo[index] else own

    def _wait(self, message: BusMessage, priority: int, work_ns: int, lengths: list[int]) -> int:
        """Return how long a frame waits from the begin of a busy period that has so much of the tick to send."""
        others = self.others
        beside = [other for other in others.messages if other.priority <= priority]
        again = [message.wire_ns, *lengths, *(other.wire_ns for other in beside)]
        now = work_ns
        while now <= LONGEST_NS:
            window = now + others.bit_ns
            more = sum(
                -(-(window + self.beside[other.name]) // other.period_ns) * other.wire_ns for other in beside
            )
            following = work_ns + more + others.error_ns(now + message.wire_ns, again)
            if following == now:
                return now
            now = following
        return LONGEST_NS

    def _beside(self) -> dict[str, ResponseTime]:
        """Return the response times of the others, to whom a tick's frames are messages with the jitter of their way
        to the bus.
        """
        if not self.others.messages:
            return {}
        known = [
            replace(
                frame.message,
                name=f"\0{frame.message.name}",
                jitter_ns=min(self.ready[index] + self.slack[index], LONGEST_NS),
                node="",
            )
            for index, frame in enumerate(self.frames)
        ]
        there = {message.node for message in self.others.messages}
        queues: dict[str, Queue] = {
            node: queue for node, queue in self.others.queues.items() if node in there
        }
        found = response_times(
            MessageSet((*self.others.messages, *known), self.others.bit_ns, queues, self.others.errors)
        )
        for message in self.others.messages:
            response = found[message.name].response_ns
            self.beside[message.name] = LONGEST_NS if response is None else response
        return {message.name: found[message.name] for message in self.others.messages}
