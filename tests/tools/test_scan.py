# Other hosts are planted.
# pyright: reportPrivateUsage=false
"""`aces discover`: finds what answers, writes a robot file that works, says what is missing."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from aces_bus import load_robot
from aces_bus.errors import SpecError
from aces_tools.robot_arg import chosen_robot
from aces_tools.sim import SimulatedRobot
from tests.tools.conftest import Aces
from tests.tools.test_device import leg as leg


@pytest.fixture
def lone(tmp_path: Path) -> str:
    """A robot with two drives on a serial line."""
    path = tmp_path / "lone.toml"
    path.write_text(
        'name = "lone"\n[buses]\nline = { link = "serial", protocol = "pololu_qik", baud = 38_400 }\n[devices]\n'
        + "\n".join(
            f'Q{n} = {{ driver = "pololu_qik", bus = "line", credentials = {{ id = {n} }}, settings.answers = true }}'
            for n in (1, 9)
        )
        + "\n",
        encoding="utf-8",
    )
    return str(path)


def test_everything_is_there(aces: Aces, leg: str) -> None:
    """With a robot each of its devices is found by name, and nothing is missing."""
    found = aces("discover", "-r", leg, "--virtual")
    assert found.status == 0
    assert {line.split()[-1] for line in found.out.splitlines()} == {"JMC0", "JMC1", "S7"}
    assert found.err == "found=3 missing=0\n"


@pytest.mark.slow
def test_something_is_missing(aces: Aces, leg: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that does not answer is said, as is one that the file has not; status 1."""
    text = (
        Path(leg)
        .read_text(encoding="utf-8")
        .replace("credentials = { board = 1 }", "credentials = { board = 5 }")
    )
    other = load_other(Path(leg), text)
    from aces_tools import discover as scan

    whole = chosen_robot(leg)
    hosts = scan.open_hosts
    monkeypatch.setattr(scan, "open_hosts", lambda robot, *rest: hosts(load_robot(other), *rest))
    found = aces("discover", "-r", leg, "--virtual")
    assert found.status == 1
    assert "can: hubo_motor board 0x05  not in the robot's file\n" in found.out
    assert "can: hubo_motor board 0x01  JMC1 does not answer\n" in found.out
    assert found.summary == {"found": len([d for d in whole.devices.values() if d.active]), "missing": 1}
    listed = json.loads(aces("discover", "-r", leg, "--virtual", "--json").out)
    assert listed["missing"] == ["JMC1"]
    assert {one["driver"] for one in listed["found"]} == {"hubo_motor", "robotis_rx"}


def load_other(path: Path, text: str) -> Path:
    """Another robot's file beside this one."""
    other = path.with_name("other.toml")
    other.write_text(text, encoding="utf-8")
    return other


@pytest.mark.slow
def test_a_file_of_what_was_found(
    aces: Aces, lone: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a real line a protocol's devices are found; the file that is written is right, and `aces device` works with it."""
    robot = chosen_robot(lone)
    path = tmp_path / "found.toml"
    with ExitStack() as stack:
        stand = SimulatedRobot(robot, {"line": {}}, 0, stack)
        line = stand.reached["line"]["address"]
        found = aces("discover", "-p", "pololu_qik", "--bus", line, "--baud", "38400", "-o", path)
        assert (found.status, found.out, found.err) == (0, "", "found=2 missing=0\n")
        assert aces("robot", "check", path).status == 0
        assert aces("device", "QIK9", "firmware", "-r", path).out.startswith("QIK9 firmware: done\n")
    written = load_robot(path)
    assert [config.credentials for config in written.devices.values()] == [{"id": 1}, {"id": 9}]
    assert written.buses["bus"].channel == line


@pytest.mark.slow
def test_nobody_is_there(aces: Aces, lone: str) -> None:
    """Nothing found is status 1, with what to look at, and no file."""
    with ExitStack() as stack:
        stand = SimulatedRobot(chosen_robot(lone), {"line": {}}, 0, stack)
        for twin in stand.simulation.twins.values():
            twin.power(False)
        line = stand.reached["line"]["address"]
        found = aces("discover", "-p", "pololu_qik", "--bus", line)
    assert (found.status, found.out) == (1, "")
    assert f"no device answers on {line}: is it powered" in found.err


def test_a_driver_that_cannot_be_loaded_is_left_out(
    aces: Aces, leg: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some other driver's trouble is said, and the scan goes on."""
    import aces_bus.device as devices

    load = devices.load_driver

    def loading(name: str) -> Any:
        if name == "hubovia":
            raise SpecError("driver 'hubovia' cannot be loaded")
        return load(name)

    monkeypatch.setattr("aces_tools.discover.load_driver", loading)
    found = aces("discover", "-r", leg, "--virtual")
    assert found.status == 0
    assert found.messages == ["driver 'hubovia' cannot be loaded; its devices are not looked for"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "which robot?"),
        (("-p", "hubo"), "which bus? --bus can0"),
        (("-p", "hubo", "--virtual"), "--virtual needs a robot"),
        (("-p", "hubo", "-r", "hubo2"), "leave --protocol out"),
        (("-p", "hubu", "--bus", "unix:x"), "did you mean 'hubo'"),
        (("-p", "hubo:D99", "--bus", "unix:x"), "D99"),
        (("-p", "hubo", "--bus", "unix:a", "--bus", "unix:b"), "one bus at a time"),
        (("-p", "hubo", "--bus", "unix:nobody"), "bus bus (unix:nobody) cannot be opened"),
        (("-p", "hubovia", "--bus", "127.0.0.1:9"), "no driver finds devices that speak hubovia"),
        (("-r", "hubo2", "--virtual", "-o", "x.toml"), "--output is for what --protocol finds"),
    ],
)
def test_a_wrong_call(
    aces: Aces, arguments: tuple[str, ...], said: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Status 2, one line that says what would be right, nothing on stdout."""
    monkeypatch.delenv("ACES_ROBOT", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    made = aces("discover", *arguments)
    assert made.status == 2
    assert said in made.err
    assert made.out == ""
