"""A channel of a motor board as its driver knows it, and what is reckoned from channels alone.

1. raw = (direction × position + zero) × counts_per_unit, truncated toward zero as the programs that drove the robots do;
   the way back is exact. Velocity is (new − old) ÷ (instants' difference): real time stamps, not the nominal period.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from aces_bus.compiling import mypyc_attr
from aces_bus.device.config import Joint
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError
from aces_bus.protocol.record import FieldValue

#: Home flags that say that a joint is homed: 6, and 2 of a wrist roll (hubo-ach).
HOMED = ("homed", "wrist_roll_homed")
#: When a joint that is homed, or becomes stiff again, has arrived (rad; hubo-ach).
ARRIVED = 0.0075


@mypyc_attr(allow_interpreted_subclasses=True)
class MotorAxis:
    """A channel. `joint` None: the robot's file has none; the channel only has a place in its board's frames."""

    __slots__ = (
        "channel",
        "count",
        "counts",
        "direction",
        "drive",
        "duty",
        "failed",
        "goal",
        "instant",
        "is_on",
        "joint",
        "name",
        "position",
        "reference",
        "scale",
        "signals",
        "velocity",
        "was_homed",
        "zero",
    )

    def __init__(self, channel: int, joint: Joint | None, name: str) -> None:
        self.channel, self.joint, self.name = channel, joint, name
        counts = joint.counts_per_unit if joint is not None else None
        self.counts: float = counts if counts is not None else 1.0
        self.direction: int = joint.direction if joint is not None else 1
        self.zero: float = (joint.zero or 0.0) if joint is not None else 0.0
        #: rad a count, with the sign of the direction.
        self.scale = self.direction / self.counts
        #: The last encoder count, and when it was received (ns).
        self.count: int | None = None
        self.instant = 0
        #: The set-point in counts (of a neck rad, of a finger A), and where a filter is to bring it (None: no filter).
        self.reference: Any = None
        self.goal: float | None = None
        #: Whether it was homed by the last status.
        self.was_homed = False
        #: Whether the last status had its drive on; None: there was none.
        self.is_on: bool | None = None
        #: Of D15: names of the switch bits and of the error bits in the last status.
        self.drive: frozenset[str] = frozenset()
        self.failed: frozenset[str] = frozenset()
        #: What the status says.
        self.signals: dict[str, Signal] = {}
        self.position: Signal | None = None
        self.velocity: Signal | None = None
        self.duty: Signal | None = None

    def to_counts(self, position: float) -> int:
        """Return the counts of a position (rad), truncated toward zero."""
        return int((self.direction * position + self.zero) * self.counts)

    def to_rad(self, count: float) -> float:
        """Return the position (rad) of an encoder count."""
        return count * self.scale - self.zero * self.direction

    def received(self, count: int, instant: int, moves: bool) -> None:
        """Update position and velocity from an encoder `count`; `moves` is False while a zero is set: no movement."""
        position, velocity, scale = self.position, self.velocity, self.scale
        if position is not None:
            position.update(count * scale - self.zero * self.direction, instant)
            old, passed = self.count, instant - self.instant
            if velocity is not None and old is not None and passed > 0 and moves:
                velocity.update((count - old) * scale * 1e9 / passed, instant)
        self.count, self.instant = count, instant

    def forget(self) -> None:
        """Forget count, reference and home: the board has lost them."""
        self.count = self.reference = self.goal = None
        self.was_homed = False

    def show(self, name: str, value: FieldValue, instant: int) -> None:
        """Update the signal `name`, if the axis has it."""
        found = self.signals.get(name)
        if found is not None:
            found.update(value, instant)

    def shown(self, name: str) -> Any:
        """Return the value of a signal; None where there is none of this name."""
        found = self.signals.get(name)
        return None if found is None else found.value


def search_state(motor: Any) -> str:
    """Return how far a home search of D08 is: "failed" before "done" before "searching", as acesHubo looks at it."""
    if motor.origin == "fail" or motor.limit_switch == "fail":
        return "failed"
    return "done" if motor.origin == "ok" and motor.limit_switch == "ok" else "searching"


def unsigned(duties: Any, directions: tuple[str, str]) -> dict[str, FieldValue]:
    """Return duties as magnitudes with a direction each."""
    return {
        "direction": [directions[value < 0] for value in duties],
        "duty": [abs(value) for value in duties],
    }


def compliant_duty(
    error: float, velocity: float, kp: float, kd: float, max_pwm: float, pwm: float = 0.0
) -> int:
    """Return the duty in 0.1 %, as it goes out: `error` = reference − position (rad), `velocity` in rad/s.

    >>> compliant_duty(0.1, 0.0, 80, 0, 8)
    -80
    >>> compliant_duty(0.033, 0.0, 80, 0, 8)
    -26
    """
    effort = int(int(10 * kp * error) - int(10 * kd * velocity) + 10 * pwm)
    most = min(1000, int(10 * max_pwm))
    return -max(-most, min(most, effort))


def compliant_duties(axes: Sequence[MotorAxis], instant: int) -> list[float]:
    """Return a compliant board's duties (%), by channel, from what the encoders said at `instant` (ns)."""
    duties: list[float] = []
    for axis in axes:
        joint = axis.joint
        if joint is None or joint.compliance is None or axis.count is None or axis.reference is None:
            duties.append(0)
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
        duties.append(duty / 10)
        if axis.duty is not None:
            axis.duty.update(-duty / 10 * axis.direction, instant)
    return duties


def home_of(board: str, axis: MotorAxis) -> tuple[int, str]:
    """Return offset and direction of a joint's home (D08). Raises `CallerError` where the robot's file has none."""
    home = axis.joint.home if axis.joint is not None else None
    if home is None or home.offset is None or home.direction is None:
        raise CallerError(f"{board}: {axis.name} needs home = {{ offset, direction }} in the robot's file")
    return home.offset, home.direction


def home_power(board: str, axes: Sequence[MotorAxis]) -> int:
    """Return the one power of fingers that are driven home (D08). Raises `CallerError` where there is none, or several."""
    powers = {
        axis.joint.home.power for axis in axes if axis.joint is not None and axis.joint.home is not None
    }
    power = next(iter(powers), None)
    if power is None or len(powers) > 1:
        raise CallerError(f"{board}: its joints need one home = {{ power }} in the robot's file")
    return power


def home_fields(board: str, axis: MotorAxis, channels: int) -> dict[str, FieldValue]:
    """Return the home command of a channel of D08, from the robot's file; `channels` is how many the board has.

    A board of three channels has 16 bits for the pulses: higher bits and the sign do not fit and are left out, and the
    other motors get 5 turns, as acesHubo sent both.
    """
    pulses, direction = home_of(board, axis)
    fields: dict[str, FieldValue] = {"direction": direction, "motor": f"motor_{axis.channel + 1}"}
    if channels == 3:
        return {**fields, "pulses": abs(pulses) & 0xFFFF, "revolutions": [5.0, 5.0]}
    offset = [0, 0]
    offset[axis.channel] = pulses
    return {**fields, "offset": offset}


def why_not_home(axes: Sequence[MotorAxis]) -> str:
    """Return what is known of joints that found no home."""
    said: list[str] = []
    for axis in axes:
        parts = [f"home flag {axis.shown('home')}"] if "home" in axis.signals else []
        parts += axis.shown("errors") or ()
        if axis.count is not None:
            parts.append(f"at {axis.to_rad(axis.count):.4f} rad")
        said.append(f"{axis.name} ({', '.join(parts)})")
    return "; ".join(said)


def name_info(kind: int | str, period_ms: float | None, axes: Sequence[MotorAxis]) -> dict[str, Any] | None:
    """Return the fields of NameInfo (D08); None where the robot's file does not know them all."""
    if period_ms is None:
        return None
    period = int(period_ms)
    homes = [axis.joint.home if axis.joint is not None else None for axis in axes]
    if kind == 5:
        return {"period": period}
    turns = [0 if home is None or home.search_turns is None else home.search_turns for home in homes]
    if kind == 3:
        known = all(home is not None and home.search_turns is not None for home in homes)
        return {"period": period, "limit": turns} if known else None
    phases = [0 if home is None or home.z_phase is None else home.z_phase for home in homes]
    if any(
        axis.joint is not None and (home is None or home.z_phase is None)
        for axis, home in zip(axes, homes, strict=True)
    ):
        return None
    # A one-channel board has places for two.
    return {"period": period, "limit": [*turns, 0][:2], "z_phase": [*phases, 0][:2]}
