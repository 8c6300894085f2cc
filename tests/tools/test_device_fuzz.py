"""`aces device fuzz`: what it finds is said, saved and repeated by the commands that it prints."""

from __future__ import annotations

import json
import shlex
from contextlib import ExitStack
from copy import copy
from pathlib import Path
from typing import Any

import pytest

from aces_bus.device.drivers import DRIVERS
from aces_bus.protocol.files import PROTOCOLS
from aces_tools.robot_arg import chosen_robot
from aces_tools.sim import SimulatedRobot
from tests.testing.faulty_pumps import HangsOnABoundary, Pump, SerialPump, pump
from tests.tools.conftest import Aces

WAIT_NS = 20_000_000_000


@pytest.fixture(autouse=True)
def pumps(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A pump that hangs, on CAN and on a line, as if installed; files and sockets of this test alone."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("ACES_ROBOT", raising=False)
    for registry in (DRIVERS, PROTOCOLS):
        for name in ("_added", "_loaded"):
            monkeypatch.setattr(registry, name, copy(vars(registry)[name]))
    for link, kind in (("can", Pump), ("serial", SerialPump)):
        driver = pump(HangsOnABoundary, link)
        DRIVERS.add(driver.name, driver, "tests")
        protocol: Any = kind.protocol
        PROTOCOLS.add(driver.protocol, protocol, "tests")
        Path(f"{driver.name}.toml").write_text(driver.example, encoding="utf-8")


def found(aces: Aces, *words: str) -> Any:
    """The one finding of a search in JSON."""
    made = aces("device", "fuzz", *words, "--seed", "1", "--most", "1", "--json")
    assert made.status == 1
    (finding,) = json.loads(made.out)["findings"]
    return finding


def test_a_finding_is_drawn_saved_and_repeated(aces: Aces) -> None:
    """stdout has what broke it and how to have it again; the summary names the seed; --replay gives the same."""
    made = aces("device", "fuzz", "can_pump", "--twin", "--seed", "1", "--most", "1")
    assert made.status == 1
    lines = made.out.splitlines()
    assert lines[0].startswith("P1 silent: Ask is not answered: asked 4 times in ")
    assert lines[1].strip() == "1 × Configure node=3 key=0 value=65535"
    assert made.err.splitlines()[-1].endswith("seed=1: 1 found")
    again = next(line.strip() for line in lines if "--replay" in line)
    replayed = aces(*shlex.split(again)[1:])
    assert replayed.status == 1
    assert replayed.out.startswith("P1 silent: Ask is not answered")


def test_nothing_found(aces: Aces) -> None:
    """Status 0, and a line that says how much was tried."""
    made = aces(
        "device", "fuzz", "can_pump", "--twin", "--not", "Configure", "--seed", "1", "--frames", "500"
    )
    assert (made.status, made.out) == (0, "")
    assert made.summary["frames"] == 500
    assert made.err.endswith("seed=1: nothing found\n")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "link"), [("can_pump", "can"), ("serial_pump", "serial")])
def test_what_play_repeats_breaks_a_fresh_twin(aces: Aces, name: str, link: str) -> None:
    """`aces sim` serves one, the printed `aces play` breaks it."""
    finding = found(aces, name, "--twin", "-o", f"found.{'log' if link == 'can' else 'slog'}")
    _, _, play = finding["commands"]
    robot = chosen_robot(f"{name}.toml")
    with ExitStack() as stack:
        served = SimulatedRobot(robot, {"line": {}}, 0, stack)
        twin = served.simulation["P1"]
        assert not vars(twin)["is_hung"]
        words = [
            served.reached["line"]["address"] if word == "PORT" else word for word in shlex.split(play)[1:]
        ]
        assert aces(*words).status == 0
        assert served.loop.wait(lambda: bool(vars(twin)["is_hung"]), WAIT_NS)


@pytest.mark.slow
def test_a_real_device(aces: Aces) -> None:
    """Without --tx nothing is sent, and what would be is said; with it the device is asked, and stopped at the end."""
    call = [
        "device",
        "fuzz",
        "P1",
        "-r",
        "can_pump.toml",
        "--bus",
        "line=unix:line",
        "--seed",
        "1",
        "--frames",
        "10",
        "--rate",
        "500",
    ]
    made = aces(*call)
    assert made.status == 1
    assert "P1: sent are Ask; left out: Begin, Configure, Data, Finish, Read, SetSpeed" in made.err
    assert made.messages[-1].startswith("nothing was sent: add --tx")
    with ExitStack() as stack:
        served = SimulatedRobot(chosen_robot("can_pump.toml"), {"line": {}}, 0, stack)
        assert aces(*call, "--tx").status == 0
        twin = served.simulation["P1"]
        assert vars(twin)["commands"] >= 1  # the stop, and nothing else that it counts
        assert vars(twin)["speed"] == 0


def test_one_program_drives(aces: Aces) -> None:
    """A bus that another program drives is not fuzzed."""
    from aces_bus.hardware.lock import BusLock

    lock = BusLock("unix:line", "line")
    lock.take()
    try:
        served = ["--bus", "line=unix:line", "--tx", "--frames", "5"]
        with ExitStack() as stack:
            SimulatedRobot(chosen_robot("can_pump.toml"), {"line": {}}, 0, stack)
            made = aces("device", "fuzz", "P1", "-r", "can_pump.toml", *served)
    finally:
        lock.release()
    assert made.status == 2
    assert "is driven by" in made.err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["can_pump", "--twin", "--not", "Aks"], "Aks"),
        (["can_pump", "--twin", "--bus", "line=can0"], "--bus is for a real device"),
        (["P1", "-r", "can_pump.toml", "--replay", "x.log"], "--replay is for twins"),
        (["can_pump", "--twin", "-r", "can_pump.toml"], "--virtual"),
        (["can_pump", "--twin", "--then", "fly"], "fly"),
        (["can_pump", "--twin", "--virtual"], "not allowed with"),
        (["can_pump"], "--twin"),
    ],
)
def test_wrong_calls(aces: Aces, words: list[str], message: str) -> None:
    """Each is one line, before anything is sent."""
    made = aces("device", "fuzz", *words)
    assert made.status == 2
    assert message in made.err
