"""Pololu qik motor drivers and their twins."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager

import pytest

from aces_bus import load_robot
from aces_bus.device import UNKNOWN, Job
from aces_bus.device.host import Host
from aces_bus.errors import CallerError, DeviceError, NoReplyError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.robot.rig import bus_variants
from aces_bus.testing import driver_tests
from aces_devices.pololu_qik import driver
from aces_devices.pololu_qik.driver import timeout_code

test_qik = driver_tests(
    driver, excused={"misbehaviour: * wrong_number": "an answer is one byte, which has no number"}
)

ROBOT = """
name = "qiks"
rate_hz = 20
[buses]
drives = { link = "serial", protocol = "pololu_qik" }
[devices]
A = { driver = "pololu_qik", bus = "drives", credentials = { id = 1 }, channels = 2 }
B = { driver = "pololu_qik", bus = "drives", credentials = { id = 2 }, settings = { answers = true, timeout_s = 0.5 } }
C = { driver = "pololu_qik", bus = "drives", credentials = { id = 3 }, settings = { answers = true, bits = 8 } }
[joints]
M1 = { device = "A", channel = 0, command = "duty", max_duty = 127 }
M2 = { device = "B", channel = 1, command = "duty", max_duty = 127 }
M3 = { device = "C", channel = 0, command = "duty", direction = -1 }
"""


def assembled(text: str = ROBOT) -> VirtualRobot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=20, load={"pololu_qik": driver}.__getitem__)


@pytest.fixture
def robot() -> Iterator[VirtualRobot]:
    with assembled() as made:
        yield made


def listen(robot: VirtualRobot) -> bytearray:
    """All bytes from now on."""
    heard = bytearray()
    robot.wires["drives"].attach("listener", lambda packet, instant: heard.extend(packet), echo=False)
    return heard


@pytest.mark.parametrize(
    ("joint", "duty", "command"),
    [
        ("M1", -50, "AA 01 0A 32"),
        ("M2", 200, "AA 02 0C 7F"),  # saturates at 127
        ("M3", 200, "AA 03 0B 48"),  # the 8-bit range, backwards: 128 + 72
        ("M3", -127, "AA 03 08 7F"),
    ],
)
def test_worked_examples(robot: VirtualRobot, joint: str, duty: float, command: str) -> None:
    """A duty goes out as the sheet's bytes, in each tick."""
    robot.advance(0.01)
    heard = listen(robot)
    robot[f"{joint}.duty"].set(duty)
    robot.advance(0.53)
    assert heard.count(bytes.fromhex(command)) >= 9
    assert robot.events.count("limited") == (joint == "M2")


def test_setting_the_number(robot: VirtualRobot) -> None:
    """Device 1 becomes 5, bytes as in the sheet, and goes on as 5: set-points reach it."""
    heard = listen(robot)
    robot.devices["A"].set_id(5).wait()
    assert bytes.fromhex("AA 01 04 00 05 55 2A") in heard
    robot["M1.duty"].set(127)
    robot.advance(1)
    assert bytes.fromhex("AA 05 08 7F") in heard
    assert robot.twins["A"].wheels[0].duty == 1.0
    with pytest.raises(CallerError, match="0 to 127"):
        robot.devices["A"].set_id(128)


def test_a_number_outlives_power(robot: VirtualRobot) -> None:
    """Parameters are stored: off and on again it still has its new number, and its motors are free."""
    robot.devices["B"].set_id(9).wait()
    robot["M2.duty"].set(10)
    robot.advance(0.2)
    robot.twins["B"].reboot()
    assert robot.twins["B"].wheels[1].duty is None
    robot.advance(1)
    assert robot.twins["B"].parameters["device_id"] == 9
    assert robot["B.errors"].value is not UNKNOWN


def test_without_answers_nothing_is_asked(robot: VirtualRobot) -> None:
    """A device whose transmit line is not wired is sent set-points only."""
    heard = listen(robot)
    robot.advance(2)
    assert b"\xaa\x01" not in heard
    assert "A.errors" not in robot.rig.signals
    robot.devices["A"].enable().wait()
    assert bytes.fromhex("AA 01 04 01 00 55 2A") in heard
    assert bytes.fromhex("AA 01 04 03 04 55 2A") in heard  # 4 × 0.262 s
    assert bytes.fromhex("AA 01 04 02 01 55 2A") in heard


def test_enabling_leaves_alone_what_is_right(robot: VirtualRobot) -> None:
    """What is stored is read first: a memory that wears is not written for nothing."""
    robot.devices["B"].enable().wait()
    assert robot.twins["B"].parameters["serial_timeout"] == 2
    heard = listen(robot)
    robot.devices["B"].enable().wait()
    assert b"\xaa\x02\x04" not in heard
    robot.devices["C"].enable().wait()
    assert robot.devices["C"].configuration().wait() == {
        "device_id": 3,
        "pwm": 1,
        "shutdown_on_error": 1,
        "serial_timeout": 6,  # three times as long as between two questions for errors
    }
    assert robot.devices["C"].firmware().wait().version == "1"


def test_eight_bits_are_twice_as_fine(robot: VirtualRobot) -> None:
    """In the 8-bit range 127 of 255 is half speed; before it was enabled the same bytes are full speed."""
    robot["M3.duty"].set(-127)
    robot.advance(0.2)
    assert robot.twins["C"].wheels[0].duty == 1.0
    robot.devices["C"].enable().wait()
    robot.advance(0.2)
    assert robot.twins["C"].wheels[0].duty == pytest.approx(127 / 255)
    robot["M3.duty"].set(-255)
    robot.advance(0.2)
    assert robot.twins["C"].wheels[0].duty == 1.0


def test_wheels_turn(robot: VirtualRobot) -> None:
    """Speed follows the duty; stopping brakes, coasting runs out slowly; both end the stream of set-points."""
    wheel = robot.twins["B"].wheels[1]
    clock = robot.clock
    robot["M2.duty"].set(-127)
    robot.advance(2)
    assert wheel.speed(clock.now()) == pytest.approx(-20, rel=1e-3)
    robot.devices["B"].coast().wait()
    robot.advance(0.5)
    assert -13 < wheel.speed(clock.now()) < -10
    robot["M2.duty"].set(127)
    robot.advance(2)
    robot.rig.stop_motion().wait()
    robot.advance(0.5)
    assert abs(wheel.speed(clock.now())) < 0.3
    heard = listen(robot)
    robot.advance(1)
    assert b"\xaa\x02\x0c" not in heard


def test_the_dead_mans_time_out(robot: VirtualRobot) -> None:
    """Without a host for longer than the time-out the motors stop, and that is told as an error afterwards."""
    robot.devices["B"].enable().wait()
    robot["M2.duty"].set(127)
    robot.advance(1)
    twin = robot.twins["B"]
    assert twin.wheels[1].duty == 1.0
    robot.rig.close()
    robot.advance(0.4)
    assert twin.wheels[1].duty == 1.0
    robot.advance(0.3)
    assert twin.wheels[1].duty is None
    assert twin.errors == 128


def test_the_device_watches_over_the_host() -> None:
    """Unless the robot's file says 0, enabling sets a time-out: a host that is killed leaves no motor turning."""
    with assembled() as killed:
        killed.devices["A"].enable().wait()
        killed["M1.duty"].set(100)
        killed.advance(3)
        assert killed.twins["A"].wheels[0].duty is not None
        killed.rig.close()
        killed.advance(1.5)
        assert killed.twins["A"].wheels[0].duty is None
    with assembled() as again:
        again.twins["B"].errors = 128  # of the time before
        again.advance(1)
        assert again.events.count("alarm") == 0


@pytest.mark.parametrize(
    ("seconds", "code"),
    [(0, 0), (-1, 0), (0.262, 1), (0.27, 2), (3.93, 15), (4.0, 24), (117.376, 0x5E), (502, 127)],
)
def test_time_out_codes(seconds: float, code: int) -> None:
    """0.262 s × x × 2ʸ, rounded up: the guide's own example is 0x5E."""
    assert timeout_code(seconds) == code
    made = 0.262 * (code & 15) * 2 ** (code >> 4)
    assert made >= seconds - 1e-6


def test_a_time_out_beyond_its_range_is_refused() -> None:
    """Eight and a half minutes cannot be said."""
    with pytest.raises(CallerError, match="longer than the device can wait"):
        timeout_code(510)


def test_errors_are_told(robot: VirtualRobot) -> None:
    """An error is an alarm when it comes and over when it has gone; the signal has its bits."""
    twin = robot.twins["B"]
    twin.fault("frame")
    robot.advance(1.2)
    assert robot["B.errors"].value == 16
    assert [event.detail for event in robot.events.of("alarm")] == ["frame"]
    twin.fault("frame", on=False)
    robot.advance(1.2)
    assert robot["B.errors"].value == 0
    assert robot.events.count("alarm over", "B") == 1


def test_a_parameter_that_is_refused(robot: VirtualRobot) -> None:
    """The device's reason is the error's; a format error is told too."""
    with pytest.raises(DeviceError, match="does not take 9 for pwm: bad_value"):
        robot.devices["B"].set_parameter("pwm", 9).wait()
    robot.advance(1)
    assert robot.events.of("alarm")[0].detail == "format"


def test_one_asks_at_a_time(robot: VirtualRobot) -> None:
    """Answers have no number: no request goes out before the one before was answered, and none is mixed up."""
    versions = [robot.devices[name].firmware() for name in "BC"] * 2
    found = robot.devices["B"].configuration(), robot.devices["C"].configuration()
    assert [one.wait().version for one in versions] == ["1"] * 4
    assert [one.wait()["device_id"] for one in found] == [2, 3]
    assert [one.result.id for one in versions] == [2, 3, 2, 3]


def test_a_mute_device_is_no_answer(robot: VirtualRobot) -> None:
    """Who does not answer fails by name, and holds up nobody for long."""
    robot.twins["B"].fault("silent")
    with pytest.raises(NoReplyError, match="no answer to GetFirmware"):
        robot.devices["B"].firmware().wait()
    robot.advance(3)
    assert robot.events.count("silent", "B") == 1
    assert robot["C.errors"].value == 0


def test_omnibot_wheels() -> None:
    """The shipped robot: all four wheels turn as they are told, over two drivers on one line."""
    with VirtualRobot(load_robot("omnibot"), rate_hz=10, load={"pololu_qik": driver}.__getitem__) as robot:
        robot.rig.each("enable").wait()
        for name, duty in (("M1", 127), ("M2", -127), ("M3", 64), ("M4", 0)):
            robot[f"{name}.duty"].set(duty)
        robot.advance(2)
        wheels = [
            robot.twins[name].wheels[channel]
            for name, channel in (("QIK1", 0), ("QIK2", 1), ("QIK2", 0), ("QIK1", 1))
        ]
        assert [round(w.speed(robot.clock.now()), 1) for w in wheels] == [20.0, -20.0, 10.1, 0.0]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("bits = 8", "bits = 9"), "the setting bits = 9"),
        (("channel = 1", "channel = 2"), "a qik has 0 and 1"),
    ],
)
def test_what_it_has_not_is_refused(change: tuple[str, str], complaint: str) -> None:
    """A third motor, a ninth bit."""
    with pytest.raises(CallerError, match=complaint):
        assembled(ROBOT.replace(*change))


@pytest.mark.parametrize("late_s", [0.0, 0.019, 0.03, 0.09, 0.3])
def test_a_scan_finds_late_devices(late_s: float) -> None:
    """Answers, which carry no number, are given to the right one however late they come: all are found, none is invented."""
    with scanned() as (robot, host):
        for name in "ABC":
            robot.twins[name].fault("late", late_s)
        assert driver.scan is not None
        found = Job(robot.clock, "scan", lambda job: driver.scan(host, job)).wait(200)  # type: ignore[misc]
        assert [config.credentials["id"] for config in found] == [1, 2, 3]


def test_a_scan_that_cannot_be_sure_says_so() -> None:
    """Answers later than the most patience are given to nobody."""
    with scanned() as (robot, host):
        robot.twins["B"].fault("late", 0.6)
        job = Job(robot.clock, "scan", lambda job: driver.scan(host, job))  # type: ignore[misc]
        with pytest.raises(DeviceError, match=r"later than 0\.5 s"):
            job.wait(200)


@contextmanager
def scanned() -> Generator[tuple[VirtualRobot, Host]]:
    """Twins that all answer, and a second program's host on their line."""
    text = ROBOT.replace("credentials = { id = 1 }", "credentials = { id = 1 }, settings.answers = true")
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    made = VirtualRobot(robot, load={"pololu_qik": driver}.__getitem__)
    with made.simulation:
        (port,) = made.ports("scan").values()
        host = Host(port, bus_variants(robot, "drives"), name="drives")
        host.open()
        yield made, host
        host.close()
