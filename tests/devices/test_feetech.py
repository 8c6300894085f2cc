"""Feetech servos: units, both byte orders, the lock, homing, modes, answers in turn."""

from __future__ import annotations

import math
from typing import Any

import pytest

from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError, DeviceError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.feetech import driver
from aces_devices.feetech.driver import Feetech
from aces_devices.feetech.twin import FeetechTwin
from aces_protocols.feetech.spec import feetech

test_driver = driver_tests(driver)

LINE = """
name = "line"
rate_hz = 50
[buses]
line = {{ link = "serial", protocol = "feetech", baud = 1_000_000 }}
[devices]
F1 = {{ driver = "feetech", bus = "line", model = "{model}", credentials = {{ id = 1 }}, settings = {{ health_s = 0.1 }} }}
F2 = {{ driver = "feetech", bus = "line", model = "{other}", credentials = {{ id = 2 }} }}
[joints]
J1 = {{ device = "F1", zero = {zero}{joint} }}
J2 = {{ device = "F2", zero = 2.0 }}
"""


def made(
    *, model: str = "STS3215", other: str = "STS3215", zero: float = math.pi, joint: str = ""
) -> VirtualRobot:
    robot, problems = parse_robot(LINE.format(model=model, other=other, zero=zero, joint=joint))
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=50, load={"feetech": driver}.__getitem__)


def first(robot: VirtualRobot) -> tuple[Feetech, FeetechTwin]:
    device, twin = robot.devices["F1"], robot.twins["F1"]
    assert isinstance(device, Feetech)
    assert isinstance(twin, FeetechTwin)
    return device, twin


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "zero", "counts", "sent"),
    [("STS3215", math.pi, 2374, "2A 02 01 46 09"), ("SCS0009", 2.0, 489, "2A 02 01 01 E9")],
)
def test_goals_are_counts_in_the_byte_order_of_the_series(
    model: str, zero: float, counts: int, sent: str
) -> None:
    """0.5 rad of STS is 4096ths of a turn, low byte first; of SCS 1024ths of 300°, high byte first."""
    with made(model=model, zero=zero) as robot:
        robot.advance(0.1)
        device, twin = first(robot)
        device.enable().wait()
        packets: list[bytes] = []
        robot.ports("ear")["line"].open(lambda data, _: packets.append(bytes(data)))
        robot["J1.position"].set(0.5)
        robot.advance(3.0)
        assert twin["goal_position"] == counts
        assert any(bytes.fromhex(sent) in packet for packet in packets)
        assert robot["J1.position"].value == pytest.approx(0.5, abs=6e-3)


def test_servos_of_both_series_share_a_line() -> None:
    """Their set-points go out in a packet each, as their registers are not alike."""
    with made(other="SCS0009") as robot:
        robot.advance(0.1)
        robot.rig.each("enable").wait()
        robot["J1.position"].set(0.5)
        robot["J2.position"].set(0.5)
        robot.advance(2.0)
        assert robot["J1.position"].value == pytest.approx(0.5, abs=6e-3)
        assert robot["J2.position"].value == pytest.approx(0.5, abs=6e-3)


def test_a_wheel_has_speeds_and_stops() -> None:
    """Velocity mode: the sign is bit 15; a stop is not a speed."""
    with made(joint=', type = "continuous", command = "speed", direction = -1') as robot:
        robot.advance(0.1)
        device, twin = first(robot)
        device.enable().wait()
        robot["J1.velocity"].set(1.0)
        robot.advance(0.5)
        assert twin["goal_speed"] == 0x8000 | 652
        assert robot["J1.velocity"].value == pytest.approx(1.0, abs=2e-3)
        device.stop_motion().wait()
        robot.advance(0.5)
        assert robot["J1.velocity"].value == 0


def test_another_mode_is_reported_refused_and_set_right() -> None:
    """As with every servo that has modes; the mode is written unlocked, and survives power-off."""
    robot = made()
    robot.twins["F1"]["operating_mode"] = 1
    with robot:
        robot.advance(0.2)
        device, twin = first(robot)
        with pytest.raises(DeviceError, match=r"velocity.*set_mode"):
            device.enable().wait()
        device.set_mode(confirm=True).wait()
        assert (twin["operating_mode"], twin["lock"]) == (0, 1)
        twin.reboot()
        assert twin["operating_mode"] == 0
        device.enable().wait()


def test_what_is_written_locked_does_not_survive() -> None:
    """`write` unlocks and locks; a write by hand while locked is gone after power-off."""
    with made() as robot:
        robot.advance(0.1)
        device, twin = first(robot)
        with pytest.raises(CallerError, match="confirm=True"):
            device.write("p_gain", 16)
        device.write("p_gain", 16, confirm=True).wait()
        twin.put(22, b"\x07")
        assert (twin["p_gain"], twin["d_gain"]) == (16, 7)
        twin.reboot()
        assert (twin["p_gain"], twin["d_gain"]) == (16, 32)
        robot.advance(0.3)
        device.enable().wait()
        robot.advance(0.3)
        with pytest.raises(CallerError, match="disable"):
            device.write("p_gain", 32, confirm=True)


@pytest.mark.parametrize(("at", "offset"), [(1.0, 0x800 | 1396), (5.0, 1213)])
def test_homing_makes_the_present_position_the_middle(at: float, offset: int) -> None:
    """Below the middle the offset is negative, with its sign in bit 11; afterwards the position reads 2047."""
    with made(zero=0.0) as robot:
        first(robot)[1].motion.at = at / math.tau * 4096
        robot.advance(0.1)
        device, twin = first(robot)
        device.home_here(confirm=True).wait()
        assert abs(twin["homing_offset"] - offset) <= 1
        assert device.read("present_position", raw=True).wait() == 2047


def test_a_servo_gets_another_id_for_good() -> None:
    """Asked whether it is free, written unlocked, and still so after power-off."""
    with made() as robot:
        robot.advance(0.1)
        device, twin = first(robot)
        with pytest.raises(CallerError, match="F2"):
            device.set_id(2, confirm=True)
        device.set_id(9, confirm=True).wait()
        robot.advance(0.2)
        twin.reboot()
        assert (twin["id"], device.credentials["id"]) == (9, 9)
        assert device.ping().wait() == []


def test_an_overload_lets_go_and_is_named() -> None:
    """A jammed joint: alarm by name, torque off."""
    with made() as robot:
        robot.advance(0.1)
        device, twin = first(robot)
        device.enable().wait()
        twin.fault("jam")
        robot["J1.position"].set(1.0)
        robot.advance(1.5)
        assert robot["J1.enabled"].value is False
        assert "overload" in {event.detail for event in robot.events.last if event.kind == "alarm"}


def test_sync_read_is_answered_in_turn() -> None:
    """In the order asked; an SCS servo does not know it."""
    robot = made(other="SCS0009")
    robot.simulation.open()
    found: list[Any] = []
    scanner = feetech.scanner(direction="from device", include_unknown=True)
    port = robot.ports("ear")["line"]
    port.open(lambda data, _: found.extend(scanner.feed(data)))
    port.send(feetech.encode("SyncRead", id=0xFE, start=3, count=2, ids=[2, 1]))
    robot.advance(0.05)
    assert [(record.id, record.parameters) for record in found] == [(1, b"\x09\x03")]


@pytest.mark.parametrize(
    ("joint", "why"),
    [
        (', type = "continuous"', "takes speeds"),
        (', command = "current"', "not currents"),
        (', command = "duty"', "not duties"),
    ],
)
def test_what_it_cannot_follow_is_refused(joint: str, why: str) -> None:
    """When the robot is put together, with what would work."""
    with pytest.raises(CallerError, match=why):
        made(joint=joint)


def test_all_positions_are_asked_for_at_once() -> None:
    """One SyncRead a tick for both servos; one that did not answer is asked alone, and holds nobody up."""
    with made() as robot:
        robot.advance(0.5)
        heard: list[Any] = []
        scanner = feetech.scanner(direction="to device")
        robot.ports("ear")["line"].open(lambda data, _: heard.extend(scanner.feed(data)))
        robot.advance(0.1)
        positions = [one for one in heard if one.start == 56]
        assert [(type(one).__name__, one.ids) for one in positions] == [("SyncRead", (1, 2))] * 5
        robot.twins["F2"].fault("silent")
        robot.advance(2.0)
        assert robot.devices["F2"].is_silent
        heard.clear()
        ticks = robot.rig.hosts["line"].counts.ticks
        robot.advance(1.0)
        ticks = robot.rig.hosts["line"].counts.ticks - ticks
        read = [one for one in heard if type(one).__name__ == "Read" and one.id == 1 and one.start == 56]
        assert len(read) > 0.6 * ticks  # the others' time is the silent one's
        assert robot["J1.position"].age_ns is not None
        assert robot["J1.position"].age_ns < 40_000_000
        robot.twins["F2"].fault("silent", on=False)
        robot.advance(1.0)
        assert robot["J2.position"].value is not UNKNOWN
