"""`aces run`: controllers out of files, three worlds, logs, what is said, how it ends."""

from __future__ import annotations

import math
import re
import signal
from collections.abc import Iterator
from errno import ENOSPC
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from aces_bus.controller import Player, Supervisor, Trajectory
from aces_bus.device import Robot
from aces_bus.hardware import CanGate
from aces_bus.hardware.ports import port_of
from aces_bus.robot import parse_robot, run_virtual
from aces_bus.robot.rig import simulate
from aces_bus.runtime.loop import Loop
from aces_devices.hubo_motor.twin import HuboMotorTwin
from aces_tools.running.figures import Watch
from aces_tools.running.loading import default_states, load_controllers, make_loggers
from aces_tools.running.panel import panel, plain_line, to_rich
from tests.device.fan import ROBOT, drivers
from tests.limits import small_disk
from tests.tools.conftest import Aces

FANS = """
name = "boards"
rate_hz = 100
[buses]
line = { link = "can", protocol = "hubo", bitrate = 1_000_000 }
[devices]
JMC1 = { driver = "hubo_motor", bus = "line", credentials = { board = 0x01 }, channels = 1 }
JMC2 = { driver = "hubo_motor", bus = "line", credentials = { board = 0x02 }, channels = 1 }
[joints.RHP]
device = "JMC1"
channel = 0
gear = [16, 20]
harmonic = 160
encoder = 4000
lower = -1.57
upper = 1.57
max_speed = 7.0
[joints.RKN]
device = "JMC2"
channel = 0
gear = [16, 16]
harmonic = 160
encoder = 4000
lower = 0.0
upper = 2.6
max_speed = 7.0
aliases = ["RKP"]
"""

KNEE = """
from aces_bus.controller import controller

@controller(rate_hz=100, writes=["RKN"])
def knee(RKN, t):
    return {"RKN": 0.1 * t}
"""


def boards() -> Robot:
    robot, problems = parse_robot(FANS)
    assert robot is not None, problems
    return robot


#: A controller that has the program interrupted.
INTERRUPTED = """
import os

@controller(rate_hz=100)
def cut(t):
    if t > 0.195:
        os.kill(os.getpid(), {number})
        {once}
"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """Two motor boards on one bus."""
    path = tmp_path / "boards.toml"
    path.write_text(FANS)
    return path


@pytest.fixture
def knee(tmp_path: Path) -> Path:
    """A controller in a file."""
    path = tmp_path / "knee.py"
    path.write_text(KNEE)
    return path


def numbers(path: Path) -> list[list[float]]:
    """The rows of a CSV log."""
    return [[float(cell or "nan") for cell in line.split(",")] for line in path.read_text().splitlines()[1:]]


# ---------------------------------------------------------------------- virtual


def test_a_controller_of_a_file_runs_in_virtual_time(
    aces: Aces, robot: Path, knee: Path, tmp_path: Path
) -> None:
    """Set-points reach the simulated joint, the log has both, and the summary counts the cycles."""
    log = tmp_path / "knee.csv"
    result = aces("run", "-r", robot, knee, "--virtual", "--for", "1s", "--log", log)
    assert result.status == 0
    assert result.summary["set_points"] == 101
    assert result.summary["missed"] == result.summary["tripped"] == result.summary["missing"] == 0
    assert log.read_text().splitlines()[0] == "time,RKN,RKN.setpoint"
    last = numbers(log)[-1]
    assert last[2] == pytest.approx(0.1, abs=0.002)
    assert last[1] == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize("options", [(), ("--quiet",)])
def test_a_log_that_is_not_whole_is_no_success(
    aces: Aces, robot: Path, knee: Path, tmp_path: Path, options: tuple[str, ...]
) -> None:
    """A disk that fills up stops nothing; the end says which file lacks rows and why, and the status is 1."""
    log = tmp_path / "knee.csv"
    with small_disk(800):
        result = aces("run", "-r", robot, knee, "--virtual", "--for", "1s", "--log", log, *options)
    assert result.status == 1
    assert result.summary["set_points"] == 101
    rows = len(numbers(log))
    lost = 101 - rows
    assert lost > 25
    assert (
        f"{log} is not whole: File too large; log knee.csv: 100 Hz, {rows} rows written, 0 dropped, {lost} lost"
        in result.messages
    )


def test_the_same_seed_is_the_same_log(aces: Aces, robot: Path, knee: Path, tmp_path: Path) -> None:
    """Two runs of one seed write the same bytes."""
    logs = [tmp_path / f"{n}.csv" for n in range(2)]
    for log in logs:
        assert (
            aces(
                "run", "-r", robot, knee, "--virtual", "--for", "0.5s", "--seed", 7, "--log", log, "--quiet"
            ).status
            == 0
        )
    assert logs[0].read_bytes() == logs[1].read_bytes()
    assert len(numbers(logs[0])) == 51


def test_a_trajectory_is_played_to_its_end(aces: Aces, robot: Path, tmp_path: Path) -> None:
    """A file of set-points is played from where the joints are, under its robot's names, and the run ends with it."""
    walk = tmp_path / "walk_10hz.txt"
    walk.write_text("RKP RHP EXTRA\n0.1 0.0 1\n0.2 -0.1 1\n0.3 -0.2 1\n")
    wrong = aces("run", "-r", robot, walk, "--virtual")
    assert wrong.status == 2
    assert "no joint EXTRA: --rename EXTRA=JOINT" in wrong.err
    log = tmp_path / "walk.csv"
    result = aces(
        "run", "-r", robot, walk, "--rename", "EXTRA=", "--virtual", "--log", f"{log}:R*,RKN.setpoint"
    )
    assert result.status == 0
    assert "seconds=0.740 " in result.err  # of the virtual clock, to the millisecond
    assert log.read_text().splitlines()[0] == "time,RHP,RKN,RKN.setpoint"
    assert numbers(log)[-1][3] == pytest.approx(0.3, abs=0.01)  # the last one that left


def test_home_and_enable_come_before_motion(aces: Aces, robot: Path, knee: Path) -> None:
    """--home has what is driven find its home; without --enable a board takes no set-points."""
    homed = aces("run", "-r", robot, knee, "--virtual", "--home", "--for", "0.2s")
    assert (homed.status, homed.messages) == (0, ["homed: JMC2"])


def test_lines_say_how_it_is(aces: Aces, robot: Path, knee: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no terminal a line comes now and then, and --quiet leaves them out."""
    monkeypatch.setattr("aces_tools.running.session.LINE_EVERY", 1)
    result = aces("run", "-r", robot, knee, "--virtual", "--for", "0.05s")
    line = result.out.splitlines()[-1]
    assert "; knee " in line
    assert " Hz missed 0; line " in line
    assert "clipped 0" in line
    assert aces("run", "-r", robot, knee, "--virtual", "--for", "0.05s", "--quiet").out == ""


class FullDisk(StringIO):
    """What is written there is lost."""

    def write(self, text: str) -> int:
        raise OSError(ENOSPC, "No space left on device")


@pytest.mark.parametrize("is_terminal", [False, True])
def test_what_cannot_be_shown_stops_nothing(
    aces: Aces, robot: Path, knee: Path, monkeypatch: pytest.MonkeyPatch, is_terminal: bool
) -> None:
    """A full disk, a terminal that was closed: it is said once, the run goes on to its end, and the status is 1."""
    monkeypatch.setattr("aces_tools.running.session.LINE_EVERY", 1)
    monkeypatch.setattr("aces_tools.running.session.PANEL_EVERY", 1)
    monkeypatch.setenv("TERM", "xterm")
    full = FullDisk()
    monkeypatch.setattr(full, "isatty", lambda: is_terminal)
    monkeypatch.setattr("sys.stdout", full)
    result = aces("run", "-r", robot, knee, "--virtual", "--for", "0.5s")
    assert result.status == 1
    assert result.summary["set_points"] == 51
    assert result.err.count("standard output: No space left on device") == 1


def test_only_logging_is_a_run_too(aces: Aces, robot: Path, tmp_path: Path) -> None:
    """Without a controller, a log records what the robot's joints do."""
    log = tmp_path / "all.csv"
    assert aces("run", "-r", robot, "--virtual", "--for", "0.1s", "--log", log).status == 0
    assert log.read_text().splitlines()[0] == "time,RHP,RKN"


# ---------------------------------------------------------------------- what goes wrong


def test_a_controller_that_raises_ends_it_with_status_1(aces: Aces, robot: Path, tmp_path: Path) -> None:
    """Its exception stops motion, and the end names it with file and line."""
    bad = tmp_path / "bad.py"
    bad.write_text(KNEE.replace("0.1 * t", "0.1 * t if t < 0.2 else 1 / 0"))
    result = aces("run", "-r", robot, bad, "--virtual", "--for", "60s")
    assert result.status == 1
    line = 1 + bad.read_text()[: bad.read_text().index("1 / 0")].count("\n")
    said = f"knee was stopped: knee: raised: ZeroDivisionError: division by zero ({bad}:{line})"
    assert said in result.messages
    assert result.summary["tripped"] == 1


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("x = 1\n", "no controller in it"),
        ("import aces_nothing\n", "bad.py:1: "),
        ("def f(:\n", "bad.py:1: "),
        (KNEE.replace("RKN", "RXX"), "RXX"),
        (KNEE + "\nother = knee\nmore = [knee]\n", ""),
        (KNEE.replace("rate_hz=100", "rate_hz=-1"), "not a rate"),
    ],
)
def test_a_wrong_file_is_one_line(
    aces: Aces, robot: Path, tmp_path: Path, content: str, expected: str
) -> None:
    """Whatever is wrong with a controller's file is one line and status 2, before anything is opened."""
    bad = tmp_path / "bad.py"
    bad.write_text(content)
    result = aces("run", "-r", robot, bad, "--virtual", "--for", "0.05s")
    if not expected:
        assert result.status == 0
        return
    assert result.status == 2
    assert len(result.err.splitlines()) == 1
    assert expected in result.err


def test_a_controller_that_only_waited_is_said(aces: Aces, robot: Path, tmp_path: Path) -> None:
    """No set-point at all, as the run is shorter than the past that it asks for: status 1, with what it waited for."""
    (tmp_path / "wait.py").write_text(
        "from aces_bus.controller import controller\n"
        "@controller(rate_hz=50, writes=['RKN'])\n"
        "def wait(RKN):\n"
        "    return {'RKN': RKN[-4.0]}\n"
    )
    result = aces("run", "-r", robot, tmp_path / "wait.py", "--virtual", "--for", "0.3s")
    assert result.status == 1, result
    said = "wait gave no set-point: it waited for state 'RKN.position' has no value at t = -4 s"
    assert any(line.startswith(said) for line in result.messages)
    assert result.summary["set_points"] == 0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), "nothing to run"),
        (("KNEE:nothing",), "no controller in"),
        (("nothing.txt",), "no such file"),
        (("KNEE", "--replay", "x.log", "--virtual"), "one of --virtual and --replay"),
        (("KNEE", "--replay", "x.log"), "x.log"),
        (("KNEE", "--virtual", "--bus", "line=can0"), "has no buses"),
        (("KNEE", "--virtual", "--rate", "0"), "above 0"),
        (("KNEE", "--virtual", "--log", "/no/such/folder/a.csv"), "no folder"),
        (("KNEE", "--virtual", "--log", "a.xyz"), "suffix"),
        (("KNEE", "--virtual", "--log", "a.csv:Q*"), "no joint of boards like"),
        (("KNEE", "--virtual", "--log", "a.csv:RXX"), "RXX"),
        (("KNEE", "--for", "soon", "--virtual"), "duration"),
        (("KNEE",), "which channel?"),
        (("KNEE", "KNEE", "--virtual"), "one name"),
        (("KNEE", "-i", "aces", "--bus", "line=unix:/no/such.sock"), "bus line cannot be opened"),
    ],
)
def test_a_wrong_call_is_one_line(
    aces: Aces,
    robot: Path,
    knee: Path,
    words: tuple[str, ...],
    expected: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Status 2 and one line that says what is wrong."""
    monkeypatch.chdir(robot.parent)
    result = aces("run", "-r", robot, *(word.replace("KNEE", str(knee)) for word in words))
    assert result.status == 2, result
    assert expected in result.err
    assert len(result.err.splitlines()) == 1
    assert not (robot.parent / "a.csv").exists()


# ---------------------------------------------------------------------- buses and recordings


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[str, ...]]:
    """The robot's twins at a bus of this process; gives the options that lead there."""
    robot = boards()
    options = {"interface": "aces", "channel": str(tmp_path), "bitrate": 1_000_000}
    with Loop() as loop, simulate(robot, {"line": port_of(CanGate(options), loop)}):
        yield "-i", "aces", "--bus", f"line={tmp_path}"


@pytest.mark.slow
def test_real_buses_move_only_with_tx(aces: Aces, robot: Path, knee: Path, served: tuple[str, ...]) -> None:
    """With --ask the devices are asked and set-points only counted; with --tx the joint moves, and is stopped."""
    only = aces("run", "-r", robot, knee, *served, "--for", "0.2s", "--ask")
    assert only.status == 0
    assert only.summary["set_points"] > 0
    assert only.err.splitlines()[-1].endswith("(set-points were not sent)")
    log = robot.parent / "k.csv"
    moved = aces("run", "-r", robot, knee, *served, "--for", "0.6s", "--tx", "--log", log)
    assert moved.status == 0
    assert moved.summary["cycles"] > 0
    assert max(row[1] for row in numbers(log) if math.isfinite(row[1])) > 0.02
    assert any("late" in message and "(median)" in message for message in moved.messages)


@pytest.mark.slow
def test_without_tx_and_ask_nothing_is_sent(
    aces: Aces, robot: Path, knee: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that only looks on puts no frame on the bus, says what it has not heard, and how to ask."""
    monkeypatch.setattr("aces_bus.robot.runner.RECEIVE_S", 0.2)
    options = {"interface": "aces", "channel": str(tmp_path), "bitrate": 1_000_000}
    with Loop() as loop, simulate(boards(), {"line": port_of(CanGate(options), loop)}) as twins:
        only = aces(
            "run", "-r", robot, knee, "-i", "aces", "--bus", f"line={tmp_path}", "--for", "0.2s", "--home"
        )
        assert sum(twin.requests for twin in twins.twins.values()) == 0
    assert only.messages[0] == "nothing came from JMC1, JMC2: no other program asks; --ask does"
    assert only.status == 1


@pytest.mark.slow
def test_what_is_missing_is_named_and_nothing_moves(
    aces: Aces, robot: Path, knee: Path, served: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A driven device that does not answer ends the run before motion, with its name and status 1."""
    monkeypatch.setattr("aces_bus.robot.runner.RECEIVE_S", 0.3)
    robot.write_text(FANS.replace("board = 0x02", "board = 0x05"))
    result = aces("run", "-r", robot, knee, *served, "--for", "1s", "--tx")
    assert result.status == 1
    assert result.messages[0].startswith("no answer from JMC2")
    assert result.summary["set_points"] == 0
    assert result.summary["missing"] == 1


def test_a_recording_takes_the_buses_place(aces: Aces, robot: Path, knee: Path, tmp_path: Path) -> None:
    """--replay feeds the controllers from a recording, ends with it, and moves nothing."""
    lines = []
    for n in range(60):
        position = (n * 1000).to_bytes(4, "little").hex().upper()
        lines.append(f"({100 + n / 100:.6f}) can0 062#{position}00000000\n")
    walk = tmp_path / "walk.log"
    walk.write_text("".join(lines))
    log = tmp_path / "seen.csv"
    result = aces("run", "-r", robot, knee, "--replay", walk, "--log", f"{log}:RKN")
    assert result.status == 0
    assert "(set-points were not sent)" in result.err
    assert result.messages[0] == "not in the recording: JMC1"
    seen = [row[1] for row in numbers(log)]
    assert seen[-1] > seen[len(seen) // 2] > 0
    assert aces("run", "-r", robot, knee, "--replay", walk, "--tx").status == 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(aces: Aces, robot: Path, tmp_path: Path, number: signal.Signals) -> None:
    """Ctrl-C or SIGTERM ends a run as if its time were up: the log is whole, the summary is last, the status 0."""
    log, path = tmp_path / "cut.csv", tmp_path / "cut.py"
    path.write_text(KNEE + INTERRUPTED.format(number=int(number), once=""))
    result = aces("run", "-r", robot, path, "--virtual", "--log", log)
    assert result.status == 0
    assert result.err.splitlines()[-1].startswith("seconds=0.2")
    assert 20 <= len(numbers(log)) < 25


def test_a_second_ctrl_c_ends_it_at_once(aces: Aces, robot: Path, tmp_path: Path) -> None:
    """A controller that never comes back is left by a second Ctrl-C: motion is told to stop, the log is closed, 130."""
    log, path = tmp_path / "cut.csv", tmp_path / "cut.py"
    path.write_text(
        KNEE + INTERRUPTED.format(number=int(signal.SIGINT), once="while True: os.kill(os.getpid(), 2)")
    )
    result = aces("run", "-r", robot, path, "--virtual", "--log", log)
    assert result.status == 130
    assert result.err.splitlines()[-1].startswith("seconds=0.2")
    assert 20 <= len(numbers(log)) < 25


# ---------------------------------------------------------------------- faults

#: A controller that raises after a fifth of a second, a function that reactions may name, and one that never does.
FAILING = """
from aces_bus.controller import controller

@controller(rate_hz=100, writes=["RKN"])
def knee(t):
    if t > 0.2:
        raise ValueError("no more")
    return {"RKN": 0.1 * t}

def shrug(event):
    print(f"shrugged at {event.kind}")
"""


@pytest.mark.parametrize(
    ("options", "seconds", "said"),
    [
        ((), "0.2", "knee was stopped: knee: raised: ValueError: no more"),
        (("--on-trip", "hold"), "1.0", "knee was held: knee: raised: ValueError: no more"),
        (("--on-trip", "raised@knee=hold", "--hold-for", "0.3s"), "0.5", "; held for 0.3 s"),
        (("--on-trip", "raised=ignore"), "0.3", "dead-man: no set-points for"),
        (("--on-trip", "ignore"), "1.0", ""),
    ],
)
def test_what_faults_lead_to_is_said(
    aces: Aces, robot: Path, tmp_path: Path, options: tuple[str, ...], seconds: str, said: str
) -> None:
    """--on-trip, for one kind and source or for all: how the run goes on, how it is said, and the status."""
    program = tmp_path / "failing.py"
    program.write_text(FAILING)
    result = aces("run", "-r", robot, program, "--virtual", "--for", "1s", *options)
    assert result.err.splitlines()[-1].startswith(f"seconds={seconds}")
    assert result.status == (1 if said else 0)
    assert any(message.endswith(said) or said in message for message in [*result.messages, ""])


def test_reactions_may_be_functions_of_the_controllers_file(aces: Aces, robot: Path, tmp_path: Path) -> None:
    """By name, in the call and in the robot's file; a name that there is not is refused with those that there are."""
    program = tmp_path / "failing.py"
    program.write_text(FAILING)
    run = ("run", "-r", robot, program, "--virtual", "--for", "0.3s", "--quiet")
    assert "shrugged at raised" in aces(*run, "--on-trip", "raised=shrug").out
    robot.write_text('reactions = { raised = "shrug" }\n' + FANS)
    assert "shrugged at raised" in aces(*run).out
    for wrong, expected in (("raised=shrgu", "shrug"), ("rased=hold", "raised"), ("raised@nee=hold", "knee")):
        result = aces(*run, "--on-trip", wrong)
        assert result.status == 2
        assert f"did you mean '{expected}'?" in result.err
    result = aces(
        *run, "--on-trip", "raised=controller"
    )  # what the file imports of this package is not a reaction
    assert result.status == 2
    assert (
        "no reaction (ignore, degrade, hold, park, zero duty, disable), or function of a controller's file"
        in result.err
    )


def test_a_board_that_is_not_switched_off_is_named(
    aces: Aces, robot: Path, knee: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A board that obeys no ControlOff is named at the end, and the status is 1."""
    switch = HuboMotorTwin.control

    def deaf(twin: Any, request: Any) -> None:
        if type(request).__name__ == "ControlOn":
            switch(twin, request)

    monkeypatch.setattr(HuboMotorTwin, "control", deaf)
    result = aces("run", "-r", robot, knee, "--virtual", "--for", "0.3s")
    assert result.status == 1
    assert "NOT switched off: JMC2" in result.messages


def test_a_robot_may_be_left_held(aces: Aces, robot: Path, knee: Path) -> None:
    """--at-end hold switches nothing off, and says what is left enabled."""
    result = aces("run", "-r", robot, knee, "--virtual", "--for", "0.3s", "--at-end", "hold")
    assert result.status == 0
    assert "left enabled, where they are: JMC2" in result.messages


def test_who_is_left_held_and_stops_by_itself_is_said(aces: Aces, tmp_path: Path) -> None:
    """A servo whose bus watchdog is set does not stay as it was left."""
    servo, law = tmp_path / "servo.toml", tmp_path / "law.py"
    servo.write_text(
        'name = "servo"\nrate_hz = 50\n[buses]\nline = { link = "serial", protocol = "dynamixel" }\n[devices]\n'
        'D1 = { driver = "dynamixel", bus = "line", model = "XM430-W350", credentials = { id = 1 } }\n'
        '[joints]\nRKN = { device = "D1", zero = 3.1416 }\n'
    )
    law.write_text(KNEE)
    result = aces("run", "-r", servo, law, "--virtual", "--for", "0.3s", "--at-end", "hold")
    assert result.status == 0
    holds = "D1: without this program it holds its joints where they are, 0.5 s after its host is gone"
    assert holds in result.messages


# ---------------------------------------------------------------------- parts


class Words:
    """Arguments as the parser leaves them."""

    rename: tuple[str, ...] = ()
    loop, degrees, speed, rows_hz = False, False, 1.0, None


def test_a_file_gives_what_is_asked_of_it(tmp_path: Path) -> None:
    """FILE takes all controllers, a supervisor in place of the one within; FILE:NAME one, or what a function makes."""
    path = tmp_path / "many.py"
    path.write_text(
        KNEE
        + """
from aces_bus.controller import Bounds, Equations, Guard, Supervisor
safe = Supervisor(knee, Guard({"RKN": Bounds()}, period_s=0.01))
hip = Equations("hip", "RHP[0] = 0.1", rate_hz=50, states=["RHP"])
def both():
    return [hip, safe]
number = 5
"""
    )
    robot = boards()

    def names(word: str) -> list[str]:
        return [one.name for one in load_controllers([word], robot, 100, Words())]  # type: ignore[arg-type]

    assert names(str(path)) == ["knee", "hip"]
    assert isinstance(load_controllers([str(path)], robot, 100, Words())[0], Supervisor)  # type: ignore[arg-type]
    assert names(f"{path}:hip") == ["hip"]
    assert names(f"{path}:both") == ["hip", "knee"]
    for wrong in ("number", "nothing"):
        with pytest.raises(Exception, match=wrong):
            names(f"{path}:{wrong}")


def test_logs_have_what_controllers_use(tmp_path: Path) -> None:
    """Without states a log has what is written, beside what was wanted, and what is read."""
    robot = boards()
    path = tmp_path / "knee.py"
    path.write_text(KNEE.replace("(RKN, t)", "(RHP, RKN, t)"))
    controllers = load_controllers([str(path)], robot, 100, Words())  # type: ignore[arg-type]
    assert default_states(controllers, robot) == ["RKN", "RKN.setpoint", "RHP"]
    assert default_states([], robot) == ["RHP", "RKN"]
    (log,) = make_loggers([f"{tmp_path}/a.csv:R*.setpoint,RHP.velocity"], [], robot, 100)
    assert log.states == ("RHP.setpoint", "RKN.setpoint", "RHP.velocity")
    (log,) = make_loggers([f"{tmp_path}/b.csv:RKN,R*.velocity,RHP"], [], robot, 100)
    assert log.states == ("RKN", "RHP.velocity", "RKN.velocity", "RHP")


@pytest.mark.parametrize("width", [20, 33, 50, 80, 200])
@pytest.mark.parametrize("height", [4, 12, 40])
def test_the_panel_fits(width: int, height: int) -> None:
    """Whatever the terminal's size, no line is wider and no more lines are given; names stay readable."""
    from tests.device.fan import robot_of

    goals = Trajectory(["A.left", "A.right"], [[0.0, 0.0], [900.0, 50.0]], rate_hz=1)
    player = Player("a walk with a long name\x1b[2J", goals, rate_hz=50, largest=1e6)
    run = run_virtual(robot_of(ROBOT), [player], load=drivers)
    with run:
        watch = Watch(run, real=False)
        run.start()
        watch.begin(1)
        run.clock.wait(lambda: False, 400_000_000)
        run.world.twins["B"].fault("silent")
        run.clock.wait(lambda: False, 600_000_000)
        figures = watch.look(1_000_000_001)
        lines = ["".join(text for _, text in line) for line in panel(figures, "fans, virtual", width, height)]
    assert len(lines) <= height
    assert all(len(line) <= width for line in lines)
    assert not any("\x1b" in line for line in lines)
    if width >= 80 and height >= 12:
        text = "\n".join(lines)
        assert "B: silent" in text
        assert "stopped" in text
        assert "A.left" in text
    assert "\x1b" not in plain_line(figures)
    assert str(to_rich(panel(figures, "t", 80, 20)))


def test_a_terminal_gets_the_panel(
    aces: Aces, robot: Path, knee: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a terminal the panel is drawn in place, and its last picture is of the whole run."""
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setattr("aces_tools.running.session.PANEL_EVERY", 1_000_000)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "70")
    result = aces("run", "-r", robot, knee, "--virtual", "--for", "0.2s")
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", result.out)
    last = text[text.rindex("boards, virtual") :]
    assert "0.20 s" in last.splitlines()[0]
    assert "set-point" in last
    assert "105.0" in last  # 21 cycles in 0.2 s
    assert result.err.startswith("seconds=")
