"""Faults of boards, answers and programs over a served bus, on threads, with the twins in another process.

`test_faults.py` has them in virtual time, with instants; here it is which sign of them comes, and what follows.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Mapping

import pytest

from aces_bus.controller import stop
from aces_bus.errors import AcesError
from aces_bus.robot import Runner, connect, open_gates
from aces_bus.runtime.loop import Loop
from tests.robot.served_twins import PATIENCE_S, Twins
from tests.robot.test_served_stops import BOARDS, Leg, give_time, run_on
from tests.robot.test_served_stops import patience as patience
from tests.robot.test_served_stops import shared as shared
from tests.robot.test_served_stops import twins as twins
from tests.robot.walking import hubo_leg


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "kind", "said"),
    [
        ("twice", "two devices", "are there two devices with board 0x01"),
        ("wrong_number", "silent", "requests without an answer"),
        ("wrong_check", "", ""),
    ],
)
def test_a_board_that_misbehaves(
    twins: Twins, fault: str, kind: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two boards of one number, and one that answers with another's, are said by name, and all is switched off.

    A fault that Hubo's answers cannot have, for they carry no check, changes nothing.
    """
    give_time(monkeypatch, 4)
    reactions = {kind: stop()} if kind else {}
    ended, run = run_on(
        twins,
        [Leg()],
        reactions,
        lambda: twins("fault", "JMC1", fault, True),
        enough=lambda run: not kind and run.set_points > 400,
    )
    twins("fault", "JMC1", fault, False)
    if kind:
        assert f"{kind}: " in ended.tripped["leg"]
        assert said in ended.tripped["leg"]
        assert twins.wait_for("off", BOARDS)
        assert "JMC1" in ended.not_stopped
    else:
        assert ended.tripped == {}
    assert run.rig.hosts["lower"].counts.received


@pytest.mark.slow
def test_one_of_two_boards_does_not_answer_any_more(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may not receive either, and move on: that the other one says that it is off confirms no stop."""
    give_time(monkeypatch, 4)

    def one_is_left(run: Runner) -> bool:
        is_seen = run.rig.devices["JMC1"].is_double
        return is_seen and bool(twins("fault", "JMC1", "twice", False))

    ended, _ = run_on(twins, [Leg()], {}, lambda: twins("fault", "JMC1", "twice", True), enough=one_is_left)
    assert ended.tripped == {}
    assert "two devices answer as board 0x01" in ended.not_stopped["JMC1"]
    assert twins.wait_for("off", BOARDS)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["loses", "late"])
def test_answers_that_are_lost_or_late(twins: Twins, fault: str) -> None:
    """Every third answer lost, or all of them 50 ms late: what the others say is known; the run goes on, and counts it."""

    def enough(run: Runner) -> bool:
        counts, position = run.rig.hosts["lower"].counts, run.rig["RHP.position"].last
        return counts.repeated + counts.missed + counts.answered_late > 0 and abs(position - 0.1) < 0.05

    ended, run = run_on(twins, [Leg()], {}, lambda: twins("fault", "JMC1", fault, True), enough=enough)
    twins("fault", "JMC1", fault, False)
    assert ended.tripped == {}
    assert enough(run)
    assert set(ended.not_stopped) <= {"JMC1"}  # it may not say in time that it is off


@pytest.mark.slow
def test_a_controller_that_keeps_the_interpreter(twins: Twins) -> None:
    """While a controller's step lets no other thread run, nothing is sent; then all goes on, what was missed is counted."""
    held: list[float] = []

    def hold(given: Mapping[str, float]) -> Mapping[str, float]:
        if not held:
            began = time.monotonic()
            while time.monotonic() - began < 0.2:
                re.match("(a*)*b", "a" * 20)  # one call into C, that lets nobody in
            held.append(time.monotonic() - began)
        return given

    def enough(run: Runner) -> bool:
        task = next(one for one in run.tasks.tasks if one.name == "leg")
        return bool(held) and task.missed + run.rig.hosts["lower"].counts.ticks_missed > 0

    ended, run = run_on(twins, [Leg(hold)], {}, enough=enough)
    assert enough(run)
    assert ended.tripped == {}
    assert ended.not_stopped == {}


@pytest.mark.slow
def test_a_second_master_is_refused(twins: Twins) -> None:
    """Who drives has the bus: another program that would drive is refused, with who has it; one that looks on is not."""
    robot = hubo_leg()
    buses = {"lower": {"interface": "aces", "channel": f"unix:{twins.path}"}}
    with Loop() as loop, connect(robot, open_gates(robot, loop, buses), rate_hz=50) as master:
        with Loop() as other, pytest.raises(AcesError, match=r"process \d+|pid \d+"):
            open_gates(robot, other, buses)["lower"].open(lambda *_: None)
        text = "from tests.robot.test_served_faults import look; look()"
        said = subprocess.run(
            [sys.executable, "-c", text, str(twins.path)],
            capture_output=True,
            text=True,
            check=False,
            env={"PYTHONPATH": ":".join(sys.path)},
            timeout=PATIENCE_S,
        )
        assert said.stdout == "sent 0, saw True\n", said.stderr
        assert master.hosts["lower"].counts.received


def look() -> None:
    """A program that only looks on: what it sent, and whether it saw a joint's position."""
    robot = hubo_leg()
    buses = {"lower": {"interface": "aces", "channel": f"unix:{sys.argv[1]}"}}
    with (
        Loop() as loop,
        connect(robot, open_gates(robot, loop, buses, passive=True), rate_hz=50, passive=True) as rig,
    ):
        saw = loop.wait(lambda: rig["RHP.position"].instant is not None, int(PATIENCE_S * 1e9))
        print(f"sent {rig.hosts['lower'].counts.sent}, saw {bool(saw)}")
