"""A port that is looked at: what passes it is shown to who looks on, and is otherwise as it was."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .port import Left, Packet, Port, UpperPort

#: Called with a frame or piece of bytes, the instant (ns), and whether it was sent from here. Must not block.
Passed = Callable[[Any, int, bool], Any]


class WatchedPort(UpperPort):
    """A port below, and `passed` for each frame or piece of bytes that it receives or takes to send."""

    def __init__(self, port: Port, passed: Passed) -> None:
        super().__init__(port)
        self._passed = passed

    def open(self, received: Callable[[Any, int], Any]) -> None:
        """Start receiving."""
        passed = self._passed

        def both(packet: Packet, instant: int) -> None:
            passed(packet, instant, False)
            received(packet, instant)

        self.port.open(both)

    def send(
        self,
        packet: Any,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Left | None = None,
    ) -> bool:
        """Send on the port below."""
        is_taken = self.port.send(packet, age_ns, urgent=urgent, topic=topic, report=report)
        if is_taken:
            self._passed(packet, self.port.clock.now(), True)
        return is_taken
