"""`aces robot import arm.urdf` and `aces robot export`: from a URDF to a robot that runs on twins, and back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aces_bus import load_robot
from aces_bus.errors import CallerError
from aces_bus.kinematics import load_body
from aces_bus.robot import VirtualRobot, parse_robot
from aces_lab.urdf import model_of_robot, parse_urdf, read_urdf
from tests.lab.urdf.samples import RODS, TREE
from tests.tools.conftest import aces as aces

Aces = Callable[..., Any]


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A URDF file."""
    path = tmp_path / "tree.urdf"
    path.write_text(TREE, encoding="utf-8")
    return path


def test_a_urdf_becomes_a_robot_that_runs_on_twins(aces: Aces, tree: Path) -> None:
    """Joints that move of themselves, with their types, limits and speeds; the file is the body, beside the robot's file."""
    made = tree.with_name("robot.toml")
    found = aces("robot", "import", tree, "-o", made)
    assert found.status == 0, found.err
    assert "a damiao for each, numbered in their order, eight a bus, is a choice" in found.err
    robot = load_robot(made)
    assert robot.body == str(tree)
    assert {name: (j.type, j.lower, j.upper, j.max_speed) for name, j in robot.joints.items()} == {
        "waist": ("revolute", -1.5, 1.25, 3.0),
        "shoulder": ("continuous", None, None, None),
        "grip": ("prismatic", 0.0, 0.04, 0.2),
        "wheel": ("continuous", None, None, None),
    }
    assert load_body(str(tree)).joints == tuple(robot.joints)
    assert [device.credentials for device in robot.devices.values()] == [{"motor": n} for n in (1, 2, 3, 4)]
    with VirtualRobot(robot) as virtual:
        assert set(virtual.rig.devices) == {"M1", "M2", "M3", "M4"}


@pytest.mark.parametrize("driver", ["moteus", "odrive", "dynamixel", "cia402"])
def test_another_driver_may_drive_the_joints(aces: Aces, tree: Path, driver: str) -> None:
    """`--device` chooses it; the robot passes the check."""
    made = tree.with_name("robot.toml")
    assert aces("robot", "import", tree, "--device", driver, "-o", made).status == 0
    assert aces("robot", "check", made).status == 0
    assert {device.driver for device in load_robot(made).devices.values()} == {driver}


def test_many_joints_are_on_several_buses_wherever_the_file_is(aces: Aces, tmp_path: Path) -> None:
    """Eight devices a bus, numbered anew on each; a path may be long."""
    chain = "".join(
        f'<link name="l{n}"/><joint name="j{n}" type="continuous"><parent link="l{n}"/><child link="l{n + 1}"/></joint>'
        for n in range(19)
    )
    folder = tmp_path / ("long" * 25)
    folder.mkdir()
    (folder / "chain.urdf").write_text(f'<robot name="chain">{chain}<link name="l19"/></robot>')
    assert aces("robot", "import", folder / "chain.urdf", "-o", tmp_path / "chain.toml").status == 0
    robot = load_robot(tmp_path / "chain.toml")
    assert {bus: len(robot.devices_on(bus)) for bus in robot.buses} == {"bus1": 8, "bus2": 8, "bus3": 3}
    assert robot.devices["M9"].credentials == {"motor": 1}


def test_what_a_robot_has_stays_under_the_limits_of_a_urdf(aces: Aces, tree: Path) -> None:
    """`--base`: devices, gains and other joints are its own; limits are the URDF's; what it lacks is named."""
    base = tree.with_name("base.toml")
    base.write_text(
        """
[buses]
can = { link = "can", protocol = "moteus" }
[devices]
A = { driver = "moteus", bus = "can", credentials = { id = 7 } }
[joints]
waist = { device = "A", direction = -1, lower = -3.0, upper = 3.0 }
"""
    )
    made = tree.with_name("made.toml")
    found = aces("robot", "import", tree, "--base", base, "-o", made)
    assert found.status == 0
    assert "has no shoulder, grip, wheel" in found.err
    waist = load_robot(made).joints["waist"]
    assert (waist.device, waist.direction, waist.lower, waist.upper, waist.max_speed) == (
        "A",
        -1,
        -1.5,
        1.25,
        3.0,
    )
    other = tree.with_name("rods.urdf")
    other.write_text(RODS)
    found = aces("robot", "import", other, "--base", base)
    assert (found.status, "has none of the joints" in found.err) == (2, True)


def test_an_export_has_the_inertias_of_the_body_and_the_limits_of_the_robot(aces: Aces, tree: Path) -> None:
    """Import, another limit in the robot's file, export: the same mechanism with that limit."""
    made, again = tree.with_name("robot.toml"), tree.with_name("again.urdf")
    aces("robot", "import", tree, "-o", made)
    made.write_text(made.read_text().replace("upper = 1.25", "upper = 0.5"))
    found = aces("robot", "export", made, "-o", again)
    assert (found.status, found.err) == (0, "aces: 4 joints, 8 links, 2 of them without inertia\n")
    before, after = read_urdf(str(tree)), read_urdf(str(again))
    assert after.links == before.links
    assert after.joints["waist"].upper == 0.5
    assert {**after.joints, "waist": 0} == {**before.joints, "waist": 0}


def test_a_robot_with_an_installed_body_is_exported_without_inertias(aces: Aces) -> None:
    """The chains' lengths and the robot's limits; the note says that inertias are missing."""
    found = aces("robot", "export", "minihubo_1")
    assert "26 of them without inertia" in found.err
    body = parse_urdf(found.out).body
    robot = load_robot("minihubo_1")
    assert body.tips == load_body("MiniHubo").tips
    assert all(
        body.upper[body.index[name]] == j.upper
        for name, j in robot.joints.items()
        if name in body.index and j.upper is not None
    )


def test_a_robot_without_a_body_is_not_exported(aces: Aces) -> None:
    """Its lengths are not known, and are not made up."""
    found = aces("robot", "export", "rover")
    assert found.status == 2
    assert "rover names no body" in found.err
    with pytest.raises(CallerError, match="rover names no body"):
        model_of_robot(load_robot("rover"))


ROBOT = """
body = "BODY"
[buses]
can = { link = "can", protocol = "moteus" }
"""


def test_a_robots_file_names_a_body_below_its_folder(tmp_path: Path, aces: Aces) -> None:
    """A file that is elsewhere, missing or wrong is an error of the robot's file; a body that is not installed a warning."""
    inner = tmp_path / "in"
    inner.mkdir()
    robot, body = inner / "robot.toml", inner / "b.urdf"
    body.write_text(RODS)
    (tmp_path / "out.urdf").write_text(RODS)
    for name, status, said in (
        ("b.urdf", 0, "ok"),
        ("../out.urdf", 1, "leaves the folder of the robot's file"),
        ("none.urdf", 1, "none.urdf: no such file"),
        ("Nobody", 0, "warning: body: body 'Nobody' is not installed"),
        ("MiniHubu", 1, "did you mean 'MiniHubo'?"),
    ):
        robot.write_text(ROBOT.replace("BODY", name))
        found = aces("robot", "check", robot)
        assert (found.status, said in found.out) == (status, True), (name, found.out)
    body.write_text(RODS.replace('link="base"', 'link="bace"'))
    robot.write_text(ROBOT.replace("BODY", "b.urdf"))
    assert "b.urdf: no link of rods named 'bace'; did you mean 'base'?" in aces("robot", "check", robot).out


def test_options_that_do_not_go_together_are_refused(aces: Aces, tree: Path) -> None:
    """Two files, or two words on who drives the joints."""
    for more, said in (
        (["--base", "rover", "--device", "moteus"], "--base and --device both say what drives the joints"),
        ([tree], "is a whole robot"),
        (["--device", "nobody"], "no driver named 'nobody'"),
    ):
        found = aces("robot", "import", tree, *more)
        assert (found.status, said in found.err) == (2, True), found.err


def test_names_that_a_robots_file_cannot_have_are_refused(aces: Aces, tree: Path) -> None:
    """A joint whose name has blanks or control characters cannot be one of a robot's file."""
    tree.write_text(TREE.replace('"waist"', '"the waist"'))
    found = aces("robot", "import", tree)
    assert found.status == 2
    assert "a name has letters, digits, _ . and -" in found.err
    assert parse_robot(ROBOT.replace('body = "BODY"', ""))[0] is not None
