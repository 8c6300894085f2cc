"""PID: the law, its limits, and the controller around it."""

from __future__ import annotations

import math
from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.controller import PID, PIDController
from aces_bus.errors import CallerError
from tests.controller.fakes import fakes

gains = st.floats(0.0, 10.0)
MS = 1_000_000


def plant(pid: PID, seconds: float, y: float = 0.0, dt: float = 0.01) -> list[float]:
    """A first-order plant, time constant 0.5 s, regulated."""
    out: list[float] = []
    for _ in range(round(seconds / dt)):
        y += (pid.update(y, dt) - y) * dt / 0.5
        out.append(y)
    return out


def test_it_reaches_its_set_point_without_a_lasting_error() -> None:
    """The integral takes the rest away."""
    assert plant(PID(2.0, 4.0, setpoint=1.0), 5.0)[-1] == pytest.approx(1.0, abs=1e-3)
    assert plant(PID(2.0, setpoint=1.0), 5.0)[-1] == pytest.approx(2 / 3, abs=1e-3)


@pytest.mark.parametrize("way", ["clamp", "back-calculation"])
def test_the_integral_does_not_wind_up(way: Literal["clamp", "back-calculation"]) -> None:
    """After five seconds against a limit the output leaves it within half a second; a plain integral needs seconds."""
    pid = PID(1.0, 2.0, limits=(-1, 1), anti_windup=way, setpoint=5.0)
    plant(pid, 5.0)
    assert pid.output == 1.0
    assert pid.saturated > 400
    pid.setpoint = 0.0
    plant(pid, 0.5, 1.0)
    assert pid.output < 0.9


@given(
    gains,
    gains,
    gains,
    st.lists(st.floats(-5, 5), min_size=1, max_size=30),
    st.sampled_from(["clamp", "back-calculation"]),
)
def test_the_output_never_leaves_its_limits(
    kp: float, ki: float, kd: float, values: list[float], way: Literal["clamp", "back-calculation"]
) -> None:
    """Whatever the gains and measurements."""
    pid = PID(kp, ki, kd, limits=(-0.5, 2.0), anti_windup=way, setpoint=1.0)
    for value in values:
        assert -0.5 <= pid.update(value, 0.01) <= 2.0


@given(gains, gains, gains, gains, gains, gains, st.floats(0, 0.1))
def test_a_change_of_gains_moves_nothing(
    kp: float, ki: float, kd: float, kp2: float, ki2: float, kd2: float, filter_s: float
) -> None:
    """The output just after the change is that just before it."""
    pid = PID(kp, ki, kd, setpoint=1.0, derivative_filter_s=filter_s)
    for n in range(10):
        pid.update(math.sin(n / 5), 0.01)
    before = pid.output
    pid.set_gains(kp2, ki2, kd2)
    assert pid.update(math.sin(9 / 5), 0.0) == pytest.approx(before, abs=1e-9)


def test_the_derivative_sees_the_measurement_only() -> None:
    """A step of the set-point does not kick; a ramp of the measurement gives −kd × slope, filtered or not."""
    pid = PID(0.0, 0.0, 2.0)
    pid.update(0.0, 0.01)
    pid.setpoint = 10.0
    assert pid.update(0.0, 0.01) == 0.0
    outputs: list[float] = []
    for filter_s in (0.0, 0.05):
        pid = PID(0.0, 0.0, 2.0, derivative_filter_s=filter_s)
        outputs = [pid.update(0.5 * n * 0.01, 0.01) for n in range(101)]
        assert outputs[-1] == pytest.approx(-1.0)
    assert -0.5 < outputs[2] < -0.1


def test_the_weight_of_the_set_point() -> None:
    """With weight 0 the proportional part acts on the measurement alone; the integral still leads to the set-point."""
    pid = PID(2.0, 4.0, setpoint=1.0, setpoint_weight=0.0)
    assert pid.update(0.0, 0.01) == pytest.approx(0.04)
    assert plant(pid, 8.0)[-1] == pytest.approx(1.0, abs=1e-3)


def test_it_takes_over_without_a_jump() -> None:
    """After `track` the next output is the tracked one."""
    pid = PID(2.0, 1.0, 0.5, setpoint=1.0)
    pid.track(0.3, 0.77)
    assert pid.update(0.3, 1e-9) == pytest.approx(0.77)


def test_what_is_not_finite_is_not_taken_in() -> None:
    """NaN and infinity leave the output as it was, and are counted."""
    pid = PID(1.0, 1.0, 1.0, setpoint=1.0)
    first = pid.update(0.0, 0.01)
    assert [pid.update(math.nan, 0.01), pid.update(math.inf, 0.01)] == [first, first]
    assert pid.not_finite == 2
    assert math.isfinite(pid.update(0.0, 0.01))


def test_time_that_stands_still_or_runs_back_is_harmless() -> None:
    """dt ≤ 0 gives the proportional part anew, and divides by nothing."""
    pid = PID(1.0, 1.0, 1.0, setpoint=1.0)
    pid.update(0.0, 0.01)
    assert pid.update(0.5, 0.0) == pytest.approx(0.51)
    assert pid.update(0.5, -1.0) == pytest.approx(0.51)


@pytest.mark.parametrize(
    "options",
    [
        {"kp": math.nan},
        {"kp": 1.0, "limits": (1.0, 1.0)},
        {"kp": 1.0, "derivative_filter_s": -1.0},
        {"kp": 1.0, "tracking_s": 0.0},
        {"kp": 1.0, "anti_windup": "none"},
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any]) -> None:
    """Each with what is wrong."""
    with pytest.raises(CallerError, match="PID: "):
        PID(**options)
    with pytest.raises(CallerError, match="finite"):
        PID(1.0).set_gains(ki=math.inf)


def test_the_controller_regulates_one_state_by_another() -> None:
    """Real intervals count; while the measured state is unknown it gives nothing, and begins anew after."""
    states = fakes(tilt=0.0, goal=1.0)
    law = PIDController("tilt", PID(0.0, 1.0), measured="tilt", output="motor", goal="goal", rate_hz=100)
    assert (law.states, law.writes) == (("tilt", "goal"), ("motor",))
    law.bind(states)
    law.start(0)
    assert law.step(0)["motor"] == pytest.approx(0.01)
    assert law.step(30 * MS)["motor"] == pytest.approx(0.04)
    states["goal"].value = math.nan
    assert law.step(40 * MS) == {}
    states["goal"].value, states["tilt"].value = 1.0, math.nan
    assert law.step(50 * MS) == {}
    states["tilt"].value = 0.0
    assert law.step(60 * MS)["motor"] == pytest.approx(0.01)
