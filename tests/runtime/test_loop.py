"""The loop: planned events on the monotonic clock, one thread, in order."""

from __future__ import annotations

import threading

import pytest

from aces_bus.errors import CallerError
from aces_bus.runtime import EventClock, Loop, VirtualClock


@pytest.mark.parametrize("kind", [Loop, VirtualClock])
def test_loop_and_virtual_clock_do_the_same(kind: type[Loop] | type[VirtualClock]) -> None:
    """Events happen in order of their instants, equal ones in order of asking; cancelled ones do not."""
    clock: EventClock = kind()
    seen: list[str] = []
    start = clock.now()
    clock.call_at(start + 3_000_000, lambda: seen.append("c"))
    clock.call_at(start + 2_000_000, lambda: seen.append("a"))
    clock.post(start + 2_000_000, lambda: seen.append("b"))
    clock.call_at(start + 2_500_000, lambda: seen.append("never")).cancel()
    if isinstance(clock, Loop):
        clock.start()
    try:
        assert clock.wait(lambda: len(seen) == 3, 5_000_000_000)
        assert seen == ["a", "b", "c"]
        assert clock.now() >= start + 3_000_000
        assert not clock.wait(lambda: False, 1_000_000)
    finally:
        if isinstance(clock, Loop):
            clock.stop()


def test_other_threads_hand_over_with_call_soon() -> None:
    """What other threads ask for runs on the loop's thread; what raises is kept and ends nothing."""
    told: list[BaseException] = []
    with Loop(failed=told.append) as loop:
        names: list[str] = []
        loop.call_soon(lambda: 1 / 0)
        loop.call_soon(lambda: names.append(threading.current_thread().name))
        assert loop.wait(lambda: bool(names), 5_000_000_000)
    assert names == ["aces loop"]
    assert [type(error) for error in told] == [ZeroDivisionError]
    assert len(loop.failures) == 1


def test_a_loop_does_not_wait_for_itself() -> None:
    """Waiting on the loop's own thread is refused: it would wait for ever."""
    with Loop() as loop:
        errors: list[BaseException] = []

        def wait() -> None:
            try:
                loop.wait(lambda: False, 10)
            except CallerError as error:
                errors.append(error)

        loop.call_soon(wait)
        assert loop.wait(lambda: bool(errors), 5_000_000_000)
    with pytest.raises(CallerError, match="started before"):
        loop.start()
