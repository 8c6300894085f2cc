"""What motors of MIT's law have in common: torque = kp × (position error) + kd × (velocity error) + torque.

1. Their numbers span ranges, of the model or in the motor: nothing is believed or set before they are known (`know`).
2. Without stiffness and damping nothing holds: both are the joint's `gains`, and 0 where its file has none.
3. Set-points are held to the ranges and to the joint's limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import ClassVar

from aces_bus.device import SingleMotor
from aces_bus.device.signals import Signal

#: The greatest position (rad), velocity (rad/s), torque (N·m), stiffness (N·m/rad) and damping (N·m·s/rad) that can be said.
Ranges = tuple[float, float, float, float, float]
NAMES = ("position", "velocity", "torque", "kp", "kd")


class MitMotor(SingleMotor):
    """A motor with the messages `Command` and `Feedback`, which have MIT's fields; its mode of MIT's law is `mit_mode`.

    `also_from`: messages beside `Feedback` from which the driver itself updates a signal.

    `spec_ranges`: what the spec's numbers are at full scale, 1 where it has shares.
    """

    mit_mode = "mit"
    also_from: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    def declare_mit(
        self, spec_ranges: Ranges, ranges: Ranges | None, stale_s: Mapping[str, float] | None = None
    ) -> None:
        """Add the joint's signals, after `declare`; `stale_s` for signals that are asked for less often than others."""
        self.spec_ranges = spec_ranges
        #: Of this motor; None: not known yet.
        self.ranges: Ranges | None = None
        gains = self.joint.gains if self.joint is not None else None
        #: Stiffness and damping where none were set, at the joint.
        self.usual = {"kp": (gains and gains.kp) or 0.0, "kd": (gains and gains.kd) or 0.0}
        scale = self.scale
        signals: tuple[tuple[str, Callable[[float], float], Callable[[float], float], str], ...] = (
            ("rad", scale.angle, scale.raw_angle, "where the joint is"),
            ("rad/s", scale.speed, scale.raw_speed, "how fast it turns; set: what damping aims at"),
            ("N·m", scale.torque, scale.raw_torque, "torque; set: what is added to stiffness and damping"),
            ("N·m/rad", scale.gain, scale.raw_gain, "stiffness"),
            ("N·m·s/rad", scale.gain, scale.raw_gain, "damping"),
        )
        for index, (unit, to_si, from_si, doc) in enumerate(signals):
            self.add_motor_signal(
                NAMES[index], unit=unit, of=f"Feedback.{NAMES[index]}" if index < 3 else None,
                to_si=partial(self._measured, index, to_si), from_si=partial(self._wanted, index, from_si),
                read_from=self.also_from.get(NAMES[index], ()), stale_s=(stale_s or {}).get(NAMES[index]), doc=doc,
                source="MIT frame",
            )  # fmt: skip
        if ranges is not None:
            self.know(ranges)

    def _measured(self, index: int, to_si: Callable[[float], float], value: float) -> float | None:
        if self.ranges is None:
            return None  # as a share it says nothing
        return to_si(value * self.ranges[index] / self.spec_ranges[index])

    def _wanted(self, index: int, from_si: Callable[[float], float], value: float) -> float:
        raw = from_si(float(value))
        if self.mode != self.mit_mode or self.ranges is None:
            return raw
        most = self.spec_ranges[index]
        return max(-most, min(most, raw / self.ranges[index] * most))

    def of_joint(self, name: str) -> Signal:
        """Return a signal of the joint."""
        return self.signals[f"{self.owner}.{name}"]

    def know(self, ranges: Ranges) -> None:
        """Set the motor's ranges: limit signals to values that a frame can carry, within the joint's limits."""
        self.ranges = ranges
        joint, scale = self.joint, self.scale
        low, high = sorted((scale.angle(-ranges[0]), scale.angle(ranges[0])))
        fast, strong = abs(scale.speed(ranges[1])), abs(scale.torque(ranges[2]))
        if joint is not None:
            low = low if joint.lower is None else max(low, joint.lower)
            high = high if joint.upper is None else min(high, joint.upper)
            fast = min(fast, joint.max_speed or fast)
        limits = (
            (low, high),
            (-fast, fast),
            (-strong, strong),
            (0.0, scale.gain(ranges[3])),
            (0.0, scale.gain(ranges[4])),
        )
        for name, (lower, upper) in zip(NAMES, limits, strict=True):
            signal = self.of_joint(name)
            signal.lower, signal.upper = lower, upper
        self.epoch += 1

    def stay(self) -> None:
        """Hold the present position with the stiffness and damping of the file; no velocity, no torque."""
        here = self.of_joint("position").last
        for name, path in self.modes[self.mode].items():
            message, _, field = path.partition(".")
            value = self.usual.get(name, here if name == "position" else 0.0)
            self.want(message, field, self.raw_of(name, value))

    @property
    def lets_go(self) -> str:
        """As every motor; one without stiffness gives way, whoever watches."""
        return super().lets_go or ("has no stiffness, and gives way" if self._is_soft else "")

    @property
    def _is_soft(self) -> bool:
        return self.mode == self.mit_mode and not self._given.get("Command", {}).get("kp")

    def is_followed(self, signal: Signal) -> bool:
        """Return False while it has no stiffness: then it gives way on purpose."""
        return not self._is_soft and super().is_followed(signal)
