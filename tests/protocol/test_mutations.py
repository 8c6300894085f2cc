"""Slips in shipped specs: `aces spec check`, the laws or a recording catch 95 of a hundred seeded ones.

`pytest -s` prints which caught which, and what slipped through, with the reason. A few of small protocols in the short
profile, all hundred of all protocols in the long one.
"""

from __future__ import annotations

import ast
from collections import Counter
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

from aces_bus import open_recording
from aces_bus.errors import AcesError
from aces_bus.protocol import Protocol
from aces_bus.protocol.against import check_recordings
from aces_bus.protocol.lint import check_protocol
from aces_bus.testing import Fuzzer
from tests.conftest import ROOT
from tests.protocol.mutations import Mutation, declared, drawn, folder_of

SMALL = ["minihubo_adc", "pololu_qik", "robotis"]
ALL = [*SMALL, "hubo", "hubovia"]
CAPTURES = ROOT / "examples" / "captures"
SEED = 2026
#: Scenes before the laws, for what the check lets pass.
EXAMPLES = 64
#: What the examples have of each protocol, and which way its bytes went.
RECORDINGS: dict[str, tuple[str, Any]] = {
    "hubo": ("hubo2plus.log", None),
    "minihubo_adc": ("adc.bin", "from device"),
    "robotis": ("robotis_session.dxconf.txt", "both"),
}
#: Why something slips through.
REGISTERS = "registers have no worked examples"
UNSEEN = "its worked examples read the same"


def remarks(protocol: Protocol) -> Counter[tuple[str, str]]:
    """What the check says, without lines and wording: rule and message."""
    return Counter((f.rule, f.message or "") for f in check_protocol(protocol) if f.level != "note")


def contradictions(protocol: Protocol, name: str) -> Counter[tuple[str, str]]:
    """What the recording of a protocol says against it: rule and message."""
    if name not in RECORDINGS:
        return Counter()
    file, direction = RECORDINGS[name]
    path = CAPTURES / file
    recording = open_recording(path, link="serial") if path.suffix == ".bin" else open_recording(path)
    found = check_recordings(protocol, [recording], direction=direction)
    return Counter((one.rule, one.message or "") for one in found if one.level != "note")


@lru_cache
def healthy(name: str, folder: Path) -> tuple[Counter[tuple[str, str]], Counter[tuple[str, str]]]:
    """What the check and the recording say of the shipped spec."""
    protocol = declared(name, folder)
    return remarks(protocol), contradictions(protocol, name)


def caught(mutation: Mutation, folder: Path) -> str:
    """What catches a mutation: "import", "check: RULE", "law N", "recording: RULE"; empty when nothing does."""
    try:
        mutant = declared(mutation, folder)
    except (AcesError, TypeError, ValueError, KeyError, AttributeError, AssertionError) as error:
        return f"import: {type(error).__name__}"
    said, recorded = healthy(mutation.protocol, folder)
    new = remarks(mutant) - said
    if new:
        return f"check: {min(rule for rule, _ in new)}"
    failures = Fuzzer([mutant], seed=SEED).run(EXAMPLES, most=1)
    if failures:
        return f"law {failures[0].law.number}"
    against = contradictions(mutant, mutation.protocol) - recorded
    return f"recording: {min(rule for rule, _ in against)}" if against else ""


def reason(mutation: Mutation, folder: Path) -> str:
    """Why a mutation can slip through."""
    protocol = declared(mutation, folder)
    message = next((m for m in protocol.declared if m.name == mutation.owner), None)
    if mutation.module == "control_table.py":
        return REGISTERS
    if message is None:
        return "a part that several messages share: where the examples look, it reads the same"
    if not message.examples:
        return "the message has no worked example"
    return UNSEEN


def judged(chosen: list[Mutation], folder: Path) -> list[Mutation]:
    """What slips through; prints all."""
    by: Counter[str] = Counter()
    missed: list[Mutation] = []
    for mutation in chosen:
        found = caught(mutation, folder)
        by[found or "missed"] += 1
        if found:
            print(f"{found:24} {mutation}")
        else:
            missed.append(mutation)
            print(f"{'MISSED':24} {mutation}: {reason(mutation, folder)}")
    print(", ".join(f"{what}: {count}" for what, count in by.most_common()))
    return missed


@pytest.mark.slow
def test_slips_in_small_specs_are_caught(tmp_path: Path) -> None:
    """Of every kind of slip one, in the specs of the serial protocols: what slips through is known."""
    missed = judged(drawn(SMALL, 12, SEED, in_turn=True), tmp_path)
    assert {reason(mutation, tmp_path) for mutation in missed} <= {REGISTERS, UNSEEN}
    assert len(missed) <= 3, "\n".join(map(str, missed))


@pytest.mark.long
def test_a_hundred_slips_are_caught(tmp_path: Path) -> None:
    """At least 95 of a hundred, of all places alike, in all shipped specs: more examples, fewer slips."""
    missed = judged(drawn(ALL, 100, SEED), tmp_path)
    assert len(missed) <= 5, "\n".join(map(str, missed))


@pytest.mark.slow
def test_a_mutation_changes_one_place() -> None:
    """A mutant is the shipped source but for a line or two, and the same seed draws the same ones."""
    assert drawn(SMALL, 12, 1) == drawn(SMALL, 12, 1)
    for mutation in drawn(SMALL, 12, 1):
        path = folder_of(mutation.protocol) / mutation.module
        shipped = ast.unparse(ast.parse(path.read_text(encoding="utf-8"))).splitlines()
        differing = set(mutation.text.splitlines()) ^ set(shipped)
        assert 1 <= len(differing) <= 6, mutation
