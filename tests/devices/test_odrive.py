"""ODrive axes and their twins: what goes over the wire, what a stop waits for, what an error does."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from aces_bus.errors import CallerError, DeviceError, NotStoppedError, UnknownNameError
from aces_bus.hardware import ListeningNode, SimulatedBus
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.odrive import driver
from aces_devices.odrive.driver import Odrive
from aces_devices.odrive.twin import OdriveTwin
from aces_protocols.odrive.spec import odrive

test_odrive = driver_tests(driver)

ROBOT = """
name = "cart"
rate_hz = 100
[buses]
line = { link = "can", protocol = "odrive" }
[devices]
A = { driver = "odrive", bus = "line", credentials = { node = 3 } }
B = { driver = "odrive", bus = "line", credentials = { node = 4 }, settings = { ramped = true } }
[joints]
HIP = { device = "A", gear = [1, 8], direction = -1, zero = 0.5, max_speed = 6.283185, max_current = 9 }
WHEEL = { device = "B", command = "speed", type = "continuous", max_speed = 20 }
"""


@pytest.fixture
def robot() -> Iterator[VirtualRobot]:
    """Two axes of firmware 0.6, settled."""
    found, problems = parse_robot(ROBOT)
    assert found is not None, problems
    with VirtualRobot(found, rate_hz=100) as made:
        made.advance(0.5)
        yield made


def axis(robot: VirtualRobot) -> Odrive:
    """The axis of the hip."""
    found = robot.devices["A"]
    assert isinstance(found, Odrive)
    return found


def sent(robot: VirtualRobot) -> Callable[[], list[Any]]:
    """What gives the records of all that was sent to the axes from now on, but for what asks."""
    wire = robot.wires["line"]
    assert isinstance(wire, SimulatedBus)
    heard = ListeningNode(wire)

    def records() -> list[Any]:
        found = odrive.scanner(direction="to device").feed(heard.frames())
        return [one for one in found if not type(one).__name__.startswith("Get")]

    return records


def names(records: list[Any]) -> list[str]:
    return [type(one).__name__ for one in records]


def test_enabling_says_limits_mode_and_place_before_the_loop_is_closed(robot: VirtualRobot) -> None:
    """Limits and set-points are the motor's: through the gear, direction and zero; it is enabled where it is."""
    records = sent(robot)
    axis(robot).enable().wait()
    got = records()
    assert names(got)[:4] == ["SetLimits", "SetControllerModes", "SetInputPosition", "SetAxisState"]
    limits, modes, place, state = got[:4]
    assert limits.velocity == pytest.approx(8.0)  # rev/s behind the gear
    assert limits.current == 9
    assert (modes.control, modes.input, state.state) == ("position", "passthrough", "closed_loop")
    # 0 rad of the joint: zero × gear ÷ 2π turns of the motor
    assert place.position == pytest.approx(0.5 * 8 / 6.283185307, abs=1e-4)
    robot.advance(0.3)
    assert abs(robot["HIP.position"].value) < 0.01


def test_a_set_point_goes_through_the_gear_and_is_repeated(robot: VirtualRobot) -> None:
    """The set-point is sent in every tick, which feeds the drive's watchdog."""
    axis(robot).enable().wait()
    robot["HIP"].set(0.25)
    robot.advance(0.5)
    records = sent(robot)
    robot.advance(0.5)
    given = [one for one in records() if type(one).__name__ == "SetInputPosition"]
    assert len(given) == pytest.approx(50, abs=2)
    assert given[-1].position == pytest.approx((-0.25 + 0.5) * 8 / 6.283185307, abs=1e-4)
    assert robot["HIP.position"].value == pytest.approx(0.25, abs=0.02)


def test_a_stop_is_idle_and_is_confirmed_by_a_heartbeat(robot: VirtualRobot) -> None:
    """Without a heartbeat that says so the axis counts as not stopped, by name."""
    robot.rig.each("enable").wait()
    robot["WHEEL.velocity"].set(5.0)
    robot.advance(0.5)
    assert robot["WHEEL.velocity"].value == pytest.approx(5.0, abs=0.3)
    robot.rig.stop_motion().wait()
    assert robot["B.state"].value == "idle"
    robot.twins["B"].fault("no_heartbeat")
    with pytest.raises(NotStoppedError, match="B"):
        robot.rig.stop_motion().wait()


def test_an_error_disarms_and_ends_set_points(robot: VirtualRobot) -> None:
    """It is told by name, is not enabled before it is cleared, and does not go on where it was."""
    hip = axis(robot)
    hip.enable().wait()
    robot["HIP"].set(0.5)
    robot.twins["A"].fault("over_temperature")
    robot.advance(0.5)
    assert "inverter_over_temperature" in robot.events.of("alarm")[-1].detail
    assert robot["A.errors"].value == ("inverter_over_temperature",)
    robot.twins["A"].fault("over_temperature", on=False)
    with pytest.raises(DeviceError, match="clear it first"):
        hip.enable().wait()
    assert hip.read_errors().wait() == {
        "active": ["inverter_over_temperature"],
        "disarm_reason": ["inverter_over_temperature"],
    }
    hip.clear_errors().wait()
    robot.advance(0.3)
    records = sent(robot)
    robot.advance(0.3)
    assert names(records()) == []
    hip.enable().wait()


def test_a_set_point_while_it_is_off_is_reported_and_kept_by_nobody(robot: VirtualRobot) -> None:
    """It does not leave, then or when the axis is enabled."""
    records = sent(robot)
    robot["HIP"].set(0.5)
    robot.advance(0.3)
    assert robot.events.of("not sent")[-1].detail == "HIP is off: the set-point is dropped"
    axis(robot).enable().wait()
    robot.advance(0.5)
    assert abs(robot["HIP.position"].value) < 0.01
    assert "SetInputPosition" in names(records())


def test_only_what_the_mode_takes_can_be_set(robot: VirtualRobot) -> None:
    """Another mode is for an axis that is off."""
    hip = axis(robot)
    with pytest.raises(CallerError, match="no mode 'duty'"):
        hip.set_mode("duty")
    hip.enable().wait()
    with pytest.raises(DeviceError, match="disable it first"):
        hip.set_mode("torque")
    hip.disable().wait()
    robot.advance(0.3)
    hip.set_mode("torque")
    assert [name for name, one in hip.signals.items() if one.is_writable] == ["HIP.torque"]
    hip.enable().wait()
    robot["HIP.torque"].set(0.5)
    records = sent(robot)
    robot.advance(0.1)
    assert next(one.torque for one in records() if type(one).__name__ == "SetInputTorque") == pytest.approx(
        -0.5 / 8
    )


def test_zero_is_set_where_it_is(robot: VirtualRobot) -> None:
    """Refused while it is on: it would jump."""
    hip = axis(robot)
    robot.simulation.world.joints["HIP"].place(robot.clock.now(), 0.3)  # type: ignore[attr-defined]
    robot.advance(0.2)
    assert robot["HIP.position"].value == pytest.approx(0.3, abs=1e-4)
    hip.set_zero().wait()
    robot.advance(0.2)
    assert robot["HIP.position"].value == pytest.approx(0.0, abs=1e-4)
    hip.enable().wait()
    with pytest.raises(DeviceError, match="disable it first"):
        hip.set_zero().wait()


def test_parameters_of_firmware_0_6(robot: VirtualRobot) -> None:
    """Read and written by their numbers, with their types."""
    hip = axis(robot)
    hip.write(0x123, 1.25, confirm=True).wait()
    assert hip.read(0x123).wait() == 1.25
    assert hip.read(0x123, type="uint32").wait() == 0x3FA00000
    with pytest.raises(CallerError, match="no type 'double'"):
        hip.read(0x123, type="double")
    with pytest.raises(CallerError, match="confirm=True"):
        hip.write(0x123, 1.0, confirm=False)
    with pytest.raises(CallerError, match="is a name: say settings endpoints"):
        hip.read("vbus_voltage")


#: An endpoint file of the shape that ODrive's have; numbers are drawn.
FILE = {
    "fw_version": "0.6.11",
    "hw_version": "4.4.58",
    "endpoints": {
        "vbus_voltage": {"id": 1, "type": "float", "access": "r"},
        "axis0.current_state": {"id": 40, "type": "uint8", "access": "r"},
        "axis0.config.watchdog_timeout": {"id": 200, "type": "float", "access": "rw"},
        "axis0.config.enable_watchdog": {"id": 201, "type": "bool", "access": "rw"},
        "axis0.config.motor.pole_pairs": {"id": 330, "type": "uint32", "access": "rw"},
        "save_configuration": {"id": 600, "type": "function"},
    },
}


@pytest.fixture
def named(tmp_path: Path) -> Iterator[VirtualRobot]:
    """The robot, with an endpoint file and a watchdog."""
    path = tmp_path / "flat_endpoints.json"
    path.write_text(json.dumps(FILE))
    text = ROBOT.replace(
        "credentials = { node = 3 }",
        f'credentials = {{ node = 3 }}, settings = {{ endpoints = "{path}", watchdog_s = 0.2 }}',
    )
    assert text != ROBOT
    made, problems = parse_robot(text)
    assert made is not None, problems
    with VirtualRobot(made, rate_hz=100) as robot:
        robot.advance(0.5)
        yield robot


def test_parameters_by_name(named: VirtualRobot) -> None:
    """With their types, of the file; what is written is read back, and outlives a boot when it was saved."""
    hip, twin = axis(named), named.twins["A"]
    assert hip.read("vbus_voltage").wait() == 24.0
    assert hip.read("axis0.current_state").wait() == 1
    hip.write("axis0.config.motor.pole_pairs", 7, confirm=True).wait()
    assert hip.read("axis0.config.motor.pole_pairs").wait() == 7
    twin.reboot()
    assert hip.read("axis0.config.motor.pole_pairs").wait() == 0
    hip.write("axis0.config.motor.pole_pairs", 7, confirm=True).wait()
    hip.save(confirm=True).wait()
    named.advance(0.2)
    assert hip.read(330, type="uint32").wait() == 7


def test_what_is_no_parameter_of_the_file(named: VirtualRobot) -> None:
    """An unknown name, one that can only be read, a function, a number that does not fit."""
    hip = axis(named)
    with pytest.raises(UnknownNameError, match="pole_pairs"):
        hip.read("axis0.config.motor.pole_pair")
    with pytest.raises(CallerError, match="vbus_voltage can only be read"):
        hip.write("vbus_voltage", 1.0, confirm=True)
    with pytest.raises(CallerError, match="save_configuration is a function"):
        hip.read("save_configuration")
    with pytest.raises(CallerError, match="-1 does not fit into uint32"):
        hip.write("axis0.config.motor.pole_pairs", -1, confirm=True)


def test_names_of_another_firmware_are_refused(named: VirtualRobot) -> None:
    """Its numbers are other parameters: nothing is read or written by name."""
    twin: Any = named.twins["A"]
    twin.firmware = (0, 6, 10)
    with pytest.raises(DeviceError, match=r"has firmware 0\.6\.10, and its endpoints are those of 0\.6\.11"):
        axis(named).write("axis0.config.motor.pole_pairs", 7, confirm=True).wait()
    assert 330 not in twin.parameters


def test_enabling_sets_the_watchdog_by_its_names(named: VirtualRobot) -> None:
    """A drive whose host is gone disarms."""
    named.rig.each("enable").wait()
    twin: Any = named.twins["A"]
    assert twin.watchdog_ns == pytest.approx(200_000_000)
    named.rig.stop_motion().wait()
    named.advance(0.1)
    assert twin.watchdog_ns == 0  # nothing feeds an axis that is off


def test_a_calibration_turns_the_motor_and_says_how_it_ended(robot: VirtualRobot) -> None:
    """There and back; one that is held has not succeeded, and an axis that was not calibrated stays off until then."""
    hip, twin = axis(robot), robot.twins["A"]
    assert isinstance(twin, OdriveTwin)
    twin.fault("uncalibrated")
    with pytest.raises(DeviceError, match="stays off"):
        hip.enable().wait()
    before, places = twin.turns, set[float]()
    job = hip.calibrate()
    for _ in range(100):
        robot.advance(0.01)
        places.add(round(twin.turns - before, 2))
    job.wait()
    assert max(places) == pytest.approx(0.25, abs=0.1)
    assert abs(twin.turns - before) < 0.05
    hip.enable().wait()
    hip.disable().wait()
    robot.advance(0.3)
    twin.fault("jam")
    with pytest.raises(DeviceError, match="offset_calibration failed: no_response"):
        hip.calibrate("offset_calibration").wait()
    with pytest.raises(UnknownNameError, match="procedure"):
        hip.calibrate("dance")


def test_an_axis_that_switches_itself_off_is_reported(robot: VirtualRobot) -> None:
    """A drive that rebooted is idle, without an error: its set-points end, and it does not move when it is enabled."""
    robot.rig.each("enable").wait()
    robot["HIP"].set(0.4)
    robot.advance(0.5)
    robot.twins["A"].reboot()
    robot.advance(0.3)
    assert "has switched itself off" in robot.events.of("alarm")[-1].detail
    here = robot["HIP.position"].value
    axis(robot).enable().wait()
    robot.advance(0.5)
    assert robot["HIP.position"].value == pytest.approx(here, abs=0.02)
