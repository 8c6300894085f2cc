"""Captures as buses: their own pace, faster, in virtual time."""

from __future__ import annotations

from pathlib import Path

import can
import pytest


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "walk.log"
    path.write_text("(100.000000) can0 001#01\n(100.010000) can1 002#02 T\n(100.020000) can0 00000003#03\n")
    return path


def test_any_program_opens_a_capture(log: Path) -> None:
    """By name, through python-can; the capture's stamps and channels come along, and nothing can be sent."""
    with can.Bus(str(log), "aces-replay", speed="max") as bus:
        got = list(iter(lambda: bus.recv(0), None))
        assert [(m.arbitration_id, m.timestamp, m.channel, m.is_rx, m.is_extended_id) for m in got] == [
            (1, 100.0, "can0", True, False),
            (2, 100.01, "can1", False, False),
            (3, 100.02, "can0", True, True),
        ]
        with pytest.raises(can.CanOperationError, match="nothing can be sent"):
            bus.send(can.Message(arbitration_id=1))


def test_in_real_time(log: Path) -> None:
    """Reading waits for a frame that is not due, and gives up when its own time is over."""
    with can.Bus(str(log), "aces-replay", speed=0.02) as bus:  # half a second between frames
        assert bus.recv(0) is not None
        assert bus.recv(0.001) is None


def test_looping(log: Path) -> None:
    """Again from the start, for ever."""
    with can.Bus(str(log), "aces-replay", speed="max", loop=True) as bus:
        got = [bus.recv(0) for _ in range(7)]
        assert [m.arbitration_id for m in got if m] == [1, 2, 3, 1, 2, 3, 1]


def test_what_is_no_capture(tmp_path: Path) -> None:
    """The reader's own words, as python-can's error."""
    with pytest.raises(can.CanInitializationError, match="no such file"):
        can.Bus(str(tmp_path / "none.log"), "aces-replay")
