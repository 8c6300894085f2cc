"""RPLIDAR: rounds of distances, begun and begun anew, and what a request ends."""

from __future__ import annotations

import math
from typing import Any

import pytest

from aces_bus.device import UNKNOWN, Robot
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.rplidar import EXAMPLE, driver

test_driver = driver_tests(driver)

LOAD = {"rplidar": driver}.__getitem__


def robot_of(text: str = EXAMPLE) -> Robot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return robot


def test_rounds_of_a_room() -> None:
    """The nearest distance of each round is the nearest wall's, with its angle; a nearer wall is seen in the next rounds."""
    rounds: list[Any] = []
    with VirtualRobot(robot_of(), load=LOAD) as robot:
        lidar: Any = robot.devices["LIDAR"]
        lidar.on_round = rounds.append
        robot.advance(1.5)
        assert robot["LIDAR.nearest"].value == pytest.approx(1.5, abs=0.03)
        assert robot["LIDAR.nearest_angle"].value == pytest.approx(math.pi, abs=0.2)
        assert robot["LIDAR.rate"].value == pytest.approx(5.5, rel=0.05)
        assert robot["LIDAR.points"].value == pytest.approx(364, abs=10)
        assert robot["LIDAR.health"].value == 0
        assert lidar.round == rounds[-1]
        assert all(point.distance > 1.4 for point in lidar.round)
        robot.twins["LIDAR"].walls = (3.0, 0.8, 1.5, 2.5)
        robot.advance(0.6)
        assert robot["LIDAR.nearest"].value == pytest.approx(0.8, abs=0.03)
        assert robot["LIDAR.nearest_angle"].value == pytest.approx(math.pi / 2, abs=0.2)
        robot.twins["LIDAR"].fault("dark")
        robot.advance(0.6)
        assert robot["LIDAR.nearest"].value is UNKNOWN
        assert robot["LIDAR.points"].value == 0


EXPRESS_ROBOT = EXAMPLE.replace('protocol = "rplidar"', 'protocol = "rplidar", dialect = "express"')


def test_rounds_of_an_express_scan() -> None:
    """Twice as many points a round; each is on a wall of the room, though its packet says one angle for 32."""
    with VirtualRobot(robot_of(EXPRESS_ROBOT), load=LOAD) as robot:
        lidar: Any = robot.devices["LIDAR"]
        robot.advance(1.5)
        assert robot["LIDAR.nearest"].value == pytest.approx(1.5, abs=0.03)
        assert robot["LIDAR.rate"].value == pytest.approx(5.5, rel=0.1)
        assert robot["LIDAR.points"].value == pytest.approx(727, abs=20)
        twin: Any = robot.twins["LIDAR"]
        off = [abs(point.distance - twin.distance(point.angle)) for point in lidar.round]
        assert max(off) < 0.05
        assert sorted(off)[len(off) // 2] < 0.01


def test_an_express_packet_without_its_next_one_is_dropped() -> None:
    """Its angles are not known: of a round with a lost packet nothing is told; the next rounds are whole."""
    rounds: list[Any] = []
    with VirtualRobot(robot_of(EXPRESS_ROBOT), load=LOAD) as robot:
        lidar: Any = robot.devices["LIDAR"]
        twin: Any = robot.twins["LIDAR"]
        robot.advance(1.0)
        lidar.on_round = rounds.append
        sent = twin.send_raw
        lost = iter([True])
        twin.send_raw = lambda packets: None if next(lost, False) else sent(packets)
        robot.advance(1.0)
    assert len(rounds) == pytest.approx(4, abs=1)
    for points in rounds:
        assert len(points) == pytest.approx(727, abs=20)
        assert max(abs(point.distance - twin.distance(point.angle)) for point in points) < 0.05


def test_a_scan_that_ends_is_begun_anew() -> None:
    """After a reset, and after its information was read, measurements come again within two seconds; paused, they do not."""
    with VirtualRobot(robot_of(), load=LOAD) as robot:
        lidar: Any = robot.devices["LIDAR"]
        twin: Any = robot.twins["LIDAR"]
        robot.advance(1.0)
        assert twin.is_scanning
        job = lidar.info()
        robot.advance(0.2)
        assert job.result["firmware"] == "1.29"
        robot.advance(2.0)
        assert twin.is_scanning
        lidar.reset()
        robot.advance(0.1)
        assert not twin.is_scanning
        robot.advance(2.0)
        assert twin.is_scanning
        lidar.pause()
        robot.advance(4.0)
        assert not twin.is_scanning
        assert robot["LIDAR.nearest"].value is UNKNOWN
        lidar.scan()
        robot.advance(1.0)
        assert twin.is_scanning


def test_a_scanner_that_protects_itself_is_not_asked_to_measure() -> None:
    """With the health `error` no scan is begun; the health says so."""
    with VirtualRobot(robot_of(), load=LOAD) as robot:
        twin = robot.twins["LIDAR"]
        twin.fault("protection")
        twin.is_scanning = False
        robot.advance(3.0)
        assert robot["LIDAR.health"].value == 2
        assert not twin.is_scanning
