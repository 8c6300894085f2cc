"""Live decoding under pytest-benchmark: `make test ARGS="tests/bench --benchmark-enable"`; `tests.bench` has ratios."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from aces_bus import load_protocol
from tests.bench import bits
from tests.bench.live import CHUNK, car_like, dynamixel_stream, hubo_like, messages
from tests.bench.rows import fastest

Benchmark = Callable[..., Any]


@pytest.mark.parametrize("size", [1, 64])
def test_hubo_frames(benchmark: Benchmark, size: int) -> None:
    """Python-can messages of Hubo's boards through a scanner, one by one and in batches."""
    scanner = hubo_like().scanner()
    frames = messages([(0x060, 8), (0x040, 6), (0x050, 8)], 960)
    batches = [frames[at : at + size] for at in range(0, len(frames), size)]
    given = benchmark(lambda: sum(len(scanner.feed(batch)) for batch in batches))
    assert given == len(frames)


def test_car_frames(benchmark: Benchmark) -> None:
    """A message of eight signals, in one batch."""
    scanner = car_like().scanner()
    frames = messages([(0x100, 8)], 960)
    assert benchmark(lambda: len(scanner.feed(frames))) == len(frames)


def test_dynamixel_stream(benchmark: Benchmark) -> None:
    """A noisy stream in chunks: every good packet is found."""
    data, good = dynamixel_stream(40_000)

    def run() -> int:
        scanner = load_protocol("robotis").scanner(direction="from device")
        for at in range(0, len(data), CHUNK):
            scanner.feed(data[at : at + CHUNK])
        scanner.close()
        return scanner.counts.records

    assert benchmark(run) >= good


def test_contenders_take_turns() -> None:
    """Timing runs contenders alternately, so that a drifting machine slows all of them."""
    order: list[str] = []
    best = fastest({"one": lambda: order.append("one"), "other": lambda: order.append("other")}, rounds=3)
    assert order == ["one", "other"] * 3
    assert all(seconds >= 0 for seconds in best.values())


def test_one_thread_is_measured_in_processor_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Contenders that work on one thread are measured in processor time, which other programs do not lengthen."""
    instants = iter([0, 5_000_000_000, 5_000_000_000, 7_000_000_000])
    monkeypatch.setattr("tests.bench.rows.process_time_ns", lambda: next(instants))
    assert fastest({"one": lambda: None}, rounds=2, one_thread=True) == {"one": 2.0}


@pytest.mark.parametrize("subject", bits.SUBJECTS, ids=lambda subject: subject.name)
def test_traffic_by_bits_is_decoded(subject: bits.Subject) -> None:
    """What is measured of fields and sizes by bits is whole packets, live and in columns."""
    for how in ("fixed", *subject.shapes):
        for decode in bits.contender(subject, how, 40).values():
            decode()
