"""A robot's mechanism as data: links with their inertias, and the joints between them, a tree.

1. Frozen and valid: one root, no loop, every name known; who has a `UrdfModel` need not ask again.
2. Numbers are those of the file: m, rad, kg, kg·m²; an origin is where a frame is in the one before it.
3. A joint's frame is its child's; at 0 both are at the joint's origin.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.kinematics.body import Body, Chain, Fixed, Move, Prismatic, Revolute

Vector = tuple[float, float, float]
Step = Revolute | Prismatic | Move | Fixed
Kind = Literal["revolute", "continuous", "prismatic", "fixed"]
ZERO: Final[Vector] = (0.0, 0.0, 0.0)
#: Joints between the root and a link. The deepest of the public models that the tests read has 24.
DEEPEST: Final = 1000


class UrdfOrigin(NamedTuple):
    """Where a frame is: `xyz` (m), turned by `rpy` (rad: about the fixed x, then y, then z axis)."""

    xyz: Vector = ZERO
    rpy: Vector = ZERO


NOWHERE: Final = UrdfOrigin()


class Inertia(NamedTuple):
    """Mass (kg) at an origin in the link, and the moments (kg·m²) about it, in the origin's axes: xx, xy, xz, yy, yz, zz."""

    mass: float
    origin: UrdfOrigin = NOWHERE
    moments: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class UrdfLink:
    """A rigid part. `inertia` None: the file does not state it, and dynamics take it as massless."""

    name: str
    inertia: Inertia | None = None


class Mimic(NamedTuple):
    """The value of a joint that follows another: multiplier × the other's + offset (rad, m)."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class UrdfJoint:
    """A joint between two links; `axis` is a unit vector in its own frame. What the file does not state is None.

    `lower`, `upper` rad or m; `velocity` rad/s or m/s; `effort` N·m or N; `damping` and `friction` per those.
    """

    name: str
    kind: Kind
    parent: str
    child: str
    origin: UrdfOrigin = NOWHERE
    axis: Vector = (1.0, 0.0, 0.0)
    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    effort: float | None = None
    damping: float | None = None
    friction: float | None = None
    mimic: Mimic | None = None
    #: The floating or planar joint that it is a part of, which no motor moves; "": it is a joint of its own.
    part_of: str = ""


class UrdfModel:
    """Links and joints of a robot.

    >>> turn = UrdfJoint("S", "continuous", "base", "upper", axis=(0.0, 0.0, 1.0))
    >>> arm = UrdfModel("arm", [UrdfLink("base"), UrdfLink("upper")], [turn])
    >>> arm.root, arm.moving, arm.body.tips
    ('base', ('S',), ('upper',))

    `links` and `joints` by name, in the file's order; `moving` are the joints that move of themselves: neither fixed nor
    mimicking. Raises `CallerError` for what is no tree, and `UnknownNameError` for a link or joint that is not there.
    """

    def __init__(self, name: str, links: Iterable[UrdfLink], joints: Iterable[UrdfJoint]) -> None:
        self.name = name
        links, joints = list(links), list(joints)
        for what, names in (
            ("links", [link.name for link in links]),
            ("joints", [joint.name for joint in joints]),
        ):
            if twice := [found for found, number in Counter(names).items() if number > 1]:
                raise CallerError(f"{name}: two {what} are named {twice[0]}")
        self.links = {link.name: link for link in links}
        self.joints = {joint.name: joint for joint in joints}
        parents: dict[str, UrdfJoint] = {}
        for joint in joints:
            for end in (joint.parent, joint.child):
                if end not in self.links:
                    raise UnknownNameError(f"link of {name}", end, self.links)
            if joint.child in parents:
                raise CallerError(
                    f"{name}: link {joint.child} has two joints to a parent, {parents[joint.child].name} and"
                    f" {joint.name}: a tree has one"
                )
            parents[joint.child] = joint
        roots = [link for link in self.links if link not in parents]
        if len(roots) != 1:
            raise CallerError(
                f"{name}: {len(roots)} links have no parent"
                + (
                    f" ({', '.join(roots[:3])}): a tree has one root"
                    if roots
                    else ": the joints go in a circle"
                )
            )
        self.root = roots[0]
        #: The joints in an order in which a parent comes before its children.
        self.order = self._ordered()
        if len(self.order) != len(joints):
            raise CallerError(f"{name}: some joints go in a circle, away from the root {self.root}")
        self.moving = tuple(j.name for j in joints if j.kind != "fixed" and j.mimic is None)
        #: UrdfJoint → the joint that moves it, with multiplier and offset; fixed joints have none.
        self.drives = {joint.name: self._drive(joint) for joint in joints if joint.kind != "fixed"}
        #: The same mechanism as chains from the root to each link without children.
        self.body = self._body(parents)

    def _ordered(self) -> list[UrdfJoint]:
        children: dict[str, list[UrdfJoint]] = {}
        for joint in self.joints.values():
            children.setdefault(joint.parent, []).append(joint)
        found: list[UrdfJoint] = []
        level = [self.root]
        for _ in range(DEEPEST):
            joints = [joint for link in level for joint in children.get(link, ())]
            if not joints:
                return found
            found += joints
            level = [joint.child for joint in joints]
        raise CallerError(f"{self.name}: more than {DEEPEST} joints one behind another")

    def _drive(self, joint: UrdfJoint) -> Mimic:
        """Return the joint that moves this one, through any number of joints that mimic one another."""
        multiplier, offset, met = 1.0, 0.0, {joint.name}
        while joint.mimic is not None:
            multiplier, offset = multiplier * joint.mimic.multiplier, offset + multiplier * joint.mimic.offset
            if joint.mimic.joint not in self.joints:
                raise UnknownNameError(f"joint of {self.name}", joint.mimic.joint, self.joints)
            joint = self.joints[joint.mimic.joint]
            if joint.name in met:
                raise CallerError(
                    f"{self.name}: joints mimic one another in a circle: {', '.join(sorted(met))}"
                )
            if joint.kind == "fixed":
                raise CallerError(f"{self.name}: a joint mimics {joint.name}, which is fixed")
            met.add(joint.name)
        return Mimic(joint.name, multiplier, offset)

    def _body(self, parents: dict[str, UrdfJoint]) -> Body:
        inner = {joint.parent for joint in self.joints.values()}
        limits = {
            name: (joint.lower, joint.upper)
            for name, joint in ((name, self.joints[name]) for name in self.moving)
            if joint.lower is not None and joint.upper is not None
        }
        tips = [link for link in self.links if link not in inner]
        chains = [Chain(tip, tuple(self._way(tip, parents))) for tip in tips]
        return Body(self.name, chains, joints=self.moving, limits=limits)

    def _way(self, link: str, parents: dict[str, UrdfJoint]) -> list[Step]:
        """Return the steps from the root to a link."""
        joints: list[UrdfJoint] = []
        while link in parents:
            joints.append(parents[link])
            link = parents[link].parent
        return [step for joint in reversed(joints) for step in self.steps(joint)]

    def steps(self, joint: UrdfJoint) -> list[Step]:
        """Return the steps of `aces_bus.kinematics` from a joint's parent to its child."""
        (x, y, z), (roll, pitch, yaw) = joint.origin
        found: list[Step] = [Move(x, y, z)] if any(joint.origin.xyz) else []
        found += _turns(("z", yaw), ("y", pitch), ("x", roll))
        if joint.kind == "fixed":
            return found
        to_axis, back, axis, sign = _aligned(joint.axis)
        name, multiplier, offset = self.drives[joint.name]
        if joint.kind == "prismatic":
            away = {axis: sign * offset}
            moved: list[Step] = [Prismatic(axis, name, sign * multiplier)]
            moved += [Move(away.get("x", 0.0), away.get("y", 0.0), away.get("z", 0.0))] if offset else []
        else:
            moved = [Revolute(axis, name, sign * multiplier), *_turns((axis, sign * offset))]
        return [*found, *to_axis, *moved, *back]


_Axis = Literal["x", "y", "z"]


def _turns(*turns: tuple[_Axis, float]) -> list[Step]:
    return [Fixed(axis, angle) for axis, angle in turns if angle]


def _aligned(axis: Vector) -> tuple[list[Step], list[Step], _Axis, float]:
    """Return turns after which a unit vector is an axis of the frame, those back, that axis, and its sign."""
    names: tuple[_Axis, _Axis, _Axis] = ("x", "y", "z")
    if axis.count(0.0) == 2:
        value = sum(axis)
        return [], [], names[axis.index(value)], value
    x, y, z = axis
    heading, tilt = math.atan2(y, x), math.atan2(math.hypot(x, y), z)
    return _turns(("z", heading), ("y", tilt)), _turns(("y", -tilt), ("z", -heading)), "z", 1.0
