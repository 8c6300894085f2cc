"""Components with a rate: what runs, how often, and how well it kept its time.

1. Deadlines are absolute: a tick's lateness does not move the next one. Deadlines that have passed when a tick ends are left
   out and counted, never made up for in a burst.
2. What a component raises ends nothing: it is counted and reported, with the component's name.
3. Under the virtual clock there are no threads: the same components, the same order, every run.

`VirtualTasks` plans ticks on a clock; `ThreadTasks` gives each component a thread, with real-time priority where the system
allows it (`SCHED_FIFO`), and measures lateness and overruns.
"""

from __future__ import annotations

import os
import threading
import time
from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable
from typing import Any, Self

from ..errors import CallerError
from .clock import Clock, EventClock

#: Latenesses kept for the median and the percentiles: the last ones.
KEPT = 8192
#: How long ticks that are under way may take to end, all together (s).
JOIN_S = 5.0


class Task:
    """One component: `step(now)` at `rate_hz`; and what became of it.

    `lateness_ns` and `busy_ns` are of the last tick; `missed` counts deadlines that passed while a tick before was still
    running (or the system was elsewhere), `overruns` ticks that took longer than a period.
    """

    def __init__(self, name: str, step: Callable[[int], object], rate_hz: float, priority: int = 0) -> None:
        if rate_hz <= 0:
            raise CallerError(f"{name}: a rate of {rate_hz} Hz; give a rate above 0 Hz")
        self.name, self.step, self.rate_hz, self.priority = name, step, rate_hz, priority
        self.period_ns = round(1e9 / rate_hz)
        self.ticks = self.missed = self.overruns = self.failures = 0
        self.lateness_ns = self.busy_ns = self.busy_sum_ns = 0
        self.worst_lateness_ns = self.worst_busy_ns = 0
        #: Whether it runs with real-time priority; None: not asked for, or not started.
        self.is_real_time: bool | None = None
        self.last_error: BaseException | None = None
        self._late = array("q", bytes(8 * KEPT))

    def tick(self, due: int, clock: Clock, failed: Callable[[Task, BaseException], None] | None) -> None:
        """Run one step, and measure it."""
        began = clock.now()
        late = began - due
        self._late[self.ticks % KEPT] = late
        self.ticks += 1
        self.lateness_ns = late
        if late > self.worst_lateness_ns:
            self.worst_lateness_ns = late
        try:
            self.step(began)
        except Exception as error:  # a user's code: it ends nothing
            self.failures += 1
            self.last_error = error
            if failed is not None:
                failed(self, error)
        busy = clock.now() - began
        self.busy_ns = busy
        self.busy_sum_ns += busy
        if busy > self.worst_busy_ns:
            self.worst_busy_ns = busy
        if busy > self.period_ns:
            self.overruns += 1

    def next_due(self, due: int, now: int) -> int:
        """Return the deadline after `due`; those that have passed at `now` are left out and counted."""
        following = due + self.period_ns
        if following <= now:
            passed = (now - following) // self.period_ns + 1
            self.missed += passed
            following += passed * self.period_ns
        return following

    def jitter_ns(self, share: float = 0.5) -> int:
        """Return the lateness that this share of the last ticks did not exceed: 0.5 is the median."""
        known = sorted(self._late[: min(self.ticks, KEPT)])
        return known[min(len(known) - 1, int(share * len(known)))] if known else 0

    def __str__(self) -> str:
        return (
            f"{self.name}: {self.rate_hz:g} Hz, {self.ticks} ticks, {self.missed} missed, {self.overruns} overruns,"
            f" late {self.jitter_ns() / 1e6:.3f} ms (median), {self.jitter_ns(0.99) / 1e6:.3f} ms (99 %),"
            f" {self.worst_lateness_ns / 1e6:.3f} ms (worst)"
        )


class Tasks(ABC):
    """Components that start and stop together."""

    def __init__(self, failed: Callable[[Task, BaseException], None] | None = None) -> None:
        self.tasks: list[Task] = []
        self.failed = failed
        self._is_running = False

    def add(self, name: str, step: Callable[[int], object], *, rate_hz: float, priority: int = 0) -> Task:
        """Add a component. Of two that are due together the one of higher `priority` runs first.

        Raises `CallerError` when they run already, or for a rate that is none.
        """
        if self._is_running:
            raise CallerError(f"{name}: components are added before they are started")
        task = Task(name, step, rate_hz, priority)
        self.tasks.append(task)
        return task

    @abstractmethod
    def start(self) -> Self:
        """Begin: the first ticks are due now."""

    @abstractmethod
    def stop(self) -> None:
        """End; a tick that is under way ends first."""

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()


class VirtualTasks(Tasks):
    """Components as events of a clock: in virtual time, or on a `Loop` that all share."""

    def __init__(
        self, clock: EventClock, failed: Callable[[Task, BaseException], None] | None = None
    ) -> None:
        super().__init__(failed)
        self.clock = clock
        self._timers: dict[int, Any] = {}

    def start(self) -> Self:
        """Plan the first ticks, the highest priority first."""
        self._is_running = True
        now = self.clock.now()
        for number, task in sorted(enumerate(self.tasks), key=lambda entry: (-entry[1].priority, entry[0])):
            self._plan(number, task, now)
        return self

    def _plan(self, number: int, task: Task, due: int) -> None:
        def tick() -> None:
            if not self._is_running:
                return
            task.tick(due, self.clock, self.failed)
            self._plan(number, task, task.next_due(due, self.clock.now()))

        self._timers[number] = self.clock.call_at(due, tick)

    def stop(self) -> None:
        """Plan no more."""
        self._is_running = False
        for timer in self._timers.values():
            timer.cancel()


class ThreadTasks(Tasks):
    """A thread for each component. `real_time` asks for `SCHED_FIFO` at the component's priority (1…99)."""

    def __init__(
        self,
        clock: Clock,
        failed: Callable[[Task, BaseException], None] | None = None,
        *,
        real_time: bool = False,
    ) -> None:
        super().__init__(failed)
        self.clock, self.real_time = clock, real_time
        self._stopping = threading.Event()
        self._stopped_at = 0
        self._threads: list[threading.Thread] = []

    def start(self) -> Self:
        """Start the threads."""
        self._is_running = True
        start = self.clock.now()
        for task in self.tasks:
            thread = threading.Thread(target=self._run, args=(task, start), name=task.name, daemon=True)
            self._threads.append(thread)
            thread.start()
        return self

    def stop(self) -> None:
        """Let the ticks under way end, and the threads."""
        self._stopped_at = self.clock.now()
        self._stopping.set()
        end = time.monotonic() + JOIN_S
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(max(0.0, end - time.monotonic()))
        self._is_running = False

    def _run(self, task: Task, start: int) -> None:
        if self.real_time and task.priority > 0:
            task.is_real_time = run_at(task.priority)
        due = start
        while not self._stopping.is_set():
            left = due - self.clock.now()
            if left > 0 and self._wait(left):
                break
            task.tick(due, self.clock, self.failed)
            due = task.next_due(due, self.clock.now())
        if due <= self._stopped_at:  # woken too late for what was due before the end
            task.missed += (self._stopped_at - due) // task.period_ns + 1

    def _wait(self, left: int) -> bool:
        """Let `left` ns pass; True when it is time to end."""
        # An event's wait is late by tenths of a millisecond; the last part sleeps.
        if left > 50_000_000:
            return self._stopping.wait((left - 20_000_000) / 1e9)
        time.sleep(left / 1e9)
        return self._stopping.is_set()


def run_at(priority: int) -> bool:
    """Have the calling thread run with `SCHED_FIFO`; whether the system allows it (Linux: CAP_SYS_NICE, an rtprio limit)."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(min(99, max(1, priority))))
    except (AttributeError, OSError):
        return False
    return True
