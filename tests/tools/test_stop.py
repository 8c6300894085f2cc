"""`aces stop`, and `aces device NAME stop`: whoever drives, without --tx, confirmed or named."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from aces_tools.robot_arg import chosen_robot
from aces_tools.sim import SimulatedRobot
from tests.tools.conftest import Aces

ARM = """
name = "arm"
rate_hz = 100
[buses]
legs = { link = "can", protocol = "hubo", dialect = "D12", channel = "arm0" }
[devices]
JMC0 = { driver = "hubo_motor", bus = "legs", credentials = { board = 0 }, channels = 2 }
JMC1 = { driver = "hubo_motor", bus = "legs", credentials = { board = 1 }, channels = 2 }
[joints]
YAW = { device = "JMC0", gear = [10, 20], harmonic = 100, encoder = 4096, max_speed = 1.0 }
"""


@pytest.fixture
def arm(tmp_path: Path) -> str:
    path = tmp_path / "arm.toml"
    path.write_text(ARM)
    return str(path)


@pytest.fixture
def stand(
    arm: str, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[SimulatedRobot]:
    """The robot's twins on a served bus."""
    folder = tmp_path_factory.mktemp("run")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    robot = chosen_robot(arm)
    with ExitStack() as stack:
        yield SimulatedRobot(robot, {name: {} for name in robot.buses}, 0, stack)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "which robot? aces stop ROBOT"),
        (("arm", "-r", "arm"), "name the robot once"),
        (("--id", "3"), "--id is for -p PROTOCOL"),
        (("hubo2plus", "-p", "hubo"), "leave --protocol out"),
        (("-p", "moteus"), "which bus?"),
        (("-p", "mtoeus", "--bus", "can0"), "did you mean 'moteus'"),
        (("-p", "hubo", "--bus", "can0", "--id", "1"), "which driver?"),
        (("hubo2plus", "--bus", "lower="), "say where it is"),
    ],
)
def test_wrong_calls(aces: Aces, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str) -> None:
    """Status 2 and one line that says what to write."""
    monkeypatch.delenv("ACES_ROBOT", raising=False)
    result = aces("stop", *words)
    assert (result.status, result.out) == (2, "")
    assert said in result.err
    assert len(result.err.splitlines()) == 1


def test_a_robot_is_stopped_without_tx(aces: Aces, arm: str, stand: SimulatedRobot) -> None:
    """What falls is said, everything is confirmed; of one that is silent it is not, by name and with status 1."""
    result = aces("stop", arm, "-i", "aces")
    assert (result.status, result.out) == (0, "")
    assert result.err.splitlines() == [
        "aces: switched off, and falls where nothing holds it: JMC0 (YAW), JMC1",
        "stopped=2 not_confirmed=0",
    ]
    assert (
        aces("device", "YAW", "stop", "-r", arm, "-i", "aces").err.splitlines()[-1]
        == "stopped=1 not_confirmed=0"
    )


@pytest.mark.slow
def test_one_that_is_silent_is_named(aces: Aces, arm: str, stand: SimulatedRobot) -> None:
    """Status 1, its name and joints, and what to do; the others are stopped."""
    stand.simulation.twins["JMC0"].fault("silent")
    result = aces("stop", arm, "-i", "aces")
    assert result.status == 1
    assert "aces: NOT confirmed: JMC0 (YAW): " in result.err
    assert "JMC1: " not in result.err
    assert "cut the power" in result.err


def test_a_bus_that_cannot_be_opened_is_not_silent(aces: Aces, arm: str) -> None:
    """Its devices are named: nothing was sent to them."""
    result = aces("stop", arm, "--bus", "legs=unix:/nowhere.sock")
    assert result.status == 1
    assert "NOT confirmed: JMC1: bus legs cannot be opened" in result.err


def test_a_twin_is_stopped_by_the_same_word(aces: Aces, arm: str) -> None:
    """Every device has the word `stop`, in virtual time, too."""
    assert aces("device", "YAW", "stop", "-r", arm, "--virtual").out == "YAW stop: done\n"
    mistaken = aces("device", "YAW", "stop_motion", "-r", arm, "--virtual")
    assert mistaken.status == 2
    assert "stop" in mistaken.err


CONTROLLER = """
from aces_bus.controller import controller

@controller(rate_hz=100, writes=["YAW"])
def yaw(t):
    return {"YAW": 0.1}
"""


@pytest.mark.slow
@pytest.mark.parametrize("is_suspended", [False, True])
def test_a_run_that_holds_the_lock_is_stopped(
    aces: Aces, arm: str, stand: SimulatedRobot, tmp_path: Path, is_suspended: bool
) -> None:
    """`aces run` ends with status 1 and says who stopped it; a suspended one finds the stop when it goes on."""
    program = tmp_path / "yaw.py"
    program.write_text(CONTROLLER)
    words = ["run", "-r", arm, str(program), "-i", "aces", "--tx", "--on-trip", "ignore"]
    run = subprocess.Popen(
        [sys.executable, "-m", "aces_tools", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        channel = stand.simulation.twins["JMC0"].channels[0]  # type: ignore[attr-defined]
        assert run.stdout is not None
        assert run.stdout.readline()  # it runs
        assert channel.control_on
        if is_suspended:
            run.send_signal(signal.SIGSTOP)
        refused = aces("device", "YAW", "disable", "-r", arm, "-i", "aces", "--tx")
        assert refused.status == 2
        assert "`aces stop` stops what it drives" in refused.err
        result = aces("stop", arm, "-i", "aces")
        assert result.status == 0, result.err
        assert ("which drives it" in result.err) is not is_suspended
        assert not channel.control_on
        run.send_signal(signal.SIGCONT)
        _, said = run.communicate(timeout=60)
        assert run.returncode == 1
        assert "yaw was stopped: stopped by " in said
        assert not channel.control_on
    finally:
        run.kill()
        run.communicate()
