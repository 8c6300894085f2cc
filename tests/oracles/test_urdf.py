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
from tests.lab.urdf.samples import RODS, TREE

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
