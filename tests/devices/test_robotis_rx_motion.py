"""The simulated servo's shaft: speed, compliance, torque; where it is does not depend on who asks."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_devices.robotis_rx.motion import FREE, PER_SPEED, REST, STEPS, TURN, ShaftMotion

SECOND = 1_000_000_000


def driven(**more: object) -> ShaftMotion:
    """On its way from count 100 to 900."""
    return ShaftMotion(at=100.0, goal=900.0, is_driven=True, **more)  # type: ignore[arg-type]


def test_it_runs_at_its_moving_speed() -> None:
    """0.111 rpm a count: at 90 counts 9.99 rpm, which are 204.4 counts a second."""
    motion = driven(speed=90)
    assert motion.position(SECOND) - 100 == pytest.approx(90 * 0.111 * 6 / (300 / 1023))
    assert motion.speed_at(SECOND) == pytest.approx(204.4, abs=0.1)
    assert motion.is_moving(SECOND)
    assert motion.position(60 * SECOND) == 900 - REST
    assert not motion.is_moving(60 * SECOND)
    assert motion.drive_at(60 * SECOND) == 0


def test_without_a_speed_it_runs_as_fast_as_its_torque_lets_it() -> None:
    """Half of the torque, half of the speed; none, none; and no torque at all when it is off or jammed."""
    assert driven().speed_at(0) == pytest.approx(FREE * PER_SPEED)
    assert driven(limit=512).speed_at(0) == pytest.approx(FREE * PER_SPEED * 512 / 1023)
    for still in (driven(limit=0), driven(is_jammed=True), ShaftMotion(at=100, goal=900)):
        assert still.position(10 * SECOND) == 100
        assert still.speed_at(0) == 0
    assert driven(is_jammed=True).drive_at(0) == 1
    assert ShaftMotion(at=900, goal=100, is_driven=True, is_jammed=True, limit=300).drive_at(0) == -300 / 1023


@pytest.mark.parametrize(
    ("slope", "step"), [(1, 4), (7, 4), (8, 8), (32, 32), (63, 32), (253, 128), (254, 254)]
)
def test_slopes_act_in_steps(slope: int, step: int) -> None:
    """4, 8, 16, 32, 64, 128, 254."""
    assert STEPS[slope] == step


def test_compliance_is_felt_near_the_goal() -> None:
    """A gentle slope slows it down earlier; a margin stops it earlier, on the side that it comes from."""
    steep, gentle = driven(slope=(4, 4)), driven(slope=(254, 128))
    late = round(0.62 * SECOND)
    assert gentle.position(late) < steep.position(late)
    assert driven(margin=(0, 50)).position(60 * SECOND) == 900 - 50 - REST
    assert driven(margin=(50, 0)).position(60 * SECOND) == 900 - REST
    back = ShaftMotion(at=900.0, goal=100.0, is_driven=True, margin=(50, 0))
    assert back.position(60 * SECOND) == 100 + 50 + REST


def test_endless_turn_goes_round() -> None:
    """The duty's share of the greatest speed, either way, at most the torque limit; a turn is 1227.6 counts."""
    motion = ShaftMotion(at=0.0, is_driven=True, duty=-0.5)
    assert motion.speed_at(0) == pytest.approx(-0.5 * FREE * PER_SPEED)
    assert motion.position(SECOND // 10) == pytest.approx(TURN - 0.05 * FREE * PER_SPEED)
    assert ShaftMotion(is_driven=True, duty=1.0, limit=512).drive_at(0) == 512 / 1023
    assert not ShaftMotion(is_driven=True, duty=0.0).is_moving(0)


@given(
    st.floats(0, 1023),
    st.floats(0, 1023),
    st.integers(0, 1023),
    st.integers(0, 1023),
    st.integers(32, 1023),
    st.integers(0, 254),
    st.integers(1, 254),
    st.lists(st.integers(0, 3 * SECOND), max_size=5),
)
def test_asking_changes_nothing(
    at: float, goal: float, speed: int, limit: int, punch: int, margin: int, slope: int, asked: list[int]
) -> None:
    """It goes towards its goal, never beyond, and is where it would be had nobody looked."""

    def made() -> ShaftMotion:
        return ShaftMotion(
            at, 0, goal, True, False, speed, limit, punch, margin=(margin, margin), slope=(slope, slope)
        )

    alone, watched = made(), made()
    gap = abs(goal - at)
    for instant in sorted(asked):
        watched.settle(instant)
        now = abs(goal - watched.at)
        assert now <= gap + 1e-6
        assert now == pytest.approx(abs(goal - alone.position(instant)), abs=1e-6)
        assert math.isclose(
            watched.speed_at(instant), alone.speed_at(instant), rel_tol=1e-4, abs_tol=1e-3
        ) or (abs(now - margin - REST) < 1e-6)
        gap = now
