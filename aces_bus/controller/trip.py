"""What a guard says: that motion was stopped and how, and how many set-points it changed."""

from __future__ import annotations

from typing import Literal

import msgspec

#: "park" holds, too: the run that the guard is part of then ends, and leads its joints to the pose of the robot's file.
Action = Literal["hold", "park", "zero duty", "disable"]
#: From the mildest to the strictest.
ACTIONS: tuple[Action, ...] = ("hold", "park", "zero duty", "disable")
#: Those that go on giving set-points, so that the joints stay where they are.
HOLDING: frozenset[Action] = frozenset(("hold", "park"))


class Clipped(msgspec.Struct):
    """How many set-points of a state were changed, by reason; `not_finite` were not taken at all."""

    position: int = 0
    rate: int = 0
    acceleration: int = 0
    not_finite: int = 0

    @property
    def total(self) -> int:
        """Number of values that were limited or refused."""
        return self.position + self.rate + self.acceleration + self.not_finite


class Trip(msgspec.Struct, frozen=True):
    """Motion was stopped: when (ns), how, why, and whether it takes `release` to go on.

    `source`: the device, bus or controller whose fault it was; "" where none is known.
    """

    instant: int
    action: Action
    reason: str
    latched: bool = True
    source: str = ""
