"""The state floor: one quantity with its age, history, derivative, integral, filters, spectrum and estimate.

A `State` is fed by a device's signal (`State.of(signal)`) or by `push`; `omega[0]` is its value, `omega[-0.5]` the one half
a second before; `power = torque * omega` is a quantity like any other. See docs/states.md.
"""

from __future__ import annotations

from ..device.signals import UNKNOWN as UNKNOWN
from ..device.signals import Reading as Reading
from .derived import Derived as Derived
from .derived import derived as derived
from .design import butterworth as butterworth
from .design import iir as iir
from .design import notch as notch
from .errors import StateError as StateError
from .estimators import ConstantAcceleration as ConstantAcceleration
from .estimators import ConstantVelocity as ConstantVelocity
from .estimators import Estimation as Estimation
from .estimators import Estimator as Estimator
from .estimators import Hold as Hold
from .filters import Filter as Filter
from .filters import LowPass as LowPass
from .filters import Median as Median
from .filters import MovingAverage as MovingAverage
from .filters import RateLimit as RateLimit
from .filters import Sos as Sos
from .kalman import Kalman as Kalman
from .quantity import Quantity as Quantity
from .source import Counts as Counts
from .source import Source as Source
from .spectrum import Spectrum as Spectrum
from .state import State as State
from .window import Window as Window
