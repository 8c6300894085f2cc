"""CyberGear and RobStride motors; their twins."""

from .driver import driver
from .mit_driver import mit_driver

__all__ = ["driver", "mit_driver"]
