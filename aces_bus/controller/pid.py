"""PID: the law alone, and the controller around it.

1. Derivative on the measurement, so that a new set-point does not kick; a first-order filter on it (`derivative_filter_s`).
2. The output never leaves `limits`, and the integral does not wind up there: "clamp" lets it grow only towards the limits'
   inside, "back-calculation" leads the excess back into it with the time constant `tracking_s`.
3. A change of gains moves no output: the integral, kept in units of the output, takes the difference up.
4. What is not finite is not taken in: the last output stays, and `not_finite` counts.

Theory: u = kp·(b·r − y) + I + D, with I += ki·e·dt (trapezium of e) and D = filtered −kd·dy/dt by backward Euler,
which is stable for any filter constant. K. J. Åström, R. M. Murray, Feedback Systems, ch. 11.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

from ..errors import CallerError
from ..state.errors import raise_first
from .base import NOTHING, Controller, StateLike, known_value

AntiWindup = Literal["clamp", "back-calculation"]


class PID:
    """The law: `update(measurement, dt)` gives the output.

    >>> pid = PID(kp=2.0, ki=1.0, limits=(-1.0, 1.0), setpoint=0.25)
    >>> pid.update(0.0, 0.01)
    0.5025
    >>> pid.set_gains(kp=4.0)
    >>> round(pid.update(0.0, 1e-9), 6)
    0.5025

    Gains in output units per unit (kp), per unit·s (ki), per unit/s (kd). `setpoint_weight` b weighs the set-point in the
    proportional part alone (0: no kick at all). `tracking_s` is the time in which back-calculation forgets its excess (s);
    None takes sqrt(kd/ki), or kp/ki without a derivative.
    """

    __slots__ = (
        "_derivative",
        "_error",
        "_integral",
        "_measured",
        "anti_windup",
        "derivative_filter_s",
        "high",
        "kd",
        "ki",
        "kp",
        "low",
        "not_finite",
        "output",
        "saturated",
        "setpoint",
        "setpoint_weight",
        "tracking_s",
    )

    def __init__(
        self,
        kp: float,
        ki: float = 0.0,
        kd: float = 0.0,
        *,
        setpoint: float = 0.0,
        limits: tuple[float, float] = (-math.inf, math.inf),
        anti_windup: AntiWindup = "clamp",
        tracking_s: float | None = None,
        derivative_filter_s: float = 0.0,
        setpoint_weight: float = 1.0,
    ) -> None:
        raise_first(
            CallerError,
            (
                not all(map(math.isfinite, (kp, ki, kd, setpoint, setpoint_weight))),
                f"PID: gains and set-point must be finite, not {(kp, ki, kd, setpoint)}",
            ),
            (not limits[0] < limits[1], f"PID: limits = {limits} leave nothing between them"),
            (
                not (math.isfinite(derivative_filter_s) and derivative_filter_s >= 0),
                f"PID: derivative_filter_s = {derivative_filter_s!r} s is not a time constant",
            ),
            (
                tracking_s is not None and not tracking_s > 0,
                f"PID: tracking_s = {tracking_s!r} s is not a time constant",
            ),
            (
                anti_windup not in ("clamp", "back-calculation"),
                f"PID: anti_windup is 'clamp' or 'back-calculation', not {anti_windup!r}",
            ),
        )
        self.kp, self.ki, self.kd = kp, ki, kd
        self.setpoint, self.setpoint_weight = setpoint, setpoint_weight
        self.low, self.high = limits
        self.anti_windup = anti_windup
        self.tracking_s = tracking_s
        self.derivative_filter_s = derivative_filter_s
        self.saturated = self.not_finite = 0
        self.reset()

    def reset(self, output: float = 0.0) -> None:
        """Forget; the next update starts from the integral `output`."""
        self._integral = output
        self._derivative = 0.0
        self._measured: float | None = None
        self._error = 0.0
        self.output = output

    def track(self, measurement: float, output: float) -> None:
        """Be as if it had given `output` at `measurement`: it takes over without a jump (manual to automatic)."""
        self._derivative = 0.0
        self._integral = output - self.kp * (self.setpoint_weight * self.setpoint - measurement)
        self._measured = measurement
        self._error = self.setpoint - measurement
        self.output = output

    def set_gains(self, kp: float | None = None, ki: float | None = None, kd: float | None = None) -> None:
        """Change gains without moving the output (rule 3)."""
        kp, ki, kd = (
            old if new is None else new for old, new in ((self.kp, kp), (self.ki, ki), (self.kd, kd))
        )
        if not all(math.isfinite(gain) for gain in (kp, ki, kd)):
            raise CallerError(f"PID: gains must be finite, not {(kp, ki, kd)}")
        if self._measured is not None:
            self._integral += (self.kp - kp) * (self.setpoint_weight * self.setpoint - self._measured)
            if self.kd:  # the filtered derivative scales with kd
                scaled = self._derivative * kd / self.kd
                self._integral += self._derivative - scaled
                self._derivative = scaled
        self.kp, self.ki, self.kd = kp, ki, kd

    def update(self, measurement: float, dt: float) -> float:
        """Return the output for a measurement `dt` seconds after the last; dt ≤ 0 changes nothing but the proportional
        part.
        """
        setpoint = self.setpoint
        error = setpoint - measurement
        if error - error != 0.0:  # NaN or infinite: rule 4
            self.not_finite += 1
            return self.output
        before = self._measured
        if before is None:
            before, self._error = measurement, error
        integral, increment = self._integral, 0.0
        if dt > 0.0:
            increment = 0.5 * self.ki * (error + self._error) * dt
            integral += increment
            if self.kd:
                filter_s = self.derivative_filter_s
                self._derivative = (filter_s * self._derivative - self.kd * (measurement - before)) / (
                    filter_s + dt
                )
        wanted = self.kp * (self.setpoint_weight * setpoint - measurement) + integral + self._derivative
        low, high = self.low, self.high
        output = low if wanted < low else high if wanted > high else wanted
        if output != wanted:
            self.saturated += 1
            if self.anti_windup == "clamp":
                if (wanted > high) == (increment > 0.0):
                    integral -= increment
            elif dt > 0.0 and self.ki:
                # Exact over the step, so that a short time constant cannot overshoot.
                integral += (output - wanted) * (1.0 - math.exp(-dt / self._tracking()))
        self._integral, self._error, self._measured = integral, error, measurement
        self.output = output
        return output

    def _tracking(self) -> float:
        if self.tracking_s is not None:
            return self.tracking_s
        return max(abs(math.sqrt(abs(self.kd / self.ki)) if self.kd else self.kp / self.ki), 1e-6)


class PIDController(Controller):
    """A PID from one state to another, at a rate.

    `goal` is a state too, where the set-point moves; else `pid.setpoint` is it. While the measured state is unknown it gives
    nothing, and begins anew when it is back.
    """

    def __init__(
        self, name: str, pid: PID, *, measured: str, output: str, rate_hz: float, goal: str | None = None
    ) -> None:
        super().__init__(name, rate_hz=rate_hz, states=[measured, *([goal] if goal else [])], writes=[output])
        self.pid, self.measured, self.output, self.goal = pid, measured, output, goal
        self._y: StateLike | None = None
        self._r: StateLike | None = None
        self._last: int | None = None

    def bind(self, states: Mapping[str, StateLike]) -> None:
        """Take the states it reads."""
        super().bind(states)
        self._y = self.bound[self.measured]
        self._r = self.bound[self.goal] if self.goal else None

    def start(self, now: int) -> None:
        """Begin a run with an empty integral."""
        super().start(now)
        self.pid.reset()
        self._last = None

    def step(self, now_ns: int) -> Mapping[str, float]:
        """Return the output of this cycle."""
        y = known_value(self._y)
        if y is None:
            if self._last is not None:
                self.pid.reset()
                self._last = None
            return NOTHING
        if self._r is not None:
            r = known_value(self._r)
            if r is None:
                return NOTHING
            self.pid.setpoint = r
        dt = 1.0 / self.rate_hz if self._last is None else (now_ns - self._last) / 1e9
        self._last = now_ns
        return {self.output: self.pid.update(y, dt)}
