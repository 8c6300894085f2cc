"""The twin of the control PC, motor by motor: it turns to its set-point at a steady speed.

1. Datagrams with a bad check are dropped; each twin counts those of its network.
2. The PC answers nothing, and so does this.
"""

from __future__ import annotations

from math import radians
from typing import ClassVar

from aces_bus.device import Twin, on
from aces_bus.protocol import Record

#: How fast a joint turns (rad/s) whose file says nothing: a choice.
SPEED = 1.0


class MotorTwin(Twin):
    """A motor: `angle` is where the PC was asked to turn it (°), `position(now)` where its joint is (rad)."""

    protocol = "hubovia"
    faults: ClassVar = {"stuck": "does not turn"}

    def setup(self) -> None:
        """Stand at zero until the first angle; a PC that was switched off leaves the motor where it is."""
        now = self.clock.now()
        joint = self.joints[0] if self.joints else None
        self._direction = joint.direction if joint is not None else 1
        self._zero = (joint.zero or 0.0) if joint is not None else 0.0
        self._speed = (joint.nominal_speed or SPEED) if joint is not None else SPEED
        if "_at" not in self.__dict__:
            self._at, self._motor = now, self._zero
            if joint is not None:
                self._motor += self._direction * self.world.start_of(joint.name)
                self.world.joints[joint.name] = self
        self._goal = self._sync(now) if self.__dict__.get("_goal") is not None else self._motor
        #: The last angle that was received (°), None before.
        self.angle: float | None = None

    def _sync(self, now: int) -> float:
        """Return where the motor is (rad, of its own)."""
        passed = (now - self._at) / 1e9
        self._at = max(self._at, now)
        if passed > 0 and "stuck" not in self.active_faults:
            reach = self._speed * passed
            left = self._goal - self._motor
            self._motor = self._goal if abs(left) <= reach else self._motor + (reach if left > 0 else -reach)
        return self._motor

    def position(self, now: int) -> float:
        """Return where the joint is (rad)."""
        return self._direction * (self._sync(now) - self._zero)

    @property
    def bad_checks(self) -> int:
        """Number of bytes that began a datagram whose check failed."""
        return self.twins.scanner.counts.reasons.get("malformed: checksum", 0)

    @on("Joint")
    def turn(self, request: Record) -> None:
        """Turn to an angle."""
        now = self.clock.now()
        self._sync(now)
        wanted = request.angle
        size = wanted.degrees + wanted.hundredths
        angle = -size if wanted.negative else size
        self.angle, self._goal = angle, radians(angle)

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """See `Twin.fault`."""
        self._sync(self.clock.now())
        super().fault(name, amount, on=on)
