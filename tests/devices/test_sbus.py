"""SBUS: sticks as signals, and nothing where the radio is not heard."""

from __future__ import annotations

import pytest

from aces_bus.device import UNKNOWN
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.sbus import EXAMPLE
from aces_protocols.sbus.spec import sbus


def virtual() -> VirtualRobot:
    robot, problems = parse_robot(EXAMPLE)
    assert robot is not None, problems
    return VirtualRobot(robot)


def test_sticks_and_switches_are_signals() -> None:
    """Where the twin has them; both kinds of frames are read."""
    with virtual() as robot:
        twin = robot.twins["RC"]
        twin.sticks[:3] = [-1.0, 0.5, 9.0]
        twin.switches.add("channel_18")
        for fault in ("", "sbus2"):
            if fault:
                twin.fault(fault)
            robot.advance(0.2)
            assert robot["RC.channel_1"].value == pytest.approx(-1, abs=1e-3)
            assert robot["RC.channel_2"].value == pytest.approx(0.5, abs=1e-3)
            assert robot["RC.channel_3"].value == pytest.approx(1.288, abs=1e-3)
            assert (robot["RC.channel_17"].value, robot["RC.channel_18"].value) == (0, 1)


def test_failsafe_is_nobodys_hand() -> None:
    """Channels become unknown at once, and are known again with the radio."""
    with virtual() as robot:
        robot.advance(0.2)
        robot.twins["RC"].fault("radio")
        robot.advance(0.05)
        assert robot["RC.channel_1"].value is UNKNOWN
        assert robot["RC.channel_17"].value is UNKNOWN
        assert (robot["RC.failsafe"].value, robot["RC.frame_lost"].value) == (1, 1)
        robot.twins["RC"].fault("radio", on=False)
        robot.advance(0.05)
        assert robot["RC.channel_1"].value == pytest.approx(0)


def test_a_first_byte_among_channels_costs_no_lock() -> None:
    """0F in the channels and a stream entered there: at most the frame that was entered is lost."""
    frame = sbus.encode("Channels", channels=[1500.0] * 16, flags=[])
    assert frame.count(b"\x0f") > 1
    for cut in range(len(frame)):
        scanner = sbus.scanner()
        assert len(scanner.feed(frame[cut:] + 10 * frame)) >= 10
