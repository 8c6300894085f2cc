"""Drivers that come with no test file of their own pass the published tests all the same: a servo is its two folders."""

from __future__ import annotations

import re
from pathlib import Path

from aces_bus.device.drivers import list_drivers
from aces_bus.testing import driver_tests

_HERE = Path(__file__).parent
_OWN = "".join(
    text
    for path in _HERE.glob("test_*.py")
    if path.name != "test_catalogue_drivers.py"
    and "driver_tests" in (text := path.read_text(encoding="utf-8"))
)
WITHOUT = [name for name in list_drivers() if not re.search(rf"\b{name}\b", _OWN)]

globals().update({f"test_{name}": driver_tests(name) for name in WITHOUT})
