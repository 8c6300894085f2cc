"""Ports: any bus as the device floor wants it, one way in, one way out, and what a word costs on the wire.

1. `received` is called on the clock's own thread (virtual or `Loop`), one word at a time: nothing above needs a lock.
2. A port is of one bus; who may listen only does so through a gate that cannot send.

A wire is simulated and needs no thread; a gate has threads, whose words are handed to the loop.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from msgspec.structs import replace

from ..errors import CallerError
from ..frames import Frame
from ..runtime import EventClock, Loop
from .can import CanGate, Received
from .datagram import Datagram, DatagramGate
from .events import BusEvent
from .outbox import AGE_S
from .serial import ReceivedBytes, SerialGate
from .simulated.bus import BusNode, SimulatedBus, SimulatedBusEvent
from .simulated.datagrams import SimulatedDatagrams
from .simulated.frame_time import INTERMISSION, frame_bits
from .simulated.serial_line import BITS, SimulatedSerialLine

Handler = Callable[[Any, int], Any]
#: Told what became of a word ("sent", "failed", "expired", "dropped", "unsent"), and why.
Told = Callable[[str, str], Any]
#: Told of what happens to a bus: kind ("bus-off", "lost", "reopened" …) and details.
BusHandler = Callable[[str, str], Any]
#: What of a simulated node is told; the others ("bit error", "no acknowledge") come by thousands, and are counted.
STATES = ("error-active", "error-passive", "bus-off", "recovered")
#: How long after bus-off a simulated station comes back (ns): SocketCAN's usual restart-ms, and what boards do.
RESTART = 100_000_000
#: How long a frame whose sender wants to know may wait in a simulated node's mailbox (ns).
LEAVES = round(AGE_S * 1e9)


class CanPort:
    """A CAN bus: a node on a `SimulatedBus`, or a `CanGate` with the `Loop` that its frames are handed to."""

    link: Literal["can"] = "can"
    half_duplex = False

    def __init__(
        self,
        bus: SimulatedBus | CanGate,
        loop: Loop | None = None,
        *,
        name: str = "",
        bitrate: int | None = None,
    ) -> None:
        self._bus = bus
        self._handler: BusHandler | None = None
        self._costs: dict[tuple[int, bool, bool], int] = {}
        if isinstance(bus, SimulatedBus):
            self.clock: EventClock = bus.clock
            self.bitrate = bus.bitrate
            self.data_bitrate = bus.data_bitrate
        else:
            self.clock = _loop_of(loop)
            self.bitrate, self.data_bitrate = bitrate or 1_000_000, None
        self.name = name or getattr(bus, "name", "") or "can"
        self._inbox: Any = None

    def open(self, received: Handler) -> None:
        """Begin to hear."""
        if isinstance(self._bus, SimulatedBus):
            self.node = self._bus.attach(
                self.name, received, self._happened, mailboxes=4096, restart_ns=RESTART
            )
            self.node.hears_sent = False
            self._send: Callable[..., bool] = _on_wire(self.node)
            return
        loop, handle = self.clock, received

        def heard(items: list[Received]) -> None:
            def hand_over() -> None:
                for item in items:
                    handle(_nameless(item.frame), item.host_ns)

            loop.call_soon(hand_over)

        self._send = _sender(self._bus, loop)
        self._bus.__enter__()
        self._inbox = self._bus.listen(heard)

    def on_event(self, handler: BusHandler) -> None:
        """Call `handler(kind, detail)` on the clock's thread with what happens to the bus."""
        self._handler = handler
        if isinstance(self._bus, CanGate):
            _forward(self._bus, self.clock, handler)

    def _happened(self, event: SimulatedBusEvent) -> None:
        if self._handler is not None and event.kind in STATES:
            self._handler(event.kind, "")

    def send(
        self,
        word: Frame,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Told | None = None,
    ) -> bool:
        """Send a frame; False when it cannot be (mailboxes full, bus-off, lost). See `aces_bus.device.port.Port`."""
        return self._send(word, age_ns, urgent, topic, report)

    def wire_ns(self, word: Frame) -> int:
        """How long a frame occupies the bus at most, its intermission included."""
        key = (len(word.data), word.is_extended_id, word.is_fd)
        known = self._costs.get(key)
        if known is None:
            known = self._costs[key] = self._cost(word)
        return known

    def _cost(self, word: Frame) -> int:
        """The longest that a frame of this length can be: stuffed as much as can be (CAN), or as it is (FD)."""
        if not word.is_fd:
            stuffed = (54 if word.is_extended_id else 34) + 8 * len(word.data)
            end = 10 + INTERMISSION  # delimiters, acknowledgement, end of frame
            return (stuffed + (stuffed - 1) // 4 + end) * 1_000_000_000 // self.bitrate
        pause = INTERMISSION * 1_000_000_000 // self.bitrate
        return frame_bits(word).duration_ns(self.bitrate, self.data_bitrate) + pause

    def close(self) -> None:
        """Hear no more; a gate is stopped."""
        if isinstance(self._bus, SimulatedBus):
            self._bus.detach(self.node)
        else:
            if self._inbox is not None:
                self._inbox.inbox.close()
            self._bus.stop()


class SerialPort:
    """A serial line: a node on a `SimulatedSerialLine`, or a `SerialGate` with its `Loop`."""

    link: Literal["serial"] = "serial"

    def __init__(
        self,
        line: SimulatedSerialLine | SerialGate,
        loop: Loop | None = None,
        *,
        name: str = "",
        baud: int | None = None,
        half_duplex: bool | None = None,
    ) -> None:
        self._line = line
        if isinstance(line, SimulatedSerialLine):
            self.clock: EventClock = line.clock
            self.baud, self.half_duplex = line.baud, line.half_duplex
        else:
            self.clock = _loop_of(loop)
            self.baud = baud or 115_200
            self.half_duplex = bool(half_duplex)
        self.name = name or getattr(line, "name", "") or "serial"
        self._inbox: Any = None

    def open(self, received: Handler) -> None:
        """Begin to hear."""
        if isinstance(self._line, SimulatedSerialLine):
            # An adapter for half-duplex lines takes its own echo out.
            self.node = self._line.attach(self.name, received, echo=False, whole=True)
            return
        loop, handle = self.clock, received

        def heard(items: list[ReceivedBytes]) -> None:
            def hand_over() -> None:
                for item in items:
                    handle(item.data, item.host_ns)

            loop.call_soon(hand_over)

        self._send = _sender(self._line, loop)
        self._line.__enter__()
        self._inbox = self._line.listen(heard)

    def on_event(self, handler: BusHandler) -> None:
        """Call `handler(kind, detail)` on the clock's thread with what happens to the line."""
        if isinstance(self._line, SerialGate):
            _forward(self._line, self.clock, handler)

    def send(
        self,
        word: bytes,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Told | None = None,
    ) -> bool:
        """Send bytes; False when they cannot be (the line is lost, too much waits). See `aces_bus.device.port.Port`."""
        if isinstance(self._line, SimulatedSerialLine):
            end = self.node.send(word)
            if report is not None:
                self.clock.call_at(end, lambda: report("sent", ""))
            return True
        return self._send(word, age_ns, urgent, topic, report)

    def wire_ns(self, word: bytes) -> int:
        """How long bytes occupy the line."""
        return len(word) * BITS * 1_000_000_000 // self.baud

    def close(self) -> None:
        """Hear no more; a gate is stopped."""
        if isinstance(self._line, SimulatedSerialLine):
            self.node.is_connected = False
            if self.node in self._line.nodes:
                self._line.nodes.remove(self.node)
        else:
            if self._inbox is not None:
                self._inbox.inbox.close()
            self._line.stop()


class DatagramPort:
    """Datagrams: a node on a `SimulatedDatagrams`, or a `DatagramGate` with its `Loop`. They cost no time worth counting."""

    link: Literal["datagram"] = "datagram"
    half_duplex = False

    def __init__(
        self, network: SimulatedDatagrams | DatagramGate, loop: Loop | None = None, *, name: str = ""
    ) -> None:
        self._network = network
        self.clock: EventClock = network.clock if isinstance(network, SimulatedDatagrams) else _loop_of(loop)
        self.name = name or getattr(network, "name", "") or "udp"
        self._inbox: Any = None
        self._last_source: tuple[str, int] | None = None

    def open(self, received: Handler) -> None:
        """Begin to hear."""
        if isinstance(self._network, SimulatedDatagrams):
            self.node = self._network.attach(self.name, received)
            return
        loop, handle = self.clock, received

        def heard(items: list[Datagram]) -> None:
            def hand_over() -> None:
                for item in items:
                    self._last_source = item.source
                    handle(item.data, item.host_ns)

            loop.call_soon(hand_over)

        self._send = _sender(self._network, loop)
        self._network.__enter__()
        self._inbox = self._network.listen(heard)

    def on_event(self, handler: BusHandler) -> None:
        """Call `handler(kind, detail)` on the clock's thread with what happens to the socket."""
        if isinstance(self._network, DatagramGate):
            _forward(self._network, self.clock, handler)

    def send(
        self,
        word: bytes,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Told | None = None,
    ) -> bool:
        """Send a datagram: to the peer, or to whom was heard last; False when there is neither. See `Port`."""
        if isinstance(self._network, SimulatedDatagrams):
            self.node.send(word)
            if report is not None:
                report("sent", "")
            return True
        to = self._network.peer or self._last_source
        if to is None:
            return False
        return self._send(word, age_ns, urgent, topic, report, to)

    def wire_ns(self, word: bytes) -> int:
        """Nothing worth counting."""
        return 0

    def close(self) -> None:
        """Hear no more; a gate is stopped."""
        if isinstance(self._network, SimulatedDatagrams):
            if self.node in self._network.nodes:
                self._network.nodes.remove(self.node)
        else:
            if self._inbox is not None:
                self._inbox.inbox.close()
            self._network.stop()


def _sender(gate: CanGate | SerialGate | DatagramGate, clock: EventClock) -> Callable[..., bool]:
    """What sends through a gate; False: it does not take the word.

    On a bus that is lost words do not wait, but for stops: sent when it is back, an old set-point would move a robot.
    """
    send: Callable[..., bool] = gate.send

    def on_clock(report: Told) -> Told:
        return lambda fate, why: clock.call_soon(lambda: report(fate, why))

    def give(word: Any, age_ns: int, urgent: bool, topic: object, report: Told | None, *to: Any) -> bool:
        if gate.state != "open" and not urgent:
            return False
        try:
            return send(
                word,
                *to,
                age_s=age_ns / 1e9 if age_ns else None,
                urgent=urgent,
                topic=topic,
                report=None if report is None else on_clock(report),
            )
        except CallerError:  # too much waits already, or not of this bus's kind
            return False

    return give


def _on_wire(node: BusNode) -> Callable[..., bool]:
    """What sends from a simulated node, whose frames wait in its mailboxes as in a controller's."""
    send = node.send

    def give(word: Frame, age_ns: int, urgent: bool, topic: object, report: Told | None) -> bool:
        return send(word) if report is None else send(word, report, age_ns or LEAVES)

    return give


def port_of(bus: Any, loop: Loop | None = None, **options: Any) -> Any:
    """The port of a wire or gate of any kind; options are those of the port. Raises `CallerError` for anything else."""
    if isinstance(bus, (SimulatedBus, CanGate)):
        return CanPort(bus, loop, **options)
    if isinstance(bus, (SimulatedSerialLine, SerialGate)):
        return SerialPort(bus, loop, **options)
    if isinstance(bus, (SimulatedDatagrams, DatagramGate)):
        return DatagramPort(bus, loop, **options)
    raise CallerError(f"a {type(bus).__name__} is neither a wire nor a gate")


def _nameless(frame: Frame) -> Frame:
    """A frame without its channel's name: what is sent has none, and answers belong to requests of the same channel."""
    return frame if frame.channel is None else replace(frame, channel=None)


def _forward(gate: Any, clock: EventClock, handler: BusHandler) -> None:
    """A gate's events, from its threads to the loop."""

    def told(event: BusEvent) -> None:
        clock.call_soon(lambda: handler(event.kind, event.detail))

    gate.on_event(told)


def _loop_of(loop: Loop | None) -> Loop:
    if loop is None:
        raise CallerError("a gate needs a Loop that its words are handed to")
    return loop
