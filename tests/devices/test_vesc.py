"""VESC: driver and twin."""

from __future__ import annotations

import math
from binascii import crc_hqx
from typing import Any

import pytest
import serial

from aces_bus.errors import CallerError, DeviceError, NotStoppedError, UnknownNameError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from tests.oracles.terminals import twins_at_a_terminal

test_vesc = driver_tests("vesc")
test_vesc_uart = driver_tests(
    "vesc_uart",
    excused={"misbehaviour: * wrong_number": "a serial line has one controller, without a number"},
)

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

LINE = CART.replace(
    '{ link = "can", protocol = "vesc" }', '{ link = "serial", protocol = "vesc_uart" }'
).replace('"vesc", bus = "can", credentials = { id = 5 }', '"vesc_uart", bus = "can"')
on_both = pytest.mark.parametrize("text", [CART, LINE], ids=["can", "line"])


def cart(text: str = CART, **more: Any) -> VirtualRobot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=50, **more)


@on_both
def test_a_speed_is_the_fields(text: str) -> None:
    """rad/s of the joint × gear × pole pairs, in turns of the field a minute; the tachometer says how far it went."""
    with cart(text) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["W.velocity"].set(2.0)
        robot.advance(2.0)
        assert robot.twins["V"].model.mode == "speed"
        assert robot.twins["V"].model.given == round(-2.0 * 60 / math.tau * 4 * 10)
        assert robot["W.velocity"].value == pytest.approx(2.0, rel=0.01)
        before = robot["W.position"].value
        robot.advance(1.0)
        assert robot["W.position"].value - before == pytest.approx(2.0, rel=0.02)
        assert robot["V.voltage"].value == pytest.approx(48.2)


@on_both
@pytest.mark.parametrize(("command", "value", "mode"), [("duty", 0.25, "duty"), ("current", 3.0, "current")])
def test_duty_and_current(command: str, value: float, mode: str, text: str) -> None:
    """With the joint's direction, within its limits."""
    text = text.replace('command = "speed"', f'command = "{command}"').replace(
        "max_speed = 30", "max_current = 5"
    )
    with cart(text) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot[f"W.{command}"].set(value)
        robot.advance(0.3)
        assert robot.twins["V"].model.mode == mode
        assert robot.twins["V"].model.given == pytest.approx(-value)
        robot[f"W.{command}"].set(100.0)
        robot.advance(0.1)
        assert abs(robot.twins["V"].model.given) == pytest.approx(1.0 if command == "duty" else 5.0)
        assert robot.events.of("limited")


@on_both
def test_nothing_is_sent_before_enabling(text: str) -> None:
    """A controller obeys whoever sends: the driver sends no set-point before `enable`."""
    with cart(text) as robot:
        robot.advance(0.1)
        robot["W.velocity"].set(2.0)
        robot.advance(0.3)
        assert robot.twins["V"].model.mode == "free"
        assert robot.events.of("not sent")


@on_both
def test_without_a_host_its_time_out_releases_it(text: str) -> None:
    """1 s after the last set-point, as from the factory; getters do not restart it."""
    with cart(text) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["W.velocity"].set(2.0)
        robot.advance(0.5)
        robot.devices["V"].drop("SetSpeed")
        robot.advance(0.9)
        assert robot.twins["V"].model.mode == "speed"
        robot.advance(0.2)
        assert robot.twins["V"].model.mode == "free"


@on_both
def test_a_fault_is_told_and_ends_set_points(text: str) -> None:
    """By its name; enabling fails while it lasts."""
    with cart(text) as robot:
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


@on_both
def test_one_that_was_silent_must_be_enabled_anew(text: str) -> None:
    """It may have rebooted: set-points that were given before do not go on."""
    with cart(text) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["W.velocity"].set(2.0)
        robot.advance(0.2)
        robot.twins["V"].power(False)
        robot.advance(0.5)
        robot.twins["V"].power(True)
        robot.advance(0.5)
        assert robot.twins["V"].model.mode == "free"


@pytest.mark.slow
@on_both
@pytest.mark.parametrize("stop", ["release", "brake"])
def test_a_stop_is_confirmed_or_named(stop: str, text: str) -> None:
    """It counts when no current drives the motor on; one that goes on is named."""
    text = text.replace("pole_pairs = 10", f'pole_pairs = 10, stop = "{stop}"').replace(
        '"speed"', '"current"'
    )
    with cart(text) as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait(5)
        robot["W.current"].set(5.0)
        robot.advance(0.2)
        robot.rig.stop_motion().wait(5)
        assert robot.twins["V"].model.mode == ("brake" if stop == "brake" else "current")
        assert robot.twins["V"].model.given == (5.0 if stop == "brake" else 0.0)
        robot.rig.each("enable").wait(5)
        robot["W.current"].set(5.0)
        robot.advance(0.2)
        twin = robot.twins["V"]
        twin.fault("deaf")
        twin.model._late.cancel()
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


def test_a_line_has_no_settings_of_can() -> None:
    """Status messages and host numbers are refused by name; its firmware is asked for."""
    for setting in ('values = "status"', "host = 7"):
        with pytest.raises(UnknownNameError, match=r"setting of V"):
            cart(LINE.replace("pole_pairs = 10", setting))
    with cart(LINE) as robot:
        robot.advance(0.5)
        device: Any = robot.devices["V"]
        assert device.firmware().wait(5) == "6.5 on 60"


def test_any_program_talks_to_it_at_a_terminal() -> None:
    """Worked packets, by a pseudo-terminal: what is sent is done, and answered with a right check."""
    robot, problems = parse_robot(LINE)
    assert robot is not None, problems
    with twins_at_a_terminal(robot, "can") as made, serial.Serial(made.port.path, 115200, timeout=30) as line:

        def asked(packet: str) -> bytes:
            line.write(bytes.fromhex(packet))
            head = line.read(2)
            rest: bytes = line.read(head[1] + 3)
            assert (head[0], rest[-1], crc_hqx(rest[:-3], 0).to_bytes(2, "big")) == (2, 3, rest[-3:-1])
            return rest[:-3]

        twin: Any = made.twins["V"]
        seen: list[Any] = []
        with made.port.lock:
            twin.model.set = seen.append
        assert asked("02 01 00 00 00 03")[:6] == b"\0\6\5" + b"60\0"
        assert len(asked("02 01 04 40 84 03")) == 74
        line.write(bytes.fromhex("02 05 06 00 00 13 88 8B 25 03 02 01 1E F3 FF 03"))  # 5 A, and alive
        assert asked("02 05 32 00 00 81 C0 B9 88 03")[:5].hex(" ") == "32 00 00 81 c0"
        with made.port.lock:
            assert [(type(one).__name__, one.current) for one in seen] == [("SetCurrent", 5.0)]
