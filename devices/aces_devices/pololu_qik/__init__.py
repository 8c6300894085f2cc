"""Pololu qik dual motor drivers, as on Omnibot."""

from .driver import driver as driver
