"""ODrive motor controllers on CAN, firmware 0.5 and 0.6; their twin."""

from .driver import driver

__all__ = ["driver"]
