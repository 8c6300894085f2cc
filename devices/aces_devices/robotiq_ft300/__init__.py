"""Robotiq's force/torque sensor FT 300."""

from .driver import driver

__all__ = ["driver"]
