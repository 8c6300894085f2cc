"""Jobs: steps that wait for tickets, other jobs and time, without a thread."""

from __future__ import annotations

import pytest

from aces_bus.device import Job, Steps, together
from aces_bus.errors import CallerError, DeviceError
from aces_bus.runtime import VirtualClock


def test_a_job_waits_for_time_and_for_jobs() -> None:
    """A job goes on after the time it yields and with the result of a job it yields."""
    clock = VirtualClock()
    seen: list[int] = []

    def inner(job: Job) -> Steps:
        yield 5_000
        return 42

    def outer(job: Job) -> Steps:
        yield 1_000
        seen.append(clock.now())
        job.progress, job.text = 0.5, "half way"
        result = yield Job(clock, "inner", inner)
        seen.append(clock.now())
        return result + 1

    job = Job(clock, "outer", outer)
    assert job.wait() == 43
    assert seen == [1_000, 6_000]
    assert repr(job) == "<outer: done, 100%, half way>"


def test_a_failure_is_raised_where_it_is_waited_for() -> None:
    """What a step fails with is raised inside the job that waits, which may catch it."""
    clock = VirtualClock()

    def bad(job: Job) -> Steps:
        yield 1
        raise DeviceError("no")

    def careful(job: Job) -> Steps:
        try:
            yield Job(clock, "bad", bad)
        except DeviceError:
            return "caught"

    assert Job(clock, "careful", careful).wait() == "caught"
    with pytest.raises(DeviceError, match="no"):
        together(clock, "both", [Job(clock, "bad", bad), Job(clock, "careful", careful)]).wait()


def test_a_step_that_is_none_is_the_callers_fault() -> None:
    """Yielding something that cannot be waited for fails with what may be yielded."""
    clock = VirtualClock()

    def wrong(job: Job) -> Steps:
        yield "soon"

    with pytest.raises(CallerError, match="a ticket, a job or ns"):
        Job(clock, "wrong", wrong).wait()


def test_a_cancelled_job_has_failed() -> None:
    """Cancelling ends a job at once, and closes what it has open."""
    clock = VirtualClock()
    closed: list[bool] = []

    def long(job: Job) -> Steps:
        try:
            yield 10**12
        finally:
            closed.append(True)

    job = Job(clock, "long", long)
    clock.advance(10)
    job.cancel()
    assert closed == [True]
    assert job.state == "failed"
    with pytest.raises(DeviceError, match="cancelled"):
        job.wait()


def test_waiting_too_long_says_for_what() -> None:
    """`wait` ends at its time with a message, and the job goes on."""
    clock = VirtualClock()

    def slow(job: Job) -> Steps:
        yield 10**10
        return 1

    job = Job(clock, "slow", slow)
    with pytest.raises(DeviceError, match=r"slow.*not over after 1 s"):
        job.wait(1)
    assert job.wait(20) == 1


def test_a_step_that_raises_anything_ends_its_job() -> None:
    """A driver's own fault ends its job with its text, and is raised where the clock runs."""
    clock = VirtualClock()

    def faulty(job: Job) -> Steps:
        yield 1
        raise ZeroDivisionError("oops")

    job = Job(clock, "faulty", faulty)
    with pytest.raises(ZeroDivisionError):
        clock.advance(10)
    assert job.state == "failed"
    with pytest.raises(DeviceError, match="faulty: ZeroDivisionError: oops"):
        job.wait()
