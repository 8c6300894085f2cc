"""Beyond the history: extrapolation, Kalman filters, a function of the user's own."""

from __future__ import annotations

import math
import random
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.device import UNKNOWN
from aces_bus.runtime import VirtualClock
from aces_bus.state import ConstantAcceleration, ConstantVelocity, Hold, Kalman, State, StateError

from .feeding import MS, S, fed, instants, made


@given(instants(3, 20), st.floats(-5, 5), st.floats(-5, 5), st.floats(-5, 5), st.floats(0, 2))
def test_a_constant_acceleration_goes_on(
    when: list[int], x: float, v: float, a: float, beyond: float
) -> None:
    """A parabola is continued into the future and into the past; inside, the samples count."""

    def moved(t: float) -> float:
        return x + v * t + a * t * t

    omega = fed(made(estimator=ConstantAcceleration()), moved, when)
    shortest = min(b - a for a, b in pairwise(when)) / S
    loose = 1e-13 * (1 + beyond / shortest) ** 2 + 1e-9
    ahead, before = when[-1] + round(beyond * S), when[0] - round(beyond * S)
    assert omega.at(ahead) == pytest.approx(moved(ahead / S), abs=loose * 20)
    assert omega.at(before) == pytest.approx(moved(before / S), abs=loose * 20)
    assert omega.at(when[1]) == moved(when[1] / S)


def test_zero_is_now_with_an_estimator() -> None:
    """An estimator brings [0] to the clock's now, and the past is counted from there."""
    clock = VirtualClock()
    omega = fed(State("omega", clock=clock, estimator=ConstantVelocity()), lambda t: 10 * t, [0, S])
    assert omega[0] == 10.0
    clock.advance(S // 2)
    assert omega[0] == pytest.approx(15.0)
    assert omega[-0.5] == pytest.approx(10.0)
    assert omega[-1.0] == pytest.approx(5.0)
    assert omega[2.0] == pytest.approx(35.0)
    assert omega.last == 10.0
    held = fed(State("omega", clock=clock, estimator=Hold()), lambda t: 1.0, [2 * S])
    clock.advance(S)
    assert held[0] == 1.0


def test_nothing_is_estimated_from_a_stale_value() -> None:
    """A sensor that has fallen silent is not extrapolated for ever; the past still is."""
    omega = made(estimator=ConstantVelocity(), stale_after_s=0.1)
    fed(omega, lambda t: t, [0, 50 * MS])
    clock: Any = omega.clock
    assert omega[1.0] == pytest.approx(1.05)
    clock.advance(200 * MS)
    assert omega[0] is UNKNOWN
    assert omega[0.1] is UNKNOWN
    assert omega.at(-50 * MS) == pytest.approx(-0.05)


def test_a_function_is_an_estimator() -> None:
    """It gets the state and the instant; what is not finite is unknown."""
    omega = made(estimator=lambda state, instant: state.last * 2 if instant > 0 else math.nan)
    omega.push(4.0, 0)
    assert omega.at(S) == 8.0
    assert omega.at(-S) is UNKNOWN
    assert omega.at(0) == 4.0


def test_extrapolation_leaves_unknown_samples_out() -> None:
    """The last known samples count; with one of them it is held, with none it is unknown."""
    omega = made(estimator=ConstantVelocity())
    omega.push(math.nan, 0)
    assert omega.at(S) is UNKNOWN
    omega.push(1.0, S)
    assert omega.at(5 * S) == 1.0
    omega.push(2.0, 2 * S)
    omega.push(math.nan, 3 * S)
    assert omega.at(5 * S) == pytest.approx(5.0)


# ---- Kalman ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "acceleration"), [("velocity", 0.0), ("acceleration", 3.0)])
@given(seed=st.integers(0, 1000))
def test_a_kalman_filter_converges(model: Any, acceleration: float, seed: int) -> None:
    """From noisy, uneven samples it finds value and velocity, with an error below what a sample has."""
    rng = random.Random(seed)
    noise = 0.1
    clock = VirtualClock()
    state = State("x", unit="m", clock=clock, estimator=Kalman(noise, 1e-6, model), history=2000)
    speed = state.filtered(Kalman(noise, 1e-6, model, derivative=1))
    at = 0

    def true(t: float) -> float:
        return 1 + 2 * t + 0.5 * acceleration * t * t

    while at < 10 * S:
        at += rng.randrange(2 * MS, 18 * MS)
        state.push(true(at / S) + rng.gauss(0, noise), at)
    clock.advance_to(at + 100 * MS)
    assert state[0] == pytest.approx(true(clock.now() / S), abs=noise)
    assert speed[0] == pytest.approx(2 + acceleration * at / S, abs=0.25)
    assert speed.unit == "m/s"
    assert state.at(-100 * MS) == pytest.approx(true(-0.1), abs=8 * noise)


@pytest.mark.parametrize("model", ["velocity", "acceleration"])
@given(seed=st.integers(0, 200))
def test_a_kalman_filter_is_the_textbooks(model: Any, seed: int) -> None:
    """Written out, it gives what the matrices give: F P Fᵀ + Q, then K and (I - K H) P."""
    rng = random.Random(seed)
    r, q = 0.04, 0.5
    kalman = Kalman(math.sqrt(r), q, model).track()
    size = 2 if model == "velocity" else 3
    at = 0
    for _ in range(2):
        at += rng.randrange(MS, 50 * MS)
        kalman.observe(rng.gauss(0, 1), at)
    x, p = np.array(kalman.state[1 : 1 + size]), matrix(kalman.state, size)
    H = np.eye(size)[:1]
    for _ in range(20):
        dt_ns = rng.randrange(MS, 50 * MS)
        at, dt, z = at + dt_ns, dt_ns * 1e-9, rng.gauss(0, 1)
        kalman.observe(z, at)
        F = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])[:size, :size]
        g = [[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]
        if size == 3:
            g = [
                [dt**5 / 20, dt**4 / 8, dt**3 / 6],
                [dt**4 / 8, dt**3 / 3, dt**2 / 2],
                [dt**3 / 6, dt**2 / 2, dt],
            ]
        x, p = F @ x, F @ p @ F.T + q * np.array(g)
        K = p @ H.T / (H @ p @ H.T + r)
        x, p = x + (K * (z - x[0]))[:, 0], (np.eye(size) - K @ H) @ p
    assert kalman.state[1 : 1 + size] == pytest.approx(x.tolist(), rel=1e-6, abs=1e-6)
    assert matrix(kalman.state, size) == pytest.approx(p, rel=1e-5, abs=1e-8)


def matrix(state: tuple[Any, ...], size: int) -> Any:
    """The covariance matrix of a track."""
    if size == 2:
        xx, xv, vv = state[4:]
        return np.array([[xx, xv], [xv, vv]])
    xx, xv, xa, vv, va, aa = state[4:]
    return np.array([[xx, xv, xa], [xv, vv, va], [xa, va, aa]])


def test_one_description_serves_many_states() -> None:
    """Two states with the same Kalman object do not hear of each other."""
    kalman = Kalman(0.01, 1.0)
    clock = VirtualClock()
    one, other = (State(name, clock=clock, estimator=kalman) for name in "ab")
    for i in range(50):
        one.push(float(i), i * MS)
        other.push(-float(i), i * MS)
    clock.advance_to(50 * MS)
    assert one[0] == pytest.approx(50.0, abs=0.5)
    assert other[0] == pytest.approx(-50.0, abs=0.5)


def test_without_an_estimator_there_is_no_future() -> None:
    """The error says that an estimator is missing."""
    with pytest.raises(StateError, match="estimator"):
        fed(made(), lambda t: t, [0, S]).at(2 * S)
