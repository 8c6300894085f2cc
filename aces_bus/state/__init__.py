"""The state floor: one quantity with its age, history, derivative, integral, filters, spectrum and estimate.

A `State` is fed by a device's signal (`State.of(signal)`) or by `push`; `omega[0]` is its value, `omega[-0.5]` the one half
a second before; `power = torque * omega` is a quantity like any other. See docs/states.md.
"""

from __future__ import annotations

from ..device.reading import UNKNOWN, Reading
from .declaration import SampleCounts, SignalSource
from .derived import Derived, derived
from .design import butterworth, iir, notch
from .errors import StateError
from .estimators import ConstantAcceleration, ConstantVelocity, Estimation, Estimator, Hold
from .filters import Filter, LowPass, Median, MovingAverage, RateLimit, Sos
from .kalman import Kalman
from .quantity import TimeSeries
from .state import State
from .window import SampleWindow, Spectrum

__all__ = [
    "UNKNOWN",
    "ConstantAcceleration",
    "ConstantVelocity",
    "Derived",
    "Estimation",
    "Estimator",
    "Filter",
    "Hold",
    "Kalman",
    "LowPass",
    "Median",
    "MovingAverage",
    "RateLimit",
    "Reading",
    "SampleCounts",
    "SampleWindow",
    "SignalSource",
    "Sos",
    "Spectrum",
    "State",
    "StateError",
    "TimeSeries",
    "butterworth",
    "derived",
    "iir",
    "notch",
]
