"""Over served buses, twins in another process: limits by measurement, an end that holds, and kill -9."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

ACES = (sys.executable, "-m", "aces_tools")
ARM = """
name = "arm"
rate_hz = 100
[buses]
drives = {{ link = "can", protocol = "odrive", interface = "aces", channel = "unix:{folder}/d.sock" }}
motors = {{ link = "can", protocol = "damiao", interface = "aces", channel = "unix:{folder}/m.sock" }}
[devices]
D4 = {{ driver = "damiao", bus = "motors", model = "4310", credentials = {{ motor = 4 }}, settings = {{ timeout_s = 1.0 }} }}
O1 = {{ driver = "odrive", bus = "drives", credentials = {{ node = 1 }} }}
O2 = {{ driver = "odrive", bus = "drives", credentials = {{ node = 2 }} }}
[joints]
wrist = {{ device = "D4", gains = {{ kp = 50, kd = 1 }} }}
elbow = {{ device = "O1" }}
winch = {{ device = "O2", command = "speed", lower = -1, upper = 1, max_speed = 3 }}
"""
LAW = """
from aces_bus.controller import controller
@controller(rate_hz=100, writes=["wrist", "elbow", "winch"])
def move(t):
    return {"wrist": 0.1 * t, "elbow": 0.1 * t, "winch": 2.0}
"""


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[Path]:
    """The robot's file, its twins on served buses."""
    robot = tmp_path / "arm.toml"
    robot.write_text(ARM.format(folder=tmp_path))
    (tmp_path / "law.py").write_text(LAW)
    sim = subprocess.Popen(
        [*ACES, "sim", "-r", str(robot), "--for", "60s"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        end = time.monotonic() + 20
        while not all((tmp_path / name).exists() for name in ("d.sock", "m.sock")) and time.monotonic() < end:
            time.sleep(0.05)
        yield robot
    finally:
        sim.terminate()
        sim.wait(10)


def shown(robot: Path, joint: str, signal_name: str) -> str:
    """What a second program reads of a joint's device."""
    call = [*ACES, "device", "-r", str(robot), joint, "get", signal_name, "--ask"]
    return subprocess.run(call, capture_output=True, text=True, timeout=30, check=False).stdout


@pytest.mark.slow
def test_an_end_that_holds_over_served_buses(arm: Path) -> None:
    """The winch stops at its bound; the elbow is left in closed loop; what would fall is said before, and off after."""
    law = str(arm.with_name("law.py"))
    call = [*ACES, "run", "-r", str(arm), law, "--tx", "--for", "4s", "--at-end", "hold", "--quiet"]
    ended = subprocess.run(call, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 0, ended.stderr
    lines = ended.stderr.splitlines()
    assert "aces: left enabled, where they are: O1" in lines
    assert "aces: not held, and switched off: D4, O2" in lines
    before = next(
        n for n, line in enumerate(lines) if line.startswith("aces: D4 cannot be held, and may fall")
    )
    assert before < lines.index("aces: left enabled, where they are: O1")
    assert 0.9 < float(shown(arm, "winch", "position").split()[1]) < 1.03
    assert "closed_loop" in shown(arm, "O1", "state")
    assert "idle" in shown(arm, "O2", "state")
    assert "disabled" in shown(arm, "D4", "status")


@pytest.mark.slow
def test_what_a_killed_run_leaves_behind_is_as_declared(arm: Path) -> None:
    """kill -9: a Damiao is off by its own time-out, an ODrive without a watchdog stays in closed loop."""
    call = [*ACES, "run", "-r", str(arm), str(arm.with_name("law.py")), "--tx", "--for", "60s"]
    run = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert run.stdout is not None
    with run.stdout as lines:
        assert lines.readline()  # it runs
        os.kill(run.pid, signal.SIGKILL)
    run.wait(10)
    time.sleep(1.3)
    assert "lost_communication" in shown(arm, "D4", "status")
    assert "closed_loop" in shown(arm, "O1", "state")
