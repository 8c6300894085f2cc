"""Joints keep within the limits of their file by what is measured of them, whatever they are commanded by."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus.controller import controller
from aces_bus.device import UNKNOWN, Robot
from aces_bus.errors import CallerError
from aces_bus.robot import VirtualRobot, parse_robot, run_virtual

#: Protocol, driver with what it needs, and what a joint commanded by speed must say besides.
SPEEDS = {
    "moteus": ("can", "moteus", "credentials = { id = 1 }"),
    "odrive": ("can", "odrive", "credentials = { node = 1 }"),
    "damiao": ("can", "damiao", 'credentials = { motor = 1 }, model = "4310"'),
    "robstride": ("can", "robstride", 'credentials = { motor = 1 }, model = "RS04"'),
}


def robot_of(driver: str, joint: str) -> Robot:
    """One device M with a joint J."""
    link, protocol, device = SPEEDS[driver]
    robot, problems = parse_robot(
        f'name = "one"\nrate_hz = 200\n[buses]\nb = {{ link = "{link}", protocol = "{protocol}" }}\n'
        f'[devices]\nM = {{ driver = "{driver}", bus = "b", {device} }}\n[joints]\nJ = {{ device = "M", {joint} }}\n'
    )
    assert robot is not None, problems
    return robot


def enabled(driver: str, joint: str, **options: Any) -> VirtualRobot:
    """A robot whose device is on."""
    virtual = VirtualRobot(robot_of(driver, joint), rate_hz=200, **options)
    virtual.__enter__()
    virtual.advance(0.3)
    virtual.devices["M"].enable().wait(5)
    virtual.advance(0.05)
    return virtual


def where(virtual: VirtualRobot) -> float:
    """Where the joint truly is."""
    return float(virtual.simulation.world.joints["J"].position(virtual.clock.now()))


def furthest(virtual: VirtualRobot, seconds: float) -> float:
    """The greatest distance from 0 at which the joint truly was meanwhile."""
    far = 0.0
    for _ in range(round(seconds / 0.005)):
        virtual.advance(0.005)
        far = max(far, abs(where(virtual)))
    return far


@pytest.mark.parametrize(
    ("driver", "sign"),
    [
        # In turn one direction of each is quick.
        pytest.param(driver, sign, marks=[] if sign == (-1) ** number else [pytest.mark.slow])
        for number, driver in enumerate(SPEEDS)
        for sign in (1, -1)
    ],
)
def test_a_joint_that_is_set_by_speed_stops_at_its_bound(driver: str, sign: int) -> None:
    """It comes to a stand at the bound, inside of it, without a trip, and turns back when it is told to."""
    virtual = enabled(driver, 'command = "speed", lower = -1.0, upper = 1.0, max_speed = 3.0')
    try:
        virtual.rig["J.velocity"].set(sign * 2.0)
        assert furthest(virtual, 1.5) < 1.02
        assert where(virtual) == pytest.approx(sign * 1.0, abs=0.06)
        assert virtual.rig.door.tripped == {}
        assert virtual.events.count("limited") >= 1
        virtual.rig["J.velocity"].set(-sign * 1.0)
        virtual.advance(0.5)
        assert sign * where(virtual) < 0.8
    finally:
        virtual.__exit__(None, None, None)


@pytest.mark.parametrize("driver", ["damiao", "robstride"])
def test_torque_outward_ends_at_the_bound_and_past_it_the_joint_trips(driver: str) -> None:
    """A torque runs a free joint against its bound: there it is 0; what goes on by its own momentum is switched off."""
    virtual = enabled(driver, "lower = -1.0, upper = 1.0, max_speed = 20.0")
    try:
        virtual.rig["J.torque"].set(3.0)
        virtual.advance(3.0)
        assert "J is at" in virtual.rig.door.tripped["J.torque"]
        assert "past its limits -1 to 1" in virtual.rig.door.tripped["J.position"]
        assert virtual.events.count("past limit", "M") == 1
        motor: Any = virtual.devices["M"]
        assert motor.is_on is False
        with pytest.raises(CallerError, match="past its limits"):
            virtual.rig["J.torque"].set(1.0)
    finally:
        virtual.__exit__(None, None, None)


def test_torque_no_longer_accelerates_a_joint_at_its_speed() -> None:
    """A joint that turns without end: at its largest speed torque outward is 0, so that it gets no faster."""
    virtual = enabled("damiao", 'type = "continuous", max_speed = 5.0')
    motor: Any = virtual.simulation["M"]
    try:
        virtual.rig["J.torque"].set(3.0)
        fastest = 0.0
        for _ in range(400):
            virtual.advance(0.005)
            fastest = max(fastest, motor.motor.v)
        assert 4.5 < fastest < 1.5 * 5.0
        assert virtual.rig.door.tripped == {}
    finally:
        virtual.__exit__(None, None, None)


def test_no_speed_may_be_set_before_it_is_known_where_a_joint_is() -> None:
    """A drawn schedule had a controller stop a joint of a device that answered late: 0 raised, and nothing was sent."""
    virtual = enabled("moteus", 'command = "speed", lower = -1.0, upper = 1.0, max_speed = 3.0')
    try:
        virtual.devices["M"].forget()
        assert virtual.rig["J"].last is UNKNOWN
        virtual.rig["J.velocity"].set(0.0)
        assert virtual.events.count("limited") == 0
        virtual.rig["J.velocity"].set(1.0)
        assert virtual.events.count("limited") == 1
    finally:
        virtual.__exit__(None, None, None)


def test_a_joint_that_is_too_fast_trips() -> None:
    """What turns a joint faster than its file allows switches it off, named."""
    virtual = enabled("damiao", 'type = "continuous", max_speed = 2.0')
    try:
        virtual.rig["J.torque"].set(0.01)
        virtual.advance(0.05)
        motor: Any = virtual.simulation["M"]
        for _ in range(40):  # something turns it
            motor.motor.v = 6.0
            virtual.advance(0.005)
        assert "at most 2" in virtual.rig.door.tripped["J.torque"]
        assert virtual.events.count("too fast", "M") == 1
    finally:
        virtual.__exit__(None, None, None)


def test_a_supervised_joint_past_its_bound_stops_its_controller() -> None:
    """The trip is its supervisor's: motion is stopped, and the reason names joint and limits."""

    @controller(rate_hz=200, writes=["J.torque"])
    def push() -> dict[str, float]:
        return {"J.torque": 3.0}

    with run_virtual(robot_of("damiao", "lower = -1.0, upper = 1.0, max_speed = 30.0"), [push]) as run:
        run.do("enable")
        ended = run.run(5.0)
    assert "past limit: J is at" in ended.tripped["push"]
    assert ended.seconds < 2.0
    assert ended.not_stopped == {}


def test_a_joint_that_begins_outside_may_come_back() -> None:
    """Led inside it does not trip; pushed further out it does."""
    virtual = enabled(
        "damiao", 'command = "speed", lower = -1.0, upper = 1.0, max_speed = 3.0', pose={"J": 1.5}
    )
    try:
        virtual.rig["J.velocity"].set(1.0)
        virtual.advance(0.3)
        assert where(virtual) == pytest.approx(1.5, abs=0.01)
        virtual.rig["J.velocity"].set(-1.0)
        virtual.advance(1.0)
        assert virtual.rig.door.tripped == {}
        assert where(virtual) < 1.0
    finally:
        virtual.__exit__(None, None, None)


def test_a_joint_that_nobody_commands_may_be_anywhere() -> None:
    """Outside of its limits and enabled, but without a set-point, it is left alone."""
    virtual = enabled("damiao", "lower = -1.0, upper = 1.0, max_speed = 3.0", pose={"J": 2.0})
    try:
        virtual.advance(1.0)
        assert virtual.rig.door.tripped == {}
    finally:
        virtual.__exit__(None, None, None)


def test_nothing_pushes_a_joint_before_it_is_known_where_it_is() -> None:
    """Without a position a speed of a joint with limits is 0, which is said."""
    virtual = VirtualRobot(robot_of("odrive", 'command = "speed", lower = -1.0, upper = 1.0'), rate_hz=200)
    virtual.rig["J.velocity"].set(1.0)
    assert virtual.rig.door.given("J.velocity") == 0.0
    assert virtual.rig.events.count("limited", "M") == 1


def test_a_bus_without_ticks_looks_where_a_pushed_joint_is() -> None:
    """A script without a rate sets a speed once: the joint is asked where it is, and stops at its bound."""
    virtual = VirtualRobot(
        robot_of("odrive", 'command = "speed", lower = -1.0, upper = 1.0, max_speed = 3.0'), rate_hz=0
    )
    with virtual:
        virtual.advance(0.3)
        virtual.devices["M"].enable().wait(5)
        virtual.rig["J.velocity"].set(2.0)
        assert furthest(virtual, 3.0) < 1.02
        assert virtual.rig.door.tripped == {}


def test_a_bus_without_ticks_moves_a_goal_on_once_in_a_period() -> None:
    """However often a script sets a far goal, its joint is led on every 10 ms, no more often."""
    virtual = VirtualRobot(robot_of("odrive", "lower = -1.0, upper = 1.0, max_speed = 0.5"), rate_hz=0)
    with virtual:
        virtual.advance(0.3)
        virtual.devices["M"].enable().wait(5)
        joint, given = virtual.rig["J.position"], list[int]()
        for wanted in (0.8, 0.9, 1.0):
            joint.set(wanted)
            virtual.advance(0.003)
        joint.given.append(lambda value, now: given.append(now))
        virtual.advance(0.5)
        assert 45 <= len(given) <= 51
        assert virtual.rig.door.given("J.position") == pytest.approx(0.25, abs=0.03)


def test_a_speed_that_was_measured_once_is_not_too_fast() -> None:
    """A busy machine had one answer in 0.1 s: the joint was stopped for a speed that it had for a moment only."""
    virtual = enabled("damiao", 'type = "continuous", max_speed = 2.0')
    try:
        virtual.rig["J.torque"].set(0.01)
        virtual.advance(0.05)
        motor: Any = virtual.simulation["M"]
        motor.motor.v = 6.0
        virtual.advance(0.006)
        assert virtual.rig["J.velocity"].last > 3.0
        virtual.twins["M"].fault("silent")
        virtual.advance(0.5)
        assert virtual.events.count("too fast") == 0
    finally:
        virtual.__exit__(None, None, None)


def test_a_speed_ends_when_it_is_no_longer_known_where_its_joint_is() -> None:
    """Its device answers no more: what it was set to becomes 0, though nobody stops it."""
    virtual = enabled("odrive", 'command = "speed", lower = -1.0, upper = 1.0, max_speed = 3.0')
    try:
        virtual.rig["J.velocity"].set(0.1)
        virtual.advance(0.1)
        assert virtual.rig.door.given("J.velocity") == 0.1
        virtual.twins["M"].fault("silent")
        virtual.advance(3.0)
        assert virtual.rig["J"].is_stale
        assert virtual.rig.door.given("J.velocity") == 0.0
        assert where(virtual) < 0.5
    finally:
        virtual.__exit__(None, None, None)
