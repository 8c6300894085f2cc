"""Hubo's sensor and power boards and their twins."""

from __future__ import annotations

from aces_bus.testing.conformance import driver_tests
from aces_devices.hubo_ft import driver as hubo_ft
from aces_devices.hubo_imu import driver as hubo_imu
from aces_devices.hubo_power import driver as hubo_power

test_ft = driver_tests(hubo_ft)
test_imu = driver_tests(hubo_imu)
test_power = driver_tests(hubo_power)
