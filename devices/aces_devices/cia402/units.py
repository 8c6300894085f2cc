"""What a drive's numbers are in SI: one place for both ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import tau
from typing import Any

from aces_bus.device import Joint
from aces_bus.errors import CallerError


@dataclass(frozen=True)
class Units:
    """Counts a rad; the drive's units of velocity a rad/s; 1/1000 of the rated torque a N·m (or a share of it); counts at 0.

    Signs are the joint's direction.
    """

    per_rad: float
    per_speed: float
    per_torque: float
    zero: float
    #: Whether torques are N·m, or shares of a rated torque that nobody has stated.
    is_rated: bool


def units_of(who: str, joint: Joint, settings: Mapping[str, Any]) -> Units:
    """The units of a joint's drive. Raises `CallerError` when nobody has said how many counts it has."""
    per_unit = joint.counts_per_unit
    if per_unit is None:
        turn = settings.get("counts_per_turn")
        if turn is None:
            raise CallerError(
                f"{who}: {joint.name} needs its counts: settings counts_per_turn (of the joint), or the joint's gear,"
                " harmonic and encoder"
            )
        per_unit = float(turn) / tau
    rated = settings.get("rated_torque")
    per_rad = joint.direction * per_unit
    return Units(
        per_rad,
        per_rad * float(settings.get("velocity_scale", 1.0)),
        joint.direction * 1000.0 / (1.0 if rated is None else float(rated)),
        (joint.zero or 0.0) * per_unit,
        rated is not None,
    )
