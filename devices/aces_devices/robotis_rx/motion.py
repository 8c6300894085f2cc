"""How a simulated servo turns: a motor of `joint_model`, driven along the vendor's compliance curve.

1. The same goals at the same instants give the same motion; asking changes nothing.
2. Angles are counts of 300°/1023, as fractions; counter-clockwise is positive.

The drive is the punch plus (distance − margin) ÷ slope, at most the torque limit; the wanted speed is the drive's share
of the greatest speed, at most the speed that was set. So it runs at a constant speed, slows down exponentially within the
slope, and ends near the margin, where it is not driven: what pushes it then moves it, until the curve pushes back. The
vendor's manual draws the curve and says nothing of dynamics: sizes of the motor are choices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from aces_bus.device import Twin
from aces_bus.device.single_motor import JointScale
from aces_protocols.robotis.control_table import ANGLE, SPEED

from ..joint_model import AMBIENT, MotorJoint, MotorModel
from ..servos.motion import DRAG

TOP = 1023
#: Counts a second at one count of moving speed: 0.111 rpm.
PER_SPEED = SPEED * 6 / ANGLE
#: The greatest speed (counts of moving speed): 60 rpm, an RX-28 at 12 V about. A choice of this model.
FREE = 540
#: A whole turn, in counts.
TURN = 360 / ANGLE
#: It rests a count before the margin: a recorded servo rests 2 counts from its goal, at a margin of 1 and no load.
REST = 1
#: What rounding leaves of a count.
HAIR = 1e-9


#: An RX-28 at 12 V about: A blocked, N·m/A; how much more than its speed's duty holds the speed that is wanted. Choices.
STALL_A, TORQUE_CONSTANT, HOLD = 1.9, 1.5, 8.0


@dataclass
class ComplianceLaw:
    """The controller: `goal` (counts), and as registers have them: moving speed (0: none set), torque limit, punch,
    compliance by direction (cw, ccw).
    """

    scale: JointScale
    goal: float = 512.0
    speed: int = 0
    limit: int = TOP
    punch: int = 32
    margin: tuple[int, int] = (0, 0)
    slope: tuple[int, int] = (32, 32)
    #: Nothing of it hangs on time.
    is_steady = True

    def __call__(self, q: float, v: float) -> float:
        """Return the duty at the joint's position and velocity (rad, rad/s)."""
        scale, most = self.scale, self.limit / TOP
        gap = self.goal - scale.raw_angle(q)
        free = FREE * PER_SPEED
        top = min(free * most, self.speed * PER_SPEED) if self.speed else free * most
        wanted = math.copysign(min(self.drive(gap) * free, top), gap)
        duty = (wanted + HOLD * (wanted - scale.raw_speed(v))) / free
        return scale.direction * max(-most, min(most, duty))

    def rest(self, gap: float) -> int:
        """Return the distance (counts) from which on nothing is done, on the side of a signed one."""
        return self.margin[gap > 0] + REST

    def drive(self, gap: float) -> float:
        """Return the share of the torque at a signed distance (counts)."""
        over = abs(gap) - self.margin[gap > 0]
        return (
            0.0
            if over <= REST + HAIR
            else min(self.limit / TOP, self.punch / TOP + over / STEPS[self.slope[gap > 0]])
        )


class ShaftMotion:
    """One servo's shaft. After a change of anything, call `apply`."""

    def __init__(self, twin: Twin, scale: JointScale, at: float) -> None:
        joint = twin.joints[0] if twin.joints else None
        model = MotorModel(
            speed=FREE * PER_SPEED * math.radians(ANGLE) * (1.0 + DRAG),
            stall_current=STALL_A,
            friction=0.008,
            heating=0.2,
            cooling=120.0,
            torque_constant=TORQUE_CONSTANT,
            drag=DRAG,
        )
        self.motor = MotorJoint(model.behind(scale.ratio), twin.clock.now(), position=scale.angle(at))
        if joint is not None:
            self.motor.join(twin.world, joint.name)
        self.scale, self.law = scale, ComplianceLaw(scale)
        self.is_driven = self.is_jammed = False
        #: Endless turn: share of the torque, counter-clockwise positive; None: it goes to its goal.
        self.duty: float | None = None

    @property
    def at(self) -> float:
        """The shaft's position (counts)."""
        return self.scale.raw_angle(self.motor.q)

    @at.setter
    def at(self, count: float) -> None:
        self.motor.place(self.motor.at, self.scale.angle(count))

    def settle(self, now: int) -> None:
        """Catch up to `now` (ns)."""
        self.motor.sync(now)

    def apply(self, now: int) -> None:
        """Have the motor do what is set."""
        motor = self.motor
        motor.sync(now)
        if motor.jammed is not self.is_jammed:
            motor.jammed = self.is_jammed
            motor.v = 0.0 if self.is_jammed else motor.v
        if not self.is_driven:
            motor.free(now)
        elif self.duty is not None:
            most = self.law.limit / TOP
            motor.drive(now, self.scale.direction * max(-most, min(most, self.duty)))
        else:
            motor.obey(now, self.law)

    def position(self, now: int) -> float:
        """Return the position (counts); in endless turn it wraps at a whole turn."""
        self.motor.sync(now)
        return self.at if self.duty is None else self.at % TURN

    def speed_at(self, now: int) -> float:
        """Return how fast it turns (counts a second)."""
        self.motor.sync(now)
        return self.scale.raw_speed(self.motor.v)

    def drive_at(self, now: int) -> float:
        """Return the share of the torque that it turns, or holds, with; counter-clockwise positive."""
        self.motor.sync(now)
        return self.scale.direction * self.motor.duty if self.is_driven else 0.0

    def is_moving(self, now: int) -> bool:
        """Return whether it is on its way to its goal, or would be if nothing held it."""
        if not self.is_driven or self.law.limit == 0:
            return False
        if self.duty is not None:
            return bool(self.duty)
        gap = self.law.goal - self.position(now)
        return abs(gap) > self.law.rest(gap) + HAIR

    @property
    def pushes(self) -> bool:
        """True if it is driven, with all that it may, and something does not give way."""
        most = self.law.limit / TOP
        return (
            self.is_driven and bool(most) and abs(self.motor.v) < 0.02 and abs(self.motor.duty) >= 0.5 * most
        )

    @property
    def warming(self) -> float:
        """The rise of its temperature above the surroundings' (°C)."""
        return self.motor.temperature - AMBIENT


def _step(slope: int) -> int:
    return max((step for step in (4, 8, 16, 32, 64, 128, 254) if step <= slope), default=4)


#: What a compliance slope acts as: 4, 8, 16, 32, 64, 128 or 254 (RX-28 manual).
STEPS = tuple(_step(slope) for slope in range(256))
