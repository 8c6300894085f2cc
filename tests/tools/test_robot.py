"""`aces robot`: check, show, list, import; and a robot's file as the configuration of a protocol."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from aces_bus import list_robots, load_protocol, load_robot
from aces_bus.device import Robot
from aces_bus.device.config import Joint
from aces_bus.robot.installed import robot_text
from aces_tools.protocols_arg import named_protocol, read_configuration

from .conftest import Aces

#: A board of two channels, at a place where the shipped robots have one.
ROBOT = """\
name = "arm"
[buses]
upper = { link = "can", protocol = "hubo", dialect = "D12" }
[devices]
LEG = { driver = "hubo_motor", bus = "upper", credentials = { board = 0x01 }, channels = 2 }
[joints]
RHP = { device = "LEG", gear = [16, 20] }
"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    path = tmp_path / "arm.toml"
    path.write_text(ROBOT, encoding="utf-8")
    return path


# ---------------------------------------------------------------------- check


def test_a_right_file_passes(aces: Aces, robot: Path) -> None:
    """Status 0 and a line with what it holds; what is not installed is a warning, and an error under --strict."""
    robot.write_text(ROBOT.replace("hubo_motor", "nobodys_driver"))
    result = aces("robot", "check", robot)
    assert result.status == 0
    assert result.out.splitlines()[-1] == f"{robot}: ok: 1 joint, 1 device, 1 bus"
    assert f"{robot}:5: warning: devices.LEG.driver: driver 'nobodys_driver' is not installed" in result.out
    result = aces("robot", "check", "--strict", robot)
    assert result.status == 1
    assert result.out.splitlines()[-1] == f"{robot}: 1 error"


def test_a_wrong_file_fails_with_all_its_faults(aces: Aces, robot: Path) -> None:
    """Status 1; every fault a line with file, line and key; other files are checked all the same."""
    robot.write_text(ROBOT.replace("[16, 20]", "[16]").replace('"upper", c', '"uper", c'))
    result = aces("robot", "check", robot, "hubo2")
    assert result.status == 1
    lines = [line for line in result.out.splitlines() if "warning" not in line]
    assert lines[0].startswith(f"{robot}:5: devices.LEG.bus: no bus named 'uper'; did you mean 'upper'?")
    assert lines[1].startswith(f"{robot}:7: joints.RHP.gear: expected two numbers above 0")
    assert lines[2:] == [f"{robot}: 2 errors", "hubo2: ok: 40 joints, 25 devices, 9 sensors, 2 buses"]


def test_check_for_programs(aces: Aces, robot: Path) -> None:
    """The same as JSON, with the same status."""
    robot.write_text(ROBOT.replace("[16, 20]", "[16]"))
    result = aces("robot", "check", robot, "hubo2plus", "--json")
    assert result.status == 1
    wrong, right = json.loads(result.out)
    assert (wrong["robot"], wrong["ok"], wrong["counts"]) == (str(robot), False, None)
    (one,) = [problem for problem in wrong["problems"] if problem["level"] == "error"]
    assert (one["file"], one["line"], one["key"]) == (str(robot), 7, "joints.RHP.gear")
    assert right["ok"]
    assert right["counts"] == {"joints": 38, "devices": 26, "sensors": 9, "buses": 2}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["check"], "name a robot or a file: aces robot check"),
        (["import"], "name a description file"),
        (["check", "nobody.toml"], "nobody.toml: No such file"),
        (["check", "hubo2pls"], "did you mean 'hubo2plus'? (there are: hubo2plus"),
        (["show", "hubo2pls"], "did you mean 'hubo2plus'?"),
        (["list", "hubo2"], "takes no names"),
        (["show", "hubo2", "--strict"], "--strict belongs to 'aces robot check'"),
        (["check", "hubo2", "-o", "x"], "--output belongs to 'aces robot import'"),
        (["chek"], "no argument of 'aces robot' named 'chek'; did you mean 'check'?"),
        (["import", "none.dd"], "none.dd: No such file"),
    ],
)
def test_a_wrong_call(aces: Aces, arguments: list[str], said: str) -> None:
    """Status 2, and one line that says what would work."""
    result = aces("robot", *arguments)
    assert result.status == 2
    assert said in result.err
    assert len(result.err.splitlines()) == 1


# ---------------------------------------------------------------------- list, show


@pytest.mark.slow
def test_list(aces: Aces) -> None:
    """Every robot that ships, what it speaks and has."""
    result = aces("robot", "list")
    assert result.status == 0
    assert [line.split()[0] for line in result.out.splitlines()[1:]] == list(list_robots())
    assert "hubo:D08" in result.out
    objects = json.loads(aces("robot", "list", "--json").out)
    assert [(one["name"], one["joints"]) for one in objects][:3] == [
        ("drc_hubo", 34),
        ("hubo2", 40),
        ("hubo2plus", 38),
    ]


def test_show(aces: Aces) -> None:
    """Buses, devices, joints and sensors as tables; as JSON everything the file states."""
    result = aces("robot", "show", "hubo2plus")
    lines = [line.split() for line in result.out.splitlines()]
    assert ["upper", "can", "hubo:D12", "1000", "kbit/s", "can1"] in lines
    assert ["JMC9", "hubo_motor", "upper", "board", "0x09", "2", "RSY", "REB"] in lines
    assert ["LEB", "JMC11", "1", "20/20", "100", "4000", "+1", "-2.65", "0", "rad", "6", "LEP"] in lines
    assert ["TILT_R", "FT_RF", "tilt"] in lines
    shown = json.loads(aces("robot", "show", "hubo2plus", "--json").out)
    assert shown["joints"]["LEB"]["gear"] == [20, 20]
    assert shown["joints"]["LEB"]["zero"] is None


def test_a_file_is_shown_without_control_characters(aces: Aces, robot: Path) -> None:
    """Whatever its texts hold."""
    robot.write_text(
        ROBOT + 'doc = "x"\n'.replace("doc", '[sensors]\nS = { device = "LEG", kind = "\\u001b[31m" }\n#')
    )
    result = aces("robot", "show", robot)
    assert result.status == 0
    assert "\x1b" not in result.out
    assert "\\x1b[31m" in result.out


# ---------------------------------------------------------------------- -p NAME@robot.toml


def test_a_robots_file_configures_a_protocol(robot: Path) -> None:
    """Its devices say which board is what; its bus says the dialect, unless the call does."""
    hubo = load_protocol("hubo")
    assert read_configuration(str(robot), hubo)[0] == {"channels": {0x01: 2}, "sensors": {}}
    assert named_protocol(f"hubo@{robot}").variant().tables["channels"] == {0x01: 2}
    robot.write_text(ROBOT.replace("D12", "D08"))
    assert named_protocol(f"hubo@{robot}").variant().dialect == "D08"
    assert named_protocol(f"hubo:D12@{robot}").variant().dialect == "D12"


@pytest.mark.parametrize("name", ["hubo2", "hubo2plus", "drc_hubo"])
def test_a_shipped_file_and_the_configuration_of_its_name_agree(name: str, tmp_path: Path) -> None:
    """`-p hubo@hubo2plus.toml` decides as `-p hubo@hubo2plus`."""
    path = tmp_path / f"{name}.toml"
    path.write_text(robot_text(name), encoding="utf-8")
    for dialect in ("D08", "D12"):
        ours, theirs = (
            named_protocol(f"hubo:{dialect}@{path}").variant(),
            named_protocol(f"hubo:{dialect}@{name}").variant(),
        )
        assert ours.tables == theirs.tables
        assert {m.name: str(m.identifier) for m in ours.messages.values()} == {
            m.name: str(m.identifier) for m in theirs.messages.values()
        }


def test_frames_are_read_as_the_robot_has_its_boards(aces: Aces, robot: Path, tmp_path: Path) -> None:
    """A board of three channels where the default has two gives three positions."""
    log = tmp_path / "x.log"
    log.write_text("(1.000000) can0 061#0100020003000000\n")
    assert len(aces("decode", log, "-p", "hubo", "--format", "jsonl").objects[0]["fields"]["position"]) == 2
    robot.write_text(ROBOT.replace("channels = 2", "channels = 3"))
    found = aces("decode", log, "-p", f"hubo@{robot}", "--format", "jsonl")
    assert found.status == 0
    assert found.objects[0]["fields"]["position"] == [1, 2, 3]


def test_a_wrong_robot_is_refused_with_all_its_faults(aces: Aces, robot: Path, log: Path) -> None:
    """Status 2; one line a fault; and a robot that does not speak the protocol says what it speaks."""
    result = aces("decode", log, "-p", f"robotis@{robot}")
    assert (result.status, "speaks robotis (it speaks: hubo)" in result.err) == (2, True)
    robot.write_text(ROBOT.replace("[16, 20]", "[16]").replace('"LEG"', '"leg"'))
    result = aces("decode", log, "-p", f"hubo@{robot}")
    assert result.status == 2
    assert [line.split(": ")[2] for line in result.err.splitlines()[:1]] == ["joints.RHP.device"]
    assert "joints.RHP.gear" in result.err


# ---------------------------------------------------------------------- import

TREE = """\
begin JMC
name JMC1
type H2P_1CH
can_channel 0
hardware_index 1
end JMC
begin Joint
name RHP
software_index 0
hardware_index 0
jmc_name JMC1
end Joint
"""


def test_import_prints_a_robots_file(aces: Aces, tmp_path: Path) -> None:
    """On stdout, or to a file; the file is a robot's."""
    (tmp_path / "My.dd").write_text(TREE)
    result = aces("robot", "import", tmp_path / "My.dd")
    assert result.status == 0
    (tmp_path / "out.toml").write_text(result.out, encoding="utf-8")
    made = load_robot(tmp_path / "out.toml")
    assert (made.name, list(made.joints), made.devices["JMC1"].model) == ("My", ["RHP"], "H2P_1CH")
    again = aces("robot", "import", tmp_path / "My.dd", "--name", "mine", "-o", tmp_path / "mine.toml")
    assert (again.status, again.out) == (0, "")
    assert load_robot(tmp_path / "mine.toml").name == "mine"
    assert (
        json.loads(aces("robot", "import", tmp_path / "My.dd", "--json").out)["joints"]["RHP"]["device"]
        == "JMC1"
    )


def test_import_never_overwrites_what_it_reads(aces: Aces, tmp_path: Path) -> None:
    """-o naming the description is refused, and the description stays."""
    path = tmp_path / "My.dd"
    path.write_text(TREE)
    result = aces("robot", "import", path, "-o", path)
    assert result.status == 2
    assert path.read_text() == TREE


def test_a_wrong_description_prints_nothing(aces: Aces, tmp_path: Path) -> None:
    """Status 2, every fault with file and line, no output file."""
    (tmp_path / "My.dd").write_text(TREE.replace("H2P_1CH", "H3P").replace("software_index 0\n", ""))
    result = aces("robot", "import", tmp_path / "My.dd", "-o", tmp_path / "out.toml")
    assert (result.status, result.out) == (2, "")
    assert "My.dd:3: type: no JMC type named 'H3P'" in result.err
    assert "My.dd:7: software_index: Joint needs it" in result.err
    assert not (tmp_path / "out.toml").exists()


# ---------------------------------------------------------------------- the real descriptions


def imported(aces: Aces, folder: Path, *names: str) -> tuple[Robot, dict[str, Any]]:
    """What `aces robot import` makes of shared files, and what is known of the first."""
    result = aces("robot", "import", *(folder / name for name in names))
    assert result.status == 0, result.err
    from aces_bus.robot import parse_robot

    robot, problems = parse_robot(result.out)
    assert robot is not None, problems
    expected = json.loads((folder / "expected.json").read_text(encoding="utf-8"))
    return robot, expected[names[0]]["parsed"]


@pytest.mark.shared
def test_the_tree_of_hubo2plus(aces: Aces, shared_captures: Path) -> None:
    """As many objects, joints in their order, types of boards; and every joint as the shipped robot has it."""
    robot, known = imported(aces, shared_captures, "hubo-dd/Hubo2Plus.dd")
    boards = [device for device in robot.devices.values() if device.driver == "hubo_motor"]
    kinds = Counter("FT" if s.kind == "force_torque" else "IMU" for s in robot.sensors.values())
    assert {"meta": 1, "JMC": len(boards), "Joint": len(robot.joints), **kinds} == known["objects"]
    assert list(robot.joints) == known["joints_by_index"]
    assert Counter(board.model for board in boards) == known["jmc_types"]
    shipped = load_robot("hubo2plus")
    for joint in robot.joints.values():
        ours = shipped.joint(joint.name)
        for key in Joint.__struct_fields__:
            if key not in ("name", "aliases", "command", "max_duty", "active"):
                assert getattr(joint, key) == getattr(ours, key), (joint.name, key)
        assert robot.devices[joint.device].credentials == shipped.devices[ours.device].credentials
        assert robot.devices[joint.device].bus == shipped.devices[ours.device].bus
    tables = robot.tables(load_protocol("hubo"))
    ours_too = shipped.tables(load_protocol("hubo"))
    missing = {number for number in ours_too["channels"] if number not in tables["channels"]}
    assert missing == {0x0E, 0x33, 0x34}  # the power board, two sensors that are in no use
    assert tables["channels"].items() <= ours_too["channels"].items()


@pytest.mark.shared
def test_the_joint_table_of_hubo2plus(aces: Aces, shared_captures: Path) -> None:
    """As many rows, active ones, names in order, boards; gears as the shipped robot has them."""
    robot, known = imported(aces, shared_captures, "hubo-tables/huboplus.joint.table")
    assert len(robot.joints) == known["joints"]
    assert sum(joint.active for joint in robot.joints.values()) == known["active"]
    assert list(robot.joints) == known["names"]
    assert sorted(robot.devices) == known["boards"]
    shipped = load_robot("hubo2plus")
    for joint in robot.joints.values():
        if joint.name in ("NKP", "LWR", "RWR"):
            assert not joint.active
            continue
        ours = shipped.joint(joint.name)
        for key in ("device", "channel", "gear", "harmonic", "encoder", "direction", "active"):
            assert getattr(joint, key) == getattr(ours, key), (joint.name, key)


@pytest.mark.shared
def test_the_sensor_table_of_hubo2plus(aces: Aces, shared_captures: Path) -> None:
    """Bus, use, id and signs of each; signs of 0 are not used, and so are not there."""
    robot, known = imported(aces, shared_captures, "hubo-tables/huboplus.sensor.table")
    buses = ["lower", "upper"]
    assert {
        sensor.name: {
            "bus": buses.index(robot.devices[sensor.device].bus),
            "active": int(sensor.active),
            "sensor_id": robot.devices[sensor.device].credentials["sensor"],
            "signs": list(sensor.signs or (0, 0, 0)),
        }
        for sensor in robot.sensors.values()
    } == known["sensors"]


@pytest.mark.shared
def test_the_home_table_of_drc_hubo(aces: Aces, shared_captures: Path) -> None:
    """Offsets, limits with their switch bit, directions and turns, over the robot that ships."""
    robot, known = imported(aces, shared_captures, "hubo-tables/drc-hubo-beta-2-rainbow-default.home")
    found = {}
    for name in known["joints"]:
        home = robot.joint(name).home
        assert home is not None
        assert home.lower is not None
        assert home.upper is not None
        found[name] = {
            "offset": home.offset,
            "lower": home.lower | 1,
            "upper": home.upper | 1,
            "dir": int(home.direction == "ccw"),
            "limit_turns": home.search_turns,
            "type": "raw",
        }
    assert found == known["joints"]
    assert robot.joints["WST"].upper == pytest.approx(170000 / 159154.943092)


@pytest.mark.shared
def test_three_tables_together(aces: Aces, shared_captures: Path) -> None:
    """Joints and sensors of one robot in one file."""
    names = ("hubo-tables/huboplus.joint.table", "hubo-tables/huboplus.sensor.table")
    robot, _ = imported(aces, shared_captures, *names)
    assert (len(robot.joints), len(robot.devices), len(robot.sensors)) == (41, 25, 7)
    assert robot.name == "huboplus"


def test_strict_names_the_joints_that_no_watchdog_stops(aces: Aces, tmp_path: Path) -> None:
    """--strict says of each axis that nothing in it watches over the host, and what it does then; status 0."""
    robot = tmp_path / "arm.toml"
    robot.write_text(
        'name = "arm"\nrate_hz = 100\n[buses]\nb = { link = "can", protocol = "odrive" }\n[devices]\n'
        'O1 = { driver = "odrive", bus = "b", credentials = { node = 1 } }\n'
        'O2 = { driver = "odrive", bus = "b", credentials = { node = 2 }, settings = { watchdog_s = 0.3 } }\n'
        '[joints]\nELBOW = { device = "O1" }\nWRIST = { device = "O2" }\n'
    )
    result = aces("robot", "check", robot, "--strict")
    named = "O1: no watchdog of its own: without its host it follows its last set-point (ELBOW)"
    assert [line for line in result.out.splitlines() if "watchdog" in line] == [f"{robot}: {named}"]
    assert result.status == 0
    assert not any("watchdog" in line for line in aces("robot", "check", robot).out.splitlines())


def test_without_a_word_it_says_what_there_is_to_do(aces: Aces) -> None:
    """`aces robot` alone names its actions."""
    result = aces("robot")
    assert result.status == 2
    assert "what is to be done? aces robot check|list|show|import" in result.err
