"""CyberGear and RobStride motors; their twin."""

from .driver import driver

__all__ = ["driver"]
