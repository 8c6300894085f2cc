"""The plug-in for pytest: the fixture `aces_twin`, and options that run its tests under faults.

1. pytest loads it in every project where aces-bus is installed: it imports pytest alone, which is there, and adds a fixture,
   options and a marker. Everything else is imported by the first test that uses the fixture.
2. No test without the fixture changes: hooks that look at tests are registered with the first use, or with `--aces-faults`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from .fixture import TwinMaker

MARKER = (
    "aces_faults(survives=(), without=()): faults of --aces-faults that this test has to pass in spite of,"
    " and those that it is not run under"
)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--aces-faults`, `--aces-seed`, `--aces-places` and `--aces-patience`."""
    group = parser.getgroup("aces_twin", "simulated devices (the fixture aces_twin of aces-bus)")
    group.addoption(
        "--aces-faults",
        metavar="FAULTS",
        default="",
        help="run tests with aces_twin under faults, too: all, or names with commas (--aces-faults help lists them)",
    )
    group.addoption(
        "--aces-seed", metavar="N", type=int, default=0, help="what faults are drawn from (default: 0)"
    )
    group.addoption(
        "--aces-places",
        metavar="N",
        type=int,
        default=4,
        help="how many answers of a test each fault hits, one a run (default: 4)",
    )
    group.addoption(
        "--aces-patience",
        metavar="S",
        type=float,
        default=10.0,
        help="seconds after which a test under a fault hangs (default: 10)",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker; with `--aces-faults` what runs tests under them."""
    config.addinivalue_line("markers", MARKER)
    if names := config.getoption("aces_faults", ""):
        from .rounds import FaultRounds

        config.pluginmanager.register(FaultRounds.of(names, config), "aces_twin_faults")


@pytest.fixture
def aces_twin(request: pytest.FixtureRequest) -> Iterator[TwinMaker]:
    """Make simulated devices on buses of their own: `motor = aces_twin("odrive", node=3)`; see `aces_bus.twin`."""
    from .fixture import maker_of

    with maker_of(request) as maker:
        yield maker
