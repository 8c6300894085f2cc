"""What happens to a bus besides frames: the paper's shortcut from the hardware to whoever must know at once.

1. A handler is called on the thread where it happens, before anything else is done about it. It must be quick.
2. A handler that raises is counted and heard no less: nothing that a handler does can stop a bus.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
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
]


class BusEvent(msgspec.Struct, frozen=True):
    """Something that happened to a bus.

    `kind`: "opened"; "lost" (unplugged, the server is gone); "reopened"; "closed"; "error-active", "error-passive" and
    "bus-off" (the controller's state); "dropped" (frames lost: `count` of them, `detail` says where); "clock" (the adapter's
    stamps went back); "bad input" (the adapter said what cannot be understood); "listener" (one raised: its exception in
    `detail`); "send failed" (the backend refused a word); "not sent" (`count` frames, bytes or datagrams were too old, were
    given to a lost bus, overtaken by a stop, or left over at the end: `detail` says which). `time_ns` is the host's
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
            self._handlers = tuple(one for one in self._handlers if one is not handler)

    def tell(self, event: BusEvent) -> None:
        """Call all handlers, whatever they do."""
        for handler in self._handlers:
            try:
                handler(event)
            except KeyboardInterrupt:  # the user's, and only on the main thread
                raise
            except BaseException:  # whatever a handler may raise, SystemExit too: rule 2
                self.failures += 1
