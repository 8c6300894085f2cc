"""Faults while walking, of programs and clocks: controllers, listeners, logs, time; and the same on threads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import pytest

from aces_bus.controller import IGNORE, Controller, stop
from aces_bus.controller.base import known_value
from aces_bus.hardware import CanGate
from aces_bus.hardware.ports import port_of
from aces_bus.robot import Runner, VirtualRobot, run_real, run_virtual
from aces_bus.robot.rig import simulate
from aces_bus.runtime import VirtualClock
from aces_bus.runtime.loop import Loop
from tests.device.fan import ROBOT, drivers, robot_of
from tests.robot.walking import (
    HUBO,
    MS,
    Look,
    Walk,
    hubo_leg,
    motors_are_off,
    stopped_in_time,
    walk_into,
)

# ---------------------------------------------------------------------- programs


@pytest.mark.parametrize("error", [ZeroDivisionError("off the rails"), SystemExit("off the rails")])
def test_a_controller_that_raises(error: BaseException) -> None:
    """What a controller raises while walking is told in the same cycle, and stops its motors; so is that it exits."""

    class Bad(Walk):
        def step(self, now_ns: int) -> Mapping[str, float]:
            if self.seconds(now_ns) > 0.2:
                raise error
            return super().step(now_ns)

    ended, _, look, run = walk_into(lambda run: None, walk=Bad(HUBO))
    assert f"raised: {type(error).__name__}: off the rails" in ended.tripped["walk"]
    assert look.last_given() - look.rows[0][0] == 200 * MS
    assert ended.seconds == pytest.approx(0.21, abs=0.002)
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
    assert ended.tripped["walk"].startswith("walk: dead-man: no set-points for 1")
    assert ended.seconds < 0.6
    assert motors_are_off(run)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"LHP": 0.1}, "named 'LHP'"),
        ({"RHP.current": 1.0}, "'RHP.current' is read-only"),
        ([0.1, 0.2], "it gave a list; set-points are a dict"),
        (None, "no set-points for 110 ms"),
    ],
)
def test_set_points_that_are_none(given: Any, said: str) -> None:
    """Set-points for what is not there, or cannot be set, and things that are not set-points at all, stop motion."""

    class Confused(Walk):
        def step(self, now_ns: int) -> Any:
            return given if self.seconds(now_ns) > 0.2 else super().step(now_ns)

    ended, _, look, run = walk_into(lambda run: None, walk=Confused(HUBO))
    assert said in ended.tripped["walk"]
    assert look.rows[-1][0] - look.rows[0][0] <= 320 * MS
    assert motors_are_off(run)


def test_numbers_that_are_none() -> None:
    """NaN and infinity now and then go nowhere: the joint stays where it was sent, the others go on, and it is told."""

    class Confused(Walk):
        def step(self, now_ns: int) -> Mapping[str, float]:
            self.steps += 1
            bad = self.seconds(now_ns) > 0.2 and self.steps % 5
            return {**super().step(now_ns), **({"RHP": float("nan"), "RKN": float("inf")} if bad else {})}

        steps = 0

    ended, _, look, run = walk_into(lambda run: None, walk=Confused(HUBO), seconds=0.7)
    assert ended.tripped == {}
    kept = [given for now, _, given in look.rows if now - look.rows[0][0] > 210 * MS]
    assert 1 < len({given["RHP"] for given in kept}) == len({given["RKN"] for given in kept}) < 30
    assert len({given["RAP"] for given in kept}) > 40
    assert {event.kind for event in run.events} <= {"not finite", "clipped"}


def test_nothing_but_numbers_that_are_none() -> None:
    """Five in a row for one joint stop motion, with the joint's name, whatever the others get."""

    class Lost(Walk):
        def step(self, now_ns: int) -> Mapping[str, float]:
            given = super().step(now_ns)
            return {**given, "RHP": float("nan")} if self.seconds(now_ns) > 0.2 else given

    ended, _, look, run = walk_into(lambda run: None, walk=Lost(HUBO))
    assert ended.tripped["walk"] == "walk: not finite: RHP: 5 set-points in a row were not finite numbers"
    assert look.rows[-1][0] - look.rows[0][0] <= 260 * MS
    assert motors_are_off(run)


def test_a_listener_that_raises() -> None:
    """A program that listens to the run and raises keeps nobody else from being told, and nothing from being stopped."""

    def bad(event: Any) -> None:
        raise RuntimeError("listener")

    def fault(run: Runner) -> None:
        run.handlers.append(bad)
        run.rig.on_event(bad)
        run.world.twins["JMC1"].fault("silent")

    ended, walk, look, run = walk_into(fault)
    stopped_in_time("silent", ended, walk, look)
    assert motors_are_off(run)
    assert any("listener" in str(error) for error in run.rig.events.failures)


def test_one_of_two_controllers_raises() -> None:
    """The other one goes on: only what the bad one drives is stopped."""

    class Arm(Controller):
        def step(self, now_ns: int) -> Mapping[str, float]:
            if self.seconds(now_ns) > 0.2:
                raise ValueError("arm")
            return {"RAR": 0.0}

    walk = Walk(("RHP", "RKN"))
    walk.clock = VirtualClock()
    run = run_virtual(hubo_leg(), [walk, Arm("arm", rate_hz=100, writes=["RAR"])], rate_hz=100)
    with run:
        run.do("enable")
        run.start()
        run.world.advance(0.6)
        twins = run.world.twins
        assert not any(channel.control_on for channel in twins["JMC3"].channels)
        assert all(channel.control_on for name in ("JMC1", "JMC2") for channel in twins[name].channels)
        ended = run.stop()
    assert set(ended.tripped) == {"arm"}


class FullDisk(Look):
    """A logger whose disk is full from its 51st row on."""

    name = "log"

    def step(self, now: int) -> None:
        self.rows.append((now, 0, {}))
        if len(self.rows) > 50:
            raise OSError(28, "no space left on device")


def test_a_full_disk() -> None:
    """A logger that fails is told by name, once in a while; control goes on."""
    ended, walk, look, run = walk_into(lambda run: None, seconds=1.2, more_loggers=(FullDisk(),))
    heard, event = walk.told[0]
    assert (event.kind, event.source) == ("log-failed", "log")
    assert "no space" in event.detail
    assert heard == event.instant == look.rows[50][0]
    assert ended.tripped == {}
    assert look.last_given() == look.rows[-1][0]
    assert len(walk.told) <= 3  # not a hundred times a second
    assert sum(task.failures for task in run.tasks.tasks) > 60


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

    def call_at(self, instant: int, action: Callable[[], object]) -> Any:
        return super().call_at(instant - self.ahead, action)

    def call_in(self, delay: int, action: Callable[[], object]) -> Any:
        return super().call_at(self._now + delay, action)

    def call_soon(self, action: Callable[[], object]) -> None:
        super().post(self._now, action)

    def post(self, instant: int, action: Callable[[], object]) -> None:
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


def largest_step(look: Look) -> float:
    """The largest change of a set-point from one cycle to the next (rad)."""
    rows = [given for _, _, given in look.rows if given]
    return max(abs(b[name] - a[name]) for a, b in pairwise(rows) for name in a if name in b)


@pytest.mark.parametrize("seconds", [0.05, 0.37, 2.0, 10.0])
def test_the_clock_jumps(seconds: float) -> None:
    """However far the clock jumps while walking, no set-point does; the run goes on, or stops and says why."""
    robot = VirtualRobot(hubo_leg(), rate_hz=100, clock=JumpingClock())
    ended, _, look, run = walk_into(jump(seconds), robot, seconds=seconds + 0.5)
    fastest = max(joint.max_speed or 0.0 for joint in robot.robot.joints.values())
    assert largest_step(look) <= fastest * 0.02 + 1e-9
    if ended.tripped:
        assert look.last_given() < look.rows[-1][0]
        assert motors_are_off(run)
        assert any(word in ended.tripped["walk"] for word in ("no set-points for", "silent"))
    else:
        assert ended.seconds == pytest.approx(seconds + 0.5)
        assert abs(run.states["RHP"].last - look.rows[-1][2]["RHP"]) < 0.2


# ---------------------------------------------------------------------- in real time


@pytest.mark.slow
@pytest.mark.parametrize("is_bus", [False, True])
def test_the_same_on_threads(is_bus: bool) -> None:
    """On a real bus and threads, a silent device and a closed bus stop motion too, tell the handler, and end the run."""
    speeds = ("A.left", "B.left")
    told: list[Any] = []

    class Blow(Controller):
        def step(self, now_ns: int) -> Mapping[str, float]:
            return dict.fromkeys(speeds, 100.0)

        def handle(self, event: Any) -> None:
            told.append((run.clock.now(), event))

    robot = robot_of(ROBOT)
    options = {"interface": "aces", "channel": f"test-faults-{is_bus}", "bitrate": 500_000}
    with Loop() as loop, simulate(robot, {"line": port_of(CanGate(options), loop)}, load=drivers) as twins:
        run = run_real(
            robot,
            [Blow("blow", rate_hz=50, writes=speeds)],
            buses={"line": options},
            transmit=True,
            load=drivers,
        )
        is_broken = False

        def break_it() -> bool:
            nonlocal is_broken
            if run.seconds > 0.2 and not is_broken:
                is_broken = True
                if is_bus:
                    twins.buses["line"].port.close()
                else:
                    twins["A"].fault("silent")
            return False

        ended = run.run(60.0, until=break_it)
        # Threads run in real time: without an acknowledgement the controller's own state, or on a slow machine frames that
        # are too old, may be noticed first.
        kinds = ("silent", "error-passive", "not sent")
        assert any(kind in ended.tripped["blow"] for kind in kinds), ended.tripped
        heard, event = next(one for one in told if one[1].kind in kinds)
        assert heard - event.instant >= 0
        if not is_bus:
            assert loop.wait(lambda: twins["B"].left == 0, 20_000 * MS)  # type: ignore[attr-defined]
