"""A URDF model that twins move: weight, rotors, friction, stops, a push; and the arm of four makers with it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from aces_bus import load_robot
from aces_bus.controller import controller
from aces_bus.errors import CallerError
from aces_bus.robot import run_virtual
from aces_lab.urdf import Dynamics, UrdfPhysics, model_of_robot, parse_urdf, urdf_physics
from tests.lab.urdf.samples import RODS

ARM = Path(__file__).parents[3] / "examples" / "arm.toml"


def rods() -> UrdfPhysics:
    """Two rods, hanging."""
    return UrdfPhysics(parse_urdf(RODS))


def test_what_is_held_by_its_gravity_torques_stays() -> None:
    """Exactly: nothing moves, however long."""
    body, dynamics = rods(), Dynamics(parse_urdf(RODS))
    body.place(0, 0.3)
    body.place(1, -0.8)
    held = dynamics.gravity_torques((0.3, -0.8))
    for _ in range(100):
        body.step(held.tolist())
    assert body.positions == pytest.approx([0.3, -0.8], abs=1e-12)


def test_a_pendulum_swings_as_on_paper() -> None:
    """One rod, small angles about straight down: its period is that of a physical pendulum, and it comes back."""
    text = '<robot name="p"><link name="a"/><link name="b"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>'
    text += '<inertia ixx="0" iyy="0.02" izz="0.02"/></inertial></link><joint name="S" type="continuous">'
    body = UrdfPhysics(
        parse_urdf(f'{text}<parent link="a"/><child link="b"/><axis xyz="0 1 0"/></joint></robot>')
    )
    body.place(0, math.pi / 2 + 0.05)
    period = 2 * math.pi * math.sqrt((0.02 + 2 * 0.2**2) / (2 * 9.81 * 0.2))
    for _ in range(round(1000 * period)):
        body.step([0.0])
    assert body.positions[0] - math.pi / 2 == pytest.approx(0.05, abs=1e-3)


def test_rotors_friction_stops_and_pushes_count() -> None:
    """A rotor's inertia is added, dry friction holds what is weaker than it, limits stop, somebody may push."""
    free, geared, rough = rods(), rods(), rods()
    geared.fit(0, 10.0, 0.0)
    for joint in (0, 1):
        rough.fit(joint, 0.0, 20.0)
    for _ in range(50):
        for body in (free, geared, rough):
            body.step([0.0, 0.0])
    assert free.velocities[0] > 5 * geared.velocities[0] > 0
    assert rough.positions == [0.0, 0.0]
    rough.push["E"] = 25.0
    for _ in range(1500):
        rough.step([0.0, 0.0])
    assert (rough.positions[1], rough.velocities[1]) == (2.5, 0.0)


def test_a_body_without_weight_is_refused() -> None:
    """Chains have no inertias; a robot without a body has nothing at all."""
    with pytest.raises(CallerError, match="has no inertias"):
        urdf_physics(load_robot("minihubo_1"))
    with pytest.raises(CallerError, match="names no body"):
        urdf_physics(load_robot("rover"))


@pytest.mark.slow
def test_the_arm_of_four_makers_has_weight() -> None:
    """Its motors hold it, each in its own way, and a soft one sags a little; switched off it falls."""
    robot = load_robot(ARM)
    pose = {"shoulder": 0.4, "elbow": 0.5}

    @controller(rate_hz=100, writes=list(robot.joints))
    def hold() -> dict[str, float]:
        return {joint: pose.get(joint, 0.0) for joint in robot.joints}

    body = urdf_physics(robot)
    height = Dynamics(model_of_robot(robot))
    with run_virtual(robot, [hold], pose=pose, physics=body) as run:
        run.do("enable")
        run.start()
        run.world.advance(1.0)
        held = np.array(body.positions)
        ended = run.stop()
        run.world.simulation.open()
        run.world.advance(1.5)
        run.world.simulation.close()
    assert not ended.tripped
    assert held == pytest.approx([pose.get(joint, 0.0) for joint in body.joints], abs=0.15)
    assert height.frames(body.positions)["flange"][2, 3] < height.frames(held)["flange"][2, 3] - 0.2
