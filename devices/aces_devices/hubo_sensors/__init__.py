"""Hubo's sensor boards (force/torque, tilt, attitude) and its power board, each with its twin."""

from .ft import driver as hubo_ft
from .imu import driver as hubo_imu
from .power import driver as hubo_power

__all__ = ["hubo_ft", "hubo_imu", "hubo_power"]
