"""VESC motor controllers on CAN, one motor each; their twin."""

from .driver import driver

__all__ = ["driver"]
