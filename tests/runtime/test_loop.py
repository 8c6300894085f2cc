"""The loop: planned events on the monotonic clock, one thread, in order."""

from __future__ import annotations

import socket
import threading
from functools import partial

import pytest

from aces_bus.errors import CallerError
from aces_bus.runtime import VirtualClock
from aces_bus.runtime import loop as loop_module
from aces_bus.runtime.clock import EventClock
from aces_bus.runtime.loop import Loop


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


def test_files_are_served_between_what_is_due() -> None:
    """A file that has something is read on the loop's thread, also while more and more is handed over."""
    ours, theirs = socket.socketpair()
    read: list[bytes] = []
    with ours, theirs, Loop() as loop:

        def again() -> None:
            if not read:
                loop.call_soon(again)

        loop.call(lambda: loop.watch(ours.fileno(), lambda: read.append(ours.recv(100))))
        loop.call_soon(again)
        theirs.send(b"x")
        assert loop.wait(lambda: bool(read), 5_000_000_000)
        loop.call(lambda: loop.unwatch(ours.fileno()))
    assert read == [b"x"]


def test_what_a_turn_gathers_leaves_at_its_end() -> None:
    """Ends of a turn come behind all that was due in it, each once."""
    loop = Loop()
    seen: list[str] = []

    def tick(name: str) -> None:
        seen.append(name)
        loop.at_turn_end(lambda: seen.append(f"end of {name}"))

    now = loop.now()
    loop.call_at(now, lambda: tick("a"))
    loop.call_at(now, lambda: tick("b"))
    with loop:
        assert loop.wait(lambda: len(seen) == 4, 5_000_000_000)
    assert seen == ["a", "b", "end of a", "end of b"]


def test_a_turn_has_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """What does not fit into a turn is done in the next one, in order, and that is counted."""
    monkeypatch.setattr(loop_module, "TURN_NS", -1)
    loop = Loop()
    seen: list[int] = []
    now = loop.now()
    for number in range(5):
        loop.call_at(now, partial(seen.append, number))
    with loop:
        assert loop.wait(lambda: len(seen) == 5, 5_000_000_000)
    assert seen == [0, 1, 2, 3, 4]
    assert loop.carried == 4


def test_a_file_that_is_closed_under_the_loop_is_given_up() -> None:
    """Whoever reads it is called once more, and knows by what the system says; the loop goes on."""
    ours, theirs = socket.socketpair()
    number = ours.fileno()
    with theirs, Loop() as loop:
        loop.call(lambda: loop.watch(number, lambda: ours.recv(100)))
        loop.call(ours.close)
        assert loop.wait(lambda: bool(loop.failures), 5_000_000_000)
        assert isinstance(loop.failures[0], OSError)
        assert loop.call(lambda: 5) == 5


def test_other_threads_plan() -> None:
    """What another thread plans, or takes back, holds on the loop's thread."""
    with Loop() as loop:
        seen: list[str] = []
        timer = loop.call_in(60_000_000_000, lambda: seen.append("never"))
        loop.call_in(1_000_000, lambda: seen.append("once"))
        assert loop.wait(lambda: bool(seen), 5_000_000_000)
        timer.cancel()
        assert loop.call(lambda: timer.action) is None
    assert seen == ["once"]
