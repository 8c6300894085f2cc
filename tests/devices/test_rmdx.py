"""RMD motors and their twins: what switches them on, what ends set-points, the time-out, the brake."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from aces_bus.errors import DeviceError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.rmdx import Rmdx, driver
from aces_devices.rmdx.twin import RmdxTwin

test_rmdx = driver_tests(driver)

ROBOT = """
name = "arm"
rate_hz = 100
[buses]
arm = { link = "can", protocol = "rmdx", bitrate = 1_000_000 }
[devices]
M1 = { driver = "rmdx", bus = "arm", credentials = { id = 1 }, settings = { watchdog_s = 0.2 } }
M2 = { driver = "rmdx", bus = "arm", credentials = { id = 2 } }
[joints]
ELBOW = { device = "M1", direction = -1, zero = 0.2, lower = -1.5, upper = 1.5, max_speed = 4 }
WINCH = { device = "M2", type = "continuous", command = "current", max_current = 5 }
"""


@pytest.fixture
def arm() -> Iterator[VirtualRobot]:
    """Two motors, settled."""
    found, problems = parse_robot(ROBOT)
    assert found is not None, problems
    with VirtualRobot(found, rate_hz=100) as robot:
        robot.advance(0.5)
        yield robot


def motor(robot: VirtualRobot, name: str = "M1") -> Rmdx:
    found = robot.devices[name]
    assert isinstance(found, Rmdx)
    return found


def twin(robot: VirtualRobot, name: str = "M1") -> RmdxTwin:
    found = robot.twins[name]
    assert isinstance(found, RmdxTwin)
    return found


def test_it_goes_where_it_is_sent_and_a_stop_is_confirmed(arm: VirtualRobot) -> None:
    """Position in the joint's own angle; a stop switches it off and is confirmed by the motor's answer."""
    motor(arm).enable().wait(2)
    assert twin(arm).mode == "position"
    arm["ELBOW.position"].set(0.5)
    arm.advance(1.0)
    assert arm["ELBOW.position"].value == pytest.approx(0.5, abs=0.02)
    assert twin(arm).angle == pytest.approx(-(0.5 - 0.2) * 57.2958, abs=1.5)
    motor(arm).stop_motion().wait(1)
    motor(arm).confirm_stopped().wait(1)
    assert (motor(arm).is_on, twin(arm).mode) == (False, "")
    before = twin(arm).requests
    arm["ELBOW.position"].set(1.0)
    arm.advance(0.1)
    assert twin(arm).mode == ""
    assert twin(arm).requests > before  # polls


def test_a_current_opens_the_brake_first(arm: VirtualRobot) -> None:
    """A command of current does not open it (V4.2 §2.19): enabling does."""
    assert twin(arm, "M2").motor.jammed
    motor(arm, "M2").enable().wait(2)
    assert (twin(arm, "M2").motor.jammed, twin(arm, "M2").mode) == (False, "current")
    motor(arm, "M2").lock_brake().wait(2)
    assert twin(arm, "M2").motor.jammed
    assert motor(arm, "M2").is_on is False


def test_without_its_host_the_time_out_cuts_the_output(arm: VirtualRobot) -> None:
    """With `watchdog_s` the motor keeps a time-out; without it goes on for ever (V4.2 §2.30)."""
    for name in ("M1", "M2"):
        motor(arm, name).enable().wait(2)
    assert (twin(arm).kept["timeout"], twin(arm, "M2").kept["timeout"]) == (200, 0)
    assert (motor(arm).host_loss.does, motor(arm, "M2").host_loss.does) == ("limp", "goes on")
    for host in arm.rig.hosts.values():
        host.close()
    arm.advance(0.5)
    assert (twin(arm).mode, twin(arm).motor.jammed) == ("", True)
    assert twin(arm, "M2").mode == "current"


def test_an_error_ends_set_points_until_it_is_enabled_anew(arm: VirtualRobot) -> None:
    """It is named; enabling fails while it lasts."""
    motor(arm).enable().wait(2)
    twin(arm).fault("over_temperature")
    arm.advance(0.5)
    assert motor(arm).is_on is False
    assert "over_temperature" in arm.events.of("alarm")[0].detail
    with pytest.raises(DeviceError, match="over_temperature"):
        motor(arm).enable().wait(2)
    twin(arm).fault("over_temperature", on=False)
    arm.advance(0.5)
    motor(arm).enable().wait(2)
    assert twin(arm).mode == "position"


def test_a_motor_that_was_reset_is_noticed(arm: VirtualRobot) -> None:
    """Its run time begins anew: it is off, and takes no set-points."""
    motor(arm).enable().wait(2)
    arm.advance(1.0)
    motor(arm).send("Reset")
    arm.advance(0.5)
    assert arm.events.of("rebooted")
    assert (motor(arm).is_on, twin(arm).mode) == (False, "")


def test_gains_of_both_protocols_are_read(arm: VirtualRobot) -> None:
    """By number, and six at once."""
    gains = motor(arm).gains().wait(2)
    assert gains["position_kd"] == 100.0
    assert motor(arm).model().wait(2) == "X8S2V10, 20220206"
    old, _ = parse_robot(ROBOT.replace('protocol = "rmdx"', 'protocol = "rmdx", dialect = "3"'))
    assert old is not None
    with VirtualRobot(old, rate_hz=100) as robot:
        robot.advance(0.2)
        assert motor(robot).gains().wait(2) == dict.fromkeys(gains.keys() - {"position_kd"}, 100)
