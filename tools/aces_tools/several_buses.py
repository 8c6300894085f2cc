"""Several CAN buses that are listened to as one: `aces sniff can0 can1`. Nothing is sent.

1. Frames keep the name of their bus: filters (`--filter can0,060:7F0`), protocols (`-p can0=car.dbc`) and recordings go by
   it.
2. Frames come in the order in which they were received, as far as they are read together.
3. What is lost on the buses is summed up; an event names its bus.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import msgspec

from aces_bus.recordings.base import Link

from .bus_arg import ChosenBus

if TYPE_CHECKING:
    from aces_bus import Frame
    from aces_bus.hardware import CanGate
    from aces_bus.hardware.gate import Received
    from aces_bus.hardware.gate_events import BusEvent

    from .bus_arg import AnyGate

#: Seconds between two looks at the queues: frames that come this close are shown together anyway.
LOOK_S = 0.01


class SeveralInboxes:
    """A queue of what arrives on each of several buses."""

    def __init__(self, gates: Sequence[CanGate], limit: int | None) -> None:
        self._inboxes = [
            (gate.name, gate.subscribe() if limit is None else gate.subscribe(limit=limit)) for gate in gates
        ]

    def get(self, timeout: float) -> list[Received[Frame]]:
        """Return all that is there, in the order in which it was received; waits up to `timeout` seconds for the first."""
        until = time.monotonic() + timeout
        while True:
            found = [_named(item, name) for name, inbox in self._inboxes for item in inbox.get(0)]
            left = until - time.monotonic()
            if found or left <= 0 or self.is_closed:
                return sorted(found, key=lambda item: item.host_ns)
            time.sleep(min(LOOK_S, left))

    @property
    def dropped(self) -> int:
        """Number of frames that did not fit."""
        return sum(inbox.dropped for _, inbox in self._inboxes)

    @property
    def is_closed(self) -> bool:
        """True if nothing more will come of any bus."""
        return all(inbox.is_closed for _, inbox in self._inboxes)

    def close(self) -> None:
        """Leave: nothing more is put in."""
        for _, inbox in self._inboxes:
            inbox.close()


def _named(item: Received[Frame], name: str) -> Received[Frame]:
    """Return a received frame with the name of its bus, where the adapter gives none."""
    frame, changed = item.content, msgspec.structs.replace
    return item if frame.channel is not None else changed(item, content=changed(frame, channel=name))


class SeveralGates:
    """Gates that only listen, as one. `name` has the names of all, with a blank between two."""

    listen_only: ClassVar[bool] = True

    def __init__(self, buses: Sequence[ChosenBus]) -> None:
        from aces_bus.hardware import CanGate

        self.buses = tuple(buses)
        self.gates = [CanGate(bus.options, name=bus.name, listen_only=True) for bus in buses]
        self.name = " ".join(gate.name for gate in self.gates)

    def on_event(self, handler: Callable[[BusEvent], None]) -> None:
        """Call `handler` at once with everything that happens to one of the buses."""
        for gate in self.gates:
            gate.on_event(handler)

    def subscribe(self, *, limit: int | None = None) -> SeveralInboxes:
        """Open queues of what arrives from now on, each of at most `limit` frames (None: as a gate's own)."""
        return SeveralInboxes(self.gates, limit)

    def start(self) -> None:
        """Open all buses; raises `CallerError` for the first that cannot be opened, and closes the others."""
        with ExitStack() as stack:
            stack.callback(self.stop)
            for bus, gate in zip(self.buses, self.gates, strict=True):
                bus.start(gate)
            stack.pop_all()

    def stop(self) -> None:
        """Close all buses; the queues keep what was received."""
        with ExitStack() as stack:
            for gate in self.gates:
                stack.callback(gate.stop)


@dataclass(frozen=True)
class SeveralBuses:
    """Two or more CAN buses that are named and not yet open."""

    buses: tuple[ChosenBus, ...]
    kind: ClassVar[str] = "can"
    link: ClassVar[Link] = "can"

    @property
    def name(self) -> str:
        """The names of all, with a blank between two."""
        return " ".join(bus.name for bus in self.buses)

    def gate(self, *, listen_only: bool) -> SeveralGates:
        """Return the gatekeepers, not yet started."""
        assert listen_only
        return SeveralGates(self.buses)

    def start(self, gate: AnyGate | SeveralGates) -> None:
        """Start them. Raises `CallerError` for the first bus that cannot be opened, and closes the others."""
        gate.start()
