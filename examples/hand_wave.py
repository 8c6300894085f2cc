"""A Hubo 2 waves its hand, by UDP through its control PC: eleven joints, ten rows a second, nothing is measured.

As in the original, a recorded wave of 100 Hz in degrees is played at 10 Hz: every tenth row, less the first one, in rad.
Without a file it waves from the elbow.

    python examples/hand_wave.py [FILE]        # names in the first line, degrees
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from math import pi, radians, sin

from aces_bus import load_robot
from aces_bus.controller import Player, Trajectory, read_trajectory
from aces_bus.errors import CallerError
from aces_bus.robot import run_virtual

RATE = 10.0


def wave(seconds: float = 6.0) -> Trajectory:
    """Raise the right arm to the side, wave three times, lower it."""
    rows: list[list[float]] = []
    for n in range(round(seconds * RATE) + 1):
        t = n / RATE
        up = min(1.0, t, seconds - t)
        up = up * up * (3 - 2 * up)
        rows.append([-1.2 * up, -1.4 * up, up * (-0.6 + 0.4 * sin(pi * t)), 0.2 * up * sin(pi * t)])
    return Trajectory(["RSR", "RSY", "REP", "RWY"], rows, rate_hz=RATE, source="wave")


def recorded(path: str) -> Trajectory:
    """Every tenth row, less the first."""
    whole = read_trajectory(path, rate_hz=10 * RATE)
    rows = (whole.rows[::10] - whole.rows[0]) * radians(1)
    return Trajectory(whole.names, rows, rate_hz=RATE, source=whole.source)


def main(arguments: Sequence[str]) -> None:
    motion = recorded(arguments[0]) if arguments else wave()
    robot = load_robot("hubovia")
    turned: dict[str, list[float]] = {name: [] for name in motion.names}

    def look(row: dict[str, float]) -> None:
        """Note the simulated joints, each tenth of a second."""
        for name, seen in turned.items():
            seen.append(run.world.twins[robot.joint(name).device].position(run.clock.now()))

    # Where the joints are is not known, so there is no approach: a wave begins at zero, where the arms hang.
    player = Player("wave", motion, rate_hz=RATE, approach=None, hook=look)
    run = run_virtual(robot, [player], rate_hz=RATE)
    ended = run.run(motion.duration_s + 1, until=lambda: player.mode == "ended")
    print(f"{motion!r}: {player.mode} after {ended.seconds:.1f} s, {run.set_points} set-points")
    for name, seen in turned.items():
        wanted = motion.rows[:, motion.names.index(name)]
        print(
            f"  {name}, motor {robot.joint(name).motor}: told {min(wanted):+.2f} … {max(wanted):+.2f} rad,"
            f" turned {min(seen):+.2f} … {max(seen):+.2f} rad"
        )


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except CallerError as error:  # no such file, or no such motion
        sys.exit(str(error))
