"""The arm of examples/arm.toml over served buses and a pseudo-terminal, its twins in another process: ends, limits, kill -9.

The machine may be busy: silence and lateness are ignored here, and what is judged is where things end.
"""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from aces_bus.device import Robot
from aces_bus.robot import parse_robot, run_real
from tests.robot.arm import BOUND, DEVICE_OF, FILE, arm_text, ways_of

ACES = (sys.executable, "-m", "aces_tools")
EXAMPLE = str(FILE.with_suffix(".py"))
CAN = ("lower", "middle", "upper")
#: What a busy machine does to the answers of twins; faults of the motion are not among them.
BUSY = ("silent", "no reply", "late reply", "stalled", "garbled", "dead-man")
#: Watchdogs and time-outs of devices that a busy machine keeps waiting: in the file, and here.
PATIENT = {
    "credentials = { id = 1 } }": "credentials = { id = 1 }, settings = { watchdog_s = 2.0 } }",
    "credentials = { id = 2 } }": "credentials = { id = 2 }, settings = { watchdog_s = 2.0 } }",
    "settings = { timeout_s = 0.5 }": "settings = { timeout_s = 2.0 }",
    "settings = { motion = true }": "settings = { motion = true, watchdog_s = 2.0, timeout_s = 0.3 }",
}
OFF = {"M1": "stopped", "M2": "stopped", "O3": "idle", "D4": "disabled"}
#: How far past its limit a joint may come to rest (rad): at 3 rad/s, v·(poll + reply + tick) + v²/2a.
PAST = 3.0 * 0.025 + 9.0 / 40.0


class Served(NamedTuple):
    """A robot's file, and where its buses are served: bus → channel."""

    file: Path
    robot: Robot
    channels: Mapping[str, str]

    @property
    def buses(self) -> list[str]:
        """The words that lead to the buses."""
        where = [word for bus, channel in self.channels.items() for word in ("--bus", f"{bus}={channel}")]
        return ["-r", str(self.file), "-i", "aces", *where]

    def run(self, program: str, *more: str) -> list[str]:
        """Return the words of `aces run` with a program; a busy machine stops nothing."""
        ignored = [word for kind in BUSY for word in ("--on-trip", f"{kind}=ignore")]
        return [*ACES, "run", program, *self.buses, "--tx", *ignored, *more]

    def seen(self) -> tuple[dict[str, float], dict[str, Any]]:
        """Where the joints are, and what the motors are doing, as a second program reads them; it sends no command."""
        buses = {bus: {"interface": "aces", "channel": channel} for bus, channel in self.channels.items()}
        buses["tip"] = {"channel": self.channels["tip"]}
        with run_real(self.robot, [], buses=buses, passive=False) as look:
            where: dict[str, Any] = {}
            does: dict[str, Any] = {}
            end = time.monotonic() + 30
            while time.monotonic() < end:
                where = {joint: look.rig[f"{joint}.position"].value for joint in DEVICE_OF}
                does = {
                    "M1": look.rig["M1.mode"].value,
                    "M2": look.rig["M2.mode"].value,
                    "O3": look.rig["O3.state"].value,
                    "D4": look.rig["D4.status"].value,
                }
                if all(isinstance(one, float) for one in where.values()) and all(
                    isinstance(one, str) for one in does.values()
                ):
                    return where, does
                time.sleep(0.02)
            raise TimeoutError(f"{where} {does}")


@contextmanager
def serving(folder: Path, *commands: str, more: str = "") -> Generator[Served]:
    """Serve the arm's twins on buses of their own."""
    file = folder / "arm.toml"
    text = arm_text(*commands)
    for usual, patient in PATIENT.items():
        assert usual in text
        text = text.replace(usual, patient)
    file.write_text(f"{text}\n{more}")
    robot, problems = parse_robot(file.read_text())
    assert robot is not None, problems
    channels = {bus: f"unix:{folder}/{bus}.sock" for bus in CAN}
    words = [word for bus, channel in channels.items() for word in ("--bus", f"{bus}={channel}")]
    sim = subprocess.Popen(
        [*ACES, "sim", "-r", str(file), *words, "--for", "120s"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert sim.stdout is not None
        said = ""
        while "aces device" not in said:
            line = sim.stdout.readline()
            assert line, said
            said += line
        found = re.search(r"tip: .*?(/dev/\S+)", said)
        assert found is not None, said
        yield Served(file, robot, {**channels, "tip": found[1]})
    finally:
        sim.kill()
        sim.communicate()


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    """The arm as its example has it."""
    with serving(tmp_path) as made:
        yield made


def ended(words: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)


# ---------------------------------------------------------------------- its ends


@pytest.mark.slow
def test_it_is_parked(served: Served) -> None:
    """Every joint is led to the pose of its file; the motors are off, status 0."""
    done = ended(served.run(EXAMPLE, "--for", "1.5s", "--at-end", "park"))
    assert done.returncode == 0, done.stderr
    where, does = served.seen()
    assert does == OFF
    assert served.robot.park is not None
    for joint, angle in served.robot.park.pose.items():
        assert where[joint] == pytest.approx(angle, abs=0.05), joint


@pytest.mark.slow
def test_what_holds_is_left_and_what_would_fall_is_off(served: Served) -> None:
    """The ODrive stays in closed loop; moteus and Damiao are named before and after, and off."""
    done = ended(served.run(EXAMPLE, "--for", "1.5s", "--at-end", "hold"))
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    assert "aces: left enabled, where they are: O3, X5, X6" in lines
    assert "aces: not held, and switched off: M1, M2, D4" in lines
    where, does = served.seen()
    assert does == {**OFF, "O3": "closed_loop"}
    again, _ = served.seen()
    assert again == pytest.approx(where, abs=0.01)


@pytest.mark.slow
def test_a_killed_run_leaves_what_the_drivers_declare(served: Served) -> None:
    """kill -9: moteus brakes, the Damiao motor is limp, the ODrive goes on to its last set-point; `aces stop` ends that."""
    run = subprocess.Popen(
        served.run(EXAMPLE, "--for", "60s"), stderr=subprocess.DEVNULL, stdout=subprocess.PIPE
    )
    assert run.stdout is not None
    with run.stdout as lines:
        assert lines.readline()  # it runs
        time.sleep(0.5)
        run.send_signal(signal.SIGKILL)
    run.wait(10)
    time.sleep(2.5)
    where, does = served.seen()
    assert does == {
        "M1": "position_timeout",
        "M2": "position_timeout",
        "O3": "closed_loop",
        "D4": "lost_communication",
    }
    again, _ = served.seen()
    assert again == pytest.approx(where, abs=0.01)
    stopped = ended([*ACES, "stop", *served.buses])
    assert stopped.returncode == 0, stopped.stderr
    assert served.seen()[1]["O3"] == "idle"


@pytest.mark.slow
def test_a_key_is_an_e_stop(tmp_path: Path) -> None:
    """Space, typed into the terminal of the run: all is off at once, whatever the end was to be."""
    with serving(tmp_path, more="[estop]\nkey = { key = 'space', clear = 'c' }") as served:
        child, terminal = pty.fork()
        if child == 0:  # pragma: no cover  # another process
            words = served.run(EXAMPLE, "--for", "60s", "--at-end", "park")
            os.execv(sys.executable, words)
        said = b""
        try:
            while b"elbow" not in said:  # its panel
                said += os.read(terminal, 1000)
            time.sleep(0.5)
            os.write(terminal, b" ")
            with suppress(OSError):
                while chunk := os.read(terminal, 1000):
                    said += chunk
        finally:
            os.close(terminal)
            _, status = os.waitpid(child, 0)
        assert os.waitstatus_to_exitcode(status) == 1
        assert b"key space was pressed" in said
        assert b"NOT parked" in said
        assert served.seen()[1] == OFF


# ---------------------------------------------------------------------- its limits

MODES = {
    "speed": [ways_of(joint)[1] for joint in DEVICE_OF],
    "torque": [ways_of(joint)[-1 if name[0] in "OD" else 1] for joint, name in DEVICE_OF.items()],
    "current and duty": [ways_of(joint)[{"wrist": 2, "hand": 3}.get(joint, 0)] for joint in DEVICE_OF],
}
LAW = """
from aces_bus.controller import controller

GIVEN = {given}

@controller(rate_hz=100, writes=list(GIVEN))
def push(t):
    return GIVEN
"""


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_no_joint_comes_to_rest_past_its_limits(mode: str, tmp_path: Path) -> None:
    """Pushed outward for three seconds, by what its device can be set by; a trip past the bound is allowed, and named."""
    ways = MODES[mode]
    given = {f"{joint}.{way.signal}": way.large for joint, way in zip(DEVICE_OF, ways, strict=True)}
    program = tmp_path / "push.py"
    program.write_text(LAW.format(given=given))
    with serving(tmp_path, *(way.command for way in ways)) as served:
        done = ended(served.run(str(program), "--for", "3s"))
        where, does = served.seen()
        assert does == OFF, done.stderr
        # What a busy machine measured too late is past it by more, and named.
        past = {joint for joint, angle in where.items() if angle > BOUND + PAST}
        assert all(
            f"{joint} is at " in done.stderr or f"{joint} turns at" in done.stderr for joint in past
        ), (
            where,
            done.stderr,
        )
        assert done.returncode == 0 or "past limit" in done.stderr or "too fast" in done.stderr, done.stderr
        assert any(angle > 1.2 for angle in where.values()), (where, done.stderr)
