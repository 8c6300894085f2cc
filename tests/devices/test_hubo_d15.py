"""Motor boards of D15: driver and twin over the virtual bus, bytes against the facts."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.errors import CallerError, DeviceError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.hubo_motor.d15 import driver

test_driver = driver_tests(driver)


def _load(name: str) -> Any:
    assert name == "hubo_d15"
    return driver


@contextmanager
def _running(enabled: str = "B5", *, homed: bool = True) -> Generator[Any]:
    """The example robot, heard for a second, a board of it enabled."""
    text = driver.example.replace(
        "harmonic = 100,", "harmonic = 100, max_speed = 1000,"
    )  # set at once, in one frame
    robot, problems = parse_robot(text, "d15.toml")
    assert robot is not None, problems
    with VirtualRobot(robot, rate_hz=50, homed=homed, load=_load) as running:
        running.advance(1.2)
        if enabled:
            running.devices[enabled].enable().wait(2)
        yield running


def _sent(recorder: ListeningNode, identifier: int, opcode: int | None = None) -> list[str]:
    frames = [f.data for f in recorder.frames() if f.arbitration_id == identifier]
    return [data.hex(" ").upper() for data in frames if opcode is None or data[0] == opcode]


def test_switching_on_is_one_frame_a_channel_and_switch() -> None:
    """Driver, then control, of channels 1 and 2 by the board's own identifier: `0B 01 01`, `0E 01 01` and so on."""
    with _running(enabled="") as robot:
        recorder = ListeningNode(robot.wires["lower"])
        robot.devices["B5"].enable().wait(2)
        robot.advance(0.1)
        assert _sent(recorder, 0x215, 0x0B) == ["0B 01 01", "0B 02 01"]
        assert _sent(recorder, 0x215, 0x0E) == ["0E 01 01", "0E 02 01"]
        assert set(_sent(recorder, 0x215, 0x03)) == {"03 00"}
        assert robot["PAN.control_on"].value is True
        assert not [f for f in recorder.frames() if f.arbitration_id == 0x001]
        robot.devices["B5"].disable().wait(2)
        robot.advance(0.01)
        assert _sent(recorder, 0x215, 0x0E)[-2:] == ["0E 01 00", "0E 02 00"]


def test_a_reference_is_two_numbers_of_32_bits() -> None:
    """RHY at +0.2 rad is 31830 counts (the facts' gear); the channel without a joint is 0; two's complement."""
    with _running(enabled="B0") as robot:
        recorder = ListeningNode(robot.wires["lower"])
        robot["RHY.position"].set(0.2)
        robot.advance(0.05)
        assert _sent(recorder, 0x010)[-1] == "56 7C 00 00 00 00 00 00"
        robot["RHY.position"].set(-0.2)
        robot.advance(1)
        assert _sent(recorder, 0x010)[-1] == "AA 83 FF FF 00 00 00 00"
        assert robot["RHY.position"].value == pytest.approx(-0.2, abs=2e-3)


def test_directions_and_zeros() -> None:
    """PAN turns the other way, TILT's zero is beside its encoder's: each goes where it is told, in rad."""
    with _running() as robot:
        robot["PAN.position"].set(0.5)
        robot["TILT.position"].set(-0.5)
        robot.advance(2)
        assert robot["PAN.position"].value == pytest.approx(0.5, abs=2e-3)
        assert robot["TILT.position"].value == pytest.approx(-0.5, abs=2e-3)


def test_before_enabling_set_points_are_dropped() -> None:
    """That is told, and nothing is sent."""
    with _running(enabled="") as robot:
        recorder = ListeningNode(robot.wires["lower"])
        robot["PAN.position"].set(0.5)
        robot.advance(0.2)
        assert _sent(recorder, 0x015) == []
        assert "PAN is not enabled" in robot.events.of("not sent")[0].detail


def test_homing_ends_when_the_board_says_6() -> None:
    """`11 01`; no references meanwhile; then they go on from home. Without a home the job fails by name."""
    with _running() as robot:
        robot["PAN.position"].set(0.8)
        robot.advance(2)
        recorder = ListeningNode(robot.wires["lower"])
        job = robot.devices["B5"].home("PAN")
        robot.advance(0.05)
        assert _sent(recorder, 0x215, 0x11) == ["11 01"]
        job.wait(10)
        assert robot["PAN.homed"].value is True
        robot.advance(0.5)
        assert robot["PAN.position"].value == pytest.approx(0, abs=2e-3)
        robot["TILT.position"].set(0.5)
        robot.advance(1)
        robot.twins["B5"].fault("no_home")
        with pytest.raises(DeviceError, match="TILT has not found home: jam"):
            robot.devices["B5"].home("TILT").wait(10)


def test_stopping_ends_a_search() -> None:
    """Control goes off at once, and the job has failed."""
    with _running() as robot:
        robot["PAN.position"].set(1.0)
        robot.advance(2)
        job = robot.devices["B5"].home()
        robot.advance(0.03)
        robot.devices["B5"].stop_motion().wait(1)
        robot.advance(0.5)
        assert job.state == "failed"
        assert robot["PAN.control_on"].value is False


def test_errors_are_alarms_until_they_are_cleared() -> None:
    """The encoder's bit is bit 5 here; control goes off, references end, clearing and enabling bring it back."""
    with _running() as robot:
        device, twin = robot.devices["B5"], robot.twins["B5"]
        twin.fault("encoder_fail")
        robot.advance(0.5)
        assert robot["PAN.errors"].value == "encoder_fail"
        assert robot.events.count("alarm", "B5") == 2
        assert not device.is_enabled
        with pytest.raises(DeviceError, match="PAN, TILT stays off: encoder_fail"):
            device.enable().wait(2)
        twin.fault("encoder_fail", on=False)
        device.clear_errors().wait(2)
        assert robot["PAN.errors"].value == ""
        assert robot.events.count("alarm over", "B5") == 2
        device.enable().wait(2)


def test_a_board_that_was_off_is_told() -> None:
    """Control that nobody has switched off: the board was off; references end."""
    with _running() as robot:
        robot.twins["B5"].reboot()
        robot.advance(0.5)
        assert robot.events.count("rebooted", "B5") == 1
        assert not robot.devices["B5"].is_enabled


def test_temperatures_in_tenths() -> None:
    """Board, motor 1, motor 2; a hot motor says so in its status."""
    with _running() as robot:
        assert robot["B5.temperature"].value == pytest.approx(30.0)
        assert robot["PAN.temperature"].value == pytest.approx(25.0, abs=1)
        robot.twins["B5"].fault("hot")
        robot.advance(1.2)
        assert robot["TILT.temperature"].value == pytest.approx(90.0)
        assert robot["TILT.errors"].value == "temperature_error"


def test_a_short_status_is_of_the_first_motor() -> None:
    """Three bytes: PAN's state is known, TILT's stays what it was."""
    with _running(enabled="", homed=False) as robot:
        port = robot.ports("short board")["lower"]
        port.open(lambda frame, now: None)
        port.send(Frame(0x155, bytes.fromhex("630080")))
        robot.advance(0.0005)
        assert robot["PAN.homed"].value is True
        assert robot["TILT.homed"].value is False


def test_what_cannot_be_is_refused() -> None:
    """A third channel, an unknown joint or mode, a change of mode while enabled."""
    with _running() as robot:
        device = robot.devices["B5"]
        with pytest.raises(CallerError, match="no joint of B5 named 'RHY'"):
            device.home("RHY")
        with pytest.raises(CallerError, match="absolute or incremental"):
            device.position_mode("relative")
        with pytest.raises(DeviceError, match="is enabled: disable it"):
            device.position_mode("incremental").wait(1)
        device.disable().wait(1)
        device.position_mode("incremental").wait(1)
        assert device.board_info().wait(1).version == 20150601
    text = driver.example.replace("channel = 1", "channel = 2")
    wrong, _ = parse_robot(text, "wrong.toml")
    assert wrong is not None
    with pytest.raises(CallerError, match="channels 0 and 1"):
        VirtualRobot(wrong, load=_load)
