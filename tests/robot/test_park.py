"""`at_end="park"`: from the last target to the pose of the robot's file, slowly and under watch, then off."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import msgspec
import pytest

from aces_bus.controller import IGNORE, controller
from aces_bus.controller.trip import Action
from aces_bus.device import Robot
from aces_bus.device.config import Park
from aces_bus.errors import CallerError
from aces_bus.robot import Ended, Runner, parse_robot, run_virtual
from aces_bus.robot.file import print_robot
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


def lose(seconds: float) -> Callable[[Runner], None]:
    """The knee's board answers nothing for so long."""

    def begin(run: Runner) -> None:
        board = run.world.twins["JMC2"]
        board.fault("silent")
        run.clock.call_in(round(seconds * 1e9), lambda: board.fault("silent", on=False))

    return begin


def test_late_answers_make_it_wait() -> None:
    """While it is not known where a joint is, no joint goes on; then all go on, and are parked."""
    ended, run, given = park(lose(0.4))
    assert (sorted(ended.parked), ended.not_parked, ended.not_stopped) == (["RHP", "RKN"], {}, {})
    assert run.rig["RKN"].last == pytest.approx(0.1, abs=0.02)
    most_ns = max(late - early for (early, _), (late, _) in pairwise(given))
    assert 200_000_000 < most_ns < 450_000_000
    assert all(abs(after - before) <= SPEED / 100 * 1.01 for (_, before), (_, after) in pairwise(given))


def test_a_joint_that_stays_lost_ends_it() -> None:
    """After a second, for all: the joint is named, and what answers is off."""
    ended, run, given = park(lose(1000.0))
    assert ended.parked == []
    assert ended.not_parked == dict.fromkeys(("RKN", "RHP"), "RKN: it is not known where it is")
    assert given[-1][1] > 0.17
    assert not run.world.twins["JMC1"].channels[0].control_on


def test_a_joint_that_was_lost_before_is_left_where_it_is() -> None:
    """Nobody knows where it is when the way begins: a second later the others set out."""
    run = run_virtual(
        leg(), [bend], rate_hz=100, at_end="park", reactions={"silent": IGNORE, "no reply": IGNORE}
    )
    with run:
        run.do("enable", devices=["JMC1", "JMC2"])
        run.start()
        run.clock.wait(lambda: False, 1_500_000_000)
        lose(1000.0)(run)
        run.clock.wait(lambda: False, 500_000_000)
        ended = run.stop()
    assert ended.parked == ["RHP"]
    assert ended.not_parked == {"RKN": "it is not known where it is"}


def tripped(
    fault: Callable[[Runner], Any],
    *,
    on_trip: Action = "disable",
    robot: Robot | None = None,
    at_ms: int = 1500,
) -> tuple[Ended, Runner]:
    """Run until `fault`, after `at_ms`, ends it."""
    robot = leg() if robot is None else robot
    run = run_virtual(robot, [bend], rate_hz=100, on_trip=on_trip)
    with run:
        run.do("enable", devices=["JMC1", "JMC2"])
        run.clock.call_in(at_ms * 1_000_000, lambda: fault(run))
        return run.run(10.0), run


def unplug_the_sensors(run: Runner) -> None:
    """A fault of a device that drives no joint."""
    run.world.twins["FT_RF"].power(False)


def test_a_trip_parks_where_it_is_asked_for() -> None:
    """The run ends at the trip: the joints hold, are led to the pose from there, and are then off."""
    ended, run = tripped(unplug_the_sensors, on_trip="park")
    assert "to be parked: bend" in ended.reason
    assert ended.seconds < 3
    assert "FT_RF" in ended.tripped["bend"]
    assert (sorted(ended.parked), ended.not_parked, ended.not_stopped) == (["RHP", "RKN"], {}, {})
    assert run.rig["RKN"].last == pytest.approx(0.1, abs=0.02)
    assert are_off(run)


def test_a_reaction_of_the_file_parks() -> None:
    """Of the kinds and sources that it names; the others stop as `on_trip` says."""
    robot = msgspec.structs.replace(leg(), reactions={"silent@FT_RF": "park"})
    ended, _ = tripped(unplug_the_sensors, robot=robot)
    assert sorted(ended.parked) == ["RHP", "RKN"]
    ended, run = tripped(lambda run: run.supervisors[0].guard.trip("on purpose"), robot=robot)
    assert (ended.parked, ended.not_parked) == ([], {})
    assert are_off(run)


def test_what_tripped_is_not_parked_but_named() -> None:
    """A board that falls silent: its joint is named, and the others are parked."""
    ended, run = tripped(lambda run: run.world.twins["JMC2"].power(False), on_trip="park")
    assert ended.parked == ["RHP"]
    assert ended.not_parked["RKN"].startswith("it tripped: JMC2: silent: ")
    assert "JMC2" in ended.not_stopped
    assert not run.world.twins["JMC1"].channels[0].control_on


def test_a_stricter_trip_goes_before_the_way_to_the_pose() -> None:
    """An e-stop at the same instant: nothing is led anywhere."""

    def both(run: Runner) -> None:
        run.supervisors[0].guard.trip("first", "park")
        run.rig.obey_stop("lower", Request())  # type: ignore[arg-type]

    ended, run = tripped(both, on_trip="park")
    assert ended.parked == []
    assert are_off(run)


def test_a_file_that_parks_without_a_pose_is_refused() -> None:
    """By its check with the line, and by the run."""
    text = print_robot(msgspec.structs.replace(hubo_leg(), reactions={"silent": "park"}))
    _, problems = parse_robot(text)
    assert "reactions.silent: the file names no pose to park in" in " ".join(map(str, problems))
    with pytest.raises(CallerError, match="names no pose to park in"):
        run_virtual(hubo_leg(), [bend], on_trip="park")


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
