"""What a robot's file, or a run, says of states, devices, buses and controllers: estimators, histories, periods, rates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from aces_bus import load_robot
from aces_bus.access import UdpStates
from aces_bus.controller import controller
from aces_bus.device import Robot
from aces_bus.errors import AcesError, CallerError, UnknownNameError
from aces_bus.robot import VirtualRobot, parse_robot, run_virtual
from aces_bus.robot.file import print_robot
from aces_bus.state import Kalman
from tests.device.fan import ROBOT, drivers, robot_of

MS = 1_000_000


def fans(more: str = "") -> Robot:
    return robot_of(f"{ROBOT}\n{more}")


def leg(more: str = "") -> Robot:
    """The right leg of Hubo 2+, and what its file says more."""
    return robot_of(f"{print_robot(load_robot('hubo2plus').part('RHP'))}\n{more}")


def ahead() -> Any:
    """Looks 20 ms into the future, as the paper's estimated states can be asked."""

    @controller(name="ahead", rate_hz=100, writes=["RHP"])
    def look(RHP: Any, t: float) -> Mapping[str, float]:
        return {"RHP": 0.0 * RHP[0.02] + 0.1 * t}

    return look


def asked(robot: VirtualRobot, seconds: float) -> dict[str, int]:
    """How many requests each twin gets in that time."""
    before = {name: twin.requests for name, twin in robot.twins.items()}
    robot.advance(seconds)
    return {name: twin.requests - before[name] for name, twin in robot.twins.items()}


# ---------------------------------------------------------------------- states in a run


@pytest.mark.parametrize(
    "said",
    [
        'RHP = { estimator = "velocity" }',
        '"RHP.position" = { estimator = "acceleration" }',
        "RHP = { kalman = { measurement_std = 0.001, process_density = 10 } }",
    ],
)
def test_a_declared_estimator_looks_ahead(said: str) -> None:
    """`RHP[0.02]` in a controller is a number, whichever estimator the file declares."""
    with run_virtual(leg(f"[states]\n{said}"), [ahead()], rate_hz=100) as run:
        run.do("enable")
        ended = run.run(1.0)
    assert (ended.tripped, run.set_points) == ({}, 101)
    assert run.states["RHP"][0.05] > run.states["RHP"].last > 0.05


def test_an_estimator_comes_from_a_program_too() -> None:
    """What a run is given has precedence over the file, key by key."""
    declared = {"RHP": {"estimator": Kalman(0.001, 10.0), "interpolation": "cubic"}}
    robot = leg('[states]\nRHP = { estimator = "hold", history = 77 }')
    with run_virtual(robot, [ahead()], rate_hz=100, states=declared) as run:
        run.do("enable")
        assert run.run(0.2).tripped == {}
        assert (run.states["RHP"].history, run.states["RHP"].order) == (77, 3)
        assert run.states["RHP.velocity"].history == 512


def test_without_an_estimator_the_future_is_an_error_with_a_way_out() -> None:
    """The controller is stopped at its first step; the message has controller, state, what was asked, and what to write."""
    with run_virtual(leg(), [ahead()], rate_hz=100) as run:
        run.do("enable")
        ended = run.run(1.0)
    reason = ended.tripped["ahead"]
    assert run.set_points == 0
    assert ended.seconds < 0.1
    for part in (
        "ahead",
        "'RHP.position'",
        "+0.02 s",
        '[states] "RHP.position" = { estimator = "velocity" }',
    ):
        assert part in reason


def test_a_history_that_is_still_too_short_is_waited_for() -> None:
    """A past that the history will reach is not an error at the start; one that it never will is."""

    def past(seconds: float) -> Any:
        @controller(name="past", rate_hz=100, states=["A.left"], writes=["A.left"])
        def law(states: Any) -> Mapping[str, float]:
            return {"A.left": 100.0 + 0.0 * states["A.left"][-seconds]}

        return law

    def ended(seconds: float) -> tuple[int, dict[str, str]]:
        declared = {"A.left": {"history": 50}}
        with run_virtual(fans(), [past(seconds)], load=drivers, states=declared) as run:
            found = run.run(2.0)
            return run.set_points, found.tripped

    given, tripped = ended(0.3)
    assert given > 150
    assert tripped == {}
    given, tripped = ended(0.9)
    assert given == 0
    assert "history" in tripped["past"]


def test_a_history_in_seconds_knows_how_often_its_device_is_asked() -> None:
    """`history_s` alone is enough on a robot: the period is that of the bus, or of the state."""
    text = '[states]\n"A.left" = { history_s = 2.0 }\n"B.left" = { history_s = 2.0, period_s = 0.05 }'
    with run_virtual(fans(text), [], load=drivers) as run:
        assert (run.states["A.left"].history, run.states["B.left"].history) == (201, 41)
        assert run.states["B.left"].period_s == 0.05


# ---------------------------------------------------------------------- asking


def test_a_period_is_how_often_a_device_is_asked() -> None:
    """Only who gives the state is asked less often, and its values stay fresh for five periods; the shortest counts."""
    text = '[states]\n"A.left" = { period_s = 0.1 }\n"A.right" = { period_s = 0.2 }'
    with VirtualRobot(fans(text), rate_hz=100, load=drivers) as robot:
        robot.advance(0.5)
        assert asked(robot, 2.0) == {"A": 20, "B": 200}
        assert robot["A.temperature"].stale_after_ns == 500 * MS
        assert robot["B.temperature"].stale_after_ns == 100 * MS
        assert not robot["A.left"].is_stale


def test_a_period_that_cannot_be_is_refused() -> None:
    """More often than the bus asks; of what is not asked for."""
    with pytest.raises(CallerError, match=r"A\.left: a period of 0\.001 s, but bus line asks every 0\.01 s"):
        VirtualRobot(fans('[states]\n"A.left" = { period_s = 0.001 }'), rate_hz=100, load=drivers)
    with pytest.raises(CallerError, match=r"RHP\.duty: a period of 1 s, but JMC1 is not asked for it"):
        VirtualRobot(robot_of(MOTOR + '[states]\n"RHP.duty" = { period_s = 1 }'), rate_hz=100)


MOTOR = """
name = "motor"
[buses]
can = { link = "can", protocol = "hubo", dialect = "D12" }
[devices]
JMC1 = { driver = "hubo_motor", bus = "can", credentials = { board = 1 }, channels = 2 }
[joints]
RHP = { device = "JMC1", command = "duty", gear = [1, 1], harmonic = 100, encoder = 4000 }
"""


@pytest.mark.slow
def test_refresh_asks_the_device_with_the_next_tick() -> None:
    """Once for what the same message gives, and not again before it has answered; others are not asked."""
    text = '[states]\n"A.left" = { period_s = 60 }\n"B.left" = { period_s = 60 }'
    with run_virtual(fans(text), [], load=drivers) as run:
        twins, states = run.world.twins, run.states
        run.world.advance(0.1)
        before = twins["A"].requests, twins["B"].requests
        states["A.left"].refresh()
        states["A.temperature"].refresh()
        run.world.advance(0.05)
        assert (twins["A"].requests, twins["B"].requests) == (before[0] + 1, before[1])
        assert (states["A.left"].age_s or 1.0) < 0.06
        states["B.right"].refresh()
        run.world.advance(0.05)
        assert twins["B"].requests == before[1] + 1


def test_smp_asks_the_device() -> None:
    """UDP's `SMP` goes down to the bus."""
    import socket

    text = '[states]\n"A.left" = { period_s = 60 }\n"B.left" = { period_s = 60 }'
    with run_virtual(fans(text), [], load=drivers) as run:
        run.world.advance(0.1)
        before = run.world.twins["A"].requests
        with UdpStates(run.states, {"A.left": 0}, clock=run.clock) as service:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
                client.sendto(b"SMP", ("127.0.0.1", service.ports["A.left"]))
            service.poll()
            run.world.advance(0.05)
        assert run.world.twins["A"].requests == before + 1


@pytest.mark.parametrize("name", ["hubo2plus", "minihubo_1", "drc_hubo", "hubo2"])
def test_whatever_is_polled_can_be_asked_for(name: str) -> None:
    """Each signal that a driver reads from an answer is asked for by `refresh`: no driver has forgotten which."""
    robot = VirtualRobot(load_robot(name), rate_hz=100)
    deaf = [
        whole
        for device in robot.devices.values()
        for whole in device.readable
        if device.polls and not device.polls_of(whole)
    ]
    # What comes with any answer, or only with those to a request of its own.
    assert {whole.partition(".")[2] for whole in deaf} <= {"errors"}


# ---------------------------------------------------------------------- names


@pytest.mark.parametrize("name", ["hubo2plus", "minihubo_1", "drc_hubo", "hubo2", "omnibot", "hubovia"])
def test_rig_and_states_resolve_the_same_names(name: str) -> None:
    """A joint's name, its aliases and each whole name are one signal, whoever is asked."""
    with run_virtual(load_robot(name), []) as run:
        robot = run.rig.robot
        names = [alias for joint in robot.joints.values() for alias in (joint.name, *joint.aliases)]
        for one in [*names, *run.rig.signals]:
            try:
                signal = run.rig[one]
            except AcesError as error:
                with pytest.raises(type(error)):
                    run.states[one]
            else:
                assert run.states[one].name == signal.name == run.rig.whole(one)
                assert run.states[one] is run.states[signal.name]


@pytest.mark.slow
def test_a_state_that_is_not_there_is_named() -> None:
    """A slip in a state's name is said when the robot is put together, with what there is."""
    with pytest.raises(UnknownNameError, match=r"'RHP\.positon'.*RHP\.position"):
        run_virtual(leg('[states]\n"RHP.positon" = { history = 9 }'), [])
    with pytest.raises(UnknownNameError, match=r"option of state RHP.*estimater"):
        run_virtual(leg(), [], states={"RHP": {"estimater": 1}})
    with pytest.raises(CallerError, match=r"RHP\.position and RHP are one state"):
        run_virtual(leg(), [], states={"RHP": {}, "RHP.position": {}})
    run_virtual(leg("[states]\nLHP = { history = 9 }"), [])  # of a board that is not active


# ---------------------------------------------------------------------- rates and priorities


def test_a_bus_and_a_device_have_rates_of_their_own() -> None:
    """The file's rate of a bus replaces the robot's; a device is asked and given set-points less often."""
    text = ROBOT.replace('protocol = "fan" }', 'protocol = "fan", rate_hz = 50 }')
    text = text.replace("{ node = 2 } }", "{ node = 2 }, rate_hz = 10 }")
    with VirtualRobot(robot_of(text), rate_hz=100, load=drivers) as robot:
        robot.advance(0.5)
        assert asked(robot, 2.0) == {"A": 100, "B": 20}
        assert robot["B.left"].stale_after_ns == 500 * MS
        for name in ("A", "B"):
            robot[f"{name}.left"].set(100.0)
            robot[f"{name}.right"].set(100.0)
        found = asked(robot, 2.0)  # requests and set-points
        assert found["A"] == pytest.approx(200, abs=2)
        assert found["B"] == pytest.approx(40, abs=2)


def test_who_has_priority_is_asked_when_time_is_short() -> None:
    """A tick that takes one poll asks the same device each time; without priorities they take turns."""

    def polls(priority: str) -> dict[str, int]:
        text = ROBOT.replace("{ node = 2 } }", f"{{ node = 2 }}{priority} }}")
        with VirtualRobot(robot_of(text), rate_hz=1000, budget=0.3, load=drivers) as robot:
            robot.advance(0.1)
            assert list(robot.rig.hosts["line"].members) == (["B", "A"] if priority else ["A", "B"])
            return asked(robot, 1.0)

    fair, first = polls(""), polls(", priority = 60")
    assert abs(fair["A"] - fair["B"]) <= 2
    assert first["B"] > 950
    assert first["A"] < 50


def test_a_controllers_rate_and_priority_are_the_files() -> None:
    """By its name; what was made for one rate refuses another."""

    @controller(name="swing", rate_hz=200, writes=["A.left"])
    def swing(dt: float) -> Mapping[str, float]:
        return {"A.left": 1000 * dt}

    robot = fans("[controllers]\nswing = { rate_hz = 50, priority = 45 }\nother = { rate_hz = 1 }")
    with run_virtual(robot, [swing], load=drivers) as run:
        run.run(1.0)
        (task,) = run.tasks.tasks
        assert (task.rate_hz, task.priority, task.ticks) == (50, 45, 51)
        assert run.given == {"A.left": 20.0}

    class Fixed:
        name, rate_hz, states = "swing", 200.0, ()
        __slots__ = ()

    with pytest.raises(
        CallerError, match="swing: the robot's file says 50 Hz, and it was made for 200 Hz only"
    ):
        run_virtual(robot, [Fixed()], load=drivers)  # type: ignore[list-item]


# ---------------------------------------------------------------------- the file


def test_what_is_wrong_in_a_file_is_said_with_its_line() -> None:
    """Estimators, owners, doubles, rates."""
    text = f"""{ROBOT.replace("{ node = 2 } }", "{ node = 2 }, rate_hz = 500 }")}
[states]
"A.left" = {{ estimator = "magic" }}
C = {{ history = 9 }}
"A.right" = {{ history = 9, history_s = 1 }}
"B.left" = {{ estimator = "hold", kalman = {{ measurement_std = 1 }}, interpolation = 12 }}
[controllers]
walk = {{ priority = 100 }}
"""
    _, problems = parse_robot(text)
    said = "\n".join(str(one) for one in problems if "installed" not in one.text)
    for part in (
        "devices.B.rate_hz: 500 Hz is more often than its bus ticks (100 Hz)",
        'states.A.left.estimator: expected "hold", "velocity" or "acceleration"',
        "states.C: no joint, sensor or device named 'C'",
        "states.A.right.history_s: the state has history too; give history or history_s",
        "states.B.left.kalman.process_density: is missing",
        'states.B.left.interpolation: expected "hold", "linear", "cubic" or an order from 0 to 9',
        "controllers.walk.priority: expected a whole number from 1 to 99",
    ):
        assert part in said.replace("'A.left'", "A.left").replace("'A.right'", "A.right").replace(
            "'B.left'", "B.left"
        ), said


def test_a_printed_robot_is_the_same_robot() -> None:
    """States, controllers, rates and priorities are written and read again."""
    text = ROBOT.replace('protocol = "fan" }', 'protocol = "fan", rate_hz = 50, priority = 60 }')
    robot = robot_of(
        text
        + """
[states]
"A.left" = { kalman = { measurement_std = 0.1, process_density = 2, model = "acceleration" }, interpolation = 3 }
"B.left" = { estimator = "hold", history_s = 2.5, period_s = 0.02, stale_after_s = 1 }
[controllers]
walk = { rate_hz = 50, priority = 45 }
"""
    )
    assert robot_of(print_robot(robot)) == robot
