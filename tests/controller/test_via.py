"""Via points: through every point, all joints together, within the limits."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.controller import Limits, ViaPath
from aces_bus.errors import CallerError

coordinate = st.floats(-3, 3).map(lambda x: round(x, 3))
points = st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=2, max_size=5)
limit = st.builds(Limits, st.floats(0.1, 5), st.floats(0.1, 20), st.floats(1, 100))
NAMES = ("A", "B", "C")


def differences(path: ViaPath, n: int = 2_000) -> Any:
    """Largest velocity, acceleration and jerk (the last by differences of smooth parts only) of each joint."""
    dt = path.duration_s / n
    rows = np.array([path.at(i * dt) for i in range(n + 1)])
    velocity = np.diff(rows, axis=0) / dt
    acceleration = np.diff(velocity, axis=0) / dt
    return np.abs(velocity).max(axis=0), np.abs(acceleration).max(axis=0)


@pytest.mark.slow
@given(
    points, st.lists(limit, min_size=3, max_size=3), st.sampled_from(["trapezoidal", "quintic", "through"])
)
def test_limits_hold_everywhere(where: list[tuple[float, ...]], limits: list[Limits], shape: Any) -> None:
    """Velocity and acceleration of every joint, by differences; and every point is met at its time."""
    if shape == "trapezoidal":
        limits = [Limits(one.velocity, one.acceleration) for one in limits]
    path = ViaPath(NAMES, where, dict(zip(NAMES, limits, strict=True)), shape=shape)
    for point, time in zip(where, path.times, strict=True):
        assert np.allclose(path.at(time), point, atol=1e-9)
    velocity, acceleration = differences(path)
    for k, one in enumerate(limits):
        assert velocity[k] <= one.velocity * (1 + 1e-6) + 1e-6
        assert acceleration[k] <= one.acceleration * (1 + 1e-3) + 1e-3


@pytest.mark.parametrize(
    ("limits", "shape", "duration"),
    [
        (Limits(1.0, 2.0), "trapezoidal", 2.5),
        (Limits(10.0, 2.0), "trapezoidal", 2.0),
        (Limits(1.0), "quintic", 3.75),
        (Limits(100.0, 10 / math.sqrt(3)), "quintic", math.sqrt(2)),
        (Limits(100.0, 1e6, 15.0), "quintic", 2.0),
    ],
)
def test_no_slower_than_the_limits_ask(limits: Limits, shape: Any, duration: float) -> None:
    """The least time for two radians, from the textbook; the slowest joint sets it, all arrive together."""
    path = ViaPath(["A", "B"], [[0, 0], [2, 0.1]], limits, shape=shape)
    assert path.duration_s == pytest.approx(duration)
    half = path.at(duration / 2)
    assert half == pytest.approx([1.0, 0.05])


@pytest.mark.parametrize("shape", ["quintic", "through"])
def test_jerk_is_limited_too(shape: Any) -> None:
    """Third differences inside of the segments stay below the limit, and come near it."""
    path = ViaPath(["A", "B"], [[0, 0], [1, -1], [2, 0]], Limits(50.0, 1e3, jerk=8.0), shape=shape)
    most = 0.0
    for begin, end in itertools.pairwise(path.times):
        rows = np.array([path.at(begin + (end - begin) * (0.001 + 0.998 * n / 500)) for n in range(501)])
        most = max(most, float(np.abs(np.diff(rows, 3, axis=0)).max()) / ((end - begin) * 0.998 / 500) ** 3)
    assert 0.9 * 8.0 < most < 8.0 * 1.001


def test_through_does_not_stop_and_is_at_its_limit() -> None:
    """Points in a row are passed with velocity; one of the limits is reached, as more would be slow."""
    path = ViaPath(["A"], [[0.0], [1.0], [2.0], [3.0]], Limits(1.0, 5.0, 50.0), shape="through")
    step = 1e-4
    speed = (path.at(path.times[1] + step)[0] - path.at(path.times[1] - step)[0]) / (2 * step)
    assert speed > 0.5
    velocity, acceleration = differences(path)
    assert max(velocity[0] / 1.0, acceleration[0] / 5.0) > 0.95 or path.duration_s < 8


def test_where_the_direction_turns_through_stands_still() -> None:
    """No overshoot at a turning point."""
    path = ViaPath(["A"], [[0.0], [1.0], [0.0]], Limits(1.0, 5.0), shape="through")
    assert max(path.at(path.duration_s * n / 999)[0] for n in range(1000)) <= 1.0 + 1e-12


@pytest.mark.parametrize("shape", ["trapezoidal", "quintic", "through"])
def test_times_may_be_given(shape: Any) -> None:
    """They are kept when they are long enough; else joint and segment, and what would do."""
    path = ViaPath(["A", "B"], [[0, 0], [1, 2], [1, 0]], Limits(1.0, 2.0), shape=shape, times=[0, 8, 15])
    assert path.duration_s == 15
    velocity, acceleration = differences(path)
    assert velocity.max() <= 1.0
    assert acceleration.max() <= 2.0 * 1.001
    message = (
        "3 times|as long would do" if shape == "through" else r"segment 2 \(8 … 8\.5 s\) is too short for B"
    )
    with pytest.raises(CallerError, match=message):
        ViaPath(["A", "B"], [[0, 0], [1, 2], [1, 0]], Limits(1.0, 2.0), shape=shape, times=[0, 8, 8.5])


def test_a_pause_is_a_point_twice() -> None:
    """Nothing moves between equal points, for the time given."""
    path = ViaPath(["A"], [[0.0], [1.0], [1.0], [0.0]], Limits(1.0, 2.0), times=[0, 2, 5, 7])
    assert path.at(2.1) == path.at(4.9) == [1.0]
    assert ViaPath(["A"], [[1.0], [1.0]], Limits(1.0, 2.0)).at(0.01) == [1.0]
    assert path.at(math.nan) == [0.0]


@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        ([[0.0]], {}, "two points"),
        ([[0.0, 1.0], [1.0, 2.0]], {}, "two points"),
        ([[0.0], [math.nan]], {}, "finite"),
        ([[0.0], [1.0]], {"shape": "cubic"}, "shape is"),
        ([[0.0], [1.0]], {"limits": Limits(1.0, 1.0, 1.0)}, "unlimited jerk"),
        ([[0.0], [1.0]], {"limits": Limits(1.0)}, "needs a limit of acceleration"),
        ([[0.0], [1.0]], {"limits": {"B": Limits(1.0, 1.0)}}, "no limits for A"),
        ([[0.0], [1.0]], {"times": [0.0]}, "as many times"),
        ([[0.0], [1.0]], {"times": [1.0, 2.0]}, "the first of them 0"),
        ([[0.0], [1.0], [2.0]], {"times": [0.0, 5.0, 5.0]}, "must increase"),
    ],
)
def test_a_wrong_path_is_refused(points: Any, options: dict[str, Any], message: str) -> None:
    """Each with what is wrong."""
    merged: dict[str, Any] = {"limits": Limits(1.0, 2.0), **options}
    with pytest.raises(CallerError, match=message):
        ViaPath(["A"], points, **merged)
    with pytest.raises(CallerError, match="above 0"):
        Limits(0.0)
