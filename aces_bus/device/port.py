"""What the device floor needs of any bus: receiving, sending, a clock, and what a frame or packet costs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, Protocol, TypeAlias

from ..frames import Frame
from ..runtime.clock import EventClock

#: What a bus carries as one: a frame, the frames that a transport cut a message into, or the bytes of a message.
Packet: TypeAlias = Frame | bytes | tuple[Frame, ...]

#: Called with what became of a frame or packet, and why.
Left = Callable[[str, str], object]


class Port(Protocol):
    """One bus; `aces_bus.hardware.port_of` makes one of any wire or gate.

    A packet is a frame (CAN; several that a transport cut it into are a tuple) or bytes."""

    @property
    def link(self) -> Literal["can", "serial", "datagram"]:
        """Kind of traffic: frames, bytes or datagrams."""
        ...

    @property
    def clock(self) -> EventClock:
        """The clock of the instants that `received` gets, and of its thread."""
        ...

    @property
    def name(self) -> str:
        """Its name in events."""
        ...

    @property
    def half_duplex(self) -> bool:
        """True if all share one wire, and a request waits until the one before was answered or timed out."""
        ...

    def open(self, received: Callable[[Any, int], Any]) -> None:
        """Start receiving: `received(packet, instant)`."""
        ...

    def on_event(self, handler: Callable[[str, str], object]) -> None:
        """Call `handler(kind, detail)` on the clock's thread with what happens to the bus."""
        ...

    def send(
        self,
        packet: Any,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Left | None = None,
    ) -> bool:
        """Send a packet; False when the bus does not take it.

        One that has not left after `age_ns` does not leave (0: the bus's own limit). `urgent`: a stop, which goes before
        all others, instead of those that wait with the same `topic`, and waits for a bus that is lost. `report(fate, why)`
        is called once, on the clock's thread, with what became of it: "sent", or why not (see `aces_bus.hardware.queues`).
        """
        ...

    def wire_ns(self, packet: Any, /) -> int:
        """Return how long a packet occupies the bus (ns)."""
        ...

    def close(self) -> None:
        """Stop receiving."""
        ...


class UpperPort:
    """What a port that stands above another one has of it."""

    def __init__(self, port: Port) -> None:
        self.port = port

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

    def on_event(self, handler: Callable[[str, str], object]) -> None:
        """Pass the handler on to the port below."""
        self.port.on_event(handler)

    def wire_ns(self, packet: Any) -> int:
        """Return what the port below says."""
        return self.port.wire_ns(packet)

    def close(self) -> None:
        """Stop receiving."""
        self.port.close()
