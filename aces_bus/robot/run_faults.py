"""What faults lead to: an event reaches every supervisor at once, and what a guard trips is stopped, or held.

1. All of it is on the thread of the buses, where nothing waits for a controller: what a fault stops is stopped when the
   fault is received, whatever the controller's rate.
2. When a guard trips, the devices that its controller drives are stopped as declared, or held where they are with live
   set-points; "park" then ends the run, whose end parks them.
3. A stop that was not confirmed is owed: it is repeated when the bus or the device is back.
"""

from __future__ import annotations

from collections.abc import Collection

from ..controller import ControlEvent, Supervisor
from ..controller.events import EventLike, raised_text
from ..controller.trip import HOLDING, Trip
from ..device import Device, Job
from ..device.events import DeviceEvent
from ..device.stopping import stop_devices
from ..errors import CallerError, NotStoppedError, UnknownNameError
from ..runtime.tasks import Task
from .run import Run

#: Events after which a stop that was not confirmed is sent again.
BACK = frozenset({"reopened", "recovered", "error-active", "answers", "rebooted"})
#: How often the buses' thread looks whether controllers still come back (ns).
WATCH_NS = 20_000_000
#: Events of logs.
OF_LOGS = ("log-failed", "log-dropped")
#: A repeated failure is reported this often at most (ns).
REPEAT_NS = 1_000_000_000


class RunFaults:
    """The way from events to stops.

    `logs`: names of loggers, whose failures have a kind of their own. `hold_s`: seconds after which what a trip holds is
    switched off; None: it is held until it is released.
    """

    def __init__(self, run: Run, logs: Collection[str], hold_s: float | None) -> None:
        self.run, self.logs, self.hold_s = run, logs, hold_s
        #: Controller → why what it drives was switched off.
        self.stopped: dict[str, str] = {}
        #: Controller → its trip that asks for the way to the pose.
        self.to_park: dict[str, Trip] = {}
        #: Controller → the instant (ns) at which it began a step that is not over yet.
        self.inside: dict[str, int] = {}
        #: Controller → the begin of the step that it was last taken for dead in.
        self._dead_since: dict[str, int] = {}
        #: Controller → the trip that was last acted upon.
        self._obeyed: dict[str, Trip] = {}
        #: Source → the instant (ns) at which a failure of it was last reported.
        self._reported: dict[str, int] = {}
        #: Devices whose stop was not confirmed, by name.
        self._owed: dict[str, Device] = {}
        self._is_attending = False

    # ------------------------------------------------------------------ events

    def happened(self, event: DeviceEvent) -> None:
        """Pass an event of a device or bus to every supervisor at once, before anything else happens."""
        self.run.note(event)
        if self.run.phase == "running":
            self._handle(event)
            if self._owed and event.kind in BACK:
                self.run.clock.call_soon(lambda: self._repay(event.source))

    def estopped(self, reason: str) -> None:
        """Stop all controllers, whatever they declare: an e-stop input or another program has stopped the devices."""
        if self.run.phase == "running" and self.run.drives:
            now = self.run.clock.now()
            for supervisor in self.run.supervisors:
                supervisor.guard.trip(reason, "disable")
                supervisor.guard.tick(now)
                trip = supervisor.guard.tripped
                assert trip is not None
                self._obeyed[supervisor.name] = trip
                self.stopped[supervisor.name] = trip.reason

    def _handle(self, event: EventLike) -> None:
        for supervisor in self.run.supervisors:
            supervisor.handle(event)
        if not self._is_attending:
            self._is_attending = True
            self.run.clock.call_soon(self._attend_all)

    def _attend_all(self) -> None:
        self._is_attending = False
        now = self.run.clock.now()
        for supervisor in self.run.supervisors:
            self.attend(supervisor, now)

    def attend(self, supervisor: Supervisor, now: int) -> None:
        if self.run.phase == "running" and supervisor.has_events:
            given = supervisor.attend(now)
            self.obey(supervisor)
            self.run.give(given)

    def task_failed(self, task: Task, error: BaseException) -> None:
        """Handle a logger that raised; controllers have supervisors for that."""
        self._raised(task.name, OF_LOGS[0] if task.name in self.logs else "raised", error)

    def bus_failed(self, error: BaseException) -> None:
        """Handle an exception on the buses' thread."""
        self._raised("buses", "bug", error)

    def _raised(self, source: str, kind: str, error: BaseException) -> None:
        now = self.run.clock.now()
        if now - self._reported.get(source, -REPEAT_NS) >= REPEAT_NS:
            self._reported[source] = now
            self.emit_all(ControlEvent(kind, now, source, raised_text(error)))

    def emit_all(self, event: ControlEvent) -> None:
        """Report to every supervisor, too, what a component reports."""
        self.run.note(event)
        self._handle(event)

    def watch(self) -> None:
        """Look, on the buses' thread, for a controller that does not come back from a step: it cannot say so itself."""
        if self.run.phase != "running":
            return
        self.run.clock.call_in(WATCH_NS, self.watch)
        now = self.run.clock.now()
        for supervisor in self.run.supervisors:
            name = supervisor.name
            began = self.inside.get(name, now)
            if supervisor.is_overdue(now, began) and self._dead_since.get(name) != began:
                self._dead_since[name] = began
                given = supervisor.emit_dead(
                    now, f"its step has not come back for {(now - began) / 1e9:.3f} s"
                )
                self.obey(supervisor)
                self.run.give(given)

    # ------------------------------------------------------------------ stops and holds

    def obey(self, supervisor: Supervisor) -> None:
        """Hold or switch off what a controller drives, as declared, after its guard has stopped motion."""
        trip = supervisor.guard.tripped
        if trip is None or not trip.latched or self._obeyed.get(supervisor.name) is trip:
            return
        self._obeyed[supervisor.name] = trip
        if trip.action in HOLDING:
            if trip.action == "park":
                self.to_park[supervisor.name] = trip
            if self.hold_s is not None:
                self.run.clock.call_in(round(self.hold_s * 1e9), lambda: self._let_go(supervisor, trip))
            return  # its guard has the door hold what it drives
        self.stopped[supervisor.name] = trip.reason
        if self.run.drives:
            self._stop(supervisor.name, self.run.driven(supervisor))

    def _let_go(self, supervisor: Supervisor, trip: Trip) -> None:
        """Let go after the stated time of holding."""
        if self.run.phase == "running" and supervisor.guard.tripped is trip:
            supervisor.guard.trip(f"{trip.reason}; held for {self.hold_s:g} s", "disable")
            supervisor.guard.tick(self.run.clock.now())
            self.obey(supervisor)

    @property
    def held(self) -> dict[str, str]:
        """Controllers whose joints are held where they are, with why."""
        return {
            s.name: s.guard.tripped.reason
            for s in self.run.supervisors
            if s.guard.tripped is not None and s.guard.tripped.action in HOLDING
        }

    def release(self, controller: str) -> None:
        """Let a controller's set-points through again after a trip; what was switched off has to be enabled before.

        Raises `UnknownNameError`, and `CallerError` while an e-stop input is pressed.
        """
        if self.run.rig.door.barred:
            raise CallerError(f"{controller} cannot be released: {self.run.rig.door.barred}")
        found = {supervisor.name: supervisor for supervisor in self.run.supervisors}
        if controller not in found:
            raise UnknownNameError("controller", controller, found)

        def let_through() -> None:
            if self.run.rig.stopped_by:
                self.run.rig.release()
            self.stopped.pop(controller, None)
            self.to_park.pop(controller, None)
            found[controller].release()

        self.run.clock.call(let_through)

    def _stop(self, name: str, devices: Collection[Device]) -> None:
        def over(stopping: Job) -> None:
            failed = stopping.error.devices if isinstance(stopping.error, NotStoppedError) else {}
            for device in devices:
                if device.name in failed:
                    self._owed[device.name] = device
                else:
                    self._owed.pop(device.name, None)
            if stopping.error is not None:
                self.run.note(ControlEvent("failed", self.run.clock.now(), name, str(stopping.error)))

        stop_devices(self.run.clock, name, devices).then(over)

    def _repay(self, source: str) -> None:
        """Stop devices again that still owe a stop, when the bus or device `source` is back."""
        owed = [device for device in self._owed.values() if source in (device.name, device.host.name)]
        if owed and self.run.phase == "running":
            self._stop(source, owed)
