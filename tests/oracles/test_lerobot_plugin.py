"""LeRobot itself with our robots: its factories make them, `lerobot-record` records a twin, its reader opens our logs.

`make test-lerobot` installs it, with PyTorch, into an environment of its own; nothing else here needs them.
"""

from __future__ import annotations

import importlib
import math
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from aces_bus.errors import CallerError, DeviceError
from tests.tools.conftest import Aces
from tests.tools.conftest import aces as aces

try:
    plugins: Any = importlib.import_module("lerobot.utils.import_utils")
    plugin: Any = importlib.import_module("lerobot_robot_aces")
except ImportError:
    pytest.skip("needs lerobot and lerobot_robot_aces: make test-lerobot", allow_module_level=True)

FOLLOWER: dict[str, Any] = {"robot": "so101", "part": "follower", "virtual": True}
LEADER: dict[str, Any] = {"robot": "so101", "part": "leader", "virtual": True}
#: A limit that a machine twenty times slower keeps, too (s).
PATIENCE_S = 30.0
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@pytest.fixture(autouse=True)
def _no_network(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """LeRobot's folders are the test's, and it asks nobody."""
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hf"))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")


def follower(**said: Any) -> Any:
    """A robot by LeRobot's own factory."""
    plugins.register_third_party_plugins()
    made = importlib.import_module("lerobot.robots.utils").make_robot_from_config
    return made(plugin.AcesRobotConfig(**{**FOLLOWER, **said}))


def leader(**said: Any) -> Any:
    """A teleoperator by LeRobot's own factory."""
    made = importlib.import_module("lerobot.teleoperators.utils").make_teleoperator_from_config
    return made(plugin.AcesLeaderConfig(**{**LEADER, **said}))


def test_a_leader_and_a_follower_by_lerobots_factories() -> None:
    """The follower's joints go where the leader's are; both know the same joints."""
    arm, hand = follower(), leader(pose={"leader_gripper": 0.5})
    assert set(arm.action_features) == set(hand.action_features) == {f"{name}.pos" for name in JOINTS}
    with arm, hand:
        found: dict[str, float] = {}
        end = time.monotonic() + 30.0
        while time.monotonic() < end and found.get("gripper.pos") != pytest.approx(0.5, abs=0.01):
            arm.send_action(hand.get_action())
            found = arm.get_observation()
        assert found["gripper.pos"] == pytest.approx(0.5, abs=0.01)
        assert arm.send_action({"gripper.pos": 9.0})["gripper.pos"] == pytest.approx(1.7453)
        with pytest.raises(CallerError, match="not a finite number"):
            arm.send_action({"gripper.pos": math.nan})
    assert not arm.is_connected


def test_nothing_moves_without_the_word() -> None:
    """On buses `tx` is needed; who is not connected says so."""
    with pytest.raises(CallerError, match=r"--robot\.tx=true"):
        follower(virtual=False).connect()
    with pytest.raises(CallerError, match="connect"):
        follower().get_observation()


def test_a_joint_that_is_not_known_is_an_error() -> None:
    """A recording never has what was not measured."""
    arm = follower()
    arm.connect()
    arm.arm.run.world.twins["F1"].fault("silent")

    def look_on() -> None:
        end = time.monotonic() + PATIENCE_S  # the twins' time follows real time
        while time.monotonic() < end:
            arm.get_observation()

    with pytest.raises(DeviceError, match=r"shoulder_pan|stopped"):
        look_on()
    with pytest.raises(DeviceError, match="NOT switched off"):
        arm.disconnect()


def test_lerobot_record_unchanged(tmp_path: Path) -> None:
    """LeRobot's own program records a leader and a follower, and its reader opens what it wrote."""
    root = tmp_path / "recorded"
    process = subprocess.run(
        [
            *(sys.executable, "-m", "lerobot.scripts.lerobot_record"),
            *("--robot.type=aces", "--robot.robot=so101", "--robot.part=follower", "--robot.virtual=true"),
            *(
                "--teleop.type=aces_leader",
                "--teleop.robot=so101",
                "--teleop.part=leader",
                "--teleop.virtual=true",
            ),
            *("--teleop.pose={leader_gripper: 0.5}", "--dataset.repo_id=aces/test", f"--dataset.root={root}"),
            *("--dataset.num_episodes=1", "--dataset.episode_time_s=4", "--dataset.reset_time_s=0"),
            *("--dataset.push_to_hub=false", "--dataset.video=false", "--dataset.single_task=follow"),
            *("--play_sounds=false", "--display_data=false"),
        ],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert process.returncode == 0, process.stderr[-3000:]
    dataset = importlib.import_module("lerobot.datasets.lerobot_dataset").LeRobotDataset(
        "aces/test", root=root
    )
    assert dataset.num_episodes == 1
    assert dataset.num_frames > 3
    last = dataset[dataset.num_frames - 1]
    names = dataset.features["action"]["names"]
    assert float(last["action"][names.index("gripper.pos")]) == pytest.approx(0.5, abs=0.01)
    assert float(last["observation.state"][names.index("gripper.pos")]) == pytest.approx(0.5, abs=0.05)


def test_logs_become_a_dataset(aces: Aces, tmp_path: Path) -> None:
    """Each log is an episode; what has no set-point yet is left out and counted."""
    logs = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for log in logs:
        made = aces(
            *(
                "teleop",
                "so101:leader",
                "so101:follower",
                "--virtual",
                "--for",
                "2s",
                "-q",
                "--log",
                str(log),
            ),
            *("--pose", "leader_gripper=0.5"),
        )
        assert made.status == 0, made.err
    convert: Any = importlib.import_module("lerobot_robot_aces.convert")
    root = tmp_path / "dataset"
    frames, left_out = convert.convert(
        [str(log) for log in logs], str(root), "aces/logs", fps=30, task="follow", robot="so101"
    )
    assert frames + left_out == 2 * 61
    assert left_out <= 4
    dataset = importlib.import_module("lerobot.datasets.lerobot_dataset").LeRobotDataset(
        "aces/logs", root=root
    )
    assert (dataset.num_episodes, dataset.num_frames) == (2, frames)
    last = dataset[frames - 1]
    assert dataset.features["action"]["names"] == [f"{name}.pos" for name in JOINTS]
    assert float(last["action"][5]) == pytest.approx(0.5, abs=1e-3)
    assert last["task"] == "follow"
