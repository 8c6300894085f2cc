"""`aces spec prove` proves shipped protocols, says what it did not prove, and its witnesses open as captures."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("z3")

from aces_bus import load_protocol
from aces_lab.prove import run
from aces_lab.prove import witness as w
from aces_lab.prove.c_export import check_c
from aces_lab.prove.columns import check_columns
from aces_lab.prove.decoding import Witness, drawn, proof_lengths
from aces_lab.prove.meaning import meaning
from tests.tools.conftest import aces as aces

from .plant import of_text, planted

Aces = Callable[..., Any]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["damiao", "pololu_qik", "minihubo_adc"])  # `make prove` has all
def test_a_shipped_protocol_is_proved(aces: Aces, name: str) -> None:
    """Nothing is refuted or unknown; what hangs on construct, or on float error, is named with its reason."""
    found = aces("spec", "prove", name)
    assert found.status == 0, found.out
    assert "refuted" not in found.out
    assert "unknown" not in found.out
    parts = dict(
        line.split(": ", 1) for line in found.out.splitlines() if line.startswith((f"{name}: ", f"{name}, "))
    )
    assert parts[name].startswith("proved ")
    relations = parts[f"{name}, apart and reachable"]
    assert relations == f"proved {relations.rpartition(' ')[2]}"
    assert (load_protocol(name).link == "can") or "all strings of up to 12 bytes" in parts[f"{name}, streams"]


def test_one_message_is_proved_as_json(aces: Aces) -> None:
    """With `--json`: each claim with its status and reason."""
    (found,) = json.loads(aces("spec", "prove", "minihubo_adc", "--message", "Sample", "--json").out)
    assert found["status"] == "proved"
    assert {part["what"] for part in found["parts"]} >= {"decode", "decode, raw", "decode, quick", "encode"}


def test_a_witness_opens_as_a_capture(aces: Aces, tmp_path: Path) -> None:
    """What is saved is what `aces decode` and `aces spec explain` read: a frame, and a packet with its check written."""
    for name, message, found in (
        ("hubo", "Reference", Witness("", 0x013, bytes.fromhex("BC3100BC3180"))),
        ("robotis", "Ping", Witness("", None, bytes.fromhex("FFFF0102 0100"))),
    ):
        variant = load_protocol(name).variant()
        path = w.save(name, variant[message], found, tmp_path)
        decoded = aces("decode", "-p", name, str(path), "--direction", "to")
        assert message in decoded.out
        assert message in aces("spec", "explain", name, str(path), "--direction", "to").out
        live, slow = w.scanned(variant, variant[message], found)
        assert live.startswith(message)
        assert slow.startswith(message)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hubo", "odrive", "canopen", "damiao", "robstride"])
def test_the_second_reading_is_the_references(name: str) -> None:
    """On drawn frames the declaration read as arithmetic says what construct says: the same raw fields, or neither."""
    for variant in load_protocol(name).variants()[-1:]:
        for message in variant.messages.values():
            if not message.plan.is_flat or message.transport is not None:
                continue
            for found in drawn(message, proof_lengths(message)[0], 25):
                parts = message.identifier.match((found.key or 0) & 0x1FFF_FFFF)
                assert parts is not None
                got = meaning(message, found.data, parts, raw=True, key=found.key)
                want = w.by_reference(message, w.image_of(message, found))
                assert w.text_of(w.plain_meaning(got)) == w.text_of(want), (message.name, found)


@pytest.mark.slow
def test_columns_and_c_read_what_the_decoder_reads() -> None:
    """Of a small protocol all columns, and of another some messages' exported C, agree on all values of each field."""
    variant = load_protocol("pololu_qik").variant()
    columns = [check_columns(variant, message) for message in variant.messages.values()]
    assert {one.status for one in columns if one is not None} <= {"bounded", "sampled"}
    in_c = list(islice(check_c(load_protocol("damiao").variant()), 4))
    assert {one.status for one in in_c} <= {"bounded", "sampled", "unknown"}


def test_a_failed_proof_prints_and_saves_its_witness(
    aces: Aces, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a fault planted in a generated decoder: the frame annotated, what scanner and reference say, and a capture."""
    (fault,) = planted(("damiao",), of_text, 5, 3)[:1]
    monkeypatch.setattr(run, "decoders", lambda variant, name: [(fault.function, fault.raw, False)])
    name = fault.message.name
    found = aces("spec", "prove", "damiao", "--message", name, "--witnesses", str(tmp_path))
    assert found.status == 1
    assert f"{name}: refuted, decode" in found.out
    for part in ("  witness: ", "  scanner:   ", "  reference: ", ": refuted "):
        assert part in found.out
    (capture,) = tmp_path.iterdir()
    assert name in aces("decode", "-p", "damiao", str(capture), "--direction", "both").out


LOSSY = """
from construct import Int16ul, Struct
from aces_bus.protocol import Protocol, Quantity
lossy = Protocol("lossy", link="can", source="a test")
payload = Struct("a" / Int16ul, "x" / Quantity(Int16ul, scale=1e-20, offset=1.0))
lossy.message("M", id=0x10, payload=payload, source="a test")
"""


def test_a_scale_that_loses_a_raw_value_has_a_witness(aces: Aces, tmp_path: Path) -> None:
    """The frame in which the field has the raw value that does not come back."""
    spec = tmp_path / "lossy.py"
    spec.write_text(LOSSY, encoding="utf-8")
    found = aces("spec", "prove", str(spec), "--witnesses", str(tmp_path / "w"))
    assert found.status == 1
    assert "scale: x: raw 1 does not come back (nearest)" in found.out
    assert (tmp_path / "w" / "lossy_M.log").read_text(encoding="utf-8").rstrip().endswith("010#00000100")
