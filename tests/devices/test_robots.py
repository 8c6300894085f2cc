"""Every robot that ships is whole, and says what its sources say."""

from __future__ import annotations

import math
from importlib.resources import files
from pathlib import Path

import pytest

from aces_bus import list_robots, load_protocol, load_robot
from aces_bus.device import Robot
from aces_bus.device.config import Joint
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.robot import parse_robot
from aces_bus.robot.file import print_robot
from aces_bus.robot.installed import robot_text

NAMES = [
    "drc_hubo",
    "hubo2",
    "hubo2plus",
    "hubovia",
    "minihubo_1",
    "minihubo_2",
    "minihubo_3",
    "omnibot",
    "quadruped",
    "rover",
    "so101",
]
HUBOS = {"drc_hubo": "D12", "hubo2": "D08", "hubo2plus": "D12"}


@pytest.fixture(params=NAMES)
def robot(request: pytest.FixtureRequest) -> Robot:
    return load_robot(request.param)


# ---------------------------------------------------------------------- every robot


def test_the_list_is_the_folder() -> None:
    """By name, in order, read when asked for; an unknown name lists them."""
    assert list(list_robots()) == NAMES
    with pytest.raises(UnknownNameError, match="did you mean 'hubo2plus'"):
        load_robot("hubo2pluss")


def test_a_path_is_a_file(tmp_path: Path) -> None:
    """What ends in .toml, or holds a folder, is read from there."""
    path = tmp_path / "hubo2.toml"
    path.write_text(robot_text("omnibot"), encoding="utf-8")
    assert load_robot(path).name == load_robot(str(path)).name == "omnibot"
    with pytest.raises(CallerError, match="No such file"):
        load_robot("hubo2plus.toml")


def test_nothing_is_wrong_with_it(robot: Robot) -> None:
    """No error, and no warning but of what is not installed."""
    _, problems = parse_robot(robot_text(robot.name))
    assert [str(p) for p in problems if not (p.is_warning and "is not installed" in p.text)] == []


def test_it_says_where_it_is_from(robot: Robot) -> None:
    """Name, doc and source; the file's head lists what is not known."""
    text = robot_text(robot.name)
    assert robot.name in NAMES
    assert robot.doc
    assert robot.source
    assert "# Not known, and therefore not here:" in text
    assert files("aces_devices.robots").joinpath(f"{robot.name}.toml").is_file()


def test_it_is_printed_and_read_back(robot: Robot) -> None:
    """As an equal robot."""
    again, problems = parse_robot(print_robot(robot))
    assert again == robot, problems


def test_every_board_has_its_joints(robot: Robot) -> None:
    """As many joints as channels, from 0 without gaps; every other device has a sensor, or is a power board."""
    for device in robot.devices.values():
        channels = [joint.channel for joint in robot.joints_of(device.name)]
        if device.channels is not None:
            assert channels == list(range(device.channels)), device.name
        else:
            assert channels == []
            assert device.kind == "power" or robot.sensors_of(device.name)


def test_left_and_right_are_alike(robot: Robot) -> None:
    """Gears, encoders and speeds of a left joint are its right one's."""
    for name, joint in robot.joints.items():
        if name[0] != "L":
            continue
        right = robot.joints.get("R" + name[1:])
        if right is None:
            continue
        for key in (
            "gear",
            "harmonic",
            "encoder",
            "command",
            "max_speed",
            "nominal_speed",
            "max_duty",
            "channel",
        ):
            assert getattr(joint, key) == getattr(right, key), (name, key)


def test_names_are_the_same_everywhere(robot: Robot) -> None:
    """A trajectory's names find the joint, whichever program's they are."""
    same = [("WST", "TSY", "HY"), ("LKN", "LKP"), ("RKN", "RKP"), ("LEB", "LEP"), ("REB", "REP")]
    if "RSP" in robot.joints:
        for names in same:
            if "KN" in names[0] and robot.name == "hubovia":
                continue  # it has no legs
            assert len({robot.joint(name).name for name in names}) == 1


# ---------------------------------------------------------------------- Hubo


@pytest.mark.parametrize(("name", "dialect"), HUBOS.items())
def test_its_tables_are_the_protocols(name: str, dialect: str) -> None:
    """What the file says of its boards is the configuration of that name."""
    hubo, robot = load_protocol("hubo"), load_robot(name)
    assert robot.tables(hubo) == hubo.configurations[name]
    assert robot.dialect("hubo") == dialect
    assert sorted(hubo.variant(dialect, robot.tables(hubo)).messages) == sorted(
        hubo.variant(dialect, name).messages
    )


@pytest.mark.parametrize("name", HUBOS)
def test_a_sensor_board_has_both_numbers(name: str) -> None:
    """The sensor's id is the board's number less 0x2F."""
    boards = [d.credentials for d in load_robot(name).devices.values() if "sensor" in d.credentials]
    assert [b["board"] for b in boards] == list(range(0x30, 0x37))
    assert all(b["sensor"] == b["board"] - 0x2F for b in boards)


@pytest.mark.parametrize(
    ("name", "joints", "inactive"), [("hubo2", 40, 3), ("hubo2plus", 38, 3), ("drc_hubo", 34, 0)]
)
def test_it_is_whole(name: str, joints: int, inactive: int) -> None:
    """18 motor boards, 7 or more sensors in use, two buses of 1 Mbit/s."""
    robot = load_robot(name)
    assert len(robot.joints) == joints
    assert [j.active for j in robot.joints.values()].count(False) == inactive
    assert len([d for d in robot.devices.values() if d.driver == "hubo_motor"]) == 18
    assert len([s for s in robot.sensors.values() if s.active]) == (8 if name == "hubo2" else 7)
    assert [(b.name, b.bitrate) for b in robot.buses.values()] == [("lower", 1_000_000), ("upper", 1_000_000)]
    legs = {"JMC0", "JMC7", "FT_RF", "IMU_0"}
    assert legs <= {d.name for d in robot.devices_on("lower")}
    assert robot.devices["EJMC3"].bus == ("upper" if name == "hubo2" else "lower")


#: Counts a rad by drive/driven, harmonic, encoder: the worked table of the protocol's facts.
COUNTS: dict[tuple[object, ...], float] = {
    (10, 25, 100, 4000): 159154.943092,
    (324, 1024, 160, 4000): 321925.257731,
    (324, 1024, 100, 4000): 201203.286082,
    (16, 20, 160, 4000): 127323.954474,
    (16, 16, 160, 4000): 101859.163579,
    (13, 25, 160, 4000): 195883.006882,
    (11, 16, 100, 4000): 92599.239617,
    (1, 1, 100, 4000): 63661.977237,
    (20, 20, 100, 4000): 63661.977237,
    (20, 24, 100, 4000): 76394.372684,
    (10, 20, 100, 4000): 127323.954474,
    (1, 2, 100, 4000): 127323.954474,
    (1, 2, 100, 128): 4074.366543,
    (1, 1, 100, 128): 2037.183272,
    (1, 1, 256, 128): 5215.189175,
    (1, 1, 1, 4096): 4096 / math.tau,
}


@pytest.mark.parametrize("name", HUBOS)
def test_every_gear_is_one_of_the_facts(name: str) -> None:
    """And gives the counts a rad of the worked table."""
    for joint in load_robot(name).joints.values():
        if joint.gear is None:
            assert joint.command == "duty"
            assert joint.counts_per_unit is None
            continue
        assert joint.counts_per_unit == pytest.approx(
            COUNTS[*joint.gear, joint.harmonic, joint.encoder], abs=1e-6
        )


def raw(joint: Joint, position: float) -> int:
    """Position to counts, truncated, as the sources do."""
    assert joint.counts_per_unit is not None
    return math.trunc((joint.direction * position + (joint.zero or 0)) * joint.counts_per_unit)


def test_worked_references_of_hubo() -> None:
    """The bytes that the facts give for board 0 and board 1."""
    robot, hubo = load_robot("hubo2plus"), load_protocol("hubo")
    hip = [raw(robot.joints["RHY"], 0.2), raw(robot.joints["RHR"], -0.05)]
    assert hubo.encode("Reference", board=0, position=hip).data.hex(" ").upper() == "56 7C 00 E0 3E 80"
    pitch = raw(robot.joints["RHP"], -0.1)
    assert (
        hubo.encode("Reference", board=1, position=[pitch, pitch]).data.hex(" ").upper()
        == "BC 31 80 BC 31 80"
    )


def test_the_neck_of_drc_hubo_is_three_servos() -> None:
    """4096 counts a turn, zero in the middle."""
    robot = load_robot("drc_hubo")
    assert [raw(robot.joints[name], 0) for name in ("NKY", "NK1", "NK2")] == [2048] * 3
    assert raw(robot.joints["NKY"], 0.5) == math.floor((0.5 + math.pi) / math.tau * 4096)


def test_drc_hubo_differs_from_hubo2plus_where_its_sources_say() -> None:
    """In these gears, limits and accelerations, and in neck and hands; in nothing else."""
    new, old = load_robot("drc_hubo").joints, load_robot("hubo2plus").joints
    own = {"NKY", "NK1", "NK2", *(f"{s}{x}" for s in "LR" for x in ("WR", "F1", "F2", "F3", "F4", "F5"))}
    gears = {name: j.gear for name, j in new.items() if name not in own and j.gear != old[name].gear}
    assert gears == {
        **{f"{s}SP": (10, 25) for s in "LR"},
        **{f"{s}EB": (10, 20) for s in "LR"},
        **{f"{s}WP": (1, 2) for s in "LR"},
        **{f"{s}KN": (13, 25) for s in "LR"},
    }
    for name in set(new) - own:
        a, b = new[name], old[name]
        assert (a.harmonic, a.encoder, a.device, a.channel) == (b.harmonic, b.encoder, b.device, b.channel)
        assert (a.nominal_speed, a.max_speed) == (b.nominal_speed, b.max_speed)
        assert (a.nominal_acceleration, a.max_acceleration) == (0.8, 200)
        limits = (-3.14, 3.14) if name[1:] == "WP" else (b.lower, b.upper)
        assert (a.lower, a.upper) == limits
    assert set(new) - set(old) == {"LWR", "RWR"}
    assert set(old) - set(new) == {f"{s}F{n}" for s in "LR" for n in (3, 4, 5)}
    assert load_robot("drc_hubo").sensors["RFFT"].signs == (-1, -1, 1)
    gains = new["REB"].compliance
    assert gains is not None
    assert (gains.kp, gains.kd, gains.max_pwm) == (50, 0, 5)


def test_hubo2_has_what_its_scripts_have() -> None:
    """Directions, home offsets, search turns, z-phases, soft limits; the wrists' missing limits stay missing."""
    joints = load_robot("hubo2").joints
    assert {name for name, joint in joints.items() if joint.direction == -1} == {
        *("RHY", "RAP", "LHY", "LHR", "LHP", "LKP", "RSY", "REB", "LSP"),
    }
    rhy, weak, finger = joints["RHY"], joints["RW1"], joints["RF1"]
    assert rhy.home is not None
    assert (rhy.home.offset, rhy.home.direction, rhy.home.search_turns, rhy.home.z_phase) == (
        -18600,
        "ccw",
        10,
        3460,
    )
    assert rhy.gains is not None
    assert (rhy.gains.kp, rhy.gains.ki, rhy.gains.kd, rhy.motor) == (200, 0, 500, 39)
    assert (weak.lower, weak.upper, joints["RW2"].upper) == (None, None, 2.0)
    assert (finger.channel, finger.command, finger.max_duty, finger.motor) == (4, "duty", 15, 9)
    no_limits = {name for name, joint in joints.items() if joint.lower is None}
    assert no_limits == {"RW1", "LW1", "NKY", "NK1", "NK2", *(f"{s}F{n}" for s in "LR" for n in range(1, 6))}
    assert joints["LEB"].gear == (20, 24)


# ---------------------------------------------------------------------- the others


def test_minihubo_servos() -> None:
    """21 servos a robot, with the ids, zeros and directions of its script."""
    scripts = {
        1: {"HY": (64, 2.618, 1), "LKP": (45, 3.747, 1), "REP": (61, 2.641, 1)},
        2: {"HY": (114, 2.605, -1), "LKP": (111, 4.146, -1), "REP": (89, 2.559, -1)},
        3: {"HY": (113, 2.60, -1), "LKP": (75, 1.04, 1), "REP": (104, 2.61, 1)},
    }
    for number, joints in scripts.items():
        robot = load_robot(f"minihubo_{number}")
        assert len(robot.joints) == len(robot.devices) == 21
        for name, expected in joints.items():
            joint = robot.joints[name]
            assert (robot.devices[joint.device].credentials["id"], joint.zero, joint.direction) == expected
        assert all(joint.lower is None and joint.zero is not None for joint in robot.joints.values())


def test_a_worked_servo_position() -> None:
    """Zero 2.605, direction −1: +0.5 → 411, 0 → 508, −0.5 → 606 counts of 300°/1023."""
    joint = load_robot("minihubo_2").joints["HY"]
    assert joint.zero is not None
    scale = 1023 / math.radians(300)
    assert [math.trunc((joint.direction * at + joint.zero) * scale) for at in (0.5, 0, -0.5)] == [
        411,
        508,
        606,
    ]


def test_omnibot_wheels() -> None:
    """Four wheels on two drivers, wired as the script has them, −127…127."""
    robot = load_robot("omnibot")
    wired = {j.name: (robot.devices[j.device].credentials["id"], j.channel) for j in robot.joints.values()}
    assert wired == {"M1": (1, 0), "M2": (2, 1), "M3": (2, 0), "M4": (1, 1)}
    assert {(j.type, j.command, j.max_duty) for j in robot.joints.values()} == {("continuous", "duty", 127)}


def test_the_quadruped_has_a_bus_a_leg() -> None:
    """Three motors a bus, numbered 1 to 3; mirrored legs turn the other way; stiffness and damping are stated."""
    robot = load_robot("quadruped")
    assert len(robot.joints) == 12
    for leg in ("LF", "RF", "LH", "RH"):
        assert [device.credentials["motor"] for device in robot.devices_on(leg)] == [1, 2, 3]
    assert robot.joints["LF_KFE"].direction == -robot.joints["RF_KFE"].direction
    assert all(joint.gains is not None and joint.gains.kp for joint in robot.joints.values())
