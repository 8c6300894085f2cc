"""Quantities made from quantities: arithmetic, functions, units, derivatives."""

from __future__ import annotations

import math
import sys
import threading
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.device import UNKNOWN
from aces_bus.runtime import VirtualClock
from aces_bus.state import ConstantVelocity, LowPass, State, StateError

from .feeding import MS, S, fed, instants, made, sine


def pair(**options: Any) -> tuple[State, State]:
    """Two states on one clock."""
    clock = VirtualClock()
    torque = State("torque", unit="N·m", clock=clock, **options)
    return torque, State("omega", unit="rad/s", clock=clock, **options)


def test_power_is_torque_times_angular_rate() -> None:
    """`torque * omega` has value, past, age and unit, and is unknown while one of the two is."""
    torque, omega = pair(stale_after_s=0.1)
    power = (torque * omega).named("power")
    assert power[0] is UNKNOWN
    torque.push(2.0, 0)
    assert power[0] is UNKNOWN
    omega.push(3.0, 0)
    torque.push(4.0, 10 * MS)
    omega.push(5.0, 10 * MS)
    assert (power[0], power[-0.01], power[-0.005]) == (20.0, 6.0, 12.0)
    assert (power.name, power.unit) == ("power", "N·m·rad/s")
    assert (torque * omega).named("power", "W").unit == "W"
    clock: Any = omega.clock
    clock.advance(50 * MS)
    torque.push(8.0, 50 * MS)
    assert (power[0], power.age_ns) == (40.0, 40 * MS)  # as old as the older
    clock.advance_to(115 * MS)
    assert power.is_stale
    assert power[0] is UNKNOWN
    assert power.last == 40.0
    omega.push(math.nan, 115 * MS)
    assert power.last is UNKNOWN


@given(instants(3, 30), instants(3, 30), st.floats(0, 1))
def test_the_past_of_a_derived_state_is_that_of_its_inputs(
    one: list[int], other: list[int], share: float
) -> None:
    """At any instant that both inputs have, a product is the product of the two interpolated values."""
    torque, omega = pair()
    fed(torque, lambda t: 3 * t, one)
    for instant in other:
        omega.push(1 - instant / S, instant)
    power = torque * omega
    span = power.span
    if span is None:
        assert one[-1] < other[0] or other[-1] < one[0]
        return
    at = round(span[0] + share * (span[1] - span[0]))
    assert power.at(at) == pytest.approx(3 * at / S * (1 - at / S))
    assert set(power.samples_between(*span)) == {i for i in (*one, *other) if span[0] <= i <= span[1]}


@given(instants(1, 30), instants(1, 30))
def test_listeners_of_a_derived_state_hear_each_instant_once(one: list[int], other: list[int]) -> None:
    """Whatever the order in which inputs come, samples are told in order of time, at all instants that both have reached."""
    torque, omega = pair()
    heard: list[tuple[Any, int]] = []
    both = torque * omega
    both.subscribe(lambda value, instant: heard.append((value, instant)))
    for instant in sorted({*one, *other}):
        if instant in one:
            torque.push(2.0, instant)
        if instant in other:
            omega.push(instant / S, instant)
    start, end = max(one[0], other[0]), min(one[-1], other[-1])
    assert [instant for _, instant in heard] == sorted(i for i in {*one, *other} if start <= i <= end)
    assert all(value == pytest.approx(2 * instant / S) for value, instant in heard)


def test_inputs_may_come_on_two_threads() -> None:
    """Two buses push at once: what is told is in order, each instant once, and an integral of it is whole."""
    torque, omega = pair(history=8000)
    both = torque * omega
    heard: list[int] = []
    both.subscribe(lambda _, instant: heard.append(instant))
    energy = both.integral()
    torque.push(1.0, 0)
    omega.push(1.0, 0)

    def push(state: State) -> None:
        for i in range(1, 4000):
            state.push(1.0, i * MS)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    threads = [threading.Thread(target=push, args=(one,)) for one in (torque, omega)]
    try:
        for one in threads:
            one.start()
        for one in threads:
            one.join()
    finally:
        sys.setswitchinterval(interval)
    assert heard == [i * MS for i in range(4000)]
    assert energy[0] == pytest.approx(3.999)
    assert energy.counts.late == 0


def test_a_sample_of_another_thread_waits_for_the_one_being_told() -> None:
    """A push on a second thread, while a listener has the first sample, is told behind it."""
    torque, omega = pair()
    both = torque * omega
    heard: list[int] = []
    others: list[threading.Thread] = []

    def listen(_: Any, instant: int) -> None:
        if not others:
            others.append(threading.Thread(target=omega.push, args=(1.0, 30 * MS)))
            others[0].start()
            others[0].join(0.05)  # it cannot end before this sample has been told
        heard.append(instant)

    for instant in (0, 10 * MS, 20 * MS, 30 * MS):
        torque.push(1.0, instant)
    omega.push(1.0, 0)
    both.subscribe(listen)
    omega.push(1.0, 10 * MS)
    others[0].join()
    assert heard == [10 * MS, 20 * MS, 30 * MS]


def test_a_product_with_itself_is_told_once() -> None:
    """`omega * omega` has one input."""
    omega = made()
    heard: list[Any] = []
    (omega * omega).subscribe(lambda value, _: heard.append(value))
    fed(omega, lambda t: 1000 * t, [0, MS, 2 * MS])
    assert heard == pytest.approx([0, 1, 4])


def test_filters_and_integrals_of_derived_states() -> None:
    """The energy of a constant power is power times time, and a filter of it stands still."""
    torque, omega = pair()
    energy = (torque * omega).integral()
    smooth = (torque * omega).filtered(LowPass(0.1))
    for i in range(101):
        torque.push(2.0, i * 10 * MS)
        omega.push(3.0, i * 10 * MS)
    assert energy[0] == pytest.approx(6.0)
    assert energy.unit == "N·m·rad"
    assert smooth[0] == pytest.approx(6.0)


def test_functions_of_states_with_estimators_reach_the_future() -> None:
    """Where all inputs can be estimated, what is made of them can."""
    clock = VirtualClock()
    x, y = (State(name, clock=clock, estimator=ConstantVelocity()) for name in "xy")
    fed(x, lambda t: t, [0, S])
    for instant in (0, S):
        y.push(2.0 * instant / S, instant)
    clock.advance(S)
    both = x + y
    assert both[0] == pytest.approx(6.0)
    assert both[1] == pytest.approx(9.0)
    assert both[-1.5] == pytest.approx(1.5)


# ---- derivatives ----------------------------------------------------------------------------------------------------


@given(instants(6, 60), st.sampled_from([1, 2, 3]))
def test_the_derivative_of_a_sine_is_within_its_bound(when: list[int], order: int) -> None:
    """The slope of uneven samples of sin(2π·f·t) is off by at most what Taylor's remainder allows."""
    f = 1.3
    omega = fed(made(), sine(f), when)
    rate = omega.rate(order)
    w = 2 * math.pi * f
    for i in range(order, len(when)):
        used = when[i - order : i + 1]
        # |error| = max|sin^(n+1)| / (n+1)! × Π |t - t_k| over the other points
        bound = w ** (order + 1) / math.factorial(order + 1)
        for one in used[:-1]:
            bound *= (used[-1] - one) / S
        assert abs(rate.at(when[i]) - w * math.cos(w * when[i] / S)) <= bound + 1e-6
    assert rate.unit == "rad/s²"


def test_the_derivative_between_samples_and_at_the_ends() -> None:
    """Between two samples the slope is theirs; outside of the history it is an error; the same object each time."""
    omega = fed(made(), lambda t: t * t, [0, S, 3 * S])
    rate = omega.rate()
    assert omega.rate() is rate
    assert (rate[0], rate[-1], rate[-2], rate[-2.5], rate[-3]) == (4.0, 4.0, 1.0, 1.0, 1.0)
    assert omega.rate(2)[0] == pytest.approx(6.0)
    with pytest.raises(StateError, match="derivative is not estimated"):
        rate[0.5]
    with pytest.raises(StateError, match="order 1 … 4"):
        omega.rate(7)
    assert (omega * 2).rate()[0] == 8.0
    assert rate.rate()[0] == pytest.approx(1.5)  # (4 - 1) / 2 s: the slope of slopes


def test_a_derivative_under_another_name_is_the_derivative() -> None:
    """`named` changes name and unit, not the value."""
    torque, _ = pair()
    torque.push(1.0, 0)
    torque.push(3.0, S)
    slope = torque.rate().named("slope", "W")
    assert (slope.name, slope.unit, slope[0], slope.at(0)) == ("slope", "W", 2.0, 2.0)
    assert torque.rate().named("slope").unit == torque.rate().unit


def test_the_derivative_beside_an_unknown_sample_is_unknown() -> None:
    """No slope is made up over a gap."""
    omega = made()
    for i, value in enumerate((0.0, 1.0, math.nan, 3.0, 4.0)):
        omega.push(value, i * S)
        if i in (2, 3):
            assert omega.rate()[0] is UNKNOWN
    assert [omega.rate().at(i * S) for i in range(5)] == [1.0, 1.0, UNKNOWN, UNKNOWN, 1.0]


# ---- units ----------------------------------------------------------------------------------------------------------
