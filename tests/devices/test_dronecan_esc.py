"""ESCs on DroneCAN: one list for all, and who is stopped, silent or back gets nothing."""

from __future__ import annotations

from math import tau
from typing import Any

import pytest

from aces_bus.errors import CallerError, DeviceError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.dronecan_esc import EXAMPLE
from aces_protocols.dronecan.spec import dronecan


def virtual(text: str = EXAMPLE) -> VirtualRobot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return VirtualRobot(robot)


def lists(recorder: Any) -> list[tuple[int, ...]]:
    """The throttles that were sent."""
    records = dronecan.scanner(direction="to device").feed([frame for _, frame in recorder.received])
    return [record.commands for record in records if type(record).__name__.startswith("RawCommand")]


def test_one_list_has_all_and_a_stop_takes_one_out() -> None:
    """Both turn by one list of four; one is stopped and the other turns on; limits and directions are kept."""
    with virtual() as robot:
        recorder = ListeningNode(robot.wires["arms"])
        robot.advance(0.3)
        assert lists(recorder) == []
        devices: Any = robot.devices
        for device in devices.values():
            device.enable().wait(5)
        robot["ROTOR_FRONT.duty"].set(0.5)
        robot["ROTOR_BACK.duty"].set(1.0)  # its joint allows 0.8
        robot.advance(1.0)
        assert lists(recorder)[-1] == (4096, 0, 0, -6553)
        assert robot["ROTOR_FRONT.velocity"].value == pytest.approx(2000 * tau / 60, rel=0.01)
        assert robot["ROTOR_BACK.velocity"].value == pytest.approx(0.8 * 4000 * tau / 60, rel=0.01)
        back: Any = robot.twins["BACK"]
        assert back.rpm < 0
        robot.devices["BACK"].stop_motion()
        robot.advance(1.0)
        assert lists(recorder)[-1] == (4096, 0, 0, 0)
        assert robot["ROTOR_BACK.velocity"].value == pytest.approx(0, abs=1)
        assert robot["ROTOR_FRONT.velocity"].value == pytest.approx(2000 * tau / 60, rel=0.01)


@pytest.mark.parametrize("how", ["silent", "reboot"])
def test_one_that_was_away_does_not_turn_when_it_is_back(how: str) -> None:
    """Until it is enabled anew its throttle is 0."""
    with virtual() as robot:
        robot.advance(2.5)
        front: Any = robot.devices["FRONT"]
        twin: Any = robot.twins["FRONT"]
        front.enable().wait(5)
        robot["ROTOR_FRONT.duty"].set(0.5)
        robot.advance(0.5)
        assert twin.throttle == 4096
        if how == "silent":
            twin.fault("silent")
            robot.advance(0.5)
            twin.fault("silent", on=False)
        else:
            twin._booted = twin.clock.now()
        robot.advance(1.5)
        assert twin.throttle == 0
        assert not robot["ROTOR_FRONT.enabled"].value
        front.enable().wait(5)
        robot["ROTOR_FRONT.duty"].set(0.25)
        robot.advance(0.5)
        assert twin.throttle == 2048


def test_an_error_ends_set_points_and_refuses_enable() -> None:
    """A node whose health is `error` gets 0, and is not enabled."""
    with virtual() as robot:
        robot.advance(0.3)
        front: Any = robot.devices["FRONT"]
        front.enable().wait(5)
        robot["ROTOR_FRONT.duty"].set(0.5)
        robot.advance(0.5)
        twin: Any = robot.twins["FRONT"]
        twin.fault("trip")
        robot.advance(1.5)
        assert twin.throttle == 0
        with pytest.raises(DeviceError, match="error"):
            front.enable().wait(5)


def test_two_of_one_place_are_refused() -> None:
    """By the names of both, before anything is sent."""
    with (
        pytest.raises(CallerError, match="BACK: FRONT has index 0 already"),
        virtual(EXAMPLE.replace("index = 3", "index = 0")),
    ):
        pass
