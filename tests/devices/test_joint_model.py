"""The simulated joint: its motor is the equation it says it is, and nobody's looking changes it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_devices.joint_model import AMBIENT, STEP_NS, MotorJoint, MotorModel, PacedGoal, servo_gains

MS = STEP_NS


def test_free_run_is_the_exact_solution() -> None:
    """At full duty the speed goes to its end with the motor's time constant: v = v∞ (1 − exp(−t/τ)), friction included."""
    motor = MotorModel(speed=6.0, time_constant=0.035, friction=0.02)
    joint = MotorJoint(motor, 0)
    joint.drive(0, 1.0)
    joint.sync(50 * MS)
    end = 6.0 * (1 - 0.02)
    passed = 0.05
    assert joint.v == pytest.approx(end * (1 - math.exp(-passed / 0.035)), rel=1e-9)
    gone = end * (passed - 0.035 * (1 - math.exp(-passed / 0.035)))
    assert joint.q == pytest.approx(gone, rel=1e-9)


def test_friction_holds_small_duties() -> None:
    """Below the friction's share nothing moves; a moving joint that is let go stops, for good."""
    joint = MotorJoint(MotorModel(friction=0.02), 0)
    joint.drive(0, 0.019)
    assert joint.position(1000 * MS) == 0.0
    joint.drive(1000 * MS, 0.5)
    joint.free(1200 * MS)
    stopped = joint.position(3000 * MS)
    assert stopped > 0.1
    assert joint.v == 0.0
    assert joint.position(9000 * MS) == stopped


def test_the_controller_brings_it_there_without_overshoot() -> None:
    """Critically damped: it arrives within what friction allows, and never passes the goal by more than that."""
    motor = MotorModel()
    joint = MotorJoint(motor, 0)
    joint.follow(0, 0.5)
    places = [joint.position(n * MS) for n in range(1500)]
    slack = motor.friction / servo_gains(motor)[0]
    assert places[-1] == pytest.approx(0.5, abs=1.1 * slack)
    assert max(places) <= 0.5 + 2 * slack


def test_stops_stop_and_pressing_takes_current() -> None:
    """Against its stop it stands still, and the current is what the duty gives through a blocked winding."""
    motor = MotorModel(stall_current=8.0)
    joint = MotorJoint(motor, 0, lower=-0.1, upper=0.2)
    joint.drive(0, 0.5)
    assert joint.position(500 * MS) == 0.2
    assert joint.current == pytest.approx(4.0)
    assert joint.moved_at < 200 * MS


def test_a_blocked_motor_heats_up() -> None:
    """i²R warms it toward its end; without current it cools to what surrounds it."""
    motor = MotorModel(heating=0.05, cooling=10.0, stall_current=8.0)
    joint = MotorJoint(motor, 0)
    joint.jammed = True
    joint.drive(0, 1.0)
    joint.sync(100_000 * MS)
    assert joint.temperature == pytest.approx(AMBIENT + 0.05 * 10 * 64, rel=1e-2)
    joint.free(100_000 * MS)
    joint.sync(300_000 * MS)
    assert joint.temperature == pytest.approx(AMBIENT, abs=0.1)


def test_a_current_is_held() -> None:
    """Pushed with a current, it accelerates until the voltage is at its end; blocked, the current is what was said."""
    joint = MotorJoint(MotorModel(stall_current=8.0), 0, upper=0.3)
    joint.push(0, 0.8)
    joint.sync(1000 * MS)
    assert joint.q == 0.3
    assert joint.current == pytest.approx(0.8)


def test_a_paced_goal_is_followed_and_reached() -> None:
    """The goal moves at its pace, with its acceleration, and stops at the target; the joint is close behind it."""
    motor = MotorModel(friction=0.0)
    stiffness, damping = servo_gains(motor)
    law = PacedGoal(0.0, 1.0, stiffness, damping, pace=1.0, acceleration=4.0, ahead=1.0 / motor.speed)
    joint = MotorJoint(motor, 0)
    joint.obey(0, law)
    joint.sync(125 * MS)
    assert joint.v == pytest.approx(0.5, abs=0.1)
    joint.sync(500 * MS)
    assert joint.v == pytest.approx(1.0, abs=0.02)
    joint.sync(3000 * MS)
    assert joint.q == pytest.approx(1.0, abs=1e-4)
    assert law.is_steady


def test_a_goal_does_not_run_away_from_a_joint_that_cannot_follow() -> None:
    """A jammed joint that is to turn on and on does not leap once it is free again."""
    law = PacedGoal(0.0, None, 2.0, 0.2, pace=3.0)
    joint = MotorJoint(MotorModel(), 0)
    joint.jammed = True
    joint.obey(0, law)
    joint.sync(5000 * MS)
    assert law.goal == pytest.approx(0.5)
    assert joint.current == pytest.approx(8.0)


@given(
    st.lists(st.integers(0, 300_000_000), min_size=0, max_size=20),
    st.lists(
        st.tuples(st.sampled_from(["follow", "drive", "free", "push"]), st.floats(-1, 1)),
        min_size=1,
        max_size=5,
    ),
)
def test_who_looks_and_when_changes_nothing(looks: list[int], orders: list[tuple[str, float]]) -> None:
    """The same orders at the same instants end in the same place, bit by bit, however often somebody asked."""
    ends: list[tuple[float, float]] = []
    for times in ([], sorted(looks)):
        joint = MotorJoint(MotorModel(), 0, lower=-0.6, upper=0.6)
        waiting = list(times)
        for number, (order, amount) in enumerate(orders):
            at = number * 60_500_000
            while waiting and waiting[0] <= at:
                joint.sync(waiting.pop(0))
            if order == "free":
                joint.free(at)
            else:
                getattr(joint, order)(at, amount)
        for at in waiting:
            joint.sync(at)
        joint.sync(400_000_000)
        ends.append((joint.q, joint.v))
    assert ends[0] == ends[1]
