"""VESC: driver and twin."""

from __future__ import annotations

import math
from typing import Any

import pytest

from aces_bus.errors import CallerError, DeviceError, NotStoppedError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing.conformance import driver_tests

test_vesc = driver_tests("vesc")

CART = """
name = "cart"
rate_hz = 50
[buses]
can = { link = "can", protocol = "vesc" }
[devices]
V = { driver = "vesc", bus = "can", credentials = { id = 5 }, settings = { pole_pairs = 10 } }
[joints]
W = { device = "V", type = "continuous", command = "speed", gear = [1, 4], direction = -1, max_speed = 30 }
"""


def cart(text: str = CART, **more: Any) -> VirtualRobot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=50, **more)


def test_a_speed_is_the_fields() -> None:
    """rad/s of the joint × gear × pole pairs, in turns of the field a minute; the tachometer says how far it went."""
    with cart() as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["W.velocity"].set(2.0)
        robot.advance(2.0)
        assert robot.twins["V"].mode == "speed"
        assert robot.twins["V"].given == round(-2.0 * 60 / math.tau * 4 * 10)
        assert robot["W.velocity"].value == pytest.approx(2.0, rel=0.01)
        before = robot["W.position"].value
        robot.advance(1.0)
        assert robot["W.position"].value - before == pytest.approx(2.0, rel=0.02)
        assert robot["V.voltage"].value == pytest.approx(48.2)


@pytest.mark.parametrize(("command", "value", "mode"), [("duty", 0.25, "duty"), ("current", 3.0, "current")])
def test_duty_and_current(command: str, value: float, mode: str) -> None:
    """With the joint's direction, within its limits."""
    text = CART.replace('command = "speed"', f'command = "{command}"').replace(
        "max_speed = 30", "max_current = 5"
    )
    with cart(text) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot[f"W.{command}"].set(value)
        robot.advance(0.3)
        assert robot.twins["V"].mode == mode
        assert robot.twins["V"].given == pytest.approx(-value)
        robot[f"W.{command}"].set(100.0)
        robot.advance(0.1)
        assert abs(robot.twins["V"].given) == pytest.approx(1.0 if command == "duty" else 5.0)
        assert robot.events.of("limited")


def test_nothing_is_sent_before_enabling() -> None:
    """A controller obeys whoever sends: the driver sends no set-point before `enable`."""
    with cart() as robot:
        robot.advance(0.1)
        robot["W.velocity"].set(2.0)
        robot.advance(0.3)
        assert robot.twins["V"].mode == "free"
        assert robot.events.of("not sent")


def test_without_a_host_its_time_out_releases_it() -> None:
    """1 s after the last set-point, as from the factory; getters do not restart it."""
    with cart() as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["W.velocity"].set(2.0)
        robot.advance(0.5)
        robot.devices["V"].drop("SetSpeed")
        robot.advance(0.9)
        assert robot.twins["V"].mode == "speed"
        robot.advance(0.2)
        assert robot.twins["V"].mode == "free"


def test_a_fault_is_told_and_ends_set_points() -> None:
    """By its name; enabling fails while it lasts."""
    with cart() as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["W.velocity"].set(2.0)
        robot.advance(0.1)
        robot.twins["V"].fault("trip")
        robot.advance(0.1)
        assert robot.events.of("alarm")[-1].detail == "over_temperature_fet"
        with pytest.raises(DeviceError, match="over_temperature_fet"):
            robot.rig.each("enable").wait(5)
        robot.twins["V"].fault("trip", on=False)
        robot.advance(4.0)
        assert robot.events.of("alarm over")
        assert robot["W.velocity"].value == pytest.approx(0.0, abs=0.1)


def test_one_that_was_silent_must_be_enabled_anew() -> None:
    """It may have rebooted: set-points that were given before do not go on."""
    with cart() as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["W.velocity"].set(2.0)
        robot.advance(0.2)
        robot.twins["V"].power(False)
        robot.advance(0.5)
        robot.twins["V"].power(True)
        robot.advance(0.5)
        assert robot.twins["V"].mode == "free"


@pytest.mark.slow
@pytest.mark.parametrize("stop", ["release", "brake"])
def test_a_stop_is_confirmed_or_named(stop: str) -> None:
    """It counts when no current drives the motor on; one that goes on is named."""
    text = CART.replace("pole_pairs = 10", f'pole_pairs = 10, stop = "{stop}"').replace(
        '"speed"', '"current"'
    )
    with cart(text) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["W.current"].set(5.0)
        robot.advance(0.2)
        robot.rig.stop_motion().wait(5)
        assert robot.twins["V"].mode == ("brake" if stop == "brake" else "current")
        assert robot.twins["V"].given == (5.0 if stop == "brake" else 0.0)
        robot.rig.each("enable").wait(5)
        robot["W.current"].set(5.0)
        robot.advance(0.2)
        twin = robot.twins["V"]
        twin.fault("deaf")
        twin._late.cancel()
        with pytest.raises(NotStoppedError, match=r"V.*its motor current is -5 A"):
            robot.rig.stop_motion().wait(5)


def test_a_long_answer_is_put_together() -> None:
    """Version and hardware come in pieces; two controllers that answer at once do not mix."""
    more = 'V2 = { driver = "vesc", bus = "can", credentials = { id = 6 } }\n[joints]'
    with cart(CART.replace("[joints]", more)) as robot:
        robot.advance(0.1)
        both: list[Any] = [robot.devices[name].firmware() for name in ("V", "V2")]
        assert [one.wait(5) for one in both] == ["6.5 on 60", "6.5 on 60"]


def test_what_cannot_be() -> None:
    """A gear with an encoder's angle; the host's number that is the device's."""
    with pytest.raises(CallerError, match="a gear of 4 goes with"):
        cart(CART.replace('command = "speed"', 'command = "position"'))
    with pytest.raises(CallerError, match="its own number 5"):
        cart(CART.replace("pole_pairs = 10", "host = 5"))
