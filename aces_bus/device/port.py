"""What the device floor asks of a bus, whatever it is: a way in, a way out, a clock, and what a word costs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, Protocol

from ..runtime import EventClock


class Port(Protocol):
    """One bus. Words are frames (CAN) or bytes; `aces_bus.hardware.port_of` makes one of any wire or gate."""

    @property
    def link(self) -> Literal["can", "serial", "datagram"]:
        """What kind of words it carries."""
        ...

    @property
    def clock(self) -> EventClock:
        """Whose instants `received` is told, and on whose thread."""
        ...

    @property
    def name(self) -> str:
        """What events call it."""
        ...

    @property
    def half_duplex(self) -> bool:
        """Whether all share one wire and nobody may speak before the one asked has answered."""
        ...

    def open(self, received: Callable[[Any, int], Any]) -> None:
        """Begin to hear: `received(word, instant)`."""
        ...

    def on_event(self, handler: Callable[[str, str], Any]) -> None:
        """Call `handler(kind, detail)` on the clock's thread with what happens to the bus."""
        ...

    def send(self, word: Any) -> bool:
        """Send a word; False when the bus does not take it."""
        ...

    def wire_ns(self, word: Any) -> int:
        """How long a word occupies the bus (ns)."""
        ...

    def close(self) -> None:
        """Hear no more."""
        ...
