"""Serial chains: where the tips of a body are, how they move with its joints, and which joint angles reach a goal."""

from __future__ import annotations

from .bodies import load_body
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
from .links import Link, Links

__all__ = [
    "Body",
    "Chain",
    "Fixed",
    "Goal",
    "Link",
    "Links",
    "Move",
    "Pose",
    "Prismatic",
    "Revolute",
    "Solution",
    "Step",
    "load_body",
    "roll_pitch_yaw",
    "rotation_of",
    "solve",
]
