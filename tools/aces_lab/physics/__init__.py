"""Bodies for the motors of twins: MuJoCo models (extra: physics)."""

from __future__ import annotations

from .mujoco_body import MujocoBody, mujoco_body

__all__ = ["MujocoBody", "mujoco_body"]
