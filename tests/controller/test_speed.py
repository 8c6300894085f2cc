"""What a control cycle may cost, as a ratio to plain calls in the same process, so that a busy machine does not count.

An empty call of a Python function takes some 0.04 µs where the promises were made: 25 of them are 1 µs.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from aces_bus.controller import PID, Bounds, Guard, Phase, Player, Row, StateMachine, Trajectory

JOINTS = [f"J{n}" for n in range(21)]
WAVE = Trajectory(
    JOINTS, np.sin(np.arange(3_000)[:, None] / 50 + np.arange(21)), rate_hz=50, interpolation="cubic"
)
PERIOD = 5_000_000


def empty(now: int) -> None:
    """What the others are measured by."""


def calls(step: Callable[[int], object], count: int = 400) -> float:
    """The cost of one call of `step` in empty calls: processor time, taken in turns, the least of ten rounds each."""
    best, cycle = [float("inf")] * 2, 0
    for _ in range(10):
        for i, one in enumerate((empty, step)):
            begin = time.process_time_ns()
            for _ in range(count):
                cycle += 1
                one(cycle * PERIOD)
            best[i] = min(best[i], (time.process_time_ns() - begin) / count)
    return best[1] / best[0]


def test_a_player_of_21_joints_costs_less_than_30_us() -> None:
    """Between rows, by cubic interpolation."""
    player = Player("p", WAVE, rate_hz=200, approach=None)
    player.start(0)
    assert calls(player.step) < 750
    assert player.mode == "running"


def test_with_its_guard_it_still_does() -> None:
    """Position, rate and acceleration of 21 joints, in motion."""
    player = Player("p", WAVE, rate_hz=200, approach=None)
    guard = Guard({joint: Bounds(-2, 2, 5.0, 500.0) for joint in JOINTS}, period_s=0.005)
    player.start(0)
    assert calls(lambda now: guard.apply(now, player.step(now))) < 1_000
    assert guard.clips == {}


def test_a_pid_costs_less_than_3_us() -> None:
    """With limits, anti-windup and a filtered derivative."""
    pid = PID(2.0, 1.0, 0.1, limits=(-1, 1), derivative_filter_s=0.01, setpoint=0.5)
    assert calls(lambda now: pid.update(1e-9 * (now % 7), 0.005)) < 75


def test_a_transition_costs_less_than_1_us() -> None:
    """A guard that is evaluated and a change of phase, each step."""
    machine = StateMachine(
        "m",
        rate_hz=200,
        memory={"n": 0},
        phases=[Phase("a"), Phase("b")],
        table=[Row("a", "b", "n < 1"), Row("b", "a", "n < 1")],
    )
    machine.start(0)
    assert calls(machine.step, 2_000) < 25
    assert machine.transitions > 10_000
