"""Links agree with forward kinematics: what a 3D view draws is where the chains are."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from aces_bus.kinematics import load_body
from aces_bus.kinematics.body import Body, Chain, Fixed, Move, Prismatic, Revolute
from aces_bus.kinematics.links import Links

Floats = npt.NDArray[np.float64]


def rotation(x: float, y: float, z: float, w: float) -> Floats:
    """The matrix of a quaternion."""
    v = np.array((x, y, z))
    cross = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
    return np.asarray((w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross)


def frames_of(links: Links, angles: dict[str, float]) -> dict[str, tuple[Floats, Floats]]:
    """Every frame in the body's own."""
    found: dict[str, tuple[Floats, Floats]] = {links.body.name: (np.zeros(3), np.eye(3))}
    for link in links.at(angles):
        place, turn = found[link.parent]
        found[link.child] = place + turn @ np.array(link.position), turn @ rotation(*link.rotation)
    return found


SLIDER = Body(
    "crane",
    [
        Chain("hook", (Fixed("y", 0.3), Prismatic("x", "boom"), Revolute("z", "swing", -1), Move(0, 1, -2))),
        Chain(
            "lamp",
            (Fixed("y", 0.3), Prismatic("x", "boom"), Move(0, 0, 1), Revolute("x", "swing"), Move(z=1)),
        ),
    ],
)


@pytest.mark.parametrize("body", [load_body("MiniHubo"), SLIDER], ids=lambda body: body.name)
def test_the_links_lead_to_where_the_tips_are(body: Body) -> None:
    """Turned, moved and fixed steps; chains that share their beginning, and joints on two ways."""
    random = np.random.default_rng(5)
    links = Links(body)
    for _ in range(5):
        angles = dict(zip(body.joints, random.uniform(-1.5, 1.5, len(body.joints)).tolist(), strict=True))
        frames = frames_of(links, angles)
        for tip, pose in body.forward(angles).items():
            assert frames[tip][0] == pytest.approx(pose.position, abs=1e-12)
            assert frames[tip][1] == pytest.approx(pose.rotation, abs=1e-12)


def test_each_frame_has_one_name_and_one_frame_before_it() -> None:
    """Also where a joint is on two ways: a tree, as 3D views want it."""
    links = Links(SLIDER).at({"boom": 1.0, "swing": 0.5})
    names = [link.child for link in links]
    assert names == ["boom", "swing", "hook", "swing/lamp", "lamp"]
    assert [link.parent for link in links] == ["crane", "boom", "swing", "boom", "swing/lamp"]


def test_an_unknown_joint_has_no_link() -> None:
    """It is left out, and not drawn at zero."""
    links = Links(SLIDER)
    assert [link.child for link in links.at({"boom": math.nan, "swing": 0.0})] == [
        *("swing", "hook", "swing/lamp", "lamp")
    ]
