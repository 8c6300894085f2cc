"""A body from outside: every motor twin gives its torque to it, and is where it says; one clock, the same run each time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pytest

from aces_bus.device.drivers import DRIVERS, load_driver
from aces_bus.device.physics import Contact, MovedBody
from aces_bus.errors import CallerError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.robot.physics import physics_of

MS = 1_000_000
#: Twins of joints without a motor of `joint_model`, and what they are instead.
BY_THEMSELVES = {
    "dronecan_esc": "a rotor that follows its throttle with a time constant",
    "hubovia": "its controller's own kinematics, which no sheet describes",
    "pololu_qik": "wheels that follow a duty with a time constant",
    "roboclaw": "wheels in counts of their encoders",
}
#: Twins that hold without being enabled.
HELD = {"rmdx": "its brake is closed until a set-point opens it"}


class Weights:
    """A body of joints that do not touch: each has an inertia (kg·m²) and a weight that pulls it down (N·m)."""

    def __init__(self, joints: Sequence[str], inertia: float = 0.02, weight: float = 0.3) -> None:
        self.joints = list(joints)
        self.inertia, self.weight = [inertia] * len(self.joints), weight
        self.friction = [0.0] * len(self.joints)
        self.positions, self.velocities = [0.0] * len(self.joints), [0.0] * len(self.joints)
        self.contacts: list[Contact] = []
        self.steps = 0

    def fit(self, joint: int, inertia: float, friction: float) -> None:
        self.inertia[joint] += inertia
        self.friction[joint] = friction

    def place(self, joint: int, position: float) -> None:
        self.positions[joint], self.velocities[joint] = position, 0.0

    def step(self, torques: Sequence[float]) -> None:
        self.steps += 1
        for number, torque in enumerate(torques):
            self.velocities[number] += (torque - self.weight) / self.inertia[number] * 1e-3
            self.positions[number] += self.velocities[number] * 1e-3


def with_joints() -> list[str]:
    """The drivers of motors in the catalogue."""
    found: list[str] = []
    for name in DRIVERS.points():
        robot, _ = parse_robot(load_driver(name).example or "")
        if robot is not None and robot.joints:
            found.append(name)
    return found


def made(driver: str, **more: Any) -> tuple[VirtualRobot, Weights]:
    """The example robot of a driver, and the body of its joints."""
    robot, problems = parse_robot(load_driver(driver).example)
    assert robot is not None, problems
    body = Weights(list(robot.joints), **more)
    return VirtualRobot(robot, rate_hz=50, physics=body), body


@pytest.mark.parametrize("driver", with_joints())
def test_every_motor_obeys_a_body(driver: str) -> None:
    """Not enabled, its joints sink by their weight: where they are is what the body says, for all that looks at them."""
    robot, body = made(driver)
    with robot:
        joints = robot.simulation.world.joints
        robot.advance(0.2)
        was = list(body.positions)
        robot.advance(0.5)
        sunk = [place - before for place, before in zip(body.positions, was, strict=True)]
        now = robot.clock.now()
        if driver in BY_THEMSELVES:
            return
        assert body.steps == pytest.approx(700, abs=1)
        for name, place in zip(body.joints, body.positions, strict=True):
            away = joints[name].position(now) - place
            assert math.remainder(away, math.tau) == pytest.approx(
                0.0, abs=1e-6
            )  # an endless turn begins anew
        if driver not in HELD:
            assert all(way < -0.01 for way in sunk), sunk


def test_the_exceptions_are_there() -> None:
    """A twin that leaves the catalogue, or has a motor by now, leaves the list."""
    assert set(BY_THEMSELVES) | set(HELD) <= set(with_joints())


def test_a_motor_that_is_enabled_holds_the_weight() -> None:
    """Stiffness against weight: it sinks by weight ÷ stiffness, its torque is the weight, and it falls when switched off."""
    robot, body = made("odrive", weight=1.5)
    with robot:
        robot.advance(0.02)
        robot.rig.each("enable").wait(5)
        robot.advance(1.0)
        held = body.positions[0]
        robot.advance(0.5)
        assert body.positions[0] == pytest.approx(held, abs=1e-3)
        twin: Any = next(iter(robot.twins.values()))
        assert twin.motor.torque == pytest.approx(1.5, rel=0.05)
        robot.rig.stop_motion().wait(5)
        robot.advance(0.5)
        assert body.positions[0] < held - 0.5


def test_a_jammed_joint_stays() -> None:
    """Nothing moves a blocked joint, however heavy."""
    robot, body = made("damiao")
    with robot:
        next(iter(robot.twins.values())).fault("jam")
        was = body.positions[0]
        robot.advance(0.5)
        assert body.positions[0] == pytest.approx(was, abs=1e-3)


def test_the_same_seed_is_the_same_run_whoever_looks() -> None:
    """Two runs are equal to the last bit; asking for positions in between changes nothing."""
    ends: list[list[float]] = []
    for looks in (1, 1, 50):
        robot, body = made("moteus")
        with robot:
            robot.advance(0.1)
            robot.rig.each("enable").wait(5)
            name = next(iter(robot.rig.robot.joints))
            robot[name].set(0.3)
            for _ in range(looks):
                robot.advance(0.5 / looks)
                robot.simulation.world.joints[name].position(robot.clock.now())
        ends.append([*body.positions, *body.velocities])
    assert ends[0] == ends[1] == ends[2]


def test_a_joint_begins_where_the_body_has_it_or_the_pose_says() -> None:
    """The body's place, unless a pose is given, which the body then takes."""
    robot, problems = parse_robot(load_driver("odrive").example)
    assert robot is not None, problems
    name = next(iter(robot.joints))
    for pose, begins in ((None, 0.4), ({name: -0.2}, -0.2)):
        body = Weights([name])
        body.positions[0] = 0.4
        made = VirtualRobot(robot, rate_hz=50, physics=body, pose=pose)
        assert made.simulation.world.joints[name].position(0) == pytest.approx(begins)
        assert body.positions[0] == pytest.approx(begins)


def test_a_body_is_checked() -> None:
    """A joint twice, a name that is no physics, a body of another robot: each is named."""
    with pytest.raises(CallerError, match="a joint twice"):
        MovedBody(Weights(["a", "a"]), 0)
    robot, problems = parse_robot(load_driver("odrive").example)
    assert robot is not None, problems
    with pytest.raises(CallerError, match="no physics named 'nothing'"):
        physics_of("nothing:x", robot)


def test_physics_that_feel_nothing_are_no_fault() -> None:
    """A body need not say how its parts move: twins of sensors then have what they have without one."""
    body = MovedBody(Weights(["J"]), 0)
    assert body.motion_of("imu", 5 * MS) is None
    assert body.wrench_on("foot", 5 * MS) is None
    assert body.at == 5 * MS


def test_axes_are_told_as_angles() -> None:
    """Roll, pitch and yaw of a part's axes, also where the pitch is a quarter turn; rates and accelerations as they are."""

    class Part(Weights):
        def motion_of(self, part: str) -> tuple[list[list[float]], list[float], list[float]] | None:
            c, s = math.cos(0.3), math.sin(0.3)
            turned = {
                "roll": [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]],
                "pitch": [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
                "yaw": [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
                "upright": [[0.0, 0.0, 1.0 + 1e-12], [0.0, 1.0, 0.0], [-1.0 - 1e-12, 0.0, 0.0]],
            }
            return (turned[part], [1.0, 2.0, 3.0], [0.0, 0.0, 9.81]) if part in turned else None

    body = MovedBody(Part(["J"]), 0)
    wanted = {"roll": (0.3, 0, 0), "pitch": (0, 0.3, 0), "yaw": (0, 0, 0.3), "upright": (0, math.pi / 2, 0)}
    for part, angles in wanted.items():
        found = body.motion_of(part, 0)
        assert found is not None
        assert (found.roll, found.pitch, found.yaw) == pytest.approx(angles)
        assert (found.rates, found.acceleration) == ((1.0, 2.0, 3.0), (0.0, 0.0, 9.81))
    assert body.motion_of("nothing", 0) is None
