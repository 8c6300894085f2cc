"""Controllers on a robot: states up, set-points down, errors by the shortcut, one clean end.

1. What runs is the same in every world (real buses, virtual time, a replay): only the clock and the tasks differ.
2. Whatever happens, the end is: controllers stop, motion stops, buses close, logs close; each once, in this order.
3. A controller's set-points go down together, on the thread of the buses.
4. Each controller has a guard and a supervisor: limits of the robot's file, a dead-man, reactions to events. When a guard
   trips, the devices that its controller drives are stopped as declared.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from ..controller import ControlEvent, ControllerLike, Guard, Reaction, Supervisor, bounds_of
from ..controller.guard import Action, Bounds
from ..device import UNKNOWN, DeviceEvent, Rig
from ..errors import AcesError, CallerError, DeviceError
from ..runtime import EventClock, Loop, Task, Tasks, ThreadTasks, VirtualTasks
from .states import States

#: Priorities of components where nobody says otherwise (the paper's order: control above logging).
CONTROL, LOGGING = 40, 5
#: A controller that gives nothing for so many of its periods is taken for dead (at least 0.1 s).
DEAD_PERIODS = 5
#: Seconds in which devices must have been heard before controllers begin.
HEARD_S = 5.0
#: Time for the last words to leave before a bus is closed (ns).
LAST_WORDS = 20_000_000


class Recorder(Protocol):
    """What a runner asks of a logger."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    @property
    def rate_hz(self) -> float:
        """How often it samples."""
        ...

    @property
    def states(self) -> Sequence[str]:
        """The names of the states that it records."""
        ...

    def bind(self, states: Mapping[str, Any]) -> None:
        """Take them."""
        ...

    def start(self, now: int) -> None:
        """Begin."""
        ...

    def step(self, now: int) -> None:
        """Sample once; must not block."""
        ...

    def stop(self, now: int) -> None:
        """End: all is on disk."""
        ...


@dataclass
class Ended:
    """How a run ended: `reason` "" for its time being up; `tripped` controllers with why."""

    reason: str
    tripped: dict[str, str]
    seconds: float


class Runner:
    """Runs controllers and loggers on a rig. Made by `run_virtual`, `run_real`, `run_replay`, or by hand.

    `tasks`: threads or events. `reactions` add to the supervisor's, `guard` False leaves limits and dead-man away (the
    drivers' own limits stay). `drives` False: set-points are counted and not sent (a replay).
    """

    def __init__(
        self,
        rig: Rig,
        controllers: Sequence[ControllerLike],
        *,
        loggers: Sequence[Recorder] = (),
        tasks: Tasks | None = None,
        reactions: Mapping[str, Reaction | tuple[Reaction, ...]] | None = None,
        guard: bool = True,
        on_trip: Action = "disable",
        drives: bool = True,
        history: int = 512,
    ) -> None:
        self.rig, self.clock = rig, rig.clock
        self.drives = drives
        self.states = States(rig, history=history)
        self.loggers = list(loggers)
        if tasks is None:
            tasks = ThreadTasks(self.clock) if isinstance(self.clock, Loop) else VirtualTasks(self.clock)
        self.tasks = tasks
        tasks.failed = self._failed
        #: What happened, newest last.
        self.events: deque[Any] = deque(maxlen=1024)
        self.handlers: list[Callable[[Any], None]] = []
        self.set_points = 0
        self.supervisors: list[Supervisor] = []
        self._stopped: set[str] = set()
        self._seconds = 0.0
        #: What is done before the buses are opened and after they are closed: loops, twins.
        self.before: list[Callable[[], Any]] = []
        self.after: list[Callable[[], Any]] = []
        #: The virtual robot or replay behind it; None on real buses.
        self.world: Any = None
        self._phase: Literal["new", "ready", "running", "over"] = "new"
        self._began = 0
        self._reason = ""
        names = {controller.name for controller in controllers}
        if len(names) < len(controllers):
            raise CallerError("two controllers have one name")
        for controller in controllers:
            supervisor = self._supervised(controller, reactions, guard, on_trip)
            self.supervisors.append(supervisor)
            tasks.add(
                controller.name, self._stepper(supervisor), rate_hz=controller.rate_hz, priority=CONTROL
            )
        for logger in self.loggers:
            tasks.add(logger.name, logger.step, rate_hz=logger.rate_hz, priority=LOGGING)
        rig.on_event(self._happened)

    # ------------------------------------------------------------------ making

    def _supervised(
        self,
        controller: ControllerLike,
        reactions: Mapping[str, Reaction | tuple[Reaction, ...]] | None,
        guard: bool,
        on_trip: Action,
    ) -> Supervisor:
        if isinstance(controller, Supervisor):
            return controller
        bounds: Mapping[str, Bounds] = {}
        if guard:
            known = bounds_of(self.rig.robot)
            bounds = {
                **known,
                **{alias: known[name] for alias, name in self.rig.aliases.items() if name in known},
            }
        period = 1 / controller.rate_hz
        dead_man = max(0.1, DEAD_PERIODS * period) if guard else None
        made = Guard(
            bounds,
            period_s=period,
            dead_man_s=dead_man,
            action=on_trip,
            unlisted="pass",
            name=controller.name,
        )
        return Supervisor(controller, made, reactions)

    def _stepper(self, supervisor: Supervisor) -> Callable[[int], None]:
        step, states = supervisor.step, self.states
        clock = self.clock
        is_direct = not isinstance(self.tasks, ThreadTasks)

        def run(now: int) -> None:
            given = step(now)
            if supervisor.guard.tripped is not None and supervisor.name not in self._stopped:
                self._trip(supervisor)
            if not given:
                return
            self.set_points += len(given)
            if not self.drives:
                return
            if is_direct:
                for name, value in given.items():
                    states[name].set(value)
            else:
                clock.call_soon(lambda: self._give(given))

        return run

    def _give(self, given: Mapping[str, float]) -> None:
        for name, value in given.items():
            self.states[name].set(value)

    # ------------------------------------------------------------------ errors

    def _happened(self, event: DeviceEvent) -> None:
        """The shortcut: what happened below reaches every supervisor at once."""
        self._note(event)
        if self._phase == "running":
            for supervisor in self.supervisors:
                supervisor.handle(event)

    def _failed(self, task: Task, error: BaseException) -> None:
        event = ControlEvent("raised", self.clock.now(), task.name, f"{type(error).__name__}: {error}"[:500])
        self._note(event)
        for supervisor in self.supervisors:
            supervisor.handle(event)

    def _note(self, event: Any) -> None:
        self.events.append(event)
        for handler in self.handlers:
            handler(event)

    def _trip(self, supervisor: Supervisor) -> None:
        """A guard has stopped motion: what its controller drives is stopped too, as declared."""
        trip = supervisor.guard.tripped
        assert trip is not None
        if not trip.latched:
            return
        self._stopped.add(supervisor.name)
        self._note(ControlEvent("trip", self.clock.now(), supervisor.name, trip.reason))
        if not self.drives or trip.action == "hold":
            return
        self.clock.call_soon(lambda: self._stop_devices(supervisor))

    def _stop_devices(self, supervisor: Supervisor) -> None:
        writes = getattr(supervisor.controller, "writes", ())
        driven: set[str] = set()
        for name in writes:
            if name in self.states:
                driven.add(self.rig.device(self.states.whole(name).partition(".")[0]).name)
        for device in self.rig.devices.values():
            if not driven or device.name in driven:
                try:
                    device.stop_motion()
                except AcesError as error:
                    self._note(ControlEvent("failed", self.clock.now(), device.name, str(error)))

    # ------------------------------------------------------------------ running

    def __enter__(self) -> Runner:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop("the program left it")

    def open(self) -> None:
        """Open the buses, and wait until every polled device has been heard or `HEARD_S` are over."""
        for begin in self.before:
            begin()
        self.clock.call(self.rig.open)
        if not self.drives:
            self._phase = "ready"
            return
        polled = [device for device in self.rig.devices.values() if device.polls]
        self.clock.wait(lambda: all(device.last_heard is not None for device in polled), round(HEARD_S * 1e9))
        self._phase = "ready"

    @property
    def missing(self) -> list[str]:
        """The polled devices that were never heard."""
        return [d.name for d in self.rig.devices.values() if d.polls and d.last_heard is None]

    def do(self, action: str, timeout_s: float = 60.0) -> None:
        """Have all devices do something ("enable", "home") and wait; raises `DeviceError` with who failed."""
        self.clock.call(lambda: self.rig.each(action)).wait(timeout_s)

    def start(self) -> None:
        """Start controllers and loggers. Raises `UnknownNameError` for a state that the robot has not."""
        self.clock.call(self._bind)
        now = self.clock.now()
        self._began = now
        for logger in self.loggers:
            logger.start(now)
        for supervisor in self.supervisors:
            supervisor.start(now)
        self._phase = "running"
        self.tasks.start()

    def _bind(self) -> None:
        for supervisor in self.supervisors:
            supervisor.bind(self.states)
            for name in getattr(supervisor.controller, "writes", ()):
                state = self.states[name]
                if not state.is_writable:
                    raise CallerError(f"{supervisor.name} gives set-points for {name}, which is read-only")
        for logger in self.loggers:
            logger.bind(self.states)

    @property
    def seconds(self) -> float:
        """How long it has been running."""
        return (self.clock.now() - self._began) / 1e9 if self._phase == "running" else 0.0

    def run(self, seconds: float | None = None, until: Callable[[], bool] | None = None) -> Ended:
        """Start, let it run until its time is up, `until()` holds or every controller has tripped, and stop."""
        if self._phase == "new":
            self.open()
        self.start()
        end = None if seconds is None else self._began + round(seconds * 1e9)

        def is_over() -> bool:
            if until is not None and until():
                return True
            return bool(self.supervisors) and len(self._stopped) == len(self.supervisors)

        left = (1 << 62) if end is None else end - self.clock.now()
        if self.clock.wait(is_over, max(0, left)) and self._stopped:
            self._reason = "every controller was stopped"
        return self.stop(self._reason)

    def stop(self, reason: str = "") -> Ended:
        """Stop controllers, motion, buses, logs; in this order, whatever fails on the way."""
        if self._phase == "over":
            return self.ended(reason)
        seconds = self.seconds
        was, self._phase = self._phase, "over"
        self.tasks.stop()
        now = self.clock.now()
        for supervisor in self.supervisors:
            if was == "running":
                supervisor.stop(now)
        if was in ("ready", "running") and self.drives:
            try:
                self.clock.call(self.rig.stop_motion).wait(2.0)
                self.clock.wait(lambda: False, LAST_WORDS)
            except (DeviceError, CallerError) as error:
                self._note(ControlEvent("failed", self.clock.now(), "stop", str(error)))
        self.rig.close()
        for end in self.after:
            end()
        for logger in self.loggers:
            if was == "running":
                logger.stop(self.clock.now())
        self._seconds = seconds
        return self.ended(reason)

    def ended(self, reason: str = "") -> Ended:
        """How it ended."""
        tripped = {s.name: s.reason for s in self.supervisors if s.reason}
        return Ended(reason, tripped, self._seconds)

    def unknown_states(self) -> list[str]:
        """Those states in use that have no fresh value."""
        return [name for name, state in self.states._made.items() if state[0] is UNKNOWN]

    @property
    def clock_name(self) -> str:
        """Which clock instants belong to."""
        clock: EventClock = self.clock
        return clock.name
