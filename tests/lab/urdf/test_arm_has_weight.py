"""The example arm has weight by its own file: its motors hold it, and it falls without them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from aces_bus import load_robot
from aces_bus.robot import VirtualRobot

ARM = Path(__file__).parents[3] / "examples" / "arm.toml"


def arm(**more: Any) -> VirtualRobot:
    return VirtualRobot(load_robot(ARM), **more)


def test_the_example_arm_carries_its_weight_and_falls_when_switched_off() -> None:
    """By its file: enabled it holds out where it is led, with torques of its weight; switched off it falls to its stops."""
    with arm() as robot:
        robot.advance(0.05)
        robot.rig.each("enable").wait(5)
        for _ in range(150):
            robot["shoulder"].set(1.0)
            for joint in ("base", "elbow", "forearm", "wrist", "hand"):
                robot[joint].set(0.0)
            robot.advance(0.01)
        held = robot["shoulder"].last
        assert held == pytest.approx(1.0, abs=0.1)
        assert robot.twins["M2"].motor.torque < -1.0  # it pulls back what leans forward
        robot.rig.stop_motion().wait(5)
        robot.advance(1.5)
        assert robot["shoulder"].last > 1.4


def test_without_physics_it_stays_where_it_is() -> None:
    """`physics="none"`: each joint moves by itself."""
    with arm(physics="none", pose={"shoulder": 0.5}) as robot:
        robot.advance(1.0)
        assert robot["shoulder"].last == pytest.approx(0.5, abs=1e-3)
