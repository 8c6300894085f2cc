"""MiniHubo's converter board: a device without a number, that speaks without being asked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from aces_bus.device import UNKNOWN, Robot
from aces_bus.errors import CallerError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.robot.file import print_robot
from aces_bus.testing import driver_tests
from aces_devices.minihubo_adc import EXAMPLE, driver

test_driver = driver_tests(driver)

LOAD = {"minihubo_adc": driver}.__getitem__


def robot_of(text: str = EXAMPLE) -> Robot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return robot


def test_three_channels_and_a_sensor_of_one() -> None:
    """Counts around the recording's means, at the rate of the board; a sensor's channel counts from 0."""
    with VirtualRobot(robot_of(), load=LOAD) as robot:
        robot.advance(1.0)
        found = [robot[f"ADC.channel_{n}"].value for n in (1, 2, 3)]
        assert found == pytest.approx([2314.5, 2802.5, 2050.7], abs=7)
        assert robot["TILT.value"].value == found[0]
        assert robot.twins["ADC"].samples == 99 or robot.twins["ADC"].samples == 100
        robot.twins["ADC"].source = lambda now: [1, 9999, -5]
        robot.advance(0.1)
        assert [robot[f"ADC.channel_{n}"].value for n in (1, 2, 3)] == [1, 4095, 0]
        robot.twins["ADC"].power(False)
        robot.advance(0.2)
        assert robot["TILT.value"].value is UNKNOWN


@pytest.mark.parametrize("cut", range(8))
def test_a_low_byte_ff_does_not_move_the_frame(cut: int) -> None:
    """Before each header stands an FF: from wherever one begins to listen, the values are right after two samples."""
    with VirtualRobot(robot_of(), load=LOAD) as robot:
        robot.twins["ADC"].source = lambda now: [0x0102, 0x0304, 0x07FF]
        robot.simulation.buses["adc"].port.send(bytes.fromhex("FF FF 01 02 03 04 07 FF")[cut:])
        robot.advance(0.055)
        heard: list[Any] = []
        robot["ADC.channel_3"].listeners.append(lambda value, now: heard.append(value))
        robot.advance(0.5)
        assert heard == [0x07FF] * len(heard)
        assert len(heard) >= 49
        assert robot["ADC.channel_1"].value == 0x0102


def test_no_credentials_are_needed_where_there_are_none() -> None:
    """A protocol without numbers needs none; two such boards on a bus, or a servo without its id, are named."""
    robot = robot_of()
    assert robot.devices["ADC"].credentials == {}
    again, problems = parse_robot(print_robot(robot))
    assert (again, problems) == (robot, [])
    _, problems = parse_robot(
        EXAMPLE.replace("[sensors]", 'B = { driver = "minihubo_adc", bus = "adc" }\n[sensors]')
    )
    assert any("nothing tells it from device ADC" in problem.text for problem in problems)
    servo = (
        'name = "r"\n[buses]\nl = { link = "serial", protocol = "robotis" }\n'
        '[devices]\nS = { driver = "robotis_rx", bus = "l" }\n'
    )
    _, problems = parse_robot(servo)
    assert [problem.key for problem in problems if not problem.is_warning] == ["devices.S.credentials"]


def test_settings_and_channels_that_cannot_be() -> None:
    """A rate that is none, a sensor of a fourth channel."""
    for text in (
        EXAMPLE.replace('bus = "adc" }', 'bus = "adc", settings = { rate_hz = 0 } }'),
        EXAMPLE.replace("channel = 0", "channel = 3"),
    ):
        with pytest.raises(CallerError, match=r"rate_hz = 0|there are 0, 1 and 2"):
            VirtualRobot(robot_of(text), load=LOAD)


@pytest.mark.shared
def test_the_recording_goes_through_the_driver(shared_captures: Path) -> None:
    """All 4624 frames, in pieces: their sums are those that are known of it."""
    data = (shared_captures / "adc" / "minihubo_adc_part1.bin").read_bytes()
    with VirtualRobot(
        robot_of(EXAMPLE.replace('bus = "adc" }', 'bus = "adc", settings = { rate_hz = 0.001 } }')), load=LOAD
    ) as robot:
        sums = [0, 0, 0]
        count = 0

        def add(number: int, value: int) -> None:
            nonlocal count
            sums[number] += value
            count += number == 0

        def listen(number: int) -> None:
            robot[f"ADC.channel_{number + 1}"].listeners.append(lambda value, now: add(number, value))

        for number in range(3):
            listen(number)
        for at in range(0, len(data), 1000):
            robot.simulation.buses["adc"].port.send(data[at : at + 1000])
        robot.advance(10)
        assert count == 4624
        assert sums == [10702327, 12958812, 9482534]
