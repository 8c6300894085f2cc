"""Bugs planted in copies of foreign packages: some of them here, all by `make planted`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.oracles.foreign import oracle

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]


def test_planted_bugs_of_a_package_are_found() -> None:
    """All bugs in a copy of pymodbus but a known one, each by a fault under which the package itself does not fail."""
    oracle("pymodbus", "pymodbus")
    command = [sys.executable, "-m", "tests.oracles.planted", "pymodbus"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
