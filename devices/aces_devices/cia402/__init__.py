"""Servo drives of CiA 402 on CANopen; their twin."""

from __future__ import annotations

from functools import partial

from aces_bus.device import Driver
from aces_bus.device.settings import described

from ..canopen_node.scan import scan_nodes
from .driver import Cia402
from .twin import Cia402Twin
from .units import DriveSettings

#: One drive a mode, one with its PDOs written, one that sends by itself.
EXAMPLE = """
name = "cia402"
rate_hz = 20

[buses]
drives = { link = "can", protocol = "canopen", bitrate = 1_000_000 }

[devices.D1]
driver = "cia402"
bus = "drives"
credentials = { node = 1 }
settings = { counts_per_turn = 100_000 }

[devices.D2]
driver = "cia402"
bus = "drives"
credentials = { node = 2 }
settings = { pdo = "write", mode = "cyclic_position" }

[devices.D3]
driver = "cia402"
bus = "drives"
credentials = { node = 3 }
settings = { counts_per_turn = 100_000, pdo = "file", rated_torque = 2.5 }

[devices.D4]
driver = "cia402"
bus = "drives"
credentials = { node = 4 }
settings = { counts_per_turn = 100_000, pdo = "write", sync = false }

[joints]
SHOULDER = { device = "D1", channel = 0, lower = -1.5, upper = 1.5 }
ELBOW = { device = "D2", channel = 0, gear = [1, 1], harmonic = 100, encoder = 1000, direction = -1, lower = -2, upper = 2 }
WHEEL = { device = "D3", channel = 0, type = "continuous", command = "speed", max_speed = 3.0 }
WRIST = { device = "D4", channel = 0, direction = -1, zero = 0.1, lower = -1, upper = 1 }
"""

driver = Driver(
    "cia402",
    device=Cia402,
    twin=Cia402Twin,
    example=EXAMPLE,
    doc="Servo drive of CiA 402 on CANopen: position, velocity and torque, profile and cyclic; homing.",
    source="CiA 301, CiA 402 (christiansandberg/canopen; ros-industrial/ros2_canopen)",
    scan=partial(scan_nodes, profile=402, driver="cia402", prefix="DRIVE", with_silent=True),
    settings=described(DriveSettings),
)

__all__ = ["driver"]
