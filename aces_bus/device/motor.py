"""A device that moves joints, each on an axis of its own.

1. A joint is named by its name or an alias, a channel without a joint by its number; no name means all.
2. What a job waits for (`until`) is looked at whenever the device has said something.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Generic, TypeVar
from typing import Protocol as Interface

from ..compiling import mypyc_attr
from ..errors import DeviceError, UnknownNameError
from ..protocol import Record
from ..runtime.clock import Clock
from .config import Joint
from .device import Device
from .host_loss import Outcome
from .ticket import Awaited, Job, Steps


class JointChannel(Interface):
    """One channel of a motor board, as its driver knows it; `joint` None: nothing is connected, or it has no name."""

    @property
    def joint(self) -> Joint | None:
        """The joint that it moves; None: none."""
        ...

    @property
    def channel(self) -> int:
        """Its number, from 0."""
        ...

    @property
    def name(self) -> str:
        """The joint's name, or what the channel is called."""
        ...


A = TypeVar("A", bound=JointChannel)

#: An answer that was on the bus so long before it was read (s) is late; longer ago than this, its clock is another.
LATE_S, OTHER_CLOCK_S = 0.05, 60.0


def age_on_bus(record: Any, clock: Clock) -> float | None:
    """Return how long ago (s) a record was on its bus, by the adapter's time stamp; None where that is not a time of this
    machine.

    What was read just now may have waited in an adapter, a server or a socket before. SocketCAN's stamps, and those of
    served buses, are seconds since 1970.
    """
    stamp = record.meta.time if isinstance(record, Record) else None
    if stamp is None:
        return None
    age = (clock.now() + getattr(clock, "epoch_ns", 0)) / 1e9 - stamp
    return float(age) if 0.0 <= age < OTHER_CLOCK_S else None


@mypyc_attr(allow_interpreted_subclasses=True)
class MotorDevice(Device, Generic[A]):
    """A device with `axes`, which `setup` makes."""

    axes: list[A]

    @property
    def stop_leaves(self) -> Outcome:
        """Free: it is switched off, unless a driver says otherwise."""
        return "limp"

    def axes_of(self, joint: str | None) -> list[A]:
        """Return the axis of a joint by name, alias or channel number; None: all that have a joint (all, where none
        has one).

        Raises `UnknownNameError`.
        """
        if joint is None:
            return [axis for axis in self.axes if axis.joint is not None] or self.axes
        for axis in self.axes:
            names = () if axis.joint is None else (axis.joint.name, *axis.joint.aliases)
            if joint in names or joint in (axis.name, str(axis.channel)):
                return [axis]
        raise UnknownNameError(f"joint of {self.name}", joint, [axis.name for axis in self.axes])

    def until(self, holds: Callable[[], bool], timeout_s: float, what: Callable[[], str]) -> Awaited:
        """Return an awaitable that ends as soon as `holds()`, checked after each message of the device; fails
        after `timeout_s`.
        """
        awaited = Awaited(self.clock)
        if holds():
            awaited.finish()
            return awaited
        timer = self.clock.call_in(
            round(timeout_s * 1e9),
            lambda: awaited.fail(DeviceError(f"{self.name}: {what()} (after {timeout_s:g} s)")),
        )
        self._until_so.append((holds, awaited, timer))
        return awaited

    def _look_again(self) -> None:
        waiting, self._until_so = self._until_so, []
        for wait in waiting:
            holds, awaited, timer = wait
            if awaited.is_over:
                continue
            if holds():
                timer.cancel()
                awaited.finish()
            else:
                self._until_so.append(wait)

    @staticmethod
    def in_turn(job: Job, axes: Sequence[A]) -> Iterator[A]:
        """Yield the axes one by one: the job's text is the name, its progress how many are done."""
        for number, axis in enumerate(axes):
            job.text = axis.name
            yield axis
            job.progress = (number + 1) / len(axes)

    def confirm_off(self, ask: Callable[[], Awaited], still_on: Callable[[], Sequence[str]]) -> Job:
        """Ask the device; the job fails when a joint is `still_on` by what it answers."""

        def steps(job: Job) -> Steps:
            record = yield ask()
            on = still_on()
            if on:
                age = age_on_bus(record, self.clock)
                late = (
                    f" ({age:.1f} s old: its answers come late)" if age is not None and age > LATE_S else ""
                )
                raise DeviceError(f"its status{late} says that {', '.join(on)} is still on")

        return self.job("look whether it is off", steps)
