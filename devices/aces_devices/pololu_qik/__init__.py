"""Pololu qik dual motor drivers, as on Omnibot."""

from .driver import driver

__all__ = ["driver"]
