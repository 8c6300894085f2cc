"""Bodies of serial chains: forward kinematics and Jacobians.

1. Lengths are metres, angles rad, rotations right-handed; every chain begins in the body's own frame.
2. A chain is data: turns and moves from the base to the tip, each in the frame that the steps before it have reached.
3. One pose is computed in plain floats, many at once with NumPy; both give the same numbers.

A joint may be in several chains (a waist), and in a chain more than once.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..errors import CallerError, UnknownNameError

Floats = npt.NDArray[np.float64]
Axis = Literal["x", "y", "z"]
AXES = {"x": 0, "y": 1, "z": 2}
#: Angles of a body's joints, by name or in the body's order.
Angles = Mapping[str, float] | Sequence[float] | Floats


@dataclass(frozen=True)
class Revolute:
    """A joint that turns by sign × its angle about an axis."""

    axis: Axis
    joint: str
    sign: float = 1.0


@dataclass(frozen=True)
class Prismatic:
    """A joint that moves by sign × its value (m) along an axis."""

    axis: Axis
    joint: str
    sign: float = 1.0


@dataclass(frozen=True)
class Move:
    """A step along the present frame, m."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(frozen=True)
class Fixed:
    """A turn that no joint makes, rad."""

    axis: Axis
    angle: float


Step = Revolute | Prismatic | Move | Fixed


@dataclass(frozen=True)
class Chain:
    """From the base to the tip called `tip`."""

    tip: str
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Pose:
    """Where a tip is: `position` (3,) m, and `rotation` (3, 3), whose columns are the tip's axes in the base."""

    position: Floats
    rotation: Floats


def rotation_of(roll: float, pitch: float, yaw: float) -> Floats:
    """Return the rotation (3, 3) that turns about the base's x, then y, then z axis by these angles (rad): URDF's
    convention.

    >>> rotation_of(0.0, 0.0, math.pi / 2).round(6).tolist()
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [-0.0, 0.0, 1.0]]

    Raises `CallerError` for an angle that is not finite.
    """
    if not all(map(math.isfinite, (roll, pitch, yaw))):
        raise CallerError(
            f"a rotation by roll {roll}, pitch {pitch}, yaw {yaw}: angles are finite numbers, rad"
        )
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle), math.cos(angle)) for angle in (roll, pitch, yaw))
    return np.array(
        (
            (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
            (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
            (-sp, cp * sr, cp * cr),
        )
    )


def roll_pitch_yaw(rotation: Floats) -> tuple[float, float, float]:
    """Return the angles (rad) of which `rotation_of` makes a rotation; straight up or down (pitch ±π/2) roll is 0."""
    r = rotation
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    if abs(r[2, 0]) > 1 - 1e-12:
        return 0.0, pitch, math.atan2(-r[0, 1], r[1, 1])
    return math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])


# A step as the loop walks it: kind, axis, joint's index, sign; or a move.
_TURN, _SLIDE, _MOVE, _FIXED = range(4)
_Walk = tuple[int, int, int, float, tuple[float, float, float]]


class Body:
    """Chains over one list of joints.

    >>> arm = Body("arm", [Chain("hand", (Revolute("z", "S"), Move(0.3), Revolute("z", "E"), Move(0.2)))])
    >>> arm.joints
    ('S', 'E')
    >>> arm.forward({"S": 0.0, "E": 0.0})["hand"].position
    array([0.5, 0. , 0. ])

    `joints` gives the order of angle vectors (None: as the chains name them); `limits` are (lower, upper) in rad by joint, a
    joint without an entry has none; `posture` is a pose away from singularities; the inverse turns to it when it is stuck.
    """

    def __init__(
        self,
        name: str,
        chains: Iterable[Chain],
        *,
        joints: Sequence[str] | None = None,
        limits: Mapping[str, tuple[float, float]] | None = None,
        posture: Mapping[str, float] | None = None,
    ) -> None:
        self.name = name
        self.chains = {chain.tip: chain for chain in chains}
        used = [
            s.joint
            for chain in self.chains.values()
            for s in chain.steps
            if isinstance(s, (Revolute, Prismatic))
        ]
        self.joints = tuple(dict.fromkeys(used if joints is None else joints))
        self.index = {joint: i for i, joint in enumerate(self.joints)}
        for joint in (*used, *(limits or {}), *(posture or {})):
            if joint not in self.index:
                raise UnknownNameError(f"joint of {name}", joint, self.joints)
        self.lower = np.full(len(self.joints), -np.inf)
        self.upper = np.full(len(self.joints), np.inf)
        for joint, (low, high) in (limits or {}).items():
            if not low < high:
                raise CallerError(
                    f"{name}: the limits of {joint}, {low} … {high}, leave nothing between them"
                )
            self.lower[self.index[joint]], self.upper[self.index[joint]] = low, high
        self.posture = (
            None if posture is None else self.vector({**dict.fromkeys(self.joints, 0.0), **posture})
        )
        self._walks = {tip: [self._walk(step) for step in chain.steps] for tip, chain in self.chains.items()}

    @property
    def tips(self) -> tuple[str, ...]:
        """The names of its tips."""
        return tuple(self.chains)

    def _walk(self, step: Step) -> _Walk:
        match step:
            case Revolute(axis, joint, sign):
                return (_TURN, AXES[axis], self.index[joint], float(sign), (0.0, 0.0, 0.0))
            case Prismatic(axis, joint, sign):
                return (_SLIDE, AXES[axis], self.index[joint], float(sign), (0.0, 0.0, 0.0))
            case Move(x, y, z):
                return (_MOVE, 0, -1, 1.0, (float(x), float(y), float(z)))
            case Fixed(axis, angle):
                return (_FIXED, AXES[axis], -1, float(angle), (0.0, 0.0, 0.0))

    def tip(self, name: str) -> str:
        """Return the name, if it is one of a tip; `UnknownNameError` lists them."""
        if name not in self.chains:
            raise UnknownNameError(f"tip of {self.name}", name, self.chains)
        return name

    def vector(self, angles: Angles) -> Floats:
        """Return angles as an array in the order of `joints`."""
        if isinstance(angles, Mapping):
            missing = [joint for joint in self.joints if joint not in angles]
            if missing:
                raise CallerError(f"{self.name}: no angle for {', '.join(missing)}")
            return np.array([angles[joint] for joint in self.joints], dtype=np.float64)
        out = np.array(angles, dtype=np.float64)
        if out.shape != (len(self.joints),):
            raise CallerError(f"{self.name} has {len(self.joints)} joints: not {out.shape} angles")
        return out

    # ---- one pose --------------------------------------------------------------------------------------------------

    def _trace(self, tip: str, q: list[float]) -> tuple[list[float], list[list[float]], list[_Mark]]:
        """Return position, axes (columns of the rotation) and the joints passed on the way to a tip."""
        px = py = pz = 0.0
        axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        marks: list[_Mark] = []
        for kind, axis, index, sign, (x, y, z) in self._walks[tip]:
            if kind == _MOVE:
                (ax, ay, az), (bx, by, bz), (cx, cy, cz) = axes
                px += ax * x + bx * y + cx * z
                py += ay * x + by * y + cy * z
                pz += az * x + bz * y + cz * z
                continue
            if kind == _SLIDE:
                ax, ay, az = axes[axis]
                marks.append((index, sign, True, ax, ay, az, px, py, pz))
                way = sign * q[index]
                px += ax * way
                py += ay * way
                pz += az * way
                continue
            if kind == _TURN:
                ax, ay, az = axes[axis]
                marks.append((index, sign, False, ax, ay, az, px, py, pz))
                angle = sign * q[index]
            else:
                angle = sign
            c, s = math.cos(angle), math.sin(angle)
            # Turning about one axis mixes the two that follow it.
            j, k = (axis + 1) % 3, (axis + 2) % 3
            (bx, by, bz), (dx, dy, dz) = axes[j], axes[k]
            axes[j] = [c * bx + s * dx, c * by + s * dy, c * bz + s * dz]
            axes[k] = [c * dx - s * bx, c * dy - s * by, c * dz - s * bz]
        return [px, py, pz], axes, marks

    def forward(self, angles: Angles, tips: Iterable[str] | None = None) -> dict[str, Pose]:
        """Return the pose of every tip (or of some)."""
        q = self.vector(angles).tolist()
        out: dict[str, Pose] = {}
        for tip in self.chains if tips is None else tips:
            position, axes, _ = self._trace(self.tip(tip), q)
            out[tip] = Pose(np.array(position), np.array(axes).T)
        return out

    def jacobian(self, angles: Angles, tip: str) -> Floats:
        """Return (6, number of joints): velocity (m/s) and angular velocity (rad/s) of a tip, in the base,
        per rad/s of a joint.
        """
        return self.pose_and_jacobian(self.vector(angles), tip)[1]

    def pose_and_jacobian(self, q: Floats, tip: str) -> tuple[Pose, Floats]:
        """Return pose and Jacobian at joint angles (rad)."""
        (px, py, pz), axes, marks = self._trace(self.tip(tip), q.tolist())
        out = np.zeros((len(self.joints), 6))
        for index, sign, slides, ax, ay, az, ox, oy, oz in marks:
            if slides:
                out[index] += (sign * ax, sign * ay, sign * az, 0.0, 0.0, 0.0)
                continue
            x, y, z = px - ox, py - oy, pz - oz
            out[index] += (
                sign * (ay * z - az * y),
                sign * (az * x - ax * z),
                sign * (ax * y - ay * x),
                sign * ax,
                sign * ay,
                sign * az,
            )
        return Pose(np.array((px, py, pz)), np.array(axes).T), out.T

    # ---- many poses ------------------------------------------------------------------------------------------------

    def forward_many(self, angles: Floats) -> dict[str, tuple[Floats, Floats]]:
        """Return for (n, number of joints) angles the positions (n, 3) and rotations (n, 3, 3) of every tip."""
        q = np.asarray(angles, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != len(self.joints):
            raise CallerError(f"{self.name} needs (n, {len(self.joints)}) angles, not {q.shape}")
        out: dict[str, tuple[Floats, Floats]] = {}
        for tip, walk in self._walks.items():
            position = np.zeros((len(q), 3))
            rotation = np.tile(np.eye(3), (len(q), 1, 1))
            for kind, axis, index, sign, offset in walk:
                if kind == _MOVE:
                    position += rotation @ np.array(offset)
                elif kind == _SLIDE:
                    position += rotation[:, :, axis] * (sign * q[:, index])[:, None]
                else:
                    angle = sign * q[:, index] if kind == _TURN else np.full(len(q), sign)
                    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
                    j, k = (axis + 1) % 3, (axis + 2) % 3
                    b, d = rotation[:, :, j].copy(), rotation[:, :, k].copy()
                    rotation[:, :, j], rotation[:, :, k] = c * b + s * d, c * d - s * b
            out[tip] = position, rotation
        return out


#: A joint on the way: index, sign, whether it slides, its axis and its origin in the base.
_Mark = tuple[int, float, bool, float, float, float, float, float, float]
