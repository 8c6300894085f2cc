"""Record which test runs which line: a pytest plugin (`-p tests.mutants.lines`).

1. `ACES_LINES` names the file that it writes: coverage.py's own, with one context a test (its node id).
2. Lines that run while modules are imported have the context "": no test runs them alone.
3. It is loaded before anything that is measured. What other processes run is not measured.
"""

from __future__ import annotations

import os
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import coverage
import pytest

ROOT = Path(__file__).resolve().parents[2]
#: Folders whose lines are measured.
MEASURED = [
    "aces_bus",
    "protocols/aces_protocols",
    "devices/aces_devices",
    "tools/aces_tools",
    "tools/aces_lab",
]

_coverage = coverage.Coverage(
    data_file=os.environ.get("ACES_LINES", str(ROOT / "build" / "mutants" / "lines.sqlite")),
    source=[str(ROOT / folder) for folder in MEASURED],
    config_file=False,
    messages=False,
)
_seconds: dict[str, float] = {}
_coverage.start()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """Count what runs from here on for this test."""
    _coverage.switch_context(item.nodeid)
    began = time.process_time()
    result = yield
    _seconds[item.nodeid] = time.process_time() - began
    _coverage.switch_context("")
    return result


def pytest_sessionfinish() -> None:
    """Write the file, and beside it what each test cost (s of processor time)."""
    _coverage.stop()
    _coverage.save()
    path = Path(_coverage.get_data().data_filename())
    lines = [f"{seconds:.4f}\t{test}\n" for test, seconds in _seconds.items()]
    path.with_suffix(".seconds").write_text("".join(lines), encoding="utf-8")
