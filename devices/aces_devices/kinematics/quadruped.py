"""The body of the robot `quadruped`: four legs of two links, nobody's robot.

Lengths are a choice. x forward, y left, z up, rad and m. With all joints at 0 the legs are straight down.

1. HAA turns a leg about x, HFE forwards and KFE (negative: bent) about −y; all legs turn the same way.
2. A tip is a foot, called as its leg: LF, RF, LH, RH (left, right; fore, hind).
"""

from __future__ import annotations

from aces_bus.kinematics.body import Body, Chain, Move, Revolute

LEGS = ("LF", "RF", "LH", "RH")
#: Where hips are before and beside the trunk's middle, how far a thigh is beside its hip, how long a link is (m).
HIP_X, HIP_Y, BESIDE, LINK = 0.2, 0.1, 0.04, 0.2


def _leg(name: str) -> Chain:
    x, y = (HIP_X if name[1] == "F" else -HIP_X), (1 if name[0] == "L" else -1)
    return Chain(
        name,
        (
            Move(x, y * HIP_Y, 0.0),
            Revolute("x", f"{name}_HAA"),
            Move(0.0, y * BESIDE, 0.0),
            Revolute("y", f"{name}_HFE", -1),
            Move(0.0, 0.0, -LINK),
            Revolute("y", f"{name}_KFE", -1),
            Move(0.0, 0.0, -LINK),
        ),
    )


QUADRUPED = Body("quadruped", map(_leg, LEGS))
