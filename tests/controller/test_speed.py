"""What a control cycle may cost, in calls of Python functions: the same on every machine, however busy it is.

How long that takes is measured by `python -m tests.bench control`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from aces_bus.controller import PID, Bounds, Guard, Phase, Player, StateMachine, Trajectory, Transition
from tests.counting import calls

JOINTS = [f"J{n}" for n in range(21)]
WAVE = Trajectory(
    JOINTS, np.sin(np.arange(3_000)[:, None] / 50 + np.arange(21)), rate_hz=50, interpolation="cubic"
)
PERIOD = 5_000_000


def most_calls(step: Callable[[int], object], count: int = 100) -> int:
    """The most calls that one of so many steps needs, once some have been made; the step itself is one."""
    for cycle in range(1, 6):
        step(cycle * PERIOD)
    return max(calls(lambda now=cycle * PERIOD: step(now)) for cycle in range(6, 6 + count)) - 1  # type: ignore[misc]


def test_a_player_calls_nothing_for_each_joint() -> None:
    """Between rows, by cubic interpolation, 21 joints cost no more calls than one."""
    player = Player("p", WAVE, rate_hz=200, approach=None)
    player.start(0)
    assert most_calls(player.step) <= 10
    assert player.mode == "running"


def test_a_guard_calls_one_function_for_each_joint() -> None:
    """Position, rate and acceleration of 21 joints, in motion."""
    player = Player("p", WAVE, rate_hz=200, approach=None)
    guard = Guard({joint: Bounds(-2, 2, 5.0, 500.0) for joint in JOINTS}, period_s=0.005)
    player.start(0)
    assert most_calls(lambda now: guard.apply(now, player.step(now))) <= 15 + len(JOINTS)
    assert guard.clips == {}


def test_a_pid_is_one_function() -> None:
    """With limits, anti-windup and a filtered derivative."""
    pid = PID(2.0, 1.0, 0.1, limits=(-1, 1), derivative_filter_s=0.01, setpoint=0.5)
    assert most_calls(lambda now: pid.update(1e-9 * (now % 7), 0.005)) <= 3


def test_a_transition_is_a_handful_of_calls() -> None:
    """A guard that is evaluated and a change of phase, each step."""
    machine = StateMachine(
        "m",
        rate_hz=200,
        memory={"n": 0},
        phases=[Phase("a"), Phase("b")],
        table=[Transition("a", "b", "n < 1"), Transition("b", "a", "n < 1")],
    )
    machine.start(0)
    assert most_calls(machine.step) <= 9
    assert machine.transitions > 100
