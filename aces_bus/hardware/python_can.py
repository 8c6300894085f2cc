"""python-can's side: what the virtual buses of this process and of others have in common.

1. A queue that is full drops its oldest frames and counts them.
2. What cannot be sent is a `CanOperationError` that says why.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from can import BusABC, BusState, CanOperationError, CanProtocol, Message

from .simulated.bus_event import SimulatedBusEvent

#: Frames a receiver may leave unread; after that the oldest is dropped and counted.
QUEUE = 65_536

_STATES = {
    "error-active": BusState.ACTIVE,
    "recovered": BusState.ACTIVE,
    "error-passive": BusState.PASSIVE,
    "bus-off": BusState.ERROR,
}


class VirtualBus(BusABC):
    """What a node on a virtual bus of this process (`AcesBus`) and of another one (`ServedBus`) have in common."""

    def __init__(
        self,
        channel: str,
        channel_info: str,
        can_filters: Any,
        *,
        fd: bool,
        listen_only: bool,
        rx_queue_size: int,
        **more: Any,
    ) -> None:
        self.channel, self.channel_info = channel, channel_info
        self._fd, self._listen_only = bool(fd), bool(listen_only)
        #: Messages, or what `_next` makes them of.
        self._queue: deque[Any] = deque()
        self._most = int(rx_queue_size) or QUEUE
        #: Frames lost because they were not read in time.
        self.dropped = 0
        #: Grows whenever something of it has changed beside its queue: frames were lost, its state is another.
        self.changes = 0
        #: What happened to this node, the last 1,024 events.
        self.events: deque[SimulatedBusEvent] = deque(maxlen=1024)
        #: Called with each event where it happens; it must not block.
        self.on_event: Callable[[SimulatedBusEvent], None] | None = None
        #: Why the bus cannot be used any more; empty while it can.
        self._why = ""
        self._can_protocol = CanProtocol.CAN_FD if fd else CanProtocol.CAN_20
        super().__init__(channel, can_filters, **more)

    def _unusable(self) -> CanOperationError:
        return CanOperationError(f"{self.channel_info} {self._why}")

    def _refusal(self) -> CanOperationError:
        """Say why a message is not sent by a bus that has `_why`, only listens, or does not take CAN FD."""
        if self._why:
            return self._unusable()
        if self._listen_only:
            return CanOperationError(f"{self.channel_info} was opened to listen only")
        return CanOperationError(f"{self.channel_info} was not opened for CAN FD; open it with fd=True")

    def _untaken(self, state: str) -> CanOperationError:
        """Say why the node took no frame."""
        why = "is bus-off" if state == "bus-off" else "has no free mailbox; does no node acknowledge?"
        return CanOperationError(f"{self.channel_info} {why}")

    def _keep(self, message: Any) -> None:
        queue = self._queue
        if len(queue) >= self._most:
            queue.popleft()
            self.dropped += 1
            self.changes += 1
        queue.append(message)

    def _next(self) -> Message | None:
        """Return the next message in the queue that passes the filters."""
        queue = self._queue
        while queue:
            try:
                message: Message = queue.popleft()
            except IndexError:  # another thread was quicker
                break
            if self._filters is None or self._matches_filters(message):
                return message
        return None

    def _note(self, event: SimulatedBusEvent) -> None:
        self.events.append(event)
        self.changes += 1
        if self.on_event is not None:
            self.on_event(event)

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        return self.recv(timeout), True

    def _apply_filters(self, filters: Any) -> None:
        """Do nothing: filters are applied on reading."""

    def _node_state(self) -> str:
        raise NotImplementedError

    @property
    def state(self) -> BusState:
        """Error active, passive or bus-off."""
        return _STATES[self._node_state()]

    @state.setter
    def state(self, new_state: BusState) -> None:
        raise NotImplementedError(
            "the state is what the bus makes of the node; open it with listen_only, or restart it"
        )


__all__ = ["QUEUE", "VirtualBus"]
