"""Kinematics and torques of URDF files against pinocchio's, on the public models of `example-robot-data`.

`make test-urdf` installs both (170 MB) and runs this; see docs/urdf.md.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aces_bus.errors import CallerError
from aces_devices.robots import import_robot
from aces_lab.urdf import Dynamics, parse_urdf, read_urdf, urdf_text
from tests.lab.urdf.samples import FREE, RODS, TREE

pin: Any = pytest.importorskip("pinocchio", reason="pinocchio is not installed: make test-urdf")
cmeel: Any = pytest.importorskip("cmeel", reason="example-robot-data is not installed: make test-urdf")

#: The wheel's models: 69 of 6.0.0.
MODELS = Path(next(iter(cmeel.__path__))).parent / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
FILES = sorted(path.relative_to(MODELS).as_posix() for path in MODELS.rglob("*.urdf"))
#: UrdfModel → why it is refused.
REFUSED = {
    # Some of its joints mimic one that it has not.
    "alex_description/urdf/alex_psyonic_hands.urdf": "no joint of alex_psyonic_hands named 'index_q1'",
    "ur_description/urdf/ur3.urdf": "no <link>",  # what is left of a xacro file; pinocchio refuses it, too
}
POSES = 10

if not FILES:
    pytest.skip("example-robot-data is not installed: make test-urdf", allow_module_level=True)


def compare(path: str) -> dict[str, float]:
    """Return the largest differences over some poses: m and shares of a rotation; torques by the largest."""
    model = read_urdf(path)
    dynamics, other = Dynamics(model), pin.buildModelFromUrdf(path)
    data, size = other.createData(), len(model.moving)
    draw = np.random.default_rng(7)
    worst: dict[str, float] = {"frames": 0.0, "tips": 0.0, "gravity": 0.0, "motion": 0.0, "mass": 0.0}

    def note(what: str, found: Any, wanted: Any) -> None:
        largest = float(np.abs(wanted).max(initial=0.0)) if what not in ("frames", "tips") else 1.0
        apart = float(np.abs(np.subtract(found, wanted)).max(initial=0.0))
        worst[what] = max(worst[what], apart / largest if largest else apart)

    for _ in range(POSES):
        q, v, a = draw.uniform(-2.0, 2.0, (3, size))
        # Pinocchio moves joints that mimic like any other: they get their value here; their torque goes to what they follow.
        there = np.zeros(other.nq)
        follows = np.zeros((other.nv, size))
        for name, (leader, multiplier, offset) in model.drives.items():
            joint, place = other.joints[other.getJointId(name)], model.moving.index(leader)
            value = multiplier * q[place] + offset
            there[joint.idx_q : joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else (np.cos(value), np.sin(value))
            )
            follows[joint.idx_v, place] = multiplier
        rate, change = follows @ v, follows @ a
        pin.framesForwardKinematics(other, data, there)
        frames, tips = dynamics.frames(q), model.body.forward(q)
        for index, frame in enumerate(other.frames):
            if frame.type == pin.FrameType.BODY and frame.name in frames:
                wanted = data.oMf[index].homogeneous
                note("frames", frames[frame.name], wanted)
                if frame.name in tips:
                    note("tips", tips[frame.name].position, wanted[:3, 3])
                    note("tips", tips[frame.name].rotation, wanted[:3, :3])
        note(
            "gravity",
            dynamics.gravity_torques(q),
            follows.T @ pin.computeGeneralizedGravity(other, data, there),
        )
        note("motion", dynamics.torques(q, v, a), follows.T @ pin.rnea(other, data, there, rate, change))
        upper = np.triu(pin.crba(other, data, there))
        note("mass", dynamics.mass_matrix(q), follows.T @ (upper + np.triu(upper, 1).T) @ follows)
    return worst


@pytest.mark.parametrize("name", [name for name in FILES if name not in REFUSED])
def test_a_public_model_is_as_pinocchio_has_it(name: str) -> None:
    """Forward kinematics within 1e-12; gravity torques, torques of a motion and masses within 1e-9 of the largest."""
    worst = compare(str(MODELS / name))
    assert max(worst["frames"], worst["tips"]) < 1e-12
    assert max(worst["gravity"], worst["motion"], worst["mass"]) < 1e-9


@pytest.mark.parametrize("name", [name for name in FILES if name not in REFUSED])
def test_a_public_model_is_written_and_imported(name: str) -> None:
    """Written and read again it is equal; imported it is a robot with its joints, limits and speeds."""
    model = read_urdf(str(MODELS / name))
    again = parse_urdf(urdf_text(model))
    assert (again.links, again.joints) == (model.links, model.joints)
    if model.moving:
        assert tuple(import_robot([MODELS / name]).robot.joints) == model.moving


def test_at_least_60_models_agree() -> None:
    """Those that are refused are named above, each with its reason."""
    assert len(FILES) - len(REFUSED) >= 60


@pytest.mark.parametrize(("name", "why"), REFUSED.items())
def test_a_model_that_is_refused_is_broken(name: str, why: str) -> None:
    """The reason is in the file."""
    with pytest.raises(CallerError) as caught:
        read_urdf(str(MODELS / name))
    assert why in str(caught.value)


@pytest.mark.parametrize("text", [TREE, RODS], ids=["tree", "rods"])
def test_what_we_write_pinocchio_reads(text: str, tmp_path: Path) -> None:
    """A model of ours, written, has the same kinematics and torques there."""
    path = tmp_path / "ours.urdf"
    path.write_text(urdf_text(parse_urdf(text)), encoding="utf-8")
    worst = compare(str(path))
    assert max(worst.values()) < 1e-12


def test_floating_and_planar_joints_are_as_pinocchio_has_them(tmp_path: Path) -> None:
    """A free flyer and a glider on a plane: frames within 1e-12, gravity torques within 1e-9 of the largest."""
    path = tmp_path / "free.urdf"
    path.write_text(FREE, encoding="utf-8")
    model, other = read_urdf(str(path)), pin.buildModelFromUrdf(str(path))
    dynamics, data, draw = Dynamics(model), other.createData(), np.random.default_rng(7)
    for _ in range(POSES):
        q = draw.uniform(-1.4, 1.4, len(model.moving))
        by_name = dict(zip(model.moving, q, strict=True))
        place = np.array([by_name[f"sea_{part}"] for part in "xyz"])
        yaw, pitch, roll = (by_name[f"sea_{part}"] for part in ("yaw", "pitch", "roll"))
        about_z, about_y = pin.rpy.rpyToMatrix(0.0, 0.0, yaw), pin.rpy.rpyToMatrix(0.0, pitch, 0.0)
        turned, turn = pin.rpy.rpyToMatrix(roll, pitch, yaw), by_name["floor_yaw"]
        plane = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        values = {
            "sea": np.concatenate((place, pin.Quaternion(turned).coeffs())),
            "boom": np.array((np.cos(by_name["boom"]), np.sin(by_name["boom"]))),
            "floor": np.array((by_name["floor_x"], by_name["floor_y"], np.cos(turn), np.sin(turn))),
        }
        # Pinocchio's speeds are along the axes of the body that moves.
        moves = {
            "sea": np.block(
                [
                    [turned.T, np.zeros((3, 3))],
                    [
                        np.zeros((3, 3)),
                        turned.T
                        @ np.column_stack(([0, 0, 1], about_z @ [0, 1, 0], about_z @ about_y @ [1, 0, 0])),
                    ],
                ]
            ),
            "boom": np.eye(1),
            "floor": np.block([[plane, np.zeros((2, 1))], [np.zeros((1, 2)), np.eye(1)]]),
        }
        there, follows = np.zeros(other.nq), np.zeros((other.nv, len(q)))
        for name, value in values.items():
            joint = other.joints[other.getJointId(name)]
            there[joint.idx_q : joint.idx_q + joint.nq] = value
            ours = [
                n for n, moving in enumerate(model.moving) if moving == name or moving.startswith(f"{name}_")
            ]
            follows[joint.idx_v : joint.idx_v + joint.nv, ours] = moves[name]
        pin.framesForwardKinematics(other, data, there)
        frames = dynamics.frames(q)
        for name in ("ship", "mast", "sled"):
            wanted = data.oMf[other.getFrameId(name)].homogeneous
            np.testing.assert_allclose(frames[name], wanted, atol=1e-12)
        gravity = follows.T @ pin.computeGeneralizedGravity(other, data, there)
        np.testing.assert_allclose(dynamics.gravity_torques(q), gravity, atol=1e-9 * np.abs(gravity).max())
