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

from ..device import Job, stop_devices, wait_stopped
from ..errors import DeviceError, NotStoppedError
from ..runtime import Loop
from .run_base import RunLogger
from .run_faults import RunFaults

T = TypeVar("T")

#: Seconds that any one part of an end may take.
PATIENCE_S = 2.0


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
                if was != "running":  # nothing is left on that has not run
                    self.at_end = "disable"
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
        if interrupted is not None:
            raise interrupted
        return self.ended(reason)

    def ended(self, reason: str = "") -> Ended:
        """How the run ended, as far as it has."""
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
    def seconds(self) -> float:
        """How long it has been running."""
        return (self.clock.now() - self._began) / 1e9 if self._phase == "running" else 0.0

    # ------------------------------------------------------------------ its parts

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
            raise TimeoutError(f"not over after {PATIENCE_S:g} s") from None
