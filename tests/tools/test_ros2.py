"""`--ros2` of run, sim and sniff: wrong calls, and what is in a bag."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from tests.ros2.domains import DOMAINS
from tests.tools.conftest import Aces

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'aces-bus[ros2]'")
rosbags: Any = pytest.importorskip("rosbags.highlevel", reason="needs rosbags (make test-oracles)")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--domain", "3"), "--domain is for --ros2"),
        (("--ros2-commands",), "--ros2-commands is for --ros2"),
        (("--ros2", "--ros2-commands"), "add --tx, or --virtual"),
        (("--ros2", "--domain", "102"), "give a number from 0 to 101"),
        (("--ros2", "--ros2-interface", "eth99"), "this machine has lo"),
        (("--ros2", "--ros2-peer", "10.0.0.2"), "--ros2-peer needs --ros2-interface"),
        (("--ros2", "--ros2-bag", "a.bag"), "ends in .mcap"),
        (("--ros2", "--foxglove"), "two live views at once"),
    ],
)
def test_wrong_calls(aces: Aces, words: tuple[str, ...], said: str) -> None:
    """Found before a bus is opened."""
    made = aces("run", "-r", "minihubo_1", *words)
    assert made.status == 2
    assert said in made.err


def test_sniff_and_sim_take_no_commands(aces: Aces) -> None:
    """They only publish."""
    made = aces("sim", "-r", "minihubo_1", "--ros2", "--ros2-commands")
    assert made.status == 2
    assert "for aces run" in made.err


def test_a_bag_is_one_for_rosbags(aces: Aces, tmp_path: Path) -> None:
    """Joints, sensors and diagnostics, of their types, in order."""
    path = tmp_path / "leg.mcap"
    made = aces(
        *("run", "-r", "hubo2plus", "--virtual", "--for", "0.2s", "-q"),
        *("--ros2", "--domain", str(next(DOMAINS)), "--ros2-bag", str(path)),
    )
    assert made.status == 0, made.err
    with rosbags.AnyReader([path]) as bag:
        topics = {connection.topic: connection.msgtype for connection in bag.connections}
        stamps = [stamp for _, stamp, _ in bag.messages()]
        last = {c.topic: bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages()}
    assert topics["/joint_states"] == "sensor_msgs/msg/JointState"
    assert topics["/RFFT/wrench"] == "geometry_msgs/msg/WrenchStamped"
    assert topics["/IMU0/imu"] == "sensor_msgs/msg/Imu"
    assert topics["/diagnostics"] == "diagnostic_msgs/msg/DiagnosticArray"
    assert len(stamps) > 100
    joints: Any = last["/joint_states"]
    assert joints.position[list(joints.name).index("RHP")] == pytest.approx(0.0, abs=0.01)
    imu: Any = last["/IMU0/imu"]
    assert imu.orientation.w == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_a_simulated_body_is_felt(aces: Aces, tmp_path: Path) -> None:
    """With `--physics mujoco`, the wrench of a foot and the attitude of the trunk are those of the body."""
    pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'aces-bus[physics]'")
    from tests.lab.physics.test_mujoco import SENSORS

    buses, _, rest = SENSORS.partition("[devices]")
    devices, _, sensors = rest.partition("[sensors]")
    shipped = (resources.files("aces_devices.robots") / "quadruped.toml").read_text(encoding="utf-8")
    for table, more in (("[buses]", buses.replace("[buses]", "")), ("[devices]", devices)):
        shipped = shipped.replace(table, table + more)
    path, bag_path = tmp_path / "quadruped.toml", tmp_path / "stand.mcap"
    path.write_text(f"{shipped}\n[sensors]{sensors}")
    made = aces(
        *("run", "-r", path, "--virtual", "--physics", "mujoco", "--no-enable", "--for", "0.5s", "-q"),
        *("--ros2", "--domain", str(next(DOMAINS)), "--ros2-bag", bag_path),
    )
    assert made.status == 0, made.err
    with rosbags.AnyReader([bag_path]) as bag:
        last = {c.topic: bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages()}
    forces = [last[f"/{foot}_foot/wrench"].wrench.force.z for foot in ("LF", "RF", "LH", "RH")]
    assert max(map(abs, forces)) > 1.0
    assert last["/imu/imu"].orientation.w == pytest.approx(1.0, abs=0.01)
