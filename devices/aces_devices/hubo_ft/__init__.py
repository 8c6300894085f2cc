"""Hubo's force/torque boards: feet (with tilt) and hands."""

from .driver import driver as driver
