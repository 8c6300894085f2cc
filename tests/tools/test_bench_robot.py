"""`aces bench robot`: host and twins in two processes, on served buses, in real time."""

from __future__ import annotations

import pytest

from aces_tools.benchmarks import robot


@pytest.mark.long
def test_a_complete_robot_is_measured() -> None:
    """Frames go both ways, cycles are counted, and every figure is there for both ways of serving the buses."""
    rows = {row.contender: row for row in robot.run(quick=True)}
    assert "cycles" in rows["missed"].unit
    assert rows["CPU a frame, threads"].value > rows["CPU a frame, one loop"].value > 0
    assert rows["lateness, median"].value > 0
    assert rows["simulated seconds a second of CPU"].value > 0
