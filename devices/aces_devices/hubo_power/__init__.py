"""Hubo's smart power controller."""

from .driver import driver as driver
