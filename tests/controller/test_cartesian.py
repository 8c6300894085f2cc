"""Cartesian path → inverse kinematics → joints → set-points."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.controller import ControlEvent, Limits, Player, Trajectory, ViaPath
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.kinematics.body import roll_pitch_yaw, rotation_of
from aces_devices.kinematics.minihubo import JOINTS, MINIHUBO, POSTURE
from aces_lab.cartesian import CartesianPath
from tests.controller.fakes import Fake

MS = 1_000_000
START = {**dict.fromkeys(JOINTS, 0.0), **POSTURE}
#: Both feet up by 20 mm: a crouch.
CROUCH = ViaPath(["LF.z", "RF.z"], [[0, 0], [0.02, 0.02], [0, 0]], Limits(0.05, 0.2), shape="quintic")


def at(angles: dict[str, float], tip: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return MINIHUBO.forward(angles)[tip].position


def bound(path: CartesianPath) -> dict[str, Fake]:
    states = {joint: Fake(START[joint]) for joint in path.states}
    path.bind(states)
    path.start(0)
    return states


def test_a_crouch_keeps_the_feet_where_they_belong() -> None:
    """At every cycle: soles as they were at the start, x and y too, z along the path; joints without jumps."""
    path = CartesianPath("crouch", MINIHUBO, CROUCH, rate_hz=50, relative=True)
    bound(path)
    start = MINIHUBO.forward(START)
    angles, last = dict(START), None
    steps = round(CROUCH.duration_s * 50)
    for n in range(steps + 2):
        setpoints = path.step(n * 20 * MS)
        angles.update(setpoints)
        poses = MINIHUBO.forward(angles)
        height = CROUCH.at(n / 50)[0]
        for tip in ("LF", "RF"):
            assert np.allclose(poses[tip].position, start[tip].position + np.array([0, 0, height]), atol=1e-4)
            assert np.allclose(poses[tip].rotation, start[tip].rotation, atol=1e-3)
        if last is not None:
            assert max(abs(setpoints[joint] - last[joint]) for joint in setpoints) < 0.05
        last = setpoints
    assert path.mode == "ended"
    assert set(path.writes) == {
        joint for joint in JOINTS if joint[1:] in ("HY", "HR", "HP", "KP", "AP", "AR")
    } | {"HY"}


def test_the_whole_path_as_joint_angles_for_a_player() -> None:
    """`to_trajectory` gives what the controller would; a player plays it, with its approach."""
    path = CartesianPath("crouch", MINIHUBO, CROUCH, rate_hz=50, relative=True)
    table = path.to_trajectory(START)
    bound(path)
    assert table.rows[30].tolist() == list([path.step(n * 20 * MS) for n in range(31)][-1].values())
    assert table.duration_s == pytest.approx(CROUCH.duration_s, abs=0.02)
    assert Player("p", table, rate_hz=200).writes == path.writes


def test_tips_that_are_held_stay_while_others_move() -> None:
    """A hand goes round a circle, locked joints and the feet do not move."""
    angles = np.linspace(0, 2 * math.pi, 51)
    centre = at(START, "LW")
    circle = Trajectory(
        ["LW.y", "LW.z"],
        np.stack([centre[1] + 0.015 * np.sin(angles), centre[2] + 0.02 - 0.02 * np.cos(angles)], axis=1),
        rate_hz=50,
        interpolation="cubic",
    )
    path = CartesianPath(
        "circle",
        MINIHUBO,
        circle,
        rate_hz=50,
        hold=["LF"],
        orientation={"LW": "free", "LF": "level"},
        locked=["HY"],
    )
    assert "HY" not in path.writes
    table = path.to_trajectory(START)
    for n, row in enumerate(table.rows.tolist()):
        now = {**START, **dict(zip(table.names, row, strict=True))}
        assert np.allclose(at(now, "LF"), at(START, "LF"), atol=1e-4)
        assert np.allclose(at(now, "LW"), (centre[0], *circle.rows[n]), atol=1e-4)


def test_what_is_out_of_reach_fails_and_the_last_set_points_stay() -> None:
    """The first instant beyond the tolerance stops it; what was given last is given again, and the reason is told."""
    heard: list[ControlEvent] = []
    down = Trajectory(["LF.z"], [[0.0], [-0.1]], rate_hz=1)
    path = CartesianPath("down", MINIHUBO, down, rate_hz=50, relative=True, largest_step=9)
    path.listeners.add(heard.append)
    bound(path)
    given = [path.step(n * 20 * MS) for n in range(50)]
    assert path.mode == "failed"
    assert given[-1] == given[-2] != given[0]
    assert "mm" in path.reason
    assert [event.kind for event in heard] == ["failed"]
    with pytest.raises(CallerError, match=r"'down' fails at 0.*mm"):
        path.to_trajectory(START)


def test_a_joint_that_would_jump_is_a_failure() -> None:
    """A path through a straight leg asks for more than `largest_step` in a cycle: it stops before, and names the joint."""
    up = Trajectory(["LF.z"], [[0.0], [-0.1]], rate_hz=1)
    path = CartesianPath("up", MINIHUBO, up, rate_hz=50, relative=True)
    bound(path)
    given = [path.step(n * 20 * MS) for n in range(50)]
    assert path.reason.startswith("0.060 s: LKP would jump by 0.2")
    assert given[3] == given[-1] == given[2]


def test_a_path_that_begins_elsewhere_gives_no_jump() -> None:
    """Without an approach, an absolute path far from the tip is refused at its first cycle, with what to do."""
    motion = Trajectory(["LF.x"], [[0.06]], rate_hz=1)
    path = CartesianPath("far", MINIHUBO, motion, rate_hz=50, approach=None)
    bound(path)
    assert path.step(0) == {}
    assert path.mode == "failed"
    assert "approach='first'" in path.reason


@pytest.mark.slow
def test_the_joints_go_gently_to_where_a_path_begins() -> None:
    """No joint is faster than `gentle` says, the way ends at the path's first point, and nothing of it is left out."""
    foot = at(START, "LF")
    motion = Trajectory(["LF.x", "LF.z"], [[0.06, foot[2] + 0.02], [0.02, foot[2] + 0.02]], rate_hz=1)
    path = CartesianPath("far", MINIHUBO, motion, rate_hz=50, gentle=Limits(0.4, 2.0))
    bound(path)
    angles, modes, places = dict(START), list[str](), list[float]()
    for n in range(300):
        given = path.step(n * 20 * MS)
        assert max(abs(given[joint] - angles[joint]) for joint in given) <= 0.4 * 0.02 + 0.04 * (
            path.mode != "approaching"
        )
        angles.update(given)
        modes.append(path.mode)
        places.append(float(at(angles, "LF")[0]))
    assert list(dict.fromkeys(modes)) == ["approaching", "running", "ended"]
    first = modes.index("running")
    assert places[first] == pytest.approx(0.06, abs=1e-3)
    assert places[-1] == pytest.approx(0.02, abs=2e-4)
    assert modes.count("running") == pytest.approx(50, abs=1)
    assert path.to_trajectory(START).rows.shape[0] == 51


def test_a_path_that_begins_out_of_reach_does_not_set_out() -> None:
    """It fails where it stands."""
    path = CartesianPath("far", MINIHUBO, Trajectory(["LF.x"], [[0.9]], rate_hz=1), rate_hz=50)
    bound(path)
    assert path.step(0) == {}
    assert path.mode == "failed"
    assert "mm" in path.reason


@pytest.mark.parametrize("relative", [True, False])
def test_a_tip_turns_along_a_path_of_its_orientation(relative: bool) -> None:
    """A foot turns and pitches in place, as the motion says, while the other stands; what is not named stays."""
    turn = Trajectory(["RF.yaw", "RF.pitch"], [[0.0, 0.0], [0.15, -0.2], [0.0, 0.0]], rate_hz=2)
    path = CartesianPath("turn", MINIHUBO, turn, rate_hz=50, hold=["LF"], relative=relative)
    table = path.to_trajectory(START)
    start = MINIHUBO.forward(START)
    for n, row in enumerate(table.rows.tolist()):
        poses = MINIHUBO.forward({**START, **dict(zip(table.names, row, strict=True))})
        yaw, pitch = turn.at(n / 50)
        assert np.allclose(poses["RF"].position, start["RF"].position, atol=1e-4)
        assert roll_pitch_yaw(poses["RF"].rotation) == pytest.approx((0.0, pitch, yaw), abs=2e-3)
        assert np.allclose(poses["LF"].rotation, start["LF"].rotation, atol=1e-3)
    with pytest.raises(CallerError, match="'RF' has a path of its orientation"):
        CartesianPath("turn", MINIHUBO, turn, rate_hz=50, orientation={"RF": "level"})


@given(*[st.floats(-3.1, 3.1)] * 3)
def test_angles_make_rotations_and_rotations_angles(roll: float, pitch: float, yaw: float) -> None:
    """`rotation_of` turns about x, then y, then z of the base; the angles of a rotation make it again, pitch ±90° too."""
    for one in (pitch, math.pi / 2, -math.pi / 2):
        rotation = rotation_of(roll, one, yaw)
        assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.allclose(rotation_of(*roll_pitch_yaw(rotation)), rotation, atol=1e-6)
    one_by_one = rotation_of(0, 0, yaw) @ rotation_of(0, pitch, 0) @ rotation_of(roll, 0, 0)
    assert np.allclose(rotation_of(roll, pitch, yaw), one_by_one)


def test_it_waits_until_all_joints_are_known() -> None:
    """One unknown joint, and nothing is given; it says which."""
    path = CartesianPath("crouch", MINIHUBO, CROUCH, rate_hz=50, relative=True)
    states = bound(path)
    states["LKP"].value = math.nan
    assert path.step(0) == {}
    assert path.waiting == "LKP"
    states["LKP"].value = 1.0
    assert path.step(1_000 * MS)["LKP"] == pytest.approx(1.0)


def test_names_are_tips_and_axes() -> None:
    """Anything else is refused, with an example or the tips that exist."""
    for names, message in ((["LF"], "such as LF.x"), (["LF.q"], "such as LF.x")):
        with pytest.raises(CallerError, match=message):
            CartesianPath("p", MINIHUBO, Trajectory(names, [[0.0]], rate_hz=1), rate_hz=50)
    with pytest.raises(UnknownNameError, match="there are: LF, LW, RF, RW"):
        CartesianPath("p", MINIHUBO, Trajectory(["XX.x"], [[0.0]], rate_hz=1), rate_hz=50)
    with pytest.raises(CallerError, match=r"neither a path nor hold"):
        CartesianPath("p", MINIHUBO, CROUCH, rate_hz=50, orientation={"LW": "free"})
