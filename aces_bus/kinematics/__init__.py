"""Serial chains: where the tips of a body are, how they move with its joints, and which joint angles reach a goal."""

from __future__ import annotations

from .body import (
    Body,
    Chain,
    Fixed,
    Move,
    Pose,
    Prismatic,
    Revolute,
    Step,
    roll_pitch_yaw,
    rotation_of,
)
from .inverse import Goal, Solution, solve

__all__ = [
    "Body",
    "Chain",
    "Fixed",
    "Goal",
    "Move",
    "Pose",
    "Prismatic",
    "Revolute",
    "Solution",
    "Step",
    "roll_pitch_yaw",
    "rotation_of",
    "solve",
]
