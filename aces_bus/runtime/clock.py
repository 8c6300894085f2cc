"""Time as a parameter: the monotonic clock in life, a virtual one in tests and simulations.

1. An instant is integer nanoseconds of one clock, and has that clock's name; instants of two clocks are never compared.
2. Virtual time moves only when it is advanced, from event to event; nothing waits, and no thread is needed.
3. Events at the same instant run in the order in which they were asked for: the same program, the same run.

What is planned on a clock runs on one thread, so that what a clock drives needs no locks: see `EventClock`, and `Loop` for
the monotonic clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol, TypeVar

from ..compiling import mypyc_attr

T = TypeVar("T")


class Clock(Protocol):
    """What has a time. `name` says which clock an instant belongs to."""

    name: str

    def now(self) -> int:
        """Return the present instant in ns."""
        ...

    def sleep_until(self, instant: int) -> None:
        """Wait until `instant` (ns) has come, or bring it about."""
        ...


@mypyc_attr(allow_interpreted_subclasses=True)
class RealClock:
    """The monotonic clock of this machine.

    `epoch_ns` is what to add to one of its instants to get nanoseconds since 1970, as of when the clock was made: a step
    of the wall clock does not move it.
    """

    name = "monotonic"

    def __init__(self) -> None:
        self.epoch_ns = time.time_ns() - time.monotonic_ns()

    def now(self) -> int:
        """Return the present instant in ns."""
        return time.monotonic_ns()

    def sleep_until(self, instant: int) -> None:
        """Wait until `instant` (ns)."""
        left = instant - time.monotonic_ns()
        if left > 0:
            time.sleep(left / 1e9)


class Timer:
    """An event that is to happen; `cancel` takes it back."""

    __slots__ = ("action", "instant")

    def __init__(self, instant: int, action: Callable[[], object]) -> None:
        self.instant = instant
        self.action: Callable[[], object] | None = action

    def cancel(self) -> None:
        """Cancel the action; do nothing if it has happened."""
        self.action = None


class EventClock(Clock, Protocol):
    """A clock on which things can be planned: `VirtualClock` and `Loop`."""

    def call_at(self, instant: int, action: Callable[[], object]) -> Timer:
        """Plan `action` for `instant` (ns)."""
        ...

    def call_in(self, delay: int, action: Callable[[], object]) -> Timer:
        """Plan `action` for `delay` ns from now."""
        ...

    def post(self, instant: int, action: Callable[[], object]) -> None:
        """Plan what will not be cancelled."""
        ...

    def call_soon(self, action: Callable[[], object]) -> None:
        """Do it next; the only method that other threads may call."""
        ...

    def call(self, action: Callable[[], T]) -> T:
        """Do it now, where all planned actions run, and return what it returns: how programs touch what a clock drives."""
        ...

    def wait(self, until: Callable[[], bool], timeout_ns: int) -> bool:
        """Let time pass until `until()` holds, at most `timeout_ns`; whether it holds."""
        ...
