"""The plug-in for pytest: options of `aces_bus.testing.law_tests`.

1. pytest loads it in every project where aces-bus is installed: it imports nothing, and does nothing but add two options.
"""

from __future__ import annotations

from typing import Any

#: Where captures of failures go when nothing else is said, from the current folder.
FAILURES = ".aces/failures"


def pytest_addoption(parser: Any) -> None:
    """Add `--aces-failures DIR` and `--aces-examples N`."""
    group = parser.getgroup("aces_bus", "laws of protocols (aces_bus.testing.law_tests)")
    group.addoption(
        "--aces-failures",
        metavar="DIR",
        default=FAILURES,
        help=f"where the captures of scenes that break a law are saved (default: {FAILURES})",
    )
    group.addoption(
        "--aces-examples",
        metavar="N",
        type=int,
        default=None,
        help="scenes a test (default: what Hypothesis's profile says)",
    )


__all__ = ["FAILURES"]
