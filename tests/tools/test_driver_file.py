"""Drivers of a file: used by every command that works on a robot, without being installed.

The registries are a program's own, so each call here is a program.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

DRIVER = Path(__file__).parents[2] / "examples" / "own_driver.py"
ROBOT = """
name = "two wheels"
rate_hz = 100
[buses]
wheels = { link = "can", protocol = "my_wheel" }
[devices]
LEFT  = { driver = "my_wheel", bus = "wheels", credentials = { node = 1 } }
"""
CONTROLLER = """
from aces_bus.controller import controller

@controller(rate_hz=50, writes=["LEFT.velocity"])
def turn(t):
    return {"LEFT.velocity": 3.0}
"""


def aces(*words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "aces_tools", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    path = tmp_path / "wheels.toml"
    path.write_text(ROBOT)
    return path


@pytest.mark.slow
def test_a_device_of_a_files_driver(robot: Path) -> None:
    """Its twin answers; its protocol is that of the file."""
    got = aces("device", "LEFT", "get", "-r", robot, "--virtual", "--json", "--driver", DRIVER)
    assert got.returncode == 0, got.stderr
    assert json.loads(got.stdout)["LEFT.position"] == {
        **json.loads(got.stdout)["LEFT.position"],
        "value": 0.0,
        "unit": "rad",
    }


@pytest.mark.slow
def test_a_controller_drives_it(robot: Path) -> None:
    """In a run, with its limits and its stop."""
    (robot.parent / "turn.py").write_text(CONTROLLER)
    ran = aces(
        "run", "-r", robot, robot.parent / "turn.py", "--virtual", "--for", "0.5s", "--driver", DRIVER, "-q"
    )
    assert ran.returncode == 0, ran.stderr
    assert " set_points=26 " in ran.stderr


@pytest.mark.slow
def test_its_twins_are_served(robot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`aces sim` puts them on a bus, and lists how they misbehave."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    served = aces("sim", "-r", robot, "--driver", DRIVER, "--for", "10ms", "--json")
    assert served.returncode == 0, served.stderr
    assert json.loads(served.stdout.splitlines()[0])["buses"]["wheels"]["address"] == "unix:wheels"


@pytest.mark.slow
def test_a_robot_of_a_files_driver_is_checked(robot: Path) -> None:
    """`aces robot check` knows its driver and its protocol then; without they are not installed."""
    assert aces("robot", "check", robot, "--strict").returncode == 1
    checked = aces("robot", "check", robot, "--strict", "--driver", DRIVER)
    assert (checked.returncode, checked.stdout) == (0, f"{robot}: ok: 1 device, 1 bus\n")


@pytest.mark.slow
def test_what_a_twin_of_a_file_raises_has_its_line(robot: Path) -> None:
    """A fault in the user's file is one line with its place, and no traceback."""
    broken = robot.parent / "own_driver.py"
    lines = DRIVER.read_text().splitlines()
    at = next(number for number, line in enumerate(lines, 1) if "def setup(self)" in line and number > 60)
    lines.insert(at, "        self.nothing_of_the_kind()")
    broken.write_text("\n".join(lines))
    got = aces("device", "LEFT", "get", "-r", robot, "--virtual", "--driver", broken)
    assert got.returncode == 2
    assert got.stderr.startswith(f"aces: {broken}:{at + 1}: AttributeError: ")
    assert got.stderr.count("\n") == 1


SCAN = """
def scan(host, job):
    found = []
    for node in range(1, 4):
        if (yield from host.answers("my_wheel", {"node": node}, "GetEstimates", reply="Estimates", timeout_s=0.5)):
            found.append(DeviceConfig(name=f"AXIS{node}", driver="my_wheel", bus=host.name, credentials={"node": node}))
    return found

driver = replace(driver, scan=scan)
"""


@pytest.mark.slow
def test_its_devices_are_found(robot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the protocol's file and the driver's, which here is the same; the robot's file that is written works with them."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    own, found = tmp_path / "own.py", tmp_path / "found.toml"
    head = "from dataclasses import replace\nfrom aces_bus.device.config import DeviceConfig\n"
    future = "from __future__ import annotations\n"
    source = DRIVER.read_text().partition("def main()")[0]
    own.write_text(source.replace(future, future + head) + SCAN)
    command = [sys.executable, "-m", "aces_tools", "sim", "-r", str(robot), "--driver", str(own), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as twins:
        try:
            assert twins.stdout is not None
            bus = json.loads(twins.stdout.readline())["buses"]["wheels"]["address"]
            discover = aces("discover", "-p", own, "--driver", own, "--bus", bus, "-o", found)
            assert discover.stderr == "found=1 missing=0\n"
            got = aces("device", "AXIS1", "get", "-r", found, "--driver", own, "--ask", "--json")
            assert got.returncode == 0, got.stderr
        finally:
            twins.terminate()
    assert 'protocol = "own.py"' in found.read_text()


@pytest.mark.slow
def test_what_is_no_driver_is_refused(robot: Path, tmp_path: Path) -> None:
    """Without the file; a file without one; a name that an installed driver has."""
    (tmp_path / "none.py").write_text("x = 1\n")
    source = DRIVER.read_text().replace('"my_wheel", ODrive', '"hubo_motor", ODrive')
    (tmp_path / "clash.py").write_text(source)
    command = ("device", "LEFT", "get", "-r", robot, "--virtual")
    for more, said in (
        ((), "my_wheel"),
        (("--driver", tmp_path / "none.py"), "none.py: declares no driver at its top level"),
        (("--driver", tmp_path / "clash.py"), "two packages claim the driver name 'hubo_motor'"),
    ):
        wrong = aces(*command, *more)
        assert wrong.returncode == 2, wrong.stderr
        assert said in wrong.stderr
        assert "Traceback" not in wrong.stderr
