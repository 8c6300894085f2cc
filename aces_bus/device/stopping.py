"""Stopping devices: at once, again and again until they have stopped, and by name those that have not.

1. Every device is sent its stop before anything is waited for; one driver's fault does not delay the others.
2. A stop counts when its packets have left; where the device can be asked whether it has stopped, when it has said so.
   Where two devices were seen to answer as one, an answer says nothing of the other, which may not receive any more.
3. It has an end: who has not stopped within `STOP_NS` is named, with the reason.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ..errors import AcesError, DeviceError, NotStoppedError
from ..runtime.clock import EventClock
from .device import Device
from .station import credential_text
from .ticket import Awaited, Job, Steps, Ticket

#: Seconds that a program waits for all of it.
PATIENCE_S = 3.0
#: How long a stop is repeated (ns); between two attempts; how long one attempt, and one confirmation, may take.
STOP_NS, PAUSE_NS, ATTEMPT_NS = 1_500_000_000, 20_000_000, 500_000_000


def stop_devices(clock: EventClock, name: str, devices: Iterable[Device], *, is_foreign: bool = False) -> Job:
    """Stop what moves. The job fails with `NotStoppedError`; to be called on the clock's thread.

    Devices that have never answered are sent their stop, and not asked whether they have stopped. `is_foreign`: another
    program has driven them. Then each is asked, and one that acknowledges nothing is named as not confirmed.
    """
    part_of = {device.name: device for device in devices}
    for device in part_of.values():
        device.host.events.act("stop", device.name)
    jobs = {device.name: _Stop(device, is_foreign).begin() for device in part_of.values()}

    def steps(job: Job) -> Steps:
        failed: dict[str, str] = {}
        for number, (who, part) in enumerate(jobs.items()):
            try:
                yield part
            except AcesError as error:
                part_of[who].host.events.act("not stopped", who, str(error))
                failed[who] = f"{_outage(part_of[who])}{error}{_last_received(part_of[who])}"
            job.progress = (number + 1) / len(jobs)
        if failed:
            raise NotStoppedError(failed)

    return Job(clock, f"{name} stop", steps)


def can_be_stopped(device: Device) -> bool:
    """Return whether a stop is for this device: it moves joints, or its driver can stop something."""
    return bool(device.joints) or type(device).stop_motion is not Device.stop_motion


def wait_stopped(stopping: Job, timeout_s: float = PATIENCE_S) -> None:
    """Let time pass until it is over: Ctrl-C does not shorten that, and is raised afterwards.

    Raises what the job failed with, `NotStoppedError` also when its clock does not run any more.
    """
    clock = stopping.clock
    end = clock.now() + round(timeout_s * 1e9)
    interrupted: KeyboardInterrupt | None = None
    while not stopping.is_over and clock.now() < end:
        try:
            clock.wait(lambda: stopping.is_over, end - clock.now())
        except KeyboardInterrupt as error:
            interrupted = error
    failed = stopping.error
    if not stopping.is_over:
        failed = DeviceError(f"NOT switched off: {stopping.name} is not over after {timeout_s:g} s")
    if interrupted is not None:
        if failed is not None:
            interrupted.add_note(str(failed))
        raise interrupted
    if failed is not None:
        raise failed


def _outage(device: Device) -> str:
    """Return that its bus is gone, where it is."""
    return f"bus {device.host.name} is {device.host.outage}: " if device.host.outage else ""


def _last_received(device: Device) -> str:
    """Say when a device was last received, if that is long ago."""
    age = None if device.last_received is None else device.clock.now() - device.last_received
    return f"; last received {age / 1e9:.1f} s ago" if age is not None and age > PAUSE_NS * 5 else ""


class _Unconfirmed(DeviceError):
    """A device says nothing, however often it is asked."""


def _acknowledges(ticket: Any) -> bool:
    """Return whether the end of a stop's ticket or job means that the device has answered it."""
    return isinstance(ticket, Awaited) and not (isinstance(ticket, Ticket) and not ticket.reply)


class _Stop:
    """The stop of one device."""

    def __init__(self, device: Device, is_foreign: bool) -> None:
        self.device, self.clock, self.is_foreign = device, device.clock, is_foreign
        if is_foreign:
            device.assume_driven()

    def begin(self) -> Job:
        """Make the first attempt at once; return the rest as a job."""
        end = self.clock.now() + STOP_NS
        ticket = self._send()
        return Job(self.clock, f"{self.device.name} stop", lambda job: self._steps(ticket, end))

    def _send(self) -> Any:
        try:
            return self.device.stop_motion()
        except Exception as error:  # a driver's code: the other devices are stopped all the same
            return error

    def _steps(self, ticket: Any, end: int) -> Steps:
        device = self.device
        while True:
            try:
                yield from self._over(ticket, "it has not stopped yet")
                is_asked = self.is_foreign or device.last_received is not None
                asked = device.confirm_stopped() if is_asked else None
                yield from self._over(asked, "it does not say whether it has stopped")
                if device.is_double and (ticket is not None or asked is not None):
                    who = credential_text(device.credentials) or device.name
                    raise DeviceError(
                        f"two devices answer as {who}: one that is off says nothing of the other"
                    )
                is_moving = ticket is not None or bool(device.joints)
                if self.is_foreign and is_moving and asked is None and not _acknowledges(ticket):
                    sent = "it was sent its stop, and" if ticket is not None else "nothing stops it:"
                    raise _Unconfirmed(f"{sent} it does not say whether it has stopped")
                device.is_driven = False
                return
            except _Unconfirmed:
                raise
            except AcesError as error:
                if self.clock.now() + PAUSE_NS >= end:
                    raise
                device.emit_event("not stopped", f"{error}; once more")
            yield PAUSE_NS
            ticket = self._send()

    def _over(self, awaited: Any, otherwise: str) -> Steps:
        """Wait until it is over, for at most `ATTEMPT_NS`; raises its error."""
        if awaited is None:
            return
        if isinstance(awaited, Exception):
            raise DeviceError(f"{type(awaited).__name__}: {awaited}")
        either = Awaited(self.clock)
        awaited.then(lambda over: either.fail(over.error) if over.error is not None else either.finish())
        timer = self.clock.call_in(ATTEMPT_NS, lambda: either.fail(DeviceError(otherwise)))
        try:
            yield either
        finally:
            timer.cancel()
