"""Hubo's inertial boards: roll, pitch and their rates."""

from .driver import driver

__all__ = ["driver"]
