"""A robot's file: read whole or refused with everything that is wrong, each at its line."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import load_protocol, load_robot
from aces_bus.device import Robot
from aces_bus.device.config import Home, Joint
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.robot import parse_robot
from aces_bus.robot.file import RobotError, print_robot
from aces_bus.robot.installed import check_robot
from tests.counting import calls

ARM = """\
name = "arm"
rate_hz = 200

[buses]
upper = { link = "can", protocol = "hubo", dialect = "D12", bitrate = 1_000_000, channel = "can1" }

[devices]
JMC8 = { driver = "hubo_motor", bus = "upper", credentials = { board = 0x08 }, channels = 2 }
HAND = { driver = "hubo_motor", bus = "upper", credentials = { board = 0x24 }, channels = 3, kind = "hand" }
FOOT = { driver = "hubo_ft", bus = "upper", credentials = { board = 0x30, sensor = 1 }, kind = "foot", active = false }

[joints]
RSP = { device = "JMC8", gear = [11, 16], harmonic = 100, encoder = 4000, lower = -3.14, upper = 3.14 }
RSR = { device = "JMC8", channel = 1, aliases = ["SR"] }

[joints.RWR]
device = "HAND"
channel = 0
direction = -1
home = { offset = -200, direction = "ccw" }

[sensors]
RFFT = { device = "FOOT", kind = "force_torque", signs = [-1, -1, 1] }
"""


def read(text: str) -> Robot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return robot


def errors(text: str) -> list[str]:
    robot, problems = parse_robot(text, "r.toml")
    assert robot is None
    return [str(problem) for problem in problems if not problem.is_warning]


def changed(old: str, new: str) -> str:
    assert ARM.count(old) == 1, old
    return ARM.replace(old, new)


# ---------------------------------------------------------------------- a right file


def test_a_file_becomes_frozen_data() -> None:
    """Every entry is there under its name, and none can be changed."""
    robot = read(ARM)
    assert (robot.name, robot.rate_hz) == ("arm", 200)
    assert robot.buses["upper"].bitrate == 1_000_000
    assert robot.devices["HAND"].credentials == {"board": 0x24}
    assert robot.joints["RWR"] == Joint(
        name="RWR", device="HAND", channel=0, direction=-1, home=Home(offset=-200, direction="ccw")
    )
    assert robot.sensors["RFFT"].signs == (-1, -1, 1)
    with pytest.raises(AttributeError):
        robot.joints["RSP"].lower = 0.0  # type: ignore[misc]


def test_what_is_unknown_is_none() -> None:
    """A limit, gear or zero that the file does not state is absent, not 0."""
    joint = read(ARM).joints["RSR"]
    assert (joint.lower, joint.upper, joint.gear, joint.zero, joint.max_speed) == (None,) * 5
    assert joint.counts_per_unit is None


def test_names_aliases_and_who_is_where() -> None:
    """Joints are found by name and alias, devices by bus, joints and sensors by device."""
    robot = read(ARM)
    assert robot.joint("SR") is robot.joint("RSR") is robot.joints["RSR"]
    with pytest.raises(UnknownNameError, match="RSP"):
        robot.joint("RPS")
    assert [joint.name for joint in robot.joints_of("JMC8")] == ["RSP", "RSR"]
    assert [sensor.name for sensor in robot.sensors_of("FOOT")] == ["RFFT"]
    assert [device.name for device in robot.devices_on("upper")] == ["JMC8", "HAND", "FOOT"]


def test_counts_a_rad() -> None:
    """driven ÷ drive × harmonic × encoder ÷ 2π."""
    assert read(ARM).joints["RSP"].counts_per_unit == pytest.approx(92599.239617, abs=1e-6)
    assert (
        Joint(name="x", device="y", gear=(1, 1), harmonic=1, encoder=4096).counts_per_unit == 4096 / math.tau
    )


def test_tables_of_a_protocol() -> None:
    """Kinds, else channels, keyed by the credential that the table maps; inactive devices too."""
    hubo = load_protocol("hubo")
    assert read(ARM).tables(hubo) == {
        "channels": {0x08: 2, 0x24: "hand", 0x30: "foot"},
        "sensors": {1: "foot"},
    }
    kinds = changed('kind = "foot"', 'kind = { channels = "foot", sensors = "ft" }')
    assert read(kinds).tables(hubo)["sensors"] == {1: "ft"}
    with pytest.raises(CallerError, match=r"nothing that speaks robotis \(it speaks: hubo\)"):
        read(ARM).tables(load_protocol("robotis"))


def test_the_dialect_of_a_protocol() -> None:
    """The bus says it, a device may differ; several cannot be answered with one."""
    assert read(ARM).dialect("hubo") == "D12"
    mixed = changed("channels = 2 }", 'channels = 2, dialect = "D08" }')
    with pytest.raises(CallerError, match=r"several dialects \(D12, D08\)"):
        read(mixed).dialect("hubo")


def test_reactions_are_printed_and_read() -> None:
    """Kinds with sources, and names of functions of a program that is not known here."""
    robot = read(changed("rate_hz = 200", 'reactions = { silent = "hold", "alarm@JMC8,walk" = "kneel" }'))
    assert robot.reactions == {"silent": "hold", "alarm@JMC8,walk": "kneel"}
    assert read(print_robot(robot)) == robot


def test_what_is_printed_reads_the_same() -> None:
    """Names that need quotes, text of any kind, hexadecimal credentials."""
    robot = read(changed('name = "arm"', 'name = "arm"\ndoc = "a \\"b\\"\\n\\t\\\\ \\u0007 é"'))
    text = print_robot(robot, ["made by hand"])
    assert text.startswith("# made by hand\n")
    assert "board = 0x24" in text
    assert read(text) == robot


@given(st.text(), st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**62), 2**62))
def test_any_text_and_number_is_printed_and_read(doc: str, lower: float, offset: int) -> None:
    """Printing loses nothing, whatever the characters and digits."""
    source = read(ARM)
    joint = Joint(
        name="RSP", device="JMC8", doc=doc or None, lower=lower, home=Home(offset=offset), aliases=("a.b",)
    )
    robot = Robot(
        name="arm", buses=source.buses, devices=source.devices, joints={"RSP": joint}, sensors=source.sensors
    )
    assert read(print_robot(robot)) == robot


# ---------------------------------------------------------------------- a wrong file


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name = "arm"\n', "name = 5\n", "r.toml:1: name: expected a name in quotes, not 5"),
        ("rate_hz = 200", "rate_hz = -200", "r.toml:2: rate_hz: expected a number above 0 (Hz), not -200"),
        ("rate_hz", "rate", "r.toml:2: rate: a robot has no such key; did you mean 'rate_hz'?"),
        (
            "rate_hz = 200",
            'reactions = { sillent = "hold" }',
            "r.toml:2: reactions.sillent: no kind of fault named 'sillent'; did you mean 'silent'?",
        ),
        (
            "rate_hz = 200",
            'reactions = { "silent@JMC9" = "hold" }',
            "r.toml:2: reactions.'silent@JMC9': no bus or device named 'JMC9'; did you mean 'JMC8'?",
        ),
        (
            "rate_hz = 200",
            'reactions = { silent = "stand still" }',
            "r.toml:2: reactions.silent: 'stand still' is not a reaction (there are: ignore, degrade, hold,",
        ),
        (
            "rate_hz = 200",
            "reactions = { silent = 3 }",
            "r.toml:2: reactions: expected a table of what faults",
        ),
        (
            'link = "can"',
            'link = "cna"',
            'r.toml:5: buses.upper.link: expected "can", "serial" or "datagram"',
        ),
        (
            'link = "can"',
            'link = "serial"',
            "r.toml:5: buses.upper.link: hubo is spoken on can, not on serial",
        ),
        (
            'protocol = "hubo"',
            'protocol = "hubbo"',
            "buses.upper.protocol: no protocol named 'hubbo'; did you mean 'hubo'?",
        ),
        (
            '"D12"',
            '"D112"',
            "r.toml:5: buses.upper.dialect: no dialect of hubo named 'D112'; did you mean 'D12'?",
        ),
        ("bitrate = 1_000_000", "baud = 9600", "r.toml:5: buses.upper.baud: belongs to link = 'serial'"),
        (
            "bitrate = 1_000_000",
            "bitrate = true",
            "buses.upper.bitrate: expected a whole number above 0, not true",
        ),
        (
            'JMC8 = { driver = "hubo_motor", bus = "upper"',
            'JMC8 = { driver = "hubo_motor", bus = "uper"',
            "r.toml:8: devices.JMC8.bus: no bus named 'uper'; did you mean 'upper'? (there are: upper)",
        ),
        (
            "{ board = 0x24 }",
            "{ board = 0x08 }",
            "r.toml:9: devices.HAND.credentials.board: board 0x08 on bus upper is device JMC8 already: two devices",
        ),
        (
            "{ board = 0x24 }",
            "{ board = 0x40 }",
            "r.toml:9: devices.HAND.credentials.board: hubo has no board 0x40 (0x00…0x3f)",
        ),
        (
            "{ board = 0x24 }",
            "{ bord = 0x24 }",
            "devices.HAND.credentials.bord: hubo has no field 'bord'; did you mean 'board'?",
        ),
        ("{ board = 0x24 }", "{}", "devices.HAND.credentials: expected what identifies it on the bus"),
        (
            '"hand"',
            '"hamd"',
            "r.toml:9: devices.HAND.kind: hubo has no channels 'hamd' (there are: 'foot', 'ft', 'hand'",
        ),
        ("channels = 2 }", "channels = 9 }", "r.toml:8: devices.JMC8.channels: hubo has no channels 9"),
        (
            "[11, 16]",
            "[11, 0]",
            "r.toml:13: joints.RSP.gear: expected two numbers above 0: [drive, driven], such as [10, 25], not [11, 0]",
        ),
        ("[11, 16]", "[11]", "r.toml:13: joints.RSP.gear: expected two numbers"),
        ("gear =", "gera =", "r.toml:13: joints.RSP.gera: a joint has no such key; did you mean 'gear'?"),
        (
            "lower = -3.14",
            "lower = nan",
            "r.toml:13: joints.RSP.lower: expected a number in rad (m for a prismatic joint), not nan",
        ),
        ("lower = -3.14", "lower = 3.15", "r.toml:13: joints.RSP.lower: 3.15 is not below upper = 3.14"),
        (
            "encoder = 4000",
            "encoder = 4000.5",
            "r.toml:13: joints.RSP.encoder: expected a whole number above 0, not 4000.5",
        ),
        (
            "encoder = 4000",
            "encoder = 99999999999999999999",
            "joints.RSP.encoder: expected a whole number above 0",
        ),
        (
            "channel = 1,",
            "channel = 0,",
            "r.toml:14: joints.RSR.channel: channel 0 of JMC8 is joint RSP already",
        ),
        (
            "channel = 1,",
            "channel = 2,",
            "r.toml:14: joints.RSR.channel: JMC8 has no channel 2 (it has: 0…1)",
        ),
        ('["SR"]', '["RSP"]', "r.toml:14: joints.RSR.aliases: 'RSP' is joint RSP already"),
        (
            'device = "HAND"\n',
            'device = "HNAD"\n',
            "r.toml:17: joints.RWR.device: no device named 'HNAD'; did you mean 'HAND'?",
        ),
        ('device = "HAND"\n', "", "r.toml:16: joints.RWR.device: is missing: expected a name in quotes"),
        ("direction = -1\n", "direction = 0\n", "r.toml:19: joints.RWR.direction: expected 1 or -1, not 0"),
        (
            "home = {",
            "home = { ofset = 3,",
            "r.toml:20: joints.RWR.home.ofset: a home has no such key; did you mean 'offset'?",
        ),
        ('"ccw"', '"left"', 'r.toml:20: joints.RWR.home.direction: expected "cw" or "ccw", not \'left\''),
        (
            "home = {",
            'type = "continuous"\nupper = 1.0\nhome = {',
            "r.toml:21: joints.RWR.upper: a continuous joint turns without end",
        ),
        (
            "[-1, -1, 1]",
            "[-1, 0, 1]",
            "r.toml:23: sensors.RFFT.signs: expected a list of 1 and -1, one an axis, not [-1, 0, 1]",
        ),
        (
            "[-1, -1, 1]",
            "[1, 1], matrix = [[1, 2], [3]]",
            "r.toml:23: sensors.RFFT.matrix: rows of a matrix are all of one length",
        ),
        (
            'RFFT = { device = "FOOT"',
            'RFFT = { device = "foot"',
            "r.toml:23: sensors.RFFT.device: no device named 'foot'",
        ),
        ("RSP = {", '"R SP" = {', "r.toml:13: joints.'R SP': a name has letters, digits, _ . and -"),
        ("RSP = {", "RSP = 3 #", "r.toml:13: joints.RSP: expected a joint: a table, { device = … }, not 3"),
        (
            "[sensors]\nRFFT =",
            "[sensors.RFFT]\nname =",
            "r.toml:23: sensors.RFFT.name: a sensor has no such key",
        ),
    ],
)
def test_one_fault_is_said_with_its_line(old: str, new: str, said: str) -> None:
    """File, line, key and what is expected; nothing else is complained about."""
    found = errors(changed(old, new))
    assert any(said in one for one in found), found
    assert len(found) <= 3, found


def test_a_section_that_is_no_table() -> None:
    """And one whose entries are not tables."""
    (said,) = errors("joints = [1]\n" + ARM[: ARM.index("[joints]")])
    assert "r.toml:1: joints: expected a table, written as [joints] with one entry a line, not [1]" in said


def test_all_faults_are_said_at_once() -> None:
    """In the file's order, from every section, keys alone and keys together."""
    text = ARM
    for old, new in [
        ("rate_hz = 200", 'rate_hz = "fast"'),
        ("bitrate = 1_000_000", "bitrate = 0"),
        ("{ board = 0x24 }", "{ board = 0x08 }"),
        ("[11, 16]", "[0, 16]"),
        ("channel = 1,", "channel = 0,"),
        ("offset = -200", "offset = 0.5"),
        ("force_torque", ""),
    ]:
        text = text.replace(old, new)
    found = errors(text)
    assert [int(one.split(":")[1]) for one in found] == [2, 5, 9, 9, 13, 14, 20, 23]


def test_an_error_carries_all_problems(tmp_path: Path) -> None:
    """`load_robot` raises once, with one line a problem."""
    path = tmp_path / "arm.toml"
    path.write_text(changed("[11, 16]", "[0, 16]").replace("rate_hz = 200", "rate_hz = 0"))
    with pytest.raises(RobotError) as raised:
        load_robot(path)
    assert str(raised.value).splitlines() == [str(problem) for problem in raised.value.problems]
    assert [(Path(p.file).name, p.line, p.key) for p in raised.value.problems] == [
        ("arm.toml", 2, "rate_hz"),
        ("arm.toml", 13, "joints.RSP.gear"),
    ]
    path.write_text(ARM)
    assert load_robot(path) == read(ARM)


SPEC = """
from construct import Byte, Struct
from aces_bus.protocol import IdField, Protocol
made = Protocol({name!r}, link={link!r})
made.message("State", id=0x10 + IdField("node", range(4)), payload=Struct("level" / Byte))
"""
LANTERN = """
name = "lantern"
[buses]
upper = { link = "can", protocol = "specs/lantern.py" }
[devices]
L1 = { driver = "lanterns_driver", bus = "upper", credentials = { node = 2 } }
"""


LEAVES_A_MARK = "from pathlib import Path\nPath(__file__).with_name('ran').touch()\n"


def test_a_check_runs_no_file_that_a_robot_names(tmp_path: Path) -> None:
    """It is said that the protocol was not checked; once the program itself has run the file, the check uses it."""
    spec = tmp_path / "specs" / "lantern.py"
    spec.parent.mkdir()
    spec.write_text(LEAVES_A_MARK + SPEC.format(name="marked_lantern", link="can"))
    (tmp_path / "robot.toml").write_text(LANTERN)
    for _ in range(2):
        robot, problems = check_robot(tmp_path / "robot.toml")
        assert robot is not None
        assert robot.buses["upper"].protocol == "specs/lantern.py"
        notes = [p.text for p in problems if p.key == "buses.upper.protocol"]
        assert notes == [
            f"specs/lantern.py is not run here, so what depends on its protocol was not checked; --driver {spec} runs it"
        ]
    assert not (spec.parent / "ran").exists()
    assert load_robot(tmp_path / "robot.toml").buses["upper"].protocol == "marked_lantern"
    assert (spec.parent / "ran").exists()
    robot, problems = check_robot(tmp_path / "robot.toml")
    assert robot is not None
    assert (robot.buses["upper"].protocol, [p.key for p in problems]) == (
        "marked_lantern",
        ["devices.L1.driver"],
    )


@pytest.mark.parametrize("way", ["..", "absolute", "link"])
def test_a_protocol_s_file_elsewhere_is_refused_and_not_run(way: str, tmp_path: Path) -> None:
    """By its path, whole or upwards, or through a link; it is used when the program has run it by itself."""
    folder, spec = tmp_path / "robot", tmp_path / "elsewhere" / "lantern.py"
    folder.mkdir()
    spec.parent.mkdir()
    spec.write_text(LEAVES_A_MARK + SPEC.format(name=f"lantern_{way.strip('.')}_", link="can"))
    (folder / "link").symlink_to(spec.parent)
    name = {"..": "../elsewhere/lantern.py", "absolute": str(spec), "link": "link/lantern.py"}[way]
    (folder / "robot.toml").write_text(LANTERN.replace("specs/lantern.py", name))
    with pytest.raises(RobotError, match=rf"robot.toml:4: .*{name} leaves the folder of the robot's file"):
        load_robot(folder / "robot.toml")
    assert check_robot(folder / "robot.toml")[0] is None
    assert not (spec.parent / "ran").exists()
    load_protocol(str(spec))
    assert load_robot(folder / "robot.toml").buses["upper"].protocol == f"lantern_{way.strip('.')}_"


def test_data_of_drivers_lies_below_the_robot_s_folder(tmp_path: Path) -> None:
    """An EDS file is found from the robot's folder, wherever the program runs; a path that leaves the folder is refused."""
    text = """
name = "drives"
[buses]
drives = { link = "can", protocol = "canopen" }
[devices]
ARM = { driver = "cia402", bus = "drives", credentials = { node = 5 }, settings = { eds = "NAME" } }
"""
    (tmp_path / "robot.toml").write_text(text.replace("NAME", "files/maker.eds"))
    robot, problems = check_robot(tmp_path / "robot.toml")
    assert robot is not None, problems
    assert robot.devices["ARM"].settings == {"eds": str(tmp_path / "files" / "maker.eds")}
    for name in ("../maker.eds", "/etc/maker.EDS"):
        (tmp_path / "robot.toml").write_text(text.replace("NAME", name))
        robot, problems = check_robot(tmp_path / "robot.toml")
        assert robot is None
        assert [(p.key, p.line) for p in problems if "leaves the folder" in p.text] == [
            ("devices.ARM.settings", 6)
        ]


def test_what_is_not_installed_is_a_warning() -> None:
    """Another machine may have it: said once, and an error only under strict."""
    text = changed('driver = "hubo_ft"', 'driver = "nobodys_driver"')
    robot, problems = parse_robot(text)
    assert robot is not None
    (one,) = [p for p in problems if "nobodys_driver" in p.text]
    assert one.is_warning
    assert "is not installed" in one.text
    assert "warning: devices.FOOT.driver" in str(one)
    robot, problems = parse_robot(text, is_strict=True)
    assert robot is None
    assert not any(problem.is_warning for problem in problems)
    robot, problems = parse_robot(ARM.replace('"hubo"', '"nobodys_protocol"'))
    assert robot is not None
    assert [p.key for p in problems if "'nobodys_protocol' is not installed" in p.text] == [
        "buses.upper.protocol"
    ]


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("lower = -3.14", "lower = -180", "joints.RSP.lower"),
        ("upper = 3.14", "upper = 180", "joints.RSP.upper"),
        ("bitrate = 1_000_000", "bitrate = 1000", "buses.upper.bitrate"),
        ("rate_hz = 200", "rate_hz = 1e6", "rate_hz"),
        ("[11, 16]", "[1, 1e6]", "joints.RSP.gear"),
        ("channel = 1,", "channel = 1, max_speed = 360,", "joints.RSR.max_speed"),
        ("channel = 1,", "channel = 1, zero = 150.0,", "joints.RSR.zero"),
    ],
)
def test_numbers_of_another_unit_are_warned_of(old: str, new: str, key: str) -> None:
    """Degrees for rad, kbit/s for bit/s: possible, and unlikely."""
    robot, problems = parse_robot(changed(old, new))
    assert robot is not None
    assert key in {problem.key for problem in problems if problem.is_warning}


def test_an_inactive_joint_claims_no_channel() -> None:
    """A spare entry may name a channel that is taken or not there."""
    spare = '\n[joints.SPARE]\ndevice = "JMC8"\nchannel = 0\nactive = false\n'
    assert read(ARM + spare).joints["SPARE"].channel == 0
    assert errors(ARM + spare.replace("false", "true"))


def test_credentials_may_refine_one_another() -> None:
    """Two axes of a node share its number and differ in another: a warning, as both may answer to the number."""
    axes = changed("{ board = 0x24 }", "{ board = 0x30, sensor = 2 }").replace('"hand"', '"foot"')
    robot, problems = parse_robot(axes)
    assert robot is not None
    assert "devices.FOOT.credentials.board" in {p.key for p in problems if p.is_warning}


def test_one_number_is_one_thing_on_all_buses() -> None:
    """A protocol's table has one entry a number: boards of equal number on two buses must be of one kind."""
    lower = (
        'lower = { link = "can", protocol = "hubo" }\n[devices]\n'
        'X = { driver = "d", bus = "lower", credentials = { board = 8 }, '
    )
    assert read(changed("[devices]\n", lower + "channels = 2 }\n")).tables(load_protocol("hubo"))
    (said,) = errors(changed("[devices]\n", lower + "channels = 1 }\n"))
    assert "devices.JMC8.channels: 0x08 is 2 here and 1 as X: hubo has one table of channels" in said


# ---------------------------------------------------------------------- files


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = \n", "r.toml:1: not a TOML file: Invalid value"),
        ('x = 1\n"', "r.toml:2: not a TOML file"),
        ("x = 1\nx = 2\n", "r.toml:2: not a TOML file: Cannot overwrite a value"),
        (b"a = 1\n\xff", "r.toml:2: not a TOML file: not UTF-8 text"),
        ("a = " + "[" * 100_000, "not a robot: nested too deeply"),
        ("a = " + "9" * 5000, "not a TOML file"),
        (b"#" * (2**20 + 1), "larger than a robot's file may be"),
        ("", "r.toml:1: a robot has buses"),
        ('name = "x"\n', "r.toml:1: a robot has buses: [buses], with lines such as"),
    ],
    ids=lambda value: str(value)[:12],
)
def test_what_is_no_robot_says_so(text: str | bytes, said: str) -> None:
    """One clear line, whatever the bytes."""
    robot, problems = parse_robot(text, "r.toml")
    assert robot is None
    assert said in "\n".join(map(str, problems))
    assert len(problems) < 3


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    """A missing file and a folder are the caller's errors; a byte order mark is none."""
    with pytest.raises(CallerError, match=r"none.toml: No such file"):
        check_robot(tmp_path / "none.toml")
    with pytest.raises(CallerError, match="directory"):
        check_robot(tmp_path)
    (tmp_path / "bom.toml").write_text("\ufeff" + ARM, encoding="utf-8")
    assert load_robot(tmp_path / "bom.toml") == read(ARM)


@given(st.data())
def test_a_damaged_file_makes_no_trouble(data: st.DataObject) -> None:
    """A file with a piece cut out or doubled is a robot or has problems."""
    start = data.draw(st.integers(0, len(ARM)))
    end = data.draw(st.integers(start, min(len(ARM), start + 40)))
    text = ARM[:start] + ARM[start:end] * data.draw(st.sampled_from([0, 2])) + ARM[end:]
    robot, problems = parse_robot(text)
    assert (robot is None) == any(not problem.is_warning for problem in problems)


# ---------------------------------------------------------------------- lines


# ---------------------------------------------------------------------- hostile files


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    [
        "".join(
            f"[devices.D{n}]\nbus = 'x{n}'\ndriver = 'd'\ncredentials = {{ a = {n} }}\n" for n in range(3000)
        ),
        "[joints]\n" + "".join(f"J{n} = {{ device = 'K{n}' }}\n" for n in range(5000)),
        "[settings]\n" + ".".join(["a"] * 100_000) + " = 1\n",
        "[joints]\nJ = { device = " + '{ a = "' * 1 + "x" * 500_000 + '" } }\n',
        "[joints]\n" + "x" * 500_000 + " = 1\n",
        "rate_hz = " + "[" * 300 + "]" * 300 + "\n",
        "a = " + '"' + "\\u0041" * 100_000 + '"\n',
        "[[a]]\n" * 5000,
    ],
    ids=["devices", "joints", "dotted", "string", "name", "lists", "escapes", "arrays"],
)
def test_a_hostile_file_costs_little(text: str) -> None:
    """However large and wrong: work in proportion, a bounded number of problems, each of bounded length."""
    found: list[Any] = []
    assert calls(lambda: found.extend(parse_robot('name = "x"\n' + text))) <= 10 * len(text)
    robot, problems = found
    assert robot is None
    assert len(problems) <= 1001
    assert max(len(str(problem)) for problem in problems) < 1000


def test_what_a_driver_may_be_told() -> None:
    """Settings are taken as they are, dates too; but not without end."""
    settings = "{ at = 2021-01-02T03:04:05, list = [1, [2.5, true]], nested = { x = 'y' } }"
    robot = read(changed("channels = 2 }", f"channels = 2, settings = {settings} }}"))
    assert robot.devices["JMC8"].settings["nested"] == {"x": "y"}
    assert read(print_robot(robot)) == robot
    deep = "[" * 20 + "]" * 20
    (said,) = errors(changed("channels = 2 }", f"channels = 2, settings = {{ deep = {deep} }} }}"))
    assert "r.toml:8: devices.JMC8.settings: tables and lists within one another" in said


@pytest.mark.parametrize(
    ("bus", "said"),
    [
        ('protocol = "moteus", channel = "unix:base"', ""),
        ('protocol = "moteus", channel = "tcp:127.0.0.1:29537/can0", interface = "aces"', ""),
        ('protocol = "moteus", channel = "tcp:nowhere"', "HOST:PORT"),
        ('protocol = "moteus", channel = "unix:"', "not an address of a served bus"),
        ('protocol = "moteus", channel = "unix:base", interface = "socketcan"', "interface = 'aces'"),
        ('protocol = "moteus", bitrate = 1_000_000, data_bitrate = 5_000_000', ""),
        ('protocol = "moteus", bitrate = 1_000_000, data_bitrate = 500_000', "not a data rate of CAN FD"),
        ('protocol = "hubo", data_bitrate = 5_000_000', "CAN FD, which hubo does not use"),
    ],
)
def test_served_buses_and_data_rates(bus: str, said: str) -> None:
    """An address of a served bus is one, where a served bus can be; a data rate is one, where CAN FD is spoken."""
    robot, problems = parse_robot(f'name = "x"\n[buses]\nb = {{ link = "can", {bus} }}\n')
    assert [said in str(one) for one in problems] == [True] * bool(said)
    if not said:
        assert robot is not None
        assert parse_robot(print_robot(robot))[0] == robot
