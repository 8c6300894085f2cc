"""MiniHubo walks: 21 servos on one serial line of 1 Mbit/s, 50 rows a second, one SYNC_WRITE a tick, all positions read.

Without a file it plays four steps of our own: a path of the feet (m), through the inverse kinematics, to joints (rad). While
one foot swings, the body leans over the other, and both soles stay level.

    python examples/minihubo_walk.py [FILE]        # a pattern of the original: 22 columns, rad, 50 Hz
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from math import degrees

from aces_bus import load_robot
from aces_bus.controller import Limits, Player, Trajectory, ViaPath
from aces_bus.errors import CallerError
from aces_bus.robot import run_virtual
from aces_devices.kinematics.minihubo import JOINTS, MINIHUBO, POSTURE, WALK_HZ, read_walk
from aces_lab.cartesian import CartesianPath

STRIDE, LIFT, LEAN = 0.02, 0.02, 0.025  # m


def steps(count: int = 4, seconds: float = 0.5) -> Trajectory:
    """So many steps forward, each of so many seconds, from the bent posture and back to it."""
    axes = ["LF.x", "LF.y", "LF.z", "RF.x", "RF.y", "RF.z"]
    points, left, right = [[0.0] * 6], 0.0, 0.0
    for step in range(count):
        last = step == count - 1
        ahead = 0.0 if last else STRIDE  # the last step brings the feet together
        if step % 2 == 0:
            points.append([(left + ahead) / 2, LEAN, LIFT, (right - ahead) / 2, LEAN, 0.0])
            left, right = ahead, -ahead
        else:
            points.append([(left - ahead) / 2, -LEAN, 0.0, (right + ahead) / 2, -LEAN, LIFT])
            left, right = -ahead, ahead
        points.append([left, 0.0, 0.0, right, 0.0, 0.0])
    path = ViaPath(
        axes, points, Limits(0.3, 3.0), shape="through", times=[n * seconds / 2 for n in range(len(points))]
    )
    feet = CartesianPath("feet", MINIHUBO, path, rate_hz=WALK_HZ, relative=True, locked=["HY"])
    start = {**dict.fromkeys(JOINTS, 0.0), **POSTURE}
    legs = feet.to_trajectory(start)
    rest = [name for name in JOINTS if name not in legs.names]
    rows = [[*row, *(start[name] for name in rest)] for row in legs.rows]
    return Trajectory([*legs.names, *rest], rows, rate_hz=WALK_HZ, source="four steps")


def level(pattern: Trajectory) -> float:
    """Return how far from level (rad) a sole is in the worst row."""
    worst = 0.0
    for row in pattern.rows:
        poses = MINIHUBO.forward(dict(zip(pattern.names, row, strict=True)), ["LF", "RF"])
        worst = max(worst, *(abs(pose.rotation[2, :2]).max() for pose in poses.values()))
    return worst


def main(arguments: Sequence[str]) -> dict[str, float]:
    pattern = read_walk(arguments[0]) if arguments else steps()
    robot = load_robot("minihubo_2")
    print(f"{pattern!r}: soles level to {level(pattern):.0e} rad, {robot.name}")
    worst = dict.fromkeys(pattern.names, 0.0)
    before: dict[str, float] = {}

    def compare(row: dict[str, float]) -> None:
        """Compare the joints with what the row before wanted."""
        if player.mode == "running":
            for name, wanted in before.items():
                worst[name] = max(worst[name], abs(run.states[name][0] - wanted))
        before.update(row)

    player = Player("walk", pattern, rate_hz=WALK_HZ, gentle=Limits(1.5, 6.0), hook=compare)
    run = run_virtual(robot, [player], rate_hz=WALK_HZ)
    with run:
        run.do("enable")
        ended = run.run(pattern.duration_s + 10, until=lambda: player.mode == "ended")
    counts = run.rig.hosts["servos"].counts
    name = max(worst, key=worst.__getitem__)
    end = ", ".join(ended.tripped.values()) or "nothing went wrong"
    print(
        f"{player.mode} after {ended.seconds:.1f} s; {end}; {counts.answered} answers, {counts.missed} missing"
    )
    print(f"furthest from the row before: {name}, {degrees(worst[name]):.1f}°")
    return worst


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except CallerError as error:  # no such file, or no such motion
        sys.exit(str(error))
