"""How a simulated servo turns: its shaft in counts, driven by a motor of `joint_model`.

1. The same goals at the same instants give the same motion; asking changes nothing.
2. Positions are counts of the servo, as fractions, and speeds counts a second; the motor behind them is in rad.

To a goal it turns at its speed limit and with its acceleration, or it turns on at a speed; stiffness and damping hold it on
its way. Sizes of motors are choices: sheets say how fast a servo turns and what it holds at most, and nothing of dynamics.
"""

from __future__ import annotations

import math

from aces_bus.device import Twin
from aces_bus.device.single_motor import JointScale

from ..joint_model import AMBIENT, MotorJoint, MotorModel, PacedGoal

#: A motor that does not turn this fast (rad/s) and has this share of its current does not turn what it should. Choices.
STILL, PUSHING = 0.02, 0.5
#: What a servo's gear takes of the full duty at its greatest speed, as viscous friction. A choice.
DRAG = 0.35
#: Stiffness and damping of the loop that holds a speed, as shares of what the motor has by itself: well damped. A choice.
TURNING = (2.25, 5.0)


class ServoShaft:
    """One servo's shaft. After a change of anything, call `apply`.

    `motor` is the motor at the joint, whose angle is `scale`'s; `stiffness` (share of the full duty for a rad of the joint)
    and `damping` (s/rad) hold it.
    """

    def __init__(
        self, twin: Twin, model: MotorModel, scale: JointScale, at: float, *, stiffness: float, damping: float
    ) -> None:
        now, joint = twin.clock.now(), twin.joints[0] if twin.joints else None
        self.scale = scale
        self.motor = MotorJoint(model.behind(scale.ratio), now, position=scale.angle(at))
        if joint is not None:
            self.motor.join(twin.world, joint.name)
        self.goal = at
        self.is_driven = self.is_jammed = False
        #: The greatest speed on the way to a goal (counts/s), and the acceleration (counts/s²).
        self.limit, self.acceleration = 0.0, math.inf
        #: The speed that it turns with, without a goal (counts/s); None: it goes to its goal.
        self.speed: float | None = None
        #: What it is driven with instead: a share of the full duty, or a share of the stall current.
        self.duty: float | None = None
        self.current: float | None = None
        #: The greatest share of the full duty on the way to a goal.
        self.strength = 1.0
        self.stiffness, self.damping = stiffness, damping

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
        motor, scale = self.motor, self.scale
        motor.sync(now)
        if motor.jammed is not self.is_jammed:
            motor.jammed = self.is_jammed
            motor.v = 0.0 if self.is_jammed else motor.v
        if not self.is_driven:
            motor.free(now)
        elif self.duty is not None:
            motor.drive(now, scale.direction * self.duty)
        elif self.current is not None:
            motor.push(now, scale.direction * self.current * motor.motor.stall_current)
        else:
            motor.obey(now, self._law())

    def _law(self) -> PacedGoal:
        motor, scale, old = self.motor, self.scale, self.motor.law
        if motor.mode != "law" or not isinstance(old, PacedGoal):
            old = None
        model, turns = motor.motor, self.speed is not None
        return PacedGoal(
            goal=motor.q if old is None else old.goal,
            target=None if self.speed is not None else scale.angle(self.goal),
            pace=abs(scale.speed(self.limit)) if self.speed is None else scale.speed(self.speed),
            acceleration=abs(scale.speed(self.acceleration)),
            rate=0.0 if old is None or (turns and not self.speed) else old.rate,
            stiffness=TURNING[0] / (model.time_constant * model.speed) if turns else self.stiffness,
            damping=TURNING[1] / model.speed if turns else self.damping,
            ahead=model.ahead,
            limit=self.strength,
        )

    def position(self, now: int) -> float:
        """Return where it is (counts)."""
        self.motor.sync(now)
        return self.at

    def speed_at(self, now: int) -> float:
        """Return how fast it turns (counts/s)."""
        self.motor.sync(now)
        return self.scale.raw_speed(self.motor.v)

    @property
    def drive(self) -> float:
        """The share of the full duty that it is driven with, −1…1, positive towards higher counts."""
        return self.scale.direction * self.motor.duty if self.is_driven else 0.0

    @property
    def load(self) -> float:
        """The winding's current as a share of its stall current, positive towards higher counts."""
        motor = self.motor
        return self.scale.direction * motor.current / motor.motor.stall_current if self.is_driven else 0.0

    @property
    def pushes(self) -> bool:
        """True if it is driven against something that does not give way."""
        return abs(self.motor.v) < STILL and abs(self.load) >= PUSHING * min(1.0, self.strength)

    @property
    def warming(self) -> float:
        """The rise of its temperature above the surroundings' (°C)."""
        return self.motor.temperature - AMBIENT
