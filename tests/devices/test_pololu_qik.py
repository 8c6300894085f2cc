"""Pololu qik motor drivers and their twins."""

from __future__ import annotations

from aces_bus.testing.conformance import driver_tests
from aces_devices.pololu_qik import driver

NO_NUMBER = "an answer is one byte, which has no number"
test_qik = driver_tests(driver, excused={"misbehaviour: * wrong_number": NO_NUMBER})
