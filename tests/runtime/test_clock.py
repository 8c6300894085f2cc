"""Clocks: virtual time goes from event to event, and only when told to."""

from __future__ import annotations

from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.errors import CallerError
from aces_bus.runtime import RealClock, VirtualClock


@given(st.lists(st.integers(0, 50)))
def test_events_happen_in_order(instants: list[int]) -> None:
    """By instant, and at the same instant in the order in which they were asked for."""
    clock = VirtualClock()
    seen: list[tuple[int, int]] = []

    def note(number: int) -> None:
        seen.append((clock.now(), number))

    for number, instant in enumerate(instants):
        clock.call_at(instant, partial(note, number))
    clock.advance_to(50)
    assert seen == sorted((instant, number) for number, instant in enumerate(instants))
    assert clock.now() == 50


def test_events_plan_events() -> None:
    """One that falls into the same advance happens in it; one planned for the past happens now."""
    clock = VirtualClock(100)
    seen: list[int] = []

    def first() -> None:
        clock.call_at(0, lambda: seen.append(clock.now()))
        clock.call_in(10, lambda: seen.append(clock.now()))

    clock.call_in(5, first)
    clock.advance(20)
    assert (seen, clock.now()) == ([105, 115], 120)


def test_a_cancelled_event_does_not_happen() -> None:
    """Nor does it count as something that is to come."""
    clock = VirtualClock()
    timer = clock.call_in(5, lambda: pytest.fail("cancelled"))
    assert clock.next_event == 5
    timer.cancel()
    assert clock.next_event is None
    assert not clock.step()


def test_time_does_not_go_back() -> None:
    """Advancing to the past is an error; sleeping until the past is over at once."""
    clock = VirtualClock(10)
    with pytest.raises(CallerError, match="cannot go back"):
        clock.advance_to(5)
    clock.sleep_until(5)
    assert clock.now() == 10


def test_an_exception_comes_out_and_the_clock_goes_on() -> None:
    """What an event raises is the caller's; the event is over, the others are still to come."""
    clock = VirtualClock()

    def fail() -> None:
        raise RuntimeError("event")

    clock.call_at(1, fail)
    seen: list[int] = []
    clock.call_at(2, lambda: seen.append(clock.now()))
    with pytest.raises(RuntimeError, match="event"):
        clock.advance_to(10)
    assert clock.now() == 1
    clock.advance_to(10)
    assert seen == [2]


def test_skipping_to_what_comes_next() -> None:
    """Time is moved on only where nothing is planned before, within the advance, and not where each event is looked at."""
    clock = VirtualClock()
    seen: list[tuple[bool, int]] = []

    def skip(instant: int) -> None:
        seen.append((clock.skip_to(instant), clock.now()))

    clock.call_at(10, partial(skip, 15))
    clock.call_at(20, partial(skip, 30))  # another is planned for then
    clock.call_at(30, partial(skip, 50))  # the advance ends before
    clock.advance_to(40)
    assert seen == [(True, 15), (False, 20), (False, 30)]
    clock.call_at(60, partial(skip, 70))
    assert clock.step()
    assert seen[3:] == [(False, 60)]
    assert not clock.skip_to(80)


def test_run_until() -> None:
    """Events happen until the condition holds; without events it says whether it does."""
    clock = VirtualClock()
    seen: list[int] = []

    def again() -> None:
        seen.append(clock.now())
        clock.call_in(10, again)

    clock.call_in(10, again)
    assert clock.run(lambda: len(seen) == 3)
    assert seen == [10, 20, 30]
    assert not VirtualClock().run(lambda: False)


def test_the_real_clock_goes_forward() -> None:
    """Monotonic, in integer ns; an instant that has passed is not waited for."""
    clock = RealClock()
    first = clock.now()
    clock.sleep_until(first - 10**12)
    assert clock.now() >= first
