"""Devices on Modbus RTU, by the table of their registers."""

from .driver import driver

__all__ = ["driver"]
