"""Faults while walking: what was declared happens, the reason reaches the handler in a cycle, the run's end names it.

A leg of Hubo 2+ (four boards and a force sensor, on CAN) and a leg of MiniHubo (six servos, on a serial line) swing a foot;
half a second later something goes wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from itertools import pairwise
from math import sin, tau
from typing import Any

import pytest
from msgspec.structs import replace

from aces_bus.assembly import Ended, Runner, VirtualRobot, run_virtual
from aces_bus.controller import IGNORE, Controller, degrade, stop
from aces_bus.controller.base import known_value
from aces_bus.device import Robot, simulate
from aces_bus.frame import Frame
from aces_bus.hardware import Faults
from aces_bus.hardware.serial_wire import Noise
from aces_bus.runtime import VirtualClock
from aces_devices.robots import load_robot

MS = 1_000_000
CYCLE = 10 * MS
FAULT_AT = 500 * MS
HUBO = ("RHR", "RHP", "RKN", "RAP", "RAR")
MINI = ("RHP", "RKP", "RAP")


@cache
def leg(name: str, *devices: str) -> Robot:
    """A robot of which only these devices are there."""
    robot = load_robot(name)
    there = set(devices) or {robot.joints[joint].device for joint in MINI}
    return replace(
        robot,
        devices={key: replace(one, active=key in there) for key, one in robot.devices.items()},
        joints={key: replace(one, active=one.device in there) for key, one in robot.joints.items()},
        sensors={key: replace(one, active=one.device in there) for key, one in robot.sensors.items()},
    )


def hubo_leg() -> Robot:
    return leg("hubo2plus", "JMC0", "JMC1", "JMC2", "JMC3", "FT_RF")


class Walk(Controller):
    """Swings a leg, notes what it is told and when, and gives way to the foot's moment as far as `compliance` says."""

    def __init__(self, joints: tuple[str, ...], sensor: str | None = None) -> None:
        self.joints, self.sensor, self.compliance = joints, sensor, 1e-4
        self.told: list[tuple[int, Any]] = []
        self.last_step = 0
        super().__init__("walk", rate_hz=100, states=[sensor] if sensor else [], writes=joints)
        self.clock: Any = None

    def step(self, now_ns: int) -> Mapping[str, float]:
        self.last_step = now_ns
        swing = 0.2 * sin(tau * self.seconds(now_ns))
        given = dict.fromkeys(self.joints, 0.2 + swing)
        if self.sensor is not None:
            given[self.joints[-1]] += self.compliance * (known_value(self.bound[self.sensor]) or 0.0)
        return given

    def handle(self, event: Any) -> None:
        self.told.append((self.clock.now(), event))

    def kinds(self) -> list[str]:
        return [event.kind for _, event in self.told]


class Set:
    """Looks at the set-points that went down, after each control cycle."""

    name, rate_hz, states = "look", 100.0, ()

    def __init__(self) -> None:
        self.run: Runner
        self.rows: list[tuple[int, int, dict[str, float]]] = []

    def bind(self, states: Mapping[str, Any]) -> None: ...

    def start(self, now: int) -> None: ...

    def step(self, now: int) -> None:
        self.rows.append((now, self.run.set_points, dict(self.run.given)))

    def stop(self, now: int) -> None: ...

    def last_given(self) -> int:
        """When the last set-points went down (ns)."""
        return max(
            now
            for (now, count, _), (_, before, _) in zip(self.rows[1:], self.rows, strict=False)
            if count > before
        )


def walk_into(
    fault: Callable[[Runner], Any],
    robot: Robot | VirtualRobot | None = None,
    walk: Walk | None = None,
    *,
    seconds: float = 2.0,
    more_loggers: tuple[Any, ...] = (),
    **options: Any,
) -> tuple[Ended, Walk, Set, Runner]:
    """Walk, have the fault happen, and see how it ends."""
    walk, look = walk or Walk(HUBO), Set()
    run = run_virtual(
        robot if robot is not None else hubo_leg(),
        [walk],
        rate_hz=100,
        loggers=[look, *more_loggers],
        **options,
    )
    look.run, walk.clock = run, run.clock
    with run:
        run.do("enable")
        run.clock.call_in(FAULT_AT, lambda: fault(run))
        ended = run.run(seconds)
    return ended, walk, look, run


def motors_are_off(run: Runner) -> bool:
    """Whether no board of the leg controls its motors any more."""
    boards = [twin for name, twin in run.world.twins.items() if name.startswith("JMC")]
    return not any(channel.control_on for twin in boards for channel in twin.channels)


def stopped_in_time(kind: str, ended: Ended, walk: Walk, look: Set) -> Any:
    """The event of this kind: its handler heard it within a cycle, set-points ended within another, the end names it."""
    heard, event = next(one for one in walk.told if one[1].kind == kind)
    assert 0 <= heard - event.instant <= CYCLE
    assert look.last_given() <= heard + CYCLE
    assert kind in ended.tripped["walk"]
    assert ended.reason == "every controller was stopped"
    return event


# ---------------------------------------------------------------------- boards


def test_nothing_goes_wrong() -> None:
    """Without a fault the leg swings to the end of its time, and is stopped then."""
    ended, walk, look, run = walk_into(lambda run: None)
    assert (ended.reason, ended.tripped, ended.seconds) == ("", {}, 2.0)
    assert walk.told == []
    assert len(look.rows) == 201
    assert motors_are_off(run)


def test_a_silent_board() -> None:
    """A board that does not answer any more stops motion: three polls, then at once; the others are switched off."""
    ended, walk, look, run = walk_into(lambda run: run.world.twins["JMC1"].fault("silent"))
    event = stopped_in_time("silent", ended, walk, look)
    assert event.source == "JMC1"
    assert "JMC1: silent" in ended.tripped["walk"]
    assert 0.5 < ended.seconds < 0.8
    assert motors_are_off(run)


def test_a_silent_board_that_was_declared_to_matter_less() -> None:
    """Declared as a degradation, the same silence is told, named, and walked on with."""
    ended, walk, look, run = walk_into(
        lambda run: run.world.twins["FT_RF"].fault("silent"),
        walk=Walk(HUBO, "RFFT.mx"),
        reactions={"silent": (degrade("no compliance", sources=["FT_RF"]), stop())},
    )
    assert "silent" in walk.kinds()
    assert ended.tripped == {}
    assert run.supervisors[0].degraded == {"no compliance": "FT_RF: silent"}
    assert look.last_given() == look.rows[-1][0]
    assert run.states["RFFT.mx"][0] != 0.0  # unknown


def test_a_board_that_reboots() -> None:
    """A board that has forgotten that it was on is noticed, and motion stops: it would not follow."""
    ended, walk, look, run = walk_into(lambda run: run.world.twins["JMC2"].reboot(), seconds=4.0)
    event = stopped_in_time("rebooted", ended, walk, look)
    assert event.source == "JMC2"
    assert ended.seconds < 1.5
    assert motors_are_off(run)


def test_two_boards_of_one_number() -> None:
    """A second board of the same number is plugged in: two answers, named, and motion stops."""
    ended, walk, look, _ = walk_into(lambda run: run.world.twins["JMC3"].fault("twice"))
    event = stopped_in_time("two answers", ended, walk, look)
    assert event.source == "JMC3"
    assert "two devices" in event.detail


def test_a_saturated_force_sensor() -> None:
    """Beyond its range a force sensor says nothing about the ground: compliance is given up, walking goes on."""
    walk = Walk(HUBO, "RFFT.mx")

    def stiff(event: Any) -> None:
        walk.compliance = 0.0

    def fall_on(run: Runner) -> None:
        run.world.twins["FT_RF"].feed = lambda now: (400.0, 0.0, 4000.0)

    ended, _, look, run = walk_into(
        fall_on, walk=walk, reactions={"alarm": (degrade("no compliance", stiff, sources=["FT_RF"]), stop())}
    )
    heard, event = next(one for one in walk.told if one[1].kind == "alarm")
    assert event.detail == "saturated"
    assert 0 <= heard - event.instant <= CYCLE
    assert ended.tripped == {}
    assert walk.compliance == 0.0
    assert run.supervisors[0].degraded == {"no compliance": "FT_RF: alarm"}
    # The moment that was measured before has moved the ankle, and moves it no more.
    after = [given for now, _, given in look.rows if now > heard + CYCLE]
    assert all(given["RAR"] == pytest.approx(given["RHR"]) for given in after)


def test_a_saturated_force_sensor_stops_by_default() -> None:
    """Where nobody has declared anything, an alarm stops motion."""

    def fall_on(run: Runner) -> None:
        run.world.twins["FT_RF"].feed = lambda now: (400.0, 0.0, 4000.0)

    ended, walk, look, run = walk_into(fall_on)
    assert stopped_in_time("alarm", ended, walk, look).source == "FT_RF"
    assert "saturated" in ended.tripped["walk"]
    assert motors_are_off(run)


# ---------------------------------------------------------------------- buses


def test_bus_off() -> None:
    """The bus goes off: motion stops, with the reason at the handler at once; the run closes what it can."""

    def errors(run: Runner) -> None:
        node = run.rig.hosts["lower"].port.node  # type: ignore[attr-defined]
        for _ in range(40):
            node.count_errors(8, 0, Frame(1))

    ended, walk, look, _ = walk_into(errors, reactions={"error-passive": IGNORE})
    event = stopped_in_time("bus-off", ended, walk, look)
    assert event.source == "lower"
    assert ended.seconds == pytest.approx(0.5, abs=0.02)


def babble(run: Runner) -> None:
    """Words that mean nothing: of a board, but too short; of nobody; of everybody."""
    twins = next(iter(run.world.simulation.buses.values()))
    for number in range(50):
        run.clock.call_in(
            number * 3 * MS,
            lambda number=number: twins.send(Frame(0x061, b"\x01\x02\x03"[: number % 3])),  # type: ignore[misc]
        )
        run.clock.call_in(
            number * 3 * MS + MS,
            lambda number=number: twins.send(Frame(0x7F0 - number, b"?")),  # type: ignore[misc]
        )


def test_garbage_on_the_bus() -> None:
    """Frames that are none of a board's messages stop motion; each is counted, and nothing is taken for an angle."""
    ended, walk, look, run = walk_into(babble)
    event = stopped_in_time("malformed", ended, walk, look)
    assert event.source == "JMC1"
    assert motors_are_off(run)


def test_garbage_that_was_declared_harmless() -> None:
    """Declared harmless, garbage is counted, and the leg swings on as if nothing had been heard."""
    plain = walk_into(lambda run: None)[2]
    ended, walk, look, run = walk_into(babble, reactions={"malformed": IGNORE, "stranger": IGNORE})
    assert ended.tripped == {}
    assert "malformed" in walk.kinds()
    assert sum(run.rig.hosts["lower"].unknown.values()) == 100
    assert [given for _, _, given in look.rows] == [given for _, _, given in plain.rows]
    assert abs(run.states["RHP"].last - look.rows[-1][2]["RHP"]) < 0.1


def test_a_bus_that_loses_frames() -> None:
    """Frames that are lost, and frames that are destroyed and sent again, cost a poll each, and no step."""
    lossy = VirtualRobot(hubo_leg(), rate_hz=100, faults={"lower": Faults(seed=1, drop=0.02, corrupt=0.02)})
    ended, walk, look, run = walk_into(lambda run: None, lossy)
    assert ended.tripped == {}
    assert walk.told == []
    assert run.rig.hosts["lower"].counts.missed > 0
    assert abs(run.states["RHP"].last - look.rows[-1][2]["RHP"]) < 0.1


@pytest.mark.parametrize("is_serial", [False, True])
def test_a_cable_that_is_pulled(is_serial: bool) -> None:
    """Behind a pulled cable all is silent: the first device that is noticed stops motion, and nothing hangs at the end."""

    def pull(run: Runner) -> None:
        port: Any = next(iter(run.rig.hosts.values())).port
        port.node.is_connected = False

    robot, joints = (leg("minihubo_2"), MINI) if is_serial else (hubo_leg(), HUBO)
    ended, walk, look, run = walk_into(pull, robot, Walk(joints))
    kind = walk.kinds()[0]
    assert kind in ("silent", "not sent", "error-passive", "bus-off")
    stopped_in_time(kind, ended, walk, look)
    assert ended.seconds < 0.8
    assert {name.partition(".")[0] for name in run.unknown_states()} >= set(joints)
    assert len(ended.failed) == (3 if is_serial else 0)  # boards are told without an answer


def test_a_servo_that_falls_silent() -> None:
    """On a serial line, where all others wait for it, a silent servo stops motion as well."""
    ended, walk, look, _ = walk_into(
        lambda run: run.world.twins["S96"].fault("silent"), leg("minihubo_2"), Walk(MINI)
    )
    event = stopped_in_time("silent", ended, walk, look)
    assert event.source == "S96"
    assert ended.seconds < 0.8
    (text,) = ended.failed  # who does not answer cannot be told to stop
    assert text.startswith("stop: servos S96: no answer")


def test_a_servo_that_reboots() -> None:
    """A servo whose torque is off again is found when its health is read, once a second; motion stops, and names it."""
    ended, walk, look, _ = walk_into(
        lambda run: run.world.twins["S96"].reboot(), leg("minihubo_2"), Walk(MINI), seconds=4.0
    )
    assert stopped_in_time("rebooted", ended, walk, look).source == "S96"
    assert ended.seconds < 1.7


def test_two_servos_of_one_number() -> None:
    """Two servos of one id answer into each other; whatever is heard of it, motion stops and the servo is named."""

    def second(run: Runner) -> None:
        robot: VirtualRobot = run.world
        other = simulate(leg("minihubo_2"), robot.ports("second"))
        for name in ("S83", "S78"):
            other.buses["servos"].remove(name)
        other.open()

    ended, walk, look, _ = walk_into(second, leg("minihubo_2"), Walk(MINI))
    kind = walk.kinds()[0]
    assert kind in ("two answers", "malformed", "silent")
    assert stopped_in_time(kind, ended, walk, look).source == "S96"


@pytest.mark.parametrize("is_declared", [False, True])
def test_noise_on_a_serial_line(is_declared: bool) -> None:
    """A line with noise says which servo it hit and stops motion; declared harmless, the servos follow all the same."""
    line = VirtualRobot(leg("minihubo_2"), rate_hz=100, noise={"servos": Noise(seed=1, flip=0.0005)})
    calm = dict.fromkeys(("malformed", "no reply", "two answers", "alarm"), IGNORE)
    ended, walk, look, run = walk_into(
        lambda run: None, line, Walk(MINI), reactions=calm if is_declared else {}
    )
    if is_declared:
        assert ended.tripped == {}
        assert "malformed" in walk.kinds()
        assert abs(run.states["RKP"].last - look.rows[-1][2]["RKP"]) < 0.15
    else:
        assert stopped_in_time(walk.kinds()[0], ended, walk, look).source in run.rig.devices


# ---------------------------------------------------------------------- programs


def test_a_controller_that_raises() -> None:
    """What a controller raises while walking is told in the same cycle, and stops its motors."""

    class Bad(Walk):
        def step(self, now_ns: int) -> Mapping[str, float]:
            if self.seconds(now_ns) > 0.5:
                raise ZeroDivisionError("off the rails")
            return super().step(now_ns)

    ended, _, look, run = walk_into(lambda run: None, walk=Bad(HUBO))
    assert "ZeroDivisionError: off the rails" in ended.tripped["walk"]
    assert look.last_given() - look.rows[0][0] == 500 * MS
    assert ended.seconds == pytest.approx(0.51, abs=0.002)
    assert motors_are_off(run)


def test_a_controller_that_waits_for_ever() -> None:
    """Who needs what is not known any more gives nothing; the dead-man below stops motion, with the reason."""

    class Follow(Walk):
        def step(self, now_ns: int) -> Mapping[str, float]:
            return {} if known_value(self.bound["RFFT.mx"]) is None else super().step(now_ns)

    ended, _, _, run = walk_into(
        lambda run: run.world.twins["FT_RF"].fault("silent"),
        walk=Follow(HUBO, "RFFT.mx"),
        reactions={"silent": IGNORE},
    )
    assert ended.tripped["walk"].startswith("no set-points for 1")
    assert ended.seconds < 0.9
    assert motors_are_off(run)


def test_one_of_two_controllers_raises() -> None:
    """The other one goes on: only what the bad one drives is stopped."""

    class Arm(Controller):
        def step(self, now_ns: int) -> Mapping[str, float]:
            if self.seconds(now_ns) > 0.5:
                raise ValueError("arm")
            return {"RAR": 0.0}

    walk = Walk(("RHP", "RKN"))
    walk.clock = VirtualClock()
    run = run_virtual(hubo_leg(), [walk, Arm("arm", rate_hz=100, writes=["RAR"])], rate_hz=100)
    with run:
        run.do("enable")
        run.start()
        run.world.advance(1.5)
        twins = run.world.twins
        assert not any(channel.control_on for channel in twins["JMC3"].channels)
        assert all(channel.control_on for name in ("JMC1", "JMC2") for channel in twins[name].channels)
        ended = run.stop()
    assert set(ended.tripped) == {"arm"}


class FullDisk(Set):
    """A logger whose disk is full from its 51st row on."""

    name = "log"

    def step(self, now: int) -> None:
        self.rows.append((now, 0, {}))
        if len(self.rows) > 50:
            raise OSError(28, "no space left on device")


def test_a_full_disk() -> None:
    """A logger that fails is told by name, once in a while; control goes on."""
    ended, walk, look, run = walk_into(lambda run: None, more_loggers=(FullDisk(),))
    heard, event = walk.told[0]
    assert (event.kind, event.source) == ("log-failed", "log")
    assert "no space" in event.detail
    assert heard == event.instant == look.rows[50][0]
    assert ended.tripped == {}
    assert look.last_given() == look.rows[-1][0]
    assert len(walk.told) <= 3  # not a hundred times a second
    assert sum(task.failures for task in run.tasks.tasks) > 100


def test_a_full_disk_that_matters() -> None:
    """Who declares that a run without a log is none has it stopped, by name."""
    ended, walk, look, run = walk_into(
        lambda run: None, more_loggers=(FullDisk(),), reactions={"log-failed": stop("disable")}
    )
    stopped_in_time("log-failed", ended, walk, look)
    assert motors_are_off(run)


# ---------------------------------------------------------------------- time


class JumpingClock(VirtualClock):
    """A clock that can be set on: what is planned is as far away as before."""

    ahead = 0

    def now(self) -> int:
        return self._now + self.ahead

    def call_at(self, instant: int, action: Callable[[], None]) -> Any:
        return super().call_at(instant - self.ahead, action)

    def call_in(self, delay: int, action: Callable[[], None]) -> Any:
        return super().call_at(self._now + delay, action)

    def call_soon(self, action: Callable[[], None]) -> None:
        super().post(self._now, action)

    def post(self, instant: int, action: Callable[[], None]) -> None:
        super().post(instant - self.ahead, action)

    def advance_to(self, instant: int) -> None:
        super().advance_to(max(self._now, instant - self.ahead))

    @property
    def next_event(self) -> int | None:
        found = super().next_event
        return None if found is None else found + self.ahead


def jump(seconds: float) -> Callable[[Runner], None]:
    def fault(run: Runner) -> None:
        run.clock.ahead += round(seconds * 1e9)  # type: ignore[attr-defined]

    return fault


def largest_step(look: Set) -> float:
    """The largest change of a set-point from one cycle to the next (rad)."""
    rows = [given for _, _, given in look.rows if given]
    return max(abs(b[name] - a[name]) for a, b in pairwise(rows) for name in a)


@pytest.mark.parametrize("seconds", [0.05, 0.37, 2.0, 60.0])
def test_the_clock_jumps(seconds: float) -> None:
    """However far the clock jumps while walking, no set-point does; the run goes on, or stops and says why."""
    robot = VirtualRobot(hubo_leg(), rate_hz=100, clock=JumpingClock())
    ended, _, look, run = walk_into(jump(seconds), robot, seconds=seconds + 1.5)
    fastest = max(joint.max_speed or 0.0 for joint in robot.robot.joints.values())
    assert largest_step(look) <= fastest * 0.02 + 1e-9
    if ended.tripped:
        assert look.last_given() < look.rows[-1][0]
        assert motors_are_off(run)
        assert any(word in ended.tripped["walk"] for word in ("no set-points for", "silent"))
    else:
        assert ended.seconds == pytest.approx(seconds + 1.5)
        assert abs(run.states["RHP"].last - look.rows[-1][2]["RHP"]) < 0.2
