"""HuboVia: joints of a Hubo 2 through its Windows control PC."""

from .driver import driver

__all__ = ["driver"]
