"""What happens to a bus, and what is counted of it.

1. A handler is called on the thread where something happens, before anything else is done about it, and must be quick.
2. One that raises is counted, and stops nothing.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import msgspec

Kind = Literal[
    "opened",
    "lost",
    "reopened",
    "closed",
    "error-active",
    "error-passive",
    "bus-off",
    "dropped",
    "clock",
    "bad input",
    "listener",
    "send failed",
    "not sent",
    "stalled",
]


class BusEvent(msgspec.Struct, frozen=True):
    """Something that happened to a bus.

    `kind`: "opened"; "lost" (unplugged, the server is gone); "reopened"; "closed"; "error-active", "error-passive" and
    "bus-off" (the controller's state); "dropped" (frames lost: `count` of them, `detail` says where); "clock" (the adapter's
    stamps went back); "bad input" (the adapter said what cannot be understood); "listener" (one raised: its exception in
    `detail`); "send failed" (the backend refused a packet); "not sent" (`count` frames, bytes or datagrams were too old,
    given to a lost bus, overtaken by a stop, or left over at the end: `detail` says which); "stalled" (the adapter did not
    take `count` of those whose age their sender has said, such as polls, in time). `time_ns` is the host's
    monotonic clock, `bus` the name of the gate.
    """

    kind: Kind
    time_ns: int
    bus: str
    detail: str = ""
    count: int = 0

    def __str__(self) -> str:
        return f"{self.bus}: {self.kind}" + (f": {self.detail}" if self.detail else "")


Handler = Callable[[BusEvent], None]


class BusEvents:
    """The handlers of one bus. `failures` counts what they raised."""

    def __init__(self) -> None:
        self._handlers: tuple[Handler, ...] = ()
        self._lock = threading.Lock()
        self.failures = 0

    def add(self, handler: Handler) -> None:
        """Call `handler` with every event from now on."""
        with self._lock:
            self._handlers += (handler,)

    def remove(self, handler: Handler) -> None:
        """Do not call it any more."""
        with self._lock:
            self._handlers = tuple(known for known in self._handlers if known is not handler)

    def emit(self, event: BusEvent) -> None:
        """Call all handlers, whatever they do."""
        for handler in self._handlers:
            try:
                handler(event)
            except KeyboardInterrupt:  # the user's, and only on the main thread
                raise
            except BaseException:  # whatever a handler may raise, SystemExit too: rule 2
                self.failures += 1


@dataclass
class GateCounters:
    """What went through a gate, and what did not: frames of CAN, bytes of a serial line, datagrams.

    `dropped` came faster than a reader took it. `kernel_dropped` is what the system says it dropped before we could read.
    `bad_input` counts what an adapter sent that cannot be understood, `echoes` what a backend returned of our own, unasked.

    Of what was `given` to be sent, each is in one of `sent`, `send_failed` (the backend refused it), `send_expired` (too
    old), `send_dropped` (the bus was lost, or a stop overtook it) and `unsent` (left over at the end), or still waits.
    """

    received: int = 0
    given: int = 0
    sent: int = 0
    send_failed: int = 0
    send_expired: int = 0
    send_dropped: int = 0
    unsent: int = 0
    dropped: int = 0
    kernel_dropped: int = 0
    bad_input: int = 0
    echoes: int = 0
    reopened: int = 0

    @property
    def not_sent(self) -> int:
        """Number of items that were given and will never be sent."""
        return self.send_failed + self.send_expired + self.send_dropped + self.unsent

    @property
    def pending(self) -> int:
        """Number of items that were given and have no fate yet."""
        return self.given - self.sent - self.not_sent
