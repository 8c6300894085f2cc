"""`aces teleop`: a follower goes where a leader is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from aces_bus import load_robot
from aces_bus.controller.log import read_log
from aces_bus.errors import CallerError
from aces_bus.robot import run_virtual
from aces_lab.teleop.arms import Follow, joined
from tests.tools.conftest import Aces
from tests.tools.conftest import aces as aces

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


def test_two_arms_of_one_file() -> None:
    """Only what is active of each, by the names that it has; joints are paired by name."""
    arms = load_robot("so101")
    robot, pairs = joined(arms.part("leader"), arms.part("follower"))
    assert pairs == {name: f"leader_{name}" for name in JOINTS}
    assert list(robot.buses) == ["follower", "leader"]
    assert set(robot.devices) == set(arms.devices)


def test_the_same_arm_twice() -> None:
    """What is the leader's has other names: buses, devices, joints."""
    arm = load_robot("so101").part("follower")
    robot, pairs = joined(arm, arm)
    assert pairs == {name: f"leader_{name}" for name in JOINTS}
    assert list(robot.buses) == ["follower", "leader_follower"]
    assert robot.joints["leader_gripper"].device == "leader_F6"
    assert robot.devices["leader_F6"].bus == "leader_follower"


def test_arms_without_a_joint_in_common() -> None:
    """Both sides' joints are named."""
    with pytest.raises(CallerError, match=r"no joint of .* has a partner"):
        joined(load_robot("minihubo_1"), load_robot("so101").part("follower"))


def test_a_joint_whose_leader_is_unknown_is_not_given() -> None:
    """And where none is known, nothing is given: the run's dead-man stops the follower."""
    follow = Follow({"a": "leader_a", "b": "leader_b"}, 100)
    values: dict[str, Any] = {"a": {0: 0.0}, "b": {0: 0.0}, "leader_a": {0: 0.5}, "leader_b": {}}
    follow.bind(values)
    assert follow.step(0) == {"a": 0.5}
    del values["leader_a"][0]
    assert follow.step(1) == {}
    assert not follow.is_idle


def test_the_follower_goes_to_the_leader(aces: Aces, tmp_path: Path) -> None:
    """In virtual time; both arms and the set-points are in the log."""
    log = tmp_path / "session.csv"
    words = (
        "teleop",
        "so101:leader",
        "so101:follower",
        "--virtual",
        "--for",
        "1.5s",
        "-q",
        "--log",
        str(log),
    )
    made = aces(*words, "--pose", "leader_gripper=0.5", "--pose", "leader_elbow_flex=-0.4")
    assert made.status == 0, made.err
    found = read_log(log)
    assert found["gripper"][-1] == pytest.approx(0.5, abs=0.01)
    assert found["elbow_flex"][-1] == pytest.approx(-0.4, abs=0.01)
    assert found["gripper.setpoint"][-1] == pytest.approx(found["leader_gripper"][-1], abs=1e-6)


def test_a_leader_that_falls_silent_stops_the_follower() -> None:
    """What nobody leads does not move on: the run's dead-man stops it."""
    arms = load_robot("so101")
    robot, pairs = joined(arms.part("leader"), arms.part("follower"))
    run = run_virtual(robot, [Follow(pairs, 100)])
    run.open()
    run.do("enable", devices=pairs)
    run.start()
    run.clock.wait(lambda: False, 200_000_000)
    assert not run.stopped
    for number in range(1, 7):
        run.world.twins[f"L{number}"].fault("silent")
    run.clock.wait(lambda: bool(run.stopped), 3_000_000_000)
    assert "teleop" in run.stopped
    assert "L1" in run.stop().not_stopped


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("so101:tail", "so101:follower"), "tail"),
        (("so101:leader",), "FOLLOWER"),
        (("minihubo_1", "so101:follower"), "has a partner"),
        (("so101:leader", "so101:follower", "--virtual", "--bus", "leader=/dev/x"), "--virtual has no buses"),
    ],
)
def test_wrong_calls(aces: Aces, words: tuple[str, ...], said: str) -> None:
    """Found before a bus is opened."""
    made = aces("teleop", *words)
    assert made.status == 2
    assert said in made.err
