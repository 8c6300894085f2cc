"""A simulated axis of a drive: its state machine, its modes, its motion, its limits and its faults.

1. Lazy: whole milliseconds are caught up on request; an axis at rest costs a comparison.
2. Motion is planned in counts, as the drive's objects are; the motor behind it is where other twins see it, in rad.
3. Objects are those of axis 0, whichever axis this is.

State machine: CiA 402 (ros2_canopen, canopen). What the standard leaves to makers is said in the README.
"""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, sqrt

from aces_bus.device.config import Joint

from ..joint_model import STEP, STEP_NS, MotorJoint, MotorModel
from .states import (
    AT_ONCE,
    FAILED,
    HALT,
    LIMITED,
    MODE_NAMES,
    REACHED,
    RELATIVE,
    REMOTE,
    START,
    TAKEN,
    VALUES,
    WARNING,
)
from .units import Units

#: Emergency codes: following error, over-voltage inside, device temperature, homing.
FOLLOWING, OVER_VOLTAGE, HOT, NO_HOME = 0x8611, 0x3210, 0x4210, 0xFF01
#: The heartbeat of a node that is watched is missing (CiA 301).
HOST_GONE = 0x8130
#: Bits of the error register 1001.
REGISTERS = {FOLLOWING: 0x21, OVER_VOLTAGE: 0x05, HOT: 0x09, NO_HOME: 0x81, HOST_GONE: 0x11}
#: A homing search that has found nothing for so long fails (ms).
SEARCH_MS = 10_000
POSITION_MODES = ("profile_position", "homing", "cyclic_position")
SPEED_MODES = ("velocity", "profile_velocity", "cyclic_velocity")
TORQUE_MODES = ("profile_torque", "cyclic_torque")


class AxisModel:
    """One axis. `objects` are its numbers by index (those of records: index << 8 | subindex); `send` sends an emergency."""

    def __init__(
        self,
        joint: Joint,
        units: Units,
        objects: dict[int, int],
        now: int,
        report: Callable[[int, int], None],
    ) -> None:
        self.joint, self.units, self.objects = joint, units, objects
        self._report = report
        lower = -1e9 if joint.lower is None else joint.lower - 0.2
        upper = 1e9 if joint.upper is None else joint.upper + 0.2
        self.motor = MotorJoint(MotorModel(), now, lower=lower, upper=upper)
        self.at = now - now % STEP_NS
        #: Counts that homing has shifted the encoder by.
        self.shift = 0.0
        self.state = "switch on disabled"
        self.mode = 0
        self.word = 0
        self.error = 0
        #: Faults that are there, by code: the state machine cannot leave "fault" before they are gone.
        self.causes: set[int] = set()
        self.is_hot = False
        self.cannot_home = False
        self.speed = 0.0
        self.demand = self._actual()
        self.goal = self.demand
        self._bits = 0
        self._next: float | None = None
        self._searched = -1
        self._is_limited = False
        self._torque = 0.0

    # ------------------------------------------------------------------ what is read

    def _actual(self) -> float:
        return self.motor.q * self.units.per_rad + self.units.zero + self.shift

    def read(self, index: int, now: int) -> int | None:
        """Return an object that the axis knows better than its dictionary; None: it does not."""
        match index:
            case 0x6041:
                self.advance(now)
                return self.statusword
            case 0x6064:
                self.advance(now)
                return round(self._actual())
            case 0x606C:
                self.advance(now)
                return (
                    0 if self.motor.jammed else round(self.speed * self.units.per_speed / self.units.per_rad)
                )
            case 0x6077:
                self.advance(now)
                if self.motor.body is not None:
                    share = self.motor.current / self.motor.motor.stall_current
                    return round(copysign(1000.0, self.units.per_rad) * share)
                return round(self._torque)
            case 0x6061:
                return self.mode
            case 0x603F:
                return self.error
            case _:
                return None

    @property
    def statusword(self) -> int:
        """As its state, its motion and its limits make it."""
        word = VALUES[self.state] | REMOTE
        if self.state != "not ready to switch on":
            word |= 0x10
        if self.state == "operation enabled":
            word |= self._bits
            if self._is_reached():
                word |= REACHED
        if self._is_limited:
            word |= LIMITED
        if self.is_hot:
            word |= WARNING
        return word

    def _is_reached(self) -> bool:
        name = MODE_NAMES.get(self.mode)
        if name in POSITION_MODES:
            if name == "homing" and self._searched >= 0:
                return False
            window = self.objects.get(0x6067, 0)
            return self.speed == 0.0 and abs(self.goal - self._actual()) <= window + 0.5
        return abs(self.speed - self.goal) < 1.0

    # ------------------------------------------------------------------ what is written

    def written(self, index: int, value: int, now: int) -> None:
        """Act on the new value of an object."""
        self.advance(now)
        self.objects[index] = value
        if index == 0x6040:
            self.control(value)
        elif index == 0x6060:
            if value != self.mode and self._has(value):
                self.mode = value
                self._bits = 0
                self._hold()
        name = MODE_NAMES.get(self.mode)
        if name == "cyclic_position" and index == 0x607A:
            self._aim(float(value))
        elif name in SPEED_MODES and index == (0x6042 if name == "velocity" else 0x60FF):
            scale = 1.0 if name == "velocity" else self.units.per_rad / self.units.per_speed
            self.goal = self._within(value * scale)

    def _has(self, mode: int) -> bool:
        """Return whether the drive has a mode: object 6502, bit mode − 1."""
        return mode == 0 or (mode > 0 and bool(self.objects.get(0x6502, 0) >> mode - 1 & 1))

    def control(self, word: int) -> None:
        """Apply a controlword to the state machine."""
        old, self.word = self.word, word
        state = self.state
        if state in ("fault", "fault reaction active"):
            if word & 0x80 and not old & 0x80 and not self.causes:
                self.state, self.error = "switch on disabled", 0
                self._report(0, 0)
            return
        if not word & 2:  # disable voltage
            self._enter("switch on disabled")
        elif not word & 4:  # quick stop
            if state == "operation enabled":
                self._enter("quick stop active")
            elif state in ("ready to switch on", "switched on"):
                self._enter("switch on disabled")
        elif not word & 1:  # shutdown
            if state != "quick stop active":
                self._enter("ready to switch on")
        elif not word & 8:  # switch on
            if state in ("ready to switch on", "operation enabled"):
                self._enter("switched on")
        elif state in ("ready to switch on", "switched on"):
            self._enter("operation enabled")
        if self.state == "operation enabled":
            self._of_mode(old, word)

    def _enter(self, state: str) -> None:
        if state == self.state:
            return
        if state == "operation enabled":
            self._hold()
        elif state != "quick stop active":
            self.speed = 0.0
            self.motor.free(self.at)
        self._bits = 0
        self._searched = -1
        self.state = state

    def _hold(self) -> None:
        """Stay where it is."""
        self.demand = self._actual()
        self.speed = 0.0
        self.goal = self.demand if MODE_NAMES.get(self.mode) in POSITION_MODES else 0.0
        self._next = None
        self._searched = -1
        self.motor.lead(self.at, self.motor.q)

    def _of_mode(self, old: int, word: int) -> None:
        """Apply the bits of the controlword that belong to the mode."""
        rises, falls = word & START and not old & START, old & START and not word & START
        name = MODE_NAMES.get(self.mode)
        if name == "profile_position":
            if rises:
                target = float(self.objects.get(0x607A, 0))
                if word & RELATIVE:
                    target += self.goal
                self._bits |= TAKEN
                if word & AT_ONCE or self._is_reached():
                    self._aim(target)
                else:
                    self._next = target
            elif falls:
                self._bits &= ~TAKEN
        elif name == "homing":
            if rises:
                self._search()
            elif falls:
                self._searched = -1

    def _aim(self, target: float) -> None:
        low, high = self.objects.get(0x607D << 8 | 1), self.objects.get(0x607D << 8 | 2)
        aim = target if low is None or high is None or low >= high else min(max(target, low), high)
        self._is_limited = aim != target
        self.goal = aim

    def _within(self, speed: float) -> float:
        most = float(self.objects.get(0x607F, 1 << 31))
        self._is_limited = abs(speed) > most
        return min(max(speed, -most), most)

    # ------------------------------------------------------------------ homing

    def _search(self) -> None:
        self._bits &= ~(TAKEN | FAILED)
        method = self.objects.get(0x6098, 0)
        if method in (35, 37):  # here
            self._found(self._actual())
            return
        self._searched = 0
        step = -1.0 if method in (1, 17, 33) else 1.0
        self.goal = self.demand + step * 1e12

    def _searching(self) -> None:
        """Advance a search by a millisecond; the switch is at the joint's limit, or half a turn from 0."""
        self._searched += 1
        joint, units = self.joint, self.units
        low = -3.14 if joint.lower is None else joint.lower
        high = 3.14 if joint.upper is None else joint.upper
        ends = sorted(angle * units.per_rad + units.zero + self.shift for angle in (low, high))
        at = ends[0] if self.goal < self.demand else ends[1]
        is_there = self.demand <= at if self.goal < self.demand else self.demand >= at
        if (self.cannot_home and (is_there or self._searched > 500)) or self._searched > SEARCH_MS:
            self._bits |= FAILED
            self._stop_search()
            self._report(NO_HOME, REGISTERS[NO_HOME])
        elif is_there:
            self._found(at)

    def _found(self, at: float) -> None:
        """End the search with the switch at count `at`, which is the home offset from now on."""
        self.shift += float(self.objects.get(0x607C, 0)) - at
        self._bits |= TAKEN
        self._stop_search()

    def _stop_search(self) -> None:
        self._searched = -1
        self.demand = self.goal = self._actual()
        self.speed = 0.0

    # ------------------------------------------------------------------ faults

    def fail(self, code: int) -> None:
        """Stop the axis with a fault, and report it."""
        self._fail(code)
        self._report(code, REGISTERS.get(code, 0x01))

    def _fail(self, code: int) -> None:
        self.error = code
        self.state = "fault"
        self.speed = 0.0
        self._bits = 0
        self._searched = -1
        self.motor.free(self.at)

    def lost_connection(self) -> None:
        """React to a lost connection as object 6007 says: 1 a fault, 2 disable voltage, 3 quick stop."""
        match self.objects.get(0x6007, 0):
            case 1 if self.state != "fault":
                self._fail(HOST_GONE)
            case 2:
                self.control(self.word & ~2)
            case 3:
                self.control(self.word & ~4 | 2)
            case _:
                pass

    def cause(self, code: int, there: bool) -> None:
        """Set or clear the cause of a fault."""
        if there and code not in self.causes:
            self.causes.add(code)
            if self.state != "fault":
                self.fail(code)
        elif not there:
            self.causes.discard(code)

    # ------------------------------------------------------------------ motion

    def position(self, now: int) -> float:
        """Return where the joint is (rad)."""
        self.advance(now)
        return self.motor.q

    def advance(self, now: int) -> None:
        """Catch up to `now` (ns)."""
        if self.motor.body is not None:
            self.motor.sync(now)
            return
        steps = (now - self.at) // STEP_NS
        if steps <= 0:
            return
        if self._is_still():
            self.at += steps * STEP_NS
            self._torque = 0.0
            return
        for _ in range(steps):
            self.at += STEP_NS
            self._step()
            if self._is_still():
                self.at = now - now % STEP_NS
                return

    def step_at(self, at: int) -> None:
        """Advance by the millisecond that ends at `at` in a body that the motor is in."""
        self.at = at
        if self.state not in ("operation enabled", "quick stop active"):
            return
        if not self._is_still():
            self._step()
        elif MODE_NAMES.get(self.mode) in POSITION_MODES:
            self._follow()

    def _is_still(self) -> bool:
        name = MODE_NAMES.get(self.mode)
        if self.state == "quick stop active":
            return False
        if self.state != "operation enabled":
            return True
        if name in TORQUE_MODES:
            return False
        target = self.goal == (self.demand if name in POSITION_MODES else 0.0)
        return target and self.speed == 0.0 and self._next is None and not self.motor.jammed

    def _step(self) -> None:
        """Advance by one millisecond."""
        name = MODE_NAMES.get(self.mode)
        if self.state == "quick stop active":
            self._ramp(0.0, float(self.objects.get(0x6085, 1 << 31)))
            if self.speed == 0.0 and self.objects.get(0x605A, 2) in (1, 2, 3):
                self._enter("switch on disabled")
                return
        elif name in TORQUE_MODES:
            most = self.objects.get(0x6072, 1000)
            self._torque = float(min(max(self.objects.get(0x6071, 0), -most), most))
            share = copysign(1.0, self.units.per_rad) * self._torque / 1000
            self.motor.push(self.at, share * self.motor.motor.stall_current)
            self.motor.sync(self.at)
            self.speed = self.motor.v * self.units.per_rad
            self.demand = self._actual()
            return
        elif name in SPEED_MODES:
            self._ramp(0.0 if self.word & HALT else self.goal, float(self.objects.get(0x6083, 1 << 31)))
        elif name == "cyclic_position":
            reach = self.objects.get(0x607F, 1 << 31) * STEP
            moved = min(max(self.goal - self.demand, -reach), reach)
            self.demand += moved
            self.speed = moved / STEP
        elif name in POSITION_MODES:
            self._towards()
            if name == "homing" and self._searched >= 0:
                self._searching()
        self._follow()

    def _ramp(self, target: float, rate: float) -> None:
        most = rate * STEP
        self.speed += min(max(target - self.speed, -most), most)
        self.demand += self.speed * STEP

    def _towards(self) -> None:
        """Advance along a trapezoid of speed towards the goal."""
        objects = self.objects
        if self._searched >= 0:
            fastest = float(objects.get(0x6099 << 8 | 1, 20000))
            up = down = float(objects.get(0x609A, 1 << 31))
        else:
            fastest = float(min(objects.get(0x6081, 1 << 31), objects.get(0x607F, 1 << 31)))
            up, down = float(objects.get(0x6083, 1 << 31)), float(objects.get(0x6084, 1 << 31))
        left = self.goal - self.demand
        wanted = copysign(min(fastest, sqrt(2 * down * abs(left))), left)
        if self.word & HALT:
            wanted = 0.0
        most = (up if abs(wanted) > abs(self.speed) else down) * STEP
        self.speed += min(max(wanted - self.speed, -1.5 * most), 1.5 * most)
        step = self.speed * STEP
        if abs(left) <= abs(step) + 0.5 and left * step >= 0:
            self.demand, self.speed = self.goal, 0.0
            if self._next is not None:
                self._aim(self._next)
                self._next = None
        else:
            self.demand += step

    def _follow(self) -> None:
        """Move the motor to the planned place, unless something is in its way."""
        self.motor.lead(self.at, (self.demand - self.units.zero - self.shift) / self.units.per_rad)
        behind = abs(self.demand - self._actual())
        self._torque = 0.0 if self.speed == 0 else copysign(20.0, self.speed)
        if behind > 1.0:
            self._torque = copysign(float(self.objects.get(0x6072, 1000)), self.demand - self._actual())
        if behind > self.objects.get(0x6065, 1 << 31) and self.state == "operation enabled":
            self.fail(FOLLOWING)
