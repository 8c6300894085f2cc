"""What all parts of a run share: its states, what has happened, and the way down for set-points.

A run is layered: this, then `run_faults` (what faults lead to), `run_end` (its one end), and `runner` (making, opening,
running).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Protocol

from ..controller import ControlEvent, Supervisor
from ..controller.events import raised_text
from ..controller.trip import Trip
from ..device import Device, Job
from ..runtime import Loop, Tasks, ThreadTasks, VirtualTasks
from .park import Parking
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


class RunBase:
    """A rig, the supervisors of its controllers, its loggers, and their tasks."""

    def __init__(
        self,
        rig: Rig,
        loggers: Sequence[RunLogger],
        tasks: Tasks | None,
        *,
        hold_s: float | None,
        at_end: Literal["disable", "hold", "park"],
        drives: bool,
        history: int,
        states: Mapping[str, Mapping[str, Any]] | None,
    ) -> None:
        self.rig, self.clock = rig, rig.clock
        self.drives, self.hold_s, self.at_end = drives, hold_s, at_end
        self.states = States(rig, history=history, declared=states)
        self.loggers = list(loggers)
        if tasks is None:
            tasks = ThreadTasks(self.clock) if isinstance(self.clock, Loop) else VirtualTasks(self.clock)
        self.tasks = tasks
        #: What happened, newest last.
        self.events: deque[Any] = deque(maxlen=1024)
        self.handlers: list[Callable[[Any], None]] = []
        self.set_points = 0
        #: The last set-points, by state.
        self.given: dict[str, float] = {}
        self.supervisors: list[Supervisor] = []
        #: Controller → why what it drives was switched off.
        self._stopped: dict[str, str] = {}
        #: Controller → the trip that was last acted upon.
        self._obeyed: dict[str, Trip] = {}
        #: Controller → the instant at which it began a step that is not over yet.
        self._inside: dict[str, int] = {}
        #: Controller → the begin of the step that it was last taken for dead in.
        self._dead_since: dict[str, int] = {}
        self._reported: dict[str, int] = {}
        #: Devices whose stop was not confirmed, by name.
        self._owed: dict[str, Device] = {}
        self._is_attending = False
        self._stopping: Job | None = None
        self._setters: dict[str, Callable[[float], None]] = {}
        self._failed_at_end: list[str] = []
        #: The way to the robot's pose, where its end, or a trip, is to park.
        self._parking: Parking | None = Parking(rig) if at_end == "park" else None
        #: Controller → its trip that asks for the way to the pose.
        self._to_park: dict[str, Trip] = {}
        self._not_stopped: dict[str, str] = {}
        self._held: list[str] = []
        self._falling: dict[str, str] = {}
        #: Why controllers were stopped, before an end that holds.
        self._tripped: dict[str, str] | None = None
        #: What is left of the end.
        self._to_end: deque[tuple[str, Callable[[], Any]]] = deque()
        self._is_bound = False
        self._logging: list[RunLogger] = []
        self._seconds = 0.0
        #: What is done before the buses are opened and after they are closed: loops, twins.
        self.before: list[Callable[[], Any]] = []
        self.after: list[Callable[[], Any]] = []
        #: The virtual robot or replay behind it; None on real buses.
        self.world: Any = None
        self._phase: Literal["new", "ready", "running", "over"] = "new"
        self._began = 0
        self._reason = ""

    # ------------------------------------------------------------------ set-points

    def driven(self, supervisor: Supervisor) -> list[Device]:
        """Return the devices that a controller gives set-points to; all of them where it does not say."""
        names = {
            self.rig.device(self.states.whole(name).partition(".")[0]).name
            for name in supervisor.writes
            if name in self.states
        }
        return [d for d in self.rig.devices.values() if not names or d.name in names]

    def _give(self, given: Mapping[str, float]) -> None:
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

    def _note(self, event: Any) -> None:
        self.events.append(event)
        for handler in self.handlers:
            try:
                handler(event)
            except Exception as error:  # a user's code: the other handlers are called all the same
                self.rig.events.failures.append(error)

    def _fault(self, source: str, error: BaseException | str) -> None:
        """Something of the end went wrong; the end goes on."""
        said = error if isinstance(error, str) else raised_text(error)
        self._failed_at_end.append(f"{source}: {said}")
        self._note(ControlEvent("failed", self.clock.now(), source, said))
