"""Faults planted in scanners and encoders: the fuzzer finds each, and shows it in a handful of bytes.

A fault is planted with `monkeypatch` before its protocol is declared anew, so that nothing generated earlier is used. The
tables are in `faults` and `encoder_faults`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from aces_bus.protocol import Protocol
from aces_bus.testing import LAWS, Fuzzer
from aces_bus.testing.bench import Bench
from aces_bus.testing.fuzz import Failure, judged
from aces_bus.testing.trial import Trial
from tests.testing.encoder_faults import ENCODER_FAULTS
from tests.testing.faults import (
    FAULTS,
    Fault,
    Patch,
    a_request_is_answered_twice,
    only_the_last_request_is_remembered,
)
from tests.testing.victims import a_bus, a_line, a_slip, lines_of_text, two_dialects

#: Examples until which a fault must be found: some seconds.
EXAMPLES = 2000
#: Faults whose counter-examples, some requests and replies, take many seconds to shrink.
DEAR = {a_request_is_answered_twice, only_the_last_request_is_remembered}


@pytest.fixture(autouse=True)
def nothing_is_remembered() -> Iterator[None]:
    """What was generated before a fault was planted, or under one, is not used again."""
    forget()
    yield
    forget()


def forget() -> None:
    for name, module in list(sys.modules.items()):
        if name.startswith("aces_bus"):
            for value in list(vars(module).values()):
                if hasattr(type(value), "cache_clear"):
                    value.cache_clear()


def hunted(fault: Fault) -> Failure:
    """The failure that a fuzzer finds."""
    chosen = [law for law in LAWS if law.number in fault.laws]
    fuzzer = Fuzzer([fault.protocol()], seed=1, laws=chosen)
    for first in range(0, EXAMPLES, 32):
        if found := fuzzer.run(32, first, most=1):
            return found[0]
    pytest.fail(f"no law of {fault.laws} failed in {EXAMPLES} examples")


def _chosen() -> list[Any]:
    """All in the long profile; every third that is soon found in the short one, which is run many times a day."""
    planted = [*FAULTS, *ENCODER_FAULTS]
    return [
        pytest.param(
            fault,
            id=str(fault),
            marks=[] if number % 3 == 0 and fault.plant not in DEAR else [pytest.mark.long],
        )
        for number, fault in enumerate(planted)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("fault", _chosen())
def test_a_planted_fault_is_found_and_small(fault: Fault, monkeypatch: Patch) -> None:
    """A law that is meant fails, on a handful of frames or bytes that still break it when they are played again."""
    fault.plant(monkeypatch)
    failure = hunted(fault)
    traffic = failure.scene.traffic
    assert (len(traffic) - traffic.count(0) if isinstance(traffic, bytes) else len(traffic)) <= fault.most
    again = Trial(Bench(failure.wire, failure.direction), failure.scene, failure.cuts)
    assert judged(failure.law, again) == failure.text
    # The numbers in the failure lead back to the example that it began with.
    assert failure.example is not None
    fuzzer = Fuzzer([fault.protocol()], seed=1, laws=[failure.law])
    assert fuzzer.example(failure.example)[1].traffic == (failure.first or failure.scene).traffic


def test_there_are_faults_enough() -> None:
    """More than twenty different ones of scanners, and all that an encoder can have."""
    assert len({fault.plant for fault in FAULTS}) >= 25
    assert len({fault.plant for fault in ENCODER_FAULTS}) >= 10


@pytest.mark.slow
@pytest.mark.parametrize("make", [a_bus, a_line, a_slip, lines_of_text, two_dialects])
def test_without_a_fault_nothing_is_found(make: Callable[[], Protocol]) -> None:
    """The victims are healthy: what is found above is due to the faults."""
    assert Fuzzer([make()], seed=1).run(64) == []
