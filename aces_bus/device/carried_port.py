"""A port for protocols with transports: packets go out frame by frame, as fast as their receivers allow.

1. A packet that needs a go-ahead (flow control) sends its first frame and waits for it; without one in time it fails, and
   says so. Nothing is sent again.
2. First frames of packets for us are answered with a go-ahead; a port that may not send (a passive host) answers none.
3. Packets that frames do not tell apart (mostly: of one identifier) go out one behind the other: what comes between its
   frames would end one. A stop does.
4. Where a transport wants pauses between frames (a broadcast's), they are kept.
5. All of it runs on the clock of the port below, in life and in virtual time alike.

A packet is one frame, or a tuple of its frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

from ..frames import Frame
from ..protocol import Variant
from ..protocol.declare.transport import Steering, Transport
from ..protocol.keys import EXTENDED, key_of
from ..runtime import EventClock
from .port import Left, Port

#: How often a receiver may ask for patience with one packet.
MOST_WAITS = 16


class _Outgoing:
    """A packet that is on its way out."""

    def __init__(
        self, port: CarriedPort, frames: Sequence[Frame], send: Callable[..., bool], report: Left | None
    ) -> None:
        self.port, self.send, self._report = port, send, report
        self.frames, self.opening = frames, frames[0].data
        self.left = deque(frames)
        #: How many frames may still go before the next go-ahead (None: all), and the time between two.
        self.allowed: int | None = 0
        self.gap_ns = port.pause_of(frames)
        self.waits = 0
        self.has_begun = False
        self.timer: Any = None

    def begin(self, waits: bool) -> bool:
        """Send the first frame; without a handshake all of them. Not when it was ended while it waited for its turn."""
        if not self.left:
            return False
        self.has_begun = True
        if not waits:
            self.allowed = None
            return self.go_on()
        taken = self.send(self.left.popleft())
        self.wait()
        return taken

    def wait(self) -> None:
        """Wait for a go-ahead, so long."""
        self.restart(round(self.port.timeout_of(self) * 1e9), self.late)

    def late(self) -> None:
        self.end("expired", "its receiver gave no go-ahead in time")

    def steered(self, steering: Steering) -> None:
        """Its receiver says how to go on; before it has begun, that was another packet's."""
        if not self.has_begun:
            return
        if steering.go == "stop":
            self.end("dropped", "its receiver cannot take it")
        elif steering.go == "wait":
            self.waits += 1
            if self.waits > MOST_WAITS:
                self.end("expired", "its receiver asked for patience too often")
            else:
                self.wait()
        elif self.allowed == 0:
            self.allowed, self.gap_ns = steering.frames or None, steering.gap_ns
            self.go_on()

    def go_on(self) -> bool:
        """Send what may go."""
        while self.left:
            if self.allowed == 0:
                self.wait()
                return True
            frame = self.left.popleft()
            if not self.send(frame):
                self.end("dropped", "the bus does not take it")
                return False
            if self.allowed is not None:
                self.allowed -= 1
            if self.gap_ns and self.left:
                self.restart(self.gap_ns, self.go_on)
                return True
        self.end("sent", "")
        return True

    def restart(self, delay_ns: int, action: Callable[[], Any]) -> None:
        if self.timer is not None:
            self.timer.cancel()
        self.timer = self.port.clock.call_in(delay_ns, action)

    def end(self, fate: str, why: str) -> None:
        """It is over; say what became of it, and let the next one go."""
        if self.timer is not None:
            self.timer.cancel()
        self.left.clear()
        self.port.ended(self, fate == "sent")
        if self._report is not None:
            self._report(fate, why)


class CarriedPort:
    """A port that knows the transports of some protocols; `is_ours(key, data)` says whose packet a first frame begins."""

    def __init__(
        self, port: Port, variants: Sequence[Variant], is_ours: Callable[[int, bytes], bool]
    ) -> None:
        self.port, self._is_ours = port, is_ours
        messages = [m for variant in variants for m in variant.messages.values()]
        self._transports = list(dict.fromkeys(m.transport for m in messages if m.transport is not None))
        self._messages = messages
        self._carried: dict[int, Transport | None] = {}
        #: By `turn_of`: packets on their way out, the first one under way.
        self._out: dict[int, deque[tuple[_Outgoing, bool]]] = {}
        #: Packets that did not leave whole.
        self.failed = 0

    @property
    def link(self) -> Literal["can", "serial", "datagram"]:
        """The link of the port below; likewise its clock, name and half_duplex."""
        return self.port.link

    @property
    def clock(self) -> EventClock:
        """The clock of the port below."""
        return self.port.clock

    @property
    def name(self) -> str:
        """The name of the port below."""
        return self.port.name

    @property
    def half_duplex(self) -> bool:
        """As of the port below."""
        return self.port.half_duplex

    def open(self, received: Callable[[Any, int], Any]) -> None:
        """Start receiving: `received(frame, instant)` has every frame; those that steer are acted on before."""

        def steer(frame: Any, instant: int) -> None:
            self._steer(frame)
            received(frame, instant)

        self.port.open(steer)

    def on_event(self, handler: Callable[[str, str], Any]) -> None:
        """As of the port below."""
        self.port.on_event(handler)

    def wire_ns(self, packet: Any) -> int:
        """How long a frame, or all frames of a packet, occupy the bus (ns)."""
        return sum(map(self.port.wire_ns, packet)) if isinstance(packet, tuple) else self.port.wire_ns(packet)

    def close(self) -> None:
        """Stop receiving; what is on its way ends."""
        for waiting in [*self._out.values()]:
            for outgoing, _ in [*waiting]:
                outgoing.end("dropped", "the port was closed")
        self._out.clear()
        self.port.close()

    def send(
        self,
        packet: Any,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Left | None = None,
    ) -> bool:
        """Send a frame or the frames of a packet (a tuple); `report` says once what became of it."""
        if not isinstance(packet, tuple):
            return self.port.send(packet, age_ns, urgent=urgent, topic=topic, report=report)
        frames: tuple[Frame, ...] = packet
        key = _key(frames[0])
        transport, turn = self._transport_of(key), self._turn_of(frames)
        if transport is not None and len(packet) > 1 and (why := transport.refuses(key)):
            if report is not None:
                report("dropped", f"{transport.title}: {why}")
            self.failed += 1
            return False
        if urgent:  # what is under way gives way to a stop
            for outgoing, _ in [*self._out.get(turn, ())]:
                outgoing.end("dropped", "a stop overtook it")
        if len(packet) == 1 and turn not in self._out:
            return self.port.send(frames[0], age_ns, urgent=urgent, topic=topic, report=report)

        def send(frame: Frame) -> bool:
            return self.port.send(frame, 0, urgent=urgent, topic=topic)

        waits = transport is not None and transport.go_ahead(key, frames[0].data) is not None
        made = _Outgoing(self, packet, send, report)
        waiting = self._out.setdefault(turn, deque())
        waiting.append((made, waits))
        return made.begin(waits) if len(waiting) == 1 else True

    def timeout_of(self, outgoing: _Outgoing) -> float:
        """How long a packet waits for its go-ahead (s)."""
        transport = self._transport_of(_key(outgoing.frames[0]))
        return transport.timeout_s if transport is not None else 1.0

    def pause_of(self, frames: Sequence[Frame]) -> int:
        """How long to wait between two frames of a packet (ns), if no flow control says it."""
        transport = self._transport_of(_key(frames[0]))
        return round(transport.pause_s(_key(frames[0])) * 1e9) if transport is not None else 0

    def _turn_of(self, frames: Sequence[Frame]) -> int:
        """What a packet has in common with those that go out before or behind it."""
        key = _key(frames[0])
        transport = self._transport_of(key)
        return key if transport is None else transport.in_turn(key)

    def cancel(self, frames: Sequence[Frame], why: str) -> None:
        """Send no more of a packet (the very tuple that `send` was given) that is on its way or waits for its turn."""
        for outgoing, _ in [*self._out.get(self._turn_of(frames), ())]:
            if outgoing.frames is frames:
                outgoing.end("expired", why)

    def ended(self, outgoing: _Outgoing, is_sent: bool) -> None:
        """A packet is out of the way: the next one of its key begins."""
        self.failed += not is_sent
        turn = self._turn_of(outgoing.frames)
        waiting = self._out[turn]
        was_first = waiting[0][0] is outgoing
        self._out[turn] = waiting = deque(pair for pair in waiting if pair[0] is not outgoing)
        if not waiting:
            del self._out[turn]
        elif was_first:
            following, waits = waiting[0]
            self.clock.call_soon(partial(following.begin, waits))

    def _steer(self, frame: Any) -> None:
        """What a received frame asks for: to go on with a packet of ours, or a go-ahead for one of its sender's."""
        if not isinstance(frame, Frame) or frame.is_remote_frame or frame.is_error_frame:
            return
        key = _key(frame)
        transport = self._transport_of(key)
        if transport is None:
            return
        steering = transport.steering(key, frame.data)
        if steering is not None:
            waiting = self._out.get(transport.in_turn(steering.key))
            if waiting and waiting[0][0].opening.startswith(steering.address):
                waiting[0][0].steered(steering)
            return
        answer = transport.go_ahead(key, frame.data)
        if answer is not None and self._is_ours(key, frame.data):
            number, data = answer
            self.port.send(
                Frame(number & 0x1FFF_FFFF, data, is_extended_id=bool(number & EXTENDED), is_fd=transport.fd)
            )

    def _transport_of(self, key: int) -> Transport | None:
        """Whose frames have a key."""
        if key not in self._carried:
            named = (
                m.transport
                for m in self._messages
                if m.transport is not None
                and m.extended == bool(key & EXTENDED)
                and m.identifier.match(key & 0x1FFF_FFFF) is not None
            )
            own = (transport for transport in self._transports if transport.is_own(key))
            self._carried[key] = next(named, None) or next(own, None)
        return self._carried[key]


def _key(frame: Any) -> int:
    return key_of(frame.arbitration_id, extended=frame.is_extended_id)


__all__ = ["CarriedPort"]
