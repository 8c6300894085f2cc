"""Motor boards of D15: driver and twin over the virtual bus."""

from __future__ import annotations

from aces_bus.testing.conformance import driver_tests
from aces_devices.hubo_motor.d15 import driver

test_driver = driver_tests(driver)
