"""An MTi on CAN: signals in SI units that go with one another, and no orientation while the sensor has none."""

from __future__ import annotations

import math
from typing import Any

import pytest

from aces_bus.device import UNKNOWN
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.xsens_can import EXAMPLE
from aces_devices.xsens_can.twin import GRAVITY, quaternion


def virtual() -> VirtualRobot:
    robot, problems = parse_robot(EXAMPLE)
    assert robot is not None, problems
    return VirtualRobot(robot)


def test_values_go_with_one_another() -> None:
    """Rates are the turning of the orientation, acceleration is gravity in its axes; `read` has all of it."""
    with virtual() as robot:
        robot.advance(0.5)
        imu: Any = robot.devices["IMU"]
        before = None
        for _ in range(50):
            robot.advance(0.1)
            motion = imu.read()
            roll, pitch, yaw = (robot[f"IMU.{name}"].value for name in ("roll", "pitch", "yaw"))
            assert math.hypot(*motion.acceleration) == pytest.approx(GRAVITY, abs=0.1)
            tilt = math.atan2(motion.acceleration[1], motion.acceleration[2])
            assert tilt == pytest.approx(roll, abs=0.02)
            wanted = quaternion(roll, pitch, yaw)
            sign = 1 if wanted[0] * motion.quaternion[0] > 0 else -1
            assert motion.quaternion == pytest.approx([sign * part for part in wanted], abs=1e-3)
            if before is not None:
                assert (roll - before[0]) / 0.1 == pytest.approx((motion.rate[0] + before[1]) / 2, abs=0.03)
            before = roll, motion.rate[0]
        assert robot["IMU.temperature"].value == pytest.approx(308.15)
        assert robot["IMU.pressure"].value == 101_325


def test_orientation_is_unknown_while_its_filter_is_not_valid() -> None:
    """Acceleration and rate stay; orientation is known again with the filter; what clips is an alarm."""
    with virtual() as robot:
        robot.advance(0.5)
        imu: Any = robot.devices["IMU"]
        robot.twins["IMU"].fault("lost")
        robot.advance(0.3)
        assert robot["IMU.roll"].value is UNKNOWN
        motion = imu.read()
        assert motion.quaternion is None
        assert motion.acceleration is not None
        assert robot["IMU.filter_valid"].value == 0
        robot.twins["IMU"].fault("lost", on=False)
        robot.twins["IMU"].fault("clip")
        robot.advance(0.3)
        assert imu.read().quaternion is not None
        assert robot["IMU.clipping"].value == 1
        assert "clip_acc_x" in imu._alarms
