"""Via points: a motion through given points, within limits of velocity, acceleration and jerk.

1. All joints move together: they leave a point and reach the next at the same instant.
2. Limits hold exactly (to rounding) for every joint, everywhere; times that break them are refused, with joint and segment.
3. "trapezoidal" and "quintic" stop at every point and go straight from one to the next; "through" does not stop: piecewise
   quintics, with the via velocities of a spline's usual rule (mean of the slopes, nought where the direction turns).

Theory. A straight segment is q = q0 + Δ·s(t) with one s for all joints, so the limits of s are the least of limit/|Δ|.
The trapezoid of s takes T = 1/v + v/a if v² ≤ a, else 2/√a; the quintic takes the largest of 1.875/v, √(5.7735/a) and
∛(60/j). Through: stretching time by k divides velocity by k, acceleration by k², jerk by k³; extremes of the polynomials
come from the roots of their derivatives, so k is known exactly.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ..errors import CallerError
from ..state.errors import raise_first
from .motion import Floats, interpolate, smooth_step

Shape = Literal["trapezoidal", "quintic", "through"]
#: Largest velocity, acceleration and jerk of the quintic from 0 to 1 in unit time.
QUINTIC_PEAKS = (1.875, 10.0 / math.sqrt(3.0), 60.0)


@dataclass(frozen=True)
class Limits:
    """What a joint may do: rad/s, rad/s², rad/s³ (or the state's unit); infinity says "not limited"."""

    velocity: float
    acceleration: float = math.inf
    jerk: float = math.inf

    def __post_init__(self) -> None:
        if not all(number > 0 for number in (self.velocity, self.acceleration, self.jerk)):
            raise CallerError(f"limits must be above 0, not {self}")


class ViaPath:
    """A motion through points.

    `points`: (number of points, number of names), at least two. `limits`: one for all names, or by name.
    `times`: seconds of every point, from 0, where they are given instead of found; they must keep the limits.

    >>> path = ViaPath(["LKP", "RKP"], [[0, 0], [1, 0.5]], Limits(velocity=1.0, acceleration=2.0))
    >>> path.duration_s, path.at(0.75), path.at(1.5)
    (1.5, [0.5, 0.25], [1.0, 0.5])
    """

    def __init__(
        self,
        names: Iterable[str],
        points: Any,
        limits: Limits | Mapping[str, Limits],
        *,
        shape: Shape = "trapezoidal",
        times: Sequence[float] | None = None,
        row_s: float = 0.02,
    ) -> None:
        self.names = tuple(names)
        self.points: Floats = np.array(points, dtype=np.float64, ndmin=2)
        self.shape = shape
        self.row_s = row_s
        self.limits = [limits if isinstance(limits, Limits) else _limit(limits, name) for name in self.names]
        is_trapezoid = shape == "trapezoidal"
        raise_first(
            CallerError,
            (
                len(self.points) < 2 or self.points.shape[1] != len(self.names),
                f"a path through {len(self.names)} names needs two points of as many numbers, not {self.points.shape}",
            ),
            (not np.isfinite(self.points).all(), "a path's points must be finite"),
            (
                shape not in ("trapezoidal", "quintic", "through"),
                f"shape is 'trapezoidal', 'quintic' or 'through', not {shape!r}",
            ),
            (
                is_trapezoid and any(math.isfinite(limit.jerk) for limit in self.limits),
                "a trapezoid has unlimited jerk: use shape='quintic' (or 'through') to limit it",
            ),
            (
                is_trapezoid and not all(math.isfinite(limit.acceleration) for limit in self.limits),
                "a trapezoid needs a limit of acceleration",
            ),
        )
        if times is not None:
            self.times = [float(time) for time in times]
            raise_first(
                CallerError,
                (
                    len(self.times) != len(self.points) or self.times[0] != 0.0,
                    f"{len(self.points)} points need as many times, the first of them 0",
                ),
                (
                    any(not b > a for a, b in zip(self.times, self.times[1:], strict=False)),
                    "the times of a path must increase",
                ),
            )
        else:
            durations = [self._segment(i) for i in range(len(self.points) - 1)]
            self.times = [0.0, *np.cumsum(durations).tolist()]
        self._polynomials: list[Floats] = []  # per segment (6, names), lowest power first
        if shape == "through":
            self._fit(free=times is None)
        elif times is not None:
            for i in range(len(self.points) - 1):
                self._check(i)

    @property
    def duration_s(self) -> float:
        """Seconds from the first point to the last."""
        return self.times[-1]

    # ---- straight segments -----------------------------------------------------------------------------------------

    def _straight_limits(self, i: int) -> tuple[float, float, float]:
        """Return the limits of s on segment i; the least over the joints."""
        least = [math.inf, math.inf, math.inf]
        for delta, limit in zip((self.points[i + 1] - self.points[i]).tolist(), self.limits, strict=True):
            if delta:
                for k, number in enumerate((limit.velocity, limit.acceleration, limit.jerk)):
                    least[k] = min(least[k], number / abs(delta))
        return least[0], least[1], least[2]

    def _segment(self, i: int) -> float:
        """Return the least duration of segment i."""
        velocity, acceleration, jerk = self._straight_limits(i)
        if math.isinf(velocity):
            return self.row_s  # nothing moves
        if self.shape == "trapezoidal":
            if velocity * velocity <= acceleration:
                return 1.0 / velocity + velocity / acceleration
            return 2.0 / math.sqrt(acceleration)
        peak_v, peak_a, peak_j = QUINTIC_PEAKS
        by_jerk: float = (peak_j / jerk) ** (1 / 3)
        return max(peak_v / velocity, math.sqrt(peak_a / acceleration), by_jerk)

    def _check(self, i: int) -> None:
        """Refuse a given time that is too short (rule 2)."""
        given, least = self.times[i + 1] - self.times[i], self._segment(i)
        if not math.isinf(self._straight_limits(i)[0]) and given < least * (1 - 1e-9):
            delta = np.abs(self.points[i + 1] - self.points[i])
            worst = max(range(len(self.names)), key=lambda k: float(delta[k]) / self.limits[k].velocity)
            raise CallerError(
                f"segment {i + 1} ({self.times[i]:g} … {self.times[i + 1]:g} s) is too short for {self.names[worst]}: "
                f"its limits need {least:.4g} s"
            )

    def _straight(self, i: int, u: float, duration: float) -> float:
        """Return s at the time u (0 … duration) of segment i."""
        if self.shape == "quintic":
            x = u / duration
            return smooth_step(x)
        # With a longer time than needed the cruise is slower; the ramps keep their acceleration.
        acceleration = self._straight_limits(i)[1]
        if math.isinf(acceleration):
            return u / duration
        root = math.sqrt(max(0.0, duration * duration - 4.0 / acceleration))
        ramp = 0.5 * (duration - root)
        speed = acceleration * ramp
        if u < ramp:
            return 0.5 * acceleration * u * u
        if u > duration - ramp:
            left = duration - u
            return 1.0 - 0.5 * acceleration * left * left
        return float(speed * (u - 0.5 * ramp))

    # ---- without stopping ------------------------------------------------------------------------------------------

    def _velocities(self) -> Floats:
        slopes = np.diff(self.points, axis=0) / np.diff(self.times)[:, None]
        out = np.zeros_like(self.points)
        same = slopes[:-1] * slopes[1:] > 0
        out[1:-1] = np.where(same, 0.5 * (slopes[:-1] + slopes[1:]), 0.0)
        return out

    def _fit(self, free: bool) -> None:
        """Fit quintics with the points' velocities and no acceleration there; stretch times until the limits hold."""
        stretch = self._print()
        if stretch <= 1 + 1e-9 and not free:
            return
        if not free:
            raise CallerError(
                f"the times of the path are too short for its limits: {stretch:.4g} times as long would do"
            )
        # Stretching divides exactly, so one pass is enough; it may also shorten what the straight estimate made long.
        self.times = [time * stretch for time in self.times]
        self._print()

    def _print(self) -> float:
        """Compute the polynomials for the present times; return the factor by which the times must grow."""
        velocities, self._polynomials, stretch = self._velocities(), [], 0.0
        limits = np.array([(limit.velocity, limit.acceleration, limit.jerk) for limit in self.limits]).T
        for i in range(len(self.points) - 1):
            duration = self.times[i + 1] - self.times[i]
            p, w = self.points[i + 1] - self.points[i], velocities[i] * duration
            z = velocities[i + 1] * duration
            # Position, velocity and acceleration at both ends, time in units of the segment.
            scaled = np.stack(
                [
                    self.points[i],
                    w,
                    0 * p,
                    10 * p - 6 * w - 4 * z,
                    -15 * p + 8 * w + 7 * z,
                    6 * p - 3 * w - 3 * z,
                ]
            )
            polynomial = scaled / duration ** np.arange(6)[:, None]
            self._polynomials.append(polynomial)
            derivative = polynomial
            for order in range(3):
                derivative = derivative[1:] * np.arange(1, len(derivative))[:, None]
                for k in range(len(self.names)):
                    peak = _peak(derivative[:, k], duration)
                    stretch = max(stretch, (peak / limits[order, k]) ** (1 / (order + 1)))
        return stretch or 1.0

    def at(self, seconds: float) -> list[float]:
        """Return the values `seconds` after the first point."""
        if not seconds > 0.0:  # NaN, too
            return self.points[0].tolist()  # type: ignore[no-any-return]
        if seconds >= self.times[-1]:
            return self.points[-1].tolist()  # type: ignore[no-any-return]
        i = bisect_right(self.times, seconds) - 1
        u = seconds - self.times[i]
        if self.shape == "through":
            c0, c1, c2, c3, c4, c5 = self._polynomials[i]
            return (c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5))))).tolist()  # type: ignore[no-any-return]
        s = self._straight(i, u, self.times[i + 1] - self.times[i])
        return interpolate(self.points[i].tolist(), self.points[i + 1].tolist(), s)


def _limit(limits: Mapping[str, Limits], name: str) -> Limits:
    if name not in limits:
        raise CallerError(f"no limits for {name}: give one for each of the path's names")
    return limits[name]


def _peak(coefficients: Floats, duration: float) -> float:
    """Return the largest magnitude of a polynomial (lowest power first) on 0 … duration."""
    ends = [0.0, duration]
    slope = (coefficients[1:] * np.arange(1, len(coefficients)))[::-1]
    scale = float(np.abs(slope).max(initial=0.0))
    if scale > 0:
        roots = np.roots(np.where(np.abs(slope) < 1e-12 * scale, 0.0, slope))
        ends += [float(root.real) for root in roots if abs(root.imag) < 1e-9 and 0 < root.real < duration]
    return float(np.abs(np.polyval(coefficients[::-1], ends)).max())
