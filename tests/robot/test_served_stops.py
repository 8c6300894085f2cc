"""Stops over a served bus, on threads, with the twins in another process: order and outcome, at whatever speed.

The twins are a process of their own, and `aces run` another where signals are sent.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from math import nan
from pathlib import Path
from typing import Any

import pytest

from aces_bus.controller import IGNORE, Controller, Player, Trajectory, stop
from aces_bus.device import stopping
from aces_bus.errors import DeviceError
from aces_bus.robot import Ended, Runner, run_real
from aces_bus.robot.file import print_robot
from tests.bench.stops import Command
from tests.robot.served_twins import PATIENCE_S, Twins
from tests.robot.walking import HUBO, hubo_leg

BOARDS = ["JMC0", "JMC1", "JMC2", "JMC3"]


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twins]:
    made = Twins(tmp_path_factory.mktemp("bus") / "b.sock")
    yield made
    made.close()


@pytest.fixture
def twins(shared: Twins) -> Twins:
    """All boards well, whatever a test did with them."""
    for name in BOARDS:
        shared("deaf", name, False)
        shared("fault", name, "silent", False)
        shared("reboot", name)
    assert shared("off") == BOARDS
    return shared


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stop has longer than in life to be confirmed: the twins of a busy machine answer late."""
    give_time(monkeypatch, 10)


def give_time(monkeypatch: pytest.MonkeyPatch, seconds: int) -> None:
    """How long a stop is repeated; an attempt half of that."""
    monkeypatch.setattr(stopping, "STOP_NS", seconds * 1_000_000_000)
    monkeypatch.setattr(stopping, "ATTEMPT_NS", seconds * 500_000_000)
    monkeypatch.setattr(stopping.wait_stopped, "__defaults__", (2.0 * seconds,))


class Leg(Controller):
    """Holds a pose; from its tenth step it does what a test says."""

    def __init__(self, then: Any = None) -> None:
        super().__init__("leg", rate_hz=100, writes=HUBO)
        self.then, self.steps = then, 0

    def step(self, now_ns: int) -> Mapping[str, float]:
        self.steps += 1
        given: dict[str, float] = dict.fromkeys(HUBO, 0.1)
        return self.then(given) if self.then is not None and self.steps > 10 else given


#: On a slow machine other signs of trouble may come before the one that is meant.
CALM = {"*": IGNORE}


def run_on(
    twins: Twins,
    controllers: list[Any],
    reactions: Mapping[str, Any],
    fault: Any = None,
    seconds: float = PATIENCE_S,
    enough: Callable[[Runner], bool] = lambda run: False,
) -> tuple[Ended, Runner]:
    """Run until every controller was stopped, or it is enough, with the fault once the boards are on and controllers run."""
    bus = {"interface": "aces", "channel": f"unix:{twins.path}", "bitrate": 1_000_000, "restart_ms": 500}
    run = run_real(
        hubo_leg(),
        controllers,
        buses={"lower": bus},
        transmit=True,
        reactions={**CALM, **reactions},
        unhomed=True,
    )
    is_done = False

    def until() -> bool:
        nonlocal is_done
        if fault is not None and not is_done and run.set_points > 50:
            is_done = True
            fault()
        return (is_done or fault is None) and enough(run)

    with run:
        enable(run, twins, BOARDS)
        ended = run.run(seconds, until=until)
    return ended, run


def enable(run: Runner, twins: Twins, boards: list[str]) -> None:
    """Have boards on: again where a busy machine answers too late."""
    for _ in range(20):
        with suppress(DeviceError):
            run.do("enable", devices=boards)
            if twins("on") == boards:
                return
    raise TimeoutError("the boards are not enabled")


# ---------------------------------------------------------------------- controllers


def raises(given: dict[str, float]) -> dict[str, float]:
    raise ZeroDivisionError("by zero")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("then", "kind", "why"),
    [
        (raises, "raised", "ZeroDivisionError: by zero"),
        (lambda given: dict.fromkeys(given, nan), "dead-man", ""),
    ],
    ids=["raises", "gives NaN"],
)
def test_a_controller_that_fails(twins: Twins, then: Any, kind: str, why: str) -> None:
    """Every board is off, confirmed, and the reason is said."""
    ended, _ = run_on(twins, [Leg(then)], {kind: stop()})
    assert why in ended.tripped["leg"]
    assert ended.not_stopped == {}
    assert twins("off") == BOARDS


@pytest.mark.slow
def test_a_controller_that_blocks(twins: Twins) -> None:
    """The boards are off before the step has come back: nothing of a stop waits for it."""
    order: list[str] = []
    release = threading.Event()

    def look() -> None:
        order.append("off" if twins.wait_for("off", BOARDS) else "still on")
        release.set()

    looker = threading.Thread(target=look)

    def block(given: dict[str, float]) -> dict[str, float]:
        if not looker.ident:
            looker.start()
            release.wait(2 * PATIENCE_S)
            order.append("came back")
        return given

    ended, _ = run_on(twins, [Leg(block)], {"dead-man": stop()})
    looker.join()
    assert order == ["off", "came back"]
    assert "has not come back" in ended.tripped["leg"]
    assert ended.failed == []


@pytest.mark.slow
def test_a_controller_that_finishes(twins: Twins) -> None:
    """A player at its end trips nothing; the run's own end switches off."""
    player = Player("p", Trajectory(["RKN"], [[0.0], [0.05]], rate_hz=10), rate_hz=100)
    run = run_real(
        hubo_leg(),
        [player],
        buses={"lower": {"interface": "aces", "channel": f"unix:{twins.path}"}},
        transmit=True,
        reactions=CALM,
        unhomed=True,
    )
    with run:
        enable(run, twins, BOARDS)
        ended = run.run(PATIENCE_S, until=lambda: player.mode == "ended")
    assert (ended.tripped, ended.not_stopped) == ({}, {})
    assert twins("off") == BOARDS


@pytest.mark.slow
def test_hold_holds_until_its_time_is_over(twins: Twins) -> None:
    """Held, the boards stay on with live set-points although the controller gives none; then they are switched off."""
    run: Runner
    seen: list[Any] = []

    def handler(event: Any) -> None:
        if event.kind == "trip":
            seen.append((event.detail.partition(":")[0], event.instant))

    bus = {"interface": "aces", "channel": f"unix:{twins.path}"}
    run = run_real(
        hubo_leg(),
        [Leg(raises)],
        buses={"lower": bus},
        transmit=True,
        reactions={**CALM, "raised": stop("hold")},
        hold_s=0.3,
        unhomed=True,
    )
    run.handlers.append(handler)
    with run:
        enable(run, twins, BOARDS)
        ended = run.run(PATIENCE_S)
    assert [what for what, _ in seen] == ["hold", "disable"]
    assert seen[1][1] - seen[0][1] >= 300_000_000
    assert ended.tripped["leg"].endswith("held for 0.3 s")
    assert twins("off") == BOARDS


# ---------------------------------------------------------------------- boards and buses


@pytest.mark.slow
def test_a_silent_board(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    """The others are off; the silent one is named, for it cannot say that it is."""
    give_time(monkeypatch, 4)
    ended, _ = run_on(
        twins, [Leg()], {"silent": stop()}, fault=lambda: twins("fault", "JMC1", "silent", True)
    )
    assert "silent" in ended.tripped["leg"]
    assert "JMC1" in ended.not_stopped
    assert set(twins("off")) >= {"JMC0", "JMC2", "JMC3"}


@pytest.mark.slow
def test_bus_off_and_recovery(twins: Twins) -> None:
    """The host leaves the bus for half a second: the stop is the first to leave when it is back, and is confirmed."""
    ended, _ = run_on(twins, [Leg()], {"bus-off": stop()}, fault=lambda: twins("bus-off"))
    assert "bus-off" in ended.tripped["leg"]
    assert twins.wait_for("off", BOARDS)


@pytest.mark.slow
def test_a_stop_that_is_not_confirmed(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    """A board that stays on is named, and the others are off."""
    give_time(monkeypatch, 4)
    ended, _ = run_on(twins, [Leg()], {}, fault=lambda: twins("deaf", "JMC2", True), enough=lambda run: True)
    assert list(ended.not_stopped) == ["JMC2"]
    assert "still on" in ended.not_stopped["JMC2"]
    assert twins("on") == ["JMC2"]


# ---------------------------------------------------------------------- signals

PROGRAM = """
from aces_bus.controller import controller

@controller(rate_hz=100, writes=["RKN"])
def knee(t):
    return {"RKN": 0.1}
"""


def command(twins: Twins, folder: Path, *words: str) -> Command:
    program = folder / "knee.py"
    program.write_text(PROGRAM)
    robot = folder / "leg.toml"
    robot.write_text(print_robot(hubo_leg()))
    return Command(
        *("run", "-r", str(robot), str(program), "-i", "aces", "--bus", f"lower=unix:{twins.path}"),
        *("--on-trip", "ignore", "--tx", "--quiet", "--unhomed", *words),
    )


def begun(twins: Twins, folder: Path) -> Command:
    """The command, with the knee's board on: again where a busy machine answered too late for it to begin."""
    said = ""
    for _ in range(10):
        run = command(twins, folder)
        while twins("on") != ["JMC2"]:
            if run.poll():
                said = run.said()
                break
            time.sleep(0.02)
        else:
            return run
        run.wait()
    raise TimeoutError(said)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals(twins: Twins, tmp_path: Path, number: signal.Signals) -> None:
    """Ctrl-C, SIGTERM and SIGHUP end `aces run` with the board off."""
    run = begun(twins, tmp_path)
    os.kill(run.pid, number)
    assert run.wait() in (0, 130), run.said()  # 130: it was still about to begin
    assert "NOT switched off" not in run.said()
    assert twins("on") == []


@pytest.mark.slow
def test_not_switched_off(twins: Twins, tmp_path: Path) -> None:
    """A board that does not obey is named on stderr, and the status is 1."""
    run = begun(twins, tmp_path)
    twins("deaf", "JMC2", True)
    os.kill(run.pid, signal.SIGINT)
    assert run.wait() in (1, 130)
    assert "NOT switched off: JMC2\n" in run.said()


@pytest.mark.slow
def test_kill_9_leaves_the_board_on(twins: Twins, tmp_path: Path) -> None:
    """Nothing can be sent any more: a board without a watchdog stays on, until a program stops it."""
    run = begun(twins, tmp_path)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    assert twins("on") == ["JMC2"]
    while command(
        twins, tmp_path, "--for", "100ms"
    ).wait():  # a busy machine may answer too late for it to begin
        pass
    assert twins("off") == BOARDS
