"""Feetech's STS, SMS and SCS servos."""

from __future__ import annotations

from aces_bus.device import Driver
from aces_bus.device.settings import described
from aces_protocols.feetech.spec import SERVOS, scs_table, sts_table

from ..servos.driver import ServoSettings
from ..servos.scan import servo_scan
from .driver import Feetech
from .twin import FeetechTwin

EXAMPLE = """\
name = "feetech_example"
rate_hz = 25

[buses]
line = { link = "serial", protocol = "feetech", baud = 1_000_000 }

[devices]
F1 = { driver = "feetech", bus = "line", model = "STS3215", credentials = { id = 1 }, settings = { health_s = 0.1 } }
F2 = { driver = "feetech", bus = "line", model = "STS3250", credentials = { id = 2 }, settings = { motion = true } }
F3 = { driver = "feetech", bus = "line", model = "SCS0009", credentials = { id = 3 }, settings = { health_s = 0.1 } }

[joints]
ELBOW = { device = "F1", direction = -1, zero = 3.14, lower = -1.6, upper = 1.6 }
WHEEL = { device = "F2", type = "continuous", command = "speed" }
CLAW  = { device = "F3", zero = 2.6 }
"""


def _model(data: bytes) -> object:
    """Return the model's name by its two bytes: of STS servos the low one first, of SCS servos the high one."""
    names = (table["model_number"].decode(data) for table in (sts_table, scs_table))
    return next((name for name in names if isinstance(name, str)), sts_table["model_number"].decode(data))


driver = Driver(
    "feetech",
    Feetech,
    FeetechTwin,
    EXAMPLE,
    doc="Feetech STS, SMS and SCS servos.",
    source="LeRobot motors/feetech; Feetech FTServo_Python",
    scan=servo_scan("feetech", sts_table, SERVOS, model=_model),
    settings=described(ServoSettings),
)

__all__ = ["Feetech", "FeetechTwin", "driver"]
