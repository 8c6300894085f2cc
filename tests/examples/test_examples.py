"""Each example runs and prints what its comments promise."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "examples"
Run = Callable[..., list[str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """`run(name, *arguments)` runs an example as a program and gives the lines that it prints."""

    def program(name: str, *arguments: str) -> list[str]:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(FOLDER / name), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return program


def test_every_example_is_run_here() -> None:
    """No example is left to rot."""
    tested = {"decode_capture.py", "encode_packet.py", "make_captures.py", "own_spec.py"}
    assert {path.name for path in FOLDER.glob("*.py")} == tested


def test_a_spec_of_ones_own(run: Run) -> None:
    """A spec of ten lines encodes, decodes, says why a frame is none of its messages, and refuses what does not fit."""
    frame, *records = run("own_spec.py")
    assert frame.split()[-1] == "a5"
    assert records == [
        "Weight(node=3, weight=12.5, state={stable}) stable",
        "malformed: length 2, Weight has 5 bytes d430",
        "unknown ",
        "total=3 decoded=1 unknown=1 malformed=1 records=1",
        "Tare: node: 16 is not one of 1…15",
    ]


def test_encoding(run: Run) -> None:
    """The three ways of sending a goal give the bytes of the manual's layout."""
    assert run("encode_packet.py") == [
        "FF FF 01 05 03 1E F6 01 E1",
        "FF FF 01 05 03 1E F6 01 E1",
        "FF FF FE 0A 83 1E 02 47 10 02 60 00 02 99",
        "register goal_position: 301 ° is outside 0…300 °",
    ]


def test_decoding_a_capture(run: Run) -> None:
    """A servo's answers come out in degrees and rpm, an overload by its name; either file format will do."""
    *lines, counts = run("decode_capture.py")
    assert lines[0].split() == ["119", "88.0", "°", "0.0", "rpm"]
    assert len(lines) == 31
    assert [line.split()[-1] for line in lines if not line.endswith("rpm")] == ["overload"]
    assert counts == "total=1627 decoded=1601 unknown=6 malformed=1 skipped=14 pending=5 records=144"
    raw = str(FOLDER / "captures" / "robotis_session.bin")
    assert run("decode_capture.py", raw) == [*lines, counts]
    assert len(run("decode_capture.py", raw, "1")) == 32
