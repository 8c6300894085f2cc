"""Foreign programs as oracles: vendors' kits and peer libraries, unmodified, against our specs, scanners and twins.

`make test-oracles` installs them (the extra [oracles]) and runs this folder. Without them a test is skipped, and says what
to install.
"""

from __future__ import annotations

import importlib
from types import ModuleType

import pytest


def oracle(module: str, package: str) -> ModuleType:
    """The foreign `module`, or the test is skipped with the `package` to install."""
    try:
        return importlib.import_module(module)
    except ImportError:
        pytest.skip(
            f"needs {package}: make test-oracles, or pip install 'aces-bus[oracles]'", allow_module_level=True
        )
