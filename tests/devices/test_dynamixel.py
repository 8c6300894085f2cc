"""X-series servos: modes, units, the watchdog, alarms, what survives power-off, answers in turn and jointly."""

from __future__ import annotations

import math
from typing import Any

import pytest

from aces_bus.device import Robot
from aces_bus.errors import CallerError, DeviceError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.dynamixel import driver
from aces_devices.dynamixel.driver import Dynamixel
from aces_devices.dynamixel.twin import DynamixelTwin
from aces_protocols.dynamixel.spec import dynamixel

test_driver = driver_tests(driver)

LINE = """
name = "line"
rate_hz = 50
[buses]
line = {{ link = "serial", protocol = "dynamixel", baud = 1_000_000 }}
[devices]
D1 = {{ driver = "dynamixel", bus = "line", model = "{model}", credentials = {{ id = 1 }}, settings = {{ {settings} }} }}
D2 = {{ driver = "dynamixel", bus = "line", model = "XL430-W250", credentials = {{ id = 2 }} }}
[joints]
J1 = {{ device = "D1", zero = 3.141592653589793{joint} }}
"""


def robot_of(
    joint: str = "", settings: str = "health_s = 0.1, motion = true", model: str = "XM430-W350"
) -> Robot:
    robot, problems = parse_robot(LINE.format(model=model, settings=settings, joint=joint))
    assert robot is not None, problems
    return robot


def made(**options: Any) -> VirtualRobot:
    return VirtualRobot(robot_of(**options), rate_hz=50, load={"dynamixel": driver}.__getitem__)


def first(robot: VirtualRobot) -> tuple[Dynamixel, DynamixelTwin]:
    device, twin = robot.devices["D1"], robot.twins["D1"]
    assert isinstance(device, Dynamixel)
    assert isinstance(twin, DynamixelTwin)
    return device, twin


# ---------------------------------------------------------------------- modes and units


@pytest.mark.slow
def test_a_joint_goes_where_it_is_sent() -> None:
    """Position: 0 rad is count 2048, speed and acceleration limits in SI, measured current in A."""
    with made() as robot:
        robot.advance(0.1)
        device, twin = first(robot)
        assert robot["J1.position"].value == pytest.approx(0, abs=1e-3)
        device.enable().wait()
        robot["J1.speed_limit"].set(0.5)
        robot["J1.position"].set(1.0)
        robot.advance(1.0)
        assert twin["goal_position"] == 2048 + round(4096 / math.tau)
        assert robot["J1.position"].value == pytest.approx(0.5, abs=0.03)
        assert robot["J1.velocity"].value == pytest.approx(0.5, abs=0.02)
        assert robot["J1.current"].value > 0
        robot.advance(2.0)
        assert robot["J1.position"].value == pytest.approx(1.0, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "signal", "value", "register", "raw"),
    [
        (', command = "speed"', "velocity", -2.0, "goal_velocity", -83),
        (', command = "current", direction = -1', "current", 0.269, "goal_current", -100),
        (', command = "duty"', "duty", 0.5, "goal_pwm", 442),
        (', type = "continuous", max_speed = 1000', "position", 20.0, "goal_position", 15086),
    ],
)
def test_what_a_joint_is_commanded_by_decides_the_mode(
    joint: str, signal: str, value: float, register: str, raw: int
) -> None:
    """Velocity, current, PWM, extended position: the goal's raw number, and that the joint turns; a stop is 0, or here."""
    with made(joint=joint) as robot:
        robot.advance(0.1)
        device, twin = first(robot)
        before = robot["J1.position"].value
        device.enable().wait()
        robot[f"J1.{signal}"].set(value)
        robot.advance(0.5)
        assert twin[register] == raw
        assert robot["J1.position"].value * math.copysign(1, value) > before + 0.1
        device.stop_motion().wait()
        robot.advance(5.0)  # without torque it runs out
        assert robot["J1.velocity"].value == 0


def test_in_another_mode_it_is_not_enabled() -> None:
    """A servo that somebody has put into another mode is reported, refused, and set right on demand."""
    robot = made()
    robot.twins["D1"]["operating_mode"] = 1
    with robot:
        robot.advance(0.2)
        device, twin = first(robot)
        assert any("mode velocity" in event.detail for event in robot.events.last)
        with pytest.raises(DeviceError, match="set_mode"):
            device.enable().wait()
        assert twin["torque_enable"] == 0
        with pytest.raises(CallerError, match="confirm=True"):
            device.set_mode(confirm=False)
        device.set_mode(confirm=True).wait()
        device.enable().wait()
        assert (twin["operating_mode"], twin["torque_enable"]) == (3, 1)
        robot.advance(0.2)
        with pytest.raises(CallerError, match="torque off"):
            device.set_mode(confirm=True)


@pytest.mark.parametrize(("model", "why"), [("XL430-W250", "has none"), ("XX", "does not say")])
def test_current_needs_a_model_that_has_it(model: str, why: str) -> None:
    """XL430 has no current, and of an unknown model its unit is not known."""
    with pytest.raises(CallerError, match=why):
        made(joint=', command = "current"', model=model)


# ---------------------------------------------------------------------- safety


def test_the_watchdog_stops_a_servo_whose_host_is_gone() -> None:
    """`enable` sets it. When nothing asks any more, a turning joint stops; goals are refused until it is enabled anew."""
    with made(
        joint=', command = "speed"', settings="health_s = 0.1, motion = true, watchdog_s = 0.2"
    ) as robot:
        robot.advance(0.1)
        device, twin = first(robot)
        device.enable().wait()
        assert twin["bus_watchdog"] == 10
        robot["J1.velocity"].set(1.0)
        robot.advance(0.5)
        robot.rig.hosts["line"].close()
        robot.advance(0.1)
        at = twin.position(robot.clock.now())
        robot.advance(5.0)
        assert twin.position(robot.clock.now()) - at == pytest.approx(
            0.1, abs=0.03
        )  # 0.2 s after the last instruction
        assert twin["bus_watchdog"] == 0xFF
        robot.rig.hosts["line"].open()
        robot.advance(0.5)
        assert any("watchdog" in event.detail for event in robot.events.last)
        assert device.takes(robot["J1.velocity"]) is False
        robot["J1.velocity"].set(1.0)
        assert robot.events.count("not sent", "D1") == 1
        device.stop_motion().wait()
        device.enable().wait()
        assert twin["bus_watchdog"] == 10
        robot["J1.velocity"].set(1.0)
        robot.advance(0.3)
        assert robot["J1.velocity"].value == pytest.approx(1.0, abs=0.02)


def test_a_goal_does_not_switch_the_torque_on() -> None:
    """A servo whose drive mode would do that gets no goal before it is enabled, and that is said."""
    robot = made()
    twin = robot.twins["D1"]
    assert isinstance(twin, DynamixelTwin)
    twin["drive_mode"] = 1 << 3
    with robot:
        robot.advance(0.2)
        device, _ = first(robot)
        assert any("torque on (drive_mode)" in event.detail for event in robot.events.last)
        robot["J1.position"].set(1.0)
        robot.advance(0.5)
        assert twin["goal_position"] == 2048
        device.enable().wait()
        robot.advance(0.2)
        robot["J1.position"].set(1.0)
        robot.advance(1.5)
        assert twin["goal_position"] > 2600


def test_a_hardware_error_is_named_and_lets_go() -> None:
    """A jammed joint is overloaded: named at once, torque off, and over after a restart."""
    with made() as robot:
        robot.advance(0.1)
        device, twin = first(robot)
        device.enable().wait()
        robot["J1.position"].set(1.0)
        twin.fault("jam")
        robot.advance(1.0)
        assert robot["D1.errors"].value == ("overload",)
        assert robot.events.count("alarm", "D1") >= 1
        assert robot["J1.enabled"].value is False
        twin.fault("jam", on=False)
        device.reboot().wait()
        robot.advance(0.5)
        assert robot["D1.errors"].value == ()
        assert robot.events.count("alarm over", "D1") == 1


def test_limits_of_the_servo_limit_the_joint() -> None:
    """Position limits of the EEPROM, once read; a goal beyond them is refused by name, and changes nothing."""
    robot = made()
    robot.twins["D1"]["max_position_limit"] = 3000
    with robot:
        robot.advance(0.1)
        device, twin = first(robot)
        assert robot["J1.position"].upper == pytest.approx((3000 - 2048) * math.tau / 4096, abs=1e-3)
        with pytest.raises(DeviceError, match="data_limit"):
            device.write("goal_position", 3001, raw=True).wait()
        assert twin["goal_position"] == 2048


# ---------------------------------------------------------------------- several at once


def answers(robot: VirtualRobot, message: str, **fields: Any) -> list[Any]:
    """What is on the line after an instruction that nobody here waits for."""
    found: list[Any] = []
    scanner = dynamixel.scanner(direction="from device", include_unknown=True)
    port = robot.ports("listener")["line"]
    packet = dynamixel.encode(message, **fields)
    scanner.sent(packet)
    port.open(lambda data, _: found.extend(scanner.feed(data)))
    port.send(packet)
    robot.advance(0.05)
    return found


def test_answers_come_in_turn_and_jointly() -> None:
    """SyncRead, BulkRead and a broadcast Ping: one status each, in the order asked; fast ones: one packet."""
    robot = VirtualRobot(robot_of(), load={"dynamixel": driver}.__getitem__)
    robot.simulation.open()
    both = {"start": 132, "count": 4}
    assert [(type(r).__name__, r.id) for r in answers(robot, "SyncRead", **both, ids=[2, 1])] == [
        ("Status", 2),
        ("Status", 1),
    ]
    areas = [{"id": 1, "start": 0, "count": 2}, {"id": 2, "start": 146, "count": 1}]
    assert [r.parameters for r in answers(robot, "BulkRead", areas=areas)] == [b"\xfc\x03", b"\x20"]
    assert [r.parameters for r in answers(robot, "Ping", id=0xFE)] == [b"\xfc\x03\x2e", b"\x24\x04\x2e"]
    (joint,) = answers(robot, "FastSyncRead", **both, ids=[1, 2])
    assert type(joint).__name__ == "FastSyncStatus"
    assert [part.id for part in (joint.first, *joint.others)] == [1, 2]
    (bulk,) = answers(robot, "FastBulkRead", areas=areas)
    assert bulk.parameters[:3] == b"\x01\xfc\x03"
    robot.twins["D2"].power(False)
    assert answers(robot, "FastSyncRead", **both, ids=[1, 2]) == []
