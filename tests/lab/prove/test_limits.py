"""A proof that runs on, eats memory or dies proves nothing, and stops nothing else."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

pytest.importorskip("z3")

from aces_bus import load_protocol
from aces_bus.protocol import Variant
from aces_lab.prove.account import Outcome
from aces_lab.prove.run import jobs_of, prove_all


@dataclass
class Hog:
    """A job that never ends, or takes all memory."""

    variant: Variant
    what: str
    patience: float = 1.0

    def prove(self, seconds: float) -> list[Outcome]:
        kept: list[bytearray] = []
        while True:
            if self.what == "memory":
                kept.append(bytearray(10_000_000))
            elif self.what == "dies":
                raise SystemExit(3)

    def lost(self, reason: str) -> list[Outcome]:
        outcome = Outcome("hog", self.what)
        outcome.add("proof", "unknown", reason)
        return [outcome]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("time", "time limit"),
        ("memory", "memory limit of 500 MB"),
        ("dies", "its process died, of 500 MB or less memory (exit status 3)"),
    ],
)
def test_a_job_beyond_its_limits_is_unknown(what: str, reason: str) -> None:
    """The system ends it; the job beside it is proved."""
    variant = load_protocol("minihubo_adc").variant()
    (hog,), (sample,) = prove_all(
        [Hog(variant, what), *jobs_of([variant])], 2, 0.5 if what == "time" else 20, 500
    )
    assert (hog.status, hog.parts[0].reason) == ("unknown", reason)
    assert sample.status == "proved"
