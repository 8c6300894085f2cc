"""Stretches of history as arrays, and their spectra."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.state import ConstantVelocity, StateError

from .feeding import MS, S, fed, instants, made, sine


@given(instants(2, 60), st.floats(0, 1), st.floats(0, 1))
def test_a_window_is_the_samples_in_it(when: list[int], one: float, other: float) -> None:
    """From t0 to t1, both included, with instants, seconds from the origin and values."""
    omega = fed(made(), lambda t: 2 * t, when)
    length = (when[-1] - when[0]) / S
    t0, t1 = sorted((-one * length, -other * length))
    found = omega.window(t0, t1)
    low, high = when[-1] + round(t0 * S), when[-1] + round(t1 * S)
    expected = [i for i in when if low <= i <= high]
    assert found.instants.tolist() == expected
    assert found.values.tolist() == [2 * (i / S) for i in expected]
    assert found.times_s == pytest.approx([(i - when[-1]) / S for i in expected])
    assert (omega * 1).window(t0, t1).instants.tolist() == expected
    assert (omega * 1).window(t0, t1).values == pytest.approx(found.values)


def test_a_window_on_an_even_grid() -> None:
    """`rate_hz` interpolates onto a grid that ends at t1; unknown stretches are NaN."""
    omega = fed(made(), lambda t: t, [0, 30 * MS, 50 * MS, 100 * MS])
    found = omega.window(-0.1, 0.0, rate_hz=100)
    assert found.values == pytest.approx([i / 100 for i in range(11)])
    assert np.diff(found.instants).tolist() == [10 * MS] * 10
    omega.push(math.nan, 110 * MS)
    assert np.isnan(omega.window(-0.01, 0.0, rate_hz=200).values).tolist() == [False, True, True]


def test_samples_that_are_gone_are_not_left_out_in_silence() -> None:
    """A window that reaches before what is kept is an error; one before the first sample ever is not."""
    omega = fed(made(history=10), lambda t: t, range(0, 10 * MS, MS))
    assert omega.window(-5.0).values.size == 10
    fed(omega, lambda t: t, [10 * MS])
    with pytest.raises(StateError, match=r"are gone \(it keeps 10\)"):
        omega.window(-5.0)
    assert omega.window().values.size == 10
    assert omega.window(-0.009).values.size == 10
    for rate in (0.0, math.nan, -1.0):
        with pytest.raises(StateError, match="not a rate"):
            omega.window(-0.005, rate_hz=rate)
    with pytest.raises(StateError, match="at most"):
        fed(made(), lambda t: t, [0, 100 * S]).window(rate_hz=1e9)


@pytest.mark.parametrize("taper", ["none", "hann", "hamming", "blackman"])
def test_a_sine_has_its_peak(taper: str) -> None:
    """A sine that fits the window has a line of its amplitude at its frequency, beside the mean."""
    omega = fed(made(), lambda t: 3 + sine(5.0, 2.0)(t), range(0, 2 * S, 5 * MS))
    found = omega.spectrum(1.995, taper=taper)
    assert found.peak == pytest.approx((5.0, 2.0), rel=1e-6 if taper == "none" else 0.01)
    assert found.amplitudes[0] == pytest.approx(3.0, rel=1e-3)
    assert found.rate_hz == pytest.approx(200.0)
    assert not found.is_resampled
    assert found.unit == "rad/s"


def test_a_spectrum_is_printed_as_its_highest_line() -> None:
    """In the state's unit, with what else there is to know, and no arrays."""
    omega = fed(made(), lambda t: 3 + 2 * math.sin(20 * math.pi * t), range(0, 1000 * MS, 5 * MS))
    shown = repr(omega.spectrum(0.995))
    assert shown == (
        "<Spectrum of 101 lines up to 100 Hz: peak 2 rad/s at 10 Hz, mean 3 rad/s; sampled at 200 Hz>"
    )
    assert repr(omega.spectrum(0.99, rate_hz=100)).endswith("sampled at 100 Hz, resampled>")


@given(st.integers(0, 1000))
def test_the_spectrum_of_uneven_samples_says_that_it_is_resampled(seed: int) -> None:
    """Jittering samples are interpolated first, and still show their line."""
    rng = np.random.default_rng(seed)
    when = (np.arange(400) * 5 * MS + rng.integers(0, 2 * MS, 400)).tolist()
    found = fed(made(), sine(5.0), when).spectrum(1.795, rate_hz=200)
    assert found.is_resampled
    assert found.peak == pytest.approx((5.0, 1.0), abs=0.02)


def test_parseval() -> None:
    """Without a taper, the squares of the lines are the mean square of the samples."""
    rng = np.random.default_rng(1)
    for count in (100, 101):
        omega = made()
        values = rng.normal(size=count)
        for i, value in enumerate(values):
            omega.push(float(value), i * MS)
        lines = omega.spectrum((count - 1) / 1000, taper="none").amplitudes
        power = lines[0] ** 2 + (lines[1 : (count + 1) // 2] ** 2).sum() / 2
        power += lines[-1] ** 2 if count % 2 == 0 else 0
        assert power == pytest.approx(np.mean(values**2))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"window_s": 0.5, "taper": "kaiser"}, "no taper named"),
        ({"window_s": 0.0}, "a window of"),
        ({"window_s": 0.002}, "needs 4"),
        ({"window_s": 5.0}, "reaches back to"),
        ({"window_s": 0.9}, "1 of 91 samples"),
    ],
)
def test_a_spectrum_that_cannot_be_is_refused(arguments: dict[str, Any], says: str) -> None:
    """Too little history, too few samples, unknown samples: said, not made up."""
    omega = made()
    for i in range(101):
        omega.push(math.nan if i == 50 else 1.0, i * 10 * MS)
    with pytest.raises(StateError, match=says):
        omega.spectrum(**arguments)


def test_windows_of_states_with_estimators() -> None:
    """The origin is now: samples lie in the past by their age, and a grid may reach beyond them."""
    omega = made(estimator=ConstantVelocity())
    fed(omega, lambda t: t, [0, 100 * MS])
    clock: Any = omega.clock
    clock.advance(100 * MS)
    assert omega.window().times_s.tolist() == [-0.2, -0.1]
    assert omega.window(-0.2, 0.1, rate_hz=10).values == pytest.approx([0.0, 0.1, 0.2, 0.3])
