"""Components with rates: absolute deadlines, order, what was missed, and errors that end nothing."""

from __future__ import annotations

import pytest

from aces_bus.errors import CallerError
from aces_bus.runtime import RealClock, ThreadTasks
from aces_bus.runtime.tasks import Task


def test_threads_tick_and_are_measured() -> None:
    """On threads a component ticks until it is stopped, and says how late it was."""
    clock = RealClock()
    done: list[int] = []

    def step(now: int) -> None:
        done.append(now)

    tasks = ThreadTasks(clock)
    task = tasks.add("thread", step, rate_hz=500)
    with tasks:
        end = clock.now() + 60_000_000_000
        while len(done) < 20 and clock.now() < end:
            clock.sleep_until(clock.now() + 1_000_000)
        with pytest.raises(CallerError, match="before they are started"):
            tasks.add("late", step, rate_hz=1)
    assert task.ticks >= 20
    assert 0 <= task.jitter_ns() <= task.jitter_ns(0.99) <= task.worst_lateness_ns
    assert "thread: 500 Hz" in str(task)
    count = len(done)
    clock.sleep_until(clock.now() + 5_000_000)
    assert len(done) == count


def test_a_rate_is_above_zero() -> None:
    """A component without a rate is none of these."""
    with pytest.raises(CallerError, match="0 Hz"):
        Task("none", lambda now: None, 0)
