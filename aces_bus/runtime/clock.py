"""Time as a parameter: the monotonic clock in life, a virtual one in tests and simulations.

1. An instant is integer nanoseconds of one clock, and has that clock's name; instants of two clocks are never compared.
2. Virtual time moves only when it is advanced, from event to event; nothing waits, and no thread is needed.
3. Events at the same instant run in the order in which they were asked for: the same program, the same run.

`Loop` is to the monotonic clock what events are to the virtual one: all its actions run on one thread, in order of their
instants, so that what is driven by a loop needs no locks; what an action raises is reported and does not end it.
`call_soon` is for other threads: receive threads hand over what they received, and programs ask for things to be done."""

from __future__ import annotations

import heapq
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any, Protocol, Self, TypeVar

from ..errors import CallerError

T = TypeVar("T")


class Clock(Protocol):
    """What has a time. `name` says which clock an instant belongs to."""

    name: str

    def now(self) -> int:
        """This instant, in ns."""
        ...

    def sleep_until(self, instant: int) -> None:
        """Return when `instant` (ns) has come: wait for it, or bring it about."""
        ...


class RealClock:
    """The monotonic clock of this machine.

    `epoch_ns` is what to add to one of its instants to get nanoseconds since 1970, as of when the clock was made: a step
    of the wall clock does not move it.
    """

    name = "monotonic"

    def __init__(self) -> None:
        self.epoch_ns = time.time_ns() - time.monotonic_ns()

    def now(self) -> int:
        """This instant, in ns."""
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
        """It will not happen; after it has, this does nothing."""
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


class Loop(RealClock):
    """A thread that does what is planned, when it is due.

    with Loop() as loop:
        loop.call_in(1_000_000, tick)
    """

    def __init__(
        self, name: str = "aces loop", failed: Callable[[BaseException], None] | None = None
    ) -> None:
        super().__init__()
        self.thread_name = name
        self._failed = failed
        #: What actions raised, the last few.
        self.failures: deque[BaseException] = deque(maxlen=16)
        self._events: list[tuple[int, int, Any]] = []
        self._count = 0
        self._changed = threading.Condition(threading.Lock())
        self._stopping = False
        self._thread: threading.Thread | None = None

    # ------------------------------------------------------------------ planning

    def call_at(self, instant: int, action: Callable[[], object]) -> Timer:
        """Plan `action` for `instant` (ns); one that has passed is done at once."""
        timer = Timer(instant, action)
        self._push(instant, timer)
        return timer

    def call_in(self, delay: int, action: Callable[[], object]) -> Timer:
        """Plan `action` for `delay` ns from now."""
        return self.call_at(self.now() + delay, action)

    def post(self, instant: int, action: Callable[[], object]) -> None:
        """Plan what will not be cancelled."""
        self._push(instant, action)

    def call_soon(self, action: Callable[[], object]) -> None:
        """Do it next, on the loop's thread."""
        self._push(0, action)

    def call(self, action: Callable[[], T]) -> T:
        """Do it on the loop's thread and return what it returns; what it raises is raised here.

        Raises `CallerError` when the loop does not run.
        """
        if threading.current_thread() is self._thread:
            return action()
        done: Future[T] = Future()

        def run() -> None:
            try:
                done.set_result(action())
            except BaseException as error:  # it is raised where it was asked for
                done.set_exception(error)

        self.call_soon(run)
        while True:
            try:
                return done.result(0.5)
            except FutureTimeout:
                if done.done():
                    raise
                if self._stopping or self._thread is None or not self._thread.is_alive():
                    raise CallerError(f"{self.thread_name} does not run: nothing can be done on it") from None

    def _push(self, instant: int, planned: Any) -> None:
        with self._changed:
            self._count += 1
            heapq.heappush(self._events, (instant, self._count, planned))
            if self._events[0][1] == self._count:
                self._changed.notify_all()

    # ------------------------------------------------------------------ running

    def start(self) -> Self:
        """Begin; raises `CallerError` when it was started before."""
        if self._thread is not None:
            raise CallerError(f"{self.thread_name} was started before; make another")
        self._thread = threading.Thread(target=self._run, name=self.thread_name, daemon=True)
        self._thread.start()
        return self

    def stop(self, timeout: float = 5.0) -> None:
        """End: what is planned does not happen."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout)

    def __enter__(self) -> Self:
        return self if self._thread is not None else self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._stopping and (not self._events or self._events[0][0] > time.monotonic_ns()):
                    left = None if not self._events else self._events[0][0] - time.monotonic_ns()
                    self._changed.wait(None if left is None else max(0, left) / 1e9)
                if self._stopping:
                    return
                _, _, planned = heapq.heappop(self._events)
            if isinstance(planned, Timer):
                action, planned.action = planned.action, None
            else:
                action = planned
            if action is None:
                continue
            try:
                action()
            except BaseException as error:  # an action is the user's code too
                self.failures.append(error)
                if self._failed is not None:
                    self._failed(error)

    def wait(self, until: Callable[[], bool], timeout_ns: int) -> bool:
        """Wait on another thread until `until()` holds; whether it did within `timeout_ns`. It is asked every millisecond.

        Raises `CallerError` on the loop's own thread, which would wait for itself.
        """
        if threading.current_thread() is self._thread:
            raise CallerError(f"{self.thread_name} cannot wait for itself; plan what is to follow instead")
        end = time.monotonic_ns() + timeout_ns
        while not until():
            left = end - time.monotonic_ns()
            if left <= 0:
                return until()
            time.sleep(min(left, 1_000_000) / 1e9)
        return True
