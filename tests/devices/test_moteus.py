"""mjbots moteus: driver and twin."""

from __future__ import annotations

import math
from typing import Any

import pytest

from aces_bus.errors import CallerError, DeviceError, NotStoppedError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_protocols.moteus.subframes import register_values

test_moteus = driver_tests("moteus")

ARM = """
name = "arm"
rate_hz = 50
[buses]
can = { link = "can", protocol = "moteus", bitrate = 1_000_000 }
[devices]
M = { driver = "moteus", bus = "can", credentials = { id = 1 }, settings = { max_torque = 1.5, watchdog_s = 0.2 } }
[joints]
J = { device = "M", lower = -1, upper = 1, max_speed = 2.0, max_acceleration = 30.0 }
"""


def arm(text: str = ARM) -> VirtualRobot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=50)


def commands(robot: VirtualRobot) -> list[dict[str, Any]]:
    """What the twin is told by `Command`s, from now on."""
    found: list[dict[str, Any]] = []
    twin = robot.twins["M"]
    take = twin._handlers["Command"]

    def noting(request: Any) -> None:
        found.append(register_values(request.subframes))
        take(request)

    twin._handlers["Command"] = noting
    return found


def test_every_set_point_has_limits_and_watchdog() -> None:
    """Position in turns, and with it, in each tick, the limits of the robot's file and the watchdog."""
    with arm() as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        told = commands(robot)
        robot["J"].set(0.5)
        robot.advance(1.0)
        assert robot["J.position"].value == pytest.approx(0.5, abs=1e-3)
        assert len(told) == pytest.approx(50, abs=2)
        assert told[-1] == {
            "mode": "position",
            "command_position": pytest.approx(0.5 / math.tau, rel=1e-6),
            "command_velocity": 0.0,
            "command_position_max_torque": 1.5,
            "command_timeout": pytest.approx(0.2),
            "command_velocity_limit": pytest.approx(2.0 / math.tau),
            "command_accel_limit": pytest.approx(30.0 / math.tau),
        }


def test_nothing_is_sent_before_enabling() -> None:
    """A set-point for a joint that is not enabled is reported, and not kept."""
    with arm() as robot:
        robot.advance(0.1)
        told = commands(robot)
        robot["J"].set(0.5)
        robot.advance(0.2)
        assert told == []
        assert "M is not enabled" in robot.events.of("not sent")[0].detail
        robot.rig.each("enable").wait(5)
        robot.advance(0.5)
        assert robot["J.position"].value == 0.0


def test_enabling_holds_where_it_is() -> None:
    """NaN is "where you are now": nothing moves, and the mode is position."""
    with VirtualRobot(arm().robot, rate_hz=50, pose={"J": 0.3}) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        told = commands(robot)
        robot.advance(0.5)
        assert robot["M.mode"].value == "position"
        assert robot["J.position"].value == pytest.approx(0.3, abs=1e-6)
        assert math.isnan(told[-1]["command_position"])


def test_without_a_host_its_watchdog_stops_it() -> None:
    """Set-points that end leave a controller in mode 11; the driver says so, and takes no more until it is enabled."""
    with arm() as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot.devices["M"].drop("Command")
        robot.advance(0.15)
        assert robot.twins["M"].mode == "position"
        robot.advance(0.15)
        assert robot.twins["M"].mode == "position_timeout"
        assert "its watchdog has stopped it" in robot.events.of("alarm")[-1].detail
        robot["J"].set(0.5)
        robot.advance(0.2)
        assert robot["J.position"].value == 0.0
        robot.rig.each("enable").wait(5)
        robot["J"].set(0.2)
        robot.advance(1.0)
        assert robot["J.position"].value == pytest.approx(0.2, abs=1e-3)


def test_a_fault_is_told_and_ends_set_points() -> None:
    """By its name; enabling fails with it until it is over."""
    with arm() as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot.twins["M"].fault("trip")
        robot.advance(0.1)
        assert robot.events.of("alarm")[-1].detail == "over_temperature"
        assert not robot.devices["M"].takes_set_points
        with pytest.raises(DeviceError, match="mode fault, fault over_temperature"):
            robot.rig.each("enable").wait(5)
        robot.twins["M"].fault("trip", on=False)
        robot.rig.each("enable").wait(5)
        robot.advance(0.1)
        assert robot.events.of("alarm over")


def test_a_stop_is_confirmed_or_named() -> None:
    """It counts when the controller says that it is stopped; one that does not take it is named."""
    with arm() as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["J"].set(1.0)
        robot.advance(0.1)
        robot.rig.stop_motion().wait(5)
        robot.advance(1.0)  # it runs out
        assert robot.twins["M"].mode == "stopped"
        where = robot["J.position"].value
        robot.advance(0.5)
        assert robot["J.position"].value == where
        robot.rig.each("enable").wait(5)
        twin: Any = robot.twins["M"]
        twin._handlers["Command"] = lambda request: None  # deaf to commands, and answers
        twin.command["command_timeout"] = math.nan
        twin._until = None
        with pytest.raises(NotStoppedError, match=r"M.*its mode is position"):
            robot.rig.stop_motion().wait(5)


def test_a_wheel_turns_at_a_speed() -> None:
    """`command = "speed"`: no position, a velocity; `stop = "brake"` shorts the windings."""
    text = ARM.replace("lower = -1, upper = 1,", 'type = "continuous", command = "speed", direction = -1,')
    with arm(text.replace("max_torque = 1.5", 'stop = "brake"')) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["J.velocity"].set(1.5)
        robot.advance(1.0)
        assert robot["J.velocity"].value == pytest.approx(1.5, rel=1e-5)
        assert robot["J.position"].value > 1.0
        robot.rig.stop_motion().wait(5)
        assert robot.twins["M"].mode == "brake"


def test_what_cannot_be() -> None:
    """A moteus has one joint, by position or speed: other modes have no watchdog."""
    with pytest.raises(CallerError, match="only these modes have the controller's watchdog"):
        arm(ARM.replace("lower = -1,", 'command = "current", lower = -1,'))


def test_its_zero_is_moved_only_while_it_is_stopped() -> None:
    """And is where the joint is then."""
    with VirtualRobot(arm().robot, rate_hz=50, pose={"J": 0.3}) as robot:
        robot.advance(0.1)
        device: Any = robot.devices["M"]
        device.set_zero().wait(5)
        robot.advance(0.1)
        assert robot["J.position"].value == pytest.approx(0.0, abs=1e-6)
        robot.rig.each("enable").wait(5)
        with pytest.raises(DeviceError, match="stop it before its zero is moved"):
            device.set_zero().wait(5)


def values(robot: VirtualRobot) -> dict[str, float]:
    """What the twin of the arm measures now."""
    twin: Any = robot.twins["M"]
    twin._sync()
    return {name: twin.value_of(name) for name in ("torque", "q_current", "temperature", "voltage", "power")}


def test_what_it_measures_is_what_its_motor_does() -> None:
    """Blocked it pushes with the torque that it may have, draws current for it, gets hot, and trips at 75 °C."""
    with arm() as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot.advance(0.1)
        rest = values(robot)
        assert abs(rest["torque"]) < 0.05
        assert rest["temperature"] == pytest.approx(25, abs=0.1)
        robot.twins["M"].fault("jam")
        robot["J"].set(0.9)
        robot.advance(1.0)
        pushing = values(robot)
        assert pushing["torque"] == pytest.approx(1.5, rel=1e-3)  # the file's `max_torque`
        assert pushing["q_current"] == pytest.approx(1.5 / 0.4, rel=1e-3)
        assert pushing["voltage"] < rest["voltage"]
        assert pushing["power"] > 0
        assert pushing["temperature"] > rest["temperature"] + 0.02
        robot.twins["M"].motor.temperature = 130.0
        robot.advance(0.1)
        assert robot.events.of("alarm")[-1].detail == "over_temperature"
        assert values(robot)["q_current"] == 0.0


def test_a_brown_out_is_a_fault_until_the_supply_is_back() -> None:
    """Too little voltage ends the motion as under-voltage; enabling works once the supply is back."""
    with arm() as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot.twins["M"].fault("brown_out", 9.0)
        robot.advance(0.1)
        assert robot.events.of("alarm")[-1].detail == "under_voltage"
        with pytest.raises(DeviceError, match="under_voltage"):
            robot.rig.each("enable").wait(5)
        robot.twins["M"].fault("brown_out", on=False)
        robot.rig.each("enable").wait(5)


# ---------------------------------------------------------------------- the configuration


def test_its_configuration_is_read_written_and_saved() -> None:
    """By name; what was written is obeyed at once, and outlives power-off only when it was saved."""
    with arm() as robot:
        robot.advance(0.1)
        device: Any = robot.devices["M"]
        twin: Any = robot.twins["M"]
        assert device.read("servo.max_current_A").wait(5) == 30
        whole = device.configuration().wait(5)
        assert whole["id.id"] == 1
        assert math.isnan(whole["servo.default_accel_limit"])
        assert whole == pytest.approx(dict(twin.configuration), nan_ok=True)
        device.write("servo.max_current_A", 2.5, confirm=True).wait(5)
        robot.rig.each("enable").wait(5)
        twin.fault("jam")
        robot["J"].set(0.9)
        robot.advance(0.5)
        assert values(robot)["torque"] == pytest.approx(
            2.5 * 0.4, rel=1e-3
        )  # less than the file's `max_torque`
        with pytest.raises(DeviceError, match="in mode position: stop it before its configuration is saved"):
            device.save(confirm=True).wait(5)
        robot.rig.stop_motion().wait(5)
        twin.reboot()
        assert device.read("servo.max_current_A").wait(5) == 30
        device.write("servo.max_current_A", 2.5, confirm=True).wait(5)
        device.save(confirm=True).wait(5)
        twin.reboot()
        assert device.read("servo.max_current_A").wait(5) == 2.5


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("servo.speed", 1.0, "ERR error setting"),
        ("nothing.at_all", 1.0, "ERR unknown group"),
        ("servo.timeout_mode", 1.5, "ERR error setting"),
        ("servo.timeout_mode", 10, "ERR error setting"),
        ("id.id", 7, "ERR error setting"),
        ("servo.max_current_A\n", 1.0, "is not a line of ASCII text"),
    ],
)
def test_what_it_cannot_be_set_to_is_named(name: str, value: float, why: str) -> None:
    """The answer of the console is the error's text; nothing is changed."""
    with arm() as robot:
        robot.advance(0.1)
        device: Any = robot.devices["M"]
        twin: Any = robot.twins["M"]
        before = dict(twin.configuration)
        with pytest.raises(DeviceError, match=why):
            device.write(name, value, confirm=True).wait(5)
        assert dict(twin.configuration) == pytest.approx(before, nan_ok=True)


def test_an_answer_that_is_lost_fails() -> None:
    """What a lost frame had is gone: the command fails, and the next one begins with what is left thrown away."""
    with arm() as robot:
        robot.advance(0.1)
        device: Any = robot.devices["M"]
        robot.twins["M"].fault("loses", 3)
        with pytest.raises(DeviceError):
            device.configuration().wait(5)
        robot.twins["M"].fault("loses", on=False)
        assert device.configuration().wait(5)["servo.timeout_mode"] == 12


def test_its_configured_bounds_hold() -> None:
    """A goal ends at servopos.position_max; a joint that is beyond it is in fault 39 when position mode begins."""
    with arm() as robot:
        robot.advance(0.1)
        device: Any = robot.devices["M"]
        device.write("servopos.position_max", 0.05, confirm=True).wait(5)
        robot.rig.each("enable").wait(5)
        robot["J"].set(0.9)
        robot.advance(1.0)
        assert robot["J.position"].value == pytest.approx(0.05 * math.tau, abs=1e-3)
        robot.rig.stop_motion().wait(5)
        device.write("servopos.position_max", 0.0, confirm=True).wait(5)
        with pytest.raises(DeviceError, match="start_outside_limit"):
            robot.rig.each("enable").wait(5)


def test_the_console_answers_every_line() -> None:
    """Also one that it does not know; bytes that are no text, and lines without an end, do no harm."""
    with arm() as robot:
        robot.advance(0.1)
        twin: Any = robot.twins["M"]

        def say(text: bytes) -> str:
            twin.console.take(text)
            return str(twin.console.give(5000).decode("latin1"))

        assert say(b"conf ge") == ""
        assert say(b"t servo.timeout_mode\r\n") == "12\r\n"
        assert say(b"tel list\n") == "firmware\r\ngit\r\nservo_stats\r\nOK\r\n"
        assert say(b"tel stop\ntel text\n") == "OK\r\nOK\r\n"
        assert say(b"tel get firmware\n").splitlines()[-2:] == ["firmware.model 256", "OK"]
        assert say(b"conf enumerate id\n") == "id.id 1\r\nOK\r\n"
        assert say(b"d cfg-set-output 0.5\n") == "OK\r\n"
        assert twin.value_of("position") == pytest.approx(0.5)
        assert say(b"conf default\n") == "OK\r\n"
        assert twin.value_of("position") == pytest.approx(0.0)
        for line in (
            b"d pos nan 1 1",
            b"d dq 1 x",
            b"aux1 out 1",
            b"tel get x",
            b"tel",
            b"conf",
            b"conf load x y",
        ):
            assert say(line + b"\n").startswith(("ERR", "OK"))
        say(bytes(range(256)) * 10)
        assert say(b"\nconf get id.id\n").endswith("1\r\n")
