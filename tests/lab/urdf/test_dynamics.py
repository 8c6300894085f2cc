"""Torques of a model: against what is known on paper, and against each other."""

from __future__ import annotations

import math

import numpy as np
import pytest

from aces_bus.kinematics.body import Floats
from aces_lab.urdf import Dynamics, parse_urdf
from tests.lab.urdf.samples import RODS, TREE

G = 9.81


def test_gravity_torques_of_two_rods_are_those_on_paper() -> None:
    """Weight times its lever, whatever the pose; straight down nothing is needed."""
    rods = Dynamics(parse_urdf(RODS))
    for s, e in ((0.0, 0.0), (0.3, -1.2), (-2.0, 0.7)):
        lower = -G * 1.0 * 0.15 * math.cos(s + e)
        upper = -G * (2.0 * 0.2 + 1.0 * 0.4) * math.cos(s) + lower
        np.testing.assert_allclose(rods.gravity_torques({"S": s, "E": e}), (upper, lower), atol=1e-12)
    np.testing.assert_allclose(rods.gravity_torques((math.pi / 2, 0.0)), (0.0, 0.0), atol=1e-12)


def test_the_mass_matrix_of_two_rods_is_that_on_paper() -> None:
    """The textbook's matrix of a double pendulum with inertia."""
    rods = Dynamics(parse_urdf(RODS))
    for e in (0.0, 0.9, -2.1):
        c = math.cos(e)
        m22 = 0.0075 + 0.15**2
        m12 = m22 + 0.4 * 0.15 * c
        m11 = 0.02 + 2 * 0.2**2 + 0.0075 + 0.4**2 + 0.15**2 + 2 * 0.4 * 0.15 * c
        np.testing.assert_allclose(rods.mass_matrix((0.5, e)), ((m11, m12), (m12, m22)), atol=1e-14)


def test_forward_undoes_inverse() -> None:
    """The accelerations under the torques of a motion are that motion's; the mass matrix is symmetric and positive."""
    tree, draw = Dynamics(parse_urdf(TREE)), np.random.default_rng(3)
    for _ in range(10):
        q, v, a = draw.uniform(-2, 2, (3, 4))
        np.testing.assert_allclose(tree.accelerations(q, v, tree.torques(q, v, a)), a, atol=1e-8)
        matrix = tree.mass_matrix(q)
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-14)
        assert np.linalg.eigvalsh(matrix)[0] > 0


def test_energy_is_kept_without_torques() -> None:
    """A tree that falls freely keeps the sum of its kinetic and potential energy; steps of 4 ms, fourth order."""
    model = parse_urdf(TREE)
    tree, still = Dynamics(model), np.zeros(4)

    def energy(q: Floats, v: Floats) -> float:
        potential = 0.0
        for link, frame in tree.frames(q).items():
            inertia = model.links[link].inertia
            if inertia is not None:
                potential += inertia.mass * G * float(frame[2, :3] @ inertia.origin.xyz + frame[2, 3])
        return potential + 0.5 * float(v @ tree.mass_matrix(q) @ v)

    def slope(x: Floats) -> Floats:
        return np.concatenate((x[4:], tree.accelerations(x[:4], x[4:], still)))

    x, h = np.array((0.3, 0.5, 0.01, 0.0, 1.0, -2.0, 0.1, 3.0)), 4e-3
    before = energy(x[:4], x[4:])
    for _ in range(20):
        k1 = slope(x)
        k2 = slope(x + h / 2 * k1)
        k3 = slope(x + h / 2 * k2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + h * k3))
    assert abs(x[:4] - (0.3, 0.5, 0.01, 0.0)).max() > 0.05
    assert energy(x[:4], x[4:]) == pytest.approx(before, abs=1e-5)


def test_gravity_may_have_another_direction() -> None:
    """On the moon, or hung on a wall: the vector is in the root's axes."""
    model = parse_urdf(RODS)
    here, moon = Dynamics(model), Dynamics(model, (0.0, 0.0, -1.62))
    np.testing.assert_allclose(
        moon.gravity_torques((0.3, 0.4)) * 9.81, here.gravity_torques((0.3, 0.4)) * 1.62
    )
    assert not Dynamics(model, (0.0, 9.81, 0.0)).gravity_torques((0.3, 0.4)).any()


def test_a_model_without_joints_or_masses_has_torques() -> None:
    """A lone link has none; joints that carry nothing need none."""
    assert Dynamics(parse_urdf('<robot name="r"><link name="a"/></robot>')).gravity_torques(()).shape == (0,)
    bare = parse_urdf(RODS.replace("<inertial>", "<visual>").replace("</inertial>", "</visual>"))
    assert Dynamics(bare).gravity_torques((0.1, 0.2)).tolist() == [0.0, 0.0]
