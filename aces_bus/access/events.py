"""What happens to those who look in from outside."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import msgspec


class AccessEvent(msgspec.Struct, frozen=True):
    """`kind` is "lost" (nothing comes any more), "back", "restarted" (another run answers) or "refused" (a set-point that
    cannot be); `instant` in ns of a local clock, `source` who it is about, `detail` for people."""

    kind: str
    instant: int
    source: str
    detail: str = ""

    def __str__(self) -> str:
        return f"{self.source}: {self.kind}" + (f": {self.detail}" if self.detail else "")


Listener = Callable[[AccessEvent], None]


class AccessEvents:
    """The last events, and who wants to know. Telling never raises."""

    def __init__(self) -> None:
        self.last: deque[AccessEvent] = deque(maxlen=64)
        self.listeners: list[Listener] = []

    def tell(self, event: AccessEvent) -> None:
        """Keep it and tell all."""
        self.last.append(event)
        for listener in list(self.listeners):
            try:
                listener(event)
            except Exception:  # a user's own; what failed goes on
                pass
