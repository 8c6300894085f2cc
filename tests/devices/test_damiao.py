"""Damiao motors and their twins: ranges that the motor says, stiffness, the time-out, what ends set-points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError, DeviceError, UnknownNameError
from aces_bus.hardware import ListeningNode, SimulatedBus
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.damiao import driver, fd_driver
from aces_devices.damiao.driver import Damiao
from aces_devices.damiao.twin import DamiaoTwin
from aces_protocols.damiao.spec import damiao

EXCUSED = {"set: ELBOW.velocity": "it is what damping aims at; stiffness holds"}
test_damiao = driver_tests(driver, excused=EXCUSED)
test_damiao_fd = driver_tests(fd_driver, excused=EXCUSED)

ROBOT = """
name = "arm"
rate_hz = 200
[buses]
arm = { link = "can", protocol = "damiao", bitrate = 1_000_000 }
[devices]
DM1 = { driver = "damiao", bus = "arm", credentials = { motor = 1 }, model = "4340" }
DM2 = { driver = "damiao", bus = "arm", credentials = { motor = 2 }, model = "4310", settings = { master = 0x12 } }
[joints]
ELBOW = { device = "DM1", direction = -1, zero = 0.2, lower = -1.5, upper = 1.5, max_speed = 6, gains = { kp = 60, kd = 2 } }
WRIST = { device = "DM2", lower = -1.5, upper = 1.5 }
"""


@pytest.fixture
def arm() -> Iterator[VirtualRobot]:
    """Two motors, settled."""
    with made() as robot:
        robot.advance(0.2)
        yield robot


def made(text: str = ROBOT) -> VirtualRobot:
    found, problems = parse_robot(text)
    assert found is not None, problems
    return VirtualRobot(found, rate_hz=200)


def motor(robot: VirtualRobot, name: str = "DM1") -> Damiao:
    """A motor's driver."""
    found = robot.devices[name]
    assert isinstance(found, Damiao)
    return found


def twin(robot: VirtualRobot, name: str = "DM1") -> DamiaoTwin:
    """A motor's twin."""
    found = robot.twins[name]
    assert isinstance(found, DamiaoTwin)
    return found


def sent(robot: VirtualRobot) -> Callable[[], list[Any]]:
    """What gives the records of all that was sent to the motors from now on."""
    wire = robot.wires["arm"]
    assert isinstance(wire, SimulatedBus)
    heard = ListeningNode(wire)
    return lambda: damiao.scanner(direction="to device").feed(heard.frames())


def names(records: list[Any]) -> list[str]:
    return [type(one).__name__ for one in records]


def test_nothing_is_believed_before_the_motor_has_said_what_its_numbers_mean() -> None:
    """A share of an unknown range says nothing; who only listens has the model's."""
    text = ROBOT.replace(', model = "4340"', "")
    with made(text) as robot:
        robot.twins["DM1"].fault("silent")
        robot.advance(0.4)
        robot.twins["DM1"].fault("silent", on=False)
        robot.advance(0.2)
        assert robot["DM1.status"].value == "disabled"
        assert robot["ELBOW.position"].value is UNKNOWN
        robot.advance(1.5)  # it is asked again
        assert robot["ELBOW.position"].value == pytest.approx(0.0, abs=1e-3)


def test_ranges_are_the_motors(arm: VirtualRobot) -> None:
    """A motor whose registers are others than its model's is read and set by its own, and that is reported."""
    twin(arm).registers[21] = twin(arm).registers[22] = 6.25
    motor(arm).enable().wait()
    assert (
        "its ranges are 6.25, 6.25, 28; the robot's file means 12.5, 10, 28"
        in arm.events.of("alarm")[-1].detail
    )
    arm["ELBOW"].set(0.5)
    arm.advance(1.0)
    assert arm["ELBOW.position"].value == pytest.approx(0.5, abs=0.01)
    assert arm.simulation.world.joints["ELBOW"].position(arm.clock.now()) == pytest.approx(0.5, abs=0.01)


def test_it_is_enabled_where_it_is_with_the_stiffness_of_the_file(arm: VirtualRobot) -> None:
    """Mode and time-out are said before; then each tick has one command, and nothing else is asked."""
    records = sent(arm)
    motor(arm).enable().wait()
    arm.advance(0.1)
    mine = [one for one in records() if one.motor == 1]
    told = names(mine)
    assert told.index("WriteInteger") < told.index("Enable") < told.index("Command")
    write = next(one for one in mine if type(one).__name__ == "WriteInteger")
    assert (write.register, write.value) == ("timeout", 2000)  # 0.1 s
    command = mine[-1]
    assert type(command).__name__ == "Command"
    assert command.position * 12.5 == pytest.approx(0.2, abs=1e-3)  # 0 of the joint
    assert (command.kp, command.kd) == (pytest.approx(60, abs=0.1), pytest.approx(2, abs=1e-3))
    since = told.index("Command")
    assert told[since:].count("AskFeedback") == 0
    assert len(told[since:]) == pytest.approx(20, abs=2)
    assert not arm.events.of("duplicate reply")


def test_stiffness_damping_and_torque_are_the_joints(arm: VirtualRobot) -> None:
    """A joint without stiffness gives way, and is not taken for stuck; torque pushes it."""
    motor(arm, "DM2").enable().wait()
    wrist = arm["WRIST.position"]
    arm["WRIST.position"].set(1.0)
    arm.advance(2.0)
    assert wrist.value == pytest.approx(0.0, abs=1e-3)
    assert not arm.events.of("following error")
    arm["WRIST.torque"].set(0.5)
    arm.advance(0.1)
    assert wrist.value > 0.01
    arm["WRIST.torque"].set(0.0)
    arm["WRIST.kp"].set(30.0)
    arm["WRIST.kd"].set(1.0)
    arm.advance(1.0)
    assert wrist.value == pytest.approx(1.0, abs=0.02)


def test_a_motor_that_hears_nothing_switches_itself_off(arm: VirtualRobot) -> None:
    """Its time-out is a fault; it does not go on when it hears again."""
    motor(arm).enable().wait()
    arm["ELBOW"].set(0.5)
    arm.advance(0.5)
    arm.rig.hosts["arm"].close()
    arm.advance(0.3)
    assert twin(arm).status == "lost_communication"
    arm.rig.hosts["arm"].open()
    arm.advance(0.3)
    assert "lost_communication" in arm.events.of("alarm")[-1].detail
    records = sent(arm)
    arm.advance(0.2)
    assert "Command" not in names([one for one in records() if one.motor == 1])
    with pytest.raises(DeviceError, match="clear it first"):
        motor(arm).enable().wait()
    motor(arm).clear_error().wait()
    motor(arm).enable().wait()


def test_a_stop_is_answered_and_a_fault_ends_set_points(arm: VirtualRobot) -> None:
    """Disable is confirmed by its own feedback; a motor that is silent counts as not stopped."""
    arm.rig.each("enable").wait()
    arm.rig.stop_motion().wait()
    assert (twin(arm).status, twin(arm, "DM2").status) == ("disabled", "disabled")
    motor(arm).enable().wait()
    arm.twins["DM1"].fault("over_current")
    arm.advance(0.1)
    assert arm["DM1.status"].value == "over_current"
    assert not motor(arm).is_on
    arm["ELBOW"].set(0.3)
    arm.advance(0.1)
    assert arm.events.of("not sent")[-1].detail == "ELBOW is off: the set-point is dropped"


def test_a_motor_that_falls_silent_while_it_is_driven_is_reported(arm: VirtualRobot) -> None:
    """Commands are answered, so who does not answer them is gone; when it is back it is off, and stays so."""
    motor(arm).enable().wait()
    arm.advance(0.2)
    arm.twins["DM1"].power(False)
    arm.advance(0.3)
    assert arm.events.of("silent")[-1].device == "DM1"
    assert arm["ELBOW.position"].value is UNKNOWN
    arm.twins["DM1"].power(True)
    arm.advance(0.5)
    assert not motor(arm).is_silent
    assert motor(arm).is_on is False
    assert twin(arm).status == "disabled"


def test_other_modes(arm: VirtualRobot) -> None:
    """The mode is written when the motor is enabled; what it takes can be set."""
    elbow = motor(arm)
    elbow.set_mode("position_velocity")
    assert [name for name, one in elbow.signals.items() if one.is_writable] == ["ELBOW.position"]
    records = sent(arm)
    elbow.enable().wait()
    arm["ELBOW"].set(0.5)
    arm.advance(1.0)
    assert arm["ELBOW.position"].value == pytest.approx(0.5, abs=0.02)
    last = [one for one in records() if type(one).__name__ == "PositionVelocity"][-1]
    assert last.position == pytest.approx(-0.5 + 0.2, abs=1e-6)
    assert last.velocity_limit == 6.0
    with pytest.raises(DeviceError, match="while it is off"):
        elbow.set_mode("mit")


def test_zero_and_registers(arm: VirtualRobot) -> None:
    """Zero is for a motor that is off; what was written is gone when it was switched off, unless it is stored."""
    elbow = motor(arm)
    with pytest.raises(CallerError, match="confirm=True"):
        elbow.set_zero(confirm=False)
    assert arm["ELBOW.position"].value == pytest.approx(0.0, abs=1e-3)
    elbow.set_zero(confirm=True).wait()
    arm.advance(0.05)
    assert arm["ELBOW.position"].value == pytest.approx(
        0.2, abs=1e-3
    )  # direction -1, zero 0.2: the motor's 0
    assert elbow.read("position_max").wait() == 12.5
    elbow.write("velocity_kp", 0.25, confirm=True).wait()
    assert elbow.read(25).wait() == 0.25
    arm.twins["DM1"].reboot()
    arm.advance(0.5)
    assert elbow.read("velocity_kp").wait() == 0.0
    elbow.write("velocity_kp", 0.25, confirm=True).wait()
    elbow.store(confirm=True).wait()
    arm.twins["DM1"].reboot()
    arm.advance(0.5)
    assert elbow.read("velocity_kp").wait() == 0.25
    with pytest.raises(CallerError, match="can only be read"):
        elbow.write("gear_ratio", 1.0, confirm=True)
    with pytest.raises(UnknownNameError, match="position_max"):
        elbow.read("positon_max")


def test_a_model_that_there_is_not() -> None:
    """Named, with those that there are."""
    with pytest.raises(UnknownNameError, match="4310"):
        made(ROBOT.replace('"4340"', '"4341"'))


def test_on_can_fd_the_same_frames_are_of_the_other_format() -> None:
    """A motor is led as on classic CAN; all frames are FD, and none is a message of `damiao`."""
    with made(ROBOT.replace('"damiao"', '"damiao_fd"')) as arm:
        wire = arm.wires["arm"]
        assert isinstance(wire, SimulatedBus)
        recorder = ListeningNode(wire)
        arm.advance(0.2)
        arm.rig.each("enable").wait(5)
        arm["ELBOW"].set(0.4)
        arm.advance(1.0)
        assert arm["ELBOW.position"].value == pytest.approx(0.4, abs=0.03)
        frames = list(recorder.frames())
        assert {frame.is_fd for frame in frames} == {True}
        assert damiao.scanner(direction="from device").feed(frames[:100]) == []
