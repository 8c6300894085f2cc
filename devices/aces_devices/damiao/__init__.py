"""Damiao DM motors: MIT frame, position, velocity and force modes; their twin."""

from .driver import driver

__all__ = ["driver"]
