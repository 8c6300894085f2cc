"""Hubo's motor boards: driver `hubo_motor` and its twin."""

from __future__ import annotations

from aces_bus.device import Driver

from .driver import HuboMotor
from .example import D12
from .scan import scan_boards
from .settings import SETTINGS
from .twin import HuboMotorTwin

driver = Driver(
    "hubo_motor",
    device=HuboMotor,
    twin=HuboMotorTwin,
    example=D12,
    doc="Motor boards of the Hubo humanoids: 1, 2, 3 or 5 motors, DRC-Hubo's hand and neck",
    source="hubo-ach; HuboCan; acesHubo; HUBO2_CANprotocol.xls",
    scan=scan_boards,
    settings=SETTINGS,
)
