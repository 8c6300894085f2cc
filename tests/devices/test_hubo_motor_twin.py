"""The simulated motor board: every status bit can be reached, faults do what they say, the same run twice is the same."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import pytest

from aces_bus import Frame, make_scanner
from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.hubo_motor import D08, D12, driver
from aces_devices.hubo_motor.axis import home_fields
from aces_devices.hubo_motor.twin import HuboMotorTwin
from aces_protocols.hubo.spec import hubo


@cache
def robot_of(text: str) -> Robot:
    robot, problems = parse_robot(text, "test.toml")
    assert robot is not None, problems
    return robot


def made(text: str = D12, seed: int = 0, board: str = "") -> VirtualRobot:
    """The example's boards, or one of them."""
    robot = robot_of(text)
    return VirtualRobot(robot.part(board) if board else robot, rate_hz=100, seed=seed, load=lambda _: driver)


def up(robot: VirtualRobot) -> None:
    robot.advance(0.9)
    robot.rig.each("enable").wait()
    robot.advance(0.1)


# What brings each bit about; None: nothing needs be done but enabling.
def jammed(robot: VirtualRobot) -> None:
    robot.twins["JMC0"].fault("jam", 1)
    robot["RHY.position"].set(1.0)


def far(robot: VirtualRobot) -> None:
    robot.devices["JMC0"].set_parameters(max_error=1000)
    robot.advance(0.5)
    robot["RHY.position"].set(0.5)
    robot.advance(0.02)


def leap(robot: VirtualRobot) -> None:
    robot.devices["JMC0"].set_parameters(max_step=1000)
    robot.advance(0.5)
    robot["RHY.position"].set(0.5)


def beyond(lower: float | None, upper: float | None, goal: float) -> Callable[[VirtualRobot], None]:
    def run(robot: VirtualRobot) -> None:
        robot.devices["JMC0"].set_limits("RHY", lower=lower, upper=upper)
        robot.advance(0.1)
        robot["RHY.position"].set(goal)

    return run


def fast(robot: VirtualRobot) -> None:
    robot.devices["JMC0"].set_parameters("RHY", max_velocity=100)
    robot.advance(0.5)
    robot["RHY.position"].set(1.0)
    robot.advance(0.1)


def jerky(robot: VirtualRobot) -> None:
    robot.devices["JMC0"].set_parameters("RHY", max_acceleration=100)
    robot.advance(0.5)
    robot["RHY.position"].set(1.0)


def hot(robot: VirtualRobot) -> None:
    robot.devices["JMC0"].set_parameters(temperature_warning=26)
    robot.twins["JMC0"].fault("jam", 1)
    robot["RHY.position"].set(1.0)
    robot.advance(2.0)


def current_mode(robot: VirtualRobot) -> None:
    robot.devices["JMC0"].set_control_mode("current")


def at_switch(robot: VirtualRobot) -> None:
    robot["RHY.position"].set(-0.5)


def fault(name: str) -> Callable[[VirtualRobot], None]:
    def run(robot: VirtualRobot) -> None:
        robot.twins["JMC0"].fault(name, 1)

    return run


def nothing(robot: VirtualRobot) -> None:
    pass


BITS: list[tuple[str, Callable[[VirtualRobot], None]]] = [
    ("driver_on", nothing),
    ("control_on", nothing),
    ("current_mode", current_mode),
    ("limit_switch", at_switch),
    ("jam", jammed),
    ("saturated", jammed),
    ("saturated", fault("saturated")),
    ("big_error", far),
    ("big_error", leap),
    ("encoder_error", fault("encoder_fail")),
    ("driver_fault", fault("fet_fault")),
    ("motor_fail_0", fault("motor_fail_0")),
    ("motor_fail_1", fault("motor_fail_1")),
    ("below_minimum", beyond(-0.1, None, -0.3)),
    ("above_maximum", beyond(None, 0.1, 0.3)),
    ("velocity_error", fast),
    ("velocity_error", fault("overspeed")),
    ("acceleration_error", jerky),
    ("acceleration_error", fault("over_acceleration")),
    ("temperature_error", hot),
    ("temperature_error", fault("hot")),
]


#: Bits that one command sets for both motors.
OF_THE_BOARD = {"driver_on", "control_on", "current_mode", "limit_switch"}


@pytest.mark.parametrize(("bit", "cause"), BITS)
def test_every_status_bit_can_be_reached(bit: str, cause: Callable[[VirtualRobot], None]) -> None:
    """Each bit of the status is set by something that happens to the motor, and read by the driver under its name."""
    with made(board="JMC0") as robot:
        up(robot)
        seen: set[str] = set()
        cause(robot)
        for _ in range(8):
            robot.advance(0.25)
            seen |= set(robot["RHY.status"].last)
            if bit in seen:
                break
        assert bit in seen
        assert bit in OF_THE_BOARD or bit not in robot["RHR.status"].last


def test_the_bits_are_all_there_are() -> None:
    """The list above has every flag that the spec has a name for."""
    variant = hubo.variant("D12")
    scanner = make_scanner([variant], direction="from device", include_unknown=True)
    scanner.sent(variant.encoder.packet(variant["SendStatus"], {"board": 0}))
    (record,) = scanner.feed((Frame(0x150, b"\xff" * 8),))
    motor: Any = record.motor[0]
    assert {bit for bit, _ in BITS} == {*motor.drive, *motor.errors}


@pytest.mark.parametrize(
    "bit", ["driver_on", "limit_switch", "jam", "saturated", "big_error", "encoder_error"]
)
def test_every_bit_of_a_finger_can_be_reached(bit: str) -> None:
    """A hand's status has one byte a motor: the same causes, the same names."""
    with made(board="EJMC4") as robot:
        up(robot)
        twin = robot.twins["EJMC4"]
        channel = twin.channels[0]
        seen: set[str] = set()
        if bit == "jam":
            twin.fault("jam", 1)
            robot["RF1.duty"].set(60)
        elif bit == "limit_switch":
            robot["RF1.duty"].set(-40)
        elif bit == "big_error":
            channel.errors.add("big_error")  # a finger follows no reference that could be far
        elif bit in ("saturated", "encoder_error"):
            twin.fault({"saturated": "saturated", "encoder_error": "encoder_fail"}[bit], 1)
        for _ in range(8):
            robot.advance(0.25)
            seen |= set(robot["RF1.status"].last)
            if bit in seen:
                break
        assert bit in seen


def test_faults_are_documented_and_of_one_motor_or_all() -> None:
    """A fault with an amount is of that motor, from 1; 0 is all of them."""
    assert all(HuboMotorTwin.faults.values())
    with made() as robot:
        twin = robot.twins["JMC0"]
        twin.fault("jam", 2)
        assert [channel.joint.jammed for channel in twin.channels] == [False, True]
        twin.fault("jam", 0)
        assert [channel.joint.jammed for channel in twin.channels] == [True, True]
        twin.fault("jam", on=False)
        assert [channel.joint.jammed for channel in twin.channels] == [False, False]


def test_an_encoder_that_fails_stands_still() -> None:
    """The joint moves on, its counts do not."""
    with made() as robot:
        up(robot)
        robot.twins["JMC0"].fault("encoder_fail", 1)
        robot["RHY.position"].set(0.3)
        robot.advance(1.0)
        assert robot["RHY.position"].value == 0.0
        moved = robot.simulation.world.joints["RHY"].position(robot.clock.now())
        assert abs(moved - 0.3) < 0.1


def test_heat_is_told_in_degrees() -> None:
    """The temperature byte is the hottest motor's; with the fault it is 95 °C."""
    with made() as robot:
        up(robot)
        assert robot["JMC0.temperature"].value == 25
        robot.twins["JMC0"].fault("hot", 1)
        robot.advance(1.0)
        assert robot["JMC0.temperature"].value == 95


def test_currents_rise_with_load() -> None:
    """A blocked motor that is driven takes the current that the duty gives, as far as the field goes."""
    with made() as robot:
        up(robot)
        assert robot["RHY.current"].value == 0.0
        robot.twins["JMC0"].fault("jam", 1)
        robot["RHY.position"].set(1.0)
        robot.advance(1.0)
        assert robot["RHY.current"].value == pytest.approx(8.0)
        assert robot["RHR.current"].value == 0.0


def test_joints_stand_in_the_world() -> None:
    """Other twins find every joint by its name, at its true angle."""
    with made() as robot:
        joints = robot.simulation.world.joints
        assert set(joints) == {"RHY", "RHR", "RHP", "RF1", "RF2", "RF3", "RF4", "RF5"}
        assert all(abs(joint.position(robot.clock.now())) <= 0.05 for joint in joints.values())


def test_the_same_seed_is_the_same_robot() -> None:
    """Joints begin where the seed puts them, and end in the same place, bit by bit; another seed is another robot."""

    def run(seed: int) -> list[float]:
        with VirtualRobot(robot_of(D12), rate_hz=100, seed=seed, homed=False, load=lambda _: driver) as robot:
            up(robot)
            robot["RF1.duty"].set(20)
            robot.advance(0.333)
            return [joint.position(robot.clock.now()) for joint in robot.simulation.world.joints.values()]

    assert run(3) == run(3)
    assert run(3) != run(4)


def test_gains_make_it_stiff_or_limp() -> None:
    """Without gains a joint follows nothing; with its own it does."""
    with made() as robot:
        up(robot)
        board = robot.devices["JMC0"]
        board.set_gains("RHY", kp=0, ki=0, kd=0).wait()
        robot["RHY.position"].set(0.3)
        robot.advance(1.0)
        assert robot["RHY.position"].value == 0.0
        board.set_gains("RHY", kp=200, ki=0, kd=500).wait()
        robot.advance(1.0)
        assert robot["RHY.position"].value == pytest.approx(0.3, abs=2e-3)


def test_sixteen_bits_run_around() -> None:
    """A finger beyond 32767 counts is told as two bytes tell it, not refused."""
    with made() as robot:
        up(robot)
        channel = robot.twins["EJMC4"].channels[0]
        channel.offset = channel.raw(channel.joint.q) - 40_000
        robot.advance(0.1)
        raw = robot["RF1.position"].value * channel.counts
        assert raw == pytest.approx(40_000 - 65_536, abs=2)


def test_nothing_malformed_is_ever_answered() -> None:
    """A board answers what its kind knows; selectors and channels that mean nothing are left alone."""
    with made() as robot:
        robot.advance(0.5)
        board, twin = robot.devices["JMC0"], robot.twins["JMC0"]
        before = twin.replies
        board.send("GetParameters", selector=99)
        board.send("GetParameters", selector=30)
        board.send("DeadZone", channel=3, dead_zone=5)
        robot.advance(0.004)
        kept: Any = [channel.stored.dead_zone for channel in twin.channels]
        assert kept == [0, 0]
        assert twin.replies - before <= 3  # what the polls asked for meanwhile
        with pytest.raises(CallerError):
            home_fields(board.name, board.axes[0], 2)


def test_an_old_board_tells_its_index() -> None:
    """SendPm is answered with the z-phase counts of the first two motors, below one motor turn."""
    with made(D08) as robot:
        robot.advance(0.2)
        record = robot.devices["JMC0"].ask("SendPm", reply="Pm").wait()
        assert list(record.z_phase) == [18600 % 4000, -15000 % 4000]
