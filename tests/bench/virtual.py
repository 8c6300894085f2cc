"""How much faster than life virtual time is: the complete Hubo 2+ with player, guard and log, and a quadruped at 500 Hz.

1. Seconds of virtual time a second of CPU: what other programs take from the machine meanwhile does not count.
2. It is one run of one program; only ratios between two trees, in turn on one machine, carry over.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable
from math import sin
from pathlib import Path

from msgspec.structs import replace

from aces_bus import load_robot
from aces_bus.controller import Player, Trajectory
from aces_bus.controller.log import Logger
from aces_bus.device import Robot
from aces_bus.hardware.simulated import bus
from aces_bus.robot import Runner, VirtualRobot, run_virtual

from .rows import BenchRow

RATE_HZ = 200.0
#: What is to be reached, as interpreted and as compiled (`make compiled`).
INTERPRETED, COMPILED = 3.3, 5.0
#: Rows of the motion a second.
ROWS_HZ = 10.0


def is_compiled() -> bool:
    """Whether the modules that `make compiled` compiles are."""
    return not bus.__file__.endswith(".py")


def complete_hubo() -> Robot:
    """The Hubo 2+ of the robot file with all that is inactive there; its neck, which follows no frame, is DRC-Hubo's."""
    robot = load_robot("hubo2plus")
    return replace(
        robot,
        devices={
            name: replace(one, active=True, kind="neck" if name == "EJMC2" else one.kind)
            for name, one in robot.devices.items()
        },
        joints={name: replace(one, active=True) for name, one in robot.joints.items()},
        sensors={name: replace(one, active=True) for name, one in robot.sensors.items()},
    )


def hubo_run(seconds: float, log: Path, *, seed: int = 0) -> Runner:
    """A run of `seconds`: all joints follow a motion within their limits, and are logged with their set-points."""
    robot = complete_hubo()
    limits = [
        (-1.0 if joint.lower is None else joint.lower, 1.0 if joint.upper is None else joint.upper)
        for joint in robot.joints.values()
    ]
    rows = [
        [min(max(0.05 * sin(row / 3 + number), lower), upper) for number, (lower, upper) in enumerate(limits)]
        for row in range(round(seconds * ROWS_HZ) + 20)
    ]
    motion = Trajectory(list(robot.joints), rows, rate_hz=ROWS_HZ, interpolation="cubic")
    player = Player("walk", motion, rate_hz=RATE_HZ)
    logger = Logger(
        log, [column for name in robot.joints for column in (name, f"{name}(setpoint)")], rate_hz=RATE_HZ
    )
    return run_virtual(VirtualRobot(robot, rate_hz=RATE_HZ, seed=seed), [player], loggers=[logger])


def trotting(seconds: float) -> Runner:
    """A run of the quadruped: all twelve joints swing within their limits, set at 500 Hz."""
    robot = load_robot("quadruped")
    rows = [
        [-0.3 + 0.1 * sin(row / 3 + number) for number in range(len(robot.joints))]
        for row in range(round(seconds * ROWS_HZ) + 20)
    ]
    motion = Trajectory(list(robot.joints), rows, rate_hz=ROWS_HZ, interpolation="cubic")
    return run_virtual(robot, [Player("swing", motion, rate_hz=500.0)])


def quadruped(seconds: float) -> BenchRow:
    """The quadruped's row."""
    made = trotting(seconds)
    with made as going:
        going.do("enable")
        began = time.process_time()
        going.run(seconds)
        spent = time.process_time() - began
    frames = sum(wire.load.frames for wire in made.world.wires.values())
    subject = f"quadruped in virtual time, 12 joints at 500 Hz, {frames:,} frames"
    return BenchRow(
        subject,
        f"player and guard, {'compiled' if is_compiled() else 'interpreted'}",
        seconds / spent,
        "× real time",
    )


def run(*, quick: bool = False) -> Iterable[BenchRow]:
    """Two rows: some twenty seconds of CPU, a few with `quick`."""
    seconds = 2.0 if quick else 10.0
    with tempfile.TemporaryDirectory(prefix="aces") as folder:
        made = hubo_run(seconds, Path(folder) / "log.csv")
        with made as going:
            going.do("enable")
            began = time.process_time()
            going.run(seconds)
            spent = time.process_time() - began
        frames = sum(wire.load.frames for wire in made.world.wires.values())
    ratio, target = seconds / spent, COMPILED if is_compiled() else INTERPRETED
    yield BenchRow(
        f"complete Hubo 2+ in virtual time, {len(complete_hubo().joints)} joints, {frames:,} frames",
        f"player, guard and log, {'compiled' if is_compiled() else 'interpreted'}",
        ratio,
        "× real time",
        None,
        f"≥ {target:g}",
        ratio >= target,
    )
    yield quadruped(seconds)
