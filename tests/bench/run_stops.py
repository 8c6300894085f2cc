"""How long a stop of the complete Hubo 2+ takes: in virtual time, and over served buses with the twins in another process.

    python -m tests.bench.run_stops                 5 stops of each kind; a table
    python -m tests.bench.run_stops --runs 50

Median and longest: from the fault, or the end of the run, until the last board is off, and until all have said so and the
run is over. Served figures are this machine's; virtual ones are the buses' own, the same everywhere.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import Any

from aces_bus import load_robot
from aces_bus.controller import IGNORE, Controller, stop
from aces_bus.device import Robot
from aces_bus.errors import DeviceError
from aces_bus.robot import Runner, run_real, run_virtual
from tests.robot.served_twins import Twins, note_off

RATE_HZ = 200
#: Only what is measured stops motion.
CALM: Mapping[str, Any] = {"*": IGNORE, "alarm": stop()}


class Pose(Controller):
    """Gives all joints where they are at first."""

    def __init__(self, robot: Robot, rate_hz: float) -> None:
        self.joints = tuple(joint.name for joint in robot.joints.values() if joint.active)
        super().__init__("pose", rate_hz=rate_hz, writes=self.joints)

    def step(self, now_ns: int) -> Mapping[str, float]:
        return dict.fromkeys(self.joints, 0.0)


def alarm(run: Runner) -> None:
    """A board says that something is wrong with it."""
    run.rig.hosts["lower"].emit("alarm", "JMC1", "measured")


def virtual(is_fault: bool) -> tuple[float, float]:
    """One stop: seconds to the last board, and until all is confirmed."""
    robot = load_robot("hubo2plus")
    run = run_virtual(robot, [Pose(robot, 1 if is_fault else RATE_HZ)], rate_hz=RATE_HZ, reactions=CALM)
    off_at: dict[str, int] = {}
    with run:
        run.do("enable")
        run.start()
        run.world.clock.advance(503_000_000)
        note_off(run.world, run.clock.now, off_at)
        began = run.clock.now()
        if is_fault:
            alarm(run)
            run.world.clock.advance(5_000_000)
        run.stop()
    return (max(off_at.values()) - began) / 1e9, (run.clock.now() - began) / 1e9


def served(is_fault: bool, twins: Twins) -> tuple[float, float]:
    """The same on threads; the stop of a fault is at once followed by that of the run's end."""
    robot = load_robot("hubo2plus")
    buses = {name: {"interface": "aces", "channel": f"unix:{twins.path / name}.sock"} for name in robot.buses}
    run = run_real(
        robot,
        [Pose(robot, 1 if is_fault else RATE_HZ)],
        buses=buses,
        rate_hz=RATE_HZ,
        transmit=True,
        reactions=CALM,
    )
    began = 0

    def until() -> bool:
        nonlocal began
        if run.seconds > 1.0 and not began:
            began = time.monotonic_ns()
            if is_fault:
                run.clock.call_soon(lambda: alarm(run))
            return not is_fault
        return False

    with run:
        for _ in range(20):
            with suppress(DeviceError):
                run.do("enable")
                break
        ended = run.run(60.0, until=until)
    now = time.monotonic_ns()
    assert ended.not_stopped == {}, ended
    return (max(twins("off_at").values()) - began) / 1e9, (now - began) / 1e9


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="stops of each kind (default: 5)")
    runs = parser.parse_args().runs
    print(f"{'':<34} {'last board off':>22} {'run is over':>22}")
    with tempfile.TemporaryDirectory() as folder:
        twins = Twins(Path(folder), "all")
        try:
            for is_fault, what in ((False, "end of the run, 200 Hz"), (True, "fault, controller at 1 Hz")):
                print(line(f"virtual: {what}", [virtual(is_fault)]), flush=True)
                print(line(f"served: {what}", [served(is_fault, twins) for _ in range(runs)]), flush=True)
        finally:
            twins.close()
    return 0


def line(what: str, found: list[tuple[float, float]]) -> str:
    """Median and longest of a kind (ms)."""
    cells = [f"{median(one) * 1e3:.2f} ({max(one) * 1e3:.2f}) ms" for one in zip(*found, strict=True)]
    return f"{what:<34} {cells[0]:>22} {cells[1]:>22}"


if __name__ == "__main__":
    sys.exit(main())
