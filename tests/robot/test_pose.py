"""Where twins are at first, and what gears make of a joint's angle."""

from __future__ import annotations

from math import pi, tau

import pytest

from aces_bus import load_robot
from aces_bus.device import Robot
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.robot import VirtualRobot, run_virtual
from tests.device.fan import robot_of


@pytest.mark.parametrize(
    ("name", "joint", "reports"),
    [
        ("hubo2plus", "RKN", False),  # an incremental encoder: it says where it is once it is homed
        ("minihubo_1", "RHP", True),
        ("hubovia", None, None),
    ],
)
def test_a_twin_is_where_it_was_put(name: str, joint: str | None, reports: bool | None) -> None:
    """By name or alias; a board with absolute encoders reports it from the first answer on."""
    robot = load_robot(name)
    joint = joint or next(iter(robot.joints))
    robot = robot.part(joint)
    with VirtualRobot(robot, rate_hz=50, pose={joint: 0.3}) as made:
        made.advance(0.5)
        assert made.simulation.world.joints[joint].position(made.clock.now()) == pytest.approx(0.3, abs=1e-6)
        if reports:
            assert made[joint].value == pytest.approx(0.3, abs=0.006)


def test_homing_starts_from_the_pose() -> None:
    """A knee that is bent finds its zero all the same."""
    with run_virtual(load_robot("hubo2plus").part("RKN"), [], pose={"RKP": 0.6}, seed=3) as run:
        assert run.world.simulation.world.joints["RKN"].position(run.clock.now()) == pytest.approx(0.6)
        run.do("home")
        run.clock.wait(lambda: False, 4_000_000_000)
        assert run.states["RKN"].last == pytest.approx(0, abs=0.01)
        assert run.world.simulation.world.joints["RKN"].position(run.clock.now()) == pytest.approx(
            0, abs=0.01
        )


def test_a_pose_that_cannot_be_is_refused() -> None:
    """Beyond a stop, of a joint that is not there, of one whose twin has no angle."""
    robot = load_robot("hubo2plus").part("RKN")
    with pytest.raises(CallerError, match=r"RKN: its twin cannot begin at 30: it begins at \d"):
        VirtualRobot(robot, pose={"RKN": 30.0})
    with pytest.raises(UnknownNameError, match="RKNN"):
        VirtualRobot(robot, pose={"RKNN": 0.0})
    with pytest.raises(CallerError, match="LKN: its twin cannot begin at 0: it has none here"):
        VirtualRobot(robot, pose={"LKN": 0.0})


# ---------------------------------------------------------------------- gears


def servo(joint: str) -> Robot:
    return robot_of(
        f"""
name = "arm"
[buses]
line = {{ link = "serial", protocol = "robotis", baud = 1_000_000 }}
[devices]
S1 = {{ driver = "robotis_rx", bus = "line", credentials = {{ id = 1 }} }}
[joints]
J = {{ device = "S1", zero = 1.0, {joint} }}
"""
    )


@pytest.mark.parametrize(
    ("stated", "ratio", "counts"),
    [
        ("gear = [1, 2]", 2.0, None),
        ("harmonic = 100", 100.0, None),
        ("gear = [10, 25], encoder = 4000", 2.5, 2.5 * 4000 / tau),
        ("gear = [10, 25], harmonic = 100, encoder = 4000", 250.0, 250 * 4000 / tau),
        ("encoder = 4000", None, None),
        ("direction = 1", None, None),
    ],
)
def test_a_gear_needs_no_harmonic_drive(stated: str, ratio: float | None, counts: float | None) -> None:
    """What is not stated is not there; a ratio that nothing states stays unknown."""
    joint = servo(stated).joints["J"]
    assert joint.ratio == ratio
    assert joint.counts_per_unit == (None if counts is None else pytest.approx(counts))


def test_a_servo_behind_a_gear_has_the_joints_angles() -> None:
    """Position, speed, limits and set-points are the joint's, in the driver as in the twin; the servo turns more."""
    plain, geared = servo("direction = -1"), servo("direction = -1, gear = [1, 2]")
    for robot, ratio in ((plain, 1.0), (geared, 2.0)):
        with VirtualRobot(robot, rate_hz=50, pose={"J": 0.2}) as made:
            made.advance(0.3)
            assert made["J"].value == pytest.approx(0.2, abs=0.006)
            made.devices["S1"].enable()
            made["J"].set(-0.3)
            made.advance(2.0)
            assert made["J"].value == pytest.approx(-0.3, abs=0.02)
            world = made.simulation.world
            assert world.joints["J"].position(made.clock.now()) == pytest.approx(-0.3, abs=0.02)
            angle = made.twins["S1"]["present_position"] * 300 / 1023
            assert angle == pytest.approx((0.3 + 1.0) * ratio * 180 / pi, abs=2)
            assert made["J"].upper is not None
            assert made["J"].lower is not None
            assert made["J"].upper - made["J"].lower == pytest.approx(300 * pi / 180 / ratio, rel=0.01)
