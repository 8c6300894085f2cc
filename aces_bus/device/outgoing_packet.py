"""A packet of several frames on its way out: one frame behind the other, as fast as its receiver allows.

1. A frame is handed to the port when the one before it has left. So a packet that is ended has one frame left at most, and
   what its receiver says is about frames that it can have.
2. It ends once, with a fate. Where the transport has aborts and it was not the receiver that ended it, an abort is sent.
   The next packet in turn waits until the last frame and the abort have left: frames do not say which packet they are of.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from ..frames import Frame
from ..protocol.declare.handshake import AnswerTimes, GivenUp, Steering
from ..protocol.declare.transport import Transport
from ..runtime.clock import EventClock, Timer
from .port import Left

#: How often a receiver may say that the sender has to wait, and how often it may have each frame on average.
MOST_WAITS, MOST_TIMES = 16, 4


class OutgoingPacket:
    """Made by `CarriedPort`. `send(frame, report)` hands over a frame; `gone(packet, is_sent)` is called when no frame of
    it is left.
    """

    def __init__(
        self,
        frames: Sequence[Frame],
        key: int,
        transport: Transport | None,
        clock: EventClock,
        send: Callable[[Frame, Left], bool],
        gone: Callable[[OutgoingPacket, bool], Any],
        report: Left | None,
        topic: object,
    ) -> None:
        self.frames, self.key, self.transport, self.topic = frames, key, transport, topic
        self._clock, self._send, self._gone, self._report = clock, send, gone, report
        self.opening = frames[0].data
        #: The place of the next frame, that behind the furthest one that was handed over, and how many may leave before
        #: the next go-ahead (None: all).
        self._at = self._furthest = 0
        self._allowed: int | None = None
        self._gap_ns, self._times = 0, AnswerTimes(1.0, 1.0, 1.0, 1.0)
        self._is_acknowledged = False
        if transport is not None:
            self._gap_ns, self._times = round(transport.pause_s(self.key) * 1e9), transport.answer_times
            self._is_acknowledged = transport.acknowledgement(self.key, self.opening) is not None
            if transport.go_ahead(self.key, self.opening) is not None:
                self._allowed = 1
        #: How many frames were handed over, and which of them has not left (0: none).
        self._count = self._in_flight = 0
        self._waits = 0
        self._is_pausing = self._is_sending = False
        self.fate = ""
        self._given_up: GivenUp | None = None
        self._timer: Timer | None = None

    @property
    def has_begun(self) -> bool:
        """True if a frame of the packet was handed over."""
        return self._count > 0

    def go_on(self) -> bool:
        """Send what may go; False where the port does not take it."""
        if self._is_sending:  # of a port that sends at once: the loop below goes on
            return True
        self._is_sending = True
        while not (self._in_flight or self._is_pausing or self.fate or self._allowed == 0):
            if self._at == len(self.frames):
                break
            frame = self.frames[self._at]
            self._at += 1
            self._furthest = max(self._furthest, self._at)
            self._count += 1
            if self._allowed is not None:
                self._allowed -= 1
            number = self._in_flight = self._count
            if not self._send(frame, partial(self._left, number)) and not self.fate:
                self._in_flight = 0
                self.end("dropped", "the bus does not take it", "timed out")
        self._is_sending = False
        return self.fate in ("", "sent")

    def _left(self, number: int, fate: str, why: str) -> None:
        """Act on the fate of a frame."""
        if number != self._in_flight:
            return
        self._in_flight = 0
        if self.fate:
            self._finish()
        elif fate != "sent":
            self.end(fate, why, "timed out")
        elif self._at == len(self.frames) and not self._is_acknowledged:
            self.end("sent", "")
        elif self._allowed == 0 or self._at == len(self.frames):
            self._wait(self._times.answer_s)
        elif self._gap_ns:
            self._is_pausing = True
            self._restart(self._gap_ns, self._paused)
        else:
            self.go_on()

    def _paused(self) -> None:
        self._is_pausing = False
        self.go_on()

    def _wait(self, time_s: float) -> None:
        self._restart(round(time_s * 1e9), self._late)

    def _late(self) -> None:
        missing = "acknowledgement" if self._furthest == len(self.frames) else "go-ahead"
        self.end("expired", f"its receiver gave no {missing} in time", "timed out")

    def _restart(self, delay_ns: int, action: Callable[[], object]) -> None:
        self._stop_timer()
        self._timer = self._clock.call_in(delay_ns, action)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def steered(self, steering: Steering) -> None:
        """Take what its receiver says of how to go on; before it has begun, that was another packet's."""
        if self.fate or not self.has_begun:
            return
        if any(self.opening[at : at + len(given)] != given for at, given in steering.opening):
            return
        if steering.go == "stop":
            self.end("dropped", steering.reason or "its receiver cannot take it")
        elif steering.go == "done":
            if self._is_acknowledged and self._furthest == len(self.frames):
                self.end("sent", "")
        elif self._allowed != 0 and not steering.start:
            return  # it does not wait: only a place says what such a go-ahead means
        elif steering.go == "wait":
            self._waits += 1
            self._allowed = 0
            if self._waits > MOST_WAITS:
                self.end("expired", "its receiver asked for patience too often", "asked too often")
            elif not self._in_flight:
                self._wait(self._times.hold_s)
        else:
            self._let_go_on(steering)

    def _let_go_on(self, steering: Steering) -> None:
        start = steering.start or self._at
        if start >= len(self.frames):
            why = f"its receiver asks for frame {start} of {len(self.frames) - 1}"
            self.end("dropped", why, "contradiction")
        elif self._count > MOST_TIMES * len(self.frames):
            self.end("expired", "its receiver asks for the same frames too often", "asked too often")
        else:
            self._stop_timer()
            self._is_pausing = False
            self._at, self._allowed, self._gap_ns = start, steering.frames or None, steering.gap_ns
            self.go_on()

    def end(self, fate: str, why: str, given_up: GivenUp | None = None) -> None:
        """End the packet: report its fate, and tell the receiver if it was `given_up`."""
        if self.fate:
            return
        self._stop_timer()
        self.fate, self._given_up = fate, given_up
        if self._report is not None:
            self._report(fate, why)
        if not self._in_flight:
            self._finish()

    def _finish(self) -> None:
        """End it, as no frame is left: tell its receiver where that is due, then let the next one go."""
        gone = partial(self._gone, self, self.fate == "sent")
        transport, given_up = self.transport, self._given_up
        if transport is not None and given_up is not None and self.has_begun:
            abort = transport.abort(self.key, self.opening, given_up, by_sender=True)
            if abort is not None and self._send(transport.frame(*abort), lambda fate, why: gone()):
                return
        gone()


__all__ = ["OutgoingPacket"]
