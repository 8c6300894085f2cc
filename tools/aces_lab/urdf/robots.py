"""Between URDF models, bodies of `aces_bus.kinematics`, and robots' files.

1. What a robot's file says (limits, speeds) is newer than what its body's file says, and replaces it.
2. A body of chains has no inertias: its links are written without any.
3. Links that two chains share are one link: chains share what their steps have in common from the beginning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_bus.kinematics import load_body
from aces_bus.kinematics.bodies import body_format
from aces_bus.kinematics.body import (
    Body,
    Fixed,
    Move,
    Prismatic,
    Revolute,
    roll_pitch_yaw,
    rotation_of,
)

from .model import Kind, Mimic, Step, UrdfJoint, UrdfLink, UrdfModel, UrdfOrigin, Vector
from .read import read_urdf


def urdf_body(path: str) -> Body:
    """Return the body of a URDF file; raises `CallerError` with file and line."""
    return read_urdf(path).body


def robot_joints(path: str) -> Mapping[str, Mapping[str, object]]:
    """Return the joints of a URDF file that a motor may move, with the keys of a robot's file."""
    model = read_urdf(path)
    found: dict[str, dict[str, object]] = {}
    for name in model.moving:
        joint = model.joints[name]
        if joint.part_of:
            continue
        kind = joint.kind if joint.lower is not None or joint.kind == "prismatic" else "continuous"
        keys = {"type": kind, "lower": joint.lower, "upper": joint.upper, "max_speed": joint.velocity or None}
        found[name] = {key: value for key, value in keys.items() if value is not None}
    return found


def model_of_robot(robot: Robot) -> UrdfModel:
    """Return a robot's mechanism, with the limits and speeds of its file. Raises `CallerError` for one without a body."""
    if robot.body is None:
        raise CallerError(
            f"{robot.name} names no body, so that its lengths are not known: body = in its file names an installed body,"
            " or a URDF file beside it"
        )
    is_file = body_format(robot.body) is not None
    model = read_urdf(robot.body) if is_file else model_of_body(load_body(robot.body))
    joints = [_limited(joint, robot) for joint in model.joints.values()]
    return UrdfModel(robot.name, model.links.values(), joints)


def _limited(joint: UrdfJoint, robot: Robot) -> UrdfJoint:
    """Return a joint with the limits of the robot's file, where that has the joint."""
    own = robot.joints.get(joint.name)
    if own is None or joint.kind == "fixed" or joint.mimic is not None:
        return joint
    lower = joint.lower if own.lower is None else own.lower
    upper = joint.upper if own.upper is None else own.upper
    kind: Kind = joint.kind
    if kind == "continuous" and lower is not None and upper is not None:
        kind = "revolute"
    return replace(joint, kind=kind, lower=lower, upper=upper, velocity=own.max_speed or joint.velocity)


def model_of_body(body: Body) -> UrdfModel:
    """Return a body of chains as a model without inertias; a tip is a link of its own.

    A joint that several chains or steps use moves one joint, which the others mimic.
    """
    made = _Made(body)
    for chain in body.chains.values():
        made.add(chain.tip, chain.steps)
    return UrdfModel(body.name, made.links, made.joints)


class _Made:
    """Links and joints of a body's chains, as they are met."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self.links = [UrdfLink(body.name)]
        self.joints: list[UrdfJoint] = []
        #: The steps up to a joint → its child.
        self.reached: dict[tuple[Step, ...], str] = {}
        self.names = {body.name, *body.tips}

    def add(self, tip: str, steps: tuple[Step, ...]) -> None:
        """Add what a chain does not share with those before it."""
        parent, begin = self.body.name, 0
        for end, step in enumerate(steps, 1):
            if not isinstance(step, Revolute | Prismatic):
                continue
            way = steps[:end]
            if way not in self.reached:
                self.reached[way] = self._moved(step, parent, _origin(steps[begin : end - 1]))
            parent, begin = self.reached[way], end
        # A tip's own name is its link's.
        self.links.append(UrdfLink(tip))
        name = self._free(f"{tip}_tip", {joint.name for joint in self.joints} | set(self.body.joints))
        self.joints.append(UrdfJoint(name, "fixed", parent, tip, _origin(steps[begin:])))

    def _moved(self, step: Revolute | Prismatic, parent: str, origin: UrdfOrigin) -> str:
        """Add a joint that moves; return its child."""
        taken = {joint.name for joint in self.joints}
        name = step.joint if step.joint not in taken else self._free(step.joint, taken)
        child = self._free(f"{name}_link", self.names)
        self.names.add(child)
        self.links.append(UrdfLink(child))
        place = self.body.index[step.joint]
        low, high = float(self.body.lower[place]), float(self.body.upper[place])
        is_first, has_range = name == step.joint, bool(np.isfinite((low, high)).all())
        kind: Kind = "prismatic" if isinstance(step, Prismatic) else "revolute" if has_range else "continuous"
        number, sign = "xyz".index(step.axis), 1.0 if step.sign > 0 else -1.0
        axis: Vector = (sign * (number == 0), sign * (number == 1), sign * (number == 2))
        mimic = None if is_first else Mimic(step.joint, abs(step.sign))
        if is_first and abs(step.sign) != 1:
            raise CallerError(
                f"{self.body.name}: {name} turns by {step.sign:g} times its angle, which URDF cannot say of a joint"
            )
        lower, upper = (low, high) if is_first and has_range else (None, None)
        self.joints.append(UrdfJoint(name, kind, parent, child, origin, axis, lower, upper, mimic=mimic))
        return child

    @staticmethod
    def _free(name: str, taken: set[str]) -> str:
        found, number = name, 2
        while found in taken:
            found, number = f"{name}_{number}", number + 1
        return found


def _origin(steps: tuple[Step, ...]) -> UrdfOrigin:
    """Return where steps lead of which none is a joint's."""
    place, turned = np.zeros(3), np.eye(3)
    for step in steps:
        if isinstance(step, Move):
            place = place + turned @ np.array((step.x, step.y, step.z))
        elif isinstance(step, Fixed):
            angles = [0.0, 0.0, 0.0]
            angles["xyz".index(step.axis)] = step.angle
            turned = turned @ rotation_of(*angles)
    x, y, z = place.tolist()
    return UrdfOrigin((x, y, z), roll_pitch_yaw(turned))
