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

Gains are given as stiffness (duty per rad) and damping (duty per rad/s); `servo_gains` makes them from a bandwidth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from aces_bus.device import Twin

#: The step of the controller (ns, s).
STEP_NS = 1_000_000
STEP = 1e-3
#: What surrounds the motors (°C).
AMBIENT = 25.0


@dataclass(frozen=True)
class MotorModel:
    """A motor with its gear, on the joint's side.

    `speed`: without load at full duty (rad/s); `time_constant`: of that speed (s); `stall_current`: at full duty, blocked
    (A); `friction`: the share of the full duty that Coulomb friction takes; `heating`: °C/s for each A²; `cooling`: s;
    `torque_constant`: N·m/A.
    """

    speed: float = 6.0
    time_constant: float = 0.035
    stall_current: float = 8.0
    friction: float = 0.01
    heating: float = 0.05
    cooling: float = 300.0
    torque_constant: float = 1.0

    @classmethod
    def of_ratio(cls, ratio: float, *, speed: float = 1600.0, stall_current: float = 8.0) -> MotorModel:
        """Return the same motor behind another gear: `ratio` motor turns a turn of the joint, `speed` the motor's own
        (rad/s).
        """
        return cls(speed=speed / max(1.0, ratio), stall_current=stall_current)


def servo_gains(motor: MotorModel, bandwidth: float = 80.0) -> tuple[float, float]:
    """Return stiffness (1/rad) and damping (s/rad) of a critically damped position loop with this bandwidth (rad/s)."""
    tau, speed = motor.time_constant, motor.speed
    return bandwidth**2 * tau / speed, max(0.0, 2 * bandwidth * tau - 1) / speed


class MotorJoint:
    """One joint and its motor. `lower` and `upper` are its mechanical stops (rad).

    What drives it is set by `free`, `drive`, `push`, `follow` and `impede`; `sync` catches up. `jammed` blocks
    it where it is.
    """

    __slots__ = (
        "_constants",
        "at",
        "current_wanted",
        "damping",
        "duty",
        "goal",
        "impedance",
        "jammed",
        "lower",
        "mode",
        "motor",
        "moved_at",
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
        self.temperature = AMBIENT
        #: The last whole millisecond that has been caught up (ns).
        self.at = now - now % STEP_NS
        #: When it last moved; since when the duty has been at its limit, −1 when it is not.
        self.moved_at = self.at
        self.saturated_since = -1
        decay, stall = math.exp(-STEP / motor.time_constant), motor.stall_current
        #: What a step of the motor needs: decay and reach of its speed, friction, speed, stall current and torque, heating.
        self._constants = (
            decay,
            motor.time_constant * (1 - decay),
            motor.friction * motor.speed,
            motor.speed,
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

    def place(self, now: int, position: float) -> None:
        """Put it somewhere, at rest: what a kinematic movement of 1 kHz does."""
        self.sync(now)
        if not self.jammed:
            new = min(max(position, self.lower), self.upper)
            if new != self.q:
                self.moved_at = self.at
            self.q = new
        self.v = 0.0

    # ------------------------------------------------------------------ what is known of it

    def position(self, now: int) -> float:
        """Return where it is (rad)."""
        self.sync(now)
        return self.q

    @property
    def current(self) -> float:
        """The winding's current (A), signed."""
        motor = self.motor
        return motor.stall_current * (self.duty - self.v / motor.speed)

    @property
    def torque(self) -> float:
        """The motor's torque (N·m), signed."""
        return self.motor.torque_constant * self.current

    def sync(self, now: int) -> None:
        """Catch up to `now` (ns)."""
        if now < self.at + STEP_NS:
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
        """Simulate `ms` milliseconds."""
        q, v = self.q, self.v
        decay, reach, friction, speed, stall, most, heating, cooling = self._constants
        stiffness, damping, goal = self.stiffness, self.damping, self.goal
        lower, upper = self.lower, self.upper
        mode, jammed = self.mode, self.jammed
        wanted, kp, kd, torque = self.impedance
        duty, temperature = self.duty, self.temperature
        at, moved_at, saturated = self.at, self.moved_at, self.saturated_since
        for number in range(steps):
            at += STEP_NS
            if mode == "position":
                duty = stiffness * (goal - q) - damping * v
            elif mode == "current":
                duty = self.current_wanted / stall + v / speed
            elif mode == "impedance":
                duty = (kp * (goal - q) + kd * (wanted - v) + torque) / most + v / speed
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
            end = speed * duty
            if v > 0.0 or (v == 0.0 and end > friction):
                end -= friction
            elif v < 0.0 or end < -friction:
                end += friction
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
        world.joints[name] = found
    found.free(now)
    return found
