"""ECUs that are asked by OBD-II."""

from .driver import driver

__all__ = ["driver"]
