"""`aces sim`: where twins stand, how others join, faults, and how it ends."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import can
import pytest

from aces_bus.errors import CallerError, UnknownNameError
from aces_tools.robot_arg import chosen_robot
from aces_tools.sim import SimulatedRobot, parse_fault
from tests.tools.conftest import Aces
from tests.tools.test_device import leg as leg

WAIT_S = 20.0


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Sockets of these tests alone."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("run")))


def test_how_to_join_is_said(aces: Aces, leg: str) -> None:
    """stdout has a line a bus and one for all that can be copied; stderr says the rest, and the counts at the end."""
    made = aces("sim", "-r", leg, "--for", "10ms")
    assert made.status == 0
    lines = made.out.splitlines()
    assert lines[0] == f"can: aces sniff -i aces -c unix:leg0 -p hubo@{leg}"
    assert lines[1].startswith("line: aces discover --bus /dev/")
    assert lines[2].startswith(f"aces device -r {leg} --bus can=unix:leg0 --bus line=/dev/")
    assert made.messages == ["leg: 3 devices are there; runs until Ctrl-C"]
    assert made.summary == {"requests": 0, "replies": 0, "others": 0}


def test_devices_of_one_kind_without_a_file(aces: Aces) -> None:
    """`-p`: the line that a program needs is what stdout says first."""
    made = aces("sim", "-p", "moteus", "--id", "1,2", "--fd", "--for", "10ms")
    assert made.out.splitlines()[0].startswith("channel: unix:moteus ")
    assert made.messages == ["moteus: 2 devices are there; runs until Ctrl-C"]
    made = aces("sim", "-p", "feetech", "--model", "STS3215", "--for", "10ms")
    assert made.out.startswith("port: /dev/pts/")
    for wrong in (["--id", "3"], ["-p", "moteus", "-r", "so101"], ["-p", "nothing"]):
        assert aces("sim", *wrong).status == 2


def test_as_json(aces: Aces, leg: str) -> None:
    """As JSON: the buses, and at the end the counts."""
    first, last = aces("sim", "-r", leg, "--for", "10ms", "--json").objects
    assert first["robot"] == "leg"
    assert first["buses"]["can"] == {"kind": "can", "interface": "aces", "address": "unix:leg0"}
    assert first["buses"]["line"]["baud"] == 1_000_000
    assert last["devices"]["S7"] == {"requests": 0, "replies": 0}


@pytest.mark.slow
def test_a_program_of_its_own(leg: str) -> None:
    """As a process: clients come and go, Ctrl-C ends it with the counts and status 0."""
    process = subprocess.Popen(
        [sys.executable, "-m", "aces_tools", "sim", "-r", leg],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    try:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert "unix:leg0" in first
        for _ in range(2):
            heard = _position(leg)
            assert heard == 0.0
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=WAIT_S)
    finally:
        process.kill()
    assert process.returncode == 0, err
    assert "Traceback" not in err
    counts = dict(pair.split("=") for pair in err.splitlines()[-1].split())
    assert int(counts["requests"]) >= 2
    assert counts["requests"] == counts["replies"]
    assert not Path(os.environ["XDG_RUNTIME_DIR"], "aces", "leg0.sock").exists()


def _position(leg: str) -> Any:
    """A joint's position, asked as another program would."""
    from argparse import Namespace

    from aces_tools.device import alone
    from aces_tools.robot_arg import open_robot

    options = Namespace(bus=[], interface="aces", baud=None, virtual=False)
    with open_robot(alone(chosen_robot(leg), "JMC1"), options, rate_hz=100) as live:
        signal_ = live.rig["KNEE.position"]
        assert live.clock.wait(lambda: signal_.instant is not None, round(WAIT_S * 1e9))
        return signal_.last


def test_a_name_that_is_served(aces: Aces, leg: str) -> None:
    """A second one says who is there and how to have another name; named, a served bus is joined, a new one is made."""
    robot = chosen_robot(leg)
    with ExitStack() as stack:
        SimulatedRobot(robot, {name: {} for name in robot.buses}, 0, stack)
        second = aces("sim", "-r", leg, "--for", "10ms")
        assert second.status == 2
        assert (
            "unix:leg0 is served already; --bus can=unix:leg0 joins it, --bus can=unix:leg_can" in second.err
        )
        joined = aces("sim", "-r", leg, "--bus", "can=unix:leg0", "--for", "10ms")
        assert joined.status == 0
        assert "-c unix:leg0" in joined.out
        other = aces("sim", "-r", leg, "--bus", "can=unix:leg_can", "--for", "10ms")
        assert other.status == 0
        assert "-c unix:leg_can" in other.out


LONE = """
name = "lone"
rate_hz = 50
[buses]
can = { link = "can", protocol = "odrive", bitrate = 250_000, channel = "lone0" }
[devices]
AXIS0 = { driver = "odrive", bus = "can", credentials = { node = 0 } }
"""


def test_a_listener_sees_what_a_lone_device_sends(aces: Aces, tmp_path: Path) -> None:
    """The bus acknowledges what a device sends of its own accord, also where `aces sniff` is all that listens."""
    file = tmp_path / "lone.toml"
    file.write_text(LONE)
    robot = chosen_robot(str(file))
    with ExitStack() as stack:
        SimulatedRobot(robot, {"can": {}}, 0, stack)
        got = aces("sniff", "unix:lone0", "-p", "odrive", "-n", "3", "--for", "20s")
    assert (got.status, got.summary["decoded"]) == (0, 3)


def test_a_file_may_name_a_served_bus(aces: Aces, tmp_path: Path) -> None:
    """`channel = "unix:NAME"` in a robot's file is the bus that `aces sim` serves, as it is the one that others join."""
    file = tmp_path / "lone.toml"
    file.write_text(LONE.replace('"lone0"', '"unix:lone1"'))
    assert aces("robot", "check", file).status == 0
    robot = chosen_robot(str(file))
    with ExitStack() as stack:
        SimulatedRobot(robot, {"can": {}}, 0, stack)
        got = aces("sniff", "unix:lone1", "-p", "odrive", "-n", "1", "--for", "20s")
        asked = aces("device", "AXIS0", "get", "-r", file, "--ask")
    assert (got.status, got.summary["decoded"]) == (0, 1)
    assert (asked.status, "AXIS0.position" in asked.out) == (0, True), asked.err


FD = """
name = "fd"
rate_hz = 50
[buses]
can = { link = "can", protocol = "moteus", bitrate = 1_000_000, data_bitrate = 5_000_000, channel = "fd0" }
[devices]
M1 = { driver = "moteus", bus = "can", credentials = { id = 1 } }
[joints]
KNEE = { device = "M1" }
"""


def test_the_data_bitrate_of_the_file_is_that_of_the_bus(aces: Aces, tmp_path: Path) -> None:
    """A served bus has the file's data bit rate, hosts open it so, and CAN FD frames both ways are switched to it."""
    file = tmp_path / "fd.toml"
    file.write_text(FD)
    robot = chosen_robot(str(file))
    with ExitStack() as stack:
        SimulatedRobot(robot, {"can": {}}, 0, stack)
        with can.Bus("unix:fd0", "aces", fd=True, data_bitrate=5_000_000) as listener:
            assert aces("device", "M1", "get", "-r", file, "-i", "aces", "--ask").status == 0
            seen = [listener.recv(WAIT_S) for _ in range(2)]
        with pytest.raises(can.CanInitializationError, match="5"):
            can.Bus("unix:fd0", "aces", fd=True, data_bitrate=2_000_000)
    assert [one is not None and one.is_fd and one.bitrate_switch for one in seen] == [True, True]


def test_datagrams(aces: Aces) -> None:
    """A datagram bus is bound where the call says; a port that is taken is named."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        made = aces("sim", "-r", "hubovia", "--bus", f"pc=127.0.0.1:{port}", "--for", "10ms")
        assert made.status == 2
        assert f"bus pc (127.0.0.1:{port}) cannot be opened" in made.err
    made = aces("sim", "-r", "hubovia", "--bus", f"pc=127.0.0.1:{port}", "--for", "10ms")
    assert made.status == 0
    assert made.out.splitlines()[0] == f"pc: udp 127.0.0.1:{port}, hubovia"
    assert "pc=127.0.0.1:11000" in aces("sim", "-r", "hubovia", "--bus", "pc=11000").err


def test_faults(aces: Aces, leg: str) -> None:
    """Faults are a device's and its kind's; those of a kind are for those who have it; they are listed."""
    robot = chosen_robot(leg)
    assert parse_fault(robot, "S7:late=0.2") == (["S7"], "late", 0.2)
    assert parse_fault(robot, "*:silent") == (["JMC0", "JMC1", "S7"], "silent", None)
    assert parse_fault(robot, "*:fet_fault") == (["JMC0", "JMC1"], "fet_fault", None)
    for text in ("JMC9:silent", "S7:fet_fault", "*:nothing"):
        with pytest.raises(UnknownNameError):
            parse_fault(robot, text)
    for text in ("S7", "S7:", ":silent", "S7:late=soon", "S7:late="):
        with pytest.raises(CallerError):
            parse_fault(robot, text)
    listed = json.loads(aces("sim", "-r", leg, "--list-faults", "--json").out)
    assert listed["hubo_motor"]["devices"] == ["JMC0", "JMC1"]
    assert "jam" in listed["hubo_motor"]["faults"]
    assert "hubo_motor:  JMC0, JMC1" in aces("sim", "-r", leg, "--list-faults").out
    assert aces("sim", "-r", leg, "--fault", "S7:cold").status == 2
