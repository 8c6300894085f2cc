"""Torques that move a mechanism, or hold it: inverse dynamics of a model whose root does not move.

1. Exact: Newton and Euler for every link, all in the root's axes; nothing is approximated, no term left out.
2. Positions, speeds and torques are in the order of `UrdfModel.moving`; joints that mimic pass their torque on.
3. Friction and the inertia of rotors are not in a URDF file's links, and not here.

Theory: what a link inherits from the joints before it is a sum over these, what a joint carries a sum over the links behind
it. Both are a product with the matrix that says which joint is before which link. Moments are about the root's origin, so
that the wrenches of links may be added as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from aces_bus.kinematics.body import Angles, Floats, rotation_of

from .model import UrdfModel, UrdfOrigin

#: m/s² in the root's axes, z up: what pinocchio and MuJoCo take, where nobody says another.
GRAVITY: Final = (0.0, 0.0, -9.81)


class Dynamics:
    """A model's torques.

    >>> from aces_lab.urdf import Inertia, UrdfJoint, UrdfLink, UrdfModel
    >>> rod = UrdfLink("rod", Inertia(2.0, UrdfOrigin((0.5, 0.0, 0.0))))
    >>> arm = UrdfModel("arm", [UrdfLink("base"), rod], [UrdfJoint("S", "continuous", "base", "rod", axis=(0, 1, 0))])
    >>> Dynamics(arm).gravity_torques({"S": 0.0})  # 2 kg, 0.5 m away: held by a turn about y, downwards negative
    array([-9.81])

    `gravity` in m/s², in the root's axes.
    """

    def __init__(self, model: UrdfModel, gravity: Sequence[float] = GRAVITY) -> None:
        self.model, self.gravity = model, np.array(gravity, dtype=np.float64)
        order = model.order
        places = {joint.child: place for place, joint in enumerate(order)}
        #: Where each joint's parent is; -1: the root.
        self._parents = [places.get(joint.parent, -1) for joint in order]
        #: [link, joint]: whether the joint is before the link, or its own.
        self._before = np.eye(len(order))
        for place, parent in enumerate(self._parents):
            if parent >= 0:
                self._before[place] += self._before[parent]
        self._origins = np.array([_frame(joint.origin) for joint in order]).reshape(-1, 4, 4)
        axes = np.array([joint.axis for joint in order]).reshape(-1, 3)
        self._skew = np.zeros((len(order), 3, 3))
        for (row, column), (axis, sign) in _SKEW.items():
            self._skew[:, row, column] = sign * axes[:, axis]
        self._axes = axes
        self._turns = np.array([joint.kind in ("revolute", "continuous") for joint in order], dtype=bool)
        self._slides = np.array([joint.kind == "prismatic" for joint in order], dtype=bool)
        #: [joint, moving joint]: how fast a joint moves with each of those that move of themselves; and where it is at 0.
        self._drives = np.zeros((len(order), len(model.moving)))
        self._offsets = np.zeros(len(order))
        for place, joint in enumerate(order):
            if joint.kind != "fixed":
                name, multiplier, self._offsets[place] = model.drives[joint.name]
                self._drives[place, model.moving.index(name)] = multiplier
        inertias = [model.links[joint.child].inertia for joint in order]
        self._masses = np.array([0.0 if i is None else i.mass for i in inertias])
        centers = [_frame(UrdfOrigin() if i is None else i.origin) for i in inertias]
        self._centers = np.array([frame[:3, 3] for frame in centers]).reshape(-1, 3)
        self._moments = np.array(
            [
                frame[:3, :3] @ _symmetric((0.0,) * 6 if i is None else i.moments) @ frame[:3, :3].T
                for frame, i in zip(centers, inertias, strict=True)
            ]
        ).reshape(-1, 3, 3)

    def frames(self, angles: Angles) -> dict[str, Floats]:
        """Return where every link is: (4, 4) in the root's frame, by the link's name."""
        found = self._frames(self.model.body.vector(angles))
        names = [joint.child for joint in self.model.order]
        return {self.model.root: np.eye(4), **dict(zip(names, found, strict=True))}

    def gravity_torques(self, angles: Angles) -> Floats:
        """Return the torques (N·m; N of a joint that slides) that hold the mechanism still."""
        nothing = np.zeros(len(self.model.moving))
        return self._torques(self.model.body.vector(angles), nothing, nothing, self.gravity)

    def torques(self, angles: Angles, speeds: Angles, accelerations: Angles) -> Floats:
        """Return the torques (N·m, N) under which joints at `angles` with `speeds` (rad/s, m/s) have `accelerations`."""
        vector = self.model.body.vector
        return self._torques(vector(angles), vector(speeds), vector(accelerations), self.gravity)

    def mass_matrix(self, angles: Angles) -> Floats:
        """Return (n, n): the torque (N·m, N) of each joint for an acceleration of 1 rad/s² (m/s²) of another."""
        number = len(self.model.moving)
        still = np.zeros((number, number))
        return self._torques(self.model.body.vector(angles), still, np.eye(number), np.zeros(3))

    def rest_and_masses(self, angles: Angles, speeds: Angles) -> tuple[Floats, Floats]:
        """Return the torques of a motion without acceleration, and the mass matrix: both at once, for simulations."""
        vector, size = self.model.body.vector, len(self.model.moving)
        v, a, gravity = np.zeros((size + 1, size)), np.zeros((size + 1, size)), np.zeros((size + 1, 1, 3))
        v[0], a[1:], gravity[0, 0] = vector(speeds), np.eye(size), self.gravity
        found = self._torques(vector(angles), v, a, gravity)
        return found[0], found[1:]

    def accelerations(self, angles: Angles, speeds: Angles, torques: Angles) -> Floats:
        """Return how the joints accelerate (rad/s², m/s²) under torques (N·m, N): forward dynamics.

        Raises `numpy.linalg.LinAlgError` for a joint that moves no mass.
        """
        rest, masses = self.rest_and_masses(angles, speeds)
        wanted: Floats = self.model.body.vector(torques) - rest
        return np.asarray(np.linalg.solve(masses, wanted), dtype=np.float64)

    # ---- inside ----------------------------------------------------------------------------------------------------

    def _frames(self, q: Floats) -> Floats:
        values = self._drives @ q + self._offsets
        moves = np.tile(np.eye(4), (len(values), 1, 1))
        angle = np.where(self._turns, values, 0.0)[:, None, None]
        moves[:, :3, :3] += np.sin(angle) * self._skew + (1 - np.cos(angle)) * (self._skew @ self._skew)
        moves[:, :3, 3] = np.where(self._slides, values, 0.0)[:, None] * self._axes
        found = self._origins @ moves
        for place, parent in enumerate(self._parents):
            if parent >= 0:
                found[place] = found[parent] @ found[place]
        return found

    def _torques(self, q: Floats, v: Floats, a: Floats, gravity: Floats) -> Floats:
        """Return torques for speeds and accelerations (…, n), of which there may be many."""
        frames = self._frames(q)
        rotations, places = frames[:, :3, :3], frames[:, :3, 3]
        axes = (rotations @ self._axes[:, :, None])[:, :, 0]
        centers = places + (rotations @ self._centers[:, :, None])[:, :, 0]
        moments = rotations @ self._moments @ rotations.transpose(0, 2, 1)
        parents = np.array(self._parents, dtype=np.intp)
        is_inner = (parents >= 0)[:, None]
        way = places - np.where(is_inner, places[parents], 0.0)
        rate, change = (v @ self._drives.T)[..., None] * axes, (a @ self._drives.T)[..., None] * axes
        turns, slides = self._turns[:, None], self._slides[:, None]
        spin = self._before @ np.where(turns, rate, 0.0)
        spin_before = np.where(is_inner, spin[..., parents, :], 0.0)
        twist = self._before @ np.where(turns, change + _cross(spin_before, rate), 0.0)
        twist_before = np.where(is_inner, twist[..., parents, :], 0.0)
        pull = self._before @ (
            _cross(twist_before, way)
            + _cross(spin_before, _cross(spin_before, way))
            + np.where(slides, change + 2 * _cross(spin_before, rate), 0.0)
        )
        arm = centers - places
        force = self._masses[:, None] * (
            pull - gravity + _cross(twist, arm) + _cross(spin, _cross(spin, arm))
        )
        turned = (moments @ spin[..., None])[..., 0]
        moment = (moments @ twist[..., None])[..., 0] + _cross(spin, turned) + _cross(centers, force)
        behind = self._before.T
        carried, held = behind @ force, behind @ moment
        along = np.where(slides, carried, held - _cross(places, carried))
        found: Floats = (along * axes).sum(axis=-1) @ self._drives
        return found


#: The matrix of a cross product: its place → which part of the vector, and its sign.
_SKEW: Final = {
    (0, 1): (2, -1),
    (0, 2): (1, 1),
    (1, 0): (2, 1),
    (1, 2): (0, -1),
    (2, 0): (1, -1),
    (2, 1): (0, 1),
}


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the cross products of (…, 3), three times as fast as NumPy's own."""
    return np.stack(
        (
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ),
        axis=-1,
    )


def _frame(origin: UrdfOrigin) -> Floats:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation_of(*origin.rpy), origin.xyz
    return found


def _symmetric(moments: Sequence[float]) -> Floats:
    xx, xy, xz, yy, yz, zz = moments
    return np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)))
