"""Bodies as links between frames, as 3D views draw them: each joint has a frame, and each tip.

1. A link is in the frame before it: the way from there, then the joint's turn. A joint's frame has the joint's name, a tip's
   the tip's, the first one the body's; a joint that chains reach on other ways has a frame for each, with the tip's name
   behind a slash.
2. A joint whose angle is unknown has no link.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from .body import AXES, Body, Fixed, Move, Prismatic, Revolute, Step

_Vector = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]


class Link(NamedTuple):
    """Where the frame `child` is in `parent`: `position` (x, y, z) m, `rotation` a unit quaternion (x, y, z, w)."""

    parent: str
    child: str
    position: _Vector
    rotation: _Quaternion


class _Section(NamedTuple):
    """From one frame to the next: the way that no joint changes, then the joint (None: a tip)."""

    parent: str
    child: str
    position: _Vector
    rotation: _Quaternion
    joint: Revolute | Prismatic | None


class Links:
    """The links of a body.

    >>> from aces_bus.kinematics.body import Body, Chain
    >>> arm = Body("arm", [Chain("hand", (Move(0, 0, 1.0), Revolute("z", "S"), Move(0.3)))])
    >>> [(link.parent, link.child, link.position) for link in Links(arm).at({"S": 0.0})]
    [('arm', 'S', (0.0, 0.0, 1.0)), ('S', 'hand', (0.3, 0.0, 0.0))]
    >>> [link.child for link in Links(arm).at({})]
    ['hand']
    """

    def __init__(self, body: Body) -> None:
        self.body = body
        self._sections: list[_Section] = []
        frames: dict[tuple[Step, ...], str] = {}
        taken = {body.name}
        for chain in body.chains.values():
            parent, begin = body.name, 0
            for end, step in enumerate(chain.steps, 1):
                if not isinstance(step, (Revolute, Prismatic)):
                    continue
                way = chain.steps[:end]
                if way not in frames:
                    frames[way] = self._free(step.joint, chain.tip, taken)
                    self._sections.append(
                        _Section(parent, frames[way], *_way(chain.steps[begin : end - 1]), step)
                    )
                parent, begin = frames[way], end
            tip = self._free(chain.tip, "tip", taken)
            self._sections.append(_Section(parent, tip, *_way(chain.steps[begin:]), None))

    @staticmethod
    def _free(name: str, behind: str, taken: set[str]) -> str:
        """Return the name of a frame, which no other has."""
        found, number = name, 1
        while found in taken:
            found = f"{name}/{behind}" + (f"/{number}" if number > 1 else "")
            number += 1
        taken.add(found)
        return found

    def at(self, angles: Mapping[str, float]) -> list[Link]:
        """Return the links of a pose: rad (m) by joint; one that is missing, or not finite, is unknown."""
        links: list[Link] = []
        for parent, child, place, turn, joint in self._sections:
            if joint is None:
                links.append(Link(parent, child, place, turn))
                continue
            angle = joint.sign * angles.get(joint.joint, math.nan)
            if not math.isfinite(angle):
                continue
            if isinstance(joint, Revolute):
                links.append(Link(parent, child, place, _turned(turn, AXES[joint.axis], angle)))
            else:
                links.append(Link(parent, child, _slid(place, turn, AXES[joint.axis], angle), turn))
        return links


def _way(steps: tuple[Step, ...]) -> tuple[_Vector, _Quaternion]:
    """Return the way of steps of which none is a joint's."""
    place: _Vector = (0.0, 0.0, 0.0)
    turn: _Quaternion = (0.0, 0.0, 0.0, 1.0)
    for step in steps:
        if isinstance(step, Move):
            for axis, way in enumerate((step.x, step.y, step.z)):
                place = _slid(place, turn, axis, way)
        elif isinstance(step, Fixed):
            turn = _turned(turn, AXES[step.axis], step.angle)
    return place, turn


def _turned(q: _Quaternion, axis: int, angle: float) -> _Quaternion:
    """Return a rotation, and then one about an axis of the frame that it has reached."""
    s, c = math.sin(angle / 2), math.cos(angle / 2)
    x, y, z, w = q
    if axis == 0:
        return (x * c + w * s, y * c + z * s, z * c - y * s, w * c - x * s)
    if axis == 1:
        return (x * c - z * s, y * c + w * s, z * c + x * s, w * c - y * s)
    return (x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s)


def _slid(place: _Vector, q: _Quaternion, axis: int, way: float) -> _Vector:
    """Return a place, and a way from it along an axis of a frame that is turned by `q`."""
    x, y, z, w = q
    along = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
    )[axis]
    return place[0] + along[0] * way, place[1] + along[1] * way, place[2] + along[2] * way
