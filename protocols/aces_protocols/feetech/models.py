"""Feetech's servos that are known by name.

Source: LeRobot motors/feetech/tables.py (numbers, series).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class FeetechModel:
    """One model: its number, and whose control table it has (SMS servos have that of STS)."""

    name: str
    number: int
    series: Literal["STS", "SCS"]


MODELS = (
    FeetechModel("STS3215", 777, "STS"),
    FeetechModel("STS3250", 2825, "STS"),
    FeetechModel("SM8512BL", 11_272, "STS"),
    FeetechModel("SCS0009", 1284, "SCS"),
)
#: By name.
MODEL_NAMES = {model.name: model for model in MODELS}
