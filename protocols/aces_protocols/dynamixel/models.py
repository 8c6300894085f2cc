"""What tells the models of the X series apart: units, defaults and ranges of their control tables.

Source: ROBOTIS e-manual, control table of each model. Raw numbers, as the tables have them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class FactoryGains(NamedTuple):
    """The controller's factory gains, raw."""

    velocity_i: int
    velocity_p: int
    position_d: int
    position_i: int
    position_p: int


@dataclass(frozen=True)
class XModel:
    """One model. `current_step_a`: A a count of its currents, None: it has none, and tells a load instead."""

    name: str
    number: int
    current_step_a: float | None
    current_limit: int
    velocity_limit: int
    temperature_limit: int
    #: Least and greatest supply (0.1 V).
    voltages: tuple[int, int]
    shutdown: int
    gains: FactoryGains


MODELS = (
    XModel("XM430-W350", 1020, 2.69e-3, 1193, 350, 80, (95, 160), 52, FactoryGains(1920, 100, 0, 0, 800)),
    XModel("XM540-W270", 1120, 2.69e-3, 2047, 128, 80, (95, 160), 52, FactoryGains(1920, 100, 0, 0, 800)),
    XModel("XL430-W250", 1060, None, 0, 265, 72, (60, 140), 52, FactoryGains(1000, 100, 4000, 0, 640)),
    XModel("XL330-M288", 1200, 1e-3, 1750, 445, 70, (35, 70), 53, FactoryGains(1600, 180, 0, 0, 400)),
)
#: By name.
MODEL_NAMES = {model.name: model for model in MODELS}
