"""Stop a robot from any program, also while another one drives it.

1. A stop takes no lock and needs no permission. Nothing is sent but stops and what confirms them.
2. A program that drives a bus is asked to stop its devices, and reports who has stopped. One that does not answer within
   `ACK_S` (it is suspended, or hangs) is passed over: the stops are sent beside it. It finds the request when it goes on.
3. Each bus is served by itself: one that cannot be opened does not delay the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

from ..device.config import Robot
from ..device.device import Device
from ..device.drivers import Driver, load_driver
from ..device.host import Host
from ..device.host_loss import Outcome
from ..device.stopping import can_be_stopped, stop_devices, wait_stopped
from ..errors import AcesError, NotStoppedError
from ..hardware.bell import Ringing, program_of
from ..runtime.loop import Loop
from .buses import lock_of, open_gates
from .rig import Rig, connect

#: Seconds in which a driving program must answer that it stops its devices, and report who has stopped.
ACK_S, REPORT_S = 0.2, 2.5


@dataclass
class Stopped:
    """Who was stopped: `devices` by name, with what the stop left of them; `by`: bus → the program that stopped them."""

    devices: dict[str, Outcome] = field(default_factory=dict[str, Outcome])
    by: dict[str, str] = field(default_factory=dict[str, str])


def stop_robot(
    robot: Robot,
    *,
    buses: Mapping[str, Mapping[str, Any]] | None = None,
    load: Callable[[str], Driver] = load_driver,
    begun: Callable[[Mapping[str, Outcome]], object] | None = None,
) -> Stopped:
    """Stop all devices of a robot that can be stopped, as their drivers and the robot's file say.

    Devices that another program drives are stopped, too.

    `buses` as of `run_real`. `begun` is called when the first stops are on their way, with what each will leave. Raises
    `NotStoppedError` with the devices of which it is not confirmed, and `CallerError` where it is not known where a bus is.
    """
    with ExitStack() as stack:
        loop = stack.enter_context(Loop())
        ports = open_gates(robot, loop, buses, is_locked=False, load=load)
        rig = connect(robot, ports, load=load)
        made = _RobotStop(rig, loop, stack)
        for name, host in rig.hosts.items():
            lock = lock_of(robot.buses[name], (buses or {}).get(name) or {})
            ringing = None if lock is None else lock.ring()
            if ringing is not None:
                made.asked[name] = stack.enter_context(ringing)
            else:
                made.begin(host, made.moving(host))
        if begun is not None:
            begun(
                {
                    device.name: device.stop_leaves
                    for host in rig.hosts.values()
                    for device in made.moving(host)
                }
            )
        made.ask()
        return made.finish()


class _RobotStop:
    """One stop of a robot, bus by bus."""

    def __init__(self, rig: Rig, loop: Loop, stack: ExitStack) -> None:
        self.rig, self.loop, self.stack = rig, loop, stack
        self.asked: dict[str, Ringing] = {}
        self.jobs: list[tuple[list[Device], Any]] = []
        self.stopped = Stopped()
        self.failed: dict[str, str] = {}

    @staticmethod
    def moving(host: Host) -> list[Device]:
        """Return the devices that a stop is for."""
        return [device for device in host.devices.values() if can_be_stopped(device)]

    def begin(self, host: Host, devices: list[Device]) -> None:
        """Open a bus, and have the stops of these devices leave first."""
        if not devices:
            return
        try:
            self.loop.call(lambda: host.open(is_started=False))
        except Exception as error:  # whatever a backend or the system may raise: the other buses are stopped
            said = (
                error
                if isinstance(error, AcesError)
                else " ".join(str(error).split()) or type(error).__name__
            )
            why = f"bus {host.name} cannot be opened: {said}"
            self.failed.update(dict.fromkeys((device.name for device in devices), why))
            return
        self.stack.callback(host.close)
        name = self.rig.robot.name
        job = self.loop.call(lambda: stop_devices(self.loop, name, devices, is_foreign=True))
        self.jobs.append((devices, job))

    def ask(self) -> None:
        """Take the reports of the programs that drive; stop what they do not, or do not answer for.

        The programs of all buses have the same `ACK_S` and `REPORT_S`, so that one that hangs costs the next bus nothing.
        """
        reports: dict[str, Mapping[str, Any]] = {}
        reporting: list[str] = []
        last = monotonic() + ACK_S
        for name, ringing in self.asked.items():
            answer = ringing.wait(max(0.0, last - monotonic()))
            if answer is None:
                self._begin_beside(name, {})
            elif "devices" in answer:
                reports[name] = answer
            else:
                reporting.append(name)
        last = monotonic() + REPORT_S
        for name in reporting:
            reports[name] = self.asked[name].wait(max(0.0, last - monotonic())) or {}
        for name, report in reports.items():
            self._begin_beside(name, report)

    def _begin_beside(self, name: str, answer: Mapping[str, Any]) -> None:
        """Stop what the program that drives a bus has not reported as stopped."""
        host = self.rig.hosts[name]
        done = self._reported(host, answer)
        self.begin(host, [device for device in self.moving(host) if device.name not in done])

    def _reported(self, host: Host, answer: Mapping[str, Any]) -> set[str]:
        """Note what a driving program has reported; the devices that have stopped."""
        reported = answer.get("devices")
        found = [
            (report.get("protocol"), report.get("credentials"))
            for report in (reported if isinstance(reported, list) else ())
            if isinstance(report, dict) and report.get("why") == ""
        ]
        done: dict[str, Outcome] = {
            device.name: device.stop_leaves
            for device in self.moving(host)
            if (device.variant.name, dict(device.credentials)) in found
        }
        self.stopped.devices.update(done)
        if done:
            self.stopped.by[host.name] = program_of(answer)
        return set(done)

    def finish(self) -> Stopped:
        """Wait for all stops; raises `NotStoppedError` where one is not confirmed."""
        for devices, job in self.jobs:
            try:
                wait_stopped(job)
            except NotStoppedError as error:
                self.failed.update(error.devices)
            except AcesError as error:
                self.failed.update(dict.fromkeys((device.name for device in devices), str(error)))
            self.stopped.devices.update(
                {device.name: device.stop_leaves for device in devices if device.name not in self.failed}
            )
        if self.failed:
            raise NotStoppedError(self.failed)
        return self.stopped
