"""The one end of a run: motion stops, controllers end, buses close, logs close.

Each happens once, in this order, whatever fails on the way. No wait here is without an end, and who interrupts it (Ctrl-C)
does not shorten it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

from ..controller import ControlEvent
from ..controller.events import raised_text
from ..device import Job, stop_devices, wait_stopped
from ..errors import DeviceError, NotStoppedError
from ..runtime import Loop
from .exits import is_ended
from .run_base import RunLogger
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


class RunEnd(RunFaults):
    """The end of a run: everything is stopped and closed, whatever ended it."""

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
                # Nothing is left on that has not run, or was stopped.
                if was != "running" or self.rig.stopped_by:
                    if self._parking is not None and self.rig.stopped_by:
                        self._parking.refuse(f"stopped by {self.rig.stopped_by}")
                    self.at_end = "disable"
                elif self._to_park:
                    self.at_end = "park"
                if self.at_end == "park":
                    self._to_end.append(("park", self._park))
                self._to_end.append(("stop", partial(self._in_time, self._begin_stop)))
            if was == "running":
                self._to_end.append(("tasks", self.tasks.stop))
                self._to_end += [(one.name, partial(one.stop, now)) for one in self.supervisors]
            if drove:
                self._to_end.append(("stop", self._await_stopped))
            for name, host in self.rig.hosts.items():
                self._to_end.append((f"bus {name}", partial(self._in_time, host.close)))
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
        is_ended(self.rig)
        if interrupted is not None:
            raise interrupted
        return self.ended(reason)

    def ended(self, reason: str = "") -> Ended:
        """Return how the run ended, as far as it has."""
        return Ended(
            reason or self._reason,
            self._reasons if self._tripped is None else self._tripped,
            self._seconds,
            list(self._failed_at_end),
            dict(self._not_stopped),
            list(self._held),
            dict(self._falling),
            [] if self._parking is None else list(self._parking.parked),
            {} if self._parking is None else dict(self._parking.failed),
        )

    @property
    def letting_go(self) -> dict[str, str]:
        """The driven devices that an end with "hold" stops all the same, as they would not stay: name → why."""
        if self.at_end != "hold":
            return {}
        driven = {one.name: one for supervisor in self.supervisors for one in self.driven(supervisor)}
        return {name: one.lets_go for name, one in driven.items() if one.lets_go}

    @property
    def _reasons(self) -> dict[str, str]:
        return {**self._stopped, **{s.name: s.reason for s in self.supervisors if s.reason}}

    @property
    def stopped(self) -> dict[str, str]:
        """Controllers that were stopped, with why; those that are `held` are not among them."""
        return dict(self._stopped)

    @property
    def seconds(self) -> float:
        """Duration of the run so far, in seconds."""
        return (self.clock.now() - self._began) / 1e9 if self._phase == "running" else 0.0

    # ------------------------------------------------------------------ its parts

    def _close_log(self, logger: RunLogger) -> None:
        logger.stop(self.clock.now())

    def _park(self) -> None:
        """Lead all to the pose of the robot's file; what interrupts it leads to the stop, at once."""
        parking = self._parking
        if parking is None:
            return
        if self.rig.door.barred:
            parking.refuse(self.rig.door.barred)
            return
        try:
            left = {trip.source: f"it tripped: {trip.reason}" for trip in self._to_park.values()}
            for supervisor in self.supervisors:
                if supervisor.name in self._stopped:
                    why = f"it was stopped: {self._stopped[supervisor.name]}"
                    left.update(dict.fromkeys((device.name for device in self.driven(supervisor)), why))
            seconds = self._in_time(partial(parking.begin, left))
            if not self.clock.wait(parking.is_over, round(seconds * 1e9)):
                parking.give_up(f"it has not arrived after {seconds:.1f} s")
        except BaseException as error:
            parking.give_up(raised_text(error))
            raise

    def _begin_stop(self) -> None:
        """Stop all, on the buses' thread; where it is to be left held, what was not switched off stays."""
        devices = list(self.rig.devices.values())
        if self.at_end == "hold":
            self._tripped = self._reasons
            for supervisor in self.supervisors:  # to a stand
                supervisor.guard.trip("the run is over", "hold")
                self._give(supervisor.guard.tick(self.clock.now()))
            off = [s for s in self.supervisors if s.name in self._stopped]
            devices = list({d.name: d for s in off for d in self.driven(s)}.values())
            for host in self.rig.hosts.values():
                host.send_set_points()
            left = [d for d in self.rig.devices.values() if d.is_driven and d not in devices]
            self._falling = {device.name: device.lets_go for device in left if device.lets_go}
            for name, why in self._falling.items():  # before it happens
                self._note(ControlEvent("let go", self.clock.now(), name, why))
            devices += [device for device in left if device.name in self._falling]
            self._held = [device.name for device in left if device.name not in self._falling]
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
            raise TimeoutError(f"not over after {PATIENCE_S:g} s") from None
