"""Serial chains: where the tips of a body are, and how they move with its joints."""

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
from .links import Link, Links

__all__ = [
    "Body",
    "Chain",
    "Fixed",
    "Link",
    "Links",
    "Move",
    "Pose",
    "Prismatic",
    "Revolute",
    "Step",
    "load_body",
    "roll_pitch_yaw",
    "rotation_of",
]
