"""Devices by the table of their registers, and the FT 300 as one of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from aces_bus.device import UNKNOWN, Robot
from aces_bus.device.stopping import stop_devices
from aces_bus.errors import CallerError, DeviceError, NoReplyError, NotStoppedError, UnknownNameError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.modbus.driver import driver
from aces_devices.modbus.table import ModbusRegister, RegisterEntry, registers_of
from aces_devices.robotiq_ft300.driver import driver as ft300_driver

test_modbus = driver_tests(driver)
test_ft300 = driver_tests(ft300_driver)


def noted(note: Callable[[Any], object], value: Any, now: int) -> None:
    """Listen to a signal: note its value, not when."""
    note(value)


def robot_of(text: str) -> Robot:
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return robot


def device_of(registers: str, settings: str = "") -> str:
    return f"""
name = "bench"
rate_hz = 20
[buses]
line = {{ link = "serial", protocol = "modbus", baud = 115_200 }}
[devices.D]
driver = "modbus"
bus = "line"
credentials = {{ unit = 7 }}
[devices.D.settings]
{settings}
[devices.D.settings.registers]
{registers}
"""


@pytest.mark.parametrize(
    ("kind", "options", "value", "raw"),
    [
        ("u16", {}, 0xFFFE, (0xFFFE,)),
        ("s16", {"scale": 0.1, "offset": -5}, -17.5, (0xFF83,)),
        ("u32", {}, 0x12345678, (0x1234, 0x5678)),
        ("u32", {"words": "low first"}, 0x12345678, (0x5678, 0x1234)),
        ("u32", {"bytes": "low first"}, 0x12345678, (0x3412, 0x7856)),
        ("u32", {"words": "low first", "bytes": "low first"}, 0x12345678, (0x7856, 0x3412)),
        ("s32", {}, -2, (0xFFFF, 0xFFFE)),
        ("float", {}, 12.5, (0x4148, 0)),
        ("float", {"words": "low first"}, 12.5, (0, 0x4148)),
        ("double", {}, -2.0, (0xC000, 0, 0, 0)),
        ("u64", {}, 2**48 + 1, (1, 0, 0, 1)),
        ("text", {"count": 3}, "oven", (0x6F76, 0x656E, 0)),
    ],
)
def test_numbers_and_their_orders(
    kind: Any, options: dict[str, Any], value: Any, raw: tuple[int, ...]
) -> None:
    """Types, orders of words and bytes, scale and offset: both ways."""
    register = ModbusRegister("x", RegisterEntry(address=0, type=kind, **options))
    assert register.raw(value) == raw
    assert (
        register.value(raw) == pytest.approx(value)
        if isinstance(value, float)
        else register.value(raw) == value
    )


def test_what_does_not_fit_is_refused() -> None:
    """A value beyond its type, no number, a text that is too long: named, and nothing is cut off."""
    for kind, value in (
        ("u16", 70_000),
        ("u16", -1),
        ("s16", float("nan")),
        ("u32", "much"),
        ("text", "long"),
        ("float", 1e300),
    ):
        with pytest.raises(CallerError, match=r"register x: .* does not fit into"):
            ModbusRegister("x", RegisterEntry(address=0, type=kind)).raw(value)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"address": 70_000, "type": "u16"}, "D: register x: Expected `int` <= 65535"),
        ({"address": 1, "type": "u17"}, "D: register x: Invalid enum value 'u17'"),
        ({"address": 1, "type": "u16", "adress": 2}, "D: register x: Object contains unknown field `adress`"),
        ({"type": "u16"}, "D: register x: Object missing required field `address`"),
        ({"address": 65_535, "type": "u32"}, "D: register x: 2 registers from 65535 on end beyond"),
        ({"address": 1, "type": "bit"}, "D: register x: a bit is in the table 'coil'"),
        (
            {"address": 1, "type": "u16", "table": "input", "access": "write"},
            "D: register x: .* can only be read",
        ),
        ({"address": 1, "type": "u16", "scale": 0}, "D: register x: a scale of 0"),
    ],
)
def test_a_wrong_table_is_named(entry: dict[str, Any], message: str) -> None:
    """Device, register and what is wrong."""
    with pytest.raises(CallerError, match=message):
        registers_of("D", None, {"x": entry})


def test_tables_come_from_files_too(tmp_path: Path) -> None:
    """A TOML file of one's own, a table that ships; own entries go before; what is not there is named."""
    path = tmp_path / "meter.toml"
    path.write_text(
        '[registers]\na = { address = 1, type = "u16" }\nb = { address = 2, type = "u16" }\n',
        encoding="utf-8",
    )
    found = registers_of("D", str(path), {"b": {"address": 9, "type": "s16"}})
    assert {name: one.entry.address for name, one in found.items()} == {"a": 1, "b": 9}
    assert registers_of("D", "robotiq_ft300", {})["fz"].entry.address == 182
    with pytest.raises(UnknownNameError, match="robotiq_ft300"):
        registers_of("D", "robotic", {})
    with pytest.raises(CallerError, match="cannot be read"):
        registers_of("D", str(tmp_path / "none.toml"), {})


def test_values_are_written_confirmed_and_read_back() -> None:
    """A set-point goes out once, the latest of several; a bit is a bit; what the device refuses is said."""
    with VirtualRobot(robot_of(driver.example), rate_hz=20) as robot:
        oven, twin = robot.devices["OVEN"], robot.twins["OVEN"]
        written: list[tuple[str, Any]] = []
        twin.changed = lambda name, value: written.append((name, value))
        robot.advance(0.5)
        for goal in (100.0, 150.0, 180.5):
            robot["OVEN.goal"].set(goal)
        robot["OVEN.heater"].set(True)
        robot.advance(0.5)
        assert (robot["OVEN.goal"].value, robot["OVEN.heater"].value) == (180.5, True)
        assert ("goal", 180.5) in written
        assert len(written) <= 3
        assert oven.read("temperature").wait(2) == -50.0
        twin.fault("busy")
        with pytest.raises(DeviceError, match="OVEN: writing goal = 20: refused: busy"):
            oven.write("goal", 20).wait(2)
        robot.advance(0.5)
        assert robot.events.of("alarm")[-1].detail.endswith(": busy")


def test_a_stop_is_what_the_file_says() -> None:
    """Its registers are written before all that waits, confirmed; a device that does not answer has not stopped."""
    with VirtualRobot(robot_of(driver.example), rate_hz=20) as robot:
        oven, twin = robot.devices["OVEN"], robot.twins["OVEN"]
        robot.advance(0.5)
        robot["OVEN.goal"].set(200.0)
        robot["OVEN.heater"].set(True)
        robot.advance(0.5)
        robot["OVEN.goal"].set(240.0)
        oven.stop_motion().wait(2)
        assert (twin.take("heater"), twin.take("goal")) == (False, 20)
        twin.fault("silent")
        with pytest.raises(NoReplyError):
            oven.stop_motion().wait(5)


def test_what_nothing_stops_is_named() -> None:
    """A device that was set, and whose file says no `stop`, has not stopped; `stop = {}` says that nothing has to."""
    speed = 'speed = { address = 0, type = "u16", access = "read-write" }'
    for settings, is_loud in (("", True), ("stop = {}", False)):
        with VirtualRobot(robot_of(device_of(speed, settings)), rate_hz=20) as robot:
            robot.advance(0.5)
            stop_devices(robot.clock, "all", robot.devices.values()).wait(5)  # nothing was set yet
            robot["D.speed"].set(100)
            robot.advance(0.5)
            stopping = stop_devices(robot.clock, "all", robot.devices.values())
            if is_loud:
                with pytest.raises(NotStoppedError, match="D was set, and its file says no `stop`"):
                    stopping.wait(5)
            else:
                stopping.wait(5)


def test_an_answer_never_gets_anothers_names() -> None:
    """A device that answers later than it is waited for: its values are right or unknown, though all answers look alike."""
    text = device_of(
        'a = { address = 0, type = "u16" }\nb = { address = 10, type = "u16" }\nc = { address = 20, type = "u16" }'
    )
    wanted = {"a": 1, "b": 2, "c": 3}
    for late_s in (0.12, 0.21, 0.25, 0.45, 0.65):
        with VirtualRobot(robot_of(text), rate_hz=20) as robot:
            twin: Any = robot.twins["D"]
            for name, value in wanted.items():
                twin.put(name, value)
            robot.advance(0.5)
            seen: dict[str, list[Any]] = {name: [] for name in wanted}
            for name, values in seen.items():
                robot[f"D.{name}"].listeners.append(partial(noted, values.append))
            twin.fault("late", late_s)
            robot.advance(6.0)
            for name, values in seen.items():
                assert set(values) <= {wanted[name], UNKNOWN}, (name, late_s)
            twin.fault("late", on=False)
            robot.advance(3.0)
            assert {name: robot[f"D.{name}"].value for name in wanted} == wanted


def test_neighbours_are_asked_together_and_constants_once() -> None:
    """What lies side by side is one request, what never changes is asked when the bus is opened."""
    with VirtualRobot(robot_of(driver.example), rate_hz=20) as robot:
        meter = robot.devices["METER"]
        assert [(poll.fields["start"], poll.fields["count"]) for poll in meter.polls] == [(0, 1), (2, 4)]
        robot.twins["METER"].put("serial", "SN-42")
        robot.advance(3.0)
        assert robot["METER.serial"].value == "SN-42"
        oven = robot.devices["OVEN"]
        assert sorted(poll.message for poll in oven.polls) == ["ReadBits", "ReadBits", "ReadRegisters"]


def test_a_stop_that_names_nothing_writable_is_refused() -> None:
    """It is found when the device is made, not when it must stop."""
    with pytest.raises(
        CallerError, match=r"D: stop = \{ a = … \}: there is no register a that can be written"
    ):
        VirtualRobot(robot_of(device_of('a = { address = 0, type = "u16" }', "stop = { a = 0 }")))


STREAM = ft300_driver.example.replace("{ unit = 9 } }", "{ unit = 9 }, settings = { stream = true } }")


def test_the_ft300_streams() -> None:
    """It is begun, its values are SI and fresh; it ends when it is told to, and is begun again when it breaks off."""
    with VirtualRobot(robot_of(STREAM), rate_hz=20) as robot:
        device: Any = robot.devices["FT"]
        twin: Any = robot.twins["FT"]
        twin.put("fx", 12.34)
        robot.advance(0.5)
        found = [robot[f"FT.{name}"].value for name in ("fx", "fy", "fz", "mx")]
        assert found == pytest.approx([12.34, 0, -9.81, 0.25])
        assert 40 <= robot.rig.hosts["wrist"].counts.received <= 55
        assert twin.requests == 1
        device.stop_stream()
        robot.advance(1.5)
        assert (twin.is_streaming, robot["FT.fz"].value) == (False, UNKNOWN)
        device.start_stream()
        robot.advance(0.5)
        assert robot["FT.fz"].value == pytest.approx(-9.81)
        twin.fault("quiet")
        robot.advance(0.3)
        assert robot["FT.fz"].value is UNKNOWN
        twin.fault("quiet", on=False)
        robot.advance(1.5)
        assert robot["FT.fz"].value == pytest.approx(-9.81)
