"""MiniHubo: its four chains, the columns of its walking patterns, and its mirror.

Source: acesHubo src/ik (offsets, mm there, and signs), docs/conventions.txt (names); cross-checked: with them both soles are
level in every row of the walking patterns. x forward, y left, z up, rad and m.

1. Joints have the names of the robot files (`minihubo_1`: LEP, REP). Pattern files of the original call the elbows LEB, REB.
2. The order of `MINIHUBO.joints` is the order of a pattern's first 21 columns.
3. The ankles' roll turns the same way on both sides; hips' and shoulders' roll, and the shoulders' yaw, mirror.

Limits of the joints are not in the source; give them to `minihubo(limits=…)`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from aces_bus.controller import Trajectory, read_trajectory
from aces_bus.controller.motion import Interpolation
from aces_bus.errors import CallerError
from aces_bus.kinematics.body import Body, Chain, Move, Revolute

JOINTS = (
    *("HY", "LHY", "LHR", "LHP", "LKP", "LAP", "LAR", "RHY", "RHR", "RHP", "RKP", "RAP", "RAR"),
    *("LSP", "LSR", "LSY", "LEP", "RSP", "RSR", "RSY", "REP"),
)
#: Rows a second of the walking patterns.
WALK_HZ = 50.0
#: A knee that is bent, and elbows: away from what is singular.
POSTURE = {
    **{f"{side}{joint}": angle for side in "LR" for joint, angle in (("HP", 0.5), ("KP", 1.0), ("AP", 0.5))},
    "LEP": 0.8,
    "REP": 0.8,
}
#: Left and right exchanged; these joints then turn the other way (rule 3).
MIRROR = {f"L{joint}": f"R{joint}" for joint in ("HY", "HR", "HP", "KP", "AP", "AR", "SP", "SR", "SY", "EP")}
MIRROR_FLIPPED = ("HY", "LHY", "RHY", "LAR", "RAR")


def _leg(side: str, s: float) -> Chain:
    return Chain(
        f"{side}F",
        (
            Revolute("z", "HY"),
            Move(0, s * 0.0379, -0.0447),
            Revolute("z", f"{side}HY"),
            Revolute("x", f"{side}HR", s),
            Revolute("y", f"{side}HP", -1),
            Move(-0.021, 0, -0.088),
            Revolute("y", f"{side}KP"),
            Move(0.021, 0, -0.08769),
            Revolute("y", f"{side}AP", -1),
            Revolute("x", f"{side}AR"),
            Move(0, 0, -0.034),
        ),
    )


def _arm(side: str, s: float) -> Chain:
    return Chain(
        f"{side}W",
        (
            Move(0, s * 0.0865, 0.1393),
            Revolute("y", f"{side}SP"),
            Revolute("x", f"{side}SR", s),
            Revolute("z", f"{side}SY", s),
            Move(0, 0, -0.1093),
            Revolute("y", f"{side}EP", -1),
            Move(0, 0, -0.05),
        ),
    )


def minihubo(limits: Mapping[str, tuple[float, float]] | None = None) -> Body:
    """Return the body: tips LF and RF (soles), LW and RW (wrists); `limits` in rad by joint."""
    chains = [_leg("L", 1), _leg("R", -1), _arm("L", 1), _arm("R", -1)]
    return Body("MiniHubo", chains, joints=JOINTS, limits=limits, posture=POSTURE)


MINIHUBO = minihubo()


def walk_columns(count: int) -> Sequence[str]:
    """Return the names of a pattern's columns: 22 (the last is always 0), 21, or the 13 of the legs."""
    if count in (13, 21, 22):
        return [*JOINTS, ""][:count]
    raise CallerError(f"a MiniHubo pattern has 13, 21 or 22 columns, not {count}")


def read_walk(
    file: str | os.PathLike[str], *, rate_hz: float = WALK_HZ, interpolation: Interpolation = "cubic"
) -> Trajectory:
    """Return a walking pattern of the original, its joints named as the robot's."""
    return read_trajectory(file, rate_hz=rate_hz, columns=walk_columns, interpolation=interpolation).renamed(
        {"LEB": "LEP", "REB": "REP"}
    )


def mirrored(trajectory: Trajectory) -> Trajectory:
    """Return the same motion with left and right exchanged."""
    return trajectory.mirrored(MIRROR, MIRROR_FLIPPED)
