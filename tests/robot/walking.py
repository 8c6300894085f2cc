"""Legs that swing in virtual time, until something goes wrong a fifth of a second later: for tests of faults.

A leg of Hubo 2+ (four boards and a force sensor, on CAN) and one of MiniHubo (three servos, on a serial line).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from math import sin, tau
from typing import Any

from aces_bus import load_robot
from aces_bus.controller import Controller
from aces_bus.controller.base import known_value
from aces_bus.device import Robot
from aces_bus.robot import Ended, Runner, VirtualRobot, run_virtual
from aces_bus.robot.rig import simulate

MS = 1_000_000
CYCLE = 10 * MS
FAULT_AT = 200 * MS
HUBO = ("RHR", "RHP", "RKN", "RAP", "RAR")
MINI = ("RHP", "RKP", "RAP")


@cache
def hubo_leg() -> Robot:
    """Four boards and a force sensor on CAN."""
    return load_robot("hubo2plus").part(*HUBO, "RFFT")


@cache
def mini_leg() -> Robot:
    """Three servos on a serial line."""
    return load_robot("minihubo_2").part(*MINI)


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


class Look:
    """Looks at the set-points that left by the door, after each control cycle."""

    name, rate_hz, states = "look", 100.0, ()

    def __init__(self) -> None:
        self.run: Runner
        self.rows: list[tuple[int, int, dict[str, float]]] = []

    def bind(self, states: Mapping[str, Any]) -> None: ...

    def start(self, now: int) -> None: ...

    def step(self, now: int) -> None:
        left = {name: self.run.rig.door.given(name) for name in self.run.given}
        given = {name: value for name, value in left.items() if value is not None}
        self.rows.append((now, self.run.set_points, given))

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
    seconds: float = 0.8,
    more_loggers: tuple[Any, ...] = (),
    **options: Any,
) -> tuple[Ended, Walk, Look, Runner]:
    """Walk, have the fault happen, and see how it ends."""
    walk, look = walk or Walk(HUBO), Look()
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


def second_of(world: VirtualRobot, name: str) -> Any:
    """A second board of this number, which is on, with a cable of its own."""
    made = simulate(world.robot, world.ports("second"))
    for other in [one for one in made.buses["lower"].members if one != name]:
        made.buses["lower"].remove(other)
    board: Any = made.twins[name]
    board.reply_delay_ns += 3 * MS  # frames that begin together would destroy each other
    for channel in board.channels:
        channel.switch(world.clock.now(), driver=True, control=True)
    made.open()
    return board


def motors_are_off(run: Runner) -> bool:
    """Whether no board of the leg controls its motors any more."""
    boards = [twin for name, twin in run.world.twins.items() if name.startswith("JMC")]
    return not any(channel.control_on for twin in boards for channel in twin.channels)


def stopped_in_time(kind: str, ended: Ended, walk: Walk, look: Look) -> Any:
    """The event of this kind: its handler heard it within a cycle, set-points ended within another, the end names it."""
    heard, event = next(one for one in walk.told if one[1].kind == kind)
    assert 0 <= heard - event.instant <= CYCLE
    assert look.last_given() <= heard + CYCLE
    assert kind in ended.tripped["walk"]
    assert ended.reason == "every controller was stopped"
    return event
