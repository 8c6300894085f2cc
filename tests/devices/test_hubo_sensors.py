"""Hubo's sensor and power boards and their twins."""

from __future__ import annotations

from aces_bus.testing.conformance import driver_tests
from aces_devices.hubo_sensors import hubo_ft, hubo_imu, hubo_power

test_ft = driver_tests(hubo_ft)
test_imu = driver_tests(hubo_imu)
test_power = driver_tests(hubo_power)
