"""Of the slips that authors make, at least 33 of 39 are caught: by the import, by check and its examples, or by a recording.

docs/checking.md says which are not, and why.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import pytest

from aces_bus.errors import AcesError
from aces_bus.protocol import Protocol
from aces_bus.protocol.against import check_recordings
from aces_bus.protocol.against.finding import Observation
from aces_bus.protocol.files import protocol_of_file
from aces_bus.protocol.lint import check_protocol
from tests.protocol.slips import SLIPS, Slip, recording, sound

#: What nothing catches: bytes that are as right as before, and only mean something else.
MISSED = {
    4: "a scale's sign: the quantity is as smooth the other way round",
    14: "a unit: bytes have none",
    16: "names of values: the values are those that were declared",
    25: "names of bits: the bits are those that were declared",
}
#: What a recording alone shows: neither the import nor a rule nor an example.
RECORDED = {10, 12, 13, 19, 20, 21, 22, 23, 26, 33, 34, 37, 38}

recorded = cache(recording)


def warnings_of(protocol: Protocol, spec: str) -> list[Observation]:
    return [one for one in check_recordings(protocol, [recorded(spec)]) if one.level != "note"]


def caught_by(slip: Slip, folder: Path) -> tuple[str, str]:
    """What catches a slip first, and what it says; two empty texts where nothing does."""
    try:
        protocol = protocol_of_file(str(slip.written(folder)))[0]
    except AcesError as error:
        return "import", str(error)
    findings: list[Any] = [one for one in check_protocol(protocol) if one.level != "note"]
    if findings:
        return "example" if findings[0].rule == "example" else "check", findings[0].text
    observations = warnings_of(protocol, slip.spec)
    return ("recording", observations[0].text) if observations else ("", "")


@pytest.mark.parametrize("spec", ["imu", "servo", "marine"])
def test_a_sound_spec_is_not_contradicted(spec: str) -> None:
    """Neither a rule nor the recording says anything against the specs that the slips are made in."""
    protocol = sound(spec)
    assert [str(one) for one in check_protocol(protocol) if one.level != "note"] == []
    assert [str(one) for one in warnings_of(protocol, spec)] == []


@pytest.mark.parametrize("slip", SLIPS, ids=[f"{slip.number} {slip.what}" for slip in SLIPS])
def test_a_slip_is_caught(slip: Slip, tmp_path: Path) -> None:
    """Each slip is caught by what is said of it here; and those that nothing catches are known."""
    by, text = caught_by(slip, tmp_path)
    assert bool(by) == (slip.number not in MISSED), text
    assert (by == "recording") == (slip.number in RECORDED), f"{by}: {text}"


def test_most_slips_are_caught() -> None:
    """33 of 39 at least."""
    assert len(SLIPS) == 39
    assert len({slip.number for slip in SLIPS} - MISSED.keys()) >= 33
