"""RoboClaw: answers without a head on one line, the serial time-out, stops; not before `enable`."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from aces_bus.device import Device
from aces_bus.errors import CallerError, DeviceError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.roboclaw import driver

ROBOT = """
name = "claws"
rate_hz = 20
[buses]
line = { link = "serial", protocol = "roboclaw", baud = 115_200 }
[devices]
A = { driver = "roboclaw", bus = "line", credentials = { address = 0x80 }, settings = { timeout_s = 0.3 } }
B = { driver = "roboclaw", bus = "line", credentials = { address = 0x87 } }
[joints]
LEFT = { device = "A", channel = 0, type = "continuous", command = "speed", encoder = 1000, max_speed = 20 }
RIGHT = { device = "A", channel = 1, type = "continuous", command = "duty", direction = -1, max_duty = 0.5 }
ARM = { device = "B", channel = 1, encoder = 1000, harmonic = 10, zero = 0.1, direction = -1, max_speed = 2 }
"""


def assembled(text: str = ROBOT) -> VirtualRobot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=20, load={"roboclaw": driver}.__getitem__)


@pytest.fixture
def robot() -> Iterator[VirtualRobot]:
    with assembled() as made:
        yield made


def enabled(robot: VirtualRobot) -> VirtualRobot:
    for device in robot.devices.values():
        assert isinstance(device, Device)
        device.enable().wait(2)  # type: ignore[attr-defined]
    return robot


def value(robot: VirtualRobot, name: str) -> float:
    found = robot[name].value
    assert isinstance(found, float)
    return found


def test_an_answer_takes_its_time_on_the_wire(robot: VirtualRobot) -> None:
    """A question of 2 bytes and an answer of 4, at 115,200 baud: 0.53 ms, and no pause to wait for."""
    robot.advance(1)
    ticket = robot.devices["A"].ask("GetMainVoltage", reply="MainVoltage")
    ticket.wait(1)
    assert ticket.latency_ns is not None
    assert ticket.latency_ns < 3_000_000


def test_joints_move_as_their_commands_say(robot: VirtualRobot) -> None:
    """A speed, a duty with its direction and its limit, a position: each in its own message, each acknowledged."""
    enabled(robot)
    robot["LEFT.velocity"].set(5.0)
    robot["RIGHT.duty"].set(0.9)
    robot["ARM.position"].set(0.5)
    robot.advance(2)
    assert value(robot, "LEFT.velocity") == pytest.approx(5.0, abs=0.01)
    assert value(robot, "RIGHT.duty") == pytest.approx(0.5, abs=1e-4)
    assert robot.twins["A"].duty[2] == pytest.approx(-0.5, abs=1e-4)
    assert value(robot, "ARM.position") == pytest.approx(0.5, abs=0.001)
    assert robot.events.count("malformed") == robot.events.count("no reply") == 0


def test_nothing_moves_before_enable(robot: VirtualRobot) -> None:
    """A set-point is refused, and reported."""
    robot.advance(0.5)
    robot["RIGHT.duty"].set(0.4)
    robot.advance(0.5)
    assert robot.twins["A"].duty == {1: 0.0, 2: 0.0}


def test_a_stop_ends_both_motors(robot: VirtualRobot) -> None:
    """Duty 0 at once, confirmed by both duties; what was set does not come again."""
    enabled(robot)
    robot["LEFT.velocity"].set(5.0)
    robot["RIGHT.duty"].set(0.4)
    robot.advance(0.5)
    robot.devices["A"].stop_motion().wait(1)
    robot.devices["A"].confirm_stopped().wait(1)
    robot.advance(0.5)
    assert robot.twins["A"].duty == {1: 0.0, 2: 0.0}


def test_without_its_host_both_motors_stop(robot: VirtualRobot) -> None:
    """The serial time-out that `enable` has set ends what was driven."""
    enabled(robot)
    robot["RIGHT.duty"].set(0.4)
    robot.advance(0.5)
    assert robot.twins["A"].duty[2] == pytest.approx(-0.4, abs=1e-4)
    for host in robot.rig.hosts.values():
        host.close()
    robot.advance(0.2)
    assert robot.twins["A"].duty[2] == pytest.approx(-0.4, abs=1e-4)
    robot.advance(0.3)
    assert robot.twins["A"].duty == {1: 0.0, 2: 0.0}


def test_a_fault_ends_set_points(robot: VirtualRobot) -> None:
    """An emergency stop is an alarm; it is enabled anew when that is over."""
    enabled(robot)
    robot["RIGHT.duty"].set(0.4)
    robot.advance(0.5)
    robot.twins["A"].fault("e_stop")
    robot.advance(1)
    assert robot.twins["A"].duty == {1: 0.0, 2: 0.0}
    assert robot.events.count("alarm")
    with pytest.raises(DeviceError, match="e_stop; clear it first"):
        robot.devices["A"].enable().wait(1)
    robot.twins["A"].fault("e_stop", on=False)
    robot.advance(1)
    robot.devices["A"].enable().wait(1)
    robot.advance(0.5)
    assert robot.twins["A"].duty == {1: 0.0, 2: 0.0}


def test_what_a_joint_must_say() -> None:
    """A position needs counts a turn, and there are two channels."""
    with (
        pytest.raises(CallerError, match="say encoder = counts a turn"),
        assembled(ROBOT.replace("encoder = 1000, harmonic", "harmonic")),
    ):
        pass
    with (
        pytest.raises(CallerError, match="channels 0 and 1"),
        assembled(ROBOT.replace('"B", channel = 1', '"B", channel = 2')),
    ):
        pass
