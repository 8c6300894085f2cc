"""Numbers as VESC firmware packs them: so many steps a unit."""

from __future__ import annotations

from typing import Any

from construct import Construct

from aces_bus.protocol import Quantity


def in_steps(construct: Construct, unit: str, per_unit: float, **more: Any) -> Quantity:
    """Return a number that counts `per_unit` steps a unit; the other keywords are those of `Quantity`."""
    return Quantity(construct, unit=unit, scale=1 / per_unit, **more)
