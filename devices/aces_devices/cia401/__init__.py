"""Modules of inputs and outputs of CiA 401 on CANopen; their twin."""

from __future__ import annotations

from functools import partial

from aces_bus.device import Driver
from aces_bus.device.settings import described

from ..canopen_node.scan import scan_nodes
from .channels import ModuleSettings
from .driver import Cia401
from .twin import Cia401Twin

#: One module as it is, one with channels that have names and units.
EXAMPLE = """
name = "cia401"
rate_hz = 20

[buses]
io = { link = "can", protocol = "canopen", bitrate = 500_000 }

[devices.RACK]
driver = "cia401"
bus = "io"
credentials = { node = 16 }

[devices.TANK]
driver = "cia401"
bus = "io"
credentials = { node = 17 }

[devices.TANK.settings.channels]
full = { kind = "digital_input", number = 1 }
valve = { kind = "digital_output", number = 1, stop = false }
level = { kind = "analog_input", number = 1, unit = "m", scale = 0.0001 }
heater = { kind = "analog_output", number = 1, unit = "V", scale = 0.001, lower = 0.0, upper = 10.0 }
"""

driver = Driver(
    "cia401",
    device=Cia401,
    twin=Cia401Twin,
    example=EXAMPLE,
    doc="Module of digital and analog inputs and outputs of CiA 401 on CANopen.",
    source="CiA 301, CiA 401 (as christiansandberg/canopen, CANopenNode and makers' files have them)",
    scan=partial(scan_nodes, profile=401, driver="cia401", prefix="IO", with_silent=False),
    settings=described(ModuleSettings),
)

__all__ = ["driver"]
