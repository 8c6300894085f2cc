"""Hubo's smart power controller."""

from .driver import driver

__all__ = ["driver"]
