"""Faults while walking, of devices and buses: what was declared happens, its reason is told in a cycle and ends the run."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.controller import IGNORE, degrade, stop
from aces_bus.hardware import Faults, Noise
from aces_bus.robot import Runner, VirtualRobot
from aces_bus.robot.rig import simulate
from tests.robot.walking import (
    CYCLE,
    HUBO,
    MINI,
    MS,
    Walk,
    hubo_leg,
    mini_leg,
    motors_are_off,
    second_of,
    stopped_in_time,
    walk_into,
)

# ---------------------------------------------------------------------- boards


def test_nothing_goes_wrong() -> None:
    """Without a fault the leg swings to the end of its time, and is stopped then."""
    ended, walk, look, run = walk_into(lambda run: None)
    assert (ended.reason, ended.tripped, ended.seconds) == ("", {}, 0.8)
    assert walk.told == []
    assert len(look.rows) == 81
    assert motors_are_off(run)


def test_a_silent_board() -> None:
    """A board that does not answer any more stops motion: three polls, then at once; the others are switched off."""
    ended, walk, look, run = walk_into(lambda run: run.world.twins["JMC1"].fault("silent"))
    event = stopped_in_time("silent", ended, walk, look)
    assert event.source == "JMC1"
    assert "JMC1: silent" in ended.tripped["walk"]
    assert 0.2 < ended.seconds < 0.5
    assert motors_are_off(run)


def test_a_silent_board_that_was_declared_to_matter_less() -> None:
    """Declared as a degradation, the same silence is told, named, and walked on with."""
    ended, walk, look, run = walk_into(
        lambda run: run.world.twins["FT_RF"].fault("silent"),
        walk=Walk(HUBO, "RFFT.mx"),
        reactions={"silent": (degrade("no compliance", sources=["FT_RF"]), stop())},
    )
    assert "silent" in walk.kinds()
    assert ended.tripped == {}
    assert run.supervisors[0].degraded == {"no compliance": "FT_RF: silent"}
    assert look.last_given() == look.rows[-1][0]
    assert run.states["RFFT.mx"][0] != 0.0  # unknown


def test_a_board_that_reboots() -> None:
    """A board that has forgotten that it was on is noticed, and motion stops: it would not follow."""
    ended, walk, look, run = walk_into(lambda run: run.world.twins["JMC2"].reboot(), seconds=4.0)
    event = stopped_in_time("rebooted", ended, walk, look)
    assert event.source == "JMC2"
    assert ended.seconds < 1.2
    assert motors_are_off(run)


def test_two_boards_of_one_number() -> None:
    """A second board of the same number is plugged in: two answers, named, and motion stops; neither is known to be off."""
    ended, walk, look, run = walk_into(lambda run: run.world.twins["JMC3"].fault("twice"))
    event = stopped_in_time("two devices", ended, walk, look)
    assert event.source == "JMC3"
    assert "two devices" in event.detail
    assert ended.not_stopped.keys() == {"JMC3"}
    assert "two devices answer as board 0x03" in ended.not_stopped["JMC3"]
    assert motors_are_off(run)


def test_one_of_two_boards_of_one_number_does_not_receive_any_more() -> None:
    """It moves on, and the other one says that it is off: the stop counts as not confirmed, for both were seen before."""
    seconds: list[Any] = []

    def second(run: Runner) -> None:
        seconds.append(second_of(run.world, "JMC3"))
        run.clock.call_in(100 * MS, lambda: seconds[0].fault("can_error"))

    ended, walk, _, run = walk_into(second, reactions={"two devices": IGNORE})
    assert (walk.kinds().count("two devices"), ended.tripped) == (1, {})
    assert ended.not_stopped.keys() == {"JMC3"}
    assert motors_are_off(run)
    assert all(channel.control_on for channel in seconds[0].channels)


def test_a_saturated_force_sensor() -> None:
    """Beyond its range a force sensor says nothing about the ground: compliance is given up, walking goes on."""
    walk = Walk(HUBO, "RFFT.mx")

    def stiff(event: Any) -> None:
        walk.compliance = 0.0

    def fall_on(run: Runner) -> None:
        run.world.twins["FT_RF"].feed = lambda now: (400.0, 0.0, 4000.0)

    ended, _, look, run = walk_into(
        fall_on, walk=walk, reactions={"alarm": (degrade("no compliance", stiff, sources=["FT_RF"]), stop())}
    )
    heard, event = next(one for one in walk.told if one[1].kind == "alarm")
    assert event.detail == "saturated"
    assert 0 <= heard - event.instant <= CYCLE
    assert ended.tripped == {}
    assert walk.compliance == 0.0
    assert run.supervisors[0].degraded == {"no compliance": "FT_RF: alarm"}
    # The moment that was measured before has moved the ankle, and moves it no more.
    after = [given for now, _, given in look.rows if now > heard + CYCLE]
    assert all(given["RAR"] == pytest.approx(given["RHR"]) for given in after)


def test_a_saturated_force_sensor_stops_by_default() -> None:
    """Where nobody has declared anything, an alarm stops motion."""

    def fall_on(run: Runner) -> None:
        run.world.twins["FT_RF"].feed = lambda now: (400.0, 0.0, 4000.0)

    ended, walk, look, run = walk_into(fall_on)
    assert stopped_in_time("alarm", ended, walk, look).source == "FT_RF"
    assert "saturated" in ended.tripped["walk"]
    assert motors_are_off(run)


# ---------------------------------------------------------------------- buses


def test_bus_off() -> None:
    """The bus goes off: motion stops, with the reason at the handler at once; the run closes what it can."""

    def errors(run: Runner) -> None:
        node = run.rig.hosts["lower"].port.node  # type: ignore[attr-defined]
        for _ in range(40):
            node.count_errors(8, 0, Frame(1))

    ended, walk, look, _ = walk_into(errors, reactions={"error-passive": IGNORE})
    event = stopped_in_time("bus-off", ended, walk, look)
    assert event.source == "lower"
    assert ended.seconds == pytest.approx(0.2, abs=0.02)


def babble(run: Runner) -> None:
    """Frames without a meaning: of a board, but too short; of no device; of all."""
    twins = next(iter(run.world.simulation.buses.values()))
    for number in range(50):
        run.clock.call_in(
            number * 3 * MS,
            lambda number=number: twins.send(Frame(0x061, b"\x01\x02\x03"[: number % 3])),  # type: ignore[misc]
        )
        run.clock.call_in(
            number * 3 * MS + MS,
            lambda number=number: twins.send(Frame(0x7F0 - number, b"?")),  # type: ignore[misc]
        )


def test_garbage_on_the_bus() -> None:
    """Frames that are none of a board's messages stop motion; each is counted, and nothing is taken for an angle."""
    ended, walk, look, run = walk_into(babble)
    event = stopped_in_time("malformed", ended, walk, look)
    assert event.source == "JMC1"
    assert motors_are_off(run)


@pytest.mark.slow
def test_garbage_that_was_declared_harmless() -> None:
    """Declared harmless, garbage is counted, and the leg swings on as if nothing had been heard."""
    plain = walk_into(lambda run: None)[2]
    ended, walk, look, run = walk_into(babble, reactions={"malformed": IGNORE, "unknown device": IGNORE})
    assert ended.tripped == {}
    assert "malformed" in walk.kinds()
    assert sum(run.rig.hosts["lower"].unknown.values()) == 100
    assert [given for _, _, given in look.rows] == [given for _, _, given in plain.rows]
    assert abs(run.states["RHP"].last - look.rows[-1][2]["RHP"]) < 0.1


def test_a_bus_that_loses_frames() -> None:
    """Frames that are lost, and frames that are destroyed and sent again, cost a poll each, and no step."""
    lossy = VirtualRobot(hubo_leg(), rate_hz=100, faults={"lower": Faults(seed=1, drop=0.02, corrupt=0.02)})
    ended, walk, look, run = walk_into(lambda run: None, lossy)
    assert ended.tripped == {}
    assert walk.told == []
    assert run.rig.hosts["lower"].counts.repeated > 0
    assert abs(run.states["RHP"].last - look.rows[-1][2]["RHP"]) < 0.1


@pytest.mark.parametrize("nth", [100, 3])
def test_answers_that_are_lost(nth: int) -> None:
    """Each hundredth answer of all boards lost, or each third of one: asked again a tick later, and no step is lost."""

    def lose(run: Runner) -> None:
        for name in ("JMC1",) if nth == 3 else ("JMC0", "JMC1", "JMC2", "JMC3"):
            run.world.twins[name].fault("loses", nth)

    ended, walk, look, run = walk_into(lose, seconds=1.5)
    assert ended.tripped == {}
    assert walk.told == []
    assert run.rig.hosts["lower"].counts.repeated > 0
    assert abs(run.states["RHP"].last - look.rows[-1][2]["RHP"]) < 0.1


def test_answers_that_are_late() -> None:
    """Answers of a board that are 50 ms late are reported, their values have the instant of receipt; motion goes on."""
    ended, walk, look, run = walk_into(lambda run: run.world.twins["JMC1"].fault("late"))
    assert ended.tripped == {}
    assert set(walk.kinds()) == {"late reply"}
    assert len(look.rows) == 81
    assert run.rig.hosts["lower"].counts.answered_late > 0


def test_a_blocked_joint() -> None:
    """A joint that does not turn saturates its drive: the board reports it, and motion stops."""
    ended, walk, look, run = walk_into(lambda run: run.world.twins["JMC1"].fault("jam"), seconds=3.0)
    event = stopped_in_time("alarm", ended, walk, look)
    assert (event.source, event.detail) == ("JMC1", "RHP: saturated")
    assert ended.seconds < 1.5
    assert motors_are_off(run)


def test_a_board_with_anothers_number() -> None:
    """A board that answers with its neighbour's number makes two of one: motion stops, and neither is known to be off."""
    ended, walk, look, run = walk_into(lambda run: run.world.twins["JMC1"].fault("wrong_number"))
    event = stopped_in_time("two devices", ended, walk, look)
    assert event.source == "JMC2"
    assert ended.not_stopped.keys() == {
        "JMC1",
        "JMC2",
    }  # both are, but JMC1 cannot say so, and may speak for JMC2
    assert motors_are_off(run)


@pytest.mark.parametrize("is_serial", [False, True])
def test_a_cable_that_is_pulled(is_serial: bool) -> None:
    """Behind a pulled cable all is silent: the first device that is noticed stops motion, and nothing hangs at the end."""

    def pull(run: Runner) -> None:
        port: Any = next(iter(run.rig.hosts.values())).port
        port.node.is_connected = False

    robot, joints = (mini_leg(), MINI) if is_serial else (hubo_leg(), HUBO)
    ended, walk, look, run = walk_into(pull, robot, Walk(joints))
    kind = walk.kinds()[0]
    assert kind in ("silent", "not sent", "error-passive", "bus-off")
    stopped_in_time(kind, ended, walk, look)
    assert ended.seconds < 0.5
    assert {name.partition(".")[0] for name in run.states.unknown} >= set(joints)
    # Whoever is behind the cable has not stopped, as far as anybody knows, and is named.
    on_it = {joint.device for joint in robot.joints.values()} & set(run.rig.devices)
    assert set(ended.not_stopped) == on_it
    assert len(ended.failed) == len(ended.not_stopped)


def test_a_servo_that_falls_silent() -> None:
    """On a serial line, where all others wait for it, a silent servo stops motion as well."""
    ended, walk, look, _ = walk_into(
        lambda run: run.world.twins["S96"].fault("silent"), mini_leg(), Walk(MINI)
    )
    event = stopped_in_time("silent", ended, walk, look)
    assert event.source == "S96"
    assert ended.seconds < 0.5
    (text,) = ended.failed  # who does not answer cannot be told to stop
    assert text.startswith("S96: servos S96: no answer")
    assert list(ended.not_stopped) == ["S96"]


def test_a_servo_that_reboots() -> None:
    """A servo whose torque is off again is found when its health is read, once a second; motion stops, and names it."""
    ended, walk, look, _ = walk_into(
        lambda run: run.world.twins["S96"].reboot(), mini_leg(), Walk(MINI), seconds=4.0
    )
    assert stopped_in_time("rebooted", ended, walk, look).source == "S96"
    assert ended.seconds < 1.4


def test_two_servos_of_one_number() -> None:
    """Two servos of one id answer into each other: it is silent, motion stops, and all others are stopped for sure."""

    def second(run: Runner) -> None:
        robot: VirtualRobot = run.world
        other = simulate(mini_leg(), robot.ports("second"))
        for name in ("S83", "S78"):
            other.buses["servos"].remove(name)
        other.open()

    ended, walk, look, _ = walk_into(second, mini_leg(), Walk(MINI))
    assert {event.source for _, event in walk.told} == {"S96"}
    assert walk.kinds() == ["garbled", "silent"]
    stopped_in_time("silent", ended, walk, look)
    # The others' answers are not taken for the rest of a garbled one.
    assert list(ended.not_stopped) == ["S96"]


@pytest.mark.parametrize("flip", [0.0005, 0.002])
def test_noise_on_a_serial_line(flip: float) -> None:
    """What noise garbles is reported with the servo that was asked, is asked again, and stops nothing: the servos follow."""
    line = VirtualRobot(mini_leg(), rate_hz=100, noise={"servos": Noise(seed=1, flip=flip)})
    ended, walk, look, run = walk_into(lambda run: None, line, Walk(MINI))
    assert ended.tripped == {}
    assert set(walk.kinds()) == {"garbled"}
    assert {event.source for _, event in walk.told} <= set(run.rig.devices)
    assert abs(run.states["RKP"].last - look.rows[-1][2]["RKP"]) < 0.15
