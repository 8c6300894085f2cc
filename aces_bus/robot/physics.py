"""Physics by name: what installed packages bring (entry points of `aces_bus.physics`), such as `mujoco:quadruped.xml`.

An entry point is a function of the robot and of what stands behind the colon; it returns a `Physics`, and raises
`CallerError` for what it cannot simulate.
"""

from __future__ import annotations

from types import FunctionType
from typing import Any

from ..device.config import Robot
from ..device.physics import Physics
from ..errors import CallerError
from ..plugins import Plugins

PHYSICS: Plugins[FunctionType] = Plugins("aces_bus.physics", "physics", FunctionType)


#: The name of no physics: each joint moves by itself, whatever the robot's file says.
NO_PHYSICS = "none"


def physics_of(text: str, robot: Robot) -> Physics:
    """Return the physics that `NAME` or `NAME:MODEL` names, for a robot.

    Raises `UnknownNameError` with the names that exist, `CallerError` for a model that cannot be read or has none of the
    robot's joints.
    """
    name, _, model = text.partition(":")
    maker: Any = PHYSICS.load(name)
    found: Physics = maker(robot, model)
    if not set(found.joints) & set(robot.joints):
        raise CallerError(
            f"{text}: it has none of the joints of {robot.name}: it has {', '.join(found.joints) or 'none'}"
        )
    return found


def chosen_physics(robot: Robot, chosen: Physics | str | None) -> Physics | None:
    """Return the physics of a robot's twins: `chosen`, or what its name names ("none": none), else what its file says.

    Raises as `physics_of`.
    """
    text = robot.physics if chosen is None else chosen
    if text is None or text == NO_PHYSICS:
        return None
    return physics_of(text, robot) if isinstance(text, str) else text
