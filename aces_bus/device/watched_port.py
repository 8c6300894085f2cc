"""A port that is looked at: what passes it is shown to who looks on, and is otherwise as it was."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from ..runtime import EventClock
from .port import Left, Port

#: Called with a frame or piece of bytes, the instant (ns), and whether it was sent from here. Must not block.
Passed = Callable[[Any, int, bool], Any]


class WatchedPort:
    """A port below, and `passed` for each frame or piece of bytes that it receives or takes to send."""

    def __init__(self, port: Port, passed: Passed) -> None:
        self.port, self._passed = port, passed

    @property
    def link(self) -> Literal["can", "serial", "datagram"]:
        """As of the port below; likewise its clock, name and half_duplex."""
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
        """Start receiving."""
        passed = self._passed

        def both(packet: Any, instant: int) -> None:
            passed(packet, instant, False)
            received(packet, instant)

        self.port.open(both)

    def on_event(self, handler: Callable[[str, str], Any]) -> None:
        """As of the port below."""
        self.port.on_event(handler)

    def send(
        self,
        packet: Any,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Left | None = None,
    ) -> bool:
        """As of the port below."""
        is_taken = self.port.send(packet, age_ns, urgent=urgent, topic=topic, report=report)
        if is_taken:
            self._passed(packet, self.port.clock.now(), True)
        return is_taken

    def wire_ns(self, packet: Any) -> int:
        """As of the port below."""
        return self.port.wire_ns(packet)

    def close(self) -> None:
        """Stop receiving."""
        self.port.close()
