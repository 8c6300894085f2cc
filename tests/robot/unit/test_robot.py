"""Robots: states, e-stops and ends of runs, in parts that no user imports."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from aces_bus import Frame, load_robot
from aces_bus.controller.following import Following, following_of
from aces_bus.device import Device, Driver, load_driver
from aces_bus.device.config import Input
from aces_bus.device.drivers import list_drivers
from aces_bus.device.stopping import can_be_stopped, stop_devices
from aces_bus.errors import CallerError, NotStoppedError
from aces_bus.robot import (
    VirtualRobot,
    connect,
    parse_robot,
    run_real,
)
from aces_bus.robot.estop import objection
from aces_bus.robot.exits import stop_at_exit, stop_forgotten
from aces_bus.robot.rig import Rig
from aces_bus.robot.run_end import in_time
from aces_bus.robot.states import States
from aces_bus.robot.worlds import Replay
from aces_bus.runtime import VirtualClock
from aces_bus.runtime.loop import Loop
from aces_bus.runtime.tasks import VirtualTasks
from tests.device.fan import ROBOT as FAN
from tests.device.fan import drivers, robot_of
from tests.robot.leg import ROBOT
from tests.robot.test_declared import leg as leg
from tests.robot.test_stop_robot import bus as bus
from tests.robot.walking import hubo_leg


@pytest.mark.parametrize(
    ("said", "wanted"),
    [
        ({"kalman": {"measurement_std": 0.001, "process_density": 10}}, None),
        ({"estimator": "hold"}, None),
        ({"kalman": {"measurement_std": -1, "process_density": 10}}, "state RHP: kalman: "),
        ({"kalman": {"measurement_std": 1, "process_density": 10}, "estimator": "hold"}, "not both"),
        ({"estimator": "holt"}, "did you mean 'hold'"),
    ],
)
def test_a_program_says_estimators_as_a_file_does(said: dict[str, Any], wanted: str | None) -> None:
    """A word or a table `kalman`; what is neither is refused with the state's name."""
    rig = VirtualRobot(leg(""), rate_hz=100).rig
    if wanted is None:
        assert States(rig, declared={"RHP": said})["RHP"] is not None
    else:
        with pytest.raises(CallerError, match=wanted):
            States(rig, declared={"RHP": said})


@pytest.mark.parametrize(
    ("one", "value", "is_pressed"),
    [
        (Input(signal="x", clear=True), True, False),
        (Input(signal="x", clear=True), 1, False),
        (Input(signal="x", clear=True), False, True),
        (Input(signal="x", clear=True), "true", True),
        (Input(signal="x", clear=True), None, True),
        (Input(signal="x", clear=True), float("nan"), True),
        (Input(signal="x", clear="run"), "run", False),
        (Input(signal="x", clear="run"), "halt", True),
        (Input(signal="x", clear="run"), ("run",), True),
        (Input(signal="x", clear=0, bit=3), 0b0111, False),
        (Input(signal="x", clear=0, bit=3), 0b1000, True),
        (Input(signal="x", clear=0, bit=3), 7.0, True),
        (Input(signal="x", pressed=1, bit=0), -1, True),
        (Input(signal="x", pressed=True), False, False),
        (Input(signal="x", pressed=True), True, True),
        (Input(signal="x", pressed=True), "no", True),
        (Input(signal="x", pressed=3), float("inf"), True),
        (Input(signal="x", pressed="estop"), ("spinout", "estop"), True),
        (Input(signal="x", pressed="estop"), frozenset({"spinout"}), False),
        (Input(signal="x", pressed="estop"), (), False),
        (Input(signal="x", pressed="estop"), 0, True),
    ],
)
def test_a_value_that_is_not_known_to_be_clear_is_pressed(one: Input, value: Any, is_pressed: bool) -> None:
    """Only the stated value is clear; what cannot be compared with the stated one is pressed."""
    assert bool(objection(one, value)) is is_pressed


def test_what_nobody_can_set_is_read_only() -> None:
    """A signal that a driver updates by itself, from no declared field, is a state that is read and not set."""
    robot = VirtualRobot(robot_of(FAN), load=drivers)
    device = robot.devices["A"]
    robot.rig.signals["A.mood"] = device.add_signal("mood")
    mood = States(robot.rig)["A.mood"]
    device["mood"].update(3.0, 5)
    assert (mood[0], mood.is_writable) == (3.0, False)


@pytest.mark.parametrize(
    ("buses", "channels", "wanted"),
    [
        (
            {"lower": "can1", "upper": "can0"},
            ["can1", "upper", "0", "1"],
            ["lower", "upper", "upper", "lower"],
        ),
        ({"lower": "a", "upper": "b"}, ["0", "1", "a"], ["lower", "upper", "lower"]),
        ({"lower": None, "upper": "can4"}, ["0", "4"], [None, "upper"]),
    ],
)
def test_channels_of_a_recording_find_their_bus(
    buses: dict[str, str | None], channels: list[str], wanted: list[str | None]
) -> None:
    """By name, by the number at the end of the bus's channel, and by order where no channel of the robot has a number."""
    text = 'name = "two"\n[buses]\n'
    for name, channel in buses.items():
        at = "" if channel is None else f', channel = "{channel}"'
        text += f'{name} = {{ link = "can", protocol = "fan"{at} }}\n'
    text += "[devices]\n"
    for name in buses:
        text += f'{name[0].upper()} = {{ driver = "fan", bus = "{name}", credentials = {{ node = 3 }} }}\n'
    replay = Replay(robot_of(text), [Frame(0x7FE, b"", 1.0, name) for name in channels], load=drivers)
    found: dict[str, str] = {}

    def finds(bus: str) -> Callable[[Any, int], None]:
        return lambda frame, now: found.update({frame.channel: bus})

    for name, port in replay.ports.items():
        port.open(finds(name))
    replay.start()
    replay.clock.advance(1_000_000_000)
    assert replay.is_over
    assert [found.get(channel) for channel in channels] == wanted
    assert replay.unmatched.startswith("1 frames were on no bus of two: ") is (None in wanted)


@pytest.mark.parametrize("begun", [False, True])
def test_an_end_does_not_wait_for_a_thread_that_hangs(monkeypatch: pytest.MonkeyPatch, begun: bool) -> None:
    """What the buses' thread has not begun in time is done here; what it has begun and not ended is said."""
    monkeypatch.setattr("aces_bus.robot.run_end.PATIENCE_S", 0.02)
    let_go = threading.Event()
    did: list[str] = []

    def action() -> int:
        did.append(threading.current_thread().name)
        if begun:
            let_go.wait(10)
        return 7

    with Loop() as loop:
        if not begun:
            loop.call_soon(lambda: let_go.wait(10))
        try:
            if begun:
                with pytest.raises(TimeoutError, match=r"not over after 0\.02 s"):
                    in_time(loop, action)
                assert did == ["aces loop"]
            else:
                assert in_time(loop, action) == 7
                assert did == [threading.current_thread().name]
        finally:
            let_go.set()
    assert len(did) == 1  # the thread does not do it once more


@pytest.mark.parametrize("error", [SystemExit(3), KeyboardInterrupt(), ValueError("no such thing")])
def test_what_is_raised_on_the_buses_thread_is_raised_where_it_was_asked_for(error: BaseException) -> None:
    """Whatever it is: it neither ends that thread nor is lost."""

    def action() -> None:
        raise error

    with Loop() as loop:
        with pytest.raises(type(error)):
            in_time(loop, action)
        assert in_time(loop, lambda: 5) == 5


#: Devices of the drivers' examples that cannot confirm the stop of another program's motion, with the reason.
SILENT: Mapping[str, str] = {
    "RACK": "CiA 401 has no message that takes outputs back to what they were",
    "TANK": "as RACK",
    "EJMC4": "boards of hands have neither a switch nor a status",
    "VIA_RSP": "the PC answers nothing and has no stop",
    "VIA_LSR": "as VIA_RSP",
    "METER": "its file says no `stop`",
    "FRONT": "DroneCAN's list of throttles has no answer, and a status has no word for being off",
    "BACK": "as FRONT",
}


@contextmanager
def second_program(robot: VirtualRobot) -> Generator[Rig]:
    """Another program on the same wires, which has received nothing yet."""
    rig = connect(robot.robot, robot.ports("second"))
    for host in rig.hosts.values():
        host.open(is_started=False)
    yield rig
    rig.close()


def stop_from_outside(robot: VirtualRobot) -> tuple[dict[str, str], dict[str, str]]:
    """Stop all devices from another program: who has not confirmed it, and what each stop leaves."""
    with second_program(robot) as rig:
        devices = [one for one in rig.devices.values() if can_be_stopped(one)]
        stopping = stop_devices(robot.clock, "all", devices, is_foreign=True)
        robot.advance(3.0)
        assert stopping.is_over
        failed = stopping.error.devices if isinstance(stopping.error, NotStoppedError) else {}
        return failed, {one.name: one.stop_leaves for one in devices}


def stopping_drivers() -> list[Driver]:
    drivers = [load_driver(name) for name in list_drivers()]
    return [one for one in drivers if one.virtual and one.device.stop_motion is not Device.stop_motion]


@pytest.mark.parametrize("driver", stopping_drivers(), ids=lambda driver: driver.name)
def test_a_program_that_knows_nothing_stops_every_device(driver: Driver) -> None:
    """Its owner is gone after `enable`: the stop is confirmed, or the device is named."""
    made, _ = parse_robot(driver.example)
    assert made is not None
    with VirtualRobot(made, rate_hz=50) as robot:
        robot.advance(1.0)
        robot.rig.each("enable").wait(30)
        for host in robot.rig.hosts.values():
            host.close()
        failed, leaves = stop_from_outside(robot)
    assert set(failed) == set(leaves) & set(SILENT)


def servos() -> VirtualRobot:
    made, _ = parse_robot(load_driver("dynamixel").example)
    assert made is not None
    return VirtualRobot(made, rate_hz=50)


def test_a_servo_whose_file_says_hold_is_held_where_it_is() -> None:
    """A program that has never read its position asks for it first: the torque stays on, and the servo stands."""
    with servos() as robot:
        robot.advance(1.0)
        robot.rig.each("enable").wait(30)
        joint = next(iter(robot.devices["D1"].joints)).name
        robot[f"{joint}.position"].set(robot[f"{joint}.position"].value + 0.5)
        robot.advance(0.1)
        for host in robot.rig.hosts.values():
            host.close()
        failed, leaves = stop_from_outside(robot)
        assert (failed, leaves["D1"]) == ({}, "holds")
        twin = robot.twins["D1"]
        now = twin.world.joints[joint].position(robot.clock.now())
        robot.advance(1.0)
        assert twin.world.joints[joint].position(robot.clock.now()) == pytest.approx(now, abs=1e-3)


def test_an_end_that_breaks_keeps_no_other_robot_enabled(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two robots are left enabled, and the end of the first raises what nobody expected: the second has its end."""
    monkeypatch.setattr("aces_bus.robot.exits._open", {})
    ended: list[str] = []

    def breaks() -> None:
        raise RuntimeError("on purpose")

    with Loop() as loop:
        for name, end in (("first", breaks), ("second", lambda: ended.append("second"))):
            device = SimpleNamespace(name="JMC2", is_driven=True)
            robot = SimpleNamespace(name=name)
            rig = SimpleNamespace(clock=loop, robot=robot, devices={"JMC2": device})
            stop_at_exit(rig, end)  # type: ignore[arg-type]
        stop_forgotten()
    assert ended == ["second"]
    assert "aces-bus: first: not stopped: RuntimeError('on purpose')" in capsys.readouterr().err


def test_what_a_program_forgets_is_stopped_at_its_exit(
    bus: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """A run that has enabled and is not ended: its boards are off, which is said once."""
    run = run_real(hubo_leg(), [], buses=bus, transmit=True)
    run.open()
    run.do("enable", devices=["JMC2"])
    stop_forgotten()
    assert "left JMC2 enabled: stopping" in capsys.readouterr().err
    assert not run.rig.devices["JMC2"].is_driven
    assert run.rig.devices["JMC2"].axes[0].is_on is False  # type: ignore[attr-defined]
    stop_forgotten()
    assert capsys.readouterr().err == ""


def test_what_counts_as_not_following() -> None:
    """Revolute joints that are set by position have 0.2 rad and 1.5 s; a file says otherwise, or 0 for never."""
    text = ROBOT.replace("aliases = ['HIP2']", "following_error = 0.5")
    text = text.replace("aliases = ['ROLL2']", "following_error = 0")
    text = text.replace("'JMC1', channel = 0,", "'JMC1', channel = 0, type = 'prismatic',")
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    assert following_of(robot) == {"HIP": Following(0.5, 0.5)}
    idle = msgspec.structs.replace(robot.joints["HIP"], active=False)
    by_speed = msgspec.structs.replace(robot.joints["HIP"], command="speed")
    for joint in (idle, by_speed):
        assert following_of(msgspec.structs.replace(robot, joints={"HIP": joint})) == {}
    assert set(following_of(load_robot("hubo2plus")).values()) == {Following(0.2, 1.5)}


def test_virtual_components_tick_exactly() -> None:
    """Under the virtual clock each component ticks at its rate, the higher priority first where both are due."""
    clock = VirtualClock()
    seen: list[tuple[int, str]] = []
    tasks = VirtualTasks(clock)
    tasks.add("low", lambda now: seen.append((now, "low")), rate_hz=100)
    tasks.add("high", lambda now: seen.append((now, "high")), rate_hz=50, priority=5)
    with tasks:
        clock.advance(20_000_000)
    assert seen == [(0, "high"), (0, "low"), (10_000_000, "low"), (20_000_000, "high"), (20_000_000, "low")]
    clock.advance(100_000_000)
    assert len(seen) == 5
    assert [task.missed for task in tasks.tasks] == [0, 0]


def test_deadlines_that_passed_are_left_out_and_counted() -> None:
    """A step that lets more than its period pass misses deadlines, and goes on in step with the others."""
    clock = VirtualClock()
    ticks: list[int] = []

    def slow(now: int) -> None:
        ticks.append(now)
        if len(ticks) == 2:
            clock.advance(35_000_000)

    tasks = VirtualTasks(clock)
    task = tasks.add("slow", slow, rate_hz=100)
    with tasks:
        clock.advance(10_000_000)
        clock.advance(10_000_000)
    assert ticks == [0, 10_000_000, 50_000_000]
    assert (task.missed, task.overruns) == (3, 1)
    assert task.worst_busy_ns == 35_000_000


def test_an_error_ends_nothing() -> None:
    """What a step raises is counted and told with the component; it ticks on."""
    clock = VirtualClock()
    told: list[tuple[str, str]] = []
    tasks = VirtualTasks(clock, lambda task, error: told.append((task.name, str(error))))

    def bad(now: int) -> None:
        raise ValueError(f"at {now}")

    task = tasks.add("bad", bad, rate_hz=100)
    with tasks:
        clock.advance(10_000_000)
    assert told == [("bad", "at 0"), ("bad", "at 10000000")]
    assert task.failures == 2
    assert isinstance(task.last_error, ValueError)
