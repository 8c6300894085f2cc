"""One motor channel of a simulated board: joint, encoder, controller, home search, errors.

1. The joint is where it is; the encoder counts from wherever it was when the power came. A home search finds the true zero.
2. Everything happens at whole milliseconds: nothing depends on when it is looked at.

The home switch and the index are placed so that a search with the robot file's offset and direction ends at the joint's
true zero: index = −offset in raw counts, the switch half a motor turn before it, active on the side that the search goes
to. Where the file has none (D12: they live in the board), they are 0.2 rad from zero, or half way to a nearer stop,
searched clockwise. Raw counts grow counter-clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from aces_bus.device.config import Joint

from ..joint_model import STEP_NS, MotorJoint, MotorModel
from .parameters import ChannelParameters, StoredBoard, StoredChannel

#: How far the stops are beyond the soft limits, and where they are without (rad).
BEYOND, RANGE = 0.1, 3.0
#: rad/s of a home search for each unit of the board's velocities, whose unit is not known.
HOMING_SPEED = 0.05
#: Home flags that say how far a search is; 6 is in the facts, the others are this twin's.
SEARCHING, INDEXING, RETURNING, HOMED = 1, 4, 5, 6
#: Half and whole range of encoder replies of two bytes.
_HALF, _WORD = 0x8000, 0x10000


@dataclass
class Search:
    """A home search under way: `phase` and which way (raw counts), `index` where the zero is counted from."""

    phase: str
    way: int
    offset: float
    most: float
    uses_index: bool = True
    index: float = 0.0
    gone: float = 0.0
    since_switch: float = 0.0
    stuck_since: int = field(default=-1)


class MotorChannel:
    """A motor of a board. `q` of its `joint` is the joint's true angle (rad)."""

    def __init__(
        self, number: int, own: Joint | None, kind: int | str, board: StoredBoard, now: int, start: float
    ) -> None:
        self.number, self.own, self.kind, self.board = number, own, kind, board
        #: Names of faults that are on for this motor.
        self.faults = frozenset[str]()
        known = own.counts_per_unit if own is not None else None
        self.counts = known if known is not None else 2000.0
        self.direction = own.direction if own is not None else 1
        self.zero = (own.zero or 0.0) if own is not None else 0.0
        self.turn = float(own.encoder or 4000) if own is not None else 4000.0
        self.stored = self.defaults()
        self._place_switch()
        ratio = self.counts * math.tau / self.turn
        stall = {1: 8.0, 2: 8.0, 5: 0.25}.get(kind if isinstance(kind, int) else 0, 1.0)
        motor = MotorModel(speed=5.0) if kind == "neck" else MotorModel.of_ratio(ratio, stall_current=stall)
        lower, upper = self._stops()
        self.joint = MotorJoint(motor, now, position=min(max(start, lower), upper), lower=lower, upper=upper)
        self._gains = (self.joint.stiffness, self.joint.damping)
        self.powered(now)

    # ------------------------------------------------------------------ geometry

    def defaults(self) -> StoredChannel:
        """Return what the board comes with: the robot file's gains and home."""
        made, own = StoredChannel(resolution=min(16383, int(self.turn))), self.own
        if own is None:
            return made
        if own.gains is not None:
            made.kp, made.ki, made.kd = (
                int(gain or 0) for gain in (own.gains.kp, own.gains.ki, own.gains.kd)
            )
        home = own.home
        if home is not None:
            made.search_direction = home.direction or made.search_direction
            made.search_limit = home.search_turns or made.search_limit
            made.lower_limit, made.upper_limit = home.lower or 0, home.upper or 0
        if self.kind == 5:
            made.search_mode = "mechanical_stop"
        if home is not None and home.offset is not None:
            made.home_offset = home.offset
            if self.kind == 3:  # 16 bits without sign go to such a board
                made.home_offset = -self._sign(made) * (abs(home.offset) & 0xFFFF)
        else:
            lower, upper = self._soft()
            # Toward clockwise, which is down in raw counts.
            room = abs((lower if self.direction > 0 else upper) + (-BEYOND if self.direction > 0 else BEYOND))
            made.home_offset = -self._sign(made) * int(min(0.2, room / 2) * self.counts)
            if self.kind == 5:
                made.home_offset = -self._sign(made) * int(room * self.counts)
        return made

    @staticmethod
    def _sign(stored: ChannelParameters) -> int:
        return 1 if stored.search_direction == "ccw" else -1

    def _soft(self) -> tuple[float, float]:
        own = self.own
        lower = own.lower if own is not None and own.lower is not None else -RANGE
        upper = own.upper if own is not None and own.upper is not None else RANGE
        return lower, upper

    def _place_switch(self) -> None:
        #: Raw counts of the index that the search counts from, and of the switch's edge; which way it is passed last.
        self.index = -float(self.stored.home_offset)
        self.side = self._sign(self.stored)
        self.way = self.side if self.index * self.side >= 0 else -self.side
        self.edge = self.index - self.way * self.turn / 2

    def _stops(self) -> tuple[float, float]:
        lower, upper = self._soft()
        at = [self.angle(self.edge + away * self.turn) for away in (-1, 1)]
        if self.kind in ("neck", 5):
            return lower - BEYOND, upper + BEYOND
        return min(lower - BEYOND, *at), max(upper + BEYOND, *at)

    def raw(self, angle: float) -> float:
        """Return the raw counts of an angle, from the true zero."""
        return (self.direction * angle + self.zero) * self.counts

    def angle(self, raw: float) -> float:
        """Return the angle (rad) at raw counts."""
        return self.direction * (raw / self.counts - self.zero)

    # ------------------------------------------------------------------ power and switches

    def powered(self, now: int) -> None:
        """Begin as after power-up: the encoder counts from here, nothing is on, nothing is known."""
        joint = self.joint
        joint.free(now)
        self.offset = 0.0 if self.kind == "neck" else float(round(self.raw(joint.q)))
        self.home = 0
        self.found = {"origin": "none", "limit_switch": "none", "encoder": "none"}
        self.errors: set[str] = set()
        self.mode = "position"
        self.driver_on = self.control_on = False
        self.reference = 0.0
        self.step = 0.0
        self.pwm: float | None = None
        self.search: Search | None = None
        self.pressing_since = -1
        self.apply_gains()

    def be_homed(self) -> None:
        """Count from the true zero, as after a home search that ended well."""
        self.offset, self.home = 0.0, HOMED
        self.found = dict.fromkeys(self.found, "ok")

    def apply_gains(self) -> None:
        """Scale the gains of the model by those of the board: the model was made for the gains that the board
        came with.
        """
        usual = self.defaults()
        stiffness, damping = self._gains
        self.joint.stiffness = stiffness * self.stored.kp / (usual.kp or 1)
        self.joint.damping = damping * self.stored.kd / (usual.kd or 1)

    def apply(self, now: int) -> None:
        """Make the joint do what switches, mode and set-points say."""
        joint = self.joint
        if self.search is not None or not self.driver_on:
            joint.free(now)
        elif self.pwm is not None:
            most = self.stored.max_pwm / 100
            joint.drive(now, max(-most, min(most, self.pwm)) * self.direction)
        elif not self.control_on:
            joint.free(now)
        elif self.mode == "current":
            joint.push(now, self.reference * self.direction)
        else:
            joint.follow(now, self.angle(self.reference + self.offset))

    def sync(self, now: int) -> None:
        """Catch up."""
        joint = self.joint
        while joint.body is None and self.search is not None and joint.at + STEP_NS <= now:
            self._search_step(joint.at + STEP_NS)
        joint.sync(now)

    def step_search(self, at: int) -> None:
        """Advance a home search by a millisecond of the body that the joint is in."""
        if self.search is not None:
            self._search_step(at)

    def count(self, now: int) -> int:
        """Return what the encoder says."""
        self.sync(now)
        count = self.raw(self.joint.q) - self.offset
        return int(count + (1e-6 if count >= 0 else -1e-6))

    def zero_here(self, now: int) -> None:
        """Make the present place the zero of the encoder."""
        self.sync(now)
        self.offset = float(round(self.raw(self.joint.q)))
        self.reference = 0.0
        self.errors.clear()
        self.apply(now)

    # ------------------------------------------------------------------ set-points

    def refer(self, now: int, count: float) -> None:
        """Take a reference (counts; A in current mode)."""
        self.sync(now)
        if count == self.reference and self.pwm is None and self.joint.mode == "position":
            self.step = 0.0
            return
        stored, board = self.stored, self.board
        if self.mode == "position":
            step = count - self.reference
            if self.control_on:
                if board.max_step and abs(step) > board.max_step:
                    self.errors.add("big_error")
                if stored.max_acceleration and abs(step - self.step) > stored.max_acceleration:
                    self.errors.add("acceleration_error")
            self.step = step
            if stored.lower_limit_enabled and count < stored.lower_limit:
                self.errors.add("below_minimum")
                count = float(stored.lower_limit)
            if stored.upper_limit_enabled and count > stored.upper_limit:
                self.errors.add("above_maximum")
                count = float(stored.upper_limit)
        self.reference = count
        self.pwm = None
        self.apply(now)

    def drive(self, now: int, duty: float | None) -> None:
        """Drive with open-loop PWM, −1…1 toward counter-clockwise raw counts; None: off."""
        self.sync(now)
        self.pwm = duty
        self.apply(now)

    def switch(self, now: int, *, driver: bool | None = None, control: bool | None = None) -> None:
        """Switch drivers and control on or off. Control begins where the joint is."""
        here = self.count(now)
        if driver is not None:
            self.driver_on = driver
            if not driver:
                self.pwm = None
        if control is not None:
            if control and not self.control_on and self.mode == "position":
                self.reference = float(here)
            self.control_on = control
            self.pwm = None
            if not control:
                self.search = None
        self.apply(now)

    # ------------------------------------------------------------------ home search

    def begin_search(
        self, now: int, *, offset: float | None = None, side: int | None = None, index: bool = True
    ) -> None:
        """Search home; `offset` and `side` (±1) are the stored ones where None."""
        self.sync(now)
        stored = self.stored
        self.home = SEARCHING
        self.found = {"origin": "none", "limit_switch": "none", "encoder": "none"}
        way = self.way if side is None or side == self.side else -self.way
        stops = stored.search_mode == "mechanical_stop"
        limit = math.inf if self.kind == 3 else (stored.search_limit + 4) * self.turn
        self.search = Search(
            phase="stop" if stops else "away",
            way=self._sign(stored) if stops else way,
            offset=float(stored.home_offset) if offset is None else offset,
            most=limit if not stops else math.inf,
            uses_index=index and stored.search_mode == "switch_and_index",
        )
        self.pwm = None
        self.apply(now)

    def _search_step(self, at: int) -> None:
        """Advance a home search, a movement of constant speed, by a millisecond."""
        search, joint, board = self.search, self.joint, self.board
        assert search is not None
        before = self.raw(joint.led)
        to_offset = search.phase == "offset"
        unit = board.velocity_to_offset if to_offset else board.velocity_to_switch
        stride = max(1, unit) * HOMING_SPEED * self.counts * 1e-3
        if to_offset:
            goal = search.index + search.offset
            way = 1 if goal > before else -1
            wanted = goal if abs(goal - before) <= stride else before + way * stride
        else:
            wanted = before + (-search.way if search.phase == "away" else search.way) * stride
        joint.lead(at, self.angle(wanted))
        after = self.raw(joint.led)
        search.gone += abs(after - before)
        search.since_switch += abs(after - before)
        stuck = abs(after - before) < 1e-9 and abs(wanted - before) > 1e-9
        if not stuck:
            search.stuck_since = -1
        elif search.stuck_since < 0:
            search.stuck_since = at
        is_jammed = stuck and at - search.stuck_since >= board.jam_time * 1_000_000
        self._go_on(at, search, after, is_jammed)

    def _go_on(self, at: int, search: Search, raw: float, is_jammed: bool) -> None:
        """Begin the next phase of a search when the present one is over."""
        phase, way = search.phase, search.way
        if phase == "stop":
            if is_jammed:
                search.index, search.phase, search.stuck_since = raw, "offset", -1
                self.home = RETURNING
            return
        if is_jammed:
            self.errors.add("jam")
            self._end_search(at, failed=True)
        elif phase == "away":
            before_edge = (self.edge - raw) * way
            if "no_switch" in self.faults or before_edge >= self.turn / 8:
                search.phase = "switch"
            elif search.gone > search.most:
                self._end_search(at, failed=True)
        elif phase == "switch":
            if "no_switch" not in self.faults and (raw - self.edge) * way >= 0:
                self.found["limit_switch"] = "ok"
                search.index = self.edge
                search.phase = "index" if search.uses_index else "offset"
                search.since_switch = 0.0
                self.home = INDEXING if search.uses_index else RETURNING
            elif search.gone > search.most:
                self._end_search(at, failed=True)
        elif phase == "index":
            if "no_index" not in self.faults and (raw - self.index) * way >= 0:
                self.found["encoder"] = "ok"
                search.index, search.phase = self.index, "offset"
                self.home = RETURNING
            elif search.since_switch > 2 * self.turn:
                self.found["encoder"] = "fail"
                self._end_search(at, failed=True)
        elif abs(raw - search.index - search.offset) < 1e-6:
            self.offset = search.index + search.offset
            self._end_search(at, failed=False)

    def _end_search(self, at: int, *, failed: bool) -> None:
        self.search = None
        self.home = 0 if failed else HOMED
        self.found["origin"] = "fail" if failed else "ok"
        self.found["limit_switch"] = "fail" if failed else "ok"
        if not failed:
            self.reference = 0.0
        else:
            self.reference = float(int(self.raw(self.joint.q) - self.offset))
        self.apply(at)

    # ------------------------------------------------------------------ what is wrong

    def look(self, now: int) -> set[str]:
        """Return the error bits as they are now: what happened since they were cleared, and what lasts."""
        self.sync(now)
        joint, stored, board, faults = self.joint, self.stored, self.board, self.faults
        errors = self.errors
        duty = abs(joint.duty)
        if duty * 100 < board.jam_duty or self.search is not None:
            self.pressing_since = -1
        elif self.pressing_since < 0:
            self.pressing_since = joint.at
        else:
            since = max(self.pressing_since, joint.moved_at)
            if joint.at - since >= board.jam_time * 1_000_000:
                errors.add("jam")
        if "saturated" in faults or (
            joint.saturated_since >= 0
            and joint.at - joint.saturated_since >= board.saturation_time * 1_000_000
        ):
            errors.add("saturated")
        if self.control_on and self.mode == "position" and self.search is None and board.max_error:
            away = abs(self.raw(joint.q) - self.offset - self.reference)
            if away > board.max_error:
                errors.add("big_error")
        if stored.max_velocity and abs(joint.v) * self.counts * 1e-3 > stored.max_velocity:
            errors.add("velocity_error")
        count = self.raw(joint.q) - self.offset
        if stored.lower_limit_enabled and count < stored.lower_limit - 1:
            errors.add("below_minimum")
        if stored.upper_limit_enabled and count > stored.upper_limit + 1:
            errors.add("above_maximum")
        for fault, bit in FAULT_BITS.items():
            if fault in faults:
                errors.add(bit)
        if joint.temperature >= board.temperature_warning:
            errors.add("temperature_error")
        return set() if "no_errors" in faults else errors

    @property
    def at_switch(self) -> bool:
        """True if the limit switch is active."""
        return "no_switch" not in self.faults and (self.raw(self.joint.q) - self.edge) * self.side > 0

    def drive_flags(self) -> list[str]:
        """Return the switches of the status."""
        flags = {
            "driver_on": self.driver_on,
            "control_on": self.control_on,
            "current_mode": self.mode == "current",
            "limit_switch": self.at_switch,
        }
        return [name for name, is_on in flags.items() if is_on]


def counts_of(
    channels: Iterable[MotorChannel], now: int, frozen: Mapping[int, int], is_short: bool
) -> list[int]:
    """Return what the encoders of channels say, some `frozen` by a fault; where `is_short`, as 16 bits, which run around."""
    counts = [frozen.get(channel.number, channel.count(now)) for channel in channels]
    return [(count + _HALF) % _WORD - _HALF for count in counts] if is_short else counts


#: Faults that set an error bit as long as they last, beside what else they do.
FAULT_BITS = {
    "encoder_fail": "encoder_error",
    "fet_fault": "driver_fault",
    "motor_fail_0": "motor_fail_0",
    "motor_fail_1": "motor_fail_1",
    "overspeed": "velocity_error",
    "over_acceleration": "acceleration_error",
    "hot": "temperature_error",
}
