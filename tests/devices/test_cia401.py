"""Modules of inputs and outputs: channels and their units, PDOs, error values, the watch over the host, stops."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError, NotStoppedError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.cia401 import driver
from aces_devices.cia401.channels import OWN
from tests.interpreted import replaces_methods

test_driver = driver_tests(driver)

CHANNELS = """
full = { kind = "digital_input", number = 10 }
valve = { kind = "digital_output", number = 1 }
lamp = { kind = "digital_output", number = 2, stop = true }
level = { kind = "analog_input", number = 1, unit = "m", scale = 0.001, offset = 0.5 }
heater = { kind = "analog_output", number = 2, unit = "V", scale = 0.001, lower = 0.0, upper = 10.0 }
"""


@contextmanager
def running(channels: str = CHANNELS, settings: str = "") -> Generator[tuple[VirtualRobot, Any, Any]]:
    """A module after a second: the robot, the device, the twin."""
    robot, problems = parse_robot(f"""
name = "plant"
rate_hz = 50
[buses]
io = {{ link = "can", protocol = "canopen", bitrate = 500_000 }}
[devices.M]
driver = "cia401"
bus = "io"
credentials = {{ node = 9 }}
[devices.M.settings]
every_s = 0.5
{settings}
[devices.M.settings.channels]
{channels}
""")
    assert robot is not None, problems
    with VirtualRobot(robot) as made:
        made.advance(1.0)
        yield made, made.devices["M"], made.twins["M"]


def test_inputs_come_when_they_change_and_lost_ones_are_made_good() -> None:
    """By PDO at once; without PDOs within half a second; in the units of the robot's file."""
    with running() as (robot, _, twin):
        assert (robot["M.full"].value, robot["M.level"].value, robot["M.di1"].value) == (False, 0.5, False)
        twin.put("full", True)
        twin.put("level", 1.25)
        robot.advance(0.01)
        assert (robot["M.full"].value, robot["M.level"].value, robot["M.level"].unit) == (True, 1.25, "m")
        assert robot["M.di9"].value is False
        twin.fault("no_pdo")
        twin.put("full", False)
        robot.advance(0.02)
        assert robot["M.full"].value is True
        robot.advance(0.6)
        assert robot["M.full"].value is False
        twin.fault("silent")
        robot.advance(3.0)
        assert robot["M.full"].value is UNKNOWN
        assert "no heartbeat" in robot.events.of("silent")[0].detail


def test_outputs_are_written_when_they_are_set_and_leave_the_others_alone() -> None:
    """What another program has set stays; nothing is written before."""
    with running() as (robot, device, twin):
        twin.numbers[0x6200, 1] = 0b1000_0000
        robot.advance(1.0)
        assert twin.numbers[0x6200, 1] == 0b1000_0000
        assert robot["M.do8"].value is True
        robot["M.valve"].set(True)
        robot["M.heater"].set(2.5)
        robot.advance(0.2)
        assert (twin.numbers[0x6200, 1], twin.numbers[0x6411, 2]) == (0b1000_0001, 2500)
        assert (twin.take("valve"), twin.take("heater"), twin.take("ao1")) == (True, 2.5, 0.0)
        robot["M.heater"].set(400.0)
        robot.advance(0.2)
        assert twin.take("heater") == 10.0
        assert robot.events.of("limited")[-1].device == "M"
        assert device.watchdog.entry == 1


def test_a_stop_sets_what_was_set_to_its_error_value() -> None:
    """Each to what the module, or the robot's file, says; read back; the module does not watch any more."""
    with running() as (robot, device, twin):
        twin.numbers[0x6200, 1] = 0b1000_0000
        robot.advance(0.6)
        for name in ("valve", "lamp", "do8"):
            robot[f"M.{name}"].set(True)
        robot["M.heater"].set(5.0)
        robot.advance(0.2)
        assert twin.numbers[0x6200, 1] == 0b1000_0011
        robot.rig.stop_motion().wait(3)
        assert (twin.numbers[0x6200, 1], twin.take("heater")) == (0b0000_0010, 0.0)
        assert device.watchdog.entry is None
        robot.advance(1.0)
        assert twin.numbers[0x6200, 1] == 0b0000_0010
        assert not robot.events.of("alarm")


@replaces_methods
def test_a_stop_goes_before_all_that_waits() -> None:
    """Its PDOs leave before what else the bus has to send."""
    with running() as (robot, device, _):
        robot["M.valve"].set(True)
        robot.advance(0.2)
        sent: list[tuple[str, bool]] = []
        transmit = device.host.transmit

        def recorded(frame: Any, of: Any, message: str, *rest: Any, urgent: bool = False, **more: Any) -> Any:
            sent.append((message, urgent))
            return transmit(frame, of, message, *rest, urgent=urgent, **more)

        device.host.transmit = recorded
        device.stop_motion().wait(3)
        assert ("Rpdo1", True) in sent
        assert not any(message.startswith("Rpdo") and not urgent for message, urgent in sent)


def test_a_module_that_is_not_operational_is_stopped_all_the_same() -> None:
    """What was set is seen to over SDO and read back; where that is not answered either, the stop says so."""
    with running(settings="watchdog_ms = 0") as (robot, device, twin):
        robot["M.valve"].set(True)
        robot.advance(0.2)
        device.nmt("pre_operational").wait(1)
        robot.advance(0.6)
        assert twin.take("valve") is True
        device.stop_motion().wait(1)
        assert twin.take("valve") is False
        device.nmt("start").wait(1)
        robot.advance(0.6)
        robot["M.valve"].set(True)
        robot.advance(0.2)
        device.nmt("stop").wait(1)
        robot.advance(0.6)
        with pytest.raises(NotStoppedError, match="NOT switched off: M"):
            robot.rig.stop_motion().wait(3)


def test_error_values_are_the_module_s() -> None:
    """Outputs without an error mode stay at a stop, as its file says."""
    with running() as (robot, device, twin):
        device.write("6206:1", 0b0000_0001, confirm=True).wait(1)
        device.write("6207:2", 0b1000_0000, confirm=True).wait(1)
        device.set_up().wait(5)
        for name in ("valve", "do3", "do9", "do16"):
            robot[f"M.{name}"].set(True)
        robot.advance(0.2)
        robot.rig.stop_motion().wait(3)
        assert (twin.numbers[0x6200, 1], twin.numbers[0x6200, 2]) == (0b100, 0b1000_0000)


def test_an_output_that_does_not_stop_is_loud() -> None:
    """It is read back; the module and its object are named."""
    with running() as (robot, _, twin):
        robot["M.valve"].set(True)
        robot.advance(0.2)
        twin.fault("stuck")
        with pytest.raises(
            NotStoppedError, match=r"object 6200:1 stays 0x1; 0x0 stops it|6200:1 stays 0x1; 0x0"
        ):
            robot.rig.stop_motion().wait(3)
        assert twin.take("valve") is True


def test_without_its_host_outputs_take_their_error_values() -> None:
    """The module misses the host's heartbeat, says so, and does not take old set-points when it is started again."""
    with running() as (robot, device, twin):
        robot["M.valve"].set(True)
        robot.advance(0.3)
        assert twin.take("valve") is True
        device.watchdog.entry = None  # as a program that hangs: no heartbeat any more
        robot.advance(1.5)
        assert twin.take("valve") is False
        assert (robot["M.network"].value, robot["M.error"].value) == ("pre_operational", "error 8130")
        assert "error 8130" in robot.events.of("alarm")[0].detail
        robot["M.valve"].set(True)
        assert robot.events.count("not sent", "M") >= 1
        device.nmt("start").wait(1)
        robot.advance(1.0)
        assert twin.take("valve") is False
        robot["M.valve"].set(True)
        robot.advance(0.3)
        assert twin.take("valve") is True


def test_network_management_stops_outputs() -> None:
    """A module that is stopped has its error values, whoever stopped it."""
    with running() as (robot, device, twin):
        robot["M.valve"].set(True)
        robot.advance(0.2)
        device.nmt("stop").wait(1)
        robot.advance(0.1)
        assert twin.take("valve") is False


def test_error_values_of_analog_outputs_that_are_open() -> None:
    """Object 6444 has 32 bits for outputs of 16: where it is not 0 the robot's file says what stops the output."""
    for more, taken in (("", 0.0), (", stop = 1.0", 3.0)):
        heater = f'heater = {{ kind = "analog_output", number = 2, unit = "V", scale = 0.001{more} }}'
        with running(heater) as (robot, device, twin):
            device.write("6444:2", 4000, confirm=True).wait(1)
            device.set_up().wait(5)
            robot["M.heater"].set(3.0)
            robot.advance(0.2)
            assert twin.take("heater") == taken
            if more:
                robot.rig.stop_motion().wait(3)
                assert twin.take("heater") == 1.0
            else:
                assert "a value that stops it" in robot.events.of("not sent")[0].detail


def test_what_a_file_may_not_say(tmp_path: Path) -> None:
    """Channels that the module does not have, twice, or a file of something else."""
    for channels, said in (
        ('a = { kind = "digital_input", number = 17 }', "the module has 16"),
        ('a = { kind = "digital_input", number = 1 }\nb = { kind = "digital_input", number = 1 }', "are one"),
        ('di2 = { kind = "digital_input", number = 1 }', "two channels are called di2"),
        ('a = { kind = "analog_input", number = 1, scale = 0.0 }', "a scale of 0"),
    ):
        with pytest.raises(CallerError, match=said), running(channels):
            pass
    other = tmp_path / "other.eds"
    other.write_text("[1000]\nParameterName=Type\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\n")
    with pytest.raises(CallerError, match=OWN.lacks), running("", f'eds = "{other}"'):
        pass
