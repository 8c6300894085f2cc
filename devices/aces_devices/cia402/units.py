"""A drive's settings, and what its numbers are in SI: one place for both ends."""

from __future__ import annotations

from dataclasses import dataclass
from math import tau
from typing import Annotated, Literal

from msgspec import Meta

from aces_bus.device.config import Joint
from aces_bus.errors import CallerError

from ..canopen_node.settings import NodeSettings


class DriveSettings(NodeSettings, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    eds: Annotated[
        str | None, Meta(description="the drive's EDS or DCF file; our own drive's when absent")
    ] = None
    pdo: Annotated[
        Literal["read", "file", "write"],
        Meta(
            description=(
                '"read": as the drive has them (when absent); "file": as its file says; "write": as the driver wants'
                " them"
            )
        ),
    ] = "read"
    sync: Annotated[
        bool | None,
        Meta(
            description='true: SYNC in each tick; when absent as the drive\'s file says, true with pdo = "write"'
        ),
    ] = None
    event_ms: Annotated[
        int,
        Meta(
            description='without SYNC and with pdo = "write": how often the drive sends (ms), 20 when absent'
        ),
    ] = 20
    mode: Annotated[
        str | None,
        Meta(description="mode of operation; when absent profile_position, or what the joint's command says"),
    ] = None
    counts_per_turn: Annotated[
        float | None,
        Meta(description="counts a turn of the joint, where it has no gear, harmonic and encoder"),
    ] = None
    velocity_scale: Annotated[
        float,
        Meta(description="the drive's units of velocity in counts/s, 1 when absent: v = counts/s × this"),
    ] = 1.0
    rated_torque: Annotated[
        float | None,
        Meta(description="the rated torque (N·m, of the joint); when absent torques are shares of it"),
    ] = None


@dataclass(frozen=True)
class Units:
    """Counts a rad; the drive's units of velocity a rad/s; 1/1000 of the rated torque a N·m (or a share of it); counts at 0.

    Signs are the joint's direction.
    """

    per_rad: float
    per_speed: float
    per_torque: float
    zero: float
    #: Whether torques are N·m, or shares of an unknown rated torque.
    is_rated: bool


def units_of(who: str, joint: Joint, settings: DriveSettings) -> Units:
    """Return the units of a joint's drive. Raises `CallerError` when its counts are not stated."""
    per_unit = joint.counts_per_unit
    if per_unit is None:
        if settings.counts_per_turn is None:
            raise CallerError(
                f"{who}: {joint.name} needs its counts: settings counts_per_turn (of the joint), or the joint's gear,"
                " harmonic and encoder"
            )
        per_unit = settings.counts_per_turn / tau
    rated = settings.rated_torque
    per_rad = joint.direction * per_unit
    return Units(
        per_rad,
        per_rad * settings.velocity_scale,
        joint.direction * 1000.0 / (1.0 if rated is None else rated),
        (joint.zero or 0.0) * per_unit,
        rated is not None,
    )
