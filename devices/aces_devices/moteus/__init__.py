"""mjbots moteus servo controllers, one joint each; their twin."""

from .driver import driver

__all__ = ["driver"]
