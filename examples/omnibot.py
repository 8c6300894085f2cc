"""Omnibot drives a square, and turns: four wheels on two motor drivers, one serial line, nothing is measured.

What the original read from a 3-D mouse is a table of moves here: (z, x, b) are forward, sideways and turn. The mix of the
four wheels stands in equations; set-points are duties of ±127.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import tau

from aces_bus import load_robot
from aces_bus.controller import controller
from aces_bus.robot import run_virtual

#: Seconds, forward, sideways, turn.
MOVES = [
    (1.0, 100, 0, 0),
    (1.0, 0, 100, 0),
    (1.0, -100, 0, 0),
    (1.0, 0, -100, 0),
    (1.0, 0, 0, 127),
    (0.5, 0, 0, 0),
]
WHEELS = ("M1", "M2", "M3", "M4")


def move_at(t: float) -> tuple[int, int, int]:
    """Forward, sideways, turn, at an instant (s)."""
    for seconds, z, x, b in MOVES:
        if t < seconds - 1e-9:
            return z, x, b
        t -= seconds
    return 0, 0, 0


@controller(rate_hz=10, writes=WHEELS)
def drive(t: float) -> Mapping[str, float]:
    """Return the move of this instant, as four duties (spaceball.m)."""
    z, x, b = move_at(t)
    return {
        "M1": z / 2 - x / 2 + b / 2,
        "M2": z / 2 + x / 2 + b / 2,
        "M3": z / 2 - x / 2 - b / 2,
        "M4": z / 2 + x / 2 - b / 2,
    }


def main() -> list[tuple[float, float, float]]:
    robot = load_robot("omnibot")
    way: list[tuple[float, float, float]] = []
    with run_virtual(robot, [drive]) as run:
        run.start()
        before = [0.0] * 4
        for seconds, z, x, b in MOVES:
            run.world.advance(seconds)
            now = [
                run.world.simulation.world.joints[wheel].position(run.clock.now()) / tau for wheel in WHEELS
            ]
            m1, m2, m3, m4 = (after - was for after, was in zip(now, before, strict=True))
            before = now
            way.append(
                ((m1 + m2 + m3 + m4) / 2, (m2 + m4 - m1 - m3) / 2, (m1 + m2 - m3 - m4) / 2)
            )  # the mix, undone
            print(
                f"told {z:4} forward {x:4} sideways {b:4} turn for {seconds} s:  went %+.2f, %+.2f, %+.2f turns of a wheel"
                % way[-1]
            )
        ended = run.stop()
    print(f"{run.set_points} set-points, {', '.join(ended.tripped.values()) or 'nothing went wrong'}")
    return way


if __name__ == "__main__":
    main()
