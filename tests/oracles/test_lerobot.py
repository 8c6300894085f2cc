"""LeRobot's bus classes, unmodified: Feetech servos with the twins of an SO-101, Dynamixel, Damiao and RobStride motors.

`make test-lerobot` installs it, with PyTorch, into an environment of its own; nothing else here needs them.
"""

from __future__ import annotations

import importlib
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Unknown
from aces_devices.feetech import driver
from tests.oracles.serial_lines import served_line

try:
    feetech: Any = importlib.import_module("lerobot.motors.feetech")
    motors: Any = importlib.import_module("lerobot.motors")
except ImportError:
    pytest.skip("needs lerobot, and PyTorch with it: make test-lerobot", allow_module_level=True)

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
ARM = """
name = "arm"
rate_hz = 100
[buses]
line = { link = "serial", protocol = "feetech", baud = 1_000_000 }
[devices]
""" + "\n".join(
    f'M{n} = {{ driver = "feetech", bus = "line", model = "STS3215", credentials = {{ id = {n} }} }}'
    for n in range(1, 7)
)
#: How often it asks again: its patience is some 50 ms, and a busy machine may take longer.
RETRIES = 50
#: What it is told that a byte takes (ms): its patience is the time of the bytes and 50 ms.
SLOW_BYTE_MS = 100.0


def patiently(step: Callable[[], Any]) -> Any:
    """Do again what LeRobot itself does not ask again when an answer comes too late; return its result."""
    for _ in range(RETRIES):
        try:
            return step()
        except ConnectionError:
            pass
    return step()


def connect(bus: Any) -> None:
    """Connect with the handshake, which asks each servo once; from then on it waits for answers as on a slow line."""

    def step() -> None:
        try:
            bus.connect(handshake=True)
        except (
            ConnectionError,
            RuntimeError,
            IndexError,
        ) as error:  # its kit takes a late answer for another
            bus.port_handler.closePort()
            raise ConnectionError(str(error)) from error

    patiently(step)
    bus.port_handler.tx_time_per_byte = SLOW_BYTE_MS


def turn_by_hand(line: Any, count: int) -> None:
    """Turn all servos of an arm to where their registers say `count`."""
    with line.lock:
        for twin in line.twins.values():
            twin.turn_by_hand(twin.motion.scale.angle(count))


def test_the_bus_class_sets_up_calibrates_and_moves_an_arm() -> None:
    """Connect with its handshake, configure, calibrate, torque, goals and positions: as LeRobot does with an SO-101."""
    with served_line(ARM, driver) as line:
        arm = {
            name: motors.Motor(n, "sts3215", motors.MotorNormMode.RANGE_M100_100)
            for n, name in enumerate(JOINTS, 1)
        }
        bus = feetech.FeetechMotorsBus(line.path, arm)
        connect(bus)
        bus.disable_torque(num_retry=RETRIES)
        patiently(bus.configure_motors)
        for name in JOINTS:
            bus.write("Operating_Mode", name, 0, num_retry=RETRIES)
            bus.write("P_Coefficient", name, 16, num_retry=RETRIES)
        with line.lock:
            twins: list[Any] = [line.twins[f"M{n}"] for n in range(1, 7)]
            assert [twin["p_gain"] for twin in twins] == [16] * 6
            assert [twin["return_delay"] for twin in twins] == [0] * 6
        calibration = {
            name: motors.MotorCalibration(n, 0, 100 * n, 1000, 3000) for n, name in enumerate(JOINTS, 1)
        }
        bus.write_calibration(calibration)
        assert bus.is_calibrated
        with line.lock:
            assert [twin["homing_offset"] for twin in twins] == [100, 200, 300, 400, 500, 600]
        bus.enable_torque(num_retry=RETRIES)
        goals = dict(zip(JOINTS, (1500, 1600, 1700, 1800, 1900, 2000), strict=True))
        bus.sync_write("Goal_Position", goals, normalize=False)
        found: dict[str, float] = {}
        for _ in range(1000):
            found = bus.sync_read("Present_Position", normalize=False, num_retry=RETRIES)
            if found == pytest.approx(goals, abs=2):  # friction holds it a step or two before its goal
                break
        assert found == pytest.approx(goals, abs=2)
        shares = bus.sync_read("Present_Position", num_retry=RETRIES)
        assert shares["shoulder_pan"] == pytest.approx(-50, abs=0.3)
        bus.disconnect(disable_torque=True)
        assert not any(twin["torque_enable"] for twin in twins)
        assert not [one for one in line.records() if isinstance(one, Unknown)]


def test_feetech_with_the_fixture(aces_twin: Any) -> None:
    """Ping, read, write, sync_read, sync_write."""
    arm = aces_twin("feetech", ids=[1, 2], model="STS3215")
    joints = {f"j{n}": motors.Motor(n, "sts3215", motors.MotorNormMode.DEGREES) for n in (1, 2)}
    bus = feetech.FeetechMotorsBus(arm.port, joints)
    bus.connect(handshake=False)
    bus.port_handler.tx_time_per_byte = SLOW_BYTE_MS
    assert bus.ping("j1", num_retry=RETRIES) == 777
    bus.write("P_Coefficient", "j2", 16, num_retry=RETRIES)
    assert arm["FEETECH2"]["p_gain"] == 16
    bus.sync_write("Goal_Position", {"j1": 1500, "j2": 1600}, normalize=False)
    arm.expect("SyncWrite")
    found = bus.sync_read("Goal_Position", normalize=False, num_retry=RETRIES)
    assert found == {"j1": 1500, "j2": 1600}
    bus.disconnect(disable_torque=False)


def test_dynamixel_with_the_fixture(aces_twin: Any) -> None:
    """Ping, read, write, sync_read, sync_write."""
    dynamixel: Any = importlib.import_module("lerobot.motors.dynamixel")
    arm = aces_twin("dynamixel", ids=[1, 2], model="XL330-M288")
    joints = {f"j{n}": motors.Motor(n, "xl330-m288", motors.MotorNormMode.DEGREES) for n in (1, 2)}
    bus = dynamixel.DynamixelMotorsBus(arm.port, joints)
    bus.connect(handshake=False)
    assert bus.ping("j1", num_retry=RETRIES) == 1200
    bus.write("Position_P_Gain", "j2", 300, num_retry=RETRIES)
    assert bus.read("Position_P_Gain", "j2", num_retry=RETRIES) == 300
    bus.sync_write("Goal_Position", {"j1": 1500, "j2": 1600}, normalize=False)
    arm.expect("SyncWrite")
    found = bus.sync_read("Goal_Position", normalize=False, num_retry=RETRIES)
    assert found == {"j1": 1500, "j2": 1600}
    bus.disconnect(disable_torque=False)


def test_damiao_with_the_fixture(aces_twin: Any) -> None:
    """What LeRobot's own test of it asks, which is skipped without hardware: connect, ping, read, write, sync.

    In virtual time: its class waits for an answer for 1 ms, which a busy machine may take.
    """
    damiao: Any = importlib.import_module("lerobot.motors.damiao")
    arm = aces_twin(
        "damiao", motors=[1, 2], model="4310", dialect="4310", settings={"master": 0x11}, time="virtual"
    )
    arm["DAMIAO2"].registers[7] = 0x12
    joints = {
        f"joint_{n}": motors.Motor(
            n, "damiao", motors.MotorNormMode.DEGREES, motor_type_str="dm4310", recv_id=0x10 + n
        )
        for n in (1, 2)
    }
    bus = damiao.DamiaoMotorsBus(arm.channel, joints, can_interface="aces", use_can_fd=False)
    bus.connect(handshake=True)
    bus.enable_torque()
    bus.sync_write("Kp", {"joint_1": 40.0, "joint_2": 40.0})
    for _ in range(100):
        bus.sync_write("Goal_Position", {"joint_1": 10.0, "joint_2": -20.0})
        arm.wait(0.02)
    found = bus.sync_read("Present_Position")
    assert found == {"joint_1": pytest.approx(10.0, abs=3.0), "joint_2": pytest.approx(-20.0, abs=3.0)}
    position = patiently(lambda: bus.read("Present_Position", "joint_1"))
    assert position == pytest.approx(math.degrees(arm["DAMIAO1"].angle), abs=0.1)
    bus.disconnect(disable_torque=True)
    assert arm["DAMIAO1"].status == "disabled"


def test_robstride_with_the_fixture(aces_twin: Any) -> None:
    """Connect with its handshake, its mode, torque, goals and positions."""
    robstride: Any = importlib.import_module("lerobot.motors.robstride")
    arm = aces_twin("robstride_mit", motors=[1, 2], model="RS00", time="virtual")
    joints = {
        f"joint_{n}": motors.Motor(
            n, "robstride", motors.MotorNormMode.DEGREES, motor_type_str="O0", recv_id=n
        )
        for n in (1, 2)
    }
    bus = robstride.RobstrideMotorsBus(arm.channel, joints, can_interface="aces", use_can_fd=False)

    def connected() -> None:
        try:
            bus.connect(handshake=True)
        except ConnectionError:  # it waits for 1 ms, which a busy machine may take
            bus.canbus.shutdown()
            raise

    patiently(connected)
    bus.configure_motors()
    bus.sync_write("Kp", {"joint_1": 40.0, "joint_2": 40.0})
    for _ in range(100):
        bus.sync_write("Goal_Position", {"joint_1": 10.0, "joint_2": -20.0})
        arm.wait(0.02)
    found = bus.sync_read("Present_Position")
    assert found == {"joint_1": pytest.approx(10.0, abs=3.0), "joint_2": pytest.approx(-20.0, abs=3.0)}
    time.sleep(0.05)  # it believes what it read for 20 ms
    position = patiently(lambda: bus.read("Present_Position", "joint_1"))
    assert position == pytest.approx(math.degrees(arm["ROBSTRIDE_MIT1"].angle), abs=0.1)
    bus.disconnect(disable_torque=True)
    assert arm["ROBSTRIDE_MIT1"].state == "reset"


def test_an_so101_is_calibrated_and_teleoperated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """LeRobot's own SO-101 classes: both arms are calibrated by hand, then the follower goes where the leader is moved."""
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path))
    followers: Any = importlib.import_module("lerobot.robots.so_follower")
    leaders: Any = importlib.import_module("lerobot.teleoperators.so_leader")
    loop: Any = importlib.import_module("lerobot.scripts.lerobot_teleoperate").teleop_loop
    steps: Any = importlib.import_module("lerobot.processor").make_default_processors()
    hand = importlib.import_module("lerobot.motors.motors_bus")
    monkeypatch.setattr("builtins.input", lambda text="": "")
    with served_line(ARM, driver) as one, served_line(ARM, driver) as two:
        follower = followers.SO101Follower(
            followers.SO101FollowerConfig(port=one.path, id="follower", calibration_dir=tmp_path / "follower")
        )
        leader = leaders.SO101Leader(
            leaders.SO101LeaderConfig(port=two.path, id="leader", calibration_dir=tmp_path / "leader")
        )
        for arm, line in ((follower, one), (leader, two)):
            ways = iter((1047, 3047, 2047))

            def turned(line: Any = line, ways: Iterator[int] = ways) -> bool:
                """Turn all joints by hand; return whether they have been everywhere, and Enter is pressed."""
                count = next(ways, None)
                if count is not None:
                    turn_by_hand(line, count)
                return count is None

            monkeypatch.setattr(hand, "enter_pressed", turned)
            connect(arm.bus)
            patiently(arm.calibrate)
            assert arm.is_calibrated
            patiently(arm.configure)
        assert json.loads(follower.calibration_fpath.read_text())["gripper"]["range_max"] > 2500
        turn_by_hand(two, 2447)
        patiently(lambda: loop(leader, follower, 30, *steps, duration=2.0))
        with one.lock:
            twins: list[Any] = list(one.twins.values())
            places = [twin["present_position"] for twin in twins]
        assert places == pytest.approx([2447] * 6, abs=15)
        patiently(follower.disconnect)
        patiently(leader.disconnect)
