"""What goes wrong on a robot's buses, with the drivers of Hubo 2+ on virtual wires: told by name, survived, never passed
for fresh."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from aces_bus import load_robot
from aces_bus.device import UNKNOWN, Robot
from aces_bus.errors import NoReplyError
from aces_bus.robot import VirtualRobot
from tests.conftest import PROFILE

RATE = 200.0
#: A board of two motors, and another beside it.
BOARD, JOINT, OTHER = "JMC0", "RHY", "RHP"
HIP = (JOINT, OTHER)
LEGS = (*HIP, "RKN", "RAP", "LHY", "LHP", "LKN", "LAP")


@pytest.fixture
def joints() -> tuple[str, ...]:
    """The joints whose boards are there; a test that needs more than a hip names them."""
    return HIP


@pytest.fixture
def hubo(joints: tuple[str, ...]) -> Robot:
    """The file of Hubo 2+, in the short profile with these boards alone."""
    robot = load_robot("hubo2plus")
    return robot if PROFILE == "long" else robot.part(*joints)


@pytest.fixture
def robot(hubo: Robot) -> Iterator[VirtualRobot]:
    """Hubo 2+ with everybody heard."""
    with VirtualRobot(hubo, rate_hz=RATE) as robot:
        robot.advance(0.5)
        assert not robot.events.of("silent")
        yield robot


def kinds(robot: VirtualRobot, device: str) -> set[str]:
    """What was told of a device."""
    return {kind for (kind, who) in robot.events.counts if who == device}


def told(robot: VirtualRobot, kind: str, device: str) -> str:
    """The details of the last event of a kind."""
    return str([event for event in robot.events.of(kind) if event.device == device][-1].detail)


def still_lives(robot: VirtualRobot) -> None:
    """The other boards are as fresh as before."""
    assert robot[f"{OTHER}.position"].value is not UNKNOWN
    age_ns = robot[f"{OTHER}.position"].age_ns
    assert age_ns is not None
    assert age_ns <= 3 * 1e9 / RATE
    assert not robot.events.failures
    assert not robot.events.of("bug")


@pytest.mark.slow
def test_a_lost_reply(robot: VirtualRobot) -> None:
    """A reply that is lost now and then costs the value one tick, and the board is not silent."""
    twin = robot.twins[BOARD]
    host = robot.rig.hosts["lower"]
    repeated = host.counts.repeated
    twin.fault("loses", 10)
    ages: list[int] = []
    for _ in range(100):
        robot.advance(1 / RATE)
        age_ns = robot[f"{JOINT}.position"].age_ns
        assert age_ns is not None
        ages.append(age_ns)
    assert host.counts.repeated > repeated
    assert max(ages) <= 2 * 1e9 / RATE
    assert robot[f"{JOINT}.position"].value is not UNKNOWN
    assert "silent" not in kinds(robot, BOARD)
    assert "malformed" not in kinds(robot, BOARD)
    still_lives(robot)


def test_a_request_whose_replies_are_all_lost(robot: VirtualRobot) -> None:
    """A request that nobody answers is repeated, fails by name, and holds up nobody."""
    robot.twins[BOARD].fault("silent")
    ticket = robot.devices[BOARD].ask("SendEncoder", selector=0, reply=("Encoder",), retries=2)
    with pytest.raises(NoReplyError, match=f"{BOARD}: no answer to SendEncoder within 50 ms .3 tries."):
        ticket.wait(5)
    assert ticket.tries == 3
    assert told(robot, "no reply", BOARD) == "SendEncoder, 3 tries"
    still_lives(robot)


def test_a_board_that_falls_silent_and_comes_back(robot: VirtualRobot) -> None:
    """Silence is told once with its age, values go stale, and the first answer ends it."""
    signal = robot[f"{JOINT}.position"]
    robot.twins[BOARD].fault("silent")
    robot.advance(0.5)
    assert robot.events.count("silent", BOARD) == 1
    assert "last received 0." in told(robot, "silent", BOARD)
    assert signal.value is UNKNOWN
    assert signal.last is not UNKNOWN
    assert signal.is_stale
    still_lives(robot)
    robot.twins[BOARD].fault("silent", on=False)
    robot.advance(0.2)
    assert robot.events.count("answers", BOARD) == 1
    assert signal.value is not UNKNOWN


@pytest.mark.parametrize("joints", [(*HIP, "LAP", "RSP")], ids=["both buses"])
def test_a_wrong_number(robot: VirtualRobot) -> None:
    """A board that answers with a number that nobody has on this bus is a stranger by name; nothing of it is believed."""
    robot.twins["JMC7"].fault("wrong_number", 0x08)
    robot.advance(0.5)
    strangers = [event.detail for event in robot.events.of("unknown device")]
    assert any("Encoder of board 0x08" in one and "not on this bus" in one for one in strangers)
    assert robot["RSP.position"].value is not UNKNOWN  # board 0x08 of the other bus
    assert "silent" in kinds(robot, "JMC7")
    assert robot["LAP.position"].value is UNKNOWN
    still_lives(robot)


@pytest.mark.parametrize("joints", [(*HIP, "LHY", "LHP")], ids=["hips"])
def test_the_number_of_another_board(robot: VirtualRobot) -> None:
    """A board that answers with its neighbour's number makes two answers of one; both are told."""
    robot.twins["JMC4"].fault("wrong_number", robot.twins["JMC5"].credentials["board"])
    robot.advance(0.5)
    assert "silent" in kinds(robot, "JMC4")
    assert robot["LHY.position"].value is UNKNOWN
    # JMC5 has one motor, JMC4 two: the frame is too long for what JMC5 says.
    assert kinds(robot, "JMC5") & {"duplicate reply", "malformed"}
    still_lives(robot)


def test_a_rebooted_board(robot: VirtualRobot) -> None:
    """A board that was off for a moment has forgotten its enabling: that is told, set-points end, nothing moves."""
    robot.devices[BOARD].enable().wait(10)
    robot.advance(1)
    signal = robot[f"{JOINT}.position"]
    signal.set(0.1)
    robot.advance(1)
    assert signal.value == pytest.approx(0.1, abs=0.01)
    twin = robot.twins[BOARD]
    twin.power(False)
    robot.advance(0.3)
    assert signal.value is UNKNOWN
    twin.power(True)
    robot.advance(1.0)
    assert robot.events.count("rebooted", BOARD) >= 1
    assert told(robot, "rebooted", BOARD)
    joint = robot.simulation.world.joints[JOINT]
    where = joint.position(robot.clock.now())
    robot.advance(0.5)
    assert joint.position(robot.clock.now()) == pytest.approx(where, abs=1e-3)
    assert robot[f"{JOINT}.enabled"].value is False
    still_lives(robot)


def test_two_boards_with_one_number(robot: VirtualRobot, hubo: Robot) -> None:
    """A second board with a number that is taken is told as such, and when it has gone all is as before."""
    from msgspec.structs import replace

    from aces_bus.robot.rig import simulate

    only = {name: replace(c, active=name == BOARD) for name, c in hubo.devices.items()}
    double = simulate(replace(hubo, devices=only), robot.ports("double"), seed=2)
    double.twins[BOARD].reply_delay_ns += 3_000_000  # frames of the same bits at the same time are one frame
    with double:
        robot.advance(1.0)
        assert robot.events.count("duplicate reply", BOARD) >= 1
        assert "two devices with board 0x00" in told(robot, "two devices", BOARD)
        still_lives(robot)
    robot.advance(0.5)
    count = robot.events.count("duplicate reply", BOARD)
    robot.advance(1.0)
    assert robot.events.count("duplicate reply", BOARD) == count
    assert robot[f"{JOINT}.position"].value is not UNKNOWN


def test_a_three_channel_frame_of_a_two_channel_board(robot: VirtualRobot) -> None:
    """Positions of three motors, from a board that has two, are malformed: told with the bytes, none is an angle."""
    from aces_bus import Frame

    device, twin = robot.devices[BOARD], robot.twins[BOARD]
    before = robot[f"{JOINT}.position"].last
    twin.fault("silent")
    for _ in range(60):
        twin.send_raw(Frame(0x060 + device.credentials["board"], data=bytes((0x11, 0x22) * 3)))
        robot.advance(1 / RATE)
    assert robot.events.count("malformed", BOARD) >= 60
    assert "11 22 11 22 11 22" in told(robot, "malformed", BOARD)
    assert robot[f"{JOINT}.position"].value is UNKNOWN
    assert robot[f"{JOINT}.position"].last == before
    still_lives(robot)
    twin.fault("silent", on=False)
    robot.advance(0.3)
    assert robot[f"{JOINT}.position"].value is not UNKNOWN


def test_late_answers(robot: VirtualRobot) -> None:
    """Answers after their time are told as late; what they say carries the instant at which it came."""
    robot.twins[BOARD].fault("late", 0.08)
    robot.advance(1.0)
    assert kinds(robot, BOARD) & {"late reply", "silent"}
    position = robot[f"{JOINT}.position"]
    assert position.instant is not None
    assert position.instant <= robot.clock.now()
    still_lives(robot)


@pytest.mark.slow
@pytest.mark.parametrize("joints", [LEGS], ids=["legs"])
def test_everything_at_once(robot: VirtualRobot) -> None:
    """One board silent, one late, one doubled, one cut short, one lossy: the others answer every tick."""
    for name, fault in (
        ("JMC2", "silent"),
        ("JMC3", "late"),
        ("JMC4", "twice"),
        ("JMC7", "short"),
        ("JMC6", "loses"),
    ):
        robot.twins[name].fault(fault)
    robot.advance(1.0)
    assert "silent" in kinds(robot, "JMC2")
    assert kinds(robot, "JMC3") & {"late reply", "silent"}
    assert {"duplicate reply", "two devices"} <= kinds(robot, "JMC4")
    assert "malformed" in kinds(robot, "JMC7")
    for joint in ("RKN", "LAP", "LAR"):
        assert robot[f"{joint}.position"].value is UNKNOWN
    still_lives(robot)
    for name in ("JMC2", "JMC3", "JMC4", "JMC6", "JMC7"):
        robot.twins[name].active_faults.clear()
    robot.advance(1.0)
    assert all(not device.is_silent for device in robot.devices.values())
    assert all(robot[f"{j}.position"].value is not UNKNOWN for j in ("RKN", "RAP", "LHY", "LAP", "LKN"))
