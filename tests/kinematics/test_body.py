"""Forward kinematics and Jacobians of chains."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.kinematics.body import Body, Chain, Fixed, Move, Prismatic, Revolute

ARM = Body(
    "arm",
    [
        Chain(
            "hand",
            (
                Revolute("z", "S"),
                Move(0.3),
                Revolute("y", "E", -1),
                Prismatic("x", "R"),
                Revolute("x", "W"),
                Move(0.2, 0.1),
            ),
        ),
        Chain("elbow", (Revolute("z", "S"), Move(0.3))),
        Chain("eye", (Fixed("y", 0.4), Revolute("z", "S"), Move(0, 0, 0.1), Revolute("z", "S", 0.5))),
    ],
)
angles = st.lists(st.floats(-3, 3), min_size=4, max_size=4)


def test_a_straight_arm_is_as_long_as_its_links() -> None:
    """At zero the moves add up, and the tip's axes are the base's."""
    pose = ARM.forward([0, 0, 0, 0])["hand"]
    assert pose.position.tolist() == [0.5, 0.1, 0.0]
    assert pose.rotation.tolist() == np.eye(3).tolist()


def test_turns_are_right_handed() -> None:
    """A quarter turn about z takes x to y; about y, z to x; about x, y to z."""
    for axis, expected in (("z", (0, 1, 0)), ("y", (0, 0, -1)), ("x", (1, 0, 0))):
        body = Body("one", [Chain("tip", (Revolute(axis, "q"), Move(1)))])  # type: ignore[arg-type]
        assert np.allclose(body.forward([math.pi / 2])["tip"].position, expected)


@given(angles)
def test_many_poses_equal_one_by_one(q: list[float]) -> None:
    """Arrays of poses give the numbers of single ones."""
    many = ARM.forward_many(np.array([q, [0.1, 0.2, 0.3, 0.4]]))
    for tip, pose in ARM.forward(q).items():
        assert np.allclose(many[tip][0][0], pose.position, atol=1e-12)
        assert np.allclose(many[tip][1][0], pose.rotation, atol=1e-12)


@given(angles)
def test_a_rotation_is_one(q: list[float]) -> None:
    """Orthonormal and right-handed, whatever the angles."""
    for pose in ARM.forward(q).values():
        assert np.allclose(pose.rotation.T @ pose.rotation, np.eye(3), atol=1e-12)
        assert math.isclose(float(np.linalg.det(pose.rotation)), 1.0)


@given(angles)
def test_the_jacobian_is_the_derivative(q: list[float]) -> None:
    """Central differences of position and rotation agree with every column, shared and repeated joints too."""
    step = 1e-6
    for tip in ARM.tips:
        jacobian = ARM.jacobian(q, tip)
        for i in range(4):
            up, down = list(q), list(q)
            up[i] += step
            down[i] -= step
            a, b = ARM.forward(up)[tip], ARM.forward(down)[tip]
            assert np.allclose((a.position - b.position) / (2 * step), jacobian[:3, i], atol=1e-8)
            spin = (a.rotation - b.rotation) / (2 * step) @ ARM.forward(q)[tip].rotation.T
            assert np.allclose((spin[2, 1], spin[0, 2], spin[1, 0]), jacobian[3:, i], atol=1e-8)


def test_angles_go_by_name_or_by_order() -> None:
    """A mapping and a vector say the same; a missing joint and a wrong length are named."""
    by_name = ARM.forward({"R": 0.3, "S": 0.1, "W": 0.4, "E": 0.2})
    assert np.array_equal(by_name["hand"].position, ARM.forward([0.1, 0.2, 0.3, 0.4])["hand"].position)
    with pytest.raises(CallerError, match="no angle for W"):
        ARM.forward({"R": 0.3, "S": 0.1, "E": 0.2})
    with pytest.raises(CallerError, match="4 joints"):
        ARM.forward([0.1])
    with pytest.raises(CallerError, match=r"\(n, 4\)"):
        ARM.forward_many(np.zeros((2, 3)))


def test_names_that_do_not_exist_are_found_at_definition() -> None:
    """Of joints in limits and posture, and of tips; the message lists those that exist."""
    chain = Chain("tip", (Revolute("z", "q"),))
    with pytest.raises(UnknownNameError, match="there are: q"):
        Body("b", [chain], limits={"p": (0, 1)})
    with pytest.raises(UnknownNameError, match="there are: q"):
        Body("b", [chain], posture={"p": 0.1})
    with pytest.raises(UnknownNameError, match="there are: r"):
        Body("b", [chain], joints=["r"])
    with pytest.raises(CallerError, match="leave nothing"):
        Body("b", [chain], limits={"q": (1, 0)})
    with pytest.raises(UnknownNameError, match="there are: elbow, eye, hand"):
        ARM.forward([0, 0, 0, 0], ["foot"])
