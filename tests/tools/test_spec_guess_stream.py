"""`aces spec guess` on a serial line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.tools.conftest import Aces

SESSION = Path(__file__).resolve().parents[2] / "examples" / "captures" / "robotis_session.bin"


@pytest.mark.slow
def test_a_serial_line_becomes_a_draft_that_decodes_and_passes(aces: Aces, tmp_path: Path) -> None:
    """Framing, check and kinds of packets are said, and the draft reads what the installed protocol reads."""
    draft = tmp_path / "servo.py"
    result = aces("spec", "guess", SESSION, "--no-known", "-o", draft)
    assert result.status == 0
    assert "FF FF where the 145 packets before end, by the 8-bit number at byte 3 plus 4" in result.out
    assert "inverted sum, 8 bits of bytes 2 to -2" in result.out
    ours = aces("decode", SESSION, "-p", draft)
    known = aces("decode", SESSION, "-p", "robotis", "--direction", "both")
    assert ours.summary["records"] == 145
    assert ours.summary["decoded"] == known.summary["decoded"] + known.summary["unknown"]
    assert aces("spec", "check", draft, "--for", "0").status == 0
    found = json.loads(aces("spec", "guess", SESSION, "--no-known", "--json").out)
    assert found["framings"][0]["length"] == {"offset": 3, "width": 1, "order": "big", "constant": 4}


@pytest.mark.slow
def test_can_and_serial_are_not_guessed_together(aces: Aces, tmp_path: Path) -> None:
    """Two links are two guesses."""
    log = tmp_path / "drive.log"
    log.write_text("(1.000000) can0 123#01\n")
    result = aces("spec", "guess", log, SESSION)
    assert result.status == 2
    assert "serial line" in result.err
