"""LD06: rounds of distances, whole ones alone."""

from __future__ import annotations

import math
from typing import Any

import pytest

from aces_bus.device import UNKNOWN
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.ld06 import EXAMPLE


def virtual(text: str = EXAMPLE) -> VirtualRobot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return VirtualRobot(robot)


def test_rounds_of_a_room() -> None:
    """450 points a round, each on a wall; the nearest one is the nearest wall's; darkness is unknown, not far."""
    rounds: list[Any] = []
    with virtual() as robot:
        lidar: Any = robot.devices["LIDAR"]
        lidar.on_round = rounds.append
        robot.advance(0.5)
        assert robot["LIDAR.nearest"].value == pytest.approx(1.5, abs=0.03)
        assert robot["LIDAR.nearest_angle"].value == pytest.approx(math.pi, abs=0.2)
        assert robot["LIDAR.rate"].value == pytest.approx(10, rel=0.05)
        assert robot["LIDAR.points"].value == pytest.approx(450, abs=2)
        assert lidar.round == rounds[-1]
        twin: Any = robot.twins["LIDAR"]
        for point in lidar.round:
            assert point.distance == pytest.approx(twin.distance(point.angle), abs=0.05)
        twin.fault("dark")
        robot.advance(0.3)
        assert robot["LIDAR.nearest"].value is UNKNOWN
        assert robot["LIDAR.points"].value == 0


def test_a_round_with_a_lost_packet_is_dropped() -> None:
    """What is missing is not reported as free room: rounds are whole, or not there."""
    rounds: list[Any] = []
    with virtual() as robot:
        lidar: Any = robot.devices["LIDAR"]
        lidar.on_round = rounds.append
        robot.advance(0.35)
        before = len(rounds)
        twin: Any = robot.twins["LIDAR"]
        twin.fault("loses", 20)
        robot.advance(0.5)
        assert len(rounds) - before <= 1
        twin.fault("loses", on=False)
        robot.advance(0.5)
        assert len(rounds) - before >= 4
        assert all(len(found) > 440 for found in rounds)


def test_an_ld14p_is_turned_by_commands() -> None:
    """With `rounds_hz` it is told its speed when the bus opens; `pause` and `scan` do what they say."""
    with virtual(EXAMPLE.replace('bus = "line" }', 'bus = "line", settings = { rounds_hz = 5 } }')) as robot:
        lidar: Any = robot.devices["LIDAR"]
        robot.advance(1.0)
        assert robot["LIDAR.rate"].value == pytest.approx(5, rel=0.05)
        lidar.pause().wait()
        robot.advance(2.0)
        assert robot["LIDAR.nearest"].value is UNKNOWN
        lidar.scan().wait()
        robot.advance(1.0)
        assert robot["LIDAR.nearest"].value == pytest.approx(1.5, abs=0.03)
