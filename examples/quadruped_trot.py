"""A quadruped stands up and trots on the spot: twelve motors with stiffness and damping, four CAN buses, 500 Hz.

The feet's paths are given, the joints follow from them: each leg is two links of equal length, which has one solution with
the knee bent forward. Feet that swing are soft (a third of the stiffness); those that stand are stiff. Printed: how
closely the joints follow, what the buses carry, how long it took.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from math import acos, cos, pi, sin

from aces_bus import load_robot
from aces_bus.controller import Controller, controller
from aces_bus.robot import run_virtual

LEGS = ("LF", "RF", "LH", "RH")
JOINTS = [f"{leg}_{part}" for leg in LEGS for part in ("HAA", "HFE", "KFE")]
RATE_HZ = 500
#: Each link of a leg (m); how high it stands, how far a foot is lifted.
LINK, HEIGHT, LIFT = 0.2, 0.32, 0.05
#: Until it stands; a step (s).
RISE_S, STEP_S = 1.0, 0.4
#: Stiffness of a leg that stands (N·m/rad), and the share of it while it swings.
STIFFNESS, SOFT = {"HAA": 60.0, "HFE": 60.0, "KFE": 40.0}, 1 / 3


def leg_angles(height: float) -> tuple[float, float]:
    """Hip and knee (rad) of a foot straight below its hip at a depth (m).

    >>> [round(angle, 3) for angle in leg_angles(2 * LINK)]
    [0.0, 0.0]
    """
    half = acos(min(1.0, height / (2 * LINK)))
    return half, -2 * half


def foot(leg: str, t: float) -> tuple[float, bool]:
    """Return how deep below its hip a foot is (m), and whether it swings: diagonal legs together, in turn."""
    if t < RISE_S:
        share = 0.5 - 0.5 * cos(pi * t / RISE_S)
        return 2 * LINK + (HEIGHT - 2 * LINK) * share, False
    phase = (t - RISE_S) % (2 * STEP_S) / STEP_S - (leg in ("RF", "LH"))
    swings = 0 <= phase < 1
    return HEIGHT - (LIFT * sin(pi * phase) ** 2 if swings else 0.0), swings


@controller(rate_hz=RATE_HZ, writes=[*JOINTS, *(f"{joint}.kp" for joint in JOINTS)])
def trot(t: float) -> Mapping[str, float]:
    """Angles and stiffness of all joints."""
    wanted: dict[str, float] = {}
    for leg in LEGS:
        height, swings = foot(leg, t)
        for part, angle in zip(("HAA", "HFE", "KFE"), (0.0, *leg_angles(height)), strict=True):
            wanted[f"{leg}_{part}"] = angle
            wanted[f"{leg}_{part}.kp"] = STIFFNESS[part] * (SOFT if swings else 1.0)
    return wanted


def main(seconds: float = 3.0, law: Controller = trot) -> dict[str, float]:
    """Return how far joints were from their goals (rad), and how much faster than life the run was."""
    worst = 0.0
    with run_virtual(load_robot("quadruped"), [law]) as run:
        run.do("enable")
        run.start()
        begun, cpu = run.clock.now(), time.process_time()
        wires = run.world.wires.values()
        frames = -sum(wire.load.frames for wire in wires)
        for _ in range(round(seconds * 50)):
            run.world.advance(0.02)
            if run.seconds > 0.1:
                for joint in JOINTS:
                    given = run.rig.door.given(joint)
                    if given is not None:
                        worst = max(worst, abs(run.world[joint].last - given))
        spent = time.process_time() - cpu
        passed = (run.clock.now() - begun) / 1e9
        frames += sum(wire.load.frames for wire in wires)
        unanswered = sum(host.counts.missed for host in run.rig.hosts.values())
        load = max(wire.load.busy_ns / (run.clock.now() - wire.load.since) for wire in wires)
        ended = run.stop()
    print(
        f"{len(JOINTS)} joints on {len(LEGS)} buses, {RATE_HZ} Hz: within {worst:.3f} rad of their set-points"
    )
    print(
        f"{frames / passed:.0f} frames/s, a bus is loaded by up to {100 * load:.0f} %; unanswered: {unanswered}"
    )
    print(f"{passed:.1f} s in {spent:.1f} s of CPU: {passed / spent:.2f} × real time")
    print(", ".join(ended.tripped.values()) or "nothing went wrong")
    return {"worst": worst, "ratio": passed / spent, "unanswered": unanswered, "load": load}


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 3.0)
