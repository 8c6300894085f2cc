"""The guard: nothing gets through that is beyond the limits, and feasible motions get through untouched."""

from __future__ import annotations

import itertools
import math
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus.controller import Bounds, ControlEvent, Guard
from aces_bus.errors import CallerError
from tests.controller.fakes import fakes

MS = 1_000_000
wild = st.lists(st.floats(-20, 20) | st.sampled_from([0.0, 1.0, -1.0]), min_size=1, max_size=60)


def guarded(bounds: Bounds, values: list[float], period_ms: int = 10) -> tuple[list[float], Guard]:
    """What leaves a guard for these set-points of A."""
    guard = Guard({"A": bounds}, period_s=period_ms / 1e3)
    return [guard.apply(n * period_ms * MS, {"A": value})["A"] for n, value in enumerate(values)], guard


@given(wild, st.floats(0.1, 100), st.floats(0.5, 1e4))
def test_position_rate_and_acceleration_hold(values: list[float], rate: float, acceleration: float) -> None:
    """Whatever is asked for: within the limits of position and rate always, and within the acceleration too."""
    out, _ = guarded(Bounds(-2.0, 3.0, rate, acceleration), [0.0, *values, *[values[-1]] * 50])
    speeds = np.diff([out[0], *out]) / 0.01
    assert min(out) >= -2.0
    assert max(out) <= 3.0
    assert np.abs(speeds).max() <= rate * (1 + 1e-6)
    assert np.abs(np.diff(speeds)).max() <= acceleration * 0.01 * (1 + 1e-6) + 1e-6


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=80))
def test_a_feasible_motion_passes_unchanged(pushes: list[float]) -> None:
    """Any motion whose own differences keep the limits gets through to the last bit, and nothing is counted."""
    acceleration, rate, dt = 5.0, 1.0, 0.01
    x = v = 0.0
    values = [x]
    for push in pushes:
        v = max(-rate, min(rate, v + push * acceleration * dt))
        x += v * dt
        values.append(x)
    out, guard = guarded(Bounds(-10, 10, rate, acceleration), values)
    assert out == values
    assert guard.clips == {}


def test_a_motion_that_stops_at_its_limit_passes() -> None:
    """Braking as hard as allowed, to rest exactly at the limit of position, is feasible."""
    speeds = np.array([*range(1, 11), *range(9, -1, -1)]) * 0.05
    values = [0.0, *np.cumsum(speeds * 0.01).tolist()]
    out, guard = guarded(Bounds(-1, values[-1] + 1e-12, 10, 5.0), values)
    assert out == values
    assert guard.clips == {}


@pytest.mark.parametrize(("share", "clips"), [(0.99, 0), (1.01, 1), (1.5, 1)])
def test_a_change_of_speed_is_held_to_the_acceleration(share: float, clips: int) -> None:
    """From rest, 1 rad/s² lets a cycle of 10 ms change the speed by 0.01 rad/s; a hundredth more is limited, and counted."""
    asked = share * 0.01 * 0.01
    out, guard = guarded(Bounds(-10.0, 10.0, 5.0, 1.0), [0.0, 0.0, asked])
    assert out[-1] == pytest.approx(min(asked, 1e-4), rel=1e-6)
    assert ("A" in guard.clips and guard.clips["A"].acceleration) == clips


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("speed", [1.0, 1.5, 1000.0])
def test_one_limit_is_met_at_rest(sign: float, speed: float) -> None:
    """Towards the one limit that there is, a joint slows down in time: it arrives within its acceleration, and stays."""
    bounds = Bounds(-math.inf, 1.0, 5.0, 2.0) if sign > 0 else Bounds(-1.0, math.inf, 5.0, 2.0)
    out, _ = guarded(bounds, [sign * min(10.0, 0.01 * speed * n) for n in range(400)])
    speeds = np.diff(out) / 0.01
    assert np.abs(np.diff([0.0, *speeds])).max() <= 0.02 * (1 + 1e-6)
    assert max(sign * value for value in out) <= 1.0
    assert out[-1] == pytest.approx(sign, abs=1e-9)


@pytest.mark.parametrize("acceleration", [math.inf, 50.0])
@pytest.mark.parametrize("speed", [0.8, -0.8, 3.0, -3.0])
def test_what_is_too_fast_is_led_the_same_way(speed: float, acceleration: float) -> None:
    """However slow the limit is, a set-point beyond it is followed at it, and never the other way."""
    out, guard = guarded(
        Bounds(-9, 9, rate=0.5, acceleration=acceleration), [0.01 * speed * n for n in range(50)]
    )
    way = math.copysign(1.0, speed)
    steps = way * np.diff(out) / 0.01
    assert (steps >= 0.0).all()
    assert (steps <= 0.5 + 1e-9).all()
    assert steps[5:] == pytest.approx(0.5)
    assert guard.clipped("A").rate >= 45


def test_a_motion_that_ends_at_once_is_ended_within_the_acceleration() -> None:
    """Set-points that stand still at full speed are passed and come back to: no joint stops within a cycle."""
    ramp = [0.005 * (0.01 * n) * n for n in range(30)]
    out, _ = guarded(Bounds(-9, 9, rate=5.0, acceleration=2.0), [*ramp, *[ramp[-1]] * 100])
    assert out[:30] == pytest.approx(ramp)
    speeds = np.diff(out) / 0.01
    assert np.abs(np.diff(speeds)).max() <= 0.02 * (1 + 1e-6)
    assert out[-1] == pytest.approx(ramp[-1])


def test_a_step_is_reached_without_overshoot() -> None:
    """As quickly as the limits allow: v/a + d/v seconds for a distance d, and never beyond."""
    out, guard = guarded(Bounds(-9, 9, rate=1.0, acceleration=4.0), [0.0] + [1.0] * 200)
    assert max(out) <= 1.0 + 1e-12
    assert out[-1] == pytest.approx(1.0)
    arrived = next(n for n, value in enumerate(out) if value > 1 - 1e-6)
    assert arrived * 0.01 == pytest.approx(1.25, abs=0.03)
    assert guard.clipped("A").rate + guard.clipped("A").acceleration > 20


def test_a_motion_that_is_too_fast_is_followed_and_met() -> None:
    """A sine beyond the rate comes out slower, and agrees again where it is slow enough."""
    values = [math.sin(3 * n * 0.01) if n < 420 else math.sin(3 * 4.2) for n in range(700)]
    out, _ = guarded(Bounds(-2, 2, rate=2.0, acceleration=50.0), values)
    assert np.abs(np.diff(out)).max() <= 0.02 + 1e-9
    assert out[-1] == pytest.approx(values[-1])
    assert max(out) <= 1.0 + 0.05


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "text", None])
def test_what_is_not_finite_never_gets_through(value: Any) -> None:
    """It is dropped and counted, the others go on, and whoever listens is told once a second."""
    heard: list[ControlEvent] = []
    guard = Guard({"A": Bounds(), "B": Bounds()}, period_s=0.01)
    guard.listeners.add(heard.append)
    for n in range(50):
        wanted = 2.0 if n % 5 == 4 else value
        assert guard.apply(n * 10 * MS, {"A": wanted, "B": 1.0}).keys() == (
            {"A", "B"} if n % 5 == 4 else {"B"}
        )
    assert guard.clipped("A").not_finite == 40
    assert [(event.kind, event.instant, event.source) for event in heard] == [("not finite", 0, "guard")]
    assert "A" in heard[0].detail
    assert isinstance(heard[0].instant, int)


def test_what_is_forgotten_is_the_speed_too() -> None:
    """After `forget` a motion begins from rest: its first step is one of the acceleration."""
    guard = Guard({"A": Bounds(-10.0, 10.0, rate=5.0, acceleration=2.0)}, period_s=0.01)
    for n in range(50):
        guard.apply(n * 10 * MS, {"A": 5.0})
    guard.forget()
    out = [guard.apply(n * 10 * MS, {"A": value})["A"] for n, value in ((50, 0.0), (51, 1.0))]
    assert out == [0.0, pytest.approx(2.0 * 0.01**2)]


def test_unlisted_states_are_refused_or_passed() -> None:
    """A name without bounds is refused and counted; with `pass` it only has to be finite."""
    guard = Guard({"A": Bounds()}, period_s=0.01)
    assert guard.apply(0, {"A": 1.0, "LPK": 2.0}) == {"A": 1.0}
    assert guard.refused == {"LPK": 1}
    guard = Guard({}, period_s=0.01, unlisted="pass")
    assert guard.apply(0, {"LPK": 2.0, "Q": math.nan}) == {"LPK": 2.0}


def test_the_first_set_point_starts_from_the_present_position() -> None:
    """With the state bound it is limited from there; without, it is believed, and counted as unanchored."""
    guard = Guard({"A": Bounds(rate=1.0)}, period_s=0.01)
    guard.bind(fakes(A=0.5))
    assert guard.apply(0, {"A": 2.0})["A"] == pytest.approx(0.51)
    other = Guard({"A": Bounds(rate=1.0)}, period_s=0.01)
    assert other.apply(0, {"A": 2.0}) == {"A": 2.0}
    assert (guard.unanchored, other.unanchored) == (0, 1)


def test_a_joint_that_begins_outside_of_its_limits_is_led_inside() -> None:
    """It does not jump to the limit: it goes there within its rate and acceleration, and never further out."""
    guard = Guard({"A": Bounds(-1.0, 1.0, rate=1.0, acceleration=10.0)}, period_s=0.01)
    guard.bind(fakes(A=1.5))
    out = [guard.apply(n * 10 * MS, {"A": 2.0 if n < 100 else 0.5})["A"] for n in range(300)]
    assert out[0] == pytest.approx(1.499)
    assert np.diff(out).max() <= 1e-12
    assert np.abs(np.diff(out)).max() <= 0.01 * (1 + 1e-6)
    assert out[90] == pytest.approx(1.0)
    assert out[-1] == pytest.approx(0.5)


def test_a_pause_earns_no_jump() -> None:
    """After seconds without set-points the next step is not larger than two periods allow."""
    guard = Guard({"A": Bounds(rate=1.0)}, period_s=0.01, dead_man_s=None)
    guard.apply(0, {"A": 0.0})
    assert guard.apply(5_000 * MS, {"A": 9.0})["A"] == pytest.approx(0.02)
    assert guard.apply(5_000 * MS, {"A": 9.0})["A"] < 0.0201
    assert guard.apply(4_000 * MS, {"A": 9.0})["A"] < 0.0202


def test_the_dead_man_holds_within_the_limits_and_lets_go() -> None:
    """After 100 ms without set-points it comes to a stand by its acceleration, stays, and follows again when they come."""
    heard: list[ControlEvent] = []
    guard = Guard({"A": Bounds(rate=3.0, acceleration=5.0)}, period_s=0.01, dead_man_s=0.1)
    guard.listeners.add(heard.append)
    now, x = 0, 0.0
    for n in range(50):
        now, x = n * 10 * MS, n * n * 0.00025
        assert guard.apply(now, {"A": x}) == {"A": pytest.approx(x)}
    assert [guard.tick(now + n * 10 * MS) for n in range(1, 11)] == [{}] * 10
    held = [guard.tick(now + n * 10 * MS)["A"] for n in range(11, 80)]
    assert guard.tripped is not None
    assert (guard.tripped.action, guard.tripped.latched) == ("hold", False)
    assert np.abs(np.diff(held, 2)).max() <= 5.0 * 1e-4 + 1e-9
    assert held[-1] == held[-2] > x
    out = guard.apply(now + 800 * MS, {"A": x})
    assert guard.tripped is None
    assert abs(out["A"] - held[-1]) <= 5.0 * 2e-4
    assert [event.kind for event in heard] == ["trip", "late", "clipped"]
    assert {event.source for event in heard} == {"guard"}


@pytest.mark.parametrize("action", ["zero duty", "disable"])
def test_the_other_actions_are_latched(action: Literal["zero duty", "disable"]) -> None:
    """Nothing goes down any more until `release`, and then from the present position."""
    states = fakes(A=0.0)
    guard = Guard({"A": Bounds(rate=1.0)}, period_s=0.01, action=action)
    guard.bind(states)
    guard.apply(0, {"A": 0.0})
    assert guard.tick(500 * MS) == {}
    assert guard.tripped is not None
    assert (guard.tripped.action, guard.tripped.instant) == (action, 500 * MS)
    assert guard.apply(510 * MS, {"A": 0.0}) == {}
    assert guard.swallowed == 1
    states["A"].value = -0.7
    guard.release()
    assert guard.apply(520 * MS, {"A": 0.0})["A"] == pytest.approx(-0.69)


def test_a_trip_stops_at_once_and_the_strictest_wins() -> None:
    """Several at a time: the strictest action and its reason; a milder one later changes nothing."""
    guard = Guard({"A": Bounds()}, period_s=0.01)
    guard.apply(0, {"A": 1.0})
    guard.trip("first")
    assert guard.apply(10 * MS, {"A": 5.0}) == {"A": 1.0}
    assert guard.apply(20 * MS, {"A": 5.0}) == {"A": 1.0}
    guard.trip("second", "zero duty")
    guard.trip("third", "disable")
    assert guard.tick(30 * MS) == {}
    assert guard.tripped is not None
    assert (guard.tripped.reason, guard.tripped.action) == ("third", "disable")
    guard.trip("fourth", "hold")
    assert guard.tick(40 * MS) == {}
    assert guard.tripped.reason == "third"
    assert guard.trips == 2


def test_a_hold_by_hand_is_released_from_where_it_stands() -> None:
    """It takes `release`, and then there is no jump."""
    guard = Guard({"A": Bounds(rate=1.0)}, period_s=0.01)
    guard.apply(0, {"A": 1.0})
    guard.trip("by hand")
    guard.apply(10 * MS, {"A": 5.0})
    guard.release()
    assert guard.apply(20 * MS, {"A": 5.0})["A"] == pytest.approx(1.01)


def test_the_dead_man_waits_for_the_first_set_points() -> None:
    """A controller that has not begun yet is not dead."""
    guard = Guard({"A": Bounds()}, period_s=0.01)
    assert [guard.tick(n * 1_000 * MS) for n in range(3)] == [{}] * 3
    assert guard.tripped is None


@given(wild, st.lists(st.integers(-5, 60), min_size=61, max_size=61))
def test_odd_instants_do_no_harm(values: list[float], gaps: list[int]) -> None:
    """Clocks that jump, stand or run back: still within position, and finite."""
    guard, now = Guard({"A": Bounds(-2, 3, 1.0, 5.0)}, period_s=0.01, dead_man_s=None), 0
    for value, gap in zip(values, gaps, strict=False):
        now += gap * MS
        assert -2 <= guard.apply(now, {"A": value})["A"] <= 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"period_s": 0.0}, "not a period"),
        ({"dead_man_s": 0.005}, "more than the period"),
        ({"action": "explode"}, "hold, park, zero duty, disable"),
    ],
)
def test_wrong_settings_are_refused(options: dict[str, Any], message: str) -> None:
    """Period, dead-man, action and bounds."""
    merged: dict[str, Any] = {"period_s": 0.01, **options}
    with pytest.raises(CallerError, match=message):
        Guard({}, **merged)
    with pytest.raises(CallerError, match="must not be above upper"):
        Bounds(1.0, 0.0)


# ---------------------------------------------------------------------- a joint that is not named any more


def test_a_speed_that_is_not_named_any_more_becomes_0() -> None:
    """After `unnamed_s` it is led to 0 at its rate, said once; named again it goes on from there."""
    seen: list[ControlEvent] = []
    bounds = {"wheel": Bounds(-9.0, 9.0, rate=10.0, rest=0.0), "knee": Bounds(-1.0, 1.0)}
    guard = Guard(bounds, period_s=0.01, dead_man_s=None, unnamed_s=0.1, name="walk")
    guard.listeners.add(seen.append)
    for tick in range(10):
        guard.apply(tick * 10 * MS, {"wheel": 2.0, "knee": 0.5})
    left = [dict(guard.apply(tick * 10 * MS, {"knee": 0.5})) for tick in range(10, 50)]
    wheel = [one["wheel"] for one in left if "wheel" in one]
    assert [one for one in left[:10] if "wheel" in one] == []  # not yet
    assert all(before - after <= 0.1 + 1e-9 for before, after in itertools.pairwise(wheel))
    assert wheel[-1] == 0.0
    assert len(wheel) < len(left) - 10  # it stands, and nothing more is given
    assert all(one["knee"] == 0.5 for one in left)
    said = "wheel: no set-point for 110 ms while others come; it stands still"
    assert seen == [ControlEvent("unnamed", 200 * MS, "walk", said)]
    assert guard.apply(500 * MS, {"wheel": 0.05, "knee": 0.5})["wheel"] == pytest.approx(0.05)


def test_a_position_that_is_not_named_any_more_stays() -> None:
    """It stands where it was led, and nothing of it leaves again."""
    guard = Guard({"a": Bounds(), "b": Bounds()}, period_s=0.01, dead_man_s=None, unnamed_s=0.1)
    guard.apply(0, {"a": 1.0, "b": 1.0})
    left = [guard.apply(tick * 10 * MS, {"b": 1.0}) for tick in range(1, 50)]
    assert all(one == {"b": 1.0} for one in left)


def test_a_hold_of_a_speed_is_standing_still() -> None:
    """A trip that holds leads a speed to 0: a wheel that keeps its speed is not held."""
    guard = Guard({"wheel": Bounds(-9.0, 9.0, rest=0.0)}, period_s=0.01, dead_man_s=None)
    guard.apply(0, {"wheel": 2.0})
    guard.trip("enough", "hold")
    assert guard.tick(10 * MS) == {"wheel": 0.0}


def test_five_set_points_that_are_no_numbers_are_a_fault_of_this_instant() -> None:
    """Who reacts to faults is told the instant and whose set-points they were."""
    told: list[ControlEvent] = []
    guard = Guard({"A": Bounds()}, period_s=0.01, name="walk")
    guard.fault = told.append
    for n in range(5):
        guard.apply(n * 10 * MS, {"A": math.nan})
    assert [(event.kind, event.instant, event.source) for event in told] == [("not finite", 40 * MS, "walk")]
