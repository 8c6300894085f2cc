"""Captures as buses: their own pace, faster, in virtual time."""

from __future__ import annotations

from pathlib import Path

import can
import pytest

from aces_bus import Frame
from aces_bus.errors import CallerError
from aces_bus.hardware import CanGate, ListeningNode, SimulatedBus
from aces_bus.hardware.replay import ReplayBus, paced, replay_into
from aces_bus.runtime import VirtualClock

FRAMES = [
    Frame(1, timestamp=100.0),
    Frame(2, timestamp=100.25),
    Frame(3),  # no time: at once
    Frame(4, timestamp=100.2),  # the clock went back: at once
    Frame(5, timestamp=160.2),
]


@pytest.mark.parametrize(
    ("speed", "longest", "due"),
    [
        (1.0, None, [0, 0.25, 0.25, 0.25, 60.25]),
        (2.0, None, [0, 0.125, 0.125, 0.125, 30.125]),
        (1.0, 1.0, [0, 0.25, 0.25, 0.25, 1.25]),
        (None, None, [0, 0, 0, 0, 0]),
    ],
)
def test_frames_come_when_they_are_due(speed: float | None, longest: float | None, due: list[float]) -> None:
    """At the capture's pace or another; long silences can be cut short."""
    clock = VirtualClock()
    came = [
        (frame.arbitration_id, clock.now() / 1e9)
        for frame in paced(FRAMES, clock=clock, speed=speed, longest_gap=longest)
    ]
    assert came == list(zip(range(1, 6), due, strict=True))


def test_a_capture_is_sent_on_a_virtual_bus() -> None:
    """Planned as events: other nodes live beside it."""
    clock = VirtualClock()
    wire = SimulatedBus(clock)
    recorder = ListeningNode(wire)
    wire.attach()
    node = wire.attach()
    replay_into(clock, FRAMES, node.send, speed=10)
    clock.advance(10**10)
    assert [frame.arbitration_id for frame in recorder.frames()] == [1, 2, 3, 4, 5]
    assert recorder.received[-1][0] > 6_000_000_000


def test_impossible_paces() -> None:
    """Backwards, standing still, or no pace where one is needed."""
    for speed in (0.0, -1.0, float("nan")):
        with pytest.raises(CallerError, match="is not a pace"):
            next(paced(FRAMES, speed=speed))
    with pytest.raises(CallerError, match="virtual time"):
        replay_into(VirtualClock(), FRAMES, print, speed=None)


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


def test_a_gate_on_a_replay(log: Path) -> None:
    """The end of a capture is a lost bus to a gate that does not reopen: readers are told."""
    gate = CanGate(lambda: ReplayBus(log, speed=None, end="raise"), reopen=False)
    inbox = gate.subscribe()
    with gate:
        found = []
        while items := inbox.get(5):
            found += [item.content.arbitration_id for item in items]
        assert found == [1, 2, 3]
        assert inbox.is_closed


def test_looping(log: Path) -> None:
    """Again from the start, for ever."""
    with can.Bus(str(log), "aces-replay", speed="max", loop=True) as bus:
        got = [bus.recv(0) for _ in range(7)]
        assert [m.arbitration_id for m in got if m] == [1, 2, 3, 1, 2, 3, 1]


def test_what_is_no_capture(tmp_path: Path) -> None:
    """The reader's own words, as python-can's error."""
    with pytest.raises(can.CanInitializationError, match="no such file"):
        can.Bus(str(tmp_path / "none.log"), "aces-replay")
