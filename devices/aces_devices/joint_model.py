"""A simulated joint: a geared DC motor with friction, heat and stops, driven by a digital controller of 1 kHz.

1. Exact between two steps: the duty is constant for a millisecond, and the first-order motor is solved for it, not stepped.
2. Lazy: nothing is computed until it is asked for; then all whole milliseconds since are caught up. Who asks, and how often,
   changes nothing. A joint at rest costs one comparison.
3. SI, on the joint's side of the gear: rad, rad/s, A, °C; the duty is −1…1.

Motor: J v' = n kt i − b v − friction; i = (V u − n kt v) / R; the winding's inductance is left out (its time constant is far
below a millisecond). So v' = (v∞ − v) / τ with v∞ = speed · u ∓ friction: what `Motor` holds. Velocity that would change
its sign within a step stops there; whether it starts again is decided in the next one. Heat: one body, i²R against a
surrounding of 25 °C.

What is driven by torque (`impede`: MIT's law, stiffness and damping in N·m) has the torque constant of `Motor`, and no more
torque than the full duty gives.

A controller of its own kind is a `DutyLaw`: the duty of the next millisecond from position and velocity. `PacedGoal` is the
usual one: a goal that moves no faster than it may, and stiffness and damping about it.

Gains are given as stiffness (duty per rad) and damping (duty per rad/s); `servo_gains` makes them from a bandwidth.

In a body from outside (`join`) the motor gives its torque, and the body says where the joint is (`aces_bus.device.physics`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

from aces_bus.device import Twin
from aces_bus.device.physics import MovedBody
from aces_bus.device.twin import World

#: The step of the controller (ns, s).
STEP_NS = 1_000_000
STEP = 1e-3
#: What surrounds the motors (°C).
AMBIENT = 25.0
#: In a body: a movement that is led does not wait for a joint that is farther behind than this (rad), for it is blocked.
BEHIND = 0.15


#: Torque for each ampere of a motor behind `MotorModel.of_ratio`'s gears, at the motor (N·m/A). A choice.
TORQUE_A = 0.05


@dataclass(frozen=True)
class MotorModel:
    """A motor with its gear, on the joint's side.

    `speed`: without load and drag at full duty (rad/s); `time_constant`: of that speed (s); `stall_current`: at full duty,
    blocked (A); `friction`: the share of the full duty that Coulomb friction takes; `drag`: the share that viscous friction
    would take at `speed`; `heating`: °C/s for each A²; `cooling`: s;
    `torque_constant`: N·m/A.
    """

    speed: float = 6.0
    time_constant: float = 0.035
    stall_current: float = 8.0
    friction: float = 0.01
    heating: float = 0.05
    cooling: float = 300.0
    torque_constant: float = 1.0
    drag: float = 0.0

    @classmethod
    def of_ratio(cls, ratio: float, *, speed: float = 1600.0, stall_current: float = 8.0) -> MotorModel:
        """Return the same motor behind another gear: `ratio` motor turns a turn of the joint, `speed` the motor's own
        (rad/s).
        """
        ratio = max(1.0, ratio)
        return cls(speed=speed / ratio, stall_current=stall_current, torque_constant=TORQUE_A * ratio)

    def behind(self, ratio: float) -> MotorModel:
        """Return the same motor and gear behind one more, of `ratio` turns a turn of the joint."""
        return replace(self, speed=self.speed / ratio, torque_constant=self.torque_constant * ratio)

    @property
    def ahead(self) -> float:
        """The duty that a speed takes (s/rad), but for dry friction."""
        return (1.0 + self.drag) / self.speed

    @property
    def stall_torque(self) -> float:
        """The torque at full duty, blocked (N·m)."""
        return self.stall_current * self.torque_constant

    @property
    def inertia(self) -> float:
        """The inertia that the motor has at the joint (kg·m²): that of its time constant."""
        return self.stall_torque * self.time_constant / self.speed


def servo_gains(motor: MotorModel, bandwidth: float = 80.0) -> tuple[float, float]:
    """Return stiffness (1/rad) and damping (s/rad) of a critically damped position loop with this bandwidth (rad/s)."""
    tau, speed = motor.time_constant, motor.speed
    return bandwidth**2 * tau / speed, max(0.0, 2 * bandwidth * tau - 1) / speed


class DutyLaw(Protocol):
    """A controller: what it does in a millisecond."""

    def __call__(self, q: float, v: float) -> float:
        """Return the duty for the next millisecond, at this position and velocity (rad, rad/s)."""
        ...

    @property
    def is_steady(self) -> bool:
        """True while the duty hangs on position and velocity alone."""
        ...


@dataclass(slots=True)
class PacedGoal:
    """A goal that moves, with stiffness (1/rad) and damping (s/rad) about it.

    It moves to `target` at up to `pace` (rad/s), which it reaches and leaves with `acceleration` (rad/s²); without a target
    it moves on at `pace`, whose sign is its direction. `feed` is added to the duty, and `ahead` (s/rad) for the goal's own
    speed; `limit` bounds it. `emf` (s/rad) makes up for the motor's own voltage: 1/speed where current is controlled, else
    0. A goal without a target does not run away from a joint that cannot follow.
    """

    goal: float
    target: float | None
    stiffness: float
    damping: float
    pace: float = math.inf
    acceleration: float = math.inf
    rate: float = 0.0
    feed: float = 0.0
    limit: float = math.inf
    ahead: float = 0.0
    emf: float = 0.0

    @property
    def is_steady(self) -> bool:
        """True at the target."""
        return self.rate == 0.0 and (self.goal == self.target or (self.target is None and self.pace == 0.0))

    def __call__(self, q: float, v: float) -> float:
        """See `DutyLaw`."""
        if self.target is None:
            self._turn(q)
        elif self.goal != self.target or self.rate:
            self._approach(self.target)
        rate = self.rate
        pull = self.stiffness * (self.goal - q) + self.damping * (rate - v) + self.ahead * rate + self.feed
        return max(-self.limit, min(self.limit, pull)) + v * self.emf

    def _turn(self, q: float) -> None:
        most = self.acceleration * STEP
        self.rate += max(-most, min(most, self.pace - self.rate))
        self.goal += self.rate * STEP
        reach = min(self.limit, 1.0) / self.stiffness if self.stiffness else math.inf
        self.goal = max(q - reach, min(q + reach, self.goal))

    def _approach(self, target: float) -> None:
        away = target - self.goal
        speed = self.pace
        if self.acceleration < math.inf:
            most = self.acceleration * STEP
            speed = min(speed, math.sqrt(2.0 * self.acceleration * abs(away)))
            self.rate += max(-most, min(most, math.copysign(speed, away) - self.rate))
            is_there = abs(away) <= max(abs(self.rate), most) * STEP and abs(self.rate) <= 2.0 * most
        else:
            is_there = abs(away) <= speed * STEP
            self.rate = math.copysign(speed, away)
        if is_there:
            self.goal, self.rate = target, 0.0
        else:
            self.goal += self.rate * STEP


class MotorJoint:
    """One joint and its motor. `lower` and `upper` are its mechanical stops (rad).

    What drives it is set by `free`, `drive`, `push`, `follow`, `impede` and `obey`; `sync` catches up. `jammed` blocks
    it where it is. `controller` is called in each millisecond of a body, with its instant: what `lead`s the joint.
    """

    __slots__ = (
        "_constants",
        "at",
        "body",
        "controller",
        "current_wanted",
        "damping",
        "duty",
        "goal",
        "impedance",
        "jammed",
        "law",
        "lower",
        "mode",
        "motor",
        "moved_at",
        "name",
        "q",
        "saturated_since",
        "stiffness",
        "temperature",
        "upper",
        "v",
    )

    def __init__(
        self,
        motor: MotorModel,
        now: int,
        *,
        position: float = 0.0,
        lower: float = -math.inf,
        upper: float = math.inf,
    ) -> None:
        self.motor = motor
        self.lower, self.upper = lower, upper
        self.q, self.v, self.duty = position, 0.0, 0.0
        self.mode = "free"
        self.goal = position
        self.current_wanted = 0.0
        #: Velocity (rad/s), stiffness (N·m/rad), damping (N·m·s/rad) and torque (N·m) that are wanted beside the goal.
        self.impedance = (0.0, 0.0, 0.0, 0.0)
        self.stiffness, self.damping = servo_gains(motor)
        self.jammed = False
        self.law: DutyLaw | None = None
        #: The body that it moves, and its joint's name there; None: it moves by itself.
        self.body: MovedBody | None = None
        self.name = ""
        self.controller: Callable[[int], None] | None = None
        self.temperature = AMBIENT
        #: The last whole millisecond that has been caught up (ns).
        self.at = now - now % STEP_NS
        #: When it last moved; since when the duty has been at its limit, −1 when it is not.
        self.moved_at = self.at
        self.saturated_since = -1
        slowing = 1.0 + motor.drag
        decay, stall = math.exp(-STEP * slowing / motor.time_constant), motor.stall_current
        #: What a step of the motor needs: decay and reach of its speed, friction, speed (also with drag), stall current and
        #: torque, heating.
        self._constants = (
            decay,
            motor.time_constant * (1 - decay) / slowing,
            motor.friction * motor.speed / slowing,
            motor.speed,
            motor.speed / slowing,
            stall,
            stall * motor.torque_constant,
            motor.heating * stall * stall,
            motor.cooling,
        )

    # ------------------------------------------------------------------ what drives it

    def free(self, now: int) -> None:
        """Take the duty away: it runs out and stays."""
        self.sync(now)
        self.mode, self.duty = "free", 0.0

    def drive(self, now: int, duty: float) -> None:
        """Drive with open-loop PWM, −1…1."""
        self.sync(now)
        self.mode, self.duty = "duty", max(-1.0, min(1.0, duty))

    def push(self, now: int, current: float) -> None:
        """Drive the motor with a current (A)."""
        self.sync(now)
        self.mode, self.current_wanted = "current", current

    def follow(self, now: int, goal: float) -> None:
        """Control the position to `goal` (rad)."""
        self.sync(now)
        self.mode, self.goal = "position", goal

    def impede(
        self, now: int, goal: float, velocity: float, stiffness: float, damping: float, torque: float
    ) -> None:
        """Control torque = stiffness × (goal − position) + damping × (velocity − its own) + torque, as MIT's
        motors do.
        """
        self.sync(now)
        self.mode, self.goal = "impedance", goal
        self.impedance = (velocity, stiffness, damping, torque)

    def obey(self, now: int, law: DutyLaw) -> None:
        """Have a controller of 1 kHz say the duty."""
        self.sync(now)
        self.mode, self.law = "law", law

    def place(self, now: int, position: float) -> None:
        """Put it somewhere, at rest."""
        self.sync(now)
        if not self.jammed:
            new = min(max(position, self.lower), self.upper)
            if new != self.q:
                self.moved_at = self.at
            self.q = new
            if self.body is not None:
                self.body.place(self.name, new)
        self.v = 0.0

    def lead(self, now: int, position: float) -> None:
        """Move it to the next place of a movement that is planned for each millisecond: it is there at once, or in a body
        it is pulled there, unless it is blocked far from it.
        """
        if self.body is None:
            self.place(now, position)
            return
        here = self.led
        if self.mode != "position" or abs(position - self.q) <= max(BEHIND, abs(here - self.q)):
            self.follow(now, position)

    @property
    def led(self) -> float:
        """The place that a movement by `lead` has come to (rad)."""
        return self.q if self.body is None or self.mode != "position" else self.goal

    # ------------------------------------------------------------------ in a body

    def join(self, world: World, name: str) -> None:
        """Have the world's body say where the joint of this name is, where it has one."""
        body, motor = world.body, self.motor
        friction = motor.friction * motor.stall_torque
        if body is not None and body.add(name, self, inertia=motor.inertia, friction=friction):
            self.body, self.name, self.at = body, name, body.at
            body.place(name, self.q)

    def pull(self, at: int) -> float:
        """Return the torque (N·m) for the millisecond that ends at `at`; what flows heats."""
        self.at = at
        if self.controller is not None:
            self.controller(at)
        duty = self._wanted()
        if -1.0 < duty < 1.0:
            self.saturated_since = -1
        else:
            duty = max(-1.0, min(1.0, duty))
            self.saturated_since = self.saturated_since if self.saturated_since >= 0 else at
        self.duty = duty
        motor = self.motor
        share = 0.0 if self.mode == "free" else duty - self.v / motor.speed
        heat = motor.heating * (motor.stall_current * share) ** 2
        self.temperature += (heat - (self.temperature - AMBIENT) / motor.cooling) * STEP
        return (share - motor.drag * self.v / motor.speed) * motor.stall_torque

    def _wanted(self) -> float:
        """Return the duty that is wanted now; what `_run` does in a loop."""
        q, v, speed = self.q, self.v, self.motor.speed
        match self.mode:
            case "position":
                return self.stiffness * (self.goal - q) - self.damping * v
            case "law" if self.law is not None:
                return self.law(q, v)
            case "current":
                return self.current_wanted / self.motor.stall_current + v / speed
            case "impedance":
                wanted, kp, kd, torque = self.impedance
                return (
                    kp * (self.goal - q) + kd * (wanted - v) + torque
                ) / self.motor.stall_torque + v / speed
            case "free":
                return v / speed
            case _:
                return self.duty

    def moved(self, position: float, velocity: float) -> float | None:
        """Take where the body has led the joint; a jammed one stays where it was."""
        if self.jammed:
            self.v = 0.0
            return self.q
        if position != self.q:
            self.moved_at = self.at
        self.q, self.v = position, velocity
        return None

    # ------------------------------------------------------------------ what is known of it

    def position(self, now: int) -> float:
        """Return where it is (rad)."""
        self.sync(now)
        return self.q

    @property
    def current(self) -> float:
        """The winding's current (A), signed; none where it is free."""
        motor = self.motor
        if self.mode == "free":
            return 0.0
        if self.mode == "current" and -1.0 < self.duty < 1.0:
            return self.current_wanted
        return motor.stall_current * (self.duty - self.v / motor.speed)

    @property
    def torque(self) -> float:
        """The motor's torque (N·m), signed."""
        return self.motor.torque_constant * self.current

    def sync(self, now: int) -> None:
        """Catch up to `now` (ns)."""
        if now < self.at + STEP_NS:
            return
        if self.body is not None:
            self.body.advance(now)
            return
        steps = (now - self.at) // STEP_NS
        mode = self.mode
        if self.v == 0.0 and (
            mode == "free"
            or (
                mode == "position"
                and not self.jammed
                and abs(self.stiffness * (self.goal - self.q)) <= self.motor.friction
            )
        ):
            self.duty = 0.0 if mode == "free" else self.stiffness * (self.goal - self.q)
            self.saturated_since = -1
            self._rest(steps * STEP)
        else:
            self._run(steps)
        self.at += steps * STEP_NS

    def _run(self, steps: int) -> None:
        """Simulate `steps` milliseconds."""
        q, v = self.q, self.v
        decay, reach, friction, speed, fastest, stall, most, heating, cooling = self._constants
        stiffness, damping, goal = self.stiffness, self.damping, self.goal
        lower, upper = self.lower, self.upper
        mode, jammed = self.mode, self.jammed
        wanted, kp, kd, torque = self.impedance
        duty, temperature, law = self.duty, self.temperature, self.law
        at, moved_at, saturated = self.at, self.moved_at, self.saturated_since
        for number in range(steps):
            at += STEP_NS
            if mode == "position":
                duty = stiffness * (goal - q) - damping * v
            elif mode == "current":
                duty = self.current_wanted / stall + v / speed
            elif mode == "impedance":
                duty = (kp * (goal - q) + kd * (wanted - v) + torque) / most + v / speed
            elif mode == "law" and law is not None:
                duty = law(q, v)
            if duty >= 1.0:
                duty = 1.0
                saturated = saturated if saturated >= 0 else at
            elif duty <= -1.0:
                duty = -1.0
                saturated = saturated if saturated >= 0 else at
            else:
                saturated = -1
            share = duty - v / speed
            temperature += (heating * share * share - (temperature - AMBIENT) / cooling) * STEP
            if jammed:
                v = 0.0
                continue
            end = fastest * duty
            if v > 0.0 or (v == 0.0 and end > friction):
                end -= friction
            elif v < 0.0 or end < -friction:
                end += friction
            elif mode == "law" and law is not None and not law.is_steady:
                continue
            else:
                # At rest, and nothing changes that before the next command.
                self.q, self.v, self.duty, self.temperature = q, v, duty, temperature
                self.moved_at, self.saturated_since = moved_at, saturated
                self._rest((steps - number - 1) * STEP)
                return
            gone = v - end
            w = end + gone * decay
            if v * w < 0.0:
                w = 0.0
            old = q
            q += end * STEP + gone * reach
            v = w
            if q >= upper:
                q = upper
                v = 0.0 if v > 0.0 else v
            elif q <= lower:
                q = lower
                v = 0.0 if v < 0.0 else v
            if q != old:
                moved_at = at
        self.q, self.v, self.duty, self.temperature = q, v, duty, temperature
        self.moved_at, self.saturated_since = moved_at, saturated

    def _rest(self, duration: float) -> None:
        """Pass a step in which nothing moves; what flows heats."""
        motor = self.motor
        current = motor.stall_current * self.duty
        if current == 0.0 and self.temperature == AMBIENT:
            return
        end = AMBIENT + motor.heating * motor.cooling * current * current
        self.temperature = end + (self.temperature - end) * math.exp(-duration / motor.cooling)


#: How a motor with a `MotorJoint` misbehaves; `jam` carries it out.
JAM = {"jam": "the motor does not turn, and pushes"}


def jam(twin: Twin, motor: MotorJoint) -> None:
    """Block the motor of a twin, or let it go, as its fault "jam" says."""
    motor.sync(twin.clock.now())
    motor.jammed = "jam" in twin.active_faults
    motor.v = 0.0 if motor.jammed else motor.v


def joint_of(twin: Twin, motor: MotorModel) -> MotorJoint:
    """Return the simulated joint of a twin that has one, by its joint's name (its own where it has none), and free.

    It is made when the twin is first powered; switched off and on, it is where it was.
    """
    now, world = twin.clock.now(), twin.world
    joint = twin.joints[0] if twin.joints else None
    name = joint.name if joint is not None else twin.name
    found = world.joints.get(name)
    if not isinstance(found, MotorJoint):
        found = MotorJoint(motor, now, position=world.start_of(name))
        found.join(world, name)
        world.joints[name] = found
    found.free(now)
    return found
