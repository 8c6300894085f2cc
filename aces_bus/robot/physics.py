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


def physics_of(text: str, robot: Robot) -> Physics:
    """Return the physics that `NAME` or `NAME:MODEL` names, for a robot.

    Raises `UnknownNameError` with the names that exist, `CallerError` for a model that cannot be read or has none of the
    robot's joints.
    """
    name, _, model = text.partition(":")
    found: Any = PHYSICS.load(name)(robot, model)
    if not set(found.joints) & set(robot.joints):
        raise CallerError(
            f"{text}: it has none of the joints of {robot.name}: it has {', '.join(found.joints) or 'none'}"
        )
    return found  # type: ignore[no-any-return]
