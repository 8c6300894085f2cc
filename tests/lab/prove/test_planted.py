"""The prover refuses every planted fault with a witness that running the function confirms."""

from __future__ import annotations

from collections.abc import Callable

import pytest

pytest.importorskip("z3")

from aces_lab.prove import witness as w
from aces_lab.prove.decoding import FailedClaim, proof_lengths, prove_decoder
from aces_lab.prove.symbols import PathSearch

from .plant import Planted, of_plan, of_text, planted

PROTOCOLS = (
    "hubo",
    "odrive",
    "canopen",
    "vesc",
    "robstride",
    "damiao",
    "pololu_qik",
    "minihubo_adc",
    "dynamixel",
    "ubx",
)


def refused(fault: Planted) -> str:
    """The witness of a fault as a line of the table; raises `AssertionError` when the fault is proved or not confirmed."""
    sizes, _ = proof_lengths(fault.message)
    try:
        prove_decoder(fault.message, fault.function, PathSearch(60), sizes, raw=fault.raw, quick=False)
    except FailedClaim as failed:
        found = failed.witness
    else:
        raise AssertionError(f"{fault.where}: {fault.fault}: proved")
    image = w.image_of(fault.message, found)
    got = w.by_function(fault.message, fault.function, found, image)
    want = w.by_reference(fault.message, image, raw=fault.raw)
    assert w.text_of(got) != w.text_of(want), f"{fault.where}: {fault.fault}: {found} shows no difference"
    key = "" if found.key is None else f"{found.key:X}#"
    return f"{fault.where:36} {fault.fault:60} {key}{found.data.hex().upper()}  {found.what}"


def table(faults: list[Planted]) -> str:
    return "\n".join(map(refused, faults)) + "\n"


@pytest.mark.slow
def test_faults_in_generated_text_are_refused(golden: Callable[[str, str], None]) -> None:
    """70 of 70 in at least 20 messages; the table is kept."""
    faults = planted(PROTOCOLS, of_text, 70, 29)
    assert len(faults) == 70
    assert len({fault.where for fault in faults}) >= 20
    golden("prove/faults_in_text.txt", table(faults))


@pytest.mark.slow
def test_faults_in_plans_are_refused(golden: Callable[[str, str], None]) -> None:
    """30 of 30 in plans before they are printed; the table is kept."""
    faults = planted(PROTOCOLS, of_plan, 30, 30)
    assert len(faults) == 30
    golden("prove/faults_in_plans.txt", table(faults))


def test_a_wrong_constant_is_refused_at_once() -> None:
    """One fault of the text, in less than half a second."""
    (fault,) = planted(("minihubo_adc",), of_text, 5, 1)[:1]
    assert refused(fault)
