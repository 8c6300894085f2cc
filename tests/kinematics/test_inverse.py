"""Inverse kinematics: it converges where a goal is in reach, keeps limits, and says so when it does not."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.kinematics.body import Body, Chain, Move, Revolute
from aces_lab.cartesian import Goal, solve
from aces_lab.cartesian.inverse import level_error, rotation_error

PLANAR = (Revolute("z", "S"), Move(0.3), Revolute("z", "E"), Move(0.2))
ARM = Body("arm", [Chain("hand", PLANAR)])
BENT = Body("arm", [Chain("hand", PLANAR)], limits={"E": (0.0, 2.5)}, posture={"E": 1.0})
#: Six joints: any pose within reach.
SIX = Body(
    "six",
    [
        Chain(
            "tool",
            (
                *(
                    Revolute("z", "a"),
                    Move(0, 0, 0.3),
                    Revolute("y", "b"),
                    Move(0, 0, 0.4),
                    Revolute("y", "c"),
                    Move(0, 0, 0.3),
                ),
                *(Revolute("z", "d"), Revolute("y", "e"), Revolute("z", "f"), Move(0, 0, 0.1)),
            ),
        )
    ],
    posture={"b": 0.5, "c": 0.8, "e": 0.6},
)
small = st.lists(st.floats(-0.3, 0.3), min_size=6, max_size=6)


def distance(body: Body, angles: dict[str, float], tip: str, goal: Sequence[float]) -> float:
    return float(np.linalg.norm(body.forward(angles)[tip].position - np.array(goal)))


@given(st.floats(0.15, 0.45), st.floats(-3, 3))
def test_a_point_in_reach_is_reached(radius: float, angle: float) -> None:
    """From a bent start, anywhere in the ring that two links reach."""
    goal = [radius * math.cos(angle), radius * math.sin(angle), 0.0]
    found = solve(ARM, [Goal("hand", goal)], [0.0, 1.0])
    assert found.converged, found
    assert distance(ARM, found.angles, "hand", goal) < 1e-7


@given(small)
def test_a_pose_near_by_is_reached(away: list[float]) -> None:
    """Position and rotation together, from angles up to 0.3 rad off."""
    target = np.array([0.3, 0.5, 0.8, 0.2, 0.6, -0.4])
    pose = SIX.forward(target)["tool"]
    found = solve(SIX, [Goal("tool", pose.position, pose.rotation)], target + np.array(away))
    assert found.converged, found
    again = SIX.forward(found.angles)["tool"]
    assert np.allclose(again.position, pose.position, atol=2e-7)
    assert np.allclose(again.rotation, pose.rotation, atol=2e-6)


def test_a_straight_start_bends_towards_the_posture() -> None:
    """A goal straight inwards is not a direction of a straight arm: it bends the way that it is meant to."""
    for body in (BENT, Body("arm", [Chain("hand", PLANAR)], posture={"E": -1.0})):
        found = solve(body, [Goal("hand", [0.35, 0.0, 0.0])], [0.0, 0.0])
        assert found.converged
        assert found.nudges >= 1
        assert body.posture is not None
        assert found.angles["E"] * body.posture[1] > 0


def test_a_straight_start_without_posture_is_left_too() -> None:
    """Which way does not matter, but it gets there, and the same way each time."""
    first, second = (solve(ARM, [Goal("hand", [0.35, 0.0, 0.0])], [0.0, 0.0]) for _ in range(2))
    assert first.converged
    assert first.vector.tolist() == second.vector.tolist()


def test_limits_hold_and_are_named() -> None:
    """A goal that needs the elbow the other way is answered with the nearest within limits."""
    body = Body("arm", [Chain("hand", PLANAR)], limits={"S": (-0.1, 0.1), "E": (0.0, 1.0)})
    found = solve(body, [Goal("hand", [0.0, 0.5, 0.0])], [0.0, 0.5])
    assert not found.converged
    assert found.at_limit == ("S", "E")
    assert found.angles == {"S": 0.1, "E": 1.0}
    assert "limits" in found.reason
    assert math.isclose(found.position_error, distance(body, found.angles, "hand", [0.0, 0.5, 0.0]))


def test_out_of_reach_is_answered_with_the_nearest() -> None:
    """Two links of 0.5 m together reach 0.5 m of the metre, and the error says 0.5 m."""
    found = solve(ARM, [Goal("hand", [1.0, 0.0, 0.0])], [0.4, 0.5])
    assert not found.converged
    assert math.isclose(found.position_error, 0.5, abs_tol=1e-4)
    assert found.steps <= 200


def test_locked_joints_stay() -> None:
    """A locked joint keeps its angle to the last bit."""
    found = solve(SIX, [Goal("tool", [0.2, 0.05, 0.8])], [0.1, 0.5, 0.8, 0.0, 0.6, 0.0], locked=["a", "e"])
    assert found.converged
    assert (found.angles["a"], found.angles["e"]) == (0.1, 0.6)


def test_a_level_tip_keeps_its_heading_free() -> None:
    """`level` turns the tip's z up and leaves the rest alone."""
    found = solve(
        SIX, [Goal("tool", [0.3, 0.1, 0.5], level=True)], [0.1, 0.5, 1.8, 0.0, 0.6, 0.3], most_steps=400
    )
    assert found.converged, found
    assert np.allclose(SIX.forward(found.angles)["tool"].rotation[:, 2], [0, 0, 1], atol=1e-5)


@given(st.floats(0.0, math.pi - 1e-3), st.integers(0, 2))
def test_the_rotation_error_is_axis_times_angle(angle: float, axis: int) -> None:
    """About each axis, up to nearly half a turn; at half a turn its length is still right."""
    body = Body("one", [Chain("tip", (Revolute("xyz"[axis], "q"),))])  # type: ignore[arg-type]
    error = rotation_error(body.forward([angle])["tip"].rotation, np.eye(3))
    assert np.allclose(error, angle * np.eye(3)[axis], atol=1e-6)
    half = rotation_error(body.forward([math.pi])["tip"].rotation, np.eye(3))
    assert math.isclose(float(np.linalg.norm(half)), math.pi, abs_tol=1e-6)


def test_upside_down_is_half_a_turn_from_level() -> None:
    """The level error has a direction even there."""
    assert np.allclose(level_error(np.diag([1.0, -1.0, -1.0])), [math.pi, 0.0])
    assert np.allclose(level_error(np.eye(3)), [0.0, 0.0])


def test_a_wrong_call_says_what_is_wrong() -> None:
    """No goal, an empty one, one that is not a position or no rotation, unknown names, an endless start."""
    start = [0.0, 0.5]
    for goals, message in (
        ([], "no goal"),
        ([Goal("hand")], "asks for nothing"),
        ([Goal("hand", [0.0, math.nan, 0.0])], "three finite numbers"),
        ([Goal("hand", [0.0, 0.0])], "three finite numbers"),
        ([Goal("hand", rotation=np.ones((3, 3)))], "rotation matrix"),
    ):
        with pytest.raises(CallerError, match=message):
            solve(ARM, goals, start)
    goal = [Goal("hand", [0.3, 0.1, 0.0])]
    with pytest.raises(UnknownNameError, match="there are: hand"):
        solve(ARM, [Goal("foot", [0, 0, 0])], start)
    with pytest.raises(UnknownNameError, match="there are: E, S"):
        solve(ARM, goal, start, locked=["Q"])
    with pytest.raises(CallerError, match="finite"):
        solve(ARM, goal, [math.inf, 0.0])
