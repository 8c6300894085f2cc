"""`aces device`: what it shows, reads, sets and does; what it refuses before a bus is opened; how it ends."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack
from math import pi
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot
from aces_devices.hubo_motor.twin import HuboMotorTwin
from aces_tools import device_do
from aces_tools.robot_arg import chosen_robot
from aces_tools.sim import SimulatedRobot
from tests.tools.conftest import Aces
from tests.tools.live import interrupt

#: Two motor boards on CAN and one that is inactive, a servo on a serial line.
ROBOT = """
name = "leg"
rate_hz = 100

[buses]
can = { link = "can", protocol = "hubo", dialect = "D12", bitrate = 1_000_000, channel = "leg0" }
line = { link = "serial", protocol = "robotis", baud = 1_000_000 }

[devices]
JMC0 = { driver = "hubo_motor", bus = "can", credentials = { board = 0 }, channels = 2 }
JMC1 = { driver = "hubo_motor", bus = "can", credentials = { board = 1 }, channels = 1 }
JMC2 = { driver = "hubo_motor", bus = "can", credentials = { board = 2 }, channels = 1, active = false }
S7 = { driver = "robotis_rx", bus = "line", credentials = { id = 7 }, model = "RX-28" }

[joints.YAW]
device = "JMC0"
channel = 0
gear = [10, 25]
harmonic = 100
encoder = 4000
lower = -1.5
upper = 1.5
aliases = ["Y"]

[joints]
ROLL = { device = "JMC0", channel = 1, gear = [10, 25], harmonic = 100, encoder = 4000, lower = -1.5, upper = 1.5 }
KNEE = { device = "JMC1", channel = 0, gear = [10, 25], harmonic = 100, encoder = 4000 }
TOE = { device = "S7", channel = 0, lower = -1.0, upper = 1.0 }
"""


@pytest.fixture
def leg(tmp_path: Path) -> str:
    """A robot's file: two motor boards on CAN, a servo on a serial line."""
    path = tmp_path / "leg.toml"
    path.write_text(ROBOT, encoding="utf-8")
    return str(path)


@pytest.fixture
def virtual(aces: Aces, leg: str) -> Any:
    """`aces device …` on this robot's twins."""
    return lambda *arguments: aces("device", *arguments, "--robot", leg, "--virtual")


# ---------------------------------------------------------------------- what there is


def test_the_devices_of_a_robot(aces: Aces, leg: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a name the robot's devices are listed with their joints, the inactive marked; ACES_ROBOT names the robot."""
    monkeypatch.setenv("ACES_ROBOT", leg)
    shown = aces("device")
    assert shown.status == 0
    assert [line.split()[0] for line in shown.out.splitlines()] == ["JMC0", "JMC1", "JMC2", "S7"]
    assert "YAW ROLL" in shown.out
    assert "(inactive)" in shown.out.splitlines()[2]
    rows = json.loads(aces("device", "--json").out)
    assert rows[0]["joints"] == ["YAW", "ROLL"]
    assert rows[3]["credentials"] == {"id": 7}


def test_no_robot_is_said_with_those_that_ship(aces: Aces, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a robot the call is wrong, and the message lists the robots."""
    monkeypatch.delenv("ACES_ROBOT", raising=False)
    said = aces("device", "YAW")
    assert said.status == 2
    assert "hubo2plus" in said.err
    assert "ACES_ROBOT" in said.err


@pytest.mark.slow
def test_what_a_joint_has(aces: Aces, leg: str) -> None:
    """A joint's name shows its signals with its board's own and the actions; other joints' signals are not there."""
    shown = aces("device", "Y", "-r", leg)
    assert shown.status == 0
    assert "YAW.position" in shown.out
    assert "-1.5…1.5" in shown.out
    assert "ROLL" not in shown.out
    assert "parameters*" in shown.out
    whole = json.loads(aces("device", "JMC0", "-r", leg, "--json").out)
    assert whole["signals"]["ROLL.position"] == {
        "unit": "rad",
        "read": True,
        "set": True,
        "lower": -1.5,
        "upper": 1.5,
        "doc": whole["signals"]["ROLL.position"]["doc"],
    }
    assert whole["actions"]["override_gains"]["arguments"]["first"] is True
    assert whole["actions"]["parameters"]["asks"] is True
    assert whole["actions"]["home"]["asks"] is False


def test_a_narrow_terminal(aces: Aces, leg: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """No line is wider than the terminal; in a pipe nothing is wrapped."""
    whole = aces("device", "YAW", "-r", leg).out
    monkeypatch.setattr("aces_tools.console.sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "60")
    shown = aces("device", "YAW", "-r", leg).out
    assert max(map(len, shown.splitlines())) <= 60
    assert len(shown.splitlines()) > len(whole.splitlines())
    assert shown.split() == whole.split()


# ---------------------------------------------------------------------- get and watch


def test_get(virtual: Any) -> None:
    """`get` prints each value with its unit on stdout and nothing on stderr; names choose."""
    got = virtual("YAW", "get")
    assert got.status == 0
    assert got.err == ""
    assert "YAW.position" in got.out
    assert " rad\n" in got.out
    assert [line.split()[0] for line in virtual("YAW", "get", "position").out.splitlines()] == [
        "YAW.position"
    ]
    assert virtual("YAW.position", "get").out == virtual("JMC0", "get", "YAW.position").out


def test_get_as_json(virtual: Any) -> None:
    """As JSON each signal has value, unit and age."""
    whole = json.loads(virtual("JMC0", "get", "position", "status", "--json").out)
    assert set(whole) == {"YAW.position", "ROLL.position", "YAW.status", "ROLL.status"}
    assert whole["YAW.position"] == {"value": 0.0, "unit": "rad", "age_s": whole["YAW.position"]["age_s"]}
    assert 0 <= whole["YAW.position"]["age_s"] < 1
    assert whole["YAW.status"]["value"] == []


def test_watch_in_a_pipe(virtual: Any) -> None:
    """`watch` prints a head and a line each time; as JSON an object a line."""
    lines = virtual(
        "YAW", "watch", "position", "velocity", "--for", "0.5s", "--every", "100ms"
    ).out.splitlines()
    assert lines[0].split() == ["time", "YAW.position", "YAW.velocity"]
    assert [line.split()[0] for line in lines[1:]] == ["0.100", "0.200", "0.300", "0.400", "0.500"]
    objects = virtual("YAW", "watch", "position", "--for", "0.2s", "--json").objects
    assert objects == [{"time": 0.1, "YAW.position": 0.0}, {"time": 0.2, "YAW.position": 0.0}]


def test_watch_ends_with_ctrl_c(virtual: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C ends `watch` as if its time were up."""
    shown: list[float] = []

    def show(seconds: float, signals: Any) -> None:
        shown.append(seconds)
        if len(shown) == 3:
            interrupt()

    monkeypatch.setattr(device_do.Doing, "_print_line", staticmethod(show))
    assert virtual("YAW", "watch", "position").status == 0
    assert len(shown) == 3


def test_watch_on_a_terminal(virtual: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a terminal a table is kept up to date, with the last state left on it."""
    monkeypatch.setattr("aces_tools.device_do.sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    shown = virtual("YAW", "watch", "--for", "0.1s", "--every", "0.05s")
    assert shown.status == 0
    assert "YAW.position" in shown.out
    assert "none" in shown.out  # no error bits


# ---------------------------------------------------------------------- set


def test_set(virtual: Any) -> None:
    """A set-point goes out enabled, and what it came to is shown; degrees are understood."""
    made = virtual("KNEE", "set", "position=0.2", "--enable", "--for", "2s")
    assert made.status == 0, made
    assert made.out.startswith("KNEE.position: set to 0.2 rad, is 0.199")
    made = virtual("KNEE", "set", "position=10deg", "--enable", "--for", "2s", "--json")
    assert json.loads(made.out)["KNEE.position"] == pytest.approx(0.1745, abs=0.002)


def test_a_set_point_beyond_its_limits_is_told(virtual: Any) -> None:
    """It is limited, stderr says to what, stdout what was really set, and the status is 1."""
    made = virtual("YAW", "set", "position=900", "--enable")
    assert made.status == 1
    assert any("limited: YAW.position: 900 is above 1.5 rad" in line for line in made.messages)
    assert made.messages[-1] == "YAW.position: limited: 900 is not within -1.5 to 1.5 rad"
    assert made.out.startswith("YAW.position: set to 1.5 rad, is 1.")


def test_a_position_is_led_there(virtual: Any) -> None:
    """It takes its time, at 1 rad/s where the file states no speed; when --for is too short for it, that is said."""
    short = virtual("YAW", "set", "position=1.2", "--enable", "--for", "0.5s")
    assert short.status == 1
    assert short.messages[-1].startswith("YAW.position: limited in speed: only at 0.")
    whole = virtual("YAW", "set", "position=1.2", "--enable")
    assert whole.status == 0
    assert whole.out.startswith("YAW.position: set to 1.2 rad, is 1.")


def test_set_without_enabling(virtual: Any) -> None:
    """A joint that is not enabled follows nothing: status 1, one line, and what to do."""
    made = virtual("YAW", "set", "position=0.1", "--for", "0.2s")
    assert made.status == 1
    assert made.messages == ["YAW: not enabled, so it follows no set-points; add --enable"]


ENDS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGXCPU]


@pytest.mark.parametrize("ends", [[], *[[end] for end in ENDS], ENDS], ids=str)
@pytest.mark.parametrize("at", ["enabling", "moving"])
def test_whatever_ends_it_the_motor_is_off(
    virtual: Any, monkeypatch: pytest.MonkeyPatch, ends: list[signal.Signals], at: str
) -> None:
    """Its time, a signal, three of them, while it is enabled or after: control is off, and off is the last word."""
    if at == "enabling" and not ends:
        return
    worlds: list[VirtualRobot] = []
    recorders: list[ListeningNode] = []
    wait, make = device_do.Doing.wait, VirtualRobot.open

    def opens(robot: VirtualRobot) -> VirtualRobot:
        worlds.append(robot)
        recorders.append(ListeningNode(robot.wires["can"]))
        return make(robot)

    def waits(doing: Any, until: Any, duration: int) -> bool:
        device = doing.device
        if device.is_driven and device.is_enabled == (at == "moving") and not doing.patience.is_over:
            for end in ends:
                os.kill(os.getpid(), end)
        return wait(doing, until, duration)

    monkeypatch.setattr(VirtualRobot, "open", opens)
    monkeypatch.setattr(device_do.Doing, "wait", waits)
    made = virtual("KNEE", "set", "position=0.1", "--enable", "--for", "0.2s")
    assert "NOT" not in made.err
    assert not any(channel.control_on for channel in worlds[-1].twins["JMC1"].channels)
    commands = [frame.data[1] for frame in recorders[-1].frames() if frame.arbitration_id == 1]
    switches = [command for command in commands if command in (0x0E, 0x0F)]  # control on, control off
    assert switches[-1:] == [0x0F]


def test_a_closed_pipe_ends_it_with_the_motor_off(virtual: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is raised on the way, the device is told to stop before it comes out."""
    stopped: list[str] = []
    stop = device_do.Doing.stop

    def stops(doing: Any) -> None:
        stop(doing)
        stopped.append(doing.device.name)

    def broken(*_: Any) -> int:
        raise BrokenPipeError

    monkeypatch.setattr(device_do.Doing, "stop", stops)
    monkeypatch.setattr(device_do.Doing, "_show_set", broken)
    assert virtual("KNEE", "set", "position=0.1", "--enable", "--for", "0.1s").status == 0
    assert stopped == ["JMC1"]


def test_who_is_not_switched_off_is_said(virtual: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that stays on is named, also after an action that was interrupted, and the status is 1."""
    told: list[float] = []

    switch = HuboMotorTwin.control

    def deaf(twin: Any, request: Any) -> None:
        if type(request).__name__ == "ControlOn":
            switch(twin, request)
        else:
            told.append(twin.clock.now() / 1e9)

    monkeypatch.setattr(HuboMotorTwin, "control", deaf)
    made = virtual("KNEE", "set", "position=0.1", "--enable", "--for", "0.1s")
    assert made.status == 1
    assert made.messages[-1].startswith("NOT switched off: JMC1 (")
    assert "its status says that KNEE is still on" in made.messages[-1]
    assert len(told) > 20  # told again and again
    assert told[-1] - told[0] < 2


# ---------------------------------------------------------------------- actions


def test_an_action_with_progress_and_result(virtual: Any) -> None:
    """An action's result is shown; as JSON it is an object."""
    assert virtual("KNEE", "home").out == "KNEE home: KNEE\n"
    found = virtual("JMC0", "parameters")
    assert found.out.startswith("JMC0 parameters: done\n")
    assert "    YAW\n" in found.out
    whole = json.loads(virtual("JMC0", "parameters", "--json").out)
    assert whole["action"] == "parameters"
    assert whole["result"]["channels"]["YAW"]["kp"] == 200
    assert json.loads(virtual("TOE", "read", "name=alarm_led", "--json").out)["result"] == [
        "overheating",
        "overload",
    ]


def test_an_action_that_is_interrupted(virtual: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C ends a job, stops what moves, and is status 1."""
    stopped: list[bool] = []
    stop, wait = device_do.Doing.stop, device_do.Doing.wait

    def waits(doing: Any, until: Any, duration: int) -> bool:
        if not doing.patience.is_over and doing.device.last_received is not None:
            interrupt()
        return wait(doing, until, duration)

    def stops(doing: Any) -> None:
        stopped.append(True)
        stop(doing)

    monkeypatch.setattr(device_do.Doing, "stop", stops)
    monkeypatch.setattr(device_do.Doing, "wait", waits)
    made = virtual("KNEE", "home")
    assert made.status == 1
    assert made.messages == ["KNEE home: interrupted, and stopped"]
    assert stopped == [True]


def test_an_action_that_fails(virtual: Any) -> None:
    """What a device refuses is status 1 and one line."""
    made = virtual("TOE", "set_id", "number=300")
    assert made.status in (1, 2)
    assert len(made.messages) == 1


# ---------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("YAWW", "get"), "did you mean 'YAW'"),
        (("get", "YAW"), "aces device NAME get"),
        (("JMC2", "get"), "JMC2 is listed as inactive"),
        (("YAW", "get", "speed"), "no signal of YAW named 'speed'"),
        (("YAW", "fly"), "no action of JMC0 (hubo_motor) named 'fly'"),
        (("YAW", "set"), "set what?"),
        (("YAW", "set", "position"), "write NAME=VALUE"),
        (("YAW", "set", "position=far"), "'far' is not a number of rad, or degrees: 30deg"),
        (("YAW", "set", "position=nan"), "nan is not a number of rad"),
        (("YAW", "set", "position=1e999"), "inf is not a number of rad"),
        (("YAW", "set", "position=true"), "True is not a number of rad"),
        (("YAW", "set", "position=1", "position=2"), "position is given twice"),
        (("YAW", "set", "current=1"), "YAW.current can only be read (to be set: YAW.position)"),
        (("JMC0", "override_gains", "first=1"), "override_gains needs second=…"),
        (("YAW", "set_gains", "kx=1"), "no argument of set_gains named 'kx'"),
        (("YAW", "get", "--enable"), "--enable is for 'set'"),
        (("YAW", "home", "--for", "3s"), "--for is for 'set' and 'watch'"),
        (("YAW", "watch", "--every", "often"), "--every: 'often' is not a duration"),
        (("YAW", "get", "--bus", "can=can0"), "--virtual has no buses"),
    ],
)
def test_a_wrong_call(virtual: Any, arguments: tuple[str, ...], said: str) -> None:
    """A wrong call is status 2, one line that says what would be right, and nothing on stdout."""
    made = virtual(*arguments)
    assert made.status == 2
    assert said in made.err
    assert made.out == ""
    assert len(made.err.splitlines()) == 1


def test_nothing_is_changed_without_tx(aces: Aces, leg: str) -> None:
    """On real buses whatever changes a device needs --tx, and says so before a bus is opened."""
    for arguments in (("YAW", "home"), ("YAW", "set", "position=0")):
        made = aces("device", *arguments, "-r", leg, "--bus", "can=unix:nobody")
        assert made.status == 1
        assert "nothing was sent; add --tx" in made.err


def test_a_bus_that_cannot_be_opened(
    aces: Aces, leg: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It is named, with what to write; status 2."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("CAN_INTERFACE", raising=False)
    assert (
        "bus line: where is it? The robot's file does not say: --bus line="
        in aces("device", "TOE", "get", "-r", leg).err
    )
    gone = aces("device", "TOE", "get", "-r", leg, "--bus", "line=/dev/ttyNobody")
    assert gone.err == "aces: bus line (/dev/ttyNobody) cannot be opened: No such file or directory\n"
    none = aces("device", "YAW", "get", "-r", leg, "-i", "aces")
    assert none.status == 2
    assert "bus can (unix:leg0) cannot be opened" in none.err
    assert "aces sim -r ROBOT" in none.err
    assert (
        "no bus of leg named 'cam'; did you mean 'can'"
        in aces("device", "YAW", "get", "-r", leg, "--bus", "cam=can0").err
    )


# ---------------------------------------------------------------------- on buses that others are on


@pytest.fixture
def stand(
    leg: str, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[SimulatedRobot]:
    """The robot's twins on a served bus and a pseudo-terminal, with threads of their own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("run")))
    robot = chosen_robot(leg)
    with ExitStack() as stack:
        yield SimulatedRobot(robot, {name: {} for name in robot.buses}, 0, stack)


def test_on_a_served_bus(aces: Aces, leg: str, stand: SimulatedRobot) -> None:
    """Through a real bus values are read, another program sees it, and nothing is written on stderr.

    But that ticks were late, where the machine is busy.
    """
    with can.Bus("unix:leg0", interface="aces") as other:
        got = aces("device", "YAW", "get", "position", "-r", leg, "-i", "aces", "--ask")
        seen = other.recv(10)
    assert seen is not None
    assert seen.arbitration_id == 0x001  # the question; its answers come after it
    assert (got.status, got.out) == (0, "YAW.position  0 rad\n")
    assert [line for line in got.err.splitlines() if ": overrun: " not in line] == []
    assert aces("device", "JMC0", "parameters", "-r", leg, "-i", "aces").status == 0  # only asks: no --tx


@pytest.mark.slow
def test_a_looker_sees_what_another_program_asks(
    aces: Aces, leg: str, stand: SimulatedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a program that drives, `get` and `watch` show its answers and send nothing; whoever would ask, too, is refused
    by that program's name.
    """
    from argparse import Namespace

    from aces_tools.device import alone
    from aces_tools.robot_arg import open_robot

    monkeypatch.setattr("sys.argv", ["/usr/bin/aces", "run", "walk.py"])
    options = Namespace(bus=[], interface="aces", baud=None, virtual=False)
    command = ("device", "YAW", "get", "position", "-r", leg, "-i", "aces")
    twin = stand.simulation["JMC0"]
    with open_robot(alone(chosen_robot(leg), "JMC0"), options, rate_hz=50) as live:
        assert live.clock.wait(lambda: live.rig["YAW"].instant is not None, 20_000_000_000)
        got = aces(*command)
        watched = aces("device", "YAW", "watch", "position", "--for", "0.2s", "-r", leg, "-i", "aces")
        refused = aces(*command, "--ask")
        host = live.rig.hosts["can"]
        live.clock.call(host.close)
        assert live.clock.wait(lambda: twin.requests == host.counts.sent, 20_000_000_000)
        assert live.rig.events.count("duplicate reply") == 0
    assert got.status == 0
    assert got.out.startswith("YAW.position  ")
    assert watched.status == 0
    assert refused.status == 2
    assert "is driven by aces run (pid " in refused.err
    alone_again = aces(*command)
    assert alone_again.status == 1
    assert alone_again.messages == ["nothing came from JMC0: no other program asks it; --ask does"]


def test_on_a_pseudo_terminal(aces: Aces, leg: str, stand: SimulatedRobot) -> None:
    """A servo answers through its line; asking needs no --tx."""
    path = stand.reached["line"]["address"]
    got = aces("device", "TOE", "ping", "-r", leg, "--bus", f"line={path}")
    assert (got.status, got.out) == (0, "TOE ping: none\n"), got.err


@pytest.mark.slow
def test_a_device_that_is_not_there(
    aces: Aces, leg: str, stand: SimulatedRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`get` says who does not answer and what to look at; `set` and actions do nothing; status 1."""
    stand.simulation["JMC0"].fault("silent")
    monkeypatch.setattr(device_do, "HEARD_S", 1.0)
    got = aces("device", "YAW", "get", "position", "-r", leg, "-i", "aces", "--ask")
    assert (got.status, got.out) == (1, "YAW.position  unknown\n")
    (silent,) = [line for line in got.messages if line.startswith("JMC0: silent:")]
    assert "is it powered, on bus can, and board 0x00? `aces discover`" in silent
    made = aces("device", "YAW", "set", "position=0", "--enable", "--tx", "-r", leg, "-i", "aces")
    assert made.status == 1
    assert any(line.startswith("JMC0: silent:") for line in made.messages)
    assert made.messages[-1] == "JMC0 does not answer: nothing was set"


@pytest.mark.slow
def test_the_command_line_puts_twins_somewhere(aces: Aces) -> None:
    """`--pose` in degrees or rad, for twins only."""
    command = ("device", "RHP", "get", "position", "-r", "minihubo_1", "--virtual", "--json")
    for text in ("RHP=20deg", f"RHP={pi / 9}"):
        found = json.loads(aces(*command, "--pose", text).out)["RHP.position"]["value"]
        assert found == pytest.approx(pi / 9, abs=0.006)
    for more, said in (
        (("--pose", "RHP=high"), "--pose RHP=high: write JOINT=ANGLE"),
        (("--pose", "RHPP=1"), "RHPP"),
    ):
        wrong = aces(*command, *more)
        assert (wrong.status, said in wrong.err) == (2, True)
    real = aces("device", "RHP", "get", "-r", "minihubo_1", "--bus", "/dev/ttyX", "--pose", "RHP=0")
    assert (real.status, "--pose is for twins" in real.err) == (2, True)


def test_a_drive_that_was_switched_off_meanwhile_is_said(
    aces: Aces, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its own watchdog cut it off while this program was held up: the end says so, status 1, not only what was set."""
    from aces_devices.damiao.twin import DamiaoTwin

    robot = tmp_path / "arm.toml"
    robot.write_text(
        'name = "arm"\nrate_hz = 100\n[buses]\nb = { link = "can", protocol = "damiao" }\n[devices]\n'
        'M = { driver = "damiao", bus = "b", model = "4310", credentials = { motor = 1 } }\n'
        '[joints]\nJ = { device = "M", gains = { kp = 50, kd = 1 } }\n'
    )
    call = ("device", "J", "set", "position=0.2", "--enable", "--for", "1s", "--robot", robot, "--virtual")
    assert aces(*call).status == 0

    def cut_off(twin: DamiaoTwin) -> None:
        twin.clock.call_in(500_000_000, twin.lost)

    monkeypatch.setattr(DamiaoTwin, "watch_over", cut_off)
    result = aces(*call)
    assert result.status == 1
    assert any(
        "takes no set-points any more: it was switched off meanwhile" in one for one in result.messages
    )
