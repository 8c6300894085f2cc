"""The pose of a simulated Hubo, as its sensors feel it: simple, and the same for all sensors of a robot.

1. It knows joint positions only: no dynamics, no contact, no fall. What it leaves out is said here and in the README.
2. It is a function of the joints at an instant; within a millisecond it is computed once.

The model: the robot is standing. Its pelvis lies so that both feet are flat on average: when each leg's angles add up to
zero, the pelvis is level and so are the feet; when one ankle moves, the pelvis tilts by half of it and the feet by the
other half each. Links are rigid and massless, the whole weight is one point above the pelvis. That point's place beside
the feet shares the weight between them; its place before them is the moment about the ankles. Axes: x forward, y left,
z up; joints turn right-handed about y (pitch) and x (roll).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sin
from typing import Final

from aces_bus.device import Robot
from aces_bus.device.twin import World
from aces_bus.errors import UnknownNameError

#: How long a pose holds (ns).
HOLD_NS: Final = 1_000_000
_LEG = ("HP", "KN", "AP", "HR", "AR")


@dataclass(frozen=True)
class Build:
    """Sizes in m, weight in N: a robot of Hubo's proportions. They are choices, no sheet has them."""

    weight: float = 440.0
    shank: float = 0.3
    thigh: float = 0.3
    trunk: float = 0.25
    half_stance: float = 0.09
    #: From the ankle to the sole's edge: the moment that a foot can take is its load times this.
    sole_front: float = 0.12
    sole_side: float = 0.06


BUILD: Final = Build()


@dataclass
class Foot:
    """What one foot feels: its roll and pitch (rad), and the floor's force (N) and moments (N·m) on it."""

    roll: float = 0.0
    pitch: float = 0.0
    mx: float = 0.0
    my: float = 0.0
    fz: float = 0.0


class BodyPose:
    """The pose at an instant: `update(now)`, then `roll`, `pitch`, `roll_rate`, `pitch_rate` and `feet["R"]`."""

    def __init__(self, world: World, robot: Robot, build: Build = BUILD) -> None:
        self.world, self.build = world, build
        # Looked up in each update: a board that reboots may register other models.
        self._names = [[_name(robot, side + part) for part in _LEG] for side in "RL"]
        self._at = -HOLD_NS
        self.roll = self.pitch = self.roll_rate = self.pitch_rate = 0.0
        self.feet = {"R": Foot(), "L": Foot()}

    def update(self, now: int) -> None:
        """Compute the pose, unless that was done within the last millisecond."""
        passed = now - self._at
        if passed < HOLD_NS:
            return
        build = self.build
        joints = self.world.joints
        legs = [
            [joints[name].position(now) if name in joints else 0.0 for name in names] for names in self._names
        ]
        pitches = [hip + knee + ankle for hip, knee, ankle, _, _ in legs]
        rolls = [hip + ankle for _, _, _, hip, ankle in legs]
        pitch, roll = -sum(pitches) / 2, -sum(rolls) / 2
        if self._at >= 0:
            self.pitch_rate = (pitch - self.pitch) * 1e9 / passed
            self.roll_rate = (roll - self.roll) * 1e9 / passed
        self.pitch, self.roll, self._at = pitch, roll, now
        # Where the weight is, before and beside the middle of the ankles.
        x, y = build.trunk * sin(pitch), -build.trunk * sin(roll)
        for hip, knee, _, hip_roll, _ in legs:
            x += 0.5 * (build.thigh * sin(pitch + hip) + build.shank * sin(pitch + hip + knee))
            y -= 0.5 * (build.thigh + build.shank) * sin(roll + hip_roll)
        left = min(1.0, max(0.0, 0.5 + y / (2 * build.half_stance)))
        beside = y - min(build.half_stance, max(-build.half_stance, y))
        before = min(build.sole_front, max(-build.sole_front, x))
        beside = min(build.sole_side, max(-build.sole_side, beside))
        for side, share, sum_roll, sum_pitch in zip("RL", (1 - left, left), rolls, pitches, strict=True):
            foot = self.feet[side]
            foot.roll, foot.pitch = roll + sum_roll, pitch + sum_pitch
            foot.fz = build.weight * share
            foot.mx, foot.my = foot.fz * beside, -foot.fz * before


def body_of(world: World, robot: Robot) -> BodyPose:
    """Return the one body of a simulated robot."""
    found: BodyPose | None = world.shared.get("hubo body")
    if found is None:
        found = world.shared["hubo body"] = BodyPose(world, robot)
    return found


def _name(robot: Robot, alias: str) -> str:
    try:
        return robot.joint(alias).name
    except UnknownNameError:
        return ""
