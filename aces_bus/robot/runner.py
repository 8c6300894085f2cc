"""Controllers on a robot: states up, set-points down, errors by the shortcut, one clean end.

1. What runs is the same in every world (real buses, virtual time, a replay): only the clock and the tasks differ.
2. Whatever happens, the end is: motion stops, controllers end, buses close, logs close; each once, in this order.
3. A controller's thread computes and nothing else. Guards, reactions and stops are on the thread of the buses, where nothing
   waits for a controller: what a fault stops is stopped when the fault is received, whatever the controller's rate.
4. Each controller has a guard and a supervisor: limits of the robot's file, a dead-man, reactions to events. When a guard
   trips, the devices that its controller drives are stopped as declared, or held where they are with live set-points.
5. A stop that was not confirmed is owed: it is repeated when the bus or the device is back. No wait here is without an end.

Controllers are stepped with the instants that their cycles were due: they and their guards see even steps, however late
a thread woke up. Set-points that come after the end, or after a trip, go nowhere.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, Protocol, TypeVar

from ..controller import (
    IGNORE,
    ControlEvent,
    ControllerLike,
    Guard,
    Reaction,
    Supervisor,
    bounds_of,
    parse_reactions,
)
from ..controller.events import EventLike, Listeners, raised_text
from ..controller.guard import Action, Bounds, Trip
from ..device import Device, DeviceEvent, Job, stop_devices, wait_stopped
from ..errors import AcesError, CallerError, DeviceError, NotStoppedError, UnknownNameError
from ..runtime import Loop, Task, Tasks, ThreadTasks, VirtualClock, VirtualTasks
from .checks import KINDS_OF_FAULTS
from .rig import Rig, States

T = TypeVar("T")

#: Priorities of components by default: buses above control above logging.
CONTROL, LOGGING = 40, 5
#: A controller that gives nothing for so many of its periods, and so many seconds, is taken for dead.
DEAD_PERIODS, DEAD_S = 5, 0.1
#: Events after which a stop that was not confirmed is sent again.
BACK = frozenset({"reopened", "recovered", "error-active", "answers", "rebooted"})
#: Seconds in which every polled device must have answered before controllers begin.
RECEIVE_S = 5.0
#: Seconds that any one part of an end may take.
PATIENCE_S = 2.0
#: How often the buses' thread looks whether controllers still come back (ns), and a run in virtual time at its end.
WATCH_NS, STEP_NS = 20_000_000, 1_000_000
#: Events of logs.
OF_LOGS = ("log-failed", "log-dropped")
#: A repeated failure is reported this often at most (ns).
REPEAT_NS = 1_000_000_000


class RunLogger(Protocol):
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
    """How a run ended: `reason` "" for its time being up; `tripped` controllers with why; `failed` what went wrong at the
    end itself, and of that `not_stopped` the devices that may still move, with why. `held`: those left as they were, on
    request.
    """

    reason: str
    tripped: dict[str, str]
    seconds: float
    failed: list[str] = field(default_factory=list[str])
    not_stopped: dict[str, str] = field(default_factory=dict[str, str])
    held: list[str] = field(default_factory=list[str])


class Runner:
    """Runs controllers and loggers on a rig. Made by `run_virtual`, `run_real`, `run_replay`, or by hand.

    `tasks`: threads or events. `reactions` add to the robot file's, and these to the supervisor's; those that name functions
    find them in `own_reactions`. `on_trip` is what stops motion where no reaction says how. "hold" ends after `hold_s`
    (None: with `release`, or the run), then what was held is switched off. `at_end` "hold" leaves what runs as it is at the
    end. `guard` False leaves its limits and dead-man away (the door's stay). `drives` False: set-points are counted
    and not sent (a replay). `states` declares states (name → keywords of `State`), see `States`. Rates and priorities of the
    robot's file replace the controllers' own.
    """

    def __init__(
        self,
        rig: Rig,
        controllers: Sequence[ControllerLike],
        *,
        loggers: Sequence[RunLogger] = (),
        tasks: Tasks | None = None,
        reactions: Mapping[str, Reaction | tuple[Reaction, ...]] | None = None,
        guard: bool = True,
        own_reactions: Mapping[str, Callable[[EventLike], object]] | None = None,
        on_trip: Action = "disable",
        hold_s: float | None = None,
        at_end: Literal["disable", "hold"] = "disable",
        drives: bool = True,
        history: int = 512,
        states: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        self.rig, self.clock = rig, rig.clock
        self.drives, self.hold_s, self.at_end = drives, hold_s, at_end
        self.states = States(rig, history=history, declared=states)
        self.loggers = list(loggers)
        if tasks is None:
            tasks = ThreadTasks(self.clock) if isinstance(self.clock, Loop) else VirtualTasks(self.clock)
        self.tasks = tasks
        tasks.failed = self._failed
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
        self._told: dict[str, int] = {}
        #: Devices whose stop was not confirmed, by name.
        self._owed: dict[str, Device] = {}
        self._is_attending = False
        self._stopping: Job | None = None
        self._setters: dict[str, Callable[[float], None]] = {}
        self._failed_at_end: list[str] = []
        self._not_stopped: dict[str, str] = {}
        self._held: list[str] = []
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
        names = [*(one.name for one in controllers), *(one.name for one in loggers)]
        double = {name for name in names if names.count(name) > 1}
        if double:
            raise CallerError(f"two controllers or loggers have one name: {', '.join(sorted(double))}")
        declared = parse_reactions(
            rig.robot.reactions,
            kinds=KINDS_OF_FAULTS,
            sources=(*rig.robot.buses, *rig.robot.devices, *names),
            own=own_reactions,
        )
        components: list[ControllerLike | RunLogger] = [*controllers, *self.loggers]
        for component in components:
            self._timed(component)
        for controller in controllers:
            supervisor = self._supervised(controller, {**declared, **(reactions or {})}, guard, on_trip)
            self.supervisors.append(supervisor)
            self._add_task(controller, self._stepper(supervisor), CONTROL)
        for logger in self.loggers:
            listeners = getattr(logger, "listeners", None)
            if isinstance(listeners, Listeners):
                listeners.add(self._tell_all)
            self._add_task(logger, logger.step, LOGGING)
        rig.on_event(self._happened)

    # ------------------------------------------------------------------ making

    def _add_task(
        self, component: ControllerLike | RunLogger, step: Callable[[int], Any], priority: int
    ) -> None:
        said = self.rig.robot.controllers.get(component.name)
        stated = None if said is None else said.priority
        self.tasks.add(
            component.name, step, rate_hz=component.rate_hz, priority=priority if stated is None else stated
        )

    def _timed(self, component: ControllerLike | RunLogger) -> None:
        """Give a component the rate that the robot's file states for it."""
        said = self.rig.robot.controllers.get(component.name)
        if said is None or said.rate_hz is None or said.rate_hz == component.rate_hz:
            return
        try:
            if isinstance(component, Supervisor):
                raise AttributeError  # its guard was made for a rate
            component.rate_hz = said.rate_hz  # type: ignore[misc]
        except AttributeError:
            raise CallerError(
                f"{component.name}: the robot's file says {said.rate_hz:g} Hz, and it was made for"
                f" {component.rate_hz:g} Hz only"
            ) from None

    def _supervised(
        self,
        controller: ControllerLike,
        reactions: Mapping[str, Reaction | tuple[Reaction, ...]],
        guard: bool,
        on_trip: Action,
    ) -> Supervisor:
        period = 1 / controller.rate_hz
        dead_man = max(DEAD_S, DEAD_PERIODS * period) if guard else None
        if isinstance(controller, Supervisor):
            if controller.dead_man_ns is None and dead_man is not None:
                controller.dead_man_ns = round(dead_man * 1e9)
            self._listen(controller)
            return controller
        bounds: Mapping[str, Bounds] = {}
        if guard:
            bounds = self.rig.by_signal(bounds_of(self.rig.robot))
        made = Guard(
            bounds,
            period_s=period,
            dead_man_s=None,
            action=on_trip,
            unlisted="pass",
            name=controller.name,
        )
        # What a log cannot take is no reason to stop a robot, unless that is declared.
        supervisor = Supervisor(
            controller, made, {**dict.fromkeys(OF_LOGS, IGNORE), **reactions}, dead_man_s=dead_man
        )
        self._listen(supervisor)
        return supervisor

    def _listen(self, supervisor: Supervisor) -> None:
        """What controller, guard and supervisor tell is among the events."""
        for listeners in (
            getattr(supervisor.controller, "listeners", None),
            supervisor.guard.listeners,
            supervisor.listeners,
        ):
            if isinstance(listeners, Listeners):
                listeners.add(self._note)

    def _task_of(self, name: str) -> Task:
        return next(task for task in self.tasks.tasks if task.name == name)

    def _stepper(self, supervisor: Supervisor) -> Callable[[int], None]:
        compute, name, inside = supervisor.compute, supervisor.name, self._inside
        is_direct = not isinstance(self.tasks, ThreadTasks)
        task: Task | None = None

        def run(now: int) -> None:
            nonlocal task
            if task is None:
                task = self._task_of(name)
            due = now - task.lateness_ns
            if is_direct:
                self._attend(supervisor, now)
                self._pass_on(supervisor, due, compute(due))
                return
            inside[name] = now
            wanted = compute(due)
            inside.pop(name, None)
            self.clock.call_soon(lambda: self._pass_on(supervisor, due, wanted))

        return run

    def _pass_on(self, supervisor: Supervisor, now: int, wanted: Mapping[str, float]) -> None:
        """On the buses' thread: what a controller wants, through its guard; what comes after the end goes nowhere."""
        if self._phase == "running":
            given = supervisor.pass_on(now, wanted)
            self._obey(supervisor)
            self._give(given)

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

    # ------------------------------------------------------------------ errors

    def _happened(self, event: DeviceEvent) -> None:
        """The shortcut: what happened below reaches every supervisor at once, and is acted upon next."""
        self._note(event)
        if self._phase == "running":
            self._handle(event)
            if self._owed and event.kind in BACK:
                self.clock.call_soon(lambda: self._repay(event.source))

    def _handle(self, event: EventLike) -> None:
        for supervisor in self.supervisors:
            supervisor.handle(event)
        if not self._is_attending:
            self._is_attending = True
            self.clock.call_soon(self._attend_all)

    def _attend_all(self) -> None:
        self._is_attending = False
        now = self.clock.now()
        for supervisor in self.supervisors:
            self._attend(supervisor, now)

    def _attend(self, supervisor: Supervisor, now: int) -> None:
        if self._phase == "running" and supervisor.has_events:
            given = supervisor.attend(now)
            self._obey(supervisor)
            self._give(given)

    def _failed(self, task: Task, error: BaseException) -> None:
        """A component raised: a logger, as controllers have supervisors for that."""
        is_log = any(logger.name == task.name for logger in self.loggers)
        self._raised(task.name, OF_LOGS[0] if is_log else "raised", error)

    def bus_failed(self, error: BaseException) -> None:
        """Something raised on the buses' thread."""
        self._raised("buses", "bug", error)

    def _raised(self, source: str, kind: str, error: BaseException) -> None:
        now = self.clock.now()
        if now - self._told.get(source, -REPEAT_NS) >= REPEAT_NS:
            self._told[source] = now
            self._tell_all(ControlEvent(kind, now, source, raised_text(error)))

    def _tell_all(self, event: ControlEvent) -> None:
        """What components tell reaches every supervisor, too."""
        self._note(event)
        self._handle(event)

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

    def _obey(self, supervisor: Supervisor) -> None:
        """A guard has stopped motion: what its controller drives is held or switched off, as declared."""
        trip = supervisor.guard.tripped
        if trip is None or not trip.latched or self._obeyed.get(supervisor.name) is trip:
            return
        self._obeyed[supervisor.name] = trip
        if trip.action == "hold":
            if self.hold_s is not None:
                self.clock.call_in(round(self.hold_s * 1e9), lambda: self._let_go(supervisor, trip))
            self._hold(supervisor, trip)
            return
        self._stopped[supervisor.name] = trip.reason
        if self.drives:
            self._stop(supervisor.name, self.driven(supervisor))

    def _hold(self, supervisor: Supervisor, trip: Trip) -> None:
        """Set-points that stay where they are, at the controller's rate, whether it still runs or not."""

        def again() -> None:
            if self._phase == "running" and supervisor.guard.tripped is trip:
                self._give(supervisor.guard.tick(self.clock.now()))
                self.clock.call_in(period, again)

        period = round(1e9 / supervisor.rate_hz)
        self.clock.call_in(period, again)

    def _let_go(self, supervisor: Supervisor, trip: Trip) -> None:
        """It has been held for as long as was said."""
        if self._phase == "running" and supervisor.guard.tripped is trip:
            supervisor.guard.trip(f"{trip.reason}; held for {self.hold_s:g} s", "disable")
            supervisor.guard.tick(self.clock.now())
            self._obey(supervisor)

    @property
    def held(self) -> dict[str, str]:
        """Controllers whose joints are held where they are, with why."""
        return {
            s.name: s.guard.tripped.reason
            for s in self.supervisors
            if s.guard.tripped is not None and s.guard.tripped.action == "hold"
        }

    def release(self, controller: str) -> None:
        """Let a controller's set-points through again after a trip; what was switched off has to be enabled before.

        Raises `UnknownNameError`.
        """
        found = {supervisor.name: supervisor for supervisor in self.supervisors}
        if controller not in found:
            raise UnknownNameError("controller", controller, found)

        def let_through() -> None:
            self._stopped.pop(controller, None)
            found[controller].release()

        self.clock.call(let_through)

    def _stop(self, name: str, devices: Collection[Device]) -> None:
        def over(stopping: Job) -> None:
            failed = stopping.error.devices if isinstance(stopping.error, NotStoppedError) else {}
            for device in devices:
                if device.name in failed:
                    self._owed[device.name] = device
                else:
                    self._owed.pop(device.name, None)
            if stopping.error is not None:
                self._note(ControlEvent("failed", self.clock.now(), name, str(stopping.error)))

        stop_devices(self.clock, name, devices).then(over)

    def _repay(self, source: str) -> None:
        """The bus or device `source` is back: who owes a stop there is stopped again."""
        owed = [device for device in self._owed.values() if source in (device.name, device.host.name)]
        if owed and self._phase == "running":
            self._stop(source, owed)

    def _watch(self) -> None:
        """On the buses' thread: a controller that does not come back from a step cannot say so itself."""
        if self._phase != "running":
            return
        self.clock.call_in(WATCH_NS, self._watch)
        now = self.clock.now()
        for supervisor in self.supervisors:
            name = supervisor.name
            began = self._inside.get(name, now)
            if supervisor.is_overdue(now, began) and self._dead_since.get(name) != began:
                self._dead_since[name] = began
                given = supervisor.tell_dead(
                    now, f"its step has not come back for {(now - began) / 1e9:.3f} s"
                )
                self._obey(supervisor)
                self._give(given)

    def driven(self, supervisor: Supervisor) -> list[Device]:
        """The devices that a controller gives set-points to; all of them where it does not say."""
        names = {
            self.rig.device(self.states.whole(name).partition(".")[0]).name
            for name in supervisor.writes
            if name in self.states
        }
        return [d for d in self.rig.devices.values() if not names or d.name in names]

    # ------------------------------------------------------------------ running

    def __enter__(self) -> Runner:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        was_over = self._phase == "over" and not self._to_end
        ended = self.stop("the program left it")
        if ended.not_stopped and kind is None and not was_over:  # else `run` or `stop` has returned it
            raise NotStoppedError(ended.not_stopped)

    def open(self) -> None:
        """Open the buses, and wait until every polled device has been heard or `RECEIVE_S` are over.

        Whatever opening raises comes out, with all closed again.
        """
        self.bind()
        try:
            for begin in self.before:
                begin()
            self.clock.call(self._open_hosts)
            if any(host.rate_hz for host in self.rig.hosts.values()):
                polled = [device for device in self.rig.devices.values() if device.polls]
                self.clock.wait(
                    lambda: all(device.last_heard is not None for device in polled), round(RECEIVE_S * 1e9)
                )
        except BaseException:
            self.stop("it could not be opened")
            raise
        self._phase = "ready"

    def _open_hosts(self) -> None:
        for name, host in self.rig.hosts.items():
            try:
                host.open()
            except AcesError:
                raise
            except Exception as error:  # whatever a backend or the system may raise
                said = " ".join(str(error).split()) or type(error).__name__
                raise CallerError(f"bus {name} cannot be opened: {said}") from error

    @property
    def missing(self) -> list[str]:
        """The polled devices that were never heard."""
        return [d.name for d in self.rig.devices.values() if d.polls and d.last_heard is None]

    def do(
        self, action: str, timeout_s: float = 60.0, *, devices: Collection[Device | str] | None = None
    ) -> list[str]:
        """Have devices do something ("enable", "home") and wait; those that have it, by name.

        `devices` None: all of the robot's; names may be those of joints. Raises `DeviceError` with who failed, `CallerError`
        where this run sends nothing that changes a device.
        """
        if not self.drives:
            raise CallerError(
                f"{action!r} changes devices, and this run sends nothing that does (transmit=True)"
            )
        some = self.rig.devices.values() if devices is None else devices
        found = dict.fromkeys(self.rig.device(one) if isinstance(one, str) else one for one in some)
        able = [device for device in found if action in device.actions]

        self.clock.call(lambda: self.rig.each(action, able)).wait(timeout_s)
        return [device.name for device in able]

    def start(self) -> None:
        """Start controllers and loggers. Raises `UnknownNameError` for a state that the robot has not."""
        self.bind()
        for logger in self.loggers:  # files take their time
            self._logging.append(logger)
            logger.start(self.clock.now())
        self._began = now = self.clock.now()
        for supervisor in self.supervisors:
            supervisor.start(now)
        self._phase = "running"
        self.tasks.start()
        if isinstance(self.tasks, ThreadTasks):
            self.clock.call_soon(self._watch)

    def bind(self) -> None:
        """Give controllers and loggers their states; may be done before the buses are opened. Raises as `start`."""
        if not self._is_bound:
            if self._phase == "new":
                self._bind()
            else:
                self.clock.call(self._bind)
            self._is_bound = True

    def _bind(self) -> None:
        for supervisor in self.supervisors:
            for name in (*supervisor.states, *supervisor.writes):
                self.states.whole(name)  # says best what is wrong with it
            supervisor.bind(self.states)
            for name in supervisor.writes:
                if not self.states[name].is_writable:
                    raise CallerError(f"{supervisor.name} gives set-points for {name}, which is read-only")
                self.rig.door.claim(name, supervisor.name, is_supervised=True)
        for logger in self.loggers:
            try:
                logger.bind(self.states)
            except UnknownNameError as error:
                self.states.whole(error.name)
                raise

    @property
    def seconds(self) -> float:
        """How long it has been running."""
        return (self.clock.now() - self._began) / 1e9 if self._phase == "running" else 0.0

    def run(self, seconds: float | None = None, until: Callable[[], bool] | None = None) -> Ended:
        """Start, let it run until its time is up, `until()` holds or every controller has been stopped, and stop.

        `until` is asked every millisecond. What it raises comes out, with motion stopped and all closed.
        """
        try:
            if self._phase == "new":
                self.open()
            self.start()
            end = None if seconds is None else self._began + round(seconds * 1e9)

            def is_over() -> bool:
                if self._stopped and len(self._stopped) == len(self.supervisors):
                    self._reason = "every controller was stopped"
                    return True
                return until is not None and until()

            self._let_pass(is_over, (1 << 62) if end is None else end)
        except BaseException as error:
            self.stop(f"{type(error).__name__}: {error}".rstrip(": "))
            raise
        return self.stop(self._reason)

    def _let_pass(self, is_over: Callable[[], bool], end: int) -> None:
        clock = self.clock
        if not isinstance(clock, VirtualClock):
            clock.wait(is_over, max(0, end - clock.now()))
            return
        while not is_over():  # asked once a millisecond, not after each event
            if clock.next_event is None and end >= 1 << 62:
                raise CallerError("nothing will ever happen here, and the run has no end: give it one")
            if clock.now() >= end:
                return
            clock.advance_to(min(end, clock.now() + STEP_NS))

    def stop(self, reason: str = "") -> Ended:
        """Stop motion, controllers, buses, logs; in this order, whatever fails on the way.

        Called again after it was interrupted, it goes on where it was.
        """
        if self._phase != "over":
            self._seconds, self._reason = self.seconds, reason or self._reason
            was, self._phase = self._phase, "over"
            now = self.clock.now()
            drove = was != "new" and self.drives
            if drove:
                if was != "running":  # nothing is left on that has not run
                    self.at_end = "disable"
                self._to_end.append(("stop", partial(self._in_time, self._begin_stop)))
            if was == "running":
                self._to_end.append(("tasks", self.tasks.stop))
                self._to_end += [(one.name, partial(one.stop, now)) for one in self.supervisors]
            if drove:
                self._to_end.append(("stop", self._await_stopped))
            self._to_end.append(("buses", lambda: self._in_time(self.rig.close)))
            self._to_end += [("end", end) for end in self.after]
            self._to_end += [(one.name, partial(self._close_log, one)) for one in self._logging]
        interrupted: BaseException | None = None
        while self._to_end:
            source, action = self._to_end[0]
            try:
                action()
            except Exception as error:  # whatever it is, the rest is done
                self._fault(source, error)
            except BaseException as error:  # Ctrl-C: the rest is done, and then it is raised
                interrupted = error
            self._to_end.popleft()
        if interrupted is not None:
            raise interrupted
        return self.ended(reason)

    def _close_log(self, logger: RunLogger) -> None:
        logger.stop(self.clock.now())

    def _begin_stop(self) -> None:
        """On the buses' thread: all is stopped, or where it is to be left held, what was not switched off stays."""
        devices = list(self.rig.devices.values())
        if self.at_end == "hold":
            self._tripped = self._reasons
            for supervisor in self.supervisors:  # to a stand
                supervisor.guard.trip("the run is over", "hold")
                self._give(supervisor.guard.tick(self.clock.now()))
            off = [s for s in self.supervisors if s.name in self._stopped]
            devices = list({d.name: d for s in off for d in self.driven(s)}.values())
            self._held = [d.name for d in self.rig.devices.values() if d.is_driven and d not in devices]
        self._stopping = stop_devices(self.clock, self.rig.robot.name, devices)

    def _await_stopped(self) -> None:
        if self._stopping is None:  # interrupted, or it failed, which has been said
            self._not_stopped = dict.fromkeys(self.rig.devices, "its stop could not begin")
            self._in_time(self._begin_stop)
            self._not_stopped = {}
        assert self._stopping is not None
        self._confirm(self._stopping)
        done = {*self._not_stopped, *self._held}
        late = [d for d in self.rig.devices.values() if d.is_driven and d.name not in done]
        if late:  # something enabled them after the stop had begun
            self._confirm(self._in_time(partial(stop_devices, self.clock, self.rig.robot.name, late)))

    def _confirm(self, stopping: Job) -> None:
        """Wait for a stop; who has not stopped is noted, with why."""
        try:
            wait_stopped(stopping)
        except DeviceError as error:
            if not isinstance(stopping.error, NotStoppedError):
                self._fault("stop", str(error))
                self._not_stopped.update(dict.fromkeys(self.rig.devices, str(error)))
        finally:
            if isinstance(stopping.error, NotStoppedError):
                self._not_stopped.update(stopping.error.devices)
                for name, why in stopping.error.devices.items():
                    self._fault(name, why)

    def _in_time(self, action: Callable[[], T]) -> T:
        """Do it on the buses' thread, which may hang or be gone: then, after a while, here."""
        clock = self.clock
        if not isinstance(clock, Loop):
            return action()
        done: Future[T] = Future()

        def run() -> None:
            if done.set_running_or_notify_cancel():
                try:
                    done.set_result(action())
                except BaseException as error:  # it is raised where it was asked for
                    done.set_exception(error)

        clock.call_soon(run)
        try:
            return done.result(PATIENCE_S)
        except TimeoutError:
            if done.cancel():
                return action()
            raise

    def ended(self, reason: str = "") -> Ended:
        """How it ended."""
        return Ended(
            reason or self._reason,
            self._reasons if self._tripped is None else self._tripped,
            self._seconds,
            list(self._failed_at_end),
            dict(self._not_stopped),
            list(self._held),
        )

    @property
    def _reasons(self) -> dict[str, str]:
        return {**self._stopped, **{s.name: s.reason for s in self.supervisors if s.reason}}

    @property
    def stopped(self) -> dict[str, str]:
        """Controllers that were stopped, with why; those that are `held` are not among them."""
        return dict(self._stopped)

    @property
    def used(self) -> list[str]:
        """The states that controllers read or write, as they call them."""
        names = [name for s in self.supervisors for name in (*s.writes, *s.states)]
        return list(dict.fromkeys(names))
