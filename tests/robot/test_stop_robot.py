"""A stop by another program: of every driver's devices, through a run, and through the lock of who drives."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from aces_bus.controller import IGNORE, controller
from aces_bus.errors import CallerError, DeviceError
from aces_bus.hardware import CanGate
from aces_bus.hardware.ports import port_of
from aces_bus.robot import VirtualRobot, run_real, run_virtual, stop_robot
from aces_bus.robot.file import print_robot
from aces_bus.robot.rig import Rig, simulate
from aces_bus.runtime.loop import Loop
from tests.robot.served_twins import PATIENCE_S, Twins
from tests.robot.walking import hubo_leg

WHO = "aces stop (pid 7)"


class Request:
    """A request as a bell gives it."""

    who = WHO

    def __init__(self) -> None:
        self.answers: list[dict[str, Any]] = []

    def answer(self, **content: Any) -> None:
        self.answers.append(content)


# ---------------------------------------------------------------------- who drives obeys


@controller(rate_hz=100, writes=["RKN"])
def bend(t: float) -> dict[str, float]:
    return {"RKN": 0.2 * t}


@pytest.mark.parametrize("at_end", ["disable", "hold"])
def test_no_reaction_keeps_a_run_from_being_stopped(at_end: Any) -> None:
    """A run that ignores all faults, and would hold at its end, ends with everything off, and answers who has stopped."""
    run = run_virtual(hubo_leg(), [bend], rate_hz=100, reactions={"*": IGNORE}, at_end=at_end)
    request = Request()
    run.before.append(
        lambda: run.clock.call_in(2_000_000_000, lambda: run.rig.obey_stop("lower", request))  # type: ignore[arg-type]
    )
    with run:
        run.do("enable")
        ended = run.run(10.0)
        given = run.set_points
    assert ended.reason == f"stopped by {WHO}"
    assert ended.tripped == {"bend": f"stopped by {WHO}"}
    assert (ended.held, ended.not_stopped, run.set_points) == ([], {}, given)
    assert request.answers[0] == {"is_stopping": True}
    boards = [one["credentials"]["board"] for one in request.answers[1]["devices"] if one["why"] == ""]
    assert {0, 1, 2, 3} <= set(boards)
    twins = run.world.twins
    assert not any(
        channel.control_on for name in ("JMC0", "JMC1", "JMC2", "JMC3") for channel in twins[name].channels
    )


def test_a_hold_does_not_survive_a_stop() -> None:
    """What a trip has held is switched off, too."""

    @controller(rate_hz=100, writes=["RKN"])
    def fails(t: float) -> dict[str, float]:
        if t > 0.3:
            raise ValueError("on purpose")
        return {"RKN": 0.0}

    run = run_virtual(hubo_leg(), [fails], rate_hz=100, on_trip="hold")
    run.before.append(
        lambda: run.clock.call_in(2_000_000_000, lambda: run.rig.obey_stop("lower", Request()))  # type: ignore[arg-type]
    )
    with run:
        run.do("enable")
        ended = run.run(10.0)
    assert 0.3 < ended.seconds < 2.0
    assert f"stopped by {WHO}" in ended.tripped["fails"]
    assert not any(channel.control_on for channel in run.world.twins["JMC2"].channels)


def test_a_script_is_refused_until_it_has_released() -> None:
    """After another program's stop neither set-points nor `enable` pass, until the program says that it may go on."""
    with VirtualRobot(hubo_leg(), rate_hz=100) as robot:
        robot.advance(0.5)
        robot.rig.each("enable").wait(30)
        robot.rig.obey_stop("lower", Request())  # type: ignore[arg-type]
        robot.advance(0.5)
        with pytest.raises(CallerError, match="stopped by aces stop"):
            robot["RKN"].set(0.3)
        with pytest.raises(DeviceError, match="release it first"):
            robot.rig.each("enable").wait()
        assert robot.twins["JMC2"].channels[0].control_on is False
        robot.rig.release()
        robot.rig.each("enable").wait(30)
        robot["RKN"].set(0.3)
        robot.advance(1.0)
        assert robot["RKN"].value == pytest.approx(0.3, abs=0.01)


def test_a_run_does_not_begin_after_another_program_s_stop() -> None:
    """Stopped between its opening and its start, a run is refused until it is released."""
    run = run_virtual(hubo_leg(), [bend], rate_hz=100)
    with run:
        run.rig.obey_stop("lower", Request())  # type: ignore[arg-type]
        with pytest.raises(DeviceError, match=r"was stopped by .*: release it first"):
            run.start()
        assert run.set_points == 0


# ---------------------------------------------------------------------- through the lock


@pytest.fixture
def bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """The leg's twins on a bus with a lock of its own; gives the options that lead there."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    # A bus within this process has no lock: here it is one that other programs could open.
    monkeypatch.setattr("aces_bus.robot.buses.IN_PROCESS", ())
    options = {"interface": "aces", "channel": str(tmp_path), "bitrate": 1_000_000}
    with Loop() as loop, simulate(hubo_leg(), {"lower": port_of(CanGate(options), loop)}):
        yield {"lower": options}


@pytest.mark.slow
def test_a_run_is_stopped_through_its_lock(bus: dict[str, Any]) -> None:
    """The program that drives is asked, stops its devices itself, and is named; then it may be released."""
    with run_real(hubo_leg(), [], buses=bus, transmit=True) as run:
        run.do("enable", devices=["JMC2"])
        stopped = stop_robot(hubo_leg(), buses=bus)
        assert "(pid" in stopped.by["lower"]
        assert stopped.devices["JMC2"] == "limp"
        assert "(pid" in run.rig.stopped_by
        assert not run.states["RKN.enabled"].last
        with pytest.raises(DeviceError, match="release it first"):
            run.do("enable")


@pytest.mark.slow
def test_who_does_not_answer_is_passed_over(bus: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """The host hangs (its loop is blocked): the stop is sent beside it, and what it gave meanwhile goes nowhere."""
    import threading

    with run_real(hubo_leg(), [], buses=bus, transmit=True) as run:
        run.do("enable", devices=["JMC2"])
        goes_on = threading.Event()
        run.clock.call_soon(lambda: goes_on.wait(30) and None)
        try:
            stopped = stop_robot(hubo_leg(), buses=bus)
        finally:
            goes_on.set()
        assert stopped.by == {}
        assert stopped.devices["JMC2"] == "limp"
        assert run.clock.wait(lambda: bool(run.rig.stopped_by), 20_000_000_000)


@pytest.mark.slow
@pytest.mark.parametrize(
    "report",
    [
        {"who": ["\x1b[2J"], "devices": [{"protocol": [], "credentials": 5, "why": ""}]},
        {"devices": [{"protocol": "hubo2plus", "credentials": [["board"]], "why": ""}, None, 7]},
        {"devices": "all"},
    ],
)
def test_a_report_that_is_none_stops_nothing(
    bus: dict[str, Any], monkeypatch: pytest.MonkeyPatch, report: dict[str, Any]
) -> None:
    """What answers says nothing of the devices that can be understood: the stops are sent beside it."""
    import threading

    goes_on = threading.Event()

    def obey_stop(_: Rig, __: str, request: Any) -> None:
        request.answer(is_stopping=True)
        request.answer(**report)
        goes_on.wait(30)  # it sends nothing more: frames of one identifier at once would be bit errors

    monkeypatch.setattr(Rig, "obey_stop", obey_stop)
    with run_real(hubo_leg(), [], buses=bus, transmit=True) as run:
        run.do("enable", devices=["JMC2"])
        try:
            stopped = stop_robot(hubo_leg(), buses=bus)
        finally:
            goes_on.set()
        assert stopped.by == {}
        assert stopped.devices["JMC2"] == "limp"


# ---------------------------------------------------------------------- programs that forget their end


FORGETFUL = """
import sys, threading
from aces_bus import load_robot
from aces_bus.robot import run_real
run = run_real(load_robot(sys.argv[1]), [], buses={"lower": {"interface": "aces", "channel": sys.argv[2]}}, transmit=True)
if sys.argv[3] == "thread":
    is_on = threading.Event()
    def work():
        with run:
            run.do("enable")
            is_on.set()
            run.run(60)
    threading.Thread(target=work, daemon=True).start()
    is_on.wait(60)
else:
    run.open()
    run.do("enable")
if sys.argv[3] == "raises":
    raise ValueError("on purpose")
"""


@pytest.mark.slow
@pytest.mark.parametrize("how", ["ends", "raises", "thread"])
def test_a_program_that_forgets_leaves_no_motor_on(tmp_path: Path, how: str) -> None:
    """The script is over, raises, or has its run in a daemon thread: the boards are off, and stderr says which were on."""
    twins = Twins(tmp_path / "b.sock")
    try:
        robot = tmp_path / "leg.toml"
        robot.write_text(print_robot(hubo_leg()))
        words = [sys.executable, "-c", FORGETFUL, str(robot), f"unix:{twins.path}", how]
        ended = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
        assert "enabled: stopping" in ended.stderr
        assert twins("on") == []
    finally:
        twins.close()
