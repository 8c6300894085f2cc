"""What faults lead to, row by row of the table in docs/running.md: what moves, after how long, what is said.

All in virtual time; `test_served_stops.py` has the same over a served bus, with twins in another process.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import nan
from typing import Any

import pytest

from aces_bus.controller import (
    IGNORE,
    Controller,
    Guard,
    Phase,
    Player,
    StateMachine,
    Supervisor,
    Trajectory,
    Transition,
    degrade,
    stop,
)
from aces_bus.controller.reactions import Reaction
from aces_bus.errors import NotStoppedError, UnknownNameError
from aces_bus.robot import Ended, Runner, run_virtual
from aces_bus.robot.checks import KINDS_OF_FAULTS
from tests.conftest import ROOT
from tests.robot.walking import CYCLE, FAULT_AT, HUBO, MS, Walk, hubo_leg, motors_are_off

#: From a fault that is received to the frames of the stop on the wire: the frame under way, and those of four boards.
AT_ONCE = MS


def board_is_on(run: Runner, name: str) -> bool:
    return any(channel.control_on for channel in run.world.twins[name].channels)


@dataclass
class Case:
    """What was run, and when the boards went off (ns of virtual time; None: they did not)."""

    run: Runner
    ended: Ended
    off_at: int | None
    #: When controllers were started (ns).
    began: int


def case(
    fault: Callable[[Runner], Any],
    controllers: list[Any] | None = None,
    *,
    seconds: float = 1.0,
    **options: Any,
) -> Case:
    """A leg swings, the fault happens, and the instant at which JMC2 switches off is noted."""
    run = run_virtual(hubo_leg(), controllers or [Walk(HUBO)], rate_hz=100, **options)
    noted: list[int] = []

    def look() -> None:
        if not board_is_on(run, "JMC2"):
            noted.append(run.clock.now())
            return
        run.clock.call_in(MS // 10, look)

    for one in controllers or run.supervisors:
        bare = getattr(one, "controller", one)
        if isinstance(bare, Walk):
            bare.clock = run.clock
    with run:
        run.do("enable")
        look()
        began = run.clock.now()
        run.clock.call_in(FAULT_AT, lambda: fault(run))
        ended = run.run(seconds)
    return Case(run, ended, noted[0] if noted else None, began)


# ---------------------------------------------------------------------- at once


class Slow(Walk):
    """One that is stepped once a second, and so would hear of a fault a second later."""

    def __init__(self) -> None:
        super().__init__(HUBO)
        self.rate_hz = 1.0


@pytest.mark.slow
def test_the_shortcut_does_not_wait_for_a_slow_controller() -> None:
    """A board that says nothing stops the others within a bus tick, although the controller runs once a second."""
    found = case(lambda run: run.world.twins["JMC1"].fault("silent"), [Slow()], seconds=3.0)
    silent = next(event for event in found.run.events if event.kind == "silent")
    assert found.off_at is not None
    assert found.off_at - silent.instant <= AT_ONCE
    assert "JMC1: silent" in found.ended.tripped["walk"]


def test_an_end_stops_before_it_waits_for_controllers() -> None:
    """When a controller's own end is reached, all boards have been told already."""
    sent: list[int] = []

    class Last(Walk):
        def stop(self, now: int) -> None:
            sent.append(run.rig.hosts["lower"].counts.sent - before)

    run = run_virtual(hubo_leg(), [Last(HUBO)], rate_hz=100)
    with run:
        run.do("enable")
        run.start()
        run.world.clock.advance(100 * MS)
        before = run.rig.hosts["lower"].counts.sent
        ended = run.stop()
    assert sent[0] >= 4
    assert ended.not_stopped == {}
    assert motors_are_off(run)


# ---------------------------------------------------------------------- hold


def test_what_is_enabled_after_the_stop_has_begun_is_stopped_too() -> None:
    """A controller's own end that enables a board again does not leave it on."""

    class Stubborn(Walk):
        def stop(self, now: int) -> None:
            run.clock.wait(lambda: motors_are_off(run), 1000 * MS)
            run.clock.wait(lambda: False, 100 * MS)  # all have said so
            run.rig.each("enable")
            assert run.clock.wait(lambda: board_is_on(run, "JMC2"), 1000 * MS)

    run: Runner = run_virtual(hubo_leg(), [Stubborn(HUBO)], rate_hz=100)
    with run:
        run.do("enable")
        ended = run.run(0.2)
    assert motors_are_off(run)
    assert ended.not_stopped == {}


@pytest.mark.slow
def test_hold_holds_until_the_run_is_over() -> None:
    """Declared as hold, a fault switches nothing off before the run's own end, and is said."""
    found = case(lambda run: run.world.twins["FT_RF"].fault("silent"), on_trip="hold", seconds=1.5)
    assert (found.ended.reason, found.ended.seconds) == ("", 1.5)
    assert "FT_RF: silent" in found.ended.tripped["walk"]
    assert found.off_at is not None
    assert found.off_at >= found.began + 1_500 * MS
    assert motors_are_off(found.run)


def test_what_is_held_gets_references_in_each_tick_and_does_not_move() -> None:
    """Between a trip and the end, board and joint stay where they are, on, with set-points in each bus tick."""
    run = run_virtual(hubo_leg(), [Walk(HUBO)], rate_hz=100, on_trip="hold")
    with run:
        run.do("enable")
        run.start()
        run.world.clock.advance(FAULT_AT)
        run.supervisors[0].guard.trip("by hand", "hold")
        run.world.clock.advance(20 * MS)
        assert run.held == {"walk": "by hand"}
        door, host = run.rig.door, run.rig.hosts["lower"]
        where, count = {name: door.given(name) for name in run.given}, host.counts.set_points
        run.world.clock.advance(500 * MS)
        assert {name: door.given(name) for name in run.given} == where
        assert host.counts.set_points - count >= 4 * 50
        assert all(board_is_on(run, f"JMC{number}") for number in range(4))
        run.release("walk")
        assert run.held == {}
        run.world.clock.advance(50 * MS)
        assert {name: door.given(name) for name in run.given} != where
        with pytest.raises(UnknownNameError, match="walk"):
            run.release("wlk")
    assert motors_are_off(run)


def test_a_hold_has_an_end_where_one_is_stated() -> None:
    """After `hold_s` what was held is switched off, and the run ends, with both reasons."""
    found = case(
        lambda run: run.world.twins["FT_RF"].fault("silent"), on_trip="hold", hold_s=0.3, seconds=5.0
    )
    silent = next(event for event in found.run.events if event.kind == "silent")
    assert found.off_at is not None
    assert 300 * MS <= found.off_at - silent.instant <= 300 * MS + AT_ONCE
    assert found.ended.tripped["walk"].endswith("; held for 0.3 s")
    assert found.ended.reason == "every controller was stopped"


def test_the_time_of_a_hold_ends_with_its_release() -> None:
    """The timer of a hold that was released stops nothing: neither the resumed run, nor a later hold before its own time."""
    run = run_virtual(hubo_leg(), [Walk(HUBO)], rate_hz=100, on_trip="hold", hold_s=0.3)
    with run:
        run.do("enable")
        run.start()
        run.world.clock.advance(FAULT_AT)
        guard = run.supervisors[0].guard
        guard.trip("by hand", "hold")
        run.world.clock.advance(100 * MS)
        run.release("walk")
        run.world.clock.advance(500 * MS)  # over the end of the first hold
        assert (guard.tripped, run.stopped) == (None, {})
        assert all(board_is_on(run, f"JMC{number}") for number in range(4))
        guard.trip("once more", "hold")
        run.world.clock.advance(100 * MS)
        run.release("walk")
        guard.trip("for good", "hold")
        run.world.clock.advance(250 * MS)  # over the end of the second hold, not of the third
        assert run.held == {"walk": "for good"}
        assert all(board_is_on(run, f"JMC{number}") for number in range(4))
        run.world.clock.advance(100 * MS)
        assert run.stopped == {"walk": "for good; held for 0.3 s"}
        assert motors_are_off(run)


def test_a_controller_that_hangs_is_held_by_the_buses_thread() -> None:
    """Set-points of a hold do not come from the controller: one that is never stepped again is held all the same."""
    run = run_virtual(hubo_leg(), [Walk(HUBO)], rate_hz=100, on_trip="hold")
    with run:
        run.do("enable")
        run.start()
        run.world.clock.advance(FAULT_AT)
        run.supervisors[0].guard.trip("it hangs", "hold")
        run.world.clock.advance(20 * MS)
        run.tasks.stop()  # as if it never came back
        before = run.rig.hosts["lower"].counts.set_points
        run.world.clock.advance(100 * MS)
        assert run.rig.hosts["lower"].counts.set_points - before >= 4 * 9


@pytest.mark.slow
def test_a_run_may_leave_the_robot_held() -> None:
    """Asked for, the end switches nothing off and says who is left enabled; what a fault switched off stays off."""
    found = case(lambda run: None, at_end="hold", seconds=0.5)
    assert found.off_at is None
    assert found.ended.held == ["JMC0", "JMC1", "JMC2", "JMC3"]
    assert found.ended.tripped == {}
    assert found.ended.not_stopped == {}
    found = case(lambda run: run.world.twins["FT_RF"].fault("silent"), at_end="hold")
    assert found.ended.held == []
    assert motors_are_off(found.run)
    with run_virtual(hubo_leg(), [Walk(HUBO)], rate_hz=100, at_end="hold") as run:
        run.do("enable")  # and something goes wrong before it runs
    assert motors_are_off(run)


# ---------------------------------------------------------------------- reactions


@pytest.mark.slow
def test_reactions_of_the_robot_file_and_of_the_call() -> None:
    """`reactions` of the file count; those of the call go before; functions of one's own are called with the event."""
    from msgspec.structs import replace

    told: list[Any] = []

    def kneel(event: Any) -> None:
        told.append(event)

    robot = replace(hubo_leg(), reactions={"silent@FT_RF": "kneel", "silent": "hold"})
    for more, expected in (({}, {}), ({"silent": stop("disable")}, {"walk": "FT_RF: silent"})):
        run = run_virtual(robot, [Walk(HUBO)], rate_hz=100, own_reactions={"kneel": kneel}, reactions=more)
        run.supervisors[0].controller.clock = run.clock  # type: ignore[attr-defined]
        with run:
            run.do("enable")
            run.clock.call_in(FAULT_AT, lambda: run.world.twins["FT_RF"].fault("silent"))  # noqa: B023
            ended = run.run(0.8)
        assert {name: why[:13] for name, why in ended.tripped.items()} == expected
    assert [event.source for event in told] == ["FT_RF"]
    with pytest.raises(UnknownNameError, match="kneel"):
        run_virtual(robot, [Walk(HUBO)])


def test_words_of_reactions() -> None:
    """Each word is a reaction; who is named goes before all others; slips are errors with what there is."""
    found = Reaction.parse(
        {
            "silent": "disable",
            "silent@JMC1": "hold",
            "alarm": "degrade:soft",
            "lost": "ignore",
            "bug": "degrade",
        },
        kinds=KINDS_OF_FAULTS,
        sources=["JMC1"],
    )
    assert found == {
        "silent": (stop("hold", sources=["JMC1"]), stop("disable")),
        "alarm": (degrade("soft"),),
        "lost": (IGNORE,),
        "bug": (degrade("bug"),),
    }
    for wrong, near in (
        ({"sillent": "hold"}, "silent"),
        ({"silent": "hodl"}, "hold"),
        ({"silent@JMC9": "hold"}, "JMC1"),
    ):
        with pytest.raises(UnknownNameError, match=near):
            Reaction.parse(wrong, kinds=KINDS_OF_FAULTS, sources=["JMC1"])


# ---------------------------------------------------------------------- controllers


class Fails(Walk):
    """Swings, and after the fault does what a test says."""

    def __init__(self, then: Callable[[dict[str, float]], Mapping[str, float]]) -> None:
        super().__init__(HUBO)
        self.then, self.is_failing = then, False

    def step(self, now_ns: int) -> Mapping[str, float]:
        given = dict(super().step(now_ns))
        return self.then(given) if self.is_failing else given


def raises(given: dict[str, float]) -> Mapping[str, float]:
    raise ZeroDivisionError("by zero")


def fails(then: Callable[[dict[str, float]], Mapping[str, float]], **options: Any) -> Case:
    walk = Fails(then)

    def begin(run: Runner) -> None:
        walk.is_failing = True

    return case(begin, [walk], **options)


def test_a_controller_that_raises() -> None:
    """Its devices are off before the next tick; the exception is the reason."""
    found = fails(raises)
    assert found.off_at is not None
    assert "raised: ZeroDivisionError: by zero" in found.ended.tripped["walk"]
    assert found.off_at - next(e.instant for e in found.run.events if e.kind == "trip") <= AT_ONCE


@pytest.mark.parametrize("then", [dict.clear, lambda given: dict.fromkeys(given, nan)])
def test_a_controller_that_gives_nothing_or_no_numbers(then: Any) -> None:
    """Nothing, or nothing finite, for five periods and at least 0.1 s: it is taken for dead, or stopped before."""
    found = fails(lambda given: then(given) or {})
    assert found.off_at is not None
    trip = next(event for event in found.run.events if event.kind == "trip")
    assert found.off_at - trip.instant <= AT_ONCE
    assert found.ended.seconds <= 0.2 + 0.12 + 0.02


@pytest.mark.slow
def test_a_machine_that_waits_or_has_ended_is_alive() -> None:
    """Phases without set-points, and the final one, trip no dead-man: the joint stays where the phase before led it."""
    machine = StateMachine(
        "bend",
        rate_hz=100,
        phases=[
            Phase("bend", each="RKN[0] = 0.3"),
            Phase("wait", each="n += 1"),
            Phase("more", each="RKN[0] = 0.4"),
            Phase("end", final=True),
        ],
        table=[
            Transition("bend", "wait", after_s=0.3),
            Transition("wait", "more", after_s=0.5),
            Transition("more", "end", after_s=0.3),
        ],
        memory={"n": 0.0},
    )
    found = case(lambda run: None, [machine], seconds=2.0)
    assert found.ended.tripped == {}
    assert (machine.phase, found.ended.seconds) == ("end", 2.0)
    assert motors_are_off(found.run)


def test_a_player_that_ends_stays_where_it_is() -> None:
    """At its end a player gives its last row, until the run is over."""
    player = Player("p", Trajectory(["RKN"], [[0.0], [0.2]], rate_hz=10), rate_hz=100, approach=None)
    found = case(lambda run: None, [player], seconds=1.0)
    assert (player.mode, found.ended.tripped) == ("ended", {})
    assert found.run.given["RKN"] == pytest.approx(0.2)


@pytest.mark.slow
def test_one_controller_s_fault_is_that_controller_s() -> None:
    """Each has its own dead-man: when the arm's stops giving, the leg swings on."""

    class Arm(Controller):
        def step(self, now_ns: int) -> Mapping[str, float]:
            return {"RAR": 0.1} if self.seconds(now_ns) < 0.2 else {}

    leg = Walk(HUBO[:3])
    found = case(lambda run: None, [leg, Arm("arm", rate_hz=50, writes=["RAR"])], seconds=1.0)
    assert list(found.ended.tripped) == ["arm"]
    assert "no set-points for" in found.ended.tripped["arm"]
    assert found.ended.seconds == 1.0
    assert leg.last_step >= found.began + 1_000 * MS - 2 * CYCLE


# ---------------------------------------------------------------------- buses

#: Only what the host's own controller says last counts.
PASSIVE = {"error-passive": IGNORE}


def bus_off(run: Runner, seconds: float) -> None:
    """The host's controller leaves the bus, and comes back so much later."""
    node: Any = run.rig.hosts["lower"].port.node  # type: ignore[attr-defined]
    node.restart_ns = None
    for _ in range(40):
        node.count_errors(8, 0, None)
    run.clock.call_in(round(seconds * 1e9), node.restart)


def test_a_stop_that_found_the_bus_off_leaves_when_it_is_back() -> None:
    """The host is off the bus for half a second: boards are off, confirmed, as soon as it is back."""
    found = case(lambda run: bus_off(run, 0.5), seconds=3.0, reactions=PASSIVE)
    assert "lower: bus-off" in found.ended.tripped["walk"]
    assert found.ended.not_stopped == {}
    assert found.off_at is not None
    assert motors_are_off(found.run)


@pytest.mark.slow
def test_a_stop_that_was_not_confirmed_is_owed() -> None:
    """The bus is off for longer than a stop is repeated, and another controller runs on: the stop leaves when it is back."""

    class Other(Controller):
        def step(self, now_ns: int) -> Mapping[str, float]:
            return {}

    other = Supervisor(
        Other("other", rate_hz=10, writes=["RHY"]), Guard({}, period_s=0.1, dead_man_s=None), {"*": IGNORE}
    )
    found: list[bool] = []

    def fault(run: Runner) -> None:
        bus_off(run, 4.0)
        run.clock.call_in(4_500 * MS, lambda: found.append(motors_are_off(run)))

    ended = case(fault, [Walk(HUBO), other], seconds=5.0, reactions=PASSIVE).ended
    assert "bus-off" in ended.tripped["walk"]
    assert ended.not_stopped == {}
    assert found == [True]


@pytest.mark.slow
def test_a_bus_that_stays_off_is_said_with_all_names() -> None:
    """The end names every board that is not known to be off, within its bound, and raises where nobody reads it."""
    found = case(lambda run: bus_off(run, 60.0), seconds=3.0, reactions=PASSIVE)
    assert {"JMC0", "JMC1", "JMC2", "JMC3"} <= set(found.ended.not_stopped)
    assert found.ended.not_stopped["JMC1"].startswith("bus lower is bus-off: ")
    run = run_virtual(hubo_leg(), [Walk(HUBO)], rate_hz=100)
    run.supervisors[0].controller.clock = run.clock  # type: ignore[attr-defined]
    run.open()
    run.do("enable")
    run.start()
    run.world.clock.advance(FAULT_AT)
    bus_off(run, 60.0)
    run.world.clock.advance(10 * MS)
    with pytest.raises(NotStoppedError, match=r"NOT switched off: .*JMC1.*JMC2"):
        run.__exit__(None)


@pytest.mark.slow
def test_a_board_that_does_not_obey_is_named() -> None:
    """A board that answers and stays on has not stopped: its own status says so, and all others are off."""

    def deaf(run: Runner) -> None:
        for channel in run.world.twins["JMC2"].channels:
            channel.switch = lambda now, **_: None

    found = case(deaf, seconds=0.4)
    assert list(found.ended.not_stopped) == ["JMC2"]
    assert "is still on" in found.ended.not_stopped["JMC2"]
    assert not board_is_on(found.run, "JMC1")


#: Rows of the table in docs/running.md, and the tests that keep each: of this file, or of another (`FILES`).
ROWS = {
    "Ctrl-C, Ctrl-Z, Ctrl-\\, SIGTERM, SIGHUP, SIGUSR1, SIGXCPU …": ["served:test_signals"],
    "the time is up, all is played": [
        "test_a_player_that_ends_stays_where_it_is",
        "test_a_run_may_leave_the_robot_held",
    ],
    "a controller raises": ["test_a_controller_that_raises", "served:test_a_controller_that_fails"],
    "it gives nothing": [
        "test_a_controller_that_gives_nothing_or_no_numbers",
        "served:test_a_controller_that_fails",
    ],
    "it gives no finite numbers": [
        "test_a_controller_that_gives_nothing_or_no_numbers",
        "programs:test_nothing_but_numbers_that_are_none",
        "served:test_a_controller_that_fails",
    ],
    "its step blocks": [
        "test_a_controller_that_hangs_is_held_by_the_buses_thread",
        "served:test_a_controller_that_blocks",
    ],
    "it has finished (a player's end, a final phase)": [
        "test_a_machine_that_waits_or_has_ended_is_alive",
        "served:test_a_controller_that_finishes",
    ],
    "a board is silent": ["faults:test_a_silent_board", "served:test_a_silent_board"],
    "answers are lost: 1 %, each third of a board": [
        "faults:test_answers_that_are_lost",
        "served faults:test_answers_that_are_lost_or_late",
    ],
    "packets of a serial line are garbled (noise)": ["line:test_noise_stops_no_run"],
    "answers are late": [
        "faults:test_answers_that_are_late",
        "served faults:test_answers_that_are_lost_or_late",
    ],
    "two boards have one number": [
        "faults:test_two_boards_of_one_number",
        "served faults:test_a_board_that_misbehaves",
    ],
    "one of them does not receive any more": [
        "faults:test_one_of_two_boards_of_one_number_does_not_receive_any_more",
        "served faults:test_one_of_two_boards_does_not_answer_any_more",
    ],
    "a board answers with another's number": [
        "faults:test_a_board_with_anothers_number",
        "served faults:test_a_board_that_misbehaves",
    ],
    "a joint is blocked, its board reports it": ["faults:test_a_blocked_joint"],
    "a joint is blocked, no board reports it (D08)": [
        "ways:test_a_jam_that_a_d08_board_never_reports_is_found"
    ],
    "a sensor is at its end or has no value": [
        "faults:test_a_saturated_force_sensor",
        "faults:test_a_saturated_force_sensor_stops_by_default",
    ],
    "the controller keeps the interpreter for itself (200 ms)": [
        "served faults:test_a_controller_that_keeps_the_interpreter"
    ],
    "a second program would drive": ["served faults:test_a_second_master_is_refused"],
    "another program looks on": [
        "passive:test_a_run_looks_on_beside_a_master",
        "served faults:test_a_second_master_is_refused",
    ],
    "a board reboots": ["faults:test_a_board_that_reboots"],
    "a device reports an alarm": ["faults:test_a_saturated_force_sensor_stops_by_default"],
    "the host is bus-off, the cable is out": [
        "test_a_stop_that_found_the_bus_off_leaves_when_it_is_back",
        "test_a_bus_that_stays_off_is_said_with_all_names",
        "faults:test_a_cable_that_is_pulled",
        "served:test_bus_off_and_recovery",
    ],
    "a board does not obey": [
        "test_a_board_that_does_not_obey_is_named",
        "served:test_a_stop_that_is_not_confirmed",
        "served:test_not_switched_off",
    ],
    "a log cannot write": ["programs:test_a_full_disk"],
    "kill -9, power loss, a machine that hangs": ["served:test_kill_9_leaves_the_board_on"],
}
FILES = {
    "": "test_stopping_runs.py",
    "served": "test_served_stops.py",
    "served faults": "test_served_faults.py",
    "ways": "test_ways.py",
    "passive": "test_passive.py",
    "faults": "test_faults.py",
    "programs": "test_faults_of_programs.py",
    "line": "../devices/test_robotis_rx_line.py",
}


@pytest.mark.parametrize("row", ROWS)
def test_each_row_of_the_page_is_a_test(row: str) -> None:
    """The page has the row, and the tests that keep it are there."""
    page = ROOT / "docs" / "running.md"
    assert f"\n| {row} |" in page.read_text(encoding="utf-8")
    for name in ROWS[row]:
        file, _, test = name.rpartition(":")
        assert f"def {test}(" in (ROOT / "tests" / "robot" / FILES[file]).read_text(encoding="utf-8")
