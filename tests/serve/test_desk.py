"""Owners by joint: who gives set-points, what becomes of joints whose owner is gone."""

from __future__ import annotations

from typing import Any, cast

import pytest

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.robot import parse_robot, run_virtual
from aces_lab.serve.desk import Desk
from tests.robot.leg import ROBOT

MS = 1_000_000
WHOLE = ROBOT.replace("[buses]", "park = { pose = { HIP = 0.5, ROLL = 0.0 }, speed = 1.0 }\n[buses]")


def desk(**options: Any) -> Desk:
    """A desk of the leg, HIP at 0.25, started at 0."""
    robot, problems = parse_robot(WHOLE)
    assert robot is not None, problems
    made = Desk(robot, rate_hz=100, **options)
    made.bind(cast(Any, {"HIP": {0: 0.25}, "ROLL": {0: 0.0}, "KNEE": {0: 1.0}}))
    made.start(0)
    return made


def test_enabled_joints_are_held_where_they_are() -> None:
    """From the start, in each step, with and without an owner; of joints that are not enabled nothing is given."""
    made = desk()
    assert made.step(0) == {"HIP": 0.25, "ROLL": 0.0, "KNEE": 1.0}
    made.own("wave", ["HIP2"])  # an alias
    assert made.step(10 * MS) == {"HIP": 0.25, "ROLL": 0.0, "KNEE": 1.0}
    off = desk(is_enabled=False)
    assert off.step(0) == {}
    assert off.is_idle
    off.own("wave", ["HIP"])
    with pytest.raises(CallerError, match="HIP is not enabled: enable it first"):
        off.set("wave", {"HIP": 0.5})
    off.enabled(["HIP"])
    assert off.step(10 * MS) == {"HIP": 0.25}


def test_a_joint_has_one_owner() -> None:
    """A second one is refused by name, and gets none of what it asked for; nor are its set-points taken."""
    made = desk()
    made.own("wave", ["HIP"])
    with pytest.raises(CallerError, match="HIP is owned by wave, which can hand it over to grasp"):
        made.own("grasp", ["KNEE", "HIP"])
    assert made.owners == {"HIP": "wave"}
    with pytest.raises(CallerError, match="HIP is owned by wave, not by grasp"):
        made.set("grasp", {"HIP": 0.1})
    with pytest.raises(CallerError, match="KNEE is owned by nobody, not by grasp"):
        made.set("grasp", {"KNEE": 0.1})
    for names, why in (([], "no joint is named"), (["HIP", "HIP2"], "named twice")):
        with pytest.raises(CallerError, match=why):
            made.own("grasp", names)
    with pytest.raises(UnknownNameError, match="ELBOW"):
        made.own("grasp", ["ELBOW"])


def test_set_points_are_taken_whole() -> None:
    """One that is not finite, or another's, and none is."""
    made = desk()
    made.own("wave", ["HIP", "ROLL"])
    for value in (float("nan"), float("inf")):
        with pytest.raises(CallerError, match="not a finite number"):
            made.set("wave", {"HIP": 0.5, "ROLL": value})
    with pytest.raises(CallerError, match="KNEE"):
        made.set("wave", {"HIP": 0.5, "KNEE": 0.5})
    assert made.step(0)["HIP"] == 0.25
    made.set("wave", {"HIP": 0.5})
    made.set("wave", {"ROLL": 0.1})
    assert made.step(10 * MS) == {"HIP": 0.5, "ROLL": 0.1, "KNEE": 1.0}


def test_silence_frees_and_stands() -> None:
    """Where the joint is measured; set-points of other joints, and none at all, keep it."""
    said: list[str] = []
    made = desk(report=said.append)
    made.own("wave", ["HIP", "ROLL"])
    made.set("wave", {"HIP": 0.5})
    made.step(0)
    made.set("wave", {"ROLL": 0.1})
    made.step(400 * MS)
    made.set("wave", {})
    assert made.step(800 * MS)["HIP"] == 0.5
    assert made.step(1301 * MS)["HIP"] == 0.25
    assert made.owners == {}
    assert said == ["wave gave no set-points for 0.5 s: HIP, ROLL stand still, owned by nobody"]
    assert made.step(1310 * MS) == {"HIP": 0.25, "ROLL": 0.0, "KNEE": 1.0}
    assert not made.is_idle


def test_one_that_dies_frees_at_once() -> None:
    """A joint that it only owned keeps the set-point at which it stood: nothing creeps."""
    said: list[str] = []
    made = desk(report=said.append)
    made.step(0)
    made.own("wave", ["HIP", "KNEE"])
    made.set("wave", {"HIP": 0.9})
    made.step(10 * MS)
    cast(Any, made.bound)["KNEE"][0] = 0.99
    made.lost("wave", "is gone")
    assert made.step(20 * MS) == {"HIP": 0.25, "ROLL": 0.0, "KNEE": 1.0}
    made.own("grasp", ["HIP"])
    assert made.step(30 * MS)["HIP"] == 0.25
    assert said == ["wave is gone: HIP, KNEE stand still, owned by nobody"]


def test_handing_over_changes_no_set_point() -> None:
    """The next owner has the dead-man's time to give its first."""
    made = desk()
    made.own("wave", ["HIP"])
    made.set("wave", {"HIP": 0.5})
    made.step(0)
    with pytest.raises(CallerError, match="HIP is owned by wave, not by grasp"):
        made.hand_over("grasp", "wave", ["HIP"])
    with pytest.raises(CallerError, match="grasp owns no joint"):
        made.hand_over("grasp", "wave")
    assert made.hand_over("wave", "grasp") == ["HIP"]
    assert made.step(450 * MS)["HIP"] == 0.5
    with pytest.raises(CallerError, match="HIP is owned by grasp, not by wave"):
        made.set("wave", {"HIP": 0.6})
    made.set("grasp", {"HIP": 0.7})
    assert made.step(900 * MS)["HIP"] == 0.7
    made.free("grasp")
    assert made.step(910 * MS)["HIP"] == 0.25


def test_parking_leads_slowly_and_is_an_owner() -> None:
    """At the file's speed, whoever owned the joints; then they are nobody's, and held."""
    made = desk()
    made.step(0)
    made.own("wave", ["HIP"])
    made.set("wave", {"HIP": 0.9})
    made.step(10 * MS)
    assert made.park() == ["HIP", "ROLL"]
    with pytest.raises(CallerError, match="HIP is owned by parking"):
        made.own("wave", ["HIP"])
    steps = [made.step((n + 2) * 10 * MS)["HIP"] for n in range(40)]
    assert steps[:2] == pytest.approx([0.26, 0.27])
    assert steps[-1] == 0.5
    assert made.owners == {}
    with pytest.raises(CallerError, match="no joint that its file parks is enabled"):
        desk(is_enabled=False).park()


def test_a_stop_drops_everything() -> None:
    """Nothing is given until joints are enabled again."""
    made = desk()
    made.own("wave", ["HIP"])
    made.set("wave", {"HIP": 0.5})
    made.step(0)
    made.drop()
    assert made.step(10 * MS) == {}
    assert made.is_idle
    assert made.owners == {}
    made.enabled(["HIP"])
    assert made.step(20 * MS) == {"HIP": 0.25}


def test_a_declared_dead_man_reaches_the_supervisor() -> None:
    """With `reacts` a client's death is the fault "dead-man" of a run: here it switches all off."""
    robot, problems = parse_robot(WHOLE)
    assert robot is not None, problems
    made = Desk(robot, rate_hz=200, reacts=True)
    with run_virtual(robot, [made]) as run:
        run.do("enable")
        run.start()
        run.clock.wait(lambda: False, 20 * MS)
        made.own("wave", ["HIP"])
        made.set("wave", {"HIP": 0.2})
        run.clock.wait(lambda: False, 1000 * MS)
        ended = run.stop()
    assert "dead-man" in ended.tripped["serve"]
    assert "wave gave no set-points" in ended.tripped["serve"]


@pytest.mark.slow
def test_a_run_holds_and_leads_within_limits() -> None:
    """The leg is enabled and held; a client's set-points are led at the joint's rate, and clipped at its limits."""
    robot, problems = parse_robot(WHOLE)
    assert robot is not None, problems
    made = Desk(robot, rate_hz=200)
    with run_virtual(robot, [made]) as run:
        run.do("enable")
        run.start()
        run.clock.wait(lambda: False, 20 * MS)
        made.own("wave", ["ROLL"])
        for _ in range(20):
            made.set("wave", {"ROLL": 5.0})
            run.clock.wait(lambda: False, 100 * MS)
        assert run.states["ROLL"].last == pytest.approx(0.75, abs=0.01)
        made.lost("wave", "is gone")
        run.clock.wait(lambda: False, 3000 * MS)
        assert run.states["ROLL"].last == pytest.approx(0.75, abs=0.01)
        assert run.stopped == {}
        run.stop()
