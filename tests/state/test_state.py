"""A state as the paper has it: history, interpolation, age, unknown values, set-points."""

from __future__ import annotations

import math
import sys
import threading
from bisect import bisect_left
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.device import UNKNOWN
from aces_bus.device.signals import Signal
from aces_bus.runtime import RealClock, VirtualClock
from aces_bus.state import ConstantVelocity, Kalman, State, StateError
from aces_bus.state.estimators import Estimation

from .feeding import MS, S, fed, instants, made


def test_the_papers_accesses() -> None:
    """With samples at f hertz, [0], [-1/f], [-2/f] are the last three, and [-3/(2f)] is the mean of the two around it."""
    for f in (3, 50, 200, 1000 / 3):
        omega = fed(made(), lambda t: t * t, [round(i * S / f) for i in range(20)])
        samples = [(i / f) ** 2 for i in range(20)]
        assert omega[0] == pytest.approx(samples[-1], rel=1e-6)
        assert omega[-1 / f] == pytest.approx(samples[-2], rel=1e-6)
        assert omega[-2 / f] == pytest.approx(samples[-3], rel=1e-6)
        assert omega[-3 / (2 * f)] == pytest.approx((samples[-2] + samples[-3]) / 2, rel=1e-6)
        assert omega[-19 / f] == pytest.approx(0, abs=1e-6)


@given(instants(10, 40), st.integers(1, 6), st.data())
def test_a_polynomial_of_the_order_is_met_exactly(when: list[int], order: int, data: Any) -> None:
    """Between samples of a polynomial, interpolation of its order gives the polynomial, however uneven the samples are."""
    ratios = data.draw(st.lists(st.integers(-9, 9), min_size=order + 1, max_size=order + 1))
    scale = when[-1]
    exact = [Fraction(one) for one in ratios]

    def polynomial(instant: int) -> Fraction:
        x = Fraction(instant, scale)
        return sum((one * x**k for k, one in enumerate(exact)), Fraction(0))

    omega = made(interpolation="cubic" if order == 3 else order)
    for instant in when:
        omega.push(float(polynomial(instant)), instant)
    asked = data.draw(st.integers(when[0], when[-1]))
    # Rounding of samples is amplified by the weights of the polynomial through them.
    nearest = sorted(when, key=lambda one: abs(one - asked))[: order + 3]
    gaps = [abs(a - b) for a in nearest for b in nearest if a != b]
    amplified = (max(gaps) / min(gaps)) ** order
    assert omega.at(asked) == pytest.approx(float(polynomial(asked)), abs=1e-13 * amplified + 1e-9)


@given(st.integers(1, 40), st.integers(0, 400), st.data())
def test_the_ring_keeps_the_newest(history: int, pushed: int, data: Any) -> None:
    """After any number of samples the history is the last so many, in order, and each is found at its instant."""
    omega = made(history=history)
    for i in range(pushed):
        omega.push(float(i), i * MS)
    kept = range(max(0, pushed - history), pushed)
    found = omega.window()
    assert found.values.tolist() == list(kept)
    assert found.instants.tolist() == [i * MS for i in kept]
    assert omega.counts.kept == pushed
    for i in kept:
        assert omega.at(i * MS) == i
    if pushed > history:
        assert omega.forgotten == kept[0] * MS
        with pytest.raises(StateError, match="history reaches from"):
            omega.at((kept[0] - 1) * MS)
    if len(kept) > 1:
        at = data.draw(st.integers(kept[0] * MS, kept[-1] * MS))
        assert omega.at(at) == pytest.approx(at / MS)


def test_cubic_interpolation_at_the_ends_and_with_few_samples() -> None:
    """At the ends of the history the four nearest samples count; with fewer samples the order is what they allow."""
    cubic = fed(made(interpolation="cubic"), lambda t: t**3 + 1, [i * S for i in range(1, 7)])
    for t in (1.5, 2.5, 3.5, 4.5, 5.5):
        assert cubic.at(round(t * S)) == pytest.approx(t**3 + 1)
    few = fed(made(interpolation="cubic"), lambda t: t**2, [i * S for i in range(3)])
    assert few.at(S // 2) == pytest.approx(0.25)
    two = fed(made(interpolation="cubic"), lambda t: t**2, [0, S])
    assert two.at(S // 2) == pytest.approx(0.5)


def test_whole_numbers_and_flags_are_held() -> None:
    """Between two values of an int or bool state the earlier one counts, and it stays an int or bool."""
    mode = made(type=int)
    flag = made(type=bool)
    for state, values in ((mode, (2, 5)), (flag, (True, False))):
        for i, value in enumerate(values):
            state.push(value, i * S)
        assert state.at(S // 2) is values[0]
        assert state[0] is values[1]
    with pytest.raises(StateError, match="float, int or bool"):
        made(type=str)


def test_outside_of_the_history_is_an_error_that_says_what_there_is() -> None:
    """State, asked time, history and a way out are in the message; nothing is clamped; `get` has a default."""
    omega = fed(made(), lambda t: t, range(0, S + 1, 100 * MS))
    with pytest.raises(
        StateError, match=r"'omega' has no value at t = \+0.2 s: .* from -1 to 0 s; .*estimator"
    ):
        omega[0.2]
    with pytest.raises(StateError, match=r"t = -1.5 s"):
        omega[-1.5]
    assert omega.get(-1.5) is UNKNOWN
    assert omega.get(-1.5, 7.0) == 7.0
    assert omega.get(-0.5) == pytest.approx(0.5)
    for odd in (math.nan, math.inf, "soon"):
        with pytest.raises(StateError, match="not a time in seconds"):
            omega[odd]  # type: ignore[index]


def test_unknown_before_the_first_sample() -> None:
    """Before anything was heard every value is unknown, and there is no age."""
    for omega in (made(), made(estimator=ConstantVelocity())):
        assert omega[0] is UNKNOWN
        assert omega[-0.5] is UNKNOWN
        assert omega.at(5) is UNKNOWN
        assert omega.value is UNKNOWN
        assert omega.age_s is None
        assert omega.instant is None
        assert omega.span is None
        assert omega.is_stale
        assert not omega.is_known
        assert omega.window().values.size == 0
        assert omega.rate()[0] is UNKNOWN


def test_a_stale_value_does_not_pass_as_fresh() -> None:
    """Once older than `stale_after_s`, [0] is unknown; `last` still says what it was, and the past stays readable."""
    omega = made(stale_after_s=0.05)
    omega.push(1.0, 0)
    omega.push(2.0, 10 * MS)
    clock: Any = omega.clock
    clock.advance_to(60 * MS)
    assert omega[0] == 2.0
    assert not omega.is_stale
    clock.advance(1)
    assert omega[0] is UNKNOWN
    assert omega.is_stale
    assert omega.last == 2.0
    assert omega[-0.01] == 1.0
    reading = omega.read()
    assert (reading.value, reading.instant, reading.age_ns, reading.is_stale) == (
        2.0,
        10 * MS,
        50 * MS + 1,
        True,
    )
    assert omega.age_s == pytest.approx(0.05, abs=1e-6)


@pytest.mark.parametrize(
    "odd", [math.nan, math.inf, -math.inf, UNKNOWN, None, "12", b"x", 1j, 10**400, [1.0]]
)
def test_what_is_no_number_is_an_unknown_sample(odd: Any) -> None:
    """NaN, infinities, text and the like are unknown at their instant and up to the next sample, and counted."""
    omega = made()
    omega.push(1.0, 0)
    omega.push(odd, 10 * MS)
    assert omega[0] is UNKNOWN
    assert omega.instant == 10 * MS
    omega.push(3.0, 20 * MS)
    assert omega.value == 3.0
    assert omega[-0.02] == 1.0
    assert omega[-0.005] is UNKNOWN
    assert omega[-0.015] is UNKNOWN
    assert np.isnan(omega.window().values).tolist() == [False, True, False]
    assert (omega.counts.kept, omega.counts.unknown) == (3, 1)


def test_higher_orders_keep_away_from_unknown_samples() -> None:
    """A cubic beside an unknown sample goes through known ones only."""
    omega = made(interpolation="cubic")
    for i in range(8):
        omega.push(math.nan if i == 3 else float(i**3), i * S)
    assert omega.at(4 * S + S // 2) == pytest.approx(4.5**3)
    assert omega.at(S + S // 2) == pytest.approx(3.75)  # the parabola through 0, 1, 8
    assert omega.at(2 * S + 1) is UNKNOWN


def test_late_and_repeated_samples() -> None:
    """An older sample is dropped, one at the same instant takes its place; both are counted, listeners hear neither."""
    omega = made()
    heard: list[tuple[Any, int]] = []
    omega.subscribe(lambda value, instant: heard.append((value, instant)))
    omega.push(1.0, 10)
    omega.push(2.0, 20)
    omega.push(9.0, 15)
    omega.push(3.0, 20)
    assert omega[0] == 3.0
    assert omega.window().values.tolist() == [1.0, 3.0]
    omega.push(math.nan, 20)
    assert omega[0] is UNKNOWN
    counts = omega.counts
    assert (counts.kept, counts.late, counts.repeated, counts.unknown) == (2, 1, 2, 1)
    assert heard == [(1.0, 10), (2.0, 20)]


def test_after_clear_a_clock_that_was_set_back_is_accepted() -> None:
    """`clear` forgets samples and their time."""
    omega = fed(made(history=4), lambda t: t, range(0, 10 * MS, MS))
    omega.clear()
    assert omega[0] is UNKNOWN
    assert omega.window().values.size == 0
    omega.push(1.0, 5)
    assert omega.value == 1.0
    assert omega.window().values.tolist() == [1.0]
    assert omega.counts.late == 0


def test_an_instant_that_is_none_is_the_callers_error() -> None:
    """Instants come from a clock, not from a wire: a float is refused by name."""
    with pytest.raises(StateError, match=r"'omega': 0\.5 is not an instant in ns"):
        made().push(1.0, 0.5)  # type: ignore[arg-type]


def test_set_points_reach_the_setter_and_have_a_history() -> None:
    """`set` calls the setter with finite numbers only; `setpoint` is a state of what was set."""
    sent: list[float] = []
    hip = made("hip", setter=sent.append)
    clock: Any = hip.clock
    target = hip.setpoint
    for value in (0.1, 0.2):
        clock.advance(10 * MS)
        hip.set(value)
    assert sent == [0.1, 0.2]
    assert hip[0] is UNKNOWN  # nobody has measured it
    assert (target[0], target[-0.005], target.name) == (0.2, 0.1, "hip.setpoint")
    for odd in (math.nan, math.inf, UNKNOWN, "0.1", None):
        with pytest.raises(StateError, match="not a set-point"):
            hip.set(odd)  # type: ignore[arg-type]
    assert sent == [0.1, 0.2]


def test_a_signal_tells_its_set_points_to_states_whose_set_points_are_read() -> None:
    """Nothing listens to what is handed down before it is read; then its history begins, and ends with the connection."""
    clock = VirtualClock()
    signal = Signal("hip.position", clock, unit="rad", setter=lambda value: None)
    hip = State.of(signal)
    hip.set(0.1)
    assert signal.given == []
    target = hip.setpoint
    hip.set(0.2)
    assert target[0] == 0.2
    assert target.counts.kept == 1
    assert hip.setpoint is target
    assert len(signal.given) == 1
    hip.disconnect()
    assert signal.given == []


def test_read_only_and_unsampled_states() -> None:
    """A state without setter refuses; one that nobody measures takes its set-point as its value at once."""
    with pytest.raises(StateError, match="'omega' is read-only"):
        made().set(1.0)
    lamp = made("lamp", sampled=False)
    lamp.set(0.5)
    assert lamp[0] == 0.5
    with pytest.raises(StateError, match=r"setter=…, or sampled=False"):
        made(writable=True)


def test_a_state_follows_a_signal() -> None:
    """Name, unit, clock, staleness and setter are the signal's; its last value counts at once; `disconnect` ends it."""
    clock = VirtualClock(7)
    sent: list[Any] = []
    signal = Signal("RHY.position", clock, unit="rad", stale_after_ns=20 * MS, setter=sent.append)
    signal.update(0.25, 3)
    state = State.of(signal, history=8, interpolation="cubic")
    assert (state.name, state.unit, state.clock, state.stale_after_s) == ("RHY.position", "rad", clock, 0.02)
    assert state[0] == 0.25
    signal.update(0.5, 7)
    assert (state[0], state.instant) == (0.5, 7)
    state.set(0.75)
    assert sent == [0.75]
    state.disconnect()
    signal.update(1.0, 8)
    assert state[0] == 0.5
    assert not State.of(Signal("tilt", clock)).is_writable


def test_refresh_asks_the_device() -> None:
    """`refresh` calls what requests a sample; without one it does nothing."""
    asked: list[bool] = []
    made(request=lambda: asked.append(True)).refresh()
    made().refresh()
    assert asked == [True]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"history": 0}, "history of 0"),
        ({"history": 1 << 40}, "history of"),
        ({"history_s": 1.0}, "needs period_s"),
        ({"history_s": 1.0, "history": 5, "period_s": 0.1}, "not both"),
        ({"period_s": -1.0}, "period_s = -1.0"),
        ({"stale_after_s": math.nan}, "stale_after_s = nan"),
        ({"interpolation": "quintic"}, "'quintic'; there are"),
        ({"interpolation": 99}, "orders 0 … 9"),
        ({"interpolation": 2.5}, "orders 0 … 9"),
        ({"history": 2.5}, r"history of 2\.5 samples"),
        ({"unit": 3}, "a unit is a text"),
        ({"name": ""}, "needs a name"),
        ({"estimator": 5}, "not an estimator"),
    ],
)
def test_a_wrong_declaration_is_refused(options: dict[str, Any], says: str) -> None:
    """What cannot be is said when the state is made, with its name."""
    with pytest.raises(StateError, match=says):
        made(**options)


def test_history_in_seconds() -> None:
    """`history_s` keeps that long at the state's period, both ends included."""
    omega = fed(made(period_s=0.005, history_s=1.0), lambda t: t, range(0, 3 * S, 5 * MS))
    assert omega[-1.0] == pytest.approx(omega[0] - 1.0)
    assert omega.history == 201


@pytest.mark.parametrize("what", ["piece", "instants", "value"])
def test_a_reader_that_is_overtaken_reads_again(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    """Samples that come in the middle of a reading, more than a ring of them, never mix into it."""
    omega = fed(made(history=8), lambda t: t, range(0, 8 * MS, MS))
    pushed = [0]

    def interrupted(*arguments: Any) -> int:
        place = bisect_left(*arguments)
        if pushed[0] < 300:
            for _ in range(100):
                pushed[0] += 1
                omega.push(float(pushed[0]), (7 + pushed[0]) * MS)
        return place

    monkeypatch.setattr("aces_bus.state.state.bisect_left", interrupted)
    newest = [(7 + i) * MS for i in range(293, 301)]
    if what == "piece":
        stamps, values = omega.piece_between(0, 1 << 60)
        assert values.tolist() == [float(i) for i in range(293, 301)]
        assert stamps.tolist() == newest
    elif what == "instants":
        assert omega.samples_up_to(1 << 60, 3) == newest[-3:]
    else:
        with pytest.raises(StateError, match="history reaches from"):
            omega.at(3 * MS + 1)  # it was there when the search began


def test_a_reader_between_any_two_stores_of_a_push_sees_one_moment() -> None:
    """After each single store a reader finds the old sample or the new one, and never asks for what is not there yet."""
    seen: list[Any] = []

    class Watched(State):
        def __setattr__(self, name: str, value: Any) -> None:
            super().__setattr__(name, value)
            if name in ("_newest", "_newest_at", "_count") and self.__dict__.get("_newest_at", -1) > 0:
                at = self.instant
                assert at is not None
                before = at - 10 * MS
                seen.append(self[0])
                assert self[0] >= at / S
                assert self[-0.005] == pytest.approx((before + 5 * MS) / S)
                assert self.window(-0.01).values[-1] >= at / S

    fed(Watched("omega", clock=VirtualClock()), lambda t: t, range(0, S, 10 * MS))
    assert len(seen) > 200


def test_states_default_to_this_machines_clock() -> None:
    """Without a clock a state takes the monotonic one."""
    state = State("x")
    assert isinstance(state.clock, RealClock)
    state.push(1.0, state.clock.now())
    assert state[0] == 1.0
    assert "x = 1.0" in repr(state)


def test_readers_on_other_threads_see_whole_samples() -> None:
    """While one thread pushes, others read values that were pushed, at their instants, without locks and without errors."""
    omega = made(history=100)
    omega.push(0.0, 0)
    is_done = threading.Event()
    seen = [0]

    def push() -> None:
        for i in range(1, 30_000):
            omega.push(float(i * MS), i * MS)
        is_done.set()

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    writer = threading.Thread(target=push)
    try:
        writer.start()
        while not is_done.is_set():
            value, earlier = omega[0], omega.get(-0.0315)
            assert value % MS == 0
            if earlier is not UNKNOWN:
                assert earlier % (MS // 2) == 0
            found = omega.window()
            assert (found.values == found.instants).all()
            assert (np.diff(found.instants) == MS).all()
            assert omega.rate()[0] in (UNKNOWN, 1e9)
            seen[0] += 1
    finally:
        sys.setswitchinterval(interval)
        writer.join()
    assert seen[0] > 0
    assert omega.counts.kept == 30_000


def test_an_estimator_of_ones_own_that_raises_does_not_stop_samples() -> None:
    """Samples go on, and the failures are counted."""

    class Broken:
        def start(self, state: State) -> Estimation:
            def observe(value: float, instant: int) -> None:
                raise RuntimeError

            return Estimation(observe, lambda instant: 1.0)

    omega = fed(made(estimator=Broken()), lambda t: t, [0, S])
    assert omega.counts.failed == 2
    assert omega.last == 1.0


def test_what_no_float_holds_is_unknown() -> None:
    """Between, behind and beyond samples of 1e308 there is no infinity."""
    cases: list[dict[str, Any]] = [
        {},
        {"interpolation": "cubic"},
        {"estimator": Kalman(1.0, 1.0, "acceleration")},
    ]
    for options in cases:
        omega = made(**options)
        for i in range(8):
            omega.push(1.7e308 * (-1) ** i, i)
        assert omega.at(0) == 1.7e308
        assert omega.rate().at(3) is UNKNOWN
        assert omega.rate(3).at(3) is UNKNOWN
        assert omega.rate()[0] is UNKNOWN
        if "estimator" in options:
            assert omega.at(100) is UNKNOWN
            fed(omega, lambda t: 2.0, range(S, 3 * S, 10 * MS))
            assert omega.at(3 * S) == pytest.approx(2.0)
    area = made()
    total = area.integral()
    fed(area, lambda t: 1.7e308, [0, S, 100 * S])
    assert (total[0], total.skipped_s) == (0.0, 100.0)
