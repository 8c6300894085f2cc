"""`python -m tests.bench robot`: host and twins in two processes, on served buses, in real time."""

from __future__ import annotations

import json

import pytest

from tests.bench import played, robot


@pytest.mark.slow
def test_a_host_alone_is_measured_in_lock_step(capsys: pytest.CaptureFixture[str]) -> None:
    """Recorded answers come to every poll in its tick, on real sockets; nothing is missed, however busy the machine is."""
    played.measure("200", "0.1", "loop")
    found = json.loads(capsys.readouterr().out)
    assert found["missed"] == 0
    assert found["frames_s"] > 10_000
    assert found["frame_us"] > 0


@pytest.mark.long
def test_a_complete_robot_is_measured() -> None:
    """Frames go both ways, cycles are counted, and every figure is there for both ways of serving the buses."""
    rows = {row.contender: row for row in robot.run(quick=True)}
    assert "cycles" in rows["missed"].unit
    assert rows["CPU a played frame, threads"].value > rows["CPU a played frame, one loop"].value > 0
    assert rows["CPU a frame, threads"].value > rows["CPU a frame, one loop"].value > 0
    assert rows["lateness, median"].value > 0
    assert rows["simulated seconds a second of CPU"].value > 0
