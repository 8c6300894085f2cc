"""CyberGear and RobStride motors and their twins: ranges of models, modes, what ends set-points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from aces_bus.errors import CallerError, DeviceError, UnknownNameError
from aces_bus.hardware import ListeningNode, SimulatedBus
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.robstride import driver, mit_driver
from aces_devices.robstride.driver import Robstride
from aces_devices.robstride.twin import RobstrideTwin
from aces_protocols.robstride.spec import robstride
from aces_protocols.robstride_mit.spec import robstride_mit

COMMANDS = "told by what answers commands alone; none is sent while it is off"
EXCUSED = {
    "set: HIP.velocity": "it is what damping aims at; stiffness holds",
    **{f"received: {name}": COMMANDS for name in ("*.torque", "*.state", "*.temperature")},
}
test_robstride = driver_tests(driver, excused=EXCUSED)
MIT_EXCUSED = {
    **{f"set: {name}.velocity": EXCUSED["set: HIP.velocity"] for name in ("HIP", "KNEE")},
    **{f"set: {name}.torque": "stiffness holds against it" for name in ("HIP", "KNEE")},
}
test_robstride_mit = driver_tests(mit_driver, excused=MIT_EXCUSED)

ROBOT = """
name = "leg"
rate_hz = 200
[buses]
leg = { link = "can", protocol = "robstride", bitrate = 1_000_000 }
[devices]
M1 = { driver = "robstride", bus = "leg", credentials = { motor = 1 }, model = "RS04", settings = { torque_limit = 40 } }
M2 = { driver = "robstride", bus = "leg", credentials = { motor = 2 }, model = "RS02", settings = { mode = "position" } }
[joints]
HIP = { device = "M1", direction = -1, zero = 0.2, lower = -1.5, upper = 1.5, max_speed = 6, gains = { kp = 200, kd = 5 } }
KNEE = { device = "M2", gear = [1, 2], lower = -1, upper = 1, max_speed = 3, max_current = 10 }
"""


def made(text: str = ROBOT) -> VirtualRobot:
    found, problems = parse_robot(text)
    assert found is not None, problems
    return VirtualRobot(found, rate_hz=200)


@pytest.fixture
def leg() -> Iterator[VirtualRobot]:
    """Two motors, settled."""
    with made() as robot:
        robot.advance(0.3)
        yield robot


def motor(robot: VirtualRobot, name: str = "M1") -> Robstride:
    """A motor's driver."""
    found = robot.devices[name]
    assert isinstance(found, Robstride)
    return found


def twin(robot: VirtualRobot, name: str = "M1") -> RobstrideTwin:
    """A motor's twin."""
    found = robot.twins[name]
    assert isinstance(found, RobstrideTwin)
    return found


def sent(robot: VirtualRobot) -> Callable[[], list[Any]]:
    """What gives the records of all that was sent to the motors from now on."""
    wire = robot.wires["leg"]
    assert isinstance(wire, SimulatedBus)
    heard = ListeningNode(wire)
    return lambda: robstride.scanner(direction="to device").feed(heard.frames())


def names(records: list[Any]) -> list[str]:
    return [type(one).__name__ for one in records]


def test_a_model_that_sources_disagree_about_needs_ranges() -> None:
    """A wrong range is a wrong torque: nothing is guessed."""
    with pytest.raises(CallerError, match="disagree about a RS03"):
        made(ROBOT.replace('"RS04"', '"RS03"'))
    with pytest.raises(UnknownNameError, match="RS03 and 3 more"):
        made(ROBOT.replace('model = "RS04", ', ""))
    ranges = "settings = { ranges = [12.566, 50, 60, 5000, 100] }"
    with made(
        ROBOT.replace('model = "RS04", settings = { torque_limit = 40 }', f'model = "RS03", {ranges}')
    ) as robot:
        robot.rig.each("enable").wait()
        robot["HIP"].set(0.5)
        robot.advance(1.0)
        assert robot["HIP.position"].value == pytest.approx(0.5, abs=0.02)


def test_enabling_stops_sets_the_mode_switches_on_and_limits(leg: VirtualRobot) -> None:
    """In this order; then it is held where it is, with the gains of the file, one command a tick."""
    records = sent(leg)
    motor(leg).enable().wait()
    leg.advance(0.1)
    mine = [one for one in records() if one.motor == 1]
    told = names(mine)
    assert told.index("Stop") < told.index("WriteByte") < told.index("Enable") < told.index("WriteFloat")
    limit = mine[told.index("WriteFloat")]
    assert (limit.index, limit.value) == ("limit_torque", 40.0)
    command = [one for one in mine if type(one).__name__ == "Command"][-1]
    assert command.position * 12.566370614 == pytest.approx(0.2, abs=1e-3)  # 0 of the joint
    assert command.kp * 5000 == pytest.approx(200, abs=0.1)
    assert command.kd * 100 == pytest.approx(5, abs=0.01)
    assert abs(command.torque * 120) < 0.002
    leg["HIP"].set(0.5)
    leg.advance(1.0)
    assert leg["HIP.position"].value == pytest.approx(0.5, abs=0.02)
    assert leg.simulation.world.joints["HIP"].position(leg.clock.now()) == pytest.approx(0.5, abs=0.02)


def test_position_mode_goes_through_the_gear(leg: VirtualRobot) -> None:
    """Its set-point is a parameter; limits of speed and current are written when it is enabled."""
    records = sent(leg)
    motor(leg, "M2").enable().wait()
    leg["KNEE"].set(0.5)
    leg.advance(1.0)
    assert leg["KNEE.position"].value == pytest.approx(0.5, abs=0.02)
    written = {one.index: one.value for one in records() if type(one).__name__ == "WriteFloat"}
    assert written == {"limit_spd": 6.0, "limit_cur": 10.0, "loc_ref": 1.0}
    with pytest.raises(CallerError, match="read-only"):
        leg["KNEE.kp"].set(3.0)


def test_a_fault_ends_set_points_and_has_a_name(leg: VirtualRobot) -> None:
    """As the identifier of its feedback says; it is enabled again when it is cleared."""
    motor(leg).enable().wait()
    leg.twins["M1"].fault("over_temperature")
    leg.advance(0.2)
    assert leg.events.of("alarm")[-1].detail == "HIP: over_temperature"
    assert motor(leg).is_on is False
    with pytest.raises(DeviceError, match="clear it first"):
        motor(leg).enable().wait()
    leg.twins["M1"].fault("over_temperature", on=False)
    motor(leg).clear_faults().wait()
    motor(leg).enable().wait()


def test_a_stop_is_answered_and_nothing_is_stopped_by_looking(leg: VirtualRobot) -> None:
    """What is asked while it is off are parameters: another program's motor goes on."""
    records = sent(leg)
    leg.advance(0.5)
    assert set(names(records())) == {"ReadParameter"}
    leg.rig.each("enable").wait()
    leg.rig.stop_motion().wait()
    assert (twin(leg).state, twin(leg, "M2").state) == ("reset", "reset")
    leg["HIP"].set(0.4)
    leg.advance(0.1)
    assert leg.events.of("not sent")[-1].detail == "HIP is off: the set-point is dropped"


def test_zero_and_parameters(leg: VirtualRobot) -> None:
    """Zero is for a motor that says that it is off; a parameter is written with confirm=True and read back."""
    hip = motor(leg)
    with pytest.raises(DeviceError, match="disable it first"):
        hip.set_zero().wait()
    hip.disable().wait()
    hip.set_zero().wait()
    leg.advance(0.1)
    assert leg["HIP.position"].value == pytest.approx(-0.0 + 0.2, abs=1e-3)
    hip.write("spd_kp", 1.5, confirm=True).wait()
    assert hip.read("spd_kp").wait() == 1.5
    with pytest.raises(CallerError, match="can only be read"):
        hip.write("vbus", 3.0, confirm=True)
    with pytest.raises(UnknownNameError, match="spd_kp"):
        hip.read("spd_pk")


# ---------------------------------------------------------------------- the MIT protocol

MIT = """
name = "leg"
rate_hz = 200
[buses]
leg = { link = "can", protocol = "robstride_mit", bitrate = 1_000_000 }
[devices]
M1 = { driver = "robstride_mit", bus = "leg", credentials = { motor = 1 }, model = "RS00" }
[joints]
HIP = { device = "M1", direction = -1, zero = 0.2, lower = -1.5, upper = 1.5, max_speed = 6, gains = { kp = 200, kd = 5 } }
"""


def test_the_mit_protocol_follows_set_points() -> None:
    """Enabled it holds where it is, and goes to a position with the joint's stiffness; stopped it gives way."""
    with made(MIT) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["HIP"].set(0.5)
        robot.advance(1.0)
        assert robot["HIP.position"].value == pytest.approx(0.5, abs=0.02)
        robot.rig.stop_motion().wait(5)
        robot.advance(0.1)
        found: Any = robot.twins["M1"]
        assert found.state == "reset"


def test_a_fault_of_the_mit_protocol_ends_set_points_until_it_is_cleared() -> None:
    """The list of faults says so: enabling fails with their names until they are cleared."""
    with made(MIT) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot.twins["M1"].fault("under_voltage")
        robot.advance(0.5)
        assert "HIP: under_voltage" in [event.detail for event in robot.events.of("alarm")]
        with pytest.raises(DeviceError, match="under_voltage; clear it first"):
            robot.rig.each("enable").wait(5)
        robot.twins["M1"].fault("under_voltage", on=False)
        device: Any = robot.devices["M1"]
        device.clear_faults().wait(5)
        robot.rig.each("enable").wait(5)


def test_the_mit_protocol_needs_a_model_or_ranges() -> None:
    """A wrong range is a wrong torque: a model that sources disagree about needs its manual's."""
    with pytest.raises(UnknownNameError, match="without settings ranges"):
        made(MIT.replace("RS00", "RS03"))


def test_a_set_point_of_full_scale_is_a_set_point() -> None:
    """Eight bytes FF move the motor; only other last bytes make them a command that switches it."""
    frame = robstride_mit.encode("Command", motor=1, position=1.0, velocity=1.0, kp=1.0, kd=1.0, torque=1.0)
    assert frame.data == b"\xff" * 8
    (record,) = robstride_mit.scanner(direction="to device").feed([frame])
    assert type(record).__name__ == "Command"
