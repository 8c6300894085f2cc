"""A packet for us, of several frames: its sender gets go-aheads, questions for what is missing, and an acknowledgement.

1. The scanner's own rule decides what makes a packet: what is acknowledged is a record, and what is none is given up.
2. Silence after a question ends it. Where a part of what was asked for came, the rest is asked for again.
3. It waits no longer between two frames than the scanner does.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable

from ..frames import Frame
from ..protocol.declare.handshake import GivenUp
from ..protocol.declare.transport import Transport
from ..protocol.live.reassemble import Reassembler
from ..runtime.clock import EventClock, Timer


class IncomingPacket:
    """Made by `CarriedPort` of a first frame, which `take` is given then; `over()` is called when it is over."""

    def __init__(
        self,
        transport: Transport,
        key: int,
        opening: bytes,
        session: Hashable,
        clock: EventClock,
        send: Callable[[Frame], object],
        over: Callable[[], object],
    ) -> None:
        self._transport, self._key, self._opening, self._session = transport, key, opening, session
        self._clock, self._send, self._over = clock, send, over
        self._packets = Reassembler(transport)
        #: The place behind the last frame that was asked for, and how many were missing then.
        self._end = self._missing = 0
        #: Until when the scanner waits for another frame (ns).
        self._until = 0
        self._timer: Timer | None = None

    def take(self, key: int, data: bytes) -> None:
        """Take one more frame of the session; the first is the packet's first."""
        for packet in self._packets.take(None, 0, key, data, None, None):
            if packet.reason == "malformed: repeated":
                return  # the scanner waits no longer for that
            if packet.reason:
                self._give_up("contradiction")
            else:
                self._answer(self._transport.acknowledgement(self._key, self._opening))
                self.end()
            return
        self._until = self._clock.now() + round(self._transport.timeout_s * 1e9)
        missing = self._packets.missing(None, self._session)
        if self._end - 1 in missing:  # more is to come of what was asked for
            self._wait(self._transport.answer_times.next_s)
        else:
            self._ask(missing)

    def _ask(self, missing: list[int]) -> None:
        """Let its sender go on, from the first missing frame on."""
        run = 1
        while run < len(missing) and missing[run] == missing[0] + run:
            run += 1
        answer = self._transport.go_ahead(self._key, self._opening, missing[0], run)
        said = self._transport.steering(*answer) if answer is not None else None
        self._answer(answer)
        if said is None or not (said.frames or self._is_acknowledged):
            self.end()  # it may send all of it, and nothing is said to it any more
            return
        self._end, self._missing = missing[0] + (said.frames or run), len(missing)
        self._wait(self._transport.answer_times.begin_s)

    @property
    def _is_acknowledged(self) -> bool:
        return self._transport.acknowledgement(self._key, self._opening) is not None

    def _answer(self, answer: tuple[int, bytes] | None) -> None:
        if answer is not None:
            self._send(self._transport.frame(*answer))

    def _wait(self, time_s: float) -> None:
        self._stop_timer()
        instant = min(self._clock.now() + round(time_s * 1e9), self._until)
        self._timer = self._clock.call_at(instant, self._late)

    def _late(self) -> None:
        missing = self._packets.missing(None, self._session)
        if len(missing) < self._missing and self._clock.now() < self._until:
            self._ask(missing)
        else:
            self._give_up("timed out")

    def _give_up(self, why: GivenUp) -> None:
        self._answer(self._transport.abort(self._key, self._opening, why, by_sender=False))
        self.end()

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def end(self) -> None:
        """Ask for nothing more."""
        self._stop_timer()
        self._over()


__all__ = ["IncomingPacket"]
