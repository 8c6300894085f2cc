"""LeRobot's bus class for Feetech servos, unmodified, on a pseudo-terminal with the twins of an SO-101.

`make test-lerobot` installs it, with PyTorch, into an environment of its own; nothing else here needs them.
"""

from __future__ import annotations

import importlib
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


def test_the_bus_class_sets_up_calibrates_and_moves_an_arm() -> None:
    """Connect with its handshake, configure, calibrate, torque, goals and positions: as LeRobot does with an SO-101."""
    with served_line(ARM, driver) as line:
        arm = {
            name: motors.Motor(n, "sts3215", motors.MotorNormMode.RANGE_M100_100)
            for n, name in enumerate(JOINTS, 1)
        }
        bus = feetech.FeetechMotorsBus(line.path, arm)
        bus.connect(handshake=True)
        bus.disable_torque(num_retry=RETRIES)
        bus.configure_motors()
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
            if found == goals:
                break
        assert found == goals
        assert bus.sync_read("Present_Position", num_retry=RETRIES)["shoulder_pan"] == pytest.approx(-50)
        bus.disconnect(disable_torque=True)
        assert not any(twin["torque_enable"] for twin in twins)
        assert not [one for one in line.records() if isinstance(one, Unknown)]
