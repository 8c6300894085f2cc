"""One motor channel of a board, as the driver knows it: its joint's signals, its units, what was last heard.

1. raw = (direction × position + zero) × counts_per_unit, truncated toward zero as the programs that drove the robots do;
   the way back is exact.
2. Velocity is (new − old) ÷ (instants' difference): real time stamps, not the nominal period.
"""

from __future__ import annotations

from typing import Any

from aces_bus.device import Joint, Signal

#: What the reference filters of hubo-ach divide by, and when a joint that becomes stiff again has arrived (rad).
ARRIVED = 0.0075


class MotorAxis:
    """A channel. `joint` None: nobody named one; the channel only has a place in its board's frames."""

    __slots__ = (
        "channel",
        "count",
        "counts",
        "current",
        "direction",
        "duty",
        "enabled",
        "errors",
        "flags",
        "goal",
        "home",
        "homed",
        "instant",
        "joint",
        "name",
        "position",
        "reference",
        "scale",
        "status",
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
        #: The last encoder count, and when it was heard (ns).
        self.count: int | None = None
        self.instant = 0
        #: The set-point in counts, and where a filter is to bring it (None: no filter).
        self.reference: int | None = None
        self.goal: float | None = None
        #: Errors of the last status as bits; whether it was homed then.
        self.flags = 0
        self.was_homed = False
        self.position: Signal | None = None
        self.velocity: Signal | None = None
        self.current: Signal | None = None
        self.duty: Signal | None = None
        self.status: Signal | None = None
        self.errors: Signal | None = None
        self.home: Signal | None = None
        self.homed: Signal | None = None
        self.enabled: Signal | None = None

    def to_counts(self, position: float) -> int:
        """Counts of a position (rad), truncated toward zero."""
        return int((self.direction * position + self.zero) * self.counts)

    def to_rad(self, count: float) -> float:
        """Position (rad) of an encoder count."""
        return count * self.scale - self.zero * self.direction

    def heard(self, count: int, instant: int, moves: bool) -> None:
        """The encoder says `count`; `moves` False: a zero is being set, and the difference is no movement."""
        position, velocity = self.position, self.velocity
        if position is not None:
            position.update(count * self.scale - self.zero * self.direction, instant)
            old, passed = self.count, instant - self.instant
            if velocity is not None and old is not None and passed > 0 and moves:
                velocity.update((count - old) * self.scale * 1e9 / passed, instant)
        self.count, self.instant = count, instant

    def forget(self) -> None:
        """The board has forgotten."""
        self.count = self.reference = self.goal = None
        self.flags, self.was_homed = 0, False


def joints_by_channel(joints: Any, channels: int, board: str) -> list[MotorAxis]:
    """An axis a channel."""
    by_channel = {joint.channel: joint for joint in joints}
    return [
        MotorAxis(n, by_channel.get(n), by_channel[n].name if n in by_channel else f"{board}.{n}")
        for n in range(channels)
    ]
