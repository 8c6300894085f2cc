"""Hubo's inertial boards: roll, pitch and their rates."""

from .driver import driver as driver
