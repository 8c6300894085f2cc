"""Components with rates: absolute deadlines, order, what was missed, and errors that end nothing."""

from __future__ import annotations

import pytest

from aces_bus.errors import CallerError
from aces_bus.runtime import RealClock, ThreadTasks, VirtualClock
from aces_bus.runtime.tasks import Task, VirtualTasks


def test_virtual_components_tick_exactly() -> None:
    """Under the virtual clock each component ticks at its rate, the higher priority first where both are due."""
    clock = VirtualClock()
    seen: list[tuple[int, str]] = []
    tasks = VirtualTasks(clock)
    tasks.add("low", lambda now: seen.append((now, "low")), rate_hz=100)
    tasks.add("high", lambda now: seen.append((now, "high")), rate_hz=50, priority=5)
    with tasks:
        clock.advance(20_000_000)
    assert seen == [(0, "high"), (0, "low"), (10_000_000, "low"), (20_000_000, "high"), (20_000_000, "low")]
    clock.advance(100_000_000)
    assert len(seen) == 5
    assert [task.missed for task in tasks.tasks] == [0, 0]


def test_deadlines_that_passed_are_left_out_and_counted() -> None:
    """A step that lets more than its period pass misses deadlines, and goes on in step with the others."""
    clock = VirtualClock()
    ticks: list[int] = []

    def slow(now: int) -> None:
        ticks.append(now)
        if len(ticks) == 2:
            clock.advance(35_000_000)

    tasks = VirtualTasks(clock)
    task = tasks.add("slow", slow, rate_hz=100)
    with tasks:
        clock.advance(10_000_000)
        clock.advance(10_000_000)
    assert ticks == [0, 10_000_000, 50_000_000]
    assert (task.missed, task.overruns) == (3, 1)
    assert task.worst_busy_ns == 35_000_000


def test_an_error_ends_nothing() -> None:
    """What a step raises is counted and told with the component; it ticks on."""
    clock = VirtualClock()
    told: list[tuple[str, str]] = []
    tasks = VirtualTasks(clock, lambda task, error: told.append((task.name, str(error))))

    def bad(now: int) -> None:
        raise ValueError(f"at {now}")

    task = tasks.add("bad", bad, rate_hz=100)
    with tasks:
        clock.advance(10_000_000)
    assert told == [("bad", "at 0"), ("bad", "at 10000000")]
    assert task.failures == 2
    assert isinstance(task.last_error, ValueError)


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
