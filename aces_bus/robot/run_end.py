"""The one end of a run: motion stops, controllers end, buses close, logs close.

Each happens once, in this order, whatever fails on the way. No wait here is without an end, and who interrupts it (Ctrl-C)
does not shorten it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, TypeVar

from ..controller import ControlEvent
from ..controller.events import raised_text
from ..device import Job
from ..device.stopping import stop_devices, wait_stopped
from ..errors import DeviceError, NotStoppedError
from ..runtime.clock import EventClock
from ..runtime.loop import Loop
from ..runtime.tasks import Tasks
from .exits import is_ended
from .park import Parking
from .run import Run, RunLogger
from .run_faults import RunFaults

T = TypeVar("T")

#: Seconds that any one part of an end may take.
PATIENCE_S = 2.0


@dataclass
class Ended:
    """How a run ended: `reason` "" for its time being up; `tripped` controllers with why; `failed` what went wrong at the
    end itself, and of that `not_stopped` the devices that may still move, with why. `held`: those left as they were, on
    request; `let_go`: those that would not have stayed there, and were stopped instead, with why. `parked`: joints
    that came to the pose of the robot's file before they were switched off; `not_parked`: the other driven ones, with why.
    """

    reason: str
    tripped: dict[str, str]
    seconds: float
    failed: list[str] = field(default_factory=list[str])
    not_stopped: dict[str, str] = field(default_factory=dict[str, str])
    held: list[str] = field(default_factory=list[str])
    let_go: dict[str, str] = field(default_factory=dict[str, str])
    parked: list[str] = field(default_factory=list[str])
    not_parked: dict[str, str] = field(default_factory=dict[str, str])


class RunEnd:
    """The end of a run: everything is stopped and closed, whatever ended it.

    `after`: what is done after the buses are closed. `parking`: the way to the robot's pose, where this end or a trip parks.
    """

    def __init__(
        self,
        run: Run,
        faults: RunFaults,
        tasks: Tasks,
        *,
        at_end: Literal["disable", "hold", "park"],
        parking: Parking | None,
        after: Sequence[Callable[[], object]],
    ) -> None:
        self.run, self.faults, self.tasks, self.parking, self.after = run, faults, tasks, parking, after
        self.at_end = at_end
        #: The loggers that were started.
        self.logs: list[RunLogger] = []
        #: Parts of the end that are still to be done: source, action.
        self.left: deque[tuple[str, Callable[[], object]]] = deque()
        self._reason = ""
        self._seconds = 0.0
        self._stopping: Job | None = None
        self._failed: list[str] = []
        self._not_stopped: dict[str, str] = {}
        self._held: list[str] = []
        self._falling: dict[str, str] = {}
        #: Why controllers were stopped, before an end that holds.
        self._tripped: dict[str, str] | None = None

    def stop(self, reason: str = "") -> Ended:
        """Stop motion, controllers, buses, logs; in this order, whatever fails on the way.

        Called again after it was interrupted, it goes on where it was.
        """
        if self.run.phase != "over":
            self._seconds, self._reason = self.run.seconds, reason or self._reason
            was, self.run.phase = self.run.phase, "over"
            now = self.run.clock.now()
            drove = was != "new" and self.run.drives
            if drove:
                # Nothing is left on that has not run, or was stopped.
                if was != "running" or self.run.rig.stopped_by:
                    if self.parking is not None and self.run.rig.stopped_by:
                        self.parking.refuse(f"stopped by {self.run.rig.stopped_by}")
                    self.at_end = "disable"
                elif self.faults.to_park:
                    self.at_end = "park"
                if self.at_end == "park":
                    self.left.append(("park", self._park))
                self.left.append(("stop", partial(in_time, self.run.clock, self._begin_stop)))
            if was == "running":
                self.left.append(("tasks", self.tasks.stop))
                self.left += [
                    (supervisor.name, partial(supervisor.stop, now)) for supervisor in self.run.supervisors
                ]
            if drove:
                self.left.append(("stop", self._await_stopped))
            for name, host in self.run.rig.hosts.items():
                self.left.append((f"bus {name}", partial(in_time, self.run.clock, host.close)))
            self.left += [("end", end) for end in self.after]
            self.left += [(log.name, partial(self._close_log, log)) for log in self.logs]
        interrupted: BaseException | None = None
        while self.left:
            source, action = self.left[0]
            try:
                action()
            except Exception as error:  # whatever it is, the rest is done
                self._fault(source, error)
            except BaseException as error:  # Ctrl-C: the rest is done, and then it is raised
                interrupted = error
            self.left.popleft()
        is_ended(self.run.rig)
        if interrupted is not None:
            raise interrupted
        return self.ended(reason)

    def ended(self, reason: str = "") -> Ended:
        """Return how the run ended, as far as it has."""
        return Ended(
            reason or self._reason,
            self._reasons if self._tripped is None else self._tripped,
            self._seconds,
            list(self._failed),
            dict(self._not_stopped),
            list(self._held),
            dict(self._falling),
            [] if self.parking is None else list(self.parking.parked),
            {} if self.parking is None else dict(self.parking.failed),
        )

    @property
    def letting_go(self) -> dict[str, str]:
        """The driven devices that an end with "hold" stops all the same, as they would not stay: name → why."""
        if self.at_end != "hold":
            return {}
        driven = {
            device.name: device
            for supervisor in self.run.supervisors
            for device in self.run.driven(supervisor)
        }
        return {name: device.lets_go for name, device in driven.items() if device.lets_go}

    @property
    def _reasons(self) -> dict[str, str]:
        return {**self.faults.stopped, **{s.name: s.reason for s in self.run.supervisors if s.reason}}

    # ------------------------------------------------------------------ its parts

    def _fault(self, source: str, error: BaseException | str) -> None:
        """Note a fault of the end, which goes on."""
        said = error if isinstance(error, str) else raised_text(error)
        self._failed.append(f"{source}: {said}")
        self.run.note(ControlEvent("failed", self.run.clock.now(), source, said))

    def _close_log(self, logger: RunLogger) -> None:
        logger.stop(self.run.clock.now())

    def _park(self) -> None:
        """Lead all to the pose of the robot's file; what interrupts it leads to the stop, at once."""
        parking = self.parking
        if parking is None:
            return
        if self.run.rig.door.barred:
            parking.refuse(self.run.rig.door.barred)
            return
        try:
            left = {trip.source: f"it tripped: {trip.reason}" for trip in self.faults.to_park.values()}
            for supervisor in self.run.supervisors:
                if supervisor.name in self.faults.stopped:
                    why = f"it was stopped: {self.faults.stopped[supervisor.name]}"
                    left.update(dict.fromkeys((device.name for device in self.run.driven(supervisor)), why))
            seconds = in_time(self.run.clock, partial(parking.begin, left))
            if not self.run.clock.wait(parking.is_over, round(seconds * 1e9)):
                parking.give_up(f"it has not arrived after {seconds:.1f} s")
        except BaseException as error:
            parking.give_up(raised_text(error))
            raise

    def _begin_stop(self) -> None:
        """Stop all, on the buses' thread; where it is to be left held, what was not switched off stays."""
        devices = list(self.run.rig.devices.values())
        if self.at_end == "hold":
            self._tripped = self._reasons
            for supervisor in self.run.supervisors:  # to a stand
                supervisor.guard.trip("the run is over", "hold")
                self.run.give(supervisor.guard.tick(self.run.clock.now()))
            off = [s for s in self.run.supervisors if s.name in self.faults.stopped]
            devices = list({d.name: d for s in off for d in self.run.driven(s)}.values())
            for host in self.run.rig.hosts.values():
                host.send_set_points()
            left = [d for d in self.run.rig.devices.values() if d.is_driven and d not in devices]
            self._falling = {device.name: device.lets_go for device in left if device.lets_go}
            for name, why in self._falling.items():  # before it happens
                self.run.note(ControlEvent("let go", self.run.clock.now(), name, why))
            devices += [device for device in left if device.name in self._falling]
            self._held = [device.name for device in left if device.name not in self._falling]
        self._stopping = stop_devices(self.run.clock, self.run.rig.robot.name, devices)

    def _await_stopped(self) -> None:
        if self._stopping is None:  # interrupted, or it failed, which has been said
            self._not_stopped = dict.fromkeys(self.run.rig.devices, "its stop could not begin")
            in_time(self.run.clock, self._begin_stop)
            self._not_stopped = {}
        assert self._stopping is not None
        self._confirm(self._stopping)
        done = {*self._not_stopped, *self._held}
        late = [d for d in self.run.rig.devices.values() if d.is_driven and d.name not in done]
        if late:  # something enabled them after the stop had begun
            self._confirm(
                in_time(self.run.clock, partial(stop_devices, self.run.clock, self.run.rig.robot.name, late))
            )

    def _confirm(self, stopping: Job) -> None:
        """Wait for a stop; who has not stopped is noted, with why."""
        try:
            wait_stopped(stopping)
        except DeviceError as error:
            if not isinstance(stopping.error, NotStoppedError):
                self._fault("stop", str(error))
                self._not_stopped.update(dict.fromkeys(self.run.rig.devices, str(error)))
        finally:
            if isinstance(stopping.error, NotStoppedError):
                self._not_stopped.update(stopping.error.devices)
                for name, why in stopping.error.devices.items():
                    self._fault(name, why)


def in_time(clock: EventClock, action: Callable[[], T]) -> T:
    """Do it on the buses' thread, which may hang or be gone: then, after a while, here."""
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
        raise TimeoutError(f"not over after {PATIENCE_S:g} s") from None
