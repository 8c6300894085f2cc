"""Robotis RX-10, RX-28 and RX-64 servos (Dynamixel protocol 1.0)."""

from __future__ import annotations

from aces_bus.device import Driver
from aces_bus.device.settings import described
from aces_protocols.robotis.spec import SERVOS, control_table

from ..servos.driver import ServoSettings
from ..servos.scan import servo_scan
from .driver import RobotisRX
from .twin import RobotisRXTwin

EXAMPLE = """\
name = "robotis_rx_example"
rate_hz = 25

[buses]
line = { link = "serial", protocol = "robotis", baud = 1_000_000 }

[devices]
S1 = { driver = "robotis_rx", bus = "line", model = "RX-28", credentials = { id = 1 }, settings = { health_s = 0.1 } }
S2 = { driver = "robotis_rx", bus = "line", model = "RX-64", credentials = { id = 2 }, settings = { motion = true } }
S3 = { driver = "robotis_rx", bus = "line", model = "RX-10", credentials = { id = 3 }, settings = { health_s = 0.1 } }

[joints]
KNEE  = { device = "S1", direction = -1, zero = 2.605 }
HIP   = { device = "S2", direction = 1, zero = 2.618, lower = -1.5, upper = 1.5 }
WHEEL = { device = "S3", type = "continuous", command = "duty" }
"""

driver = Driver(
    "robotis_rx",
    RobotisRX,
    RobotisRXTwin,
    EXAMPLE,
    doc="Robotis RX-10, RX-28 and RX-64 servos.",
    source="Robotis RX-28 manual; recordings of two servos; acesHubo robotis.*",
    scan=servo_scan("robotis_rx", control_table, SERVOS),
    settings=described(ServoSettings),
)

__all__ = ["RobotisRX", "RobotisRXTwin", "driver"]
