"""The simulated RX servo's shaft: speed, compliance, torque; where it is does not depend on who asks."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus.device.single_motor import JointScale
from aces_devices.robotis_rx.driver import STEP
from aces_devices.robotis_rx.motion import FREE, PER_SPEED, REST, STEPS, TURN, ShaftMotion

SECOND = 1_000_000_000


def shaft(
    at: float, goal: float = 900.0, *, jammed: bool = False, driven: bool = True, **more: Any
) -> ShaftMotion:
    """A shaft on its way; `more` are the registers of its controller."""
    twin: Any = SimpleNamespace(clock=SimpleNamespace(now=lambda: 0), joints=())
    made = ShaftMotion(twin, JointScale(1.0 / STEP), at)
    made.duty = more.pop("duty", None)
    made.law.goal, made.is_driven, made.is_jammed = goal, driven, jammed
    for name, value in more.items():
        setattr(made.law, name, value)
    made.apply(0)
    return made


def driven(**more: Any) -> ShaftMotion:
    """On its way from count 100 to 900."""
    return shaft(100.0, **more)


def test_it_runs_at_its_moving_speed() -> None:
    """0.111 rpm a count: at 90 counts 9.99 rpm, which are 204.4 counts a second, but for friction."""
    motion = driven(speed=90)
    assert motion.position(SECOND) - 100 == pytest.approx(90 * 0.111 * 6 / (300 / 1023), rel=0.02)
    assert motion.speed_at(SECOND) == pytest.approx(204.4, rel=0.02)
    assert motion.is_moving(SECOND)
    assert motion.position(60 * SECOND) == pytest.approx(900, abs=REST + 0.5)
    assert not motion.is_moving(60 * SECOND)
    assert motion.drive_at(60 * SECOND) == 0


def test_without_a_speed_it_runs_as_fast_as_its_torque_lets_it() -> None:
    """Half of the torque, half of the speed; none, none; and no torque at all when it is off."""
    assert driven().speed_at(SECOND // 4) == pytest.approx(FREE * PER_SPEED, rel=0.03)
    assert driven(limit=512).speed_at(SECOND // 2) == pytest.approx(FREE * PER_SPEED * 512 / 1023, rel=0.03)
    for still in (driven(limit=0), driven(jammed=True), driven(driven=False)):
        assert still.position(10 * SECOND) == 100
        assert still.speed_at(10 * SECOND) == 0
    blocked = driven(jammed=True)
    assert blocked.drive_at(SECOND) == 1
    assert blocked.pushes
    assert shaft(900.0, 100.0, jammed=True, limit=300).drive_at(SECOND) == pytest.approx(-300 / 1023)


@pytest.mark.parametrize(
    ("slope", "step"), [(1, 4), (7, 4), (8, 8), (32, 32), (63, 32), (253, 128), (254, 254)]
)
def test_slopes_act_in_steps(slope: int, step: int) -> None:
    """4, 8, 16, 32, 64, 128, 254."""
    assert STEPS[slope] == step


def test_compliance_is_felt_near_the_goal() -> None:
    """A gentle slope slows it down earlier; a margin stops it earlier, on the side that it comes from."""
    steep, gentle = driven(slope=(4, 4)), driven(slope=(254, 128))
    late = round(0.66 * SECOND)
    assert gentle.position(late) < steep.position(late)
    assert driven(margin=(0, 50)).position(60 * SECOND) == pytest.approx(900 - 50, abs=REST + 1)
    assert driven(margin=(50, 0)).position(60 * SECOND) == pytest.approx(900, abs=REST + 1)
    assert shaft(900.0, 100.0, margin=(50, 0)).position(60 * SECOND) == pytest.approx(100 + 50, abs=REST + 1)


def test_endless_turn_goes_round() -> None:
    """The duty's share of the greatest speed, either way, at most the torque limit; a turn is 1227.6 counts."""
    motion = shaft(0.0, duty=-0.5)
    assert motion.speed_at(SECOND) == pytest.approx(-0.5 * FREE * PER_SPEED, rel=0.03)
    assert 0 <= motion.position(SECOND) < TURN
    assert shaft(0.0, duty=1.0, limit=512).drive_at(0) == 512 / 1023
    assert not shaft(0.0, duty=0.0).is_moving(0)


def test_it_gets_warm_where_it_pushes() -> None:
    """A blocked servo's winding has its stall current, which heats it; a resting one stays as it is."""
    pushing, resting = driven(jammed=True), driven(driven=False)
    for motion in (pushing, resting):
        motion.settle(5 * SECOND)
    assert pushing.warming > 2
    assert resting.warming == 0


@settings(max_examples=30)
@given(
    st.floats(0, 1023),
    st.floats(0, 1023),
    st.integers(0, 1023),
    st.integers(0, 1023),
    st.integers(32, 1023),
    st.integers(0, 254),
    st.integers(1, 254),
    st.lists(st.integers(0, 1 * SECOND), max_size=5),
)
def test_asking_changes_nothing(
    at: float, goal: float, speed: int, limit: int, punch: int, margin: int, slope: int, asked: list[int]
) -> None:
    """It is where it would be had nobody looked."""
    registers: dict[str, Any] = {
        "speed": speed,
        "limit": limit,
        "punch": punch,
        "margin": (margin,) * 2,
        "slope": (slope,) * 2,
    }
    alone, watched = shaft(at, goal, **registers), shaft(at, goal, **registers)
    for instant in sorted(asked):
        watched.settle(instant)
    assert math.isclose(watched.position(SECOND), alone.position(SECOND), rel_tol=0, abs_tol=1e-9)
