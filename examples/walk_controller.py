"""A controller that steps in place, for any robot whose joints have these names: it sees states and nothing else.

A foot is lifted as far as the robot was measured to lean on the other. Names and signs are Hubo's; what another robot calls
its joints, and which way they turn, is its file's business.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi, sin

from aces_bus.controller import controller
from aces_bus.state import State

LEGS = tuple(f"{side}{joint}" for side in "LR" for joint in ("HR", "HP", "KP", "AP", "AR"))


@controller(rate_hz=50, writes=["WST", *LEGS])
def walk(
    t: float, LHR: State, RHR: State, *, sway: float = 0.08, bend: float = 0.3, lift: float = 3.0
) -> Mapping[str, float]:
    """Lean left and right, once in 1.2 s; lift what is free."""
    fade = min(1.0, t)
    roll = sway * fade * sin(2 * pi * t / 1.2)
    lean = (LHR[0] + RHR[0]) / 2  # rad, measured
    given = {"WST": 0.5 * roll}
    for side, way in (("L", 1.0), ("R", -1.0)):
        knee = bend * fade + lift * max(0.0, way * lean)
        given |= {f"{side}HP": -knee, f"{side}KP": 2 * knee, f"{side}AP": -knee}
        given |= {f"{side}HR": roll, f"{side}AR": -roll}
    return given
