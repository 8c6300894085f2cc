"""Ports: any bus as the device floor wants it, one way in, one way out, and what a packet costs on the wire.

1. `received` is called on the clock's own thread (virtual or `Loop`), one packet at a time: nothing above needs a lock.
2. A port is of one bus; who may listen only does so through a gate that cannot send.

A wire is simulated and needs no thread; a gate is served by the loop, with threads only for what may block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from threading import get_ident
from typing import Any, Generic, Literal, TypeVar, overload

from msgspec.structs import replace

from ..errors import CallerError
from ..frames import Frame
from ..runtime.clock import EventClock
from ..runtime.loop import Loop
from .can import CanGate, not_allowed
from .datagram import DatagramGate
from .gate import ContentFilter, Gate, Received
from .gate_events import BusEvent
from .lock import BusLock
from .queues import AGE_S
from .serial import SerialGate
from .simulated.bus import SimulatedBus
from .simulated.bus_event import SimulatedBusEvent
from .simulated.datagrams import SimulatedDatagrams
from .simulated.frame_time import INTERMISSION, longest_bits
from .simulated.serial_line import BITS, SimulatedSerialLine

Packet = TypeVar("Packet")
Sent = TypeVar("Sent")
Bus = TypeVar("Bus")
Wire = SimulatedBus | SimulatedSerialLine | SimulatedDatagrams
AnyGate = CanGate | SerialGate | DatagramGate
#: Called with what became of a packet ("sent", "failed", "expired", "dropped", "unsent"), and why.
SendReport = Callable[[str, str], object]
#: Called with what happens to a bus: kind ("bus-off", "lost", "reopened" …) and details.
BusHandler = Callable[[str, str], object]
#: What is reported of a simulated node; the others ("bit error", "no acknowledge") come by thousands, and are counted.
STATES = ("error-active", "error-passive", "bus-off", "recovered")
#: How long after bus-off a simulated station comes back (ns): SocketCAN's usual restart-ms, and what boards do.
RESTART_NS = 100_000_000
#: How long a frame whose sender wants to know may wait in a simulated node's mailbox (ns).
MAILBOX_AGE_NS = round(AGE_S * 1e9)


class BasePort(Generic[Packet]):
    """What ports of all kinds have in common. `_send` is set when a port is opened; a gate's packets go to its `Loop`."""

    def __init__(self, bus: Wire | AnyGate, loop: Loop | None, name: str) -> None:
        self._gate = bus if isinstance(bus, Gate) else None
        self.clock: EventClock = _loop_of(loop) if isinstance(bus, Gate) else bus.clock
        self.name = name
        self._send: Callable[..., bool]

    def _listen(self, gate: Gate[Packet, Sent, Bus], handle: Callable[[Packet, int], None]) -> None:
        """Open a gate, and have `handle` called on the clock's thread with what it receives."""
        clock = self.clock
        assert isinstance(clock, Loop)
        # The method's place is taken by the closure: one call less a packet.
        self.__dict__["send"] = _sender(gate, clock)

        hand_over = self._hand_over

        def take(items: Iterable[Received[Packet]]) -> None:
            left = iter(items)
            try:
                hand_over(left, handle)
            except (
                BaseException
            ):  # a driver's: the loop reports it, and the packets behind it are read all the same
                clock.call_soon(lambda: take(left))
                raise

        gate.start_on(clock, take)

    def _hand_over(self, items: Iterator[Received[Packet]], handle: Callable[[Packet, int], None]) -> None:
        for item in items:
            handle(item.content, item.host_ns)

    def on_event(self, handler: BusHandler) -> None:
        """Call `handler(kind, detail)` on the clock's thread with what happens to the bus."""
        clock = self.clock

        def happened(event: BusEvent) -> None:
            clock.call_soon(lambda: handler(event.kind, event.detail))

        if self._gate is not None:
            self._gate.on_event(happened)

    def send(
        self,
        packet: Packet,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: SendReport | None = None,
    ) -> bool:
        """Send a frame, bytes or a datagram; False when it cannot be sent. See `aces_bus.device.port.Port`."""
        return self._send(packet, age_ns, urgent, topic, report)

    @property
    def lock(self) -> BusLock | None:
        """The lock of who drives the bus; None: it has none."""
        return None if self._gate is None else self._gate.lock

    def close(self) -> None:
        """Receive no more; a gate is stopped."""
        if self._gate is None:
            self._detach()
        else:
            self._gate.stop()

    def _detach(self) -> None:
        """Take the node off its simulated bus."""
        raise NotImplementedError


class CanPort(BasePort[Frame]):
    """A CAN bus: a node on a `SimulatedBus`, or a `CanGate` with the `Loop` that its frames are handed to.

    `allow`: which frames the node may send at all (None: all); a gate has its own. With a `data_bitrate` (bit/s; of a
    `SimulatedBus` its own) CAN FD frames are sent with the bit-rate switch.
    """

    link: Literal["can"] = "can"
    half_duplex = False

    def __init__(
        self,
        bus: SimulatedBus | CanGate,
        loop: Loop | None = None,
        *,
        name: str = "",
        bitrate: int | None = None,
        data_bitrate: int | None = None,
        allow: ContentFilter[Frame] | None = None,
    ) -> None:
        super().__init__(bus, loop, name or getattr(bus, "name", "") or "can")
        if allow is not None and not isinstance(bus, SimulatedBus):
            raise CallerError(f"{self.name}: what may be sent is its gate's to know: CanGate(allow=…)")
        self._bus, self._allow = bus, allow
        self._handler: BusHandler | None = None
        self._costs: dict[int | tuple[int, bool, bool, bool], int] = {}
        self.bitrate, self.data_bitrate = bitrate or 1_000_000, data_bitrate
        if isinstance(bus, SimulatedBus):
            self.bitrate, self.data_bitrate = bus.bitrate, bus.data_bitrate

    def open(self, received: Callable[[Frame, int], None]) -> None:
        """Begin to receive."""
        if not isinstance(self._bus, SimulatedBus):
            self._listen(self._bus, received)
            if self.data_bitrate is not None:
                self.__dict__["send"] = _switching(self.__dict__["send"])
            return
        self.node = self._bus.attach(
            self.name, received, self._happened, mailboxes=4096, restart_ns=RESTART_NS
        )
        self.node.hears_sent = False
        send, allow = self.node.send, self._allow

        def give(
            frame: Frame,
            age_ns: int = 0,
            *,
            urgent: bool = False,
            topic: object = None,
            report: SendReport | None = None,
        ) -> bool:
            if allow is not None and not allow.matches(frame):
                if self._handler is not None:
                    self._handler("not sent", not_allowed(frame))
                return False
            # Its frames wait in its mailboxes, as in a controller's.
            return send(frame) if report is None else send(frame, report, age_ns or MAILBOX_AGE_NS)

        # As of a gate's port: one call less a frame.
        self.__dict__["send"] = give if self.data_bitrate is None else _switching(give)

    def _hand_over(self, items: Iterator[Received[Frame]], handle: Callable[[Frame, int], None]) -> None:
        # Without its channel's name: what is sent has none, and answers belong to requests of the same channel.
        for item in items:
            frame = item.content
            handle(frame if frame.channel is None else replace(frame, channel=None), item.host_ns)

    def on_event(self, handler: BusHandler) -> None:
        """Call `handler(kind, detail)` on the clock's thread with what happens to the bus."""
        self._handler = handler
        super().on_event(handler)

    def _happened(self, event: SimulatedBusEvent) -> None:
        if self._handler is not None and event.kind in STATES:
            self._handler(event.kind, "")

    def switches(self, frame: Frame) -> bool:
        """Return whether a frame leaves with its data at the data bit rate."""
        return frame.bitrate_switch or (frame.is_fd and self.data_bitrate is not None)

    def wire_ns(self, frame: Frame) -> int:
        """Return how long a frame occupies the bus at most, its intermission included."""
        key = (
            (len(frame.data), frame.is_extended_id, frame.is_fd, frame.bitrate_switch)
            if frame.is_extended_id or frame.is_fd
            else len(frame.data)
        )
        known = self._costs.get(key)
        if known is None:
            known = self._costs[key] = self._cost(frame)
        return known

    def _cost(self, frame: Frame) -> int:
        """Return the longest that a frame of this length can be: stuffed as much as can be."""
        bits = longest_bits(
            len(frame.data),
            extended=frame.is_extended_id,
            fd=frame.is_fd,
            bitrate_switch=self.switches(frame),
        )
        pause = INTERMISSION * 1_000_000_000 // self.bitrate
        return bits.duration_ns(self.bitrate, self.data_bitrate) + pause

    def _detach(self) -> None:
        self.node.wire.detach(self.node)


def _switching(send: Callable[..., bool]) -> Callable[..., bool]:
    """Return a way to send that sets the bit-rate switch of CAN FD frames."""

    def give(frame: Frame, *rest: Any, **more: Any) -> bool:
        return send(replace(frame, bitrate_switch=True) if frame.is_fd else frame, *rest, **more)

    return give


class SerialPort(BasePort[bytes]):
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
        super().__init__(line, loop, name or getattr(line, "name", "") or "serial")
        self._line = line
        self.baud, self.half_duplex = baud or 115_200, bool(half_duplex)
        if isinstance(line, SimulatedSerialLine):
            self.baud, self.half_duplex = line.baud, line.half_duplex

    def open(self, received: Callable[[bytes, int], None]) -> None:
        """Begin to receive."""
        if not isinstance(self._line, SimulatedSerialLine):
            self._listen(self._line, received)
            return
        # An adapter for half-duplex lines takes its own echo out.
        self.node = self._line.attach(self.name, received, echo=False, whole=True)

        def give(packet: bytes, age_ns: int, urgent: bool, topic: object, report: SendReport | None) -> bool:
            end = self.node.send(packet)
            if report is not None:
                self.clock.call_at(end, lambda: report("sent", ""))
            return True

        self._send = give

    def wire_ns(self, packet: bytes) -> int:
        """Return how long bytes occupy the line."""
        return len(packet) * BITS * 1_000_000_000 // self.baud

    def _detach(self) -> None:
        self.node.is_connected = False
        if self.node in self.node.wire.nodes:
            self.node.wire.nodes.remove(self.node)


class DatagramPort(BasePort[bytes]):
    """Datagrams: a node on `SimulatedDatagrams`, or a `DatagramGate` with its `Loop`. They occupy no line.

    What is sent goes to the gate's peer, or to who sent last; it is refused while there is neither.
    """

    link: Literal["datagram"] = "datagram"
    half_duplex = False

    def __init__(
        self, network: SimulatedDatagrams | DatagramGate, loop: Loop | None = None, *, name: str = ""
    ) -> None:
        super().__init__(network, loop, name or getattr(network, "name", "") or "udp")
        self._network = network
        self._last_source: tuple[str, int] | None = None

    def open(self, received: Callable[[bytes, int], None]) -> None:
        """Begin to receive."""
        network = self._network
        if isinstance(network, SimulatedDatagrams):
            self.node = network.attach(self.name, received)

            def give(
                datagram: bytes, age_ns: int, urgent: bool, topic: object, report: SendReport | None
            ) -> bool:
                self.node.send(datagram)
                if report is not None:
                    report("sent", "")
                return True

            self._send = give
            return
        self._listen(network, received)
        send: Callable[..., bool] = self.send

        def answer(datagram: bytes, age_ns: int = 0, **more: Any) -> bool:
            to = network.peer or self._last_source
            return to is not None and send(datagram, age_ns, to=to, **more)

        self.__dict__["send"] = answer

    def _hand_over(self, items: Iterator[Received[bytes]], handle: Callable[[bytes, int], None]) -> None:
        for item in items:
            self._last_source = item.source
            handle(item.content, item.host_ns)

    def wire_ns(self, datagram: bytes) -> int:
        """Return 0: nothing worth counting."""
        return 0

    def _detach(self) -> None:
        if self.node in self.node.wire.nodes:
            self.node.wire.nodes.remove(self.node)


def _sender(gate: Any, clock: Loop) -> Callable[..., bool]:
    """Return what sends through a gate; False: it does not take the packet.

    On a bus that is lost packets do not wait, but for stops: sent when it is back, an old set-point would move a robot.
    """
    send = gate.send

    def on_clock(report: SendReport) -> SendReport:
        return lambda fate, why: clock.call_soon(lambda: report(fate, why))

    def give(
        packet: Any,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: SendReport | None = None,
        **to: Any,
    ) -> bool:
        if gate.state != "open" and not urgent:
            return False
        try:
            is_taken: bool = send(
                packet,
                age_s=age_ns / 1e9 if age_ns else None,
                urgent=urgent,
                topic=topic,
                report=None if report is None else on_clock(report),
                **to,
            )
            return is_taken
        except CallerError:  # too much waits already, or not of this bus's kind
            return False

    if not isinstance(gate, CanGate):
        return give
    usual = gate.give

    def give_quick(
        packet: Any,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: SendReport | None = None,
    ) -> bool:
        if not urgent and report is None and clock.own_thread == get_ident():
            return usual(packet, age_ns, topic)
        return give(packet, age_ns, urgent=urgent, topic=topic, report=report)

    return give_quick


@overload
def port_of(bus: SimulatedBus | CanGate, loop: Loop | None = None, **options: Any) -> CanPort: ...
@overload
def port_of(
    bus: SimulatedSerialLine | SerialGate, loop: Loop | None = None, **options: Any
) -> SerialPort: ...
@overload
def port_of(
    bus: SimulatedDatagrams | DatagramGate, loop: Loop | None = None, **options: Any
) -> DatagramPort: ...
@overload
def port_of(
    bus: Wire | AnyGate, loop: Loop | None = None, **options: Any
) -> CanPort | SerialPort | DatagramPort: ...
def port_of(bus: object, loop: Loop | None = None, **options: Any) -> CanPort | SerialPort | DatagramPort:
    """Return the port of a wire or gate of any kind; options are those of the port. Raises `CallerError` for anything
    else.
    """
    if isinstance(bus, (SimulatedBus, CanGate)):
        return CanPort(bus, loop, **options)
    if isinstance(bus, (SimulatedSerialLine, SerialGate)):
        return SerialPort(bus, loop, **options)
    if isinstance(bus, (SimulatedDatagrams, DatagramGate)):
        return DatagramPort(bus, loop, **options)
    raise CallerError(f"a {type(bus).__name__} is neither a wire nor a gate")


def _loop_of(loop: Loop | None) -> Loop:
    if loop is None:
        raise CallerError("a gate needs a Loop that its packets are handed to")
    return loop
