"""Ways that set-points are led: what is heard of any mixture of writers, who owns a signal, where ways begin, jams."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus import load_robot
from aces_bus.errors import CallerError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, parse_robot, run_virtual
from tests.robot.leg import COUNTS, JOINTS, RATE, ROBOT, WRITERS, Leg, Wish, check_sent, count_of

# ---------------------------------------------------------------------- any of them, in any order

wishes = st.floats(-3.0, 3.0) | st.sampled_from([900.0, -900.0, math.nan, math.inf, 0.0])
writes = st.tuples(
    st.sampled_from(WRITERS), st.sampled_from(tuple(JOINTS)), wishes, st.sampled_from([0, 1, 3, 5, 40, 300])
)


@pytest.mark.slow
@settings(max_examples=25)
@given(st.lists(writes, min_size=1, max_size=12), st.sampled_from(["", "", "disable", "reboot", "can_error"]))
def test_nothing_on_the_bus_passes_a_limit_or_a_rate(drawn: list[Any], trouble: str) -> None:
    """Whoever writes what and when, and whatever happens to a board meanwhile: each frame is within limits and rate."""
    with Leg() as leg:
        for number, (writer, joint, value, wait_ms) in enumerate(drawn):
            leg.write(writer, joint, value)
            leg.pass_time(wait_ms / 1e3)
            if number == len(drawn) // 2 and trouble:
                twin, board = leg.run.world.twins["JMC0"], leg.run.rig.devices["JMC0"]
                if trouble == "disable":
                    leg.run.do("disable")
                    leg.pass_time(0.2)
                elif trouble == "reboot":
                    twin.power(False)
                    leg.pass_time(0.1)
                    twin.power(True)
                    leg.pass_time(0.2)
                else:
                    twin.fault(trouble)
                    leg.pass_time(0.1)
                    twin.fault(trouble, on=False)
                leg.run.rig.each("enable", [board])
                leg.pass_time(0.1)
        leg.pass_time(1.0)
        assert check_sent(leg) > 0


# ---------------------------------------------------------------------- owners


def test_two_controllers_of_one_signal_are_refused_by_name() -> None:
    """At configuration, whatever name each has for it: an error names both and the signal."""
    robot, _ = parse_robot(ROBOT)
    assert robot is not None
    for name in ("HIP", "HIP2", "HIP.position"):
        run = run_virtual(robot, [Wish("walk", ("HIP", "KNEE")), Wish("arm", (name,))])
        with pytest.raises(CallerError, match=r"^HIP\.position: walk and arm both give its set-points"):
            run.bind()


def test_an_owner_that_gives_up_makes_room() -> None:
    """A service that is closed owns nothing any more."""
    with Leg() as leg:
        leg.write("udp", "HIP", 0.2)
        assert leg.run.rig.door.owners == {"HIP.position": "udp"}
        leg.write("zenoh", "HIP", 0.3)
        assert leg.refused == [
            "'HIP': HIP.position: udp and zenoh both give its set-points; one of them must not"
        ]
        leg.write("script", "HIP", 0.3)
        assert leg.refused[0] == "HIP.position: udp gives its set-points; nothing else can while it does"
        leg.udp.close()
        leg.write("zenoh", "HIP", 0.3)
        assert leg.run.rig.door.owners == {"HIP.position": "zenoh"}


# ---------------------------------------------------------------------- what a way begins with, and how it ends


def test_what_a_device_dropped_is_not_gone_on_with() -> None:
    """A joint that was switched off on its way, and enabled again, stays where it is; the next way begins there."""
    with Leg() as leg:
        leg.writers["script"]("HIP", 1.0)
        leg.pass_time(0.1)
        leg.run.do("disable")
        leg.run.do("enable")
        leg.pass_time(0.5)
        here = leg.sent("HIP")[-1][1]
        assert here < 0.6
        leg.write("script", "HIP", -0.2)
        leg.pass_time(1.0)
        assert check_sent(leg) > 100
        assert leg.sent("HIP")[-1][1] == pytest.approx(-0.2, abs=2 / COUNTS)


def test_a_goal_waits_until_it_is_known_where_the_joint_is() -> None:
    """Nothing is sent to a joint whose position is not known; it begins when that is."""
    robot, _ = parse_robot(ROBOT)
    assert robot is not None
    with VirtualRobot(robot, rate_hz=200) as world:
        board = world.devices["JMC0"]
        world.advance(1.0)
        board.enable().wait(5)
        world.twins["JMC0"].fault("silent")
        world.advance(0.3)
        world["HIP"].set(0.5)
        world.advance(0.1)
        assert world.rig.door.goals == {"HIP.position": 0.5}
        assert any("waits until it is known" in event.detail for event in world.events.of("limited"))
        world.twins["JMC0"].fault("silent", on=False)
        world.advance(1.0)
        assert world.rig.door.goals == {}
        assert world["HIP"].value == pytest.approx(0.5, abs=0.01)


def test_a_bus_without_ticks_leads_there_too() -> None:
    """Without a rate the way is taken in steps of 10 ms, and what has arrived is silent."""
    robot, _ = parse_robot(ROBOT)
    assert robot is not None
    world = VirtualRobot(robot, rate_hz=0)
    heard = ListeningNode(world.wires["can"])
    with world:
        world.rig.hosts["can"].poll()
        world.advance(1.0)
        board = world.devices["JMC1"]
        board.enable().wait(5)
        world.rig.hosts["can"].poll()
        world.advance(0.01)
        world["KNEE"].set(0.5)
        world.advance(1.0)
        count = len(heard.received)
        world.advance(1.0)
        assert len(heard.received) == count
    sent = [count_of(f.data, 0) / COUNTS for _, f in heard.received if f.arbitration_id == 0x011]
    assert len(sent) > 20
    assert max(abs(after - before) for before, after in pairwise(sent)) <= RATE * 0.01 + 2 / COUNTS
    assert -sent[-1] - 0.1 + 0.2 == pytest.approx(0.5 + 0.1, abs=0.11)


@pytest.mark.parametrize("joint", ["J", ""], ids=["a joint", "no joint"])
def test_where_no_file_states_a_speed_it_is_led_all_the_same(joint: str) -> None:
    """1 rad/s, for a joint without `max_speed` and for a servo that is not a joint: after 0.5 s half a radian is left."""
    text = """
name = "bench"
rate_hz = 50
[buses]
line = { link = "serial", protocol = "robotis" }
[devices]
S1 = { driver = "robotis_rx", bus = "line", credentials = { id = 1 } }
"""
    robot, _ = parse_robot(text + ('[joints]\nJ = { device = "S1" }\n' if joint else ""))
    assert robot is not None
    with VirtualRobot(robot, rate_hz=50) as world:
        world.advance(0.3)
        world.devices["S1"].enable().wait()
        world.advance(0.1)
        servo = world[f"{joint or 'S1'}.position"]
        before = servo.value
        servo.set(before + 1.0)
        world.advance(0.02)
        assert abs(world.rig.door.goals[servo.name] - before) == pytest.approx(1.0)
        world.advance(0.48)
        assert servo.value - before == pytest.approx(0.5, abs=0.1)


# ---------------------------------------------------------------------- following


def test_a_jam_that_a_d08_board_never_reports_is_found() -> None:
    """The older firmware has no error bits: the encoder alone tells, within 2 s, whoever drives."""
    robot = load_robot("hubo2").part("RKP")
    with VirtualRobot(robot, rate_hz=100) as world:
        name = robot.joints["RKP"].device
        world.advance(1.0)
        world.devices[name].enable().wait(10)
        world.advance(1.0)
        world.twins[name].fault("jam", robot.joints["RKP"].channel + 1)
        here = world["RKP"].value
        world["RKP"].set(here + 0.6)
        world.advance(2.0)
        (event,) = world.events.of("following error")
        assert event.detail.startswith("RKP.position stays at ")
        assert not world.devices[name].is_driven
        with pytest.raises(CallerError, match="takes no set-points until it is released"):
            world["RKP"].set(here)
        world.rig.door.release()
        world["RKP"].set(here)


def test_a_virtual_robot_has_the_rate_of_its_file() -> None:
    """Not said twice: it polls as a run does; 0 is not ticks, and any other rate replaces the file's."""
    robot = load_robot("hubo2plus").part("RKN")
    assert robot.rate_hz is not None
    assert VirtualRobot(robot).rig.hosts["lower"].rate_hz == robot.rate_hz
    assert VirtualRobot(robot, rate_hz=50).rig.hosts["lower"].rate_hz == 50
    assert VirtualRobot(robot, rate_hz=0).rig.hosts["lower"].rate_hz is None
    with VirtualRobot(robot) as virtual:
        virtual.advance(0.1)
        assert virtual["RKN"].value is not None
