"""Integrals and filters: analytic bounds, scipy's answer, uneven samples, gaps."""

from __future__ import annotations

import math
import statistics
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError
from aces_bus.state import (
    Kalman,
    LowPass,
    Median,
    MovingAverage,
    RateLimit,
    Sos,
    StateError,
    iir,
    notch,
)

from .feeding import MS, S, fed, instants, made, sine

#: Butterworth, second order, 5 Hz of 200 Hz; and the same twice over.
SECTION = (
    0.005542717210280681,
    0.011085434420561363,
    0.005542717210280681,
    1.0,
    -1.778631777824585,
    0.8008026466657076,
)
LOW = Sos((SECTION,), 200)
NUMBERS = st.floats(-1e6, 1e6)


# ---- integral -------------------------------------------------------------------------------------------------------


@given(instants(3, 80))
def test_the_integral_of_a_sine_is_within_its_bound(when: list[int]) -> None:
    """Trapezoids over uneven samples of a sine are off by at most Σ h³/12 · max|f″|."""
    f = 0.7
    w = 2 * math.pi * f
    omega = made()
    area = omega.integral()
    fed(omega, sine(f), when)
    exact = (math.cos(w * when[0] / S) - math.cos(w * when[-1] / S)) / w
    bound = sum(((b - a) / S) ** 3 for a, b in pairwise(when)) / 12 * w * w
    assert abs(area[0] - exact) <= bound + 1e-12
    assert area.unit == "rad"
    assert area.window().values.size == len(when)


def test_the_integral_begins_when_it_is_asked_for() -> None:
    """From the newest sample on, from `start`; `reset` begins again."""
    omega = fed(made(), lambda t: 1.0, range(0, S, 100 * MS))
    area = omega.integral(5.0)
    assert omega.integral(5.0) is area
    assert area[0] == 5.0
    fed(omega, lambda t: 1.0, range(S, 2 * S, 100 * MS))
    assert area[0] == pytest.approx(6.0)
    area.reset(0.0)
    assert area[0] == 0.0
    fed(omega, lambda t: 1.0, [3 * S])
    assert area[0] == pytest.approx(1.1)


def test_unknown_samples_do_not_poison_an_integral() -> None:
    """NaN is bridged, as wide as `max_gap_s` allows; what is wider adds nothing and is told."""
    omega = made()
    bridged, careful = omega.integral(), omega.integral(max_gap_s=0.15)
    for i in range(11):
        omega.push(math.nan if i == 5 else 2.0, i * 100 * MS)
        assert (bridged[0] is UNKNOWN) == (i == 5)
    assert bridged[0] == pytest.approx(2.0)
    assert careful[0] == pytest.approx(1.6)
    assert careful.skipped_s == pytest.approx(0.2)


# ---- filters --------------------------------------------------------------------------------------------------------


@given(
    st.lists(NUMBERS, min_size=1, max_size=80),
    st.integers(1, 6),
    st.sampled_from(["butter", "cheby2", "bessel"]),
)
def test_sections_equal_scipys(values: list[float], order: int, family: Any) -> None:
    """Sample by sample our sections give what scipy.signal.sosfilt gives, from rest and from the steady state."""
    signal = pytest.importorskip("scipy.signal")
    for initial in ("zero", "steady"):
        kind = iir(order, 12.0, 200.0, family=family, attenuation_db=40, initial=initial)
        rows = np.array(kind.sections)
        start = signal.sosfilt_zi(rows) * (values[0] if initial == "steady" else 0.0)
        expected, _ = signal.sosfilt(rows, values, zi=start)
        step = kind.start_filter(values[0])
        found = [step(value, 0) for value in values]
        assert found == pytest.approx(expected.tolist(), rel=1e-9, abs=1e-9 * max(map(abs, values)) + 1e-300)


def test_sections_in_a_row_begin_in_the_steady_state_of_all() -> None:
    """Each section begins as if the level that the one before it gives had always been; an integrator begins at rest."""
    half, double = (0.25, 0.25, 0, 1, 0, 0), (1.0, 0.5, 0.1, 1, -0.3, 0.1)
    gain = 0.5 * 1.6 / 0.8
    step = Sos((half, double, SECTION), 200).start_filter(3.0)
    assert [step(3.0, 0) for _ in range(5)] == pytest.approx([3.0 * gain] * 5)
    total = Sos(((1.0, 0, 0, 1, -1, 0),), 200).start_filter(3.0)
    assert [total(3.0, 0) for _ in range(3)] == [3.0, 6.0, 9.0]


def test_designs_have_their_frequencies() -> None:
    """A Butterworth filter is at -3 dB at its cutoff, a notch takes its frequency out; what cannot be designed is said."""
    pytest.importorskip("scipy.signal")
    for kind, frequency, gain in (
        (iir(3, 10.0, 200.0), 10.0, math.sqrt(0.5)),
        (iir(2, (5.0, 20.0), 200.0, kind="bandpass"), 10.0, 1.0),
        (notch(10.0, 200.0), 10.0, 0.0),
        (notch(10.0, 200.0), 40.0, 1.0),
    ):
        omega = made(period_s=0.005)
        out = omega.filtered(kind)
        fed(omega, sine(frequency), range(0, 30 * S, 5 * MS))
        assert out.spectrum(3.995).peak[1] == pytest.approx(gain, abs=0.01)
    with pytest.raises(StateError, match="half of the rate"):
        iir(2, 150.0, 200.0)
    with pytest.raises(StateError, match="cannot be designed"):
        iir(2, 10.0, 200.0, family="cheby1")


def test_without_scipy_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where scipy is missing, the message says what to install and what works without."""
    import sys

    monkeypatch.setitem(sys.modules, "scipy.signal", None)
    with pytest.raises(CallerError, match=r"aces-bus\[filters\]"):
        iir(2, 5.0, 200.0)


@given(st.lists(NUMBERS, min_size=1, max_size=60), st.lists(st.integers(1, 9), min_size=1, max_size=3))
def test_a_cascade_of_averages_is_the_average_of_averages(values: list[float], lengths: list[int]) -> None:
    """Each stage is the mean of its last n inputs, with the first value before the beginning."""
    step = MovingAverage(tuple(lengths)).start_filter(values[0])
    expected = values
    for length in lengths:
        padded = [values[0]] * length + expected
        expected = [statistics.fmean(padded[i + 1 : i + 1 + length]) for i in range(len(expected))]
    assert [step(value, 0) for value in values] == pytest.approx(expected, abs=1e-6)


def test_a_cascade_settles_when_it_should() -> None:
    """A step has arrived after n + m + l - 2 samples, and not before."""
    step = MovingAverage((10, 5, 2), initial="zero").start_filter(0.0)
    found = [step(1.0, 0) for _ in range(20)]
    assert found[14] == pytest.approx(1.0)
    assert found[13] < 1 - 1e-3
    assert max(np.diff([0.0, *found])) == pytest.approx(0.1)  # velocity is limited to 1/10 a sample


@given(st.lists(NUMBERS, min_size=1, max_size=60), st.integers(1, 12))
def test_the_median_is_the_median(values: list[float], length: int) -> None:
    """Of the last so many samples, fewer at the beginning."""
    step = Median(length).start_filter(values[0])
    for i, value in enumerate(values):
        assert step(value, 0) == pytest.approx(statistics.median(values[max(0, i + 1 - length) : i + 1]))


@given(instants(2, 60), st.data())
def test_a_rate_limit_is_never_exceeded(when: list[int], data: Any) -> None:
    """Whatever comes, the output moves by at most the rates times real time, and arrives when it can."""
    omega = made()
    out = omega.filtered(RateLimit(2.0, 5.0))
    for instant in when:
        omega.push(data.draw(st.floats(-1, 1)), instant)
    found = out.window()
    change, elapsed = np.diff(found.values), np.diff(found.instants) / S
    assert (change <= 2.0 * elapsed + 1e-12).all()
    assert (change >= -5.0 * elapsed - 1e-12).all()
    omega.push(0.5, when[-1] + S)
    assert out[0] == 0.5


@given(instants(2, 60))
def test_a_low_pass_by_real_time_does_not_mind_the_sampling(when: list[int]) -> None:
    """After a step, exp(-t/τ) of it is left at any instant, however uneven the samples before it were."""
    omega = made()
    out = omega.filtered(LowPass(0.05))
    omega.push(0.0, 0)
    for instant in when:
        omega.push(1.0, instant)
        assert out[0] == pytest.approx(1 - math.exp(-instant / S / 0.05), abs=1e-12)


def test_a_filter_takes_the_history_first() -> None:
    """Made late, a filter has already seen what the state has kept; asked again, it is the same one."""
    early, late = made(), made()
    out = early.filtered(LOW)
    for omega in (early, late):
        fed(omega, sine(2.0), range(0, 2 * S, 5 * MS))
    assert late.filtered(LOW)[0] == out[0]
    assert late.filtered(LOW) is late.filtered(Sos((SECTION,), 200))


# ---- uneven samples -------------------------------------------------------------------------------------------------


def test_even_samples_pass_as_they_are() -> None:
    """On the grid, resampling changes nothing: the same numbers at the same instants, whatever the period."""
    for rate in (200.0, 30.0):
        kind = Sos((SECTION,), rate)
        when = [round(7 + i * 1e9 / rate) for i in range(300)]
        one, other = made(), made()
        resampled, accepted = one.filtered(kind), other.filtered(kind, uneven="accept")
        for omega in (one, other):
            fed(omega, sine(1.0), when)
        assert resampled.window().values.tolist() == accepted.window().values.tolist()
        assert resampled.window().instants.tolist() == when


@given(st.integers(0, 1000))
def test_uneven_samples_are_resampled(seed: int) -> None:
    """A filter of jittering samples gives what it gives for even ones, within the error of the interpolation."""
    rng = np.random.default_rng(seed)
    when = (np.arange(400) * 5 * MS + rng.integers(-2 * MS, 2 * MS, 400) + 10 * MS).tolist()
    jittering, even = made(), made()
    out, ideal = jittering.filtered(LOW), even.filtered(LOW)
    fed(jittering, sine(1.0), when)
    fed(even, sine(1.0), range(when[0], when[-1] + 1, 5 * MS))
    n = min(out.counts.kept, ideal.counts.kept)
    assert n >= 390
    found, expected = out.window().values[:n], ideal.window().values[:n]
    # Linear interpolation over h ≤ 9 ms of a 1 Hz sine: h²/8 · (2π)² = 4e-4.
    assert np.abs(found - expected).max() < 5e-4


def test_a_sample_a_little_early_is_in_step() -> None:
    """Within 1 % of the period a sample stands for its instant of the grid, and the output is not from the future."""
    omega = made()
    out = omega.filtered(LOW)
    fed(omega, lambda t: 1.0, [0, 5 * MS - 30_000, 10 * MS + 30_000, 15 * MS])
    assert out.window().instants.tolist() == [0, 5 * MS - 30_000, 10 * MS, 15 * MS]


def test_slow_samples_are_filled_up_and_gaps_are_not() -> None:
    """Twice as slow: a step in between. Beyond the gap that may be bridged: begun anew, and counted."""
    omega = made(stale_after_s=0.1)
    out = omega.filtered(LOW)
    fed(omega, lambda t: 1.0, range(0, S + 1, 10 * MS))
    assert out.counts.kept == 201
    fed(omega, lambda t: 5.0, [10 * S])
    assert out.counts.restarts == 1
    assert out[0] == pytest.approx(5.0)
    assert out.counts.kept == 202


def test_uneven_samples_may_be_refused() -> None:
    """With "refuse", a sample out of step gives unknown, is counted, and the filter begins anew there."""
    omega = made()
    out = omega.filtered(LOW, uneven="refuse")
    fed(omega, lambda t: 1.0, range(0, 50 * MS + 1, 5 * MS))
    assert out[0] == pytest.approx(1.0)
    fed(omega, lambda t: 3.0, [58 * MS])
    assert out[0] is UNKNOWN
    assert out.counts.uneven == 1
    fed(omega, lambda t: 3.0, [63 * MS])
    assert out[0] == pytest.approx(3.0)
    with pytest.raises(StateError, match=r"made for 200 Hz, its source is sampled at 100 Hz"):
        made(period_s=0.01).filtered(LOW, uneven="refuse")
    with pytest.raises(StateError, match="there are 'resample'"):
        made().filtered(LOW, uneven="ignore")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "kind",
    [LOW, MovingAverage(5), Median(5), RateLimit(100.0), LowPass(0.01), Kalman(0.1, 1.0)],
    ids=lambda k: type(k).__name__,
)
def test_unknown_samples_do_not_poison_a_filter(kind: Any) -> None:
    """A NaN gives one unknown output; what follows is as if it had not been there."""
    omega = made()
    out = omega.filtered(kind)
    for i in range(200):
        omega.push(math.nan if i in (50, 120) else 1.0, i * 5 * MS)
        if i in (50, 120):
            assert out[0] is UNKNOWN
    assert out[0] == pytest.approx(1.0)
    assert out.counts.unknown == 2
    assert out.counts.late == 0


def test_a_filter_that_runs_away_begins_anew() -> None:
    """An unstable filter reaches infinity, gives unknown there, and starts again instead of giving NaN for ever."""
    omega = made()
    out = omega.filtered(Sos(((1.0, 0, 0, 1, -1e200, 0),), 200, initial="zero"))
    fed(omega, lambda t: 1.0, range(0, 40 * MS, 5 * MS))
    assert out.counts.restarts >= 2
    assert out.counts.unknown == out.counts.restarts


def test_a_filter_of_ones_own_that_raises_does_not_stop_the_source() -> None:
    """A function is a filter; when it raises, the output is unknown, counted and kept for the curious."""
    omega = made()
    out = omega.filtered(lambda value: 1 / value)  # type: ignore[arg-type]
    for i, value in enumerate((2.0, 0.0, 4.0)):
        omega.push(value, i * S)
    assert omega[0] == 4.0
    assert [out.at(i * S) for i in range(3)] == [0.5, UNKNOWN, 0.25]
    assert out.counts.failed == 1
    assert isinstance(out.failure, ZeroDivisionError)


def test_a_loop_that_makes_filters_each_cycle_is_told() -> None:
    """Parameters that change each time would pile up filters; there is an end to it."""
    omega = made()
    for i in range(64):
        omega.filtered(LowPass(1.0 + i))
    with pytest.raises(StateError, match="Make them once"):
        omega.filtered(LowPass(0.5))
    omega.filtered(LowPass(1.0))


@pytest.mark.parametrize(
    "make",
    [
        lambda: MovingAverage(()),
        lambda: MovingAverage(0),
        lambda: MovingAverage((1.5,)),  # type: ignore[arg-type]
        lambda: made().filtered(3),  # type: ignore[arg-type]
        lambda: made().filtered(Median),  # type: ignore[arg-type]
        lambda: made().rate(1.5),  # type: ignore[arg-type]
        lambda: Median(0),
        lambda: RateLimit(0.0),
        lambda: RateLimit(1.0, -1.0),
        lambda: LowPass(math.inf),
        lambda: Sos((), 200),
        lambda: Sos(((1, 2, 3),), 200),
        lambda: Sos(((1, 0, 0, 0, 0, 0),), 200),
        lambda: Sos((SECTION,), -1),
        lambda: Kalman(0.0, 1.0),
        lambda: Kalman(1.0, 1.0, "jerk"),  # type: ignore[arg-type]
        lambda: Kalman(1.0, 1.0, derivative=2),
    ],
)
def test_a_filter_that_cannot_be_is_refused(make: Any) -> None:
    """Lengths, rates, times and coefficients are checked when the filter is described."""
    with pytest.raises(StateError):
        make()


def test_what_is_made_of_a_state_begins_anew_with_it() -> None:
    """After a clock was set back and the state was cleared, its integrals, filters and products take the new samples."""
    omega = made(estimator=Kalman(0.01, 1.0))
    area, calm, even = omega.integral(), omega.filtered(LowPass(0.1)), omega.filtered(LOW)
    energy = (omega * 2).integral()
    fed(omega, lambda t: 1.0, range(10 * S, 11 * S + 1, 5 * MS))
    omega.clear()
    for i in range(201):
        omega.push(3.0, i * 5 * MS)
    assert area[0] == pytest.approx(1.0 + 3.0)
    assert energy[0] == pytest.approx(2.0 + 6.0)
    assert calm[0] == pytest.approx(3.0)
    assert even[0] == pytest.approx(3.0)
    assert even.counts.late == 0
    assert even.instant == S
    assert omega.at(1100 * MS) == pytest.approx(3.0)
