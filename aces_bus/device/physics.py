"""A body outside of the twins: what motors move when joints hang together, have weight, and touch the ground.

1. `Physics` is what a simulator offers: torques in; positions, velocities and contacts out; a step is a millisecond.
2. `MovedBody` is its one clock: asking one motor for its state advances all motors and the body to that instant.
   Nothing is computed before it is asked for, and who asks changes nothing: the same seed is the same run.
3. Where the body can say it (`FeelingPhysics`), twins of inertial and force sensors read the motion of their part and what
   acts on it.
4. SI, by the names and directions of the robot's file: rad, rad/s, N·m (m, m/s, N for joints that slide).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

from ..errors import CallerError

#: The step of body and motors (ns).
STEP_NS = 1_000_000


class Contact(NamedTuple):
    """Two parts that touch, by the simulator's names, and the force between them along the contact's normal (N)."""

    parts: tuple[str, str]
    force: float


class PartMotion(NamedTuple):
    """Attitude and motion of a part of a body, as an inertial sensor on it measures them.

    `roll`, `pitch`, `yaw` (rad) turn it about the world's x, y and z axis, in this order. `rates` (rad/s) and `acceleration`
    (m/s²: 9.81 upwards where it rests) are along its own axes.
    """

    roll: float
    pitch: float
    yaw: float
    rates: tuple[float, ...]
    acceleration: tuple[float, ...]


class PartWrench(NamedTuple):
    """Force (N) and torque (N·m) between a part and the part that carries it, along its own axes.

    They come from contacts, weight and inertia.
    """

    force: tuple[float, ...]
    torque: tuple[float, ...]


#: A vector, and a part's axes as columns of a matrix.
Three = Sequence[float]
Axes = Sequence[Sequence[float]]


class FeelingPhysics(Protocol):
    """A `Physics` whose parts sensors can feel. A part has the name of the sensor in the robot's file."""

    def motion_of(self, part: str) -> tuple[Axes, Three, Three] | None:
        """Return a part's axes in the world, its rates (rad/s) and its acceleration, as `PartMotion`; None: no such part."""
        ...

    def wrench_on(self, part: str) -> tuple[Three, Three] | None:
        """Return force (N) and torque (N·m) as `PartWrench` has them; None: there is no such part."""
        ...


class Physics(Protocol):
    """A simulated body, whose joints are numbered in the order of `joints`; other joints of the robot move by themselves."""

    @property
    def joints(self) -> Sequence[str]:
        """Names of its joints, as the robot's file has them."""
        ...

    @property
    def positions(self) -> Sequence[float]:
        """The joints' positions (rad)."""
        ...

    @property
    def velocities(self) -> Sequence[float]:
        """The joints' velocities (rad/s)."""
        ...

    @property
    def contacts(self) -> Sequence[Contact]:
        """The present contacts."""
        ...

    def fit(self, joint: int, inertia: float, friction: float) -> None:
        """Put a motor at a joint: the inertia of its rotor at the joint (kg·m²) and its dry friction (N·m)."""
        ...

    def place(self, joint: int, position: float) -> None:
        """Put a joint somewhere (rad), at rest."""
        ...

    def step(self, torques: Sequence[float]) -> None:
        """Live for a millisecond with these torques of the motors (N·m), one for each joint."""
        ...


class BodyMotor(Protocol):
    """A motor at a joint of a body."""

    def pull(self, at: int) -> float:
        """Return its torque (N·m) for the millisecond that ends at `at` (ns)."""
        ...

    def moved(self, position: float, velocity: float) -> float | None:
        """Take where the millisecond has led the joint (rad, rad/s); return where a blocked joint stays instead."""
        ...


class MovedBody:
    """A body and the motors that move it, on one clock. `at` is the last instant that was lived up to (ns)."""

    def __init__(self, physics: Physics, now: int) -> None:
        self.physics = physics
        self.at = now - now % STEP_NS
        self._numbers = {name: number for number, name in enumerate(physics.joints)}
        if len(self._numbers) != len(physics.joints):
            raise CallerError(f"physics with a joint twice: {', '.join(physics.joints)}")
        self._motors: dict[int, BodyMotor] = {}
        self._torques = [0.0] * len(self._numbers)

    def position_of(self, joint: str) -> float | None:
        """Return where the body has a joint (rad); None: it has no such joint."""
        number = self._numbers.get(joint)
        return None if number is None else float(self.physics.positions[number])

    def motion_of(self, part: str, now: int) -> PartMotion | None:
        """Return how a part moves at `now` (ns); None: the physics has no such part, or no `FeelingPhysics`."""
        self.advance(now)
        feel: Callable[[str], tuple[Axes, Three, Three] | None] | None
        feel = getattr(self.physics, "motion_of", None)
        found = None if feel is None else feel(part)
        if found is None:
            return None
        ((xx, _, _), (yx, _, _), (zx, zy, zz)), rates, acceleration = found
        pitch = math.asin(max(-1.0, min(1.0, -zx)))
        return PartMotion(math.atan2(zy, zz), pitch, math.atan2(yx, xx), tuple(rates), tuple(acceleration))

    def wrench_on(self, part: str, now: int) -> PartWrench | None:
        """Return what acts on a part at `now` (ns); None as of `motion_of`."""
        self.advance(now)
        feel: Callable[[str], tuple[Three, Three] | None] | None
        feel = getattr(self.physics, "wrench_on", None)
        found = None if feel is None else feel(part)
        return None if found is None else PartWrench(tuple(found[0]), tuple(found[1]))

    def add(self, joint: str, motor: BodyMotor, *, inertia: float, friction: float) -> bool:
        """Have a motor move a joint; return False where the body has no such joint."""
        number = self._numbers.get(joint)
        if number is None:
            return False
        if number not in self._motors:
            self.physics.fit(number, inertia, friction)
        self._motors[number] = motor
        return True

    def place(self, joint: str, position: float) -> None:
        """Put a joint somewhere (rad), at rest."""
        self.physics.place(self._numbers[joint], position)

    def advance(self, now: int) -> None:
        """Let body and motors live up to `now` (ns)."""
        physics, torques, motors = self.physics, self._torques, self._motors
        while self.at + STEP_NS <= now:
            self.at += STEP_NS
            for number, motor in motors.items():
                torques[number] = motor.pull(self.at)
            physics.step(torques)
            positions, velocities = physics.positions, physics.velocities
            for number, motor in motors.items():
                held = motor.moved(positions[number], velocities[number])
                if held is not None:
                    physics.place(number, held)
