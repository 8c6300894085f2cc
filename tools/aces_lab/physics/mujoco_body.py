"""A MuJoCo model as the body that a robot's twins move: `--physics mujoco:model.xml`.

1. Joints of the model (hinge or slide) with the name of one of the robot's are moved by its twin's motor; the model's own
   actuators are idle, and its other joints move freely.
2. A step is a millisecond, cut into as many of the model's own steps as fit; a longer one is shortened to a millisecond.
3. What the model says of a joint's rotor inertia (`armature`) and dry friction (`frictionloss`) stands; where it says
   nothing, the motor's are put in.
4. Sensors of the robot's file whose name a site or body of the model has feel its motion, and what acts on it.
5. It begins at the keyframe `home`, where there is one. Nothing is random: the same torques give the same motion to the bit.

`picture` renders it, where MuJoCo finds a renderer (`MUJOCO_GL=egl` or `osmesa` without a screen).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from aces_bus.device import Robot
from aces_bus.device.physics import Contact
from aces_bus.errors import CallerError

#: The greatest step (s): the motors' own.
STEP_S = 1e-3
MODELS = Path(__file__).parent / "models"
HOME = "home"


def _mujoco() -> Any:
    try:
        import mujoco
    except ImportError as error:
        raise CallerError(
            f"MuJoCo needs the package mujoco: pip install 'aces-bus[physics]' ({error})"
        ) from error
    return mujoco


def mujoco_body(robot: Robot, model: str) -> MujocoBody:
    """Return the body of a file (MJCF, URDF) for a robot; without a file, of the model that ships for it.

    Raises `CallerError` where there is no such file, MuJoCo cannot read it, none ships for the robot, or MuJoCo is missing.
    """
    path = Path(model) if model else MODELS / f"{robot.name}.xml"
    if not path.is_file():
        shipped = ", ".join(sorted(file.stem for file in MODELS.glob("*.xml")))
        what = f"{path}: no such file" if model else f"no MuJoCo model ships for {robot.name}"
        raise CallerError(
            f"--physics mujoco: {what}; name a file (mujoco:model.xml). Models ship for {shipped}"
        )
    try:
        found = _mujoco().MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise CallerError(f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error
    return MujocoBody(found, list(robot.joints))


class MujocoBody:
    """A `Physics` of a `mujoco.MjModel` and the names of a robot's joints. `model` and `data` are MuJoCo's own."""

    def __init__(self, model: Any, joints: Sequence[str]) -> None:
        mj = self._mj = _mujoco()
        self.model, self.data = model, mj.MjData(model)
        one_number = (int(mj.mjtJoint.mjJNT_HINGE), int(mj.mjtJoint.mjJNT_SLIDE))
        numbers = [
            number
            for name in joints
            if (number := mj.mj_name2id(model, mj.mjtObj.mjOBJ_JOINT, name)) >= 0
            and model.jnt_type[number] in one_number
        ]
        self.joints = [mj.mj_id2name(model, mj.mjtObj.mjOBJ_JOINT, number) for number in numbers]
        self._places = np.array([model.jnt_qposadr[number] for number in numbers], dtype=int)
        self._speeds = np.array([model.jnt_dofadr[number] for number in numbers], dtype=int)
        self._steps = max(1, round(STEP_S / model.opt.timestep))
        model.opt.timestep = STEP_S / self._steps
        key = mj.mj_name2id(model, mj.mjtObj.mjOBJ_KEY, HOME)
        if key >= 0:
            mj.mj_resetDataKeyframe(model, self.data, key)
        mj.mj_forward(model, self.data)

    @property
    def positions(self) -> list[float]:
        """See `Physics`."""
        found: list[float] = self.data.qpos[self._places].tolist()
        return found

    @property
    def velocities(self) -> list[float]:
        """See `Physics`."""
        found: list[float] = self.data.qvel[self._speeds].tolist()
        return found

    @property
    def contacts(self) -> list[Contact]:
        """The present contacts, by the names of bodies; `world` is the ground."""
        mj, model, data = self._mj, self.model, self.data
        found: list[Contact] = []
        force = np.zeros(6)
        for number in range(data.ncon):
            contact = data.contact[number]
            mj.mj_contactForce(model, data, number, force)
            bodies = [model.geom_bodyid[geom] for geom in (contact.geom1, contact.geom2)]
            first, second = (mj.mj_id2name(model, mj.mjtObj.mjOBJ_BODY, body) or "" for body in bodies)
            found.append(Contact((first, second), float(force[0])))
        return found

    def pose_of(self, body: str) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return where a body of the model is (m) and its axes as columns, in the world. Raises `CallerError`."""
        mj = self._mj
        number = mj.mj_name2id(self.model, mj.mjtObj.mjOBJ_BODY, body)
        if number < 0:
            raise CallerError(f"the model has no body {body!r}")
        return self.data.xpos[number].copy(), self.data.xmat[number].reshape(3, 3).copy()

    def motion_of(self, part: str) -> tuple[list[list[float]], list[float], list[float]] | None:
        """See `FeelingPhysics`; a part is a site, or else a body, of the model."""
        found = self._part(part)
        if found is None:
            return None
        mj, model, data = self._mj, self.model, self.data
        kind, number, _, turned = found
        mj.mj_rnePostConstraint(model, data)
        velocity, acceleration = np.zeros(6), np.zeros(6)
        mj.mj_objectVelocity(model, data, kind, number, velocity, 1)
        mj.mj_objectAcceleration(model, data, kind, number, acceleration, 1)
        return turned.tolist(), velocity[:3].tolist(), acceleration[3:].tolist()

    def wrench_on(self, part: str) -> tuple[list[float], list[float]] | None:
        """See `FeelingPhysics`: the force between the part's body and the one that carries it, at the part."""
        found = self._part(part)
        if found is None:
            return None
        mj, model, data = self._mj, self.model, self.data
        kind, number, place, turned = found
        body = model.site_bodyid[number] if kind == mj.mjtObj.mjOBJ_SITE else number
        mj.mj_rnePostConstraint(model, data)
        # MuJoCo has torque and force that the carrying body exerts, about the centre of mass of the whole tree.
        carried = data.cfrc_int[body]
        lever = place - data.subtree_com[model.body_rootid[body]]
        torque = carried[:3] - np.cross(lever, carried[3:])
        return (-carried[3:] @ turned).tolist(), (-torque @ turned).tolist()

    def _part(self, name: str) -> tuple[Any, int, npt.NDArray[np.float64], npt.NDArray[np.float64]] | None:
        """Return kind and number of a site or body, where it is, and its axes as columns."""
        mj, data = self._mj, self.data
        number = mj.mj_name2id(self.model, mj.mjtObj.mjOBJ_SITE, name)
        if number >= 0:
            return mj.mjtObj.mjOBJ_SITE, number, data.site_xpos[number], data.site_xmat[number].reshape(3, 3)
        number = mj.mj_name2id(self.model, mj.mjtObj.mjOBJ_BODY, name)
        if number >= 0:
            return mj.mjtObj.mjOBJ_XBODY, number, data.xpos[number], data.xmat[number].reshape(3, 3)
        return None

    def fit(self, joint: int, inertia: float, friction: float) -> None:
        """See `Physics`."""
        model, dof = self.model, self._speeds[joint]
        model.dof_armature[dof] = model.dof_armature[dof] or inertia
        model.dof_frictionloss[dof] = model.dof_frictionloss[dof] or friction
        self._mj.mj_setConst(model, self._mj.MjData(model))  # what MuJoCo derives from inertias

    def place(self, joint: int, position: float) -> None:
        """See `Physics`."""
        self.data.qpos[self._places[joint]] = position
        self.data.qvel[self._speeds[joint]] = 0.0

    def step(self, torques: Sequence[float]) -> None:
        """See `Physics`. Raises `CallerError` where the simulation becomes unstable."""
        data = self.data
        data.qfrc_applied[self._speeds] = torques
        self._mj.mj_step(self.model, data, self._steps)
        if data.warning[self._mj.mjtWarning.mjWARN_BADQACC].number:
            raise CallerError(
                f"MuJoCo: the simulation became unstable at {data.time:.3f} s; give the model a smaller timestep, or"
                " softer gains"
            )

    def picture(self, width: int = 640, height: int = 480, camera: str | int = -1) -> npt.NDArray[np.uint8]:
        """Return what a camera of the model sees, (height, width, 3). Raises `CallerError` without a renderer."""
        try:
            renderer = self._mj.Renderer(self.model, height, width)
        except Exception as error:  # whatever its graphics library raises
            raise CallerError(
                f"MuJoCo finds no renderer: {error}; set MUJOCO_GL to egl or osmesa, and install one of them"
            ) from error
        with renderer:
            renderer.update_scene(self.data, camera)
            found: npt.NDArray[np.uint8] = renderer.render()
        return found
