"""`at_end="park"`: from the last target to the pose of the robot's file, slowly and under watch, then off."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import msgspec
import pytest

from aces_bus.controller import controller
from aces_bus.device.config import Park, Robot
from aces_bus.errors import CallerError
from aces_bus.robot import Ended, Runner, parse_robot, print_robot, run_virtual
from tests.robot.walking import hubo_leg

POSE = {"RKN": 0.1, "RHP": -0.1}
SPEED = 0.2


def leg(**more: Any) -> Robot:
    return msgspec.structs.replace(hubo_leg(), park=Park(pose=POSE, speed=SPEED, **more))


@controller(rate_hz=100, writes=["RKN", "RHP"])
def bend(t: float) -> dict[str, float]:
    return {"RKN": 0.3 * min(t, 1.0), "RHP": -0.3 * min(t, 1.0)}


def park(
    during: Callable[[Runner], Any] | None = None, robot: Robot | None = None
) -> tuple[Ended, Runner, list[Any]]:
    """Run for 1.5 s and park; `during` happens 0.5 s into the way. Gives what RKN was set to since, with the instants."""
    run = run_virtual(leg() if robot is None else robot, [bend], rate_hz=100, at_end="park")
    given: list[Any] = []
    with run:
        run.do("enable", devices=["JMC1", "JMC2"])
        run.rig["RKN"].given.append(lambda value, instant: given.append((instant, value)))
        run.start()
        run.clock.wait(lambda: False, 1_500_000_000)
        given.clear()
        if during is not None:
            run.clock.call_in(500_000_000, lambda: during(run))
        ended = run.stop()
    return ended, run, given


def are_off(run: Runner) -> bool:
    twins = run.world.twins
    return not any(channel.control_on for name in ("JMC1", "JMC2") for channel in twins[name].channels)


def test_it_parks_from_the_last_target_and_is_then_off() -> None:
    """At the pose's angles, no faster than the file says from tick to tick, and no set-point behind it."""
    ended, run, given = park()
    assert (sorted(ended.parked), ended.not_parked, ended.not_stopped) == (["RHP", "RKN"], {}, {})
    assert run.rig["RKN"].last == pytest.approx(0.1, abs=0.02)
    assert run.rig["RHP"].last == pytest.approx(-0.1, abs=0.02)
    assert given[0][1] == pytest.approx(0.3, abs=SPEED / 100 + 1e-9)
    for (_, before), (_, after) in pairwise(given):
        assert abs(after - before) <= SPEED / 100 * 1.01
    assert given[-1][1] == pytest.approx(0.1)
    assert are_off(run)


class Request:
    who = "aces stop (pid 7)"

    def answer(self, **content: Any) -> None:
        pass


def test_a_stop_interrupts_it_at_once() -> None:
    """What another program stops on the way goes no further, is named and off."""
    ended, run, given = park(lambda run: run.rig.obey_stop("lower", Request()))  # type: ignore[arg-type]
    assert ended.parked == []
    assert set(ended.not_parked.values()) == {"stopped by aces stop (pid 7)"}
    assert 0.18 < given[-1][1] < 0.22
    assert are_off(run)


def test_ctrl_c_interrupts_it_at_once() -> None:
    """It is raised when the end is over; the boards are off."""

    def interrupt(run: Runner) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        park(interrupt)


def test_a_joint_that_does_not_follow_ends_it() -> None:
    """A blocked knee is not pushed: all are switched off where they are, and the reason names it."""
    ended, run, _ = park(lambda run: run.world.twins["JMC2"].fault("jam"), leg(within=0.02))
    assert ended.parked == []
    assert "RKN: it is at 0.2" in ended.not_parked["RKN"]
    assert are_off(run)


def test_who_is_far_from_its_target_is_named_and_not_parked() -> None:
    """A joint that was astray before it begins stays where it is; the others are parked."""

    def jam(run: Runner) -> None:
        run.world.twins["JMC2"].fault("jam")

    run = run_virtual(leg(within=0.05), [bend], rate_hz=100, at_end="park")
    run.before.append(lambda: run.clock.call_in(4_000_000_000, lambda: None))
    with run:
        run.do("enable", devices=["JMC1", "JMC2"])
        run.start()
        jam(run)
        run.clock.wait(lambda: False, 700_000_000)
        ended = run.stop()
    assert ended.parked == ["RHP"]
    assert "from its target" in ended.not_parked["RKN"]
    assert are_off(run)


def test_what_cannot_be_parked_is_known_before() -> None:
    """A driven joint that the pose does not name; a file without a pose is refused when the run is made."""

    @controller(rate_hz=100, writes=["RAP"])
    def ankle(t: float) -> dict[str, float]:
        return {"RAP": 0.0}

    run = run_virtual(leg(), [ankle], rate_hz=100, at_end="park")
    assert run.unparkable["RAP"] == "the pose does not name it"
    with pytest.raises(CallerError, match="names no pose to park in"):
        run_virtual(hubo_leg(), [ankle], at_end="park")


def test_the_file_s_pose_is_checked() -> None:
    """It is read back as it was written; unknown joints and angles beyond limits are errors with their line."""
    text = print_robot(leg())
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    assert robot.park == leg().park
    _, problems = parse_robot(text.replace("RKN = 0.1", "RKN = 9.0").replace("RHP = -0.1", "RHX = -0.1"))
    said = " ".join(map(str, problems))
    assert "park.pose.RKN: 9 is beyond the limits of RKN" in said
    assert "RHX" in said
