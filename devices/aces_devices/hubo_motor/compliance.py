"""Compliant motion: the host closes the position loop itself, softly, by duties (hubo-ach; D12, one and two channels).

1. Each encoder reply gives one duty of both channels; no reference is sent meanwhile.
2. Duty (0.1 %) = −(10 Kp (ref − pos) − 10 Kd vel + 10 pwm), limited to 10 maxPWM: the Kp term, the Kd term and the sum are
   each truncated toward zero, as hubo-ach does. Kp is in %/rad.
3. Back to rigid: reference = position, control on, then a filter of length 400 until |error| is at most 0.0075 rad.
"""

from __future__ import annotations

from typing import Any

from aces_bus.device import Job, Steps
from aces_bus.errors import CallerError

from .axis import ARRIVED, MotorAxis
from .storage import Storage

#: The filter's length on the way back to rigid (hubo-ach).
RIGID_FILTER = 400


def compliant_duty(
    error: float, velocity: float, kp: float, kd: float, max_pwm: float, pwm: float = 0.0
) -> int:
    """The duty in 0.1 %, as it goes out: `error` = reference − position (rad), `velocity` in rad/s.

    >>> compliant_duty(0.1, 0.0, 80, 0, 8)
    -80
    >>> compliant_duty(0.033, 0.0, 80, 0, 8)
    -26
    """
    effort = int(int(10 * kp * error) - int(10 * kd * velocity) + 10 * pwm)
    most = min(1000, int(10 * max_pwm))
    return -max(-most, min(most, effort))


class CompliantMode(Storage):
    """Compliant and rigid."""

    def set_compliance(self, on: bool = True) -> Job:
        """Let the joints of this board give way, around the positions they are set to; off: rigid again.

        Each joint needs `compliance` gains in the robot's file; the board must be enabled. Raises `CallerError` otherwise.
        """
        if self.dialect != "D12" or self.kind not in (1, 2) or self.set_message != "Reference":
            raise CallerError(f"{self.name} (kind {self.kind}, {self.dialect}) has no compliant motion")
        without = [a.name for a in self.axes if a.joint is not None and a.joint.compliance is None]
        if on and without:
            raise CallerError(f"{self.name}: {', '.join(without)} needs compliance = {{ kp, kd, max_pwm }}")
        return self.job("compliance", self._softening if on else self._stiffening)

    def _softening(self, job: Job) -> Steps:
        if not self.is_enabled:
            raise self.fail("enable it first")
        yield self.tell("SwitchingMode", mode="non_complementary")
        self.is_compliant = True
        self._filtering = False
        for axis in self.axes:
            if axis.goal is not None:  # a filter was on its way there
                axis.reference, axis.goal = round(axis.goal), None
        self.drop("Reference")

    def _stiffening(self, job: Job) -> Steps:
        if not self.is_compliant:
            return
        self.is_compliant = False
        self.drop("PwmFine")
        goals = {axis.channel: axis.reference for axis in self.axes}
        for axis in self.axes:
            if axis.joint is not None:
                self.give(axis, axis.count or 0)
                if axis.duty is not None:
                    axis.duty.update(0.0, self.clock.now())
        yield self.tick_ns()
        yield self.tell("SwitchingMode", mode="complementary")
        yield self.tell("ControlOn")
        length, self.filter_length = self.filter_length, RIGID_FILTER
        for axis in self.axes:
            goal = goals[axis.channel]
            if axis.joint is not None and goal is not None:
                axis.goal = float(goal)
                self._filtering = True
        while self._filtering and self.is_streaming:
            yield self.tick_ns()
            far = [axis for axis in self.axes if axis.goal is not None and not self._is_near(axis)]
            if not far:
                break
        self.filter_length = length
        for axis in self.axes:
            if axis.goal is not None and self.is_streaming:
                self.give(axis, round(axis.goal))

    @staticmethod
    def _is_near(axis: MotorAxis) -> bool:
        return axis.count is not None and abs((axis.goal or 0) - axis.count) * abs(axis.scale) <= ARRIVED

    def comply(self, instant: int) -> None:
        """One step: the duties of all channels from what the encoders just said."""
        given: list[tuple[str, Any]] = []
        for axis in self.axes:
            joint = axis.joint
            if joint is None or joint.compliance is None or axis.count is None or axis.reference is None:
                given.append((f"duty.{axis.channel}", 0))
                continue
            gains = joint.compliance
            velocity = axis.velocity.last if axis.velocity is not None else 0.0
            duty = compliant_duty(
                (axis.reference - axis.count) / axis.counts,
                axis.direction * (velocity or 0.0),
                gains.kp or 0.0,
                gains.kd or 0.0,
                gains.max_pwm or 0.0,
            )
            given.append((f"duty.{axis.channel}", duty / 10))
            if axis.duty is not None:
                axis.duty.update(-duty / 10 * axis.direction, instant)
        for path, value in given:
            self._paths.setdefault("PwmFine", {})[path] = None
            self.want_raw("PwmFine", path, value)
