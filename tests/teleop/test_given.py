"""Set-points from outside a run: checked as a whole, held to limits, and a dead-man."""

from __future__ import annotations

import math
from typing import Any, cast

import pytest

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.robot import parse_robot, run_virtual
from aces_lab.teleop.given import GivenSetpoints, commanded
from tests.robot.leg import ROBOT

MS = 1_000_000


def given() -> GivenSetpoints:
    made = GivenSetpoints("hand", ["HIP", "LW.velocity"], rate_hz=100)
    made.bind(cast(Any, {"HIP": {0: 0.25}}))
    made.start(0)
    return made


def test_the_newest_is_passed_on_while_it_comes() -> None:
    """And nothing before the first; a healthy controller that has nothing is idle."""
    made = given()
    assert made.step(0) == {}
    assert made.is_idle
    made.give({"HIP": 0.5, "LW.velocity": 1.0})
    assert made.step(10 * MS) == {"HIP": 0.5, "LW.velocity": 1.0}
    made.give({"HIP": 0.6})
    assert made.step(400 * MS) == {"HIP": 0.6, "LW.velocity": 1.0}
    assert made.step(900 * MS) == {"HIP": 0.6, "LW.velocity": 1.0}
    assert not made.is_idle


def test_silence_ends_the_motion() -> None:
    """Positions are held where they are measured, speeds become 0; then it is idle until something is given."""
    made = given()
    made.give({"HIP": 0.5, "LW.velocity": 1.0})
    made.step(0)
    assert made.step(501 * MS) == {"HIP": 0.25, "LW.velocity": 0.0}
    assert made.step(510 * MS) == {}
    assert (made.is_idle, made.lapses) == (True, 1)
    made.give({"HIP": 0.1})
    assert made.step(520 * MS) == {"HIP": 0.1}


def test_release_ends_the_motion_at_once() -> None:
    """As the dead-man does."""
    made = given()
    made.give({"HIP": 0.5})
    made.step(0)
    made.release()
    assert made.step(10 * MS) == {"HIP": 0.25}
    made.release()
    assert made.step(20 * MS) == {}


def test_what_is_wrong_is_refused_whole() -> None:
    """A joint that is not its own, NaN and infinities."""
    made = given()
    with pytest.raises(UnknownNameError, match="KNEE"):
        made.give({"HIP": 0.5, "KNEE": 0.1})
    for value in (math.nan, math.inf):
        with pytest.raises(CallerError, match="not a finite number"):
            made.give({"LW.velocity": 1.0, "HIP": value})
    assert made.step(0) == {}


def test_a_run_leads_and_stops_what_is_given() -> None:
    """At the joint's rate, no further than its limits, and to a stand when nothing comes."""
    robot, problems = parse_robot(ROBOT)
    assert robot is not None, problems
    hand = GivenSetpoints("hand", commanded(robot, ["ROLL"]).values(), rate_hz=200)
    with run_virtual(robot, [hand]) as run:
        run.do("enable")
        run.start()
        for _ in range(10):
            hand.give({"ROLL": 5.0})
            run.clock.wait(lambda: False, 50 * MS)
        assert run.rig.signals["ROLL.position"].value == pytest.approx(0.75, abs=0.01)
        for _ in range(2):
            hand.give({"ROLL": -0.5})
            run.clock.wait(lambda: False, 20 * MS)
        run.clock.wait(lambda: False, 1000 * MS)
        assert hand.lapses == 1
        assert hand.is_idle
        assert not run.stopped
    with pytest.raises(UnknownNameError, match="TAIL"):
        commanded(robot, ["TAIL"])
