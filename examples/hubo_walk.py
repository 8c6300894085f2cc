"""Hubo 2+ plays a walking pattern: it homes, switches its legs on, goes gently to the first row, plays, and is compared.

Without a file it steps in place: shank and thigh are equally long, so that with hip −a, knee 2a, ankle −a a foot stays level
below its hip; what the hips roll, the ankles roll back.

    python examples/hubo_walk.py [FILE]        # names in the first line, rad; the rate is in its name (100hz.txt) or 100 Hz
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from math import pi, sin

from aces_bus import load_robot
from aces_bus.controller import Player, Trajectory, read_trajectory
from aces_bus.errors import CallerError
from aces_bus.robot import run_virtual

RATE = 100.0
JOINTS = ("WST", *(f"{side}{joint}" for side in "LR" for joint in ("HY", "HR", "HP", "KP", "AP", "AR")))


def row(phase: float, fade: float) -> list[float]:
    """One row of stepping in place: `phase` counts steps, `fade` goes from standing straight to stepping."""
    sway = 0.06 * fade * sin(pi * phase)
    q = dict.fromkeys(JOINTS, 0.0)
    for side, way in (("L", 1), ("R", -1)):
        lifted = max(0.0, way * sin(pi * phase)) ** 2
        bend = fade * (0.35 + 0.15 * lifted)
        q |= {f"{side}HP": -bend, f"{side}KP": 2 * bend, f"{side}AP": -bend}
        q |= {f"{side}HR": sway, f"{side}AR": -sway}
    return [q[joint] for joint in JOINTS]


def stepping(steps: int = 4, seconds: float = 0.6) -> Trajectory:
    """Bend the knees, step left and right, stand up."""
    count = round((steps + 2) * seconds * RATE)
    phases = [n / (seconds * RATE) - 1 for n in range(count + 1)]
    fades = [min(1.0, phase + 1, steps + 1 - phase) for phase in phases]
    smooth = [fade * fade * (3 - 2 * fade) for fade in fades]
    return Trajectory(
        JOINTS, [row(p, f) for p, f in zip(phases, smooth, strict=True)], rate_hz=RATE, source="stepping"
    )


def main(arguments: Sequence[str]) -> dict[str, float]:
    if arguments:
        pattern = read_trajectory(arguments[0], rate_hz=None if "hz" in arguments[0].lower() else RATE)
    else:
        pattern = stepping()
    robot = load_robot("hubo2plus").part(*pattern.names)  # the arms stay off
    worst = dict.fromkeys(pattern.names, 0.0)
    before: dict[str, float] = {}

    def compare(row: dict[str, float]) -> None:
        """Compare the joints with what the row before wanted."""
        if player.mode == "running":
            for name, wanted in before.items():
                worst[name] = max(worst[name], abs(run.states[name][0] - wanted))
        before.update(row)

    player = Player("walk", pattern, rate_hz=pattern.rate_hz, hook=compare)
    run = run_virtual(robot, [player], rate_hz=pattern.rate_hz)
    with run:
        homed = run.do("home")
        run.do("enable")
        print(f"{pattern!r}, on {len(homed)} boards of {robot.name}, homed and on")
        ended = run.run(pattern.duration_s + 10, until=lambda: player.mode == "ended")
    end = ", ".join(ended.tripped.values()) or "nothing went wrong"
    print(f"{player.mode} after {ended.seconds:.2f} s; {end}")
    furthest = sorted(worst, key=worst.__getitem__, reverse=True)[:4]
    print("furthest from the row before:", ", ".join(f"{name} {worst[name]:.3f} rad" for name in furthest))
    return worst


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except CallerError as error:  # no such file, or no such motion
        sys.exit(str(error))
