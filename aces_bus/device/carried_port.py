"""A port for protocols with transports: packets go out frame by frame, as fast as their receivers allow.

1. A packet that needs a go-ahead (flow control, clear to send) sends its first frame and waits for it; without one in time
   it fails, and says so. Frames are sent again where the receiver asks for them (`outgoing_packet`).
2. First frames of packets for us are answered with a go-ahead, and what transports want behind it (`incoming_packet`); a
   port that may not send (a passive host) answers none.
3. Packets that frames do not tell apart (mostly: of one identifier) go out one behind the other: what comes between its
   frames would end one. A stop does, and ends what is under way to the same device.
4. Where a transport wants pauses between frames (a broadcast's), they are kept.
5. All of it runs on the clock of the port below, in life and in virtual time alike.

A packet is one frame, or a tuple of its frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Sequence
from functools import partial
from typing import Any

from ..frames import EXTENDED, Frame, key_of
from ..protocol import Variant
from ..protocol.declare.transport import Transport
from .incoming_packet import IncomingPacket
from .outgoing_packet import OutgoingPacket
from .port import Left, Packet, Port, UpperPort


class CarriedPort(UpperPort):
    """A port that knows the transports of some protocols; `is_ours(key, data)` says whose packet a first frame begins."""

    def __init__(
        self, port: Port, variants: Sequence[Variant], is_ours: Callable[[int, bytes], bool]
    ) -> None:
        super().__init__(port)
        self._is_ours = is_ours
        messages = [m for variant in variants for m in variant.messages.values()]
        self._transports = list(dict.fromkeys(way for m in messages for way in m.ways if way is not None))
        self._messages = messages
        self._carried: dict[int, Transport | None] = {}
        #: By what they take turns for: packets on their way out, the first one under way.
        self._out: dict[int, deque[OutgoingPacket]] = {}
        #: Packets for us that are under way, by transport (its `id`: a hash of all its kinds takes long) and session.
        self._in: dict[tuple[int, Hashable], IncomingPacket] = {}
        #: Packets that did not leave whole.
        self.failed = 0

    @property
    def under_way(self) -> int:
        """Number of packets on their way, out and in, with a handshake or waiting for their turn."""
        return sum(map(len, self._out.values())) + len(self._in)

    def open(self, received: Callable[[Any, int], Any]) -> None:
        """Start receiving: `received(frame, instant)` has every frame; those that steer are acted on before."""

        def steer(frame: Any, instant: int) -> None:
            self._steer(frame)
            received(frame, instant)

        self.port.open(steer)

    def wire_ns(self, packet: Packet) -> int:
        """Return how long a frame, or all frames of a packet, occupy the bus (ns)."""
        return sum(map(self.port.wire_ns, packet)) if isinstance(packet, tuple) else self.port.wire_ns(packet)

    def close(self) -> None:
        """Stop receiving; what is on its way ends."""
        out, self._out = self._out, {}
        for waiting in out.values():
            for outgoing in waiting:
                outgoing.end("dropped", "the port was closed")
        for incoming in [*self._in.values()]:
            incoming.end()
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
        transport = self._transport_of(key)
        if transport is not None and len(frames) > 1 and transport.unsendable:
            if report is not None:
                report("dropped", f"{transport.title}: {transport.unsendable}")
            self.failed += 1
            return False
        turn = key if transport is None else transport.in_turn(key)
        if urgent:  # what is under way gives way to a stop
            for number, waiting in [*self._out.items()]:
                for outgoing in [*waiting]:
                    if number == turn or (topic is not None and outgoing.topic is topic):
                        outgoing.end("dropped", "a stop overtook it", "overtaken")
        if len(frames) == 1 and (urgent or turn not in self._out):
            return self.port.send(frames[0], age_ns, urgent=urgent, topic=topic, report=report)

        def send(frame: Frame, left: Left) -> bool:
            return self.port.send(frame, 0, urgent=urgent, topic=topic, report=left)

        gone = partial(self._gone, turn)
        made = OutgoingPacket(frames, key, transport, self.clock, send, gone, report, topic)
        waiting = self._out.setdefault(turn, deque())
        waiting.append(made)
        return made.go_on() if len(waiting) == 1 else True

    def may_begin(self, frames: Sequence[Frame]) -> bool:
        """Return whether the first of these frames begins a packet, as their transport sees it."""
        key = _key(frames[0])
        transport = self._transport_of(key)
        return transport is None or transport.part(key, frames[0].data).role in ("first", "single")

    def cancel(self, frames: Sequence[Frame], why: str) -> None:
        """Send no more of a packet (the very tuple that `send` was given) that is on its way or waits for its turn."""
        for waiting in [*self._out.values()]:
            for outgoing in [*waiting]:
                if outgoing.frames is frames:
                    outgoing.end("expired", why, "timed out")

    def _gone(self, turn: int, outgoing: OutgoingPacket, is_sent: bool) -> None:
        """Take a finished packet out of its queue, and begin the next one if it was being sent."""
        self.failed += not is_sent
        waiting = self._out.get(turn)
        if waiting is None or outgoing not in waiting:
            return
        was_first = waiting[0] is outgoing
        waiting.remove(outgoing)
        if not waiting:
            del self._out[turn]
        elif was_first:
            self.clock.call_soon(waiting[0].go_on)

    def _steer(self, frame: Frame | bytes) -> None:
        """Act on a received control frame: go on with a packet of ours, or answer the sender of one."""
        if not isinstance(frame, Frame) or frame.is_remote_frame or frame.is_error_frame:
            return
        key = _key(frame)
        transport = self._transport_of(key)
        if transport is None or not transport.has_handshake:
            return
        data = frame.data
        steering = transport.steering(key, data)
        if steering is not None and (waiting := self._out.get(transport.in_turn(steering.key))):
            waiting[0].steered(steering)
        part = transport.part(key, data)
        incoming = self._in.get((id(transport), part.session))
        if part.role == "next":
            if incoming is not None:
                incoming.take(key, data)
        elif part.role in ("first", "single", "abort"):
            if part.role == "abort" and incoming is None:
                incoming = self._in.get((id(transport), part.other))
            if incoming is not None:
                incoming.end()
            is_asking = part.role == "first" and transport.go_ahead(key, data) is not None
            if is_asking and self._is_ours(key, data):
                self._let_in(transport, key, data, part.session)

    def _let_in(self, transport: Transport, key: int, data: bytes, session: Hashable) -> None:
        """Begin to receive a packet."""

        def over() -> None:
            self._in.pop((id(transport), session), None)

        if sum(identity == id(transport) for identity, _ in self._in) >= transport.senders:
            if (abort := transport.abort(key, data, "busy", by_sender=False)) is not None:
                self.port.send(transport.frame(*abort))
            return
        made = IncomingPacket(transport, key, data, session, self.clock, self.port.send, over)
        self._in[id(transport), session] = made
        made.take(key, data)

    def _transport_of(self, key: int) -> Transport | None:
        """Return the transport whose frames have a key."""
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


def _key(frame: Frame) -> int:
    return key_of(frame.arbitration_id, extended=frame.is_extended_id)


__all__ = ["CarriedPort"]
