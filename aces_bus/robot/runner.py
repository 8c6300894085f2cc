"""Controllers on a robot: states up, set-points down, errors by the shortcut, one clean end.

1. What runs is the same in every world (real buses, virtual time, a replay): only the clock and the tasks differ.
2. A controller's thread computes and nothing else. Guards, reactions and stops are on the thread of the buses.
3. Each controller has a guard and a supervisor: a dead-man, trips, reactions to events. The door limits what it gives.
4. No wait here is without an end.

Controllers are stepped with the instants that their cycles were due: they and their guards see even steps, however late
a thread woke up. Set-points that come after the end, or after a trip, go nowhere. What faults lead to is in
`run_faults`, how a run ends in `run_end`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Literal

from ..controller import IGNORE, Guard, Supervisor, bounds_of
from ..controller.base import ControllerLike
from ..controller.events import EventLike, Listeners
from ..controller.limiter import Bounds
from ..controller.reactions import Reaction
from ..controller.trip import Action
from ..device import Device
from ..errors import AcesError, CallerError, DeviceError, NotStoppedError, UnknownNameError
from ..runtime import ThreadTasks, VirtualClock
from ..runtime.loop import Loop
from ..runtime.tasks import Task, Tasks, VirtualTasks
from .checks import KINDS_OF_FAULTS
from .exits import stop_at_exit
from .park import Parking
from .rig import Rig
from .run import Run, RunLogger
from .run_end import Ended, RunEnd
from .run_faults import OF_LOGS, RunFaults

#: Priorities of components by default: buses above control above logging.
CONTROL, LOGGING = 40, 5
#: A controller that gives nothing for so many of its periods, and so many seconds, is taken for dead.
DEAD_PERIODS, DEAD_S = 5, 0.1
#: Seconds in which every polled device must have answered before controllers begin.
RECEIVE_S = 5.0
#: How often a run in virtual time looks at its end (ns).
STEP_NS = 1_000_000


class Runner:
    """Runs controllers and loggers on a rig. Made by `run_virtual`, `run_real`, `run_replay`, or by hand.

    `tasks`: threads or events. `reactions` add to the robot file's, and these to the supervisor's; those that name functions
    find them in `own_reactions`. `on_trip` is what stops motion where no reaction says how: "park" ends the run as `at_end`
    does, "hold" ends after `hold_s` (None: with `release`, or the run), then what was held is switched off. At the end
    `at_end` "hold" leaves what runs as it is, "park" leads it to the file's pose before it is switched off. `guard` False
    leaves the dead-man away (the door's limits stay). `drives` False: set-points are counted and not sent (a replay).
    `states` declares states (name → keywords of `State`), see `States`. Rates and priorities of the robot's file replace the
    controllers' own. `unhomed`: joints that are not homed are driven, too.
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
        at_end: Literal["disable", "hold", "park"] = "disable",
        drives: bool = True,
        history: int = 512,
        states: Mapping[str, Mapping[str, Any]] | None = None,
        unhomed: bool = False,
    ) -> None:
        self._run = run = Run(rig, drives=drives, history=history, states=states)
        self.rig, self.clock, self.drives, self.states = rig, rig.clock, drives, run.states
        self.supervisors, self.events, self.handlers, self.given = (
            run.supervisors,
            run.events,
            run.handlers,
            run.given,
        )
        self.loggers = list(loggers)
        if tasks is None:
            tasks = ThreadTasks(self.clock) if isinstance(self.clock, Loop) else VirtualTasks(self.clock)
        self.tasks = tasks
        #: What is done before the buses are opened and after they are closed: loops, twins.
        self.before: list[Callable[[], object]] = []
        self.after: list[Callable[[], object]] = []
        #: The virtual robot or replay behind it; None on real buses.
        self.world: Any = None
        self._is_bound = False
        self._faults = RunFaults(run, [logger.name for logger in loggers], hold_s)
        rig.door.takes_unhomed = unhomed
        self.tasks.failed = self._faults.task_failed
        names = [*(controller.name for controller in controllers), *(logger.name for logger in loggers)]
        double = {name for name in names if names.count(name) > 1}
        if double:
            raise CallerError(f"two controllers or loggers have one name: {', '.join(sorted(double))}")
        declared = Reaction.parse(
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
            supervisor.guard.is_dry = not drives
            self.supervisors.append(supervisor)
            self._add_task(controller, self._stepper(supervisor), CONTROL)
        parks = at_end == "park" or any(map(_may_park, self.supervisors))
        self._end = RunEnd(
            run,
            self._faults,
            tasks,
            at_end=at_end,
            parking=Parking(rig) if parks else None,
            after=self.after,
        )
        for logger in self.loggers:
            listeners = getattr(logger, "listeners", None)
            if isinstance(listeners, Listeners):
                listeners.add(self._faults.emit_all)
            self._add_task(logger, logger.step, LOGGING)
        rig.on_event(self._faults.happened)
        rig.chain.tripped.append(self._faults.estopped)

    @property
    def unparkable(self) -> dict[str, str]:
        """The joints that this run drives and its end cannot park, with why; none where it is not to park."""
        devices = {d.name: d for s in self.supervisors for d in self.driven(s)}
        parking = self._end.parking
        return {} if parking is None else parking.unable(devices.values())

    # ------------------------------------------------------------------ what is known of it

    @property
    def set_points(self) -> int:
        """Number of set-points that were handed down."""
        return self._run.set_points

    @property
    def seconds(self) -> float:
        """Duration of the run so far, in seconds."""
        return self._run.seconds

    @property
    def stopped(self) -> dict[str, str]:
        """Controllers that were stopped, with why; those that are `held` are not among them."""
        return dict(self._faults.stopped)

    @property
    def held(self) -> dict[str, str]:
        """Controllers whose joints are held where they are, with why."""
        return self._faults.held

    @property
    def letting_go(self) -> dict[str, str]:
        """The driven devices that an end with "hold" stops all the same, as they would not stay: name → why."""
        return self._end.letting_go

    def driven(self, supervisor: Supervisor) -> list[Device]:
        """Return the devices that a controller gives set-points to; all of them where it does not say."""
        return self._run.driven(supervisor)

    def ended(self) -> Ended:
        """Return how the run ended, as far as it has."""
        return self._end.ended()

    def bus_failed(self, error: BaseException) -> None:
        """Report to every supervisor what was raised on the buses' thread."""
        self._faults.bus_failed(error)

    def release(self, controller: str) -> None:
        """Let a controller's set-points through again after a trip; what was switched off has to be enabled before.

        Raises `UnknownNameError`, and `CallerError` while an e-stop input is pressed.
        """
        self._faults.release(controller)

    # ------------------------------------------------------------------ making

    def _add_task(
        self, component: ControllerLike | RunLogger, step: Callable[[int], object], priority: int
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
            unnamed_s=dead_man,
            name=controller.name,
        )
        # What a log cannot take is not a reason to stop a robot, unless that is declared.
        supervisor = Supervisor(
            controller, made, {**dict.fromkeys(OF_LOGS, IGNORE), **reactions}, dead_man_s=dead_man
        )
        self._listen(supervisor)
        return supervisor

    def _listen(self, supervisor: Supervisor) -> None:
        """Have what controller, guard and supervisor report among the events."""
        for listeners in (
            getattr(supervisor.controller, "listeners", None),
            supervisor.guard.listeners,
            supervisor.listeners,
        ):
            if isinstance(listeners, Listeners):
                listeners.add(self._run.note)

    def _task_of(self, name: str) -> Task:
        return next(task for task in self.tasks.tasks if task.name == name)

    def _stepper(self, supervisor: Supervisor) -> Callable[[int], None]:
        compute, name, inside = supervisor.compute, supervisor.name, self._faults.inside
        is_direct = not isinstance(self.tasks, ThreadTasks)
        task: Task | None = None

        def run(now: int) -> None:
            nonlocal task
            if task is None:
                task = self._task_of(name)
            due = now - task.lateness_ns
            if is_direct:
                self._faults.attend(supervisor, now)
                self._pass_on(supervisor, due, compute(due))
                return
            inside[name] = now
            wanted = compute(due)
            inside.pop(name, None)
            self.clock.call_soon(lambda: self._pass_on(supervisor, due, wanted))

        return run

    def _pass_on(self, supervisor: Supervisor, now: int, wanted: Mapping[str, float]) -> None:
        """Pass on what a controller wants through its guard, on the buses' thread; what comes after the end goes nowhere."""
        if self._run.phase == "running":
            given = supervisor.pass_on(now, wanted)
            self._faults.obey(supervisor)
            self._run.give(given)

    # ------------------------------------------------------------------ running

    def __repr__(self) -> str:
        seconds = f", {self.seconds:.3f} s" if self._run.phase == "running" else ""
        return f"<run of {self.rig.robot.name}: {self._run.phase}{seconds}>"

    def __enter__(self) -> Runner:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        was_over = self._run.phase == "over" and not self._end.left
        ended = self.stop("the program left it")
        if ended.not_stopped and kind is None and not was_over:  # else `run` or `stop` has returned it
            raise NotStoppedError(ended.not_stopped)

    def open(self) -> None:
        """Open the buses, and wait until every polled device has been received or `RECEIVE_S` are over.

        Whatever opening raises comes out, with all closed again; `CallerError` for a bus rate that cannot be.
        """
        self.bind()
        if self.drives:
            for host in self.rig.hosts.values():
                host.check_rate()
        if self.drives:
            stop_at_exit(self.rig, self._end_at_exit)
        try:
            for begin in self.before:
                begin()
            self.clock.call(self._open_hosts)
            if any(host.rate_hz for host in self.rig.hosts.values()):
                polled = [device for device in self.rig.devices.values() if device.polls]
                self.clock.wait(
                    lambda: all(device.last_received is not None for device in polled), round(RECEIVE_S * 1e9)
                )
        except BaseException:
            self.stop("it could not be opened")
            raise
        chain = self.rig.chain
        if self.drives and chain.waits_for:
            self.clock.wait(lambda: not chain.waits_for, round(RECEIVE_S * 1e9))
        self._run.phase = "ready"

    def _end_at_exit(self) -> None:
        """Stop; raises `NotStoppedError`, as there is nobody who reads how it ended."""
        ended = self.stop("the program ended")
        if ended.not_stopped:
            raise NotStoppedError(ended.not_stopped)

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
        """The polled devices of which nothing was ever received."""
        return [d.name for d in self.rig.devices.values() if d.polls and d.last_received is None]

    @property
    def unhomed(self) -> list[str]:
        """The driven joints that take no set-points, as they are not homed or it is not known yet whether they are."""
        driven = {
            joint.name
            for supervisor in self.supervisors
            for device in self.driven(supervisor)
            for joint in device.joints
        }
        return (
            [] if self.rig.door.takes_unhomed else [name for name in self.rig.door.unhomed if name in driven]
        )

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
        found = dict.fromkeys(
            self.rig.device(device) if isinstance(device, str) else device for device in some
        )
        able = [device for device in found if action in device.actions]

        self.clock.call(lambda: self.rig.each(action, able)).wait(timeout_s)
        return [device.name for device in able]

    def start(self) -> None:
        """Start controllers and loggers.

        Raises `UnknownNameError` for a state that the robot has not, `DeviceError` after another program's stop.
        """
        self.bind()
        if self.rig.stopped_by:
            raise DeviceError(f"{self.rig.robot.name} was stopped by {self.rig.stopped_by}: release it first")
        for logger in self.loggers:  # files take their time
            self._end.logs.append(logger)
            logger.start(self.clock.now())
        self._run.began = now = self.clock.now()
        for supervisor in self.supervisors:
            supervisor.start(now)
        self._run.phase = "running"
        if self.drives and self.rig.door.barred:
            self.clock.call(lambda: self._faults.estopped(self.rig.door.barred))
        self.tasks.start()
        if isinstance(self.tasks, ThreadTasks):
            self.clock.call_soon(self._faults.watch)

    def bind(self) -> None:
        """Give controllers and loggers their states; may be done before the buses are opened. Raises as `start`."""
        if not self._is_bound:
            if self._run.phase == "new":
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

    def run(self, seconds: float | None = None, until: Callable[[], bool] | None = None) -> Ended:
        """Start, let it run until its time is up, `until()` holds or every controller has been stopped, and stop.

        `until` is asked every millisecond. What it raises comes out, with motion stopped and all closed.
        """
        reason = ""
        try:
            if self._run.phase == "new":
                self.open()
            self.start()
            end = None if seconds is None else self._run.began + round(seconds * 1e9)

            def is_over() -> bool:
                nonlocal reason
                if self.rig.stopped_by:
                    reason = f"stopped by {self.rig.stopped_by}"
                    return True
                if self._faults.to_park:
                    reason = f"to be parked: {', '.join(self._faults.to_park)}"
                    return True
                if self._faults.stopped and len(self._faults.stopped) == len(self.supervisors):
                    reason = "every controller was stopped"
                    return True
                return until is not None and until()

            self._let_pass(is_over, (1 << 62) if end is None else end)
        except BaseException as error:
            self.stop(f"{type(error).__name__}: {error}".rstrip(": "))
            raise
        return self.stop(reason)

    def stop(self, reason: str = "") -> Ended:
        """Stop motion, controllers, buses, logs; in this order, whatever fails on the way.

        Called again after it was interrupted, it goes on where it was.
        """
        return self._end.stop(reason)

    def _let_pass(self, is_over: Callable[[], bool], end: int) -> None:
        clock = self.clock
        if not isinstance(clock, VirtualClock):
            clock.wait(is_over, max(0, end - clock.now()))
            return
        while not is_over():  # asked once a millisecond, not after each event
            if clock.next_event is None and end >= 1 << 62:
                raise CallerError("no event is scheduled and the run has no end; pass `seconds` or `until`")
            if clock.now() >= end:
                return
            clock.advance_to(min(end, clock.now() + STEP_NS))

    @property
    def used(self) -> list[str]:
        """The states that controllers read or write, as they call them."""
        names = [name for s in self.supervisors for name in (*s.writes, *s.states)]
        return list(dict.fromkeys(names))


def _may_park(supervisor: Supervisor) -> bool:
    """Return whether a trip of this controller may ask for the way to the robot's pose."""
    found = supervisor.reactions.values()
    reactions = [reaction for some in found for reaction in ((some,) if isinstance(some, Reaction) else some)]
    return "park" in (supervisor.guard.action, *(reaction.action for reaction in reactions))


__all__ = ["Ended", "RunLogger", "Runner"]
