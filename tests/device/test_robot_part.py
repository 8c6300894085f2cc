"""A part of a robot: what is named stays active, all else is as if it were not wired."""

from __future__ import annotations

import pytest

from aces_bus import load_robot
from aces_bus.errors import UnknownNameError
from aces_bus.robot import VirtualRobot


def test_a_bus_a_device_a_joint_a_sensor() -> None:
    """Each kind of name, aliases too, keeps its devices; joints and sensors of others are inactive."""
    robot = load_robot("hubo2plus")
    part = robot.part("LKP", "JMC3", "RFFT")
    assert [name for name, one in part.devices.items() if one.active] == ["JMC3", "JMC6", "FT_RF"]
    assert [name for name, one in part.joints.items() if one.active] == ["LKN", "RAP", "RAR"]
    assert [name for name, one in part.sensors.items() if one.active] == ["RFFT", "TILT_R"]
    lower = robot.part("lower")
    assert {one.bus for one in lower.devices.values() if one.active} == {"lower"}
    assert not lower.devices["IMU_1"].active  # the file says so
    assert list(part.joints) == list(robot.joints)


def test_unknown_names_are_told() -> None:
    """A name that is nothing of the robot is an error, with what it might have been."""
    with pytest.raises(UnknownNameError, match="JMC3"):
        load_robot("hubo2plus").part("JMC33")


def test_a_part_runs() -> None:
    """Only the buses and devices of the part are made."""
    with VirtualRobot(load_robot("hubo2plus").part("RAP"), rate_hz=100) as ankle:
        ankle.advance(0.05)
        assert list(ankle.wires) == ["lower"]
        assert list(ankle.devices) == ["JMC3"]
        assert ankle["RAP.position"].value == 0.0
