"""HuboVia motors and their twins."""

from __future__ import annotations

from aces_bus.testing.conformance import driver_tests
from aces_devices.hubovia import driver

test_hubovia = driver_tests(driver)
