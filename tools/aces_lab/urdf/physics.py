"""A URDF model as the body that a robot's twins move: `--physics urdf`, gravity without MuJoCo.

1. The root stands still, nothing touches anything: arms and legs with weight, no ground.
2. A step is a millisecond, semi-implicit: accelerations of the exact dynamics, then speeds, then positions.
3. Nothing is random. Joints stop at the URDF's limits, without bouncing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from aces_bus.device import Robot
from aces_bus.device.physics import Contact
from aces_bus.errors import CallerError

from .dynamics import Dynamics
from .model import UrdfModel
from .read import read_urdf
from .robots import model_of_robot

STEP_S = 1e-3


def urdf_physics(robot: Robot, path: str = "") -> UrdfPhysics:
    """Return the physics of a URDF file, or of the robot's own body. Raises `CallerError`."""
    return UrdfPhysics(read_urdf(path) if path else model_of_robot(robot))


class UrdfPhysics:
    """A `Physics` of a model. `push` are torques (N·m, N) of somebody who pushes, by joint."""

    def __init__(self, model: UrdfModel) -> None:
        if all(link.inertia is None for link in model.links.values()):
            raise CallerError(f"{model.name} has no inertias: its links have no weight, and nothing to move")
        if free := next((joint.part_of for joint in model.joints.values() if joint.part_of), ""):
            raise CallerError(
                f"{model.name}: joint {free} is moved by nothing, and there is no ground here: take --physics mujoco"
            )
        self.dynamics, self.joints = Dynamics(model), model.moving
        self.push = dict.fromkeys(self.joints, 0.0)
        self.contacts: Sequence[Contact] = ()
        size = len(self.joints)
        self._q, self._v = np.zeros(size), np.zeros(size)
        self._rotors, self._friction = np.zeros(size), np.zeros(size)

    @property
    def positions(self) -> list[float]:
        """The joints' positions (rad, m)."""
        return self._q.tolist()

    @property
    def velocities(self) -> list[float]:
        """The joints' velocities (rad/s, m/s)."""
        return self._v.tolist()

    def fit(self, joint: int, inertia: float, friction: float) -> None:
        """Put a motor at a joint: the inertia of its rotor (kg·m²) and its dry friction (N·m)."""
        self._rotors[joint], self._friction[joint] = inertia, friction

    def place(self, joint: int, position: float) -> None:
        """Put a joint somewhere (rad, m), at rest."""
        self._q[joint], self._v[joint] = position, 0.0

    def step(self, torques: Sequence[float]) -> None:
        """Live for a millisecond. Raises `CallerError` for a joint that moves no mass."""
        rest, masses = self.dynamics.rest_and_masses(self._q, self._v)
        masses += np.diag(self._rotors)
        try:
            inverse = np.linalg.inv(masses)
        except np.linalg.LinAlgError as error:
            raise CallerError(f"{self.dynamics.model.name}: a joint moves no mass, and no rotor") from error
        v = self._v + STEP_S * (inverse @ (np.array(torques) + list(self.push.values()) - rest))
        # Friction stops at most what moves: at each joint as if the others stood still.
        v -= np.sign(v) * np.minimum(np.abs(v), STEP_S * self._friction / np.diag(masses))
        q, body = self._q + STEP_S * v, self.dynamics.model.body
        stopped = ((q > body.upper) & (v > 0)) | ((q < body.lower) & (v < 0))
        self._v = np.where(stopped, 0.0, v)
        self._q = np.where(stopped, np.clip(q, body.lower, body.upper), q)
