"""HuboVia motors and their twins."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, radians

import pytest

from aces_bus import load_robot
from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.hubovia import driver
from aces_devices.hubovia.driver import angle_bytes

test_hubovia = driver_tests(driver)

ROBOT = """
name = "via"
rate_hz = 50
[buses]
pc = { link = "datagram", protocol = "hubovia" }
[devices]
A = { driver = "hubovia", bus = "pc", credentials = { motor = 35 }, channels = 1 }
B = { driver = "hubovia", bus = "pc", credentials = { motor = 30 }, channels = 1 }
[joints]
LSR = { device = "A", motor = 35, direction = -1, lower = -2.0, upper = 2.0 }
RSP = { device = "B", motor = 30 }
"""


def made(text: str) -> Robot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return robot


def assembled(robot: Robot) -> VirtualRobot:
    return VirtualRobot(robot, rate_hz=50, load={"hubovia": driver}.__getitem__)


@pytest.fixture
def robot() -> Iterator[VirtualRobot]:
    with assembled(made(ROBOT)) as made_robot:
        yield made_robot


def listen(robot: VirtualRobot) -> list[bytes]:
    """All datagrams from now on."""
    heard: list[bytes] = []
    robot.wires["pc"].attach("listener", lambda packet, instant: heard.append(packet))
    return heard


@pytest.mark.parametrize(
    ("joint", "position", "data"),
    [
        ("LSR", 87.73, "FF 41 01 23 80 57 49 43"),  # direction −1
        ("RSP", 45.5, "FF 41 01 1E 00 2D 32 7D"),
        ("RSP", 300.25, "FF 41 01 1E 01 2C 19 64"),
    ],
)
def test_worked_examples(robot: VirtualRobot, joint: str, position: float, data: str) -> None:
    """A set-point in rad goes out as the datagram of the sheet, once; its twin, and no other, turns to it."""
    heard = listen(robot)
    robot[f"{joint}.position"].set(radians(position))
    robot.advance(0.5)
    assert heard == [bytes.fromhex(data)]
    robot.advance(6)
    where = {name: one.position(robot.clock.now()) for name, one in robot.simulation.world.joints.items()}
    assert degrees(where.pop(joint)) == pytest.approx(position)
    assert list(where.values()) == [0.0]


@pytest.mark.parametrize(
    ("angle", "told"),
    [
        (29.996, (0, 30, 0)),
        (-29.994, (1, 29, 99)),
        (0.001, (0, 0, 0)),
        (-0.004, (0, 0, 0)),
        (0.29, (0, 0, 29)),
    ],
)
def test_hundredths_are_rounded_with_carry(angle: float, told: tuple[int, int, int]) -> None:
    """Rounding goes through all places; there is no negative zero."""
    found = angle_bytes(angle)
    assert (found["negative"], found["degrees"], round(found["hundredths"] * 100)) == told


def test_what_waits_is_replaced(robot: VirtualRobot) -> None:
    """Of several set-points within a tick the last one goes out; nothing more until there is a new one."""
    robot.advance(0.005)  # between two ticks
    heard = listen(robot)
    for degree in (1, 2, 3):
        robot["RSP.position"].set(radians(degree))
    robot.advance(1)
    assert heard == [bytes.fromhex("FF 41 01 1E 00 03 00 21")]
    robot.devices["B"].repeat()
    robot.advance(0.1)
    assert heard == [heard[0]] * 2


def test_stopping_forgets_what_waits(robot: VirtualRobot) -> None:
    """A set-point that has not gone out does not, after a stop."""
    robot.advance(0.005)
    heard = listen(robot)
    robot["RSP.position"].set(1.0)
    robot.rig.stop_motion()
    robot.advance(1)
    assert heard == []


def test_what_no_datagram_holds_is_limited(robot: VirtualRobot) -> None:
    """An angle beyond 15 bits of degrees is told and limited, not wrapped."""
    robot["RSP.position"].set(1000.0)
    robot.advance(0.1)
    assert robot.events.count("limited", "B") == 1
    assert robot.twins["B"].angle == pytest.approx(32767.99)


def test_bad_checks_are_counted(robot: VirtualRobot) -> None:
    """A datagram with a wrong check moves nothing, and the twins can tell."""
    node = robot.wires["pc"].attach("stranger")
    node.send(bytes.fromhex("FF 41 01 1E 00 2D 32 7E"))
    robot.advance(0.1)
    assert robot.twins["B"].angle is None
    assert robot.twins["B"].bad_checks == 1


def test_a_stuck_motor_stays(robot: VirtualRobot) -> None:
    """It goes on from where it was when it is free again."""
    twin = robot.twins["B"]
    robot["RSP.position"].set(2.0)
    robot.advance(0.5)
    twin.fault("stuck")
    held = twin.position(robot.clock.now())
    robot.advance(1)
    assert twin.position(robot.clock.now()) == held < 1
    twin.fault("stuck", on=False)
    robot.advance(0.25)
    assert twin.position(robot.clock.now()) == pytest.approx(held + 0.25)


def test_a_joint_of_another_motor_is_refused() -> None:
    """The number in the joint and that of the device must be one."""
    with pytest.raises(CallerError, match="B is motor 30; its joint RSP says 31"):
        assembled(made(ROBOT.replace("motor = 30 }\n", "motor = 31 }\n")))


def test_the_shipped_robot() -> None:
    """Every joint of hubovia.toml is reached by its motor's number: the sheet's plus 10, but for wrists."""
    sheet, via = load_robot("hubo2"), load_robot("hubovia")
    with assembled(via) as robot:
        for name, joint in via.joints.items():
            wrist = name in ("RWY", "LWY")
            assert joint.motor == (sheet.joint(name).motor or 0) + (0 if wrist else 10)
            robot[f"{name}.position"].set(0.5)
        robot.advance(1)
        for name, model in robot.simulation.world.joints.items():
            assert model.position(robot.clock.now()) == pytest.approx(0.5, abs=1e-4), name
