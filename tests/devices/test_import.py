"""Robots from other programs' descriptions: what they say is taken over, what is wrong with them is said with its line."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aces_bus import load_protocol, load_robot
from aces_bus.errors import AcesError, CallerError, UnknownNameError
from aces_bus.robot.file import RobotError
from aces_devices.robots import import_robot

TREE = """\
include parts/boards.dd   # boards first
begin meta
name "My Robot"
default_frequency 100
default_can_bus_count 2
end meta

begin   Joint
name            REP
software_index  1
drive 20
driven 20
harmonic 100
encoder 4000
default_kp 40
default_kd 0
default_max_pwm 4
hardware_index 1
jmc_name JMC9
min_max_positions -2.65 0
nominal_and_max_speeds 1 6
nominal_and_max_accels 0.8 15
end Joint
begin Joint
name RSY
software_index 0
hardware_index 0
jmc_name JMC9
end Joint
begin Joint
name RWR
software_index 2
hardware_index 0
jmc_name EJMC4
end Joint
begin FT
name RFFT
type H2P_FT
can_channel 0
hardware_index 0x01
end FT
begin IMU
name TILT_R
type H2P_TILT
can_channel 0
hardware_index 0x01
end IMU
begin FT
name RHFT
type DRC_FT
can_channel 1
hardware_index 06
end FT
"""
BOARDS = """\
begin JMC # RSY REP
name JMC9
type H2P_2CH
can_channel 1
hardware_index 0x09
end JMC
begin JMC
name EJMC4
type DRC_3CH
can_channel 1
hardware_index 0x24
end JMC
"""
JOINTS = """\
#name motNo refEnc drive driven harm enc dir jmc active can numMot kp kd maxPWM zeroed
WST 0 0 10 25  100 4000 1 EJMC3 1 0 1 0 0 0 0
NKY 0 0 1  1   100 128  1 EJMC2 0 1 3 0 0 0 0
NKP 0 0 1  1   100 128  1 EJMC2 0 1 3 0 0 0 0
REB 1 0 20 20  100 4000 -1 JMC9 1 1 2 50 0 5 0
"""
SENSORS = """\
#Name CAN active BoardNumber x-axis y-axis z-axis
RFFT 0 1 1 -1 -1 1
IMU1 0 0 4 0 0 0
"""
HOME = """\
JointName HomeOffset LowerLimit UpperLimit SearchDirection SearchLimit Type
WST       -12500     -169999    170001     1               20          raw
REB       100        -1000      2001       0               30          raw
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "boards.dd").write_text(BOARDS)
    (tmp_path / "robot.dd").write_text(TREE)
    return tmp_path / "robot.dd"


@pytest.fixture
def tables(tmp_path: Path) -> list[Path]:
    files = {"my.joint.table": JOINTS, "my.sensor.table": SENSORS, "my.home": HOME}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    return [tmp_path / name for name in files]


def problems(*paths: Path) -> list[str]:
    with pytest.raises(RobotError) as raised:
        import_robot(paths)
    return [f"{Path(p.file).name}:{p.line}: {p.key}: {p.text}" for p in raised.value.problems]


# ---------------------------------------------------------------------- HuboCan


def test_a_tree_becomes_a_robot(tree: Path) -> None:
    """Joints in the order of their index, boards with as many channels as joints, sensors with their boards."""
    robot = import_robot([tree]).robot
    assert (robot.name, robot.rate_hz, list(robot.joints)) == ("My Robot", 100, ["RSY", "REP", "RWR"])
    rep = robot.joints["REP"]
    assert (rep.gear, rep.lower, rep.upper, rep.max_speed, rep.max_acceleration) == (
        (20, 20),
        -2.65,
        0,
        6,
        15,
    )
    assert rep.compliance is not None
    assert (rep.compliance.kp, rep.compliance.max_pwm, rep.aliases) == (40, 4, ("REB",))
    assert robot.joints["RSY"].lower is None
    assert (robot.devices["JMC9"].channels, robot.devices["JMC9"].model) == (2, "H2P_2CH")
    assert robot.tables(load_protocol("hubo")) == {
        "channels": {0x09: 2, 0x24: "hand", 0x30: "foot", 0x35: "ft"},
        "sensors": {1: "foot", 6: "ft"},
    }
    assert {s.name: robot.devices[s.device].bus for s in robot.sensors.values()} == {
        "RFFT": "lower",
        "TILT_R": "lower",
        "RHFT": "upper",
    }


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "software_index  1",
            "software_index  3",
            "robot.dd:32: software_index: joints are numbered from 0 without gaps: 1 is missing before 2",
        ),
        ("software_index  1", "software_index  0", "robot.dd:26: software_index: 0 is joint REP already"),
        ("software_index  1\n", "", "robot.dd:8: software_index: Joint needs it"),
        ("drive 20", "drive 0", "robot.dd:11: joints.REP.gear: expected two numbers above 0"),
        ("drive 20", "drive twenty", "robot.dd:11: drive: expected a number, not 'twenty'"),
        ("drive 20", "dirve 20", "robot.dd:11: dirve: no key of Joint named 'dirve'; did you mean 'drive'?"),
        ("encoder 4000", "encoder 4000\nencoder 128", "robot.dd:15: encoder: is there twice: see line 14"),
        (
            "min_max_positions -2.65 0",
            "min_max_positions -2.65",
            "robot.dd:20: min_max_positions: expected 2 values, each a number",
        ),
        (
            "min_max_positions -2.65 0",
            "min_max_positions 1 0",
            "robot.dd:20: joints.REP.lower: 1 is not below upper = 0",
        ),
        ("name RSY", "name REP", "robot.dd:25: name: REP is there twice"),
        (
            "hardware_index 0\njmc_name JMC9",
            "hardware_index 1\njmc_name JMC9",
            "joints.REP.channel: channel 1 of JMC9 is joint RSY already",
        ),
        (
            "hardware_index 0\njmc_name JMC9",
            "hardware_index 0\njmc_name JMC8",
            "robot.dd:28: joints.RSY.device: no device named 'JMC8'",
        ),
        (
            "type DRC_FT",
            "type DRC_TF",
            "robot.dd:50: type: no FT type named 'DRC_TF'; did you mean 'DRC_FT'?",
        ),
        ("can_channel 1", "can_channel 9", "robot.dd:51: can_channel: expected 0 or 1 or 2 or 3, not '9'"),
        ("end meta", "end Joint", "robot.dd:6: end: expected end meta, not 'end Joint'"),
        ("end meta\n", "", "robot.dd:2: begin: no end meta follows"),
        (
            "begin meta",
            "begin metta",
            "robot.dd:2: begin: no type of block named 'metta'; did you mean 'meta'?",
        ),
        ("parts/boards.dd", "parts/bords.dd", "robot.dd:1: include: "),
        ("parts/boards.dd", "/etc/boards.dd", "robot.dd:1: include: expected a path relative to this file"),
        ("parts/boards.dd", "robot.dd", "robot.dd:1: include: "),
        ("parts/boards.dd", "parts", "robot.dd:1: include: "),
    ],
)
def test_a_wrong_tree_says_where(tree: Path, old: str, new: str, said: str) -> None:
    """File, line and key, whichever file of the tree it is."""
    assert TREE.count(old) == 1, old
    tree.write_text(TREE.replace(old, new))
    found = problems(tree)
    assert any(one.startswith(said) or said in one for one in found), found


def test_problems_of_an_included_file_name_it(tree: Path) -> None:
    """Two boards with one number."""
    (tree.parent / "parts" / "boards.dd").write_text(BOARDS.replace("0x24", "0x09"))
    assert any("boards.dd:11: devices.EJMC4.credentials.board: board 0x09" in one for one in problems(tree))


# ---------------------------------------------------------------------- hubo-ach


def test_tables_become_a_robot(tables: list[Path]) -> None:
    """Joints, boards, sensors with signs; home offsets; limits without their switch bit, in counts and rad."""
    imported = import_robot(tables)
    robot = imported.robot
    assert (robot.name, list(robot.joints)) == ("my", ["WST", "NKY", "NKP", "REB"])
    assert [j.active for j in robot.joints.values()] == [True, False, False, True]
    assert not robot.devices["EJMC2"].active
    wst, reb = robot.joints["WST"], robot.joints["REB"]
    assert wst.home is not None
    assert (wst.home.offset, wst.home.direction, wst.home.search_turns) == (-12500, "ccw", 20)
    assert (wst.home.lower, wst.home.upper) == (-170000, 170000)
    assert wst.counts_per_unit is not None
    assert (wst.lower, wst.upper) == pytest.approx(
        (-170000 / wst.counts_per_unit, 170000 / wst.counts_per_unit)
    )
    assert reb.home is not None
    assert (reb.home.lower, reb.lower, reb.home.upper, reb.direction) == (None, None, 2000, -1)
    assert [note.rpartition(": ")[0].rpartition(":")[2] for note in imported.notes] == [
        " the lower limit of REB is switched off"
    ]
    assert reb.compliance is not None
    assert (reb.compliance.kp, reb.compliance.max_pwm) == (50, 5)
    assert robot.sensors["RFFT"].signs == (-1, -1, 1)
    assert robot.sensors["IMU1"].signs is None
    assert robot.tables(load_protocol("hubo"))["channels"] == {
        0x23: 1,
        0x22: 3,
        0x09: 2,
        0x30: "foot",
        0x33: "imu",
    }


def test_three_motors_on_a_hand_are_a_drc_hubos(tables: list[Path]) -> None:
    """Its hands have wrist rolls, its neck is three servos."""
    tables[0].write_text(JOINTS + "RWR 0 0 1 2 100 128 1 EJMC4 1 1 3 0 0 0 0\n")
    channels = import_robot(tables[:1]).robot.tables(load_protocol("hubo"))["channels"]
    assert (channels[0x24], channels[0x22]) == ("hand", "neck")


def test_an_inactive_row_claims_nothing_of_its_board(tables: list[Path]) -> None:
    """The active rows say how many motors a board has, and on which bus, wherever they stand."""
    spare = "SPARE 2 0 1 1 100 4000 1 JMC9 0 0 3 0 0 0 0\n"
    for text in (JOINTS + spare, JOINTS.replace("REB", spare + "REB")):
        tables[0].write_text(text)
        board = import_robot(tables[:1]).robot.devices["JMC9"]
        assert (board.channels, board.bus, board.active) == (2, "upper", True)


def test_a_table_in_rad(tables: list[Path]) -> None:
    """Offsets become counts, limits stay rad."""
    tables[2].write_text("JointName x y z d l t\nWST 0.1 -1.5 1.5 0 20 rad\n")
    wst = import_robot(tables).robot.joints["WST"]
    assert wst.home is not None
    assert (wst.home.offset, wst.lower, wst.upper) == (15915, -1.5, 1.5)


def test_a_home_table_alone_is_laid_over_a_robot_that_ships(tables: list[Path]) -> None:
    """The one that has its joints, said; or the one that is named."""
    tables[2].write_text(HOME + "LWR 0 1 3 0 20 raw\n")
    imported = import_robot(tables[2:])
    assert "laid over drc_hubo" in imported.notes[0]
    assert list(imported.robot.joints) == list(load_robot("drc_hubo").joints)
    assert import_robot(tables[2:], base="hubo2").robot.joints["LW2"].home is not None
    with pytest.raises(UnknownNameError, match="hubo2plus"):
        import_robot(tables[2:], base="hubo3")
    tables[2].write_text(HOME + "TAIL 0 1 3 0 20 raw\n")
    with pytest.raises(CallerError, match="name --base"):
        import_robot(tables[2:])


@pytest.mark.parametrize(
    ("table", "old", "new", "said"),
    [
        (0, "JMC9 1", "JMC99 1", "my.joint.table:5: jmc: expected JMC0…EJMC15, not 'JMC99'"),
        (0, "-1 JMC9", "-2 JMC9", "my.joint.table:5: dir: expected 1 or -1, not '-2'"),
        (0, "-1 JMC9", "JMC9", "my.joint.table:5: : expected 16 columns"),
        (0, "WST 0", "WST zero", "my.joint.table:2: motNo: expected a whole number, not 'zero'"),
        (0, "NKP", "NKY", "my.joint.table:4: name: NKY is there twice: see line 3"),
        (
            0,
            "REB 1",
            "RSY 0 0 1 1 100 4000 1 JMC9 1 0 2 0 0 0 0\nREB 1",
            "my.joint.table:6: jmc: JMC9 has other numMot or can (2, 1) than before (2, 0)",
        ),
        (0, "10 25", "10 0", "my.joint.table:2: joints.WST.gear: expected two numbers above 0"),
        (0, "REB 1", "REB 2", "my.joint.table:5: joints.REB.channel: JMC9 has no channel 2 (it has: 0…1)"),
        (1, "0 1 1 -1", "0 1 16 -1", "my.sensor.table:2: board: expected 1…15, not '16'"),
        (1, "-1 -1 1", "-1 -1 7", "my.sensor.table:2: z-axis: expected 1 or -1 or 0, not '7'"),
        (2, "REB ", "TAIL ", "my.home:3: JointName: no joint is named 'TAIL'"),
        (2, "30          raw", "30          deg", "my.home:3: Type: expected raw or rad, not 'deg'"),
        (2, "-169999", "170003", "my.home:2: joints.WST.home.lower: 170002 is not below upper = 170000"),
    ],
)
def test_a_wrong_table_says_where(tables: list[Path], table: int, old: str, new: str, said: str) -> None:
    """File, line and column."""
    text = tables[table].read_text()
    assert text.count(old) == 1, old
    tables[table].write_text(text.replace(old, new))
    assert any(one.startswith(said) for one in problems(*tables)), problems(*tables)


def test_files_that_do_not_go_together(tree: Path, tables: list[Path]) -> None:
    """Two of a kind, a tree and a table, what is none of them."""
    with pytest.raises(CallerError, match=r"both a joint table"):
        import_robot([tables[0], tables[0]])
    with pytest.raises(CallerError, match=r"a \.dd tree and a table"):
        import_robot([tree, tables[1]])
    with pytest.raises(CallerError, match="--base"):
        import_robot(tables, base="hubo2")
    for content in (b"", b"a b c\n", b"\0\1", b"#" * (2**20 + 1)):
        (tree.parent / "x").write_bytes(content)
        with pytest.raises(CallerError, match="x: "):
            import_robot([tree.parent / "x"])
    with pytest.raises(CallerError, match="not a file"):
        import_robot([tree.parent])
    with pytest.raises(CallerError, match="No such file"):
        import_robot([tree.parent / "none"])


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_is_never_a_traceback(tmp_path: Path, data: st.DataObject) -> None:
    """A description with a piece replaced by anything is a robot or an error that says why."""
    text = data.draw(st.sampled_from([TREE.replace("include", "#"), JOINTS, SENSORS, HOME]))
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 30)))
    words = st.sampled_from(
        ["0", "-1", "0x", "1e999", "nan", "9" * 30, "begin", "end", '"', "é", " ", "\n", "1_0", ""]
    )
    path = tmp_path / "x"
    path.write_text(text[:start] + data.draw(words) + text[end:], encoding="utf-8")
    try:
        said = import_robot([path]).robot.source or ""
    except AcesError as error:
        said = str(error)
    assert path.name in said
