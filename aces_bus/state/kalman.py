"""Kalman filters of a quantity that moves with nearly constant velocity or nearly constant acceleration.

1. Time steps are the real ones: samples may come unevenly, and gaps widen the uncertainty by themselves.
2. What runs is one tuple, replaced at once: a reader on another thread sees a state of one instant.

Theory: Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation (2001), §6.2: white noise of
spectral density q drives the acceleration (velocity model) or the jerk (acceleration model); §5.5.3 starts the filter by
differencing its first two samples. With the transition F over dt, P ← F P Fᵀ + Q, K = P Hᵀ / (H P Hᵀ + r).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from ..device.reading import UNKNOWN
from .errors import StateError, raise_first
from .estimators import Estimation
from .filters import AnyRate
from .units import multiplied

if TYPE_CHECKING:
    from .state import State

#: Samples that an estimate before the history is made from.
PAST_SAMPLES = 64


@dataclass(frozen=True)
class Kalman(AnyRate):
    """A Kalman filter, as the estimator of a state or, in `state.filtered(Kalman(…))`, as a filter of it.

    `measurement_std` is the standard deviation of a sample (in the state's unit), `process_density` the spectral density of
    the noise that drives the model: unit²/s³ for "velocity", unit²/s⁵ for "acceleration". Rule of thumb: how much the
    velocity (acceleration) may change in a second, squared. As a filter it gives the `derivative` 0, 1 or 2 of the quantity.
    """

    measurement_std: float
    process_density: float
    model: Literal["velocity", "acceleration"] = "velocity"
    derivative: int = 0

    def __post_init__(self) -> None:
        raise_first(
            StateError,
            (
                not (0 < self.measurement_std < math.inf and 0 <= self.process_density < math.inf),
                f"{self}: measurement_std must be > 0 and process_density ≥ 0, both finite",
            ),
            (
                self.model not in ("velocity", "acceleration"),
                f"{self}: the models are 'velocity' and 'acceleration'",
            ),
            (
                self.derivative not in ((0, 1) if self.model == "velocity" else (0, 1, 2)),
                f"{self}: the {self.model} model does not have that derivative",
            ),
        )

    def track(self) -> Track:
        """Return what runs."""
        return (VelocityTrack if self.model == "velocity" else AccelerationTrack)(
            self.measurement_std**2, self.process_density
        )

    def start(self, state: State) -> Estimation:
        """Begin as an estimator: into the future from the newest sample, into the past by filtering backwards in time."""
        track = self.track()

        def estimate(instant: int) -> Any:
            newest = state.instant
            if newest is None or instant > newest:
                return track.at(instant)[0]
            backwards = self.track()
            instants, values = state.known_samples(PAST_SAMPLES, newest=False)
            for sampled, value in zip(reversed(instants), reversed(values), strict=True):
                backwards.observe(value, -sampled)
            return backwards.at(-instant)[0]

        return Estimation(track.observe, estimate)

    def start_filter(self, first: float) -> Callable[[float, int], float]:
        """Begin as a filter."""
        track, which = self.track(), self.derivative

        def step(value: float, instant: int) -> float:
            track.observe(value, instant)
            return track.state[1 + which]  # type: ignore[no-any-return]

        return step

    def unit_of(self, unit: str | None) -> str | None:
        """Return the unit of what the filter gives."""
        for _ in range(self.derivative):
            unit = multiplied(unit, "s", -1)
        return unit


class Track:
    """A running filter. `state` is (instant, value, velocity, acceleration or 0, the covariances …); () before a sample."""

    def __init__(self, variance: float, density: float) -> None:
        self.variance, self.density = variance, density
        self.state: tuple[Any, ...] = ()
        self._seen = 0

    def observe(self, value: float, instant: int) -> None:
        """Take a sample, newer than all before. The first two start the filter; one that runs away begins anew."""
        if self._seen == 2:
            state = self._updated(value, instant)
            if -math.inf < state[1] < math.inf:
                self.state = state
                return
            self._seen = 0
        self._seen += 1
        self.state = self._begun(value, instant, (instant - self.state[0]) * 1e-9 if self._seen == 2 else 0.0)

    def _begun(self, value: float, instant: int, dt: float) -> tuple[float, ...]:
        """Return the state behind the first sample (dt = 0), or behind the second."""
        raise NotImplementedError

    def _updated(self, value: float, instant: int) -> tuple[float, ...]:
        """Return the state behind one more sample."""
        raise NotImplementedError

    def at(self, instant: int) -> tuple[Any, Any, Any]:
        """Return value, velocity and acceleration at an instant, by the model; `UNKNOWN` before the first sample."""
        if not self.state:
            return UNKNOWN, UNKNOWN, UNKNOWN
        since, x, v, a = self.state[:4]
        dt = (instant - since) * 1e-9
        return x + dt * (v + 0.5 * dt * a), v + dt * a, a


class VelocityTrack(Track):
    """Nearly constant velocity; behind value and velocity are the covariances xx, xv, vv."""

    def _begun(self, value: float, instant: int, dt: float) -> tuple[float, ...]:
        r = self.variance
        if not dt:
            return (instant, value, 0.0, 0.0, r, 0.0, 0.0)
        return (instant, value, (value - self.state[1]) / dt, 0.0, r, r / dt, 2 * r / (dt * dt))

    def _updated(self, value: float, instant: int) -> tuple[float, ...]:
        r = self.variance
        since, x, v, _, xx, xv, vv = self.state
        dt = (instant - since) * 1e-9
        x += dt * v
        noise = self.density * dt
        xx += dt * (2 * xv + dt * vv) + noise * dt * dt / 3
        xv += dt * vv + noise * dt / 2
        vv += noise
        scale = 1 / (xx + r)
        k, l = xx * scale, xv * scale  # noqa: E741 - gains of value and velocity
        error = value - x
        return (instant, x + k * error, v + l * error, 0.0, r * k, r * l, vv - l * xv)


class AccelerationTrack(Track):
    """Nearly constant acceleration; behind the three are the covariances xx, xv, xa, vv, va, aa."""

    def _begun(self, value: float, instant: int, dt: float) -> tuple[float, ...]:
        r = self.variance
        if not dt:
            return (instant, value, 0.0, 0.0, r, 0.0, 0.0, 0.0, 0.0, 0.0)
        # The acceleration is open: as uncertain as ten times what three samples would leave of it.
        v = (value - self.state[1]) / dt
        aa = 600 * r / dt**4 + (10 * v / dt) * (10 * v / dt)
        vv = 2 * r / dt**2 + aa * dt**2 / 4
        return (instant, value, v, 0.0, r, r / dt, 0.0, vv, aa * dt / 2, aa)

    def _updated(self, value: float, instant: int) -> tuple[float, ...]:
        r = self.variance
        since, x, v, a, xx, xv, xa, vv, va, aa = self.state
        dt = (instant - since) * 1e-9
        half = 0.5 * dt
        x += dt * (v + half * a)
        v += dt * a
        noise = self.density * dt
        # F P, row by row, then times Fᵀ.
        fx, fv, fa = xx + dt * (xv + half * xa), xv + dt * (vv + half * va), xa + dt * (va + half * aa)
        gv, ga = vv + dt * va, va + dt * aa
        xx = fx + dt * (fv + half * fa) + noise * dt**4 / 20
        xv = fv + dt * fa + noise * dt**3 / 8
        xa = fa + noise * dt * dt / 6
        vv = gv + dt * ga + noise * dt * dt / 3
        va = ga + noise * half
        aa += noise
        scale = 1 / (xx + r)
        k, l, m = xx * scale, xv * scale, xa * scale  # noqa: E741 - gains of value, velocity, acceleration
        error = value - x
        return (
            instant, x + k * error, v + l * error, a + m * error,
            r * k, r * l, r * m, vv - l * xv, va - l * xa, aa - m * xa,
        )  # fmt: skip
