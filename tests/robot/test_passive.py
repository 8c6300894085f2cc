"""A robot that is only listened to, beside one that drives it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import pytest
from msgspec.structs import replace

from aces_bus import load_robot
from aces_bus.controller import controller
from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError, DeviceError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, connect, open_gates, run_real
from aces_bus.runtime.loop import Loop
from tests.device.fan import ROBOT, drivers, robot_of


def beside(master: VirtualRobot, load: Any = None) -> Any:
    """A passive rig on the wires of another."""
    more = {} if load is None else {"load": load}
    return connect(master.robot, master.ports("looker"), rate_hz=100, passive=True, **more)


def test_it_sees_what_the_master_asks_and_sends_nothing() -> None:
    """Its signals are the master's, fresh; whatever is asked or set through it fails by name; the twins notice nothing."""
    with VirtualRobot(robot_of(ROBOT), rate_hz=50, load=drivers) as master:
        looker = beside(master, drivers)
        with looker:
            for name in ("A.left", "A.right"):
                master[name].set(100.0)
            master.advance(0.5)
            assert looker["A.left"].value == pytest.approx(100, abs=0.1)
            sent = looker.hosts["line"].counts
            assert (sent.sent, sent.polls) == (0, 0)
            requests = {name: twin.requests for name, twin in master.twins.items()}
            looker["A.left"].set(5.0)
            looker["A.right"].set(5.0)
            looker["B.left"].request()
            looker.hosts["line"].poll()
            looker.hosts["line"].tick()
            ticket = looker.devices["A"].ask("Ask", reply="State")
            master.advance(0.2)
            with pytest.raises(DeviceError, match="line A: Ask was not sent: this bus is only listened to"):
                ticket.wait()
            assert {name: twin.requests - requests[name] for name, twin in master.twins.items()} == {
                "A": 20,
                "B": 10,
            }
            assert looker["A.left"].value == pytest.approx(100, abs=0.1)
            assert {event.kind for event in looker.events.last} == {"not sent"}
        assert {event.kind for event in master.events.last} == set()


def test_an_answer_is_understood_by_anothers_question() -> None:
    """Hubo's replies that need their request are decoded, as the request was heard; nobody is said to answer twice."""
    robot = load_robot("hubo2plus").part("RHY", "RFFT")
    with VirtualRobot(robot, rate_hz=100) as master:
        looker = beside(master)
        with looker:
            master["RHY"].set(0.1)
            master.rig.each("enable")
            master.advance(1.0)
            for name in looker.signals:
                assert looker[name].last == master[name].last, name
            assert set(looker.hosts["lower"].unknown) == {"unknown"}  # what goes to the devices
            assert [event for event in looker.events.last if event.kind not in ("opened", "limited")] == []
        assert not looker.hosts["lower"].counts.sent


@pytest.mark.slow
def test_a_run_looks_on_beside_a_master() -> None:
    """A controller runs on what the master asks for; the run sends nothing, and ends without a stop."""
    robot = robot_of(ROBOT)
    options = {"interface": "aces", "channel": "test-passive", "bitrate": 500_000}
    seen: list[float] = []

    @controller(name="look", rate_hz=20, states=["A.left"], writes=["A.left"])
    def look(states: Any) -> Mapping[str, float]:
        seen.append(states["A.left"][0])
        return {"A.left": 300.0}

    from aces_bus.hardware import CanGate
    from aces_bus.hardware.ports import port_of
    from aces_bus.robot.rig import simulate

    with Loop() as loop, simulate(robot, {"line": port_of(CanGate(options), loop)}, load=drivers):
        ports = open_gates(robot, loop, {"line": options}, load=drivers)
        with connect(robot, ports, rate_hz=50, load=drivers) as master:
            run = run_real(robot, [look], buses={"line": options}, load=drivers)
            ended = run.run(20.0, until=lambda: len(seen) > 3)
            assert ended.reason == ""
            assert ended.tripped == {}
            assert run.rig.hosts["line"].counts.sent == 0
            assert master["A.left"].last == 0
    assert 0.0 in seen
    assert set(seen) <= {0.0, UNKNOWN}  # a slow machine may find it stale
    with pytest.raises(CallerError, match="transmit=True"):
        run_real(robot, [], buses={"line": options}, passive=True, transmit=True, load=drivers)


@pytest.mark.slow
def test_gates_of_a_looker_cannot_send_and_take_no_lock() -> None:
    """By construction; a serial line has one reader, so that a looker takes its lock, too."""
    if os.name != "posix":
        pytest.skip("locks are flock's")
    robot = load_robot("minihubo_1").part("RHP")
    can = load_robot("hubo2plus").part("RHY")
    with Loop() as loop:
        for passive in (False, True):
            (line,) = open_gates(
                robot, loop, {name: {"channel": "/dev/ttyX"} for name in robot.buses}, passive=passive
            ).values()
            assert line._gate.lock is not None  # type: ignore[attr-defined]
            assert line._gate.listen_only is passive  # type: ignore[attr-defined]
            (lower,) = open_gates(can, loop, {"lower": {"channel": "can7"}}, passive=passive).values()
            assert (lower._gate.lock is None) is passive  # type: ignore[attr-defined]
            assert lower._gate.listen_only is passive  # type: ignore[attr-defined]


def test_an_allow_list_is_the_robots_files() -> None:
    """Its gate refuses what the file does not list; a list that cannot be is a problem of the file."""
    text = ROBOT.replace('protocol = "fan" }', 'protocol = "fan", channel = "x", allow = ["100:7F8"] }')
    with Loop() as loop:
        (port,) = open_gates(robot_of(text), loop, load=drivers).values()
        allow = port._gate.allow  # type: ignore[attr-defined]
    from aces_bus import Frame
    from aces_bus.robot import parse_robot

    assert [allow.matches(Frame(number, b"")) for number in (0x101, 0x111)] == [True, False]
    for bad, said in (
        ('"can0,100:7F8"', "'can0,100:7F8': expected id:mask"),
        ('"1zz"', "'1zz': expected id:mask"),
        ('"12:zz"', "id:mask (060:7F0)"),
    ):
        _, problems = parse_robot(text.replace('"100:7F8"', bad))
        assert any(said in one.text for one in problems), problems


def test_an_allow_list_holds_in_virtual_runs_too() -> None:
    """A frame that the file does not list does not leave: the event names its identifier; what is listed goes on."""
    robot = load_robot("hubo2plus").part("RHY")
    lower = replace(robot.buses["lower"], allow=("010:7F0",))  # references, and nothing that asks
    with VirtualRobot(replace(robot, buses={**robot.buses, "lower": lower}), rate_hz=100) as master:
        recorder = ListeningNode(master.wires["lower"])
        master.advance(0.2)
        assert list(recorder.frames()) == []
        said = {event.detail for event in master.events.last if event.kind == "not sent"}
        assert "0x1 is not among the identifiers that may be sent here (allow)" in said
