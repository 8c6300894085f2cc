"""Damiao DM motors: MIT frame, position, velocity and force modes; their twin."""

from .driver import driver, fd_driver

__all__ = ["driver", "fd_driver"]
