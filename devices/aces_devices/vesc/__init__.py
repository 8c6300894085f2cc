"""VESC motor controllers on CAN and at serial lines, one motor each; their twins."""

from .driver import driver, uart_driver

__all__ = ["driver", "uart_driver"]
