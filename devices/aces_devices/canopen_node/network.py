"""canopen's network on a station of ours: what it sends goes through a function, what repeats runs on our clock.

1. No thread and no bus of its own: the same node lives in virtual time and in real time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from canopen.network import Network

from aces_bus.runtime.clock import EventClock


class Periodic:
    """A message that repeats, as canopen wants its tasks."""

    def __init__(
        self, clock: EventClock, period: float, send: Callable[[bytes], object], data: bytes
    ) -> None:
        self._clock, self._send, self.data = clock, send, bytes(data)
        self._period = max(1_000_000, round(period * 1e9))
        self._timer = clock.call_in(self._period, self._again)

    def _again(self) -> None:
        self._send(self.data)
        self._timer = self._clock.call_in(self._period, self._again)

    def update(self, data: Any) -> None:
        """Send this from now on."""
        self.data = bytes(data)

    def stop(self) -> None:
        """Send no more."""
        self._timer.cancel()


class StationNetwork(Network):
    """A network whose bus is a function `send(identifier, data)`."""

    def __init__(self, clock: EventClock, send: Callable[[int, bytes], object]) -> None:
        super().__init__(None)
        self._clock, self._put = clock, send
        self.repeated: list[Periodic] = []

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send."""
        if not remote:
            self._put(can_id, bytes(data))

    def send_periodic(self, can_id: int, data: Any, period: float, remote: bool = False) -> Any:
        """Send again and again."""
        task = Periodic(
            self._clock, period, lambda now: self.send_message(can_id, now, remote), bytes(data or b"")
        )
        self.repeated.append(task)
        return task

    def stop(self) -> None:
        """End all that repeats."""
        for task in self.repeated:
            task.stop()
        self.repeated.clear()
