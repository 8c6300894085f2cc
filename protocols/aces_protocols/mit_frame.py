"""Numbers of MIT's motor frame, which its relatives have in common: bgkatz/motorcontrol `Core/Src/math_ops.c`."""

from __future__ import annotations

from aces_bus.protocol import Quantity, bits


def span(width: int, limit: float, unit: str, *, low: float | None = None) -> Quantity:
    """Return a number that spans ±`limit` (or from `low`) in 2**width − 1 steps. We send the nearest; most firmware
    truncates.
    """
    return Quantity.span(bits(width), -limit if low is None else low, limit, bits=width, unit=unit)
