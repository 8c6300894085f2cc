"""The recordings that ship with the examples hold what is said of them, and their script makes exactly these."""

from __future__ import annotations

import json
import runpy
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from aces_bus import Unknown, open_recording
from aces_protocols.hubo.spec import hubo
from aces_protocols.minihubo_adc.spec import minihubo_adc
from aces_protocols.robotis.spec import robotis

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FOLDER = EXAMPLES / "captures"
PROTOCOLS = {"hubo": hubo, "minihubo_adc": minihubo_adc, "robotis": robotis}
EXPECTED: Mapping[str, Mapping[str, Any]] = json.loads((FOLDER / "expected.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", EXPECTED)
def test_a_recording_holds_what_is_said_of_it(name: str) -> None:
    """Messages, and the bins that bytes or frames fall into, are those that were counted when it was written."""
    wanted = EXPECTED[name]
    protocol = PROTOCOLS[wanted["protocol"]]
    scanner: Any = protocol.scanner(direction=wanted["direction"], include_unknown=True)
    capture = open_recording(FOLDER / name, link="can" if protocol.link == "can" else "serial")
    found: list[Any] = []
    for piece in capture:
        found += scanner.feed([piece]) if protocol.link == "can" else scanner.feed(piece.data)
    if protocol.link != "can":
        found += scanner.close()
    assert capture.lines_unreadable == 0
    records = [item for item in found if not isinstance(item, Unknown)]
    assert dict(Counter(type(r).__name__ for r in records)) == wanted["messages"]
    bins = ("total", "decoded", "unknown", "malformed", "skipped", "pending", "errors", "records")
    assert {b: getattr(scanner.counts, b) for b in bins if b in wanted} == {
        b: wanted[b] for b in bins if b in wanted
    }
    assert scanner.counts.balance == 0


def test_every_recording_is_described() -> None:
    """No file lies among the recordings that nothing is said of."""
    assert {p.name for p in FOLDER.iterdir()} == {*EXPECTED, "expected.json"}


def test_the_script_makes_these_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recordings can be made again, byte for byte: `python examples/make_captures.py`."""
    monkeypatch.setattr(sys, "argv", ["make_captures.py", str(tmp_path)])
    runpy.run_path(str(EXAMPLES / "make_captures.py"), run_name="__main__")
    assert {p.name for p in tmp_path.iterdir()} == {p.name for p in FOLDER.iterdir()}
    differ = [p.name for p in FOLDER.iterdir() if (tmp_path / p.name).read_bytes() != p.read_bytes()]
    assert differ == []
    assert "adc.bin: 4008 bytes" in capsys.readouterr().out


def test_the_hex_dump_holds_the_same_bytes() -> None:
    """The vendor's hex dump and the raw recording are one session."""
    capture = open_recording(FOLDER / "robotis_session.dxconf.txt", link="serial")
    assert b"".join(chunk.data for chunk in capture) == (FOLDER / "robotis_session.bin").read_bytes()
