"""Dynamixel X-series servos (protocol 2.0)."""

from __future__ import annotations

from aces_bus.device import Driver
from aces_bus.device.settings import described
from aces_protocols.dynamixel.spec import SERVOS, control_table

from ..servos.scan import servo_scan
from .driver import Dynamixel, DynamixelSettings
from .twin import DynamixelTwin

EXAMPLE = """\
name = "dynamixel_example"
rate_hz = 25

[buses]
line = { link = "serial", protocol = "dynamixel", baud = 1_000_000 }

[devices]
D1 = { driver = "dynamixel", bus = "line", model = "XM430-W350", credentials = { id = 1 }, settings = { health_s = 0.2 } }
D2 = { driver = "dynamixel", bus = "line", model = "XL430-W250", credentials = { id = 2 }, settings = { motion = true } }
D3 = { driver = "dynamixel", bus = "line", model = "XL330-M288", credentials = { id = 3 }, settings = { health_s = 0.2 } }

[joints]
KNEE  = { device = "D1", direction = -1, zero = 3.142, lower = -1.5, upper = 1.5 }
WHEEL = { device = "D2", type = "continuous", command = "speed" }
GRIP  = { device = "D3", command = "current", max_current = 0.3 }
"""

driver = Driver(
    "dynamixel",
    Dynamixel,
    DynamixelTwin,
    EXAMPLE,
    doc="Dynamixel X-series servos (protocol 2.0).",
    source="ROBOTIS e-manual, protocol 2.0 and control tables of the X series",
    scan=servo_scan("dynamixel", control_table, SERVOS),
    settings=described(DynamixelSettings),
)

__all__ = ["Dynamixel", "DynamixelTwin", "driver"]
