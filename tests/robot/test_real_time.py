"""The complete Hubo 2+ in real time: controllers on threads, its twins in `aces sim` beside it, a minute long.

HYPOTHESIS_PROFILE=long pytest -s tests/robot/test_real_time.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import pytest

from aces_bus import load_robot
from aces_bus.controller import IGNORE, Player, Trajectory
from aces_bus.robot import run_real

SECONDS = float(os.environ.get("ACES_REAL_SECONDS", "60"))
RATE = 200.0
#: A host that needs more of its core before it does anything does not keep up: Python runs one thread at a time.
BUSY = 0.9


@contextmanager
def served(channels: dict[str, str]) -> Generator[None]:
    """Run `aces sim` with the robot's devices on these channels until the block ends; it must end by itself, well."""
    words = [word for bus, channel in channels.items() for word in ("--bus", f"{bus}={channel}")]
    command = [sys.executable, "-m", "aces_tools", "sim", "-r", "hubo2plus", *words]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as sim:
        assert sim.stdout is not None
        try:
            last = "aces device"  # of the lines it prints before it serves
            assert any(line.startswith(last) for line in sim.stdout)
            yield
        finally:
            sim.terminate()
            sim.communicate(timeout=60)


def share_of_a_core(seconds: float) -> float:
    """Return how much of one core this process uses while it waits so long (1: all of it)."""
    cpu, wall = time.process_time(), time.monotonic()
    time.sleep(seconds)
    return (time.process_time() - cpu) / (time.monotonic() - wall)


@pytest.mark.long
def test_hubo_runs_a_minute_in_real_time() -> None:
    """200 Hz for 60 s: every deadline is a cycle or counted as missed; printed: lateness, and what the host costs."""
    robot = load_robot("hubo2plus")
    joints = [j for j in robot.joints.values() if j.active and j.command == "position"]
    rows = [[0.05 * (n % 2) for _ in joints] for n in range(round(SECONDS) + 2)]
    rows = [
        [min(max(v, j.lower or 0.0), j.upper or 0.0) for v, j in zip(row, joints, strict=True)]
        for row in rows
    ]
    trajectory = Trajectory([j.name for j in joints], rows, rate_hz=1.0, interpolation="cubic")
    player = Player("walk", trajectory, rate_hz=RATE)
    channels = {bus: f"unix:minute-{bus}" for bus in robot.buses}
    options: dict[str, dict[str, Any]] = {
        bus: {"interface": "aces", "channel": channel} for bus, channel in channels.items()
    }
    before = sys.getswitchinterval()
    sys.setswitchinterval(0.0001)  # as `aces run` has it
    try:
        with (
            served(channels),
            run_real(
                robot,
                [player],
                buses=options,
                transmit=True,
                rate_hz=RATE,
                reactions={"*": IGNORE},  # a busy machine is not a fault
            ) as run,
        ):
            assert run.missing == []
            if (share := share_of_a_core(2.0)) > BUSY:
                pytest.skip(
                    f"the host alone, with nothing to do but listen, takes {share:.0%} of a core of this machine"
                )
            run.do("enable")
            cpu, wall = time.process_time(), time.monotonic()
            ended = run.run(SECONDS)
            cpu, wall = time.process_time() - cpu, time.monotonic() - wall
    finally:
        sys.setswitchinterval(before)
    (task,) = run.tasks.tasks
    for name, host in run.rig.hosts.items():
        c = host.counts
        print(
            f"\n{name}: {c.ticks} ticks, {c.ticks_missed} left out, {c.missed} unanswered, {c.latency_ns / 1e6:.1f} ms",
            end="",
        )
    print(f"\n{task}\nCPU {cpu / wall:.0%} of one core; {ended}")
    assert ended.tripped == {}
    assert abs(task.ticks + task.missed - 1 - RATE * ended.seconds) <= 5
