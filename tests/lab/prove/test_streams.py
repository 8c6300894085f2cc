"""The prover of stream scanners refuses planted faults, and says what it proved of shipped framings."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("z3")

from aces_bus import load_protocol
from aces_bus.testing.laws import Way
from aces_lab.prove.decoding import FailedClaim
from aces_lab.prove.streams import StreamJob, check_seek, prove_scan, shown_by
from aces_lab.prove.symbols import PathSearch

from .plant import SCANNERS, faulty_scanner


@pytest.mark.slow
@pytest.mark.parametrize(("name", "way", "right", "wrong"), SCANNERS)
def test_a_fault_in_a_printed_scanner_is_refused(name: str, way: Way, right: str, wrong: str) -> None:
    """With bytes on which the faulty scanner, run as it is, differs from the reference."""
    scanner = faulty_scanner(name, way, right, wrong)
    with pytest.raises(FailedClaim) as failed:
        prove_scan(scanner, PathSearch(60))
    assert shown_by(scanner, failed.value.witness.data), failed.value.witness


def test_the_search_for_a_next_packet_is_compared_byte_by_byte() -> None:
    """The expression that printed scanners search with finds what the framings' sync bytes say."""
    for name in ("robotis", "ubx", "dynamixel"):
        scanner: Any = load_protocol(name).scanner(direction="to device")
        assert check_seek(scanner.framings) is None


@pytest.mark.slow
def test_what_is_proved_of_a_scanner_is_said() -> None:
    """By z3 up to a length, and the whole scanner on sequences of pieces."""
    (outcome,) = StreamJob(load_protocol("minihubo_adc").variant()).prove(60)
    assert outcome.status == "bounded"
    assert outcome.reason == (
        "scan: all strings of up to 12 bytes; scanner: all sequences of up to 3 of 6 pieces, split in two anywhere"
    )


@pytest.mark.slow
def test_a_scanner_whose_proof_has_no_more_time_is_bounded() -> None:
    """What was proved until then is said, and the trial by pieces is made."""
    (outcome,) = StreamJob(load_protocol("minihubo_adc").variant()).prove(0)
    assert outcome.status == "bounded"
    assert "time limit" in " ".join(claim.reason for claim in outcome.parts)


def test_what_z3_cannot_prove_is_tried_and_said() -> None:
    """NMEA's sentences end with one of two marks."""
    (outcome,) = StreamJob(load_protocol("nmea0183").variant()).prove(60)
    assert outcome.status == "bounded"
    assert "not by z3 (nmea0183: two marks that may close packets): all sequences of" in outcome.reason
