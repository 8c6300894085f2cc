"""The ends of `aces device … set … --enable --tx` against `aces sim`, with real programs, signals and time."""

from __future__ import annotations

import os

import pytest

from tests.bench.stops import measure, table

RUNS = int(os.environ.get("ACES_STOPS", "3"))


@pytest.mark.long
def test_however_it_ends_the_board_is_off() -> None:
    """By time, SIGINT, SIGTERM and SIGHUP: the board is off and ControlOff is on the wire, every time; printed: a table."""
    found = measure(RUNS)
    print(table(found))
    assert all(result.is_good for result in found.values())
