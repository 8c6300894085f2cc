"""The one door of set-points: each kind of writer is held to each rule, by what is heard on the bus."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from aces_bus.controller import Bounds, Guard, Supervisor
from aces_bus.errors import CallerError
from aces_bus.robot import Runner, VirtualRobot, parse_robot, run_virtual
from tests.device.fan import ROBOT as FAN_ROBOT
from tests.device.fan import drivers, robot_of
from tests.robot.leg import COUNTS, MS, RATE, ROBOT, TICK_S, WRITERS, Leg, Wish, check_sent

# ---------------------------------------------------------------------- each writer against each rule


def within_limits(writer: str) -> None:
    """900 ends at the limit, -900 at the other, to the count, and that is said."""
    with Leg() as leg:
        for wanted, limit in ((900.0, 1.0), (-900.0, -1.0)):
            leg.write(writer, "HIP", wanted)
            leg.pass_time(0.7)
            assert leg.sent("HIP")[-1][1] == pytest.approx(limit, abs=2 / COUNTS)
            assert leg.run.rig["HIP"].value == pytest.approx(limit, abs=0.01)
        assert {"limited", "clipped"} & {event.kind for event in leg.run.events}
        assert check_sent(leg) > 400


def within_the_rate(writer: str) -> None:
    """0.8 rad at 4 rad/s takes 0.2 s, all the way at that rate, and ends at the set-point."""
    with Leg() as leg:
        start = leg.run.clock.now() / 1e9
        begin = leg.sent("HIP")[-1][1]
        leg.write(writer, "HIP", 0.8)
        leg.pass_time(0.3)
        sent = [(at, value) for at, value in leg.sent("HIP") if at >= start]
        arrived = next(at for at, value in sent if value >= 0.8 - 2 / COUNTS)
        assert arrived - start == pytest.approx((0.8 - begin) / RATE, abs=0.02)
        assert sent[-1][1] == pytest.approx(0.8, abs=2 / COUNTS)
        check_sent(leg)


def finite(writer: str) -> None:
    """What is not a finite number does not leave and is counted; five in a row trip, and the board is off."""
    with Leg() as leg:
        leg.write(writer, "HIP", 0.1)
        leg.pass_time(0.3)
        at_rest = leg.sent("HIP")[-1][1]
        for _ in range(4):
            leg.write(writer, "HIP", math.nan if writer != "controller" else 0.1)
        if writer == "controller":
            leg.walk.wishes["HIP"] = math.nan
            leg.pass_time(0.018)
        assert not leg.motor_is_off()
        assert leg.run.rig.door.tripped == {}
        leg.write(writer, "HIP", math.inf)
        leg.pass_time(0.1)
        assert leg.motor_is_off()
        assert any("5 set-points in a row were not finite" in str(event) for event in leg.run.events)
        assert leg.sent("HIP")[-1][1] == at_rest
        leg.write(writer, "HIP", 0.5)
        leg.pass_time(0.1)
        assert leg.sent("HIP")[-1][1] == at_rest
        assert leg.refused


def one_owner(writer: str) -> None:
    """What a controller owns under one name no other writer moves under any; both are named."""
    with Leg(owner="arm") as leg:
        leg.pass_time(0.02)
        leg.write(writer, "HIP", 0.5)
        leg.pass_time(0.2)
        assert leg.sent("HIP")[-1][1] == leg.sent("HIP")[0][1]
        (said,) = {one for one in leg.refused if "HIP.position" in one}
        assert "arm" in said
        assert (
            writer not in ("controller", "udp", "zenoh") or {"controller": "walk"}.get(writer, writer) in said
        )
        leg.write("udp", "KNEE", 0.5)  # what is free can be moved
        leg.pass_time(0.5)
        if writer != "controller":
            assert leg.sent("KNEE")[-1][1] == pytest.approx(0.5, abs=2 / COUNTS)


def follows(writer: str) -> None:
    """A joint that is held up, on a board that says nothing of it, is found by where it is; the board is off."""
    with Leg() as leg:
        for fault in ("jam", "no_errors"):
            leg.run.world.twins["JMC0"].fault(fault, 1)
        leg.write(writer, "HIP", 0.15)
        leg.pass_time(0.7)
        assert not leg.motor_is_off()  # within the bound
        began = leg.run.clock.now()
        leg.write(writer, "HIP", 0.9)
        leg.run.clock.wait(leg.motor_is_off, 2_000 * MS)
        assert leg.run.clock.now() - began < 1_100 * MS
        leg.pass_time(0.02)
        (event,) = (one for one in leg.run.events if one.kind == "following error")
        assert event.source == "JMC0"
        assert event.detail.startswith("HIP.position stays at ")
        assert leg.run.supervisors[0].reason.startswith("JMC0: following error")
        leg.write(writer, "HIP", 0.2)
        assert leg.refused


RULES = (within_limits, within_the_rate, finite, one_owner, follows)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
@pytest.mark.parametrize("writer", WRITERS)
def test_a_writer_and_a_rule(writer: str, rule: Callable[[str], None]) -> None:
    """Every writer is held to every rule."""
    rule(writer)


# ---------------------------------------------------------------------- what an owner asks of the limiter


def owned(bounds: Bounds, wish: Wish) -> Runner:
    """The leg with a controller whose guard has bounds of its own for the hip, enabled and running."""
    robot, problems = parse_robot(ROBOT)
    assert robot is not None, problems
    guard = Guard({"HIP": bounds}, period_s=0.005, dead_man_s=None, name=wish.name)
    run = run_virtual(robot, [Supervisor(wish, guard)])
    run.open()
    run.do("enable")
    run.start()
    return run


def left(run: Runner, seconds: float) -> list[float]:
    """What left the door for the hip, tick by tick."""
    found: list[float] = []
    signal = run.rig["HIP"]
    signal.given.append(lambda value, instant: found.append(value))
    run.clock.wait(lambda: False, round(seconds * 1e9))
    signal.given.clear()
    return found


def test_a_controllers_own_bounds_are_kept_in_the_ticks_of_the_bus() -> None:
    """Narrower limits, rate and acceleration of a guard hold at the door; the file's hold where a guard's are wider."""
    wish = Wish("walk", writes=("HIP",))
    run = owned(Bounds(-9.0, 0.5, rate=1.0, acceleration=5.0), wish)
    wish.wishes["HIP"] = 2.0
    sent = np.array(left(run, 1.5))
    assert run.rig.door.limits("HIP") == Bounds(-1.0, 0.5, 1.0, 5.0)
    assert sent.max() == sent[-1] == 0.5
    speeds = np.diff(sent) / TICK_S
    assert speeds.max() == pytest.approx(1.0, abs=1e-6)
    assert np.abs(np.diff(speeds)).max() <= 5.0 * TICK_S + 1e-6
    guard = run.supervisors[0].guard
    assert guard.clips["HIP"].position > 100
    assert {event.kind for event in run.events} >= {"clipped"}
    assert not {event.kind for event in run.events} & {"limited"}
    run.stop()


def test_a_hold_comes_to_a_stand_within_the_acceleration() -> None:
    """A hold at full speed brakes as the guard's bounds say, does not turn back, and stays."""
    wish = Wish("walk", writes=("HIP",))
    run = owned(Bounds(rate=1.0, acceleration=5.0), wish)
    wish.wishes["HIP"] = 0.9
    before = left(run, 0.4)
    run.supervisors[0].guard.trip("enough", "hold")
    sent = np.array([*before[-2:], *left(run, 1.0)])
    speeds = np.diff(sent) / TICK_S
    assert speeds[0] == pytest.approx(1.0, abs=1e-6)
    assert np.abs(np.diff(speeds)).max() <= 5.0 * TICK_S + 1e-6
    assert speeds.min() >= -1e-9
    assert sent[-1] == sent[-50] < 0.5
    run.stop()


def test_a_hold_stops_a_joint_that_is_on_its_way() -> None:
    """Without a limit of acceleration it stays where it was sent last, however far away its goal is."""
    wish = Wish("walk", writes=("HIP",))
    run = owned(Bounds(rate=1.0), wish)
    wish.wishes["HIP"] = 0.9
    before = left(run, 0.3)[-1]
    run.supervisors[0].guard.trip("enough", "hold")
    after = left(run, 0.2)
    assert 0.1 < before <= after[0] <= before + 2 * TICK_S
    assert set(after[2:]) == {after[-1]}
    assert len(after) >= 35  # live, in each tick
    run.release("walk")
    assert left(run, 1.0)[-1] == 0.9
    run.stop()


def test_bounds_that_no_set_point_can_keep_are_refused() -> None:
    """A guard whose limits lie outside of the file's is an error of its controller, with the limits' own words."""
    wish = Wish("walk", writes=("HIP",))
    run = owned(Bounds(2.0, 3.0), wish)
    wish.wishes["HIP"] = 2.5
    assert left(run, 0.1) == []
    assert "lower must not be above upper" in run.held["walk"]
    run.stop()


def test_a_controller_s_signals_are_its_supervisor_s_before_the_first_step() -> None:
    """A trip of the door bars what nobody owns, and leaves the controller's own to its supervisor."""
    robot, problems = parse_robot(ROBOT)
    assert robot is not None, problems
    run = run_virtual(robot, [Wish("walk", writes=("HIP",))])
    with run:
        run.rig.door.trip("on purpose")
        assert run.rig.door.owners == {"HIP.position": "walk"}
        assert "HIP.position" not in run.rig.door.tripped
        assert "KNEE.position" in run.rig.door.tripped


def test_a_name_is_no_set_point_of_a_quantity() -> None:
    """A text for what has a unit is refused with the value, and nothing leaves."""
    with VirtualRobot(robot_of(FAN_ROBOT), load=drivers, rate_hz=100) as robot:
        robot.advance(0.05)
        with pytest.raises(CallerError, match="'fast' is not a set-point; give a finite number"):
            robot["A.left"].set("fast")
        assert robot.rig.door.counts("A.left").not_finite == 1
        robot.advance(0.05)
        assert robot.twins["A"].left == 0
