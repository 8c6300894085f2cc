"""Joints moved from a keyboard or a gamepad: as long as a key repeats or a button is held, and not longer."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from aces_bus.controller.log import read_log
from aces_bus.errors import CallerError
from aces_bus.robot import parse_robot, run_virtual
from aces_lab.teleop.given import commanded
from aces_lab.teleop.jog import (
    ABS_HAT0X,
    ABS_Y,
    BTN_TL,
    EV_ABS,
    EV_KEY,
    Gamepad,
    GamepadReader,
    InputEvent,
    Jog,
    KeyReader,
    open_gamepad,
)
from tests.robot.leg import ROBOT
from tests.tools.conftest import Aces
from tests.tools.conftest import aces as aces

MS = 1_000_000
WAIT_S = 10.0


def jog(positions: Mapping[str, float] | None = None) -> Jog:
    """Two joints that take positions and a wheel, stepped every 10 ms."""
    made = Jog({"A": "A", "B": "B", "W": "W.velocity"}, {"A": 0.5, "B": 1.0, "W": 2.0}, rate_hz=100)
    made.bind(cast(Any, {name: {0: (positions or {}).get(name, 0.0)} for name in ("A", "B")}))
    made.start(0)
    made.step(0)
    return made


def steps(made: Jog, start: int, end: int) -> list[dict[str, float]]:
    """What it gives in each step between two instants (ms)."""
    return [dict(made.step(now * MS)) for now in range(start, end, 10)]


def test_a_key_moves_for_150_ms() -> None:
    """At the joint's speed, from where it is measured; then it stands still there, and nothing is given any more."""
    made = jog({"A": 0.1})
    made.press(1.0)
    given = steps(made, 10, 170)
    assert [round(one["A"], 6) for one in given[:3]] == [0.105, 0.11, 0.115]
    assert len(given) == 16
    assert made.step(170 * MS) == {"A": 0.1}  # measured: the test's joint has not moved
    assert made.step(180 * MS) == {}
    assert made.is_idle


def test_a_key_that_repeats_moves_on() -> None:
    """Each report is another 150 ms."""
    made = jog()
    for start in range(0, 500, 100):
        made.press(-1.0)
        assert all(one["A"] < 0 for one in steps(made, start + 10, start + 110))
    assert made.step(660 * MS) == {"A": 0.0}


def test_another_joint_and_a_stop_end_the_motion() -> None:
    """At the next step."""
    made = jog()
    made.press(1.0)
    steps(made, 10, 50)
    made.choose(1)
    assert made.step(50 * MS) == {"A": 0.0}
    made.press(1.0)
    assert list(made.step(60 * MS)) == ["A", "B"]
    made.press(0.0)
    assert made.step(70 * MS) == {"B": 0.0}
    made.choose(1)
    made.press(0.5)
    assert made.step(80 * MS) == {"A": 0.0, "B": 0.0, "W.velocity": 1.0}
    assert made.step(300 * MS) == {"W.velocity": 0.0}
    made.choose(-2)
    assert made.chosen == "A"


def test_another_joint_is_chosen_without_a_word_of_the_guard() -> None:
    """The one that stands still is given, too, where it stands: it is not forgotten while the other moves."""
    robot, problems = parse_robot(ROBOT)
    assert robot is not None, problems
    names = list(robot.joints)[:2]
    hand = Jog(commanded(robot, names), dict.fromkeys(names, 0.5), rate_hz=200)
    with run_virtual(robot, [hand]) as run:
        run.do("enable")
        run.start()
        for _ in names:
            for _ in range(6):
                hand.press(1.0)
                run.clock.wait(lambda: False, 100 * MS)
            hand.choose(1)
        assert not [event for event in run.events if event.kind == "unnamed"]
        assert all(run.rig.signals[f"{name}.position"].value > 0.05 for name in names)


def test_a_joint_of_which_nothing_is_known_does_not_move() -> None:
    """And it says so."""
    made = Jog({"A": "A"}, {"A": 1.0}, rate_hz=100)
    made.bind({"A": cast(Any, {})})
    made.start(0)
    made.press(1.0)
    assert made.step(10 * MS) == {}
    assert "not known where A is" in made.waiting


def test_a_run_stops_soon_after_the_key(capsys: pytest.CaptureFixture[str]) -> None:
    """With guard and door, on a twin: no further than its limit, and it stands 0.2 s after the last repeat."""
    robot, problems = parse_robot(ROBOT)
    assert robot is not None, problems
    hand = Jog(commanded(robot, ["ROLL"]), {"ROLL": 1.0}, rate_hz=200)
    with run_virtual(robot, [hand]) as run:
        run.do("enable")
        run.start()
        for _ in range(4):
            hand.press(1.0)
            run.clock.wait(lambda: False, 50 * MS)
        run.clock.wait(lambda: False, 250 * MS)
        stood = run.rig.signals["ROLL.position"].value
        assert 0.1 < stood < 0.4
        run.clock.wait(lambda: False, 500 * MS)
        assert run.rig.signals["ROLL.position"].value == pytest.approx(stood, abs=0.002)
        for _ in range(30):
            hand.press(1.0)
            run.clock.wait(lambda: False, 50 * MS)
        assert run.rig.signals["ROLL.position"].value == pytest.approx(0.75, abs=0.01)
        assert not run.stopped


def until(is_so: Callable[[], bool]) -> None:
    """Wait for another thread."""
    end = time.monotonic() + WAIT_S
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_keys_of_a_terminal() -> None:
    """Arrows and letters; the end of the terminal ends the run."""
    reading, writing = os.pipe()
    made = jog()
    chosen: list[str] = []
    with KeyReader(reading, made, chosen.append):
        os.write(writing, b"\x1b[C")
        until(lambda: made.step(10 * MS) != {})
        os.write(writing, b"x\x1b[Bj")
        until(lambda: chosen == ["B", "W"])
        os.write(writing, b"h")
        until(lambda: "W.velocity" in made.step(20 * MS))
        os.close(writing)
        until(lambda: made.is_over)
    os.close(reading)
    assert made.step(30 * MS) == {"W.velocity": 0.0}


class FakePad:
    """A gamepad of 0 to 255, whose events are put in; None unplugs it."""

    def __init__(self) -> None:
        self.fd, self.other = os.pipe()
        self.events: list[InputEvent | None] = []

    def put(self, kind: int, code: int, value: int) -> None:
        self.events.append(cast(InputEvent, SimpleNamespace(type=kind, code=code, value=value)))
        os.write(self.other, b".")

    def unplug(self) -> None:
        self.events.append(None)
        os.write(self.other, b".")

    def read(self) -> Iterable[InputEvent]:
        os.read(self.fd, 1)
        event = self.events.pop(0)
        if event is None:
            raise OSError(19, "No such device")
        return [event]

    def absinfo(self, axis_num: int) -> Any:
        return SimpleNamespace(min=0, max=255)

    def close(self) -> None:
        with suppress(OSError):
            os.close(self.fd)
            os.close(self.other)


@pytest.fixture
def pad() -> Iterator[FakePad]:
    made = FakePad()
    yield made
    made.close()


def test_a_gamepad_moves_while_its_button_is_held(pad: FakePad) -> None:
    """In proportion to the stick; letting go of the button, or of the stick, stops; so does losing the gamepad."""
    made = jog()
    chosen: list[str] = []
    with GamepadReader(cast(Gamepad, pad), made, chosen.append):
        pad.put(EV_ABS, ABS_HAT0X, 1)
        pad.put(EV_ABS, ABS_HAT0X, 0)
        pad.put(EV_ABS, ABS_HAT0X, 1)
        until(lambda: chosen == ["B", "W"])
        pad.put(EV_ABS, ABS_Y, 0)
        until(lambda: not pad.events)
        assert made.step(10 * MS) == {}  # the button is not held
        pad.put(EV_KEY, BTN_TL, 1)
        until(lambda: made.step(20 * MS) == {"W.velocity": 2.0})
        assert made.step(9000 * MS) == {"W.velocity": 2.0}  # a stick that is held reports nothing
        pad.put(EV_ABS, ABS_Y, 255)
        until(lambda: made.step(9010 * MS) == {"W.velocity": -2.0})
        pad.put(EV_ABS, ABS_Y, 120)  # in the middle
        until(lambda: made.step(9020 * MS) == {"W.velocity": 0.0})
        pad.put(EV_ABS, ABS_Y, 0)
        until(lambda: made.step(9030 * MS) == {"W.velocity": 2.0})
        pad.put(EV_KEY, BTN_TL, 0)
        until(lambda: made.step(9040 * MS) == {"W.velocity": 0.0})
        pad.put(EV_KEY, BTN_TL, 1)
        until(lambda: made.step(9050 * MS) == {"W.velocity": 2.0})
        pad.unplug()
        until(lambda: made.is_over)
        until(lambda: made.step(9060 * MS) == {"W.velocity": 0.0})


def test_the_first_gamepad_is_taken() -> None:
    """One with a stick and a left shoulder; a keyboard is none."""
    able = {"/dev/k": {EV_KEY: [1, 2]}, "/dev/g": {EV_KEY: [BTN_TL], EV_ABS: [ABS_Y]}}

    def device(path: str) -> Any:
        if path not in able:
            raise OSError(2, "No such file or directory")
        return SimpleNamespace(path=path, capabilities=lambda absinfo: able[path])

    library: Any = SimpleNamespace(list_devices=lambda: ["/dev/gone", *able], InputDevice=device)
    assert cast(Any, open_gamepad("", library)).path == "/dev/g"
    assert cast(Any, open_gamepad("/dev/k", library)).path == "/dev/k"
    with pytest.raises(CallerError, match="/dev/gone cannot be opened"):
        open_gamepad("/dev/gone", library)
    able.clear()
    with pytest.raises(CallerError, match="gamepad"):
        open_gamepad("", library)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("-r", "so101", "--virtual"), "standard input must be a terminal"),
        (("-r", "so101", "tail", "--virtual"), "tail"),
        (("-r", "so101", "--virtual", "--bus", "leader=x"), "--virtual has no buses"),
        (("--virtual", "--id", "1"), "--id is of the devices of one kind"),
    ],
)
def test_wrong_calls(aces: Aces, words: tuple[str, ...], said: str) -> None:
    """Found before a bus is opened."""
    made = aces("jog", *words)
    assert made.status == 2
    assert said in made.err


@pytest.mark.slow
def test_a_terminal_moves_a_twin(tmp_path: Path) -> None:
    """`aces jog` in a terminal of its own: keys are not shown, the joint has moved, the terminal is as it was."""
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    log = tmp_path / "jog.csv"
    words = ("jog", "-r", "so101", "gripper", "--virtual", "--speed", "1", "--log", str(log))
    with subprocess.Popen(
        [sys.executable, "-m", "aces_tools", *words], stdin=theirs, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        try:
            for line in process.stderr:
                if "runs until" in line:
                    break
            for _ in range(10):
                os.write(ours, b"l")
                time.sleep(0.05)
            os.write(ours, b"q")
            said = process.stderr.read()
            process.wait(WAIT_S)
        finally:
            process.kill()
    assert process.returncode == 0, said
    assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)
    found = read_log(log)["gripper"]
    assert found[-1] > 0.2
