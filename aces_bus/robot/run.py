"""A run as its parts share it: its rig, its states, its controllers, what has happened, and the way down for set-points.

`run_faults` leads from faults to stops, `run_end` is the one end, and `runner` makes, opens and runs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Protocol

from ..controller import Supervisor
from ..device import Device
from .rig import Rig
from .states import States


class RunLogger(Protocol):
    """What a runner asks of a logger."""

    @property
    def name(self) -> str:
        """Name of the logger."""
        ...

    @property
    def rate_hz(self) -> float:
        """Rate of its samples, in Hz."""
        ...

    @property
    def states(self) -> Sequence[str]:
        """The names of the states that it records."""
        ...

    def bind(self, states: Mapping[str, Any]) -> None:
        """Take the states that it reads, by name."""
        ...

    def start(self, now: int) -> None:
        """Begin at an instant (ns)."""
        ...

    def step(self, now: int) -> None:
        """Sample once; must not block."""
        ...

    def stop(self, now: int) -> None:
        """End: all is on disk."""
        ...


class Run:
    """A rig, its states, the supervisors of its controllers, and the phase that the run is in."""

    def __init__(
        self,
        rig: Rig,
        *,
        drives: bool,
        history: int,
        states: Mapping[str, Mapping[str, Any]] | None,
    ) -> None:
        self.rig, self.clock, self.drives = rig, rig.clock, drives
        self.states = States(rig, history=history, declared=states)
        self.supervisors: list[Supervisor] = []
        self.phase: Literal["new", "ready", "running", "over"] = "new"
        #: The instant (ns) at which it began to run.
        self.began = 0
        #: What happened, newest last.
        self.events: deque[Any] = deque(maxlen=1024)
        self.handlers: list[Callable[[Any], None]] = []
        self.set_points = 0
        #: The last set-points of controllers, by state; what left of them the door knows.
        self.given: dict[str, float] = {}
        self._setters: dict[str, Callable[[float], None]] = {}

    @property
    def seconds(self) -> float:
        """Duration of the run so far, in seconds."""
        return (self.clock.now() - self.began) / 1e9 if self.phase == "running" else 0.0

    # ------------------------------------------------------------------ set-points

    def driven(self, supervisor: Supervisor) -> list[Device]:
        """Return the devices that a controller gives set-points to; all of them where it does not say."""
        names = {
            self.rig.device(self.states.whole(name).partition(".")[0]).name
            for name in supervisor.writes
            if name in self.states
        }
        return [d for d in self.rig.devices.values() if not names or d.name in names]

    def give(self, given: Mapping[str, float]) -> None:
        """Hand set-points down."""
        if not given:
            return
        self.set_points += len(given)
        self.given.update(given)
        if not self.drives:
            return
        setters = self._setters
        for name, value in given.items():
            give = setters.get(name)
            if give is None:
                give = setters[name] = self.rig.door.writer(self.states.whole(name))
            give(value)

    # ------------------------------------------------------------------ what happens

    def note(self, event: Any) -> None:
        self.events.append(event)
        for handler in self.handlers:
            try:
                handler(event)
            except Exception as error:  # a user's code: the other handlers are called all the same
                self.rig.events.failures.append(error)
