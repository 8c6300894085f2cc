"""ECUs by UDS: values by identifier from a table, trouble codes, sessions; their twin."""

from .driver import driver

__all__ = ["driver"]
