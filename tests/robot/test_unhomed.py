"""A joint that is not homed does not know where it is, and is not driven."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from msgspec.structs import replace

from aces_bus import load_robot
from aces_bus.controller import controller
from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_bus.robot import VirtualRobot, run_virtual

KNEE = "RKN"


def knee() -> Robot:
    """The board of a right knee."""
    return load_robot("hubo2plus").part(KNEE)


@controller(rate_hz=100, writes=[KNEE])
def bend(t: float) -> Mapping[str, float]:
    """Bend slowly."""
    return {KNEE: 0.2 * t}


def powered(robot: Robot, *, homed: bool = False) -> VirtualRobot:
    """As after power-up, with the knee bent."""
    return VirtualRobot(robot, rate_hz=100, homed=homed, pose={KNEE: 0.5})


def where(virtual: VirtualRobot) -> float:
    """Where the knee truly is."""
    return float(virtual.simulation.world.joints[KNEE].position(virtual.clock.now()))


def test_a_joint_that_is_not_homed_takes_no_set_point() -> None:
    """It says 0 where it is 0.5 rad: a set-point is refused with what to do, and nothing moves; homed it is taken."""
    with powered(knee()) as virtual:
        virtual.advance(1.5)
        assert virtual.rig[KNEE].value == pytest.approx(0.0, abs=1e-3)
        assert virtual.rig.door.unhomed == [KNEE]
        board = virtual.rig.device(KNEE)
        board.enable().wait(10)  # type: ignore[attr-defined]
        with pytest.raises(CallerError, match=r"RKN\.position: is not homed, .*: home it first"):
            virtual.rig[KNEE].set(0.3)
        virtual.advance(1.0)
        assert where(virtual) == pytest.approx(0.5, abs=0.01)
        board.home().wait(60)  # type: ignore[attr-defined]
        virtual.advance(5.0)
        assert virtual.rig.door.unhomed == []
        virtual.rig[KNEE].set(0.3)
        virtual.advance(2.0)
        assert where(virtual) == pytest.approx(0.3, abs=0.02)


def test_a_set_point_waits_until_it_is_known_whether_the_joint_is_homed() -> None:
    """Given before the board has said anything, a set-point does not move an un-homed joint, then it is dropped."""
    with powered(knee()) as virtual:
        virtual.rig[KNEE].set(0.3)
        virtual.rig.device(KNEE).enable()  # type: ignore[attr-defined]
        virtual.advance(4.0)
        assert where(virtual) == pytest.approx(0.5, abs=0.01)
        assert virtual.rig.door.goals == {}


def test_a_controller_of_an_unhomed_joint_is_stopped() -> None:
    """The fault is named; a run that allows it drives the joint, and so does a file that needs no homing."""
    with run_virtual(powered(knee()), [bend]) as run:
        run.do("enable")
        assert run.unhomed == [KNEE]
        ended = run.run(2.0)
    assert "not homed: RKN.position: is not homed" in ended.tripped["bend"]
    assert ended.not_stopped == {}
    joints = {name: replace(joint, needs_homing=False) for name, joint in knee().joints.items()}
    for virtual, unhomed in ((powered(knee()), True), (powered(replace(knee(), joints=joints)), False)):
        with run_virtual(virtual, [bend], unhomed=unhomed) as run:
            run.do("enable")
            assert run.unhomed == []
            assert run.run(1.0).tripped == {}


def test_twins_are_homed_at_first() -> None:
    """A simulated robot stands as after a home search: its joints say where they are."""
    with powered(knee(), homed=True) as virtual:
        virtual.advance(1.5)
        assert virtual.rig[KNEE].value == pytest.approx(0.5, abs=1e-3)
        assert virtual.rig.door.unhomed == []
