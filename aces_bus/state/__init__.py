"""The state floor: one quantity with its age, history, derivative, integral, filters, spectrum and estimate.

A `State` is fed by a device's signal (`State.of(signal)`) or by `push`; `omega[0]` is its value, `omega[-0.5]` the one half
a second before; `power = torque * omega` is a quantity like any other. See docs/states.md.
"""

from __future__ import annotations

from .derived import derived
from .design import iir, notch
from .errors import StateError
from .estimators import ConstantAcceleration, ConstantVelocity, Hold
from .filters import LowPass, Median, MovingAverage, RateLimit, Sos
from .kalman import Kalman
from .state import State

__all__ = [
    "ConstantAcceleration",
    "ConstantVelocity",
    "Hold",
    "Kalman",
    "LowPass",
    "Median",
    "MovingAverage",
    "RateLimit",
    "Sos",
    "State",
    "StateError",
    "derived",
    "iir",
    "notch",
]
