"""Slips in shipped specs: `aces spec check` or the laws catch nearly all of a hundred seeded ones.

`pytest -s` prints which caught which, and what slipped through, with the reason. A few of small protocols in the short
profile, all hundred of all protocols in the long one.
"""

from __future__ import annotations

from collections import Counter
from functools import lru_cache
from pathlib import Path

import pytest

from aces_bus.errors import AcesError
from aces_bus.protocol import Protocol
from aces_bus.protocol.lint import check_protocol
from aces_bus.testing.fuzz import Fuzzer
from tests.protocol.mutations import Mutation, declared, drawn, mutations

SMALL = ["minihubo_adc", "pololu_qik", "robotis"]
ALL = [*SMALL, "hubo", "hubovia"]
SEED = 2026
#: Scenes before the laws, for what the check lets pass.
EXAMPLES = 256


def remarks(protocol: Protocol) -> Counter[tuple[str, str]]:
    """What the check says, without lines and wording: rule and message."""
    return Counter((f.rule, f.message or "") for f in check_protocol(protocol) if f.level != "note")


@lru_cache
def healthy(name: str, folder: Path) -> Counter[tuple[str, str]]:
    """What the check says of the shipped spec."""
    return remarks(declared(name, folder))


def caught(mutation: Mutation, folder: Path) -> str:
    """What catches a mutation: "import", "check: RULE", "law N"; empty when nothing does."""
    try:
        mutant = declared(mutation, folder)
    except (AcesError, TypeError, ValueError, KeyError, AttributeError, AssertionError) as error:
        return f"import: {type(error).__name__}"
    new = remarks(mutant) - healthy(mutation.protocol, folder)
    if new:
        return f"check: {min(rule for rule, _ in new)}"
    failures = Fuzzer([mutant], seed=SEED).run(EXAMPLES, most=1)
    return f"law {failures[0].law.number}" if failures else ""


def reason(mutation: Mutation, folder: Path) -> str:
    """Why a mutation can slip through."""
    message = declared(mutation, folder)._messages_by_name().get(mutation.owner)
    return "" if message is None else str(len(message.examples))


def judged(chosen: list[Mutation], folder: Path) -> list[Mutation]:
    """What slips through; prints all."""
    by: Counter[str] = Counter()
    missed: list[Mutation] = []
    for mutation in chosen:
        found = caught(mutation, folder)
        by[found or "missed"] += 1
        print(f"{found or 'MISSED':22} {mutation}")
        if not found:
            missed.append(mutation)
    print(", ".join(f"{what}: {count}" for what, count in by.most_common()))
    return missed
