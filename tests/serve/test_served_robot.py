"""`aces robot serve` over a served bus: a controller is killed, another takes over, the arm stays up until `aces stop`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TypeVar

import pytest

from aces_bus.errors import CallerError, DeviceError
from aces_lab.serve.client import ServedRobot
from aces_lab.serve.messages import JointStatus
from aces_tools.robot_arg import chosen_robot
from aces_tools.sim import SimulatedRobot
from tests.tools.conftest import Aces
from tests.tools.conftest import aces as aces
from tests.tools.test_stop import ARM

T = TypeVar("T")


@pytest.fixture
def arm(tmp_path: Path) -> str:
    path = tmp_path / "arm.toml"
    path.write_text(ARM)
    return str(path)


@pytest.fixture
def stand(
    arm: str, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[SimulatedRobot]:
    """The robot's twins on a served bus."""
    folder = tmp_path_factory.mktemp("run")
    for name in ("XDG_RUNTIME_DIR", "TMPDIR"):
        monkeypatch.setenv(name, str(folder))
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    robot = chosen_robot(arm)
    with ExitStack() as stack:
        yield SimulatedRobot(robot, {name: {} for name in robot.buses}, 0, stack)


def program(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "aces_tools", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for(what: Callable[[], T | None], seconds: float = 30.0) -> T:
    """What it returns, once that is true."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := what():
            return found
        time.sleep(0.02)
    raise AssertionError("it did not happen in time")


def attached(name: str = "") -> ServedRobot | None:
    try:
        return ServedRobot("arm", name)
    except CallerError:
        return None


@pytest.mark.slow
def test_controllers_come_die_and_take_over(aces: Aces, arm: str, stand: SimulatedRobot) -> None:
    """kill -9 of one leaves the arm standing and enabled; the next moves it on; `aces stop` ends all."""
    channel = stand.simulation.twins["JMC0"].channels[0]  # type: ignore[attr-defined]
    lowest: list[float] = []
    with ExitStack() as stack:

        def begin(*words: str) -> subprocess.Popen[str]:
            made = program(*words)
            stack.callback(made.communicate)
            stack.callback(made.kill)
            return made

        server = begin("robot", "serve", arm, "-i", "aces", "--tx")
        looker = stack.enter_context(wait_for(attached))

        def yaw() -> JointStatus:
            joint = looker.status().joints["YAW"]
            if lowest:
                assert channel.control_on
                if joint.measured is not None:  # a busy machine asks late
                    lowest.append(joint.measured)
            return joint

        first = begin("robot", "attach", arm, "YAW=0.2", "--as", "first")
        wait_for(lambda: yaw().owner == "first" and (yaw().measured or 0.0) > 0.19)
        second = stack.enter_context(ServedRobot("arm", "second"))
        with pytest.raises(CallerError, match="YAW is owned by first, which can hand it over to second"):
            second.own("YAW")
        lowest.append(wait_for(lambda: yaw().measured))
        os.kill(first.pid, signal.SIGKILL)
        wait_for(lambda: yaw().owner is None)
        second.own("YAW")

        def moved() -> bool:
            second.set({"YAW": 0.3})
            return bool((yaw().measured or 0.0) > 0.28)

        wait_for(moved)
        assert min(lowest) > 0.18
        result = aces("stop", arm, "-i", "aces")
        assert result.status == 0, result.err
        assert not channel.control_on
        _, said = server.communicate(timeout=60)
        assert server.returncode == 1
        assert "if this program dies, each of JMC0" in said
        assert "first is gone: YAW stands still, owned by nobody" in said
        with pytest.raises(DeviceError, match=r"not served any more: stopped by .*pid"):
            second.set({"YAW": 0.3})


@pytest.mark.slow
def test_the_verbs_of_a_served_robot(aces: Aces, arm: str, tmp_path: Path, stand: SimulatedRobot) -> None:
    """Twins at the pace of real time: a controller of a file, hand-over by name, status, stop, enable."""
    wave = tmp_path / "wave.py"
    wave.write_text(
        "from aces_bus.controller import controller\n\n@controller(rate_hz=50, writes=['YAW'])\n"
        "def wave(YAW, t):\n    return {'YAW': YAW[0] + 0.02}\n"
    )
    with ExitStack() as stack:
        programs: list[subprocess.Popen[str]] = []
        for words in (("serve", arm, "--virtual", "--quiet"), ("attach", arm, str(wave))):
            programs.append(program("robot", *words))
            stack.callback(programs[-1].communicate)
            stack.callback(programs[-1].kill)
            stack.enter_context(wait_for(attached))
        wait_for(lambda: "wave" in aces("robot", "served", "arm").out)
        assert "attached: wave" in aces("robot", "served", "arm").out
        grasp = stack.enter_context(ServedRobot("arm", "grasp"))
        wait_for(lambda: "YAW" in aces("robot", "served", "arm", "hand-over", "wave", "grasp").err)
        grasp.set({})
        assert programs[1].wait(30) == 0
        grasp.free()
        assert aces("robot", "served", "arm", "stop").status == 0
        assert grasp.status().joints["YAW"].enabled is False
        assert aces("robot", "served", "arm", "enable", "YAW").status == 0
        assert grasp.status().joints["YAW"].enabled is True
        assert aces("robot", "served", "arm", "park").err == (
            "aces: arm: arm: its file names no pose to park in\n"
        )


def test_wrong_calls(aces: Aces, arm: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """One line that says what to write."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for words, said in (
        (("served", "arm"), "arm is not served: "),
        (("served", "arm", "hand-over", "one"), "hand-over from whom to whom?"),
        (("served", "arm", "enable"), "enable which joints?"),
        (("served", "arm", "stop", "YAW"), "stop takes no names: YAW"),
        (("attach", arm, "YAW=far"), "write JOINT=VALUE"),
        (("attach", arm, "ELBOW=1"), "ELBOW"),
        (("serve", arm, "--virtual", "-i", "aces"), "--virtual has no buses"),
        (("serve", "arm.toml:"), ""),
    ):
        result = aces("robot", *words)
        assert (result.status, result.out) == (2, ""), words
        assert said in result.err
        assert len(result.err.splitlines()) == 1, result.err
