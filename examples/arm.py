"""An arm of mixed parts waves, and folds itself before it is switched off: devices of four makers, one controller.

The robot's file beside this one names the pose to fold in. `hold` instead leaves enabled what stays where it is without this
program: the servos and the ODrive. The moteus and the Damiao motor have a watchdog, and would let go: they are switched off,
and named.

    python examples/arm.py [disable|hold|park]
    aces run -r examples/arm.toml examples/arm.py --virtual --for 4s --at-end park
"""

from __future__ import annotations

import sys
from math import pi, sin
from pathlib import Path
from typing import Any

from aces_bus import load_robot
from aces_bus.controller import controller
from aces_bus.device import Robot
from aces_bus.robot import Ended, run_virtual

JOINTS = ("base", "shoulder", "elbow", "forearm", "wrist", "hand")
#: How far it waves (rad), and how fast (1/s).
WAY, RATE = 0.6, 0.25
SECONDS = 4.0


@controller(rate_hz=100, writes=JOINTS)
def wave(t: float) -> dict[str, float]:
    """All joints swing out from 0, each a little behind the one below it."""
    behind = {joint: max(0.0, t - 0.2 * number) for number, joint in enumerate(JOINTS)}
    return {joint: WAY * sin(2 * pi * RATE * late) for joint, late in behind.items()}


def arm() -> Robot:
    """Return the robot of the file beside this program."""
    return load_robot(Path(__file__).with_suffix(".toml"))


def waved(at_end: Any = "park", seconds: float = SECONDS) -> Ended:
    """Wave for so long, end as said; in virtual time."""
    with run_virtual(arm(), [wave], at_end=at_end) as run:
        run.do("enable")
        return run.run(seconds)


def main(at_end: str = "park") -> int:
    """Wave, and say how each joint was left."""
    ended = waved(at_end)
    for joint in ended.parked:
        print(f"{joint}: parked, then off")
    for joint, why in ended.not_parked.items():
        print(f"{joint}: not parked: {why}")
    for device in ended.held:
        print(f"{device}: left enabled, where it is")
    for device, why in ended.let_go.items():
        print(f"{device}: switched off, for it would not stay: {why}")
    return bool(ended.not_stopped or ended.not_parked)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:2]))
