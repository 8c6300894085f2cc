"""URDF files as models and bodies, and what strangers may write into one."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from aces_bus.errors import CallerError
from aces_bus.kinematics import load_body
from aces_bus.kinematics.body import Body, Chain, Fixed, Move, Prismatic, Revolute, rotation_of
from aces_lab.cartesian import Goal, solve
from aces_lab.urdf import Dynamics, UrdfModel, model_of_body, parse_urdf, urdf_text
from aces_lab.urdf.physics import UrdfPhysics
from tests.lab.urdf.samples import FREE, RODS, TREE


def same(a: UrdfModel, b: UrdfModel) -> bool:
    """Whether two models have the same links and joints, in the same order."""
    return list(a.links.items()) == list(b.links.items()) and list(a.joints.items()) == list(b.joints.items())


def test_a_tree_has_the_joints_limits_and_inertias_of_its_file() -> None:
    """Joints that move of themselves, ranges, speeds, what mimics what; shapes and transmissions are passed over."""
    tree = parse_urdf(TREE)
    assert tree.moving == ("waist", "shoulder", "grip", "wheel")
    assert tree.body.tips == ("thumb", "tip", "wheel")
    assert (tree.body.lower.tolist(), tree.body.upper.tolist()) == (
        [-1.5, -math.inf, 0.0, -math.inf],
        [1.25, math.inf, 0.04, math.inf],
    )
    waist = tree.joints["waist"]
    assert (waist.velocity, waist.effort, waist.damping, waist.friction) == (3.0, 40.0, 0.1, 0.02)
    assert tree.joints["shoulder"].axis == pytest.approx((1 / 3, 2 / 3, -2 / 3))
    assert tree.drives["curl"] == ("shoulder", -0.5, 0.3)
    trunk = tree.links["trunk"].inertia
    assert trunk is not None
    assert (trunk.mass, trunk.moments[5]) == (4.5, 0.02)
    assert tree.links["floor"].inertia is None


def test_chains_and_frames_agree() -> None:
    """The body's forward kinematics, of one pose and of many, is where the frames of all links are."""
    tree = parse_urdf(TREE)
    dynamics = Dynamics(tree)
    angles = np.random.default_rng(1).uniform(-2, 2, (20, len(tree.moving)))
    many = tree.body.forward_many(angles)
    for row, q in enumerate(angles):
        frames = dynamics.frames(q)
        for tip, pose in tree.body.forward(q).items():
            np.testing.assert_allclose(pose.position, frames[tip][:3, 3], atol=1e-14)
            np.testing.assert_allclose(pose.rotation, frames[tip][:3, :3], atol=1e-14)
            np.testing.assert_allclose(many[tip][0][row], pose.position, atol=1e-14)


def test_jacobians_of_joints_that_mimic_are_the_slopes_of_the_pose() -> None:
    """A tip's velocity per joint counts all that the joint moves."""
    body, h = parse_urdf(TREE).body, 1e-6
    q = np.array((0.3, -0.4, 0.02, 0.0))
    for tip in body.tips:
        found = body.jacobian(q, tip)[:3]
        for column in range(4):
            step = np.eye(4)[column] * h
            slope = (body.forward(q + step)[tip].position - body.forward(q - step)[tip].position) / (2 * h)
            np.testing.assert_allclose(found[:, column], slope, atol=1e-8)


def test_a_file_is_reached_by_cartesian_goals() -> None:
    """The inverse of `aces_lab.cartesian` works on a body that comes from a file, within its limits."""
    body = parse_urdf(RODS).body
    found = solve(body, [Goal("tip", (0.5, 0.0, 0.2))], (0.2, 0.4))
    assert found.converged
    assert body.forward(found.vector)["tip"].position == pytest.approx((0.5, 0.0, 0.2), abs=1e-4)


def test_floating_and_planar_joints_are_joints_of_one_axis() -> None:
    """Along the axes of their frame, then yaw, pitch and roll; in a robot's file they are not, as nothing drives them."""
    free = parse_urdf(FREE)
    sea = ("sea_x", "sea_y", "sea_z", "sea_yaw", "sea_pitch", "sea_roll")
    assert free.moving == (*sea, "boom", "floor_x", "floor_y", "floor_yaw")
    assert {joint.part_of for joint in free.joints.values()} == {"sea", "", "floor"}
    q = dict.fromkeys(free.moving, 0.0) | dict(zip(sea, (1.0, 2.0, 3.0, 0.3, -0.2, 0.1), strict=True))
    before = Dynamics(free).frames(np.zeros(len(q)))["ship"]
    after = Dynamics(free).frames(np.array(list(q.values())))["ship"]
    moved = np.linalg.inv(before) @ after
    np.testing.assert_allclose(moved[:3, 3], (1.0, 2.0, 3.0), atol=1e-14)
    np.testing.assert_allclose(moved[:3, :3], rotation_of(0.1, -0.2, 0.3), atol=1e-14)
    again = parse_urdf(urdf_text(free))
    assert (again.moving, list(again.links)) == (free.moving, list(free.links))
    with pytest.raises(CallerError, match="joint sea is moved by nothing, and there is no ground here"):
        UrdfPhysics(free)


@pytest.mark.parametrize("axis", ["1 0 0", "0 1 0", "0 0 -1", "1 2 -2", "-0.3 0 0.1"])
def test_a_plane_is_the_one_on_which_the_axis_stands(axis: str) -> None:
    """Sliding never leaves it, and turning leaves the axis where it is; the frame is right-handed."""
    free = parse_urdf(
        FREE.replace('<axis xyz="0 0 1"/>\n  </joint>\n</robot>', f'<axis xyz="{axis}"/></joint></robot>')
    )
    names, normal = list(free.moving), np.array([float(word) for word in axis.split()])
    normal /= np.linalg.norm(normal)

    def sled(**values: float) -> npt.NDArray[np.float64]:
        q = np.zeros(len(names))
        for name, value in values.items():
            q[names.index(name)] = value
        frame: npt.NDArray[np.float64] = Dynamics(free).frames(q)["sled"]
        return frame

    start = np.linalg.inv(sled())
    x, y = ((start @ sled(**{name: 1.0}))[:3, 3] for name in ("floor_x", "floor_y"))
    np.testing.assert_allclose(np.cross(x, y), normal, atol=1e-14)
    turned = (start @ sled(floor_yaw=0.7))[:3, :3]
    np.testing.assert_allclose(turned @ normal, normal, atol=1e-14)
    np.testing.assert_allclose(turned @ x, math.cos(0.7) * x + math.sin(0.7) * y, atol=1e-14)


def test_written_and_read_again_a_model_is_equal() -> None:
    """All numbers, names and inertias survive; names may hold what XML has to escape."""
    tree = parse_urdf(TREE.replace('"grip"', '"grip &lt;&quot;1&quot;&amp;&gt;"'))
    assert 'grip <"1"&>' in tree.moving
    assert same(parse_urdf(urdf_text(tree)), tree)


def test_a_body_of_chains_becomes_a_model_with_the_same_kinematics() -> None:
    """Chains share what they have in common; a joint that another step uses again is followed by a mimic."""
    both = (Move(0, 0, 1), Revolute("z", "waist"))
    left = (
        Move(0, 0.2, 0),
        Fixed("x", 0.3),
        Revolute("y", "LP", -1),
        Move(0.1),
        Revolute("y", "LP", 0.5),
        Move(0, 0, -1),
    )
    body = Body(
        "pair",
        [Chain("L", (*both, *left)), Chain("R", (*both, Prismatic("x", "RS"), Move(z=2)))],
        limits={"RS": (0.0, 0.3)},
    )
    model = parse_urdf(urdf_text(model_of_body(body)))
    assert (model.moving, sum(joint.kind == "fixed" for joint in model.joints.values())) == (
        ("waist", "LP", "RS"),
        2,
    )
    q = {"waist": 0.4, "LP": -0.7, "RS": 0.2}
    for tip, pose in body.forward(q).items():
        np.testing.assert_allclose(model.body.forward(q)[tip].position, pose.position, atol=1e-14)
        np.testing.assert_allclose(model.body.forward(q)[tip].rotation, pose.rotation, atol=1e-14)
    for name in ("MiniHubo",):
        shipped = load_body(name)
        again, angles = model_of_body(shipped).body, np.linspace(-1, 1, len(shipped.joints))
        for tip, pose in shipped.forward(angles).items():
            there = again.forward(dict(zip(shipped.joints, angles, strict=True)))[tip]
            np.testing.assert_allclose(there.position, pose.position, atol=1e-14)


LINKS = '<link name="a"/><link name="b"/><link name="c"/>'


def joint(name: str, parent: str, child: str, rest: str = "", kind: str = "continuous") -> str:
    """A joint's text."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{rest}</joint>'
    )


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ("", "no <link>"),
        ("<link/>", "name='' is not a name"),
        ('<link name="a&#10;b"/>', "is not a name"),
        (f'<link name="{"x" * 101}"/>', "is not a name"),
        ('<link name="a"/><link name="a"/>', "two links are named a"),
        ('<link name="a"/><link name="b"/>', "2 links have no parent (a, b)"),
        (LINKS + joint("1", "a", "b") + joint("2", "c", "b"), "link b has two joints to a parent, 1 and 2"),
        (LINKS + joint("1", "a", "b") + joint("1", "b", "c"), "two joints are named 1"),
        (LINKS + joint("1", "b", "c") + joint("2", "c", "b"), "some joints go in a circle"),
        (
            LINKS + joint("1", "a", "b") + joint("2", "b", "c") + joint("3", "c", "a"),
            "0 links have no parent",
        ),
        (LINKS + joint("1", "a", "b") + joint("2", "b", "d"), "no link of r named 'd'"),
        (
            LINKS + joint("1", "a", "b", kind="ball"),
            "joint 1: there is no type 'ball' (revolute, continuous,",
        ),
        (LINKS + joint("1", "a", "b", '<axis xyz="0 0 0"/>', "planar"), "joint 1: its axis is 0 0 0"),
        (LINKS + joint("1", "a", "b", '<axis xyz="0 0 0"/>'), "joint 1: its axis is 0 0 0"),
        (LINKS + joint("1", "a", "b", '<axis xyz="0 1"/>'), "xyz='0 1' is not three numbers"),
        (LINKS + joint("1", "a", "b", '<origin xyz="0 nan 1"/>'), "xyz='nan' is not a finite number"),
        (LINKS + joint("1", "a", "b", '<origin rpy="0 0 1e999"/>'), "rpy='1e999' is not a finite number"),
        (
            LINKS + joint("1", "a", "b", '<limit lower="2" upper="1"/>', "revolute"),
            "lower 2 is above upper 1",
        ),
        (
            LINKS + joint("1", "a", "b", '<mimic joint="9"/>') + joint("2", "b", "c"),
            "no joint of r named '9'",
        ),
        (
            LINKS + joint("1", "a", "b", '<mimic joint="2"/>') + joint("2", "b", "c", '<mimic joint="1"/>'),
            "joints mimic one another in a circle",
        ),
        ('<link name="a"><inertial><mass value="-1"/></inertial></link>', "link a: a mass of -1 kg"),
        ('<link name="a"><inertial><mass/></inertial></link>', "value is missing"),
        ('<xacro:include filename="x"/><link name="a"/>', "this is xacro"),
        (
            "<link name='a'>" + "<visual>" * 40 + "</visual>" * 40 + "</link>",
            "more than 32 elements within one another",
        ),
    ],
)
def test_what_is_wrong_is_said_with_its_file(inside: str, said: str) -> None:
    """A wrong file is refused, never read as another robot; the message has the file, and the line where there is one."""
    with pytest.raises(CallerError) as caught:
        parse_urdf(f'<robot name="r">\n{inside}</robot>', "a.urdf")
    assert str(caught.value).startswith("a.urdf:")
    assert said in str(caught.value)


BOMB = '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]><robot name="&b;"><link name="a"/></robot>'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOMB, "1: a document type (<!DOCTYPE>) is refused"),
        ('<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot name="r"/>', "1: a document type"),
        ('<robot name="&x;"/>', "1: not XML that can be read"),
        ("<robot", "1: not XML that can be read"),
        ("", "1: not XML that can be read"),
        ('<?xml version="1.0" encoding="klingon"?><robot name="r"/>', "not XML that can be read"),
        ("<sdf/>", "1: <sdf>: not a URDF file"),
    ],
)
def test_hostile_xml_is_refused(text: str, said: str) -> None:
    """No entity is defined, expanded or fetched; what is no XML is said to be none, with its line."""
    with pytest.raises(CallerError) as caught:
        parse_urdf(text, "a.urdf")
    assert said in str(caught.value)


def test_files_that_are_too_large_or_no_files_are_not_read(tmp_path: Path) -> None:
    """A folder, a missing file and one of more than 8 MiB are refused."""
    folder = tmp_path / "folder.urdf"
    folder.mkdir()
    with pytest.raises(CallerError, match="not a file"):
        load_body(str(folder))
    with pytest.raises(CallerError, match="no such file"):
        load_body(str(tmp_path / "none.urdf"))
    large = tmp_path / "large.urdf"
    large.write_bytes(b"<robot name='r'>" + b" " * 2**23)
    with pytest.raises(CallerError, match="larger than a description may be"):
        load_body(str(large))
