"""Hubo's force/torque boards: feet (with tilt) and hands."""

from .driver import driver

__all__ = ["driver"]
