"""MiniHubo's analogue-to-digital converter board."""

from __future__ import annotations

from aces_bus.device import Driver
from aces_bus.device.settings import described

from .driver import AdcSettings, MinihuboADC
from .twin import MinihuboADCTwin

EXAMPLE = """\
name = "minihubo_adc_example"

[buses]
adc = { link = "serial", protocol = "minihubo_adc", baud = 57_600 }

[devices]
ADC = { driver = "minihubo_adc", bus = "adc" }

[sensors]
TILT = { device = "ADC", kind = "analog", channel = 0 }
"""

driver = Driver(
    "minihubo_adc",
    MinihuboADC,
    MinihuboADCTwin,
    EXAMPLE,
    doc="MiniHubo's analogue-to-digital converter board: three channels, free-running.",
    source="acesHubo flexscanner/adc; a recording of the board",
    settings=described(AdcSettings),
)

__all__ = ["MinihuboADC", "MinihuboADCTwin", "driver"]
