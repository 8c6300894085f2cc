"""`aces spec guess`: a recording in, a report and a draft out."""

from __future__ import annotations

import gzip
import json
from math import sin
from pathlib import Path
from typing import Any

import pytest

from tests.tools.conftest import Aces


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A recording of two messages: a counter with a number, and one byte."""
    path = tmp_path / "drive.log"
    lines = [
        f"({100 + number / 100:.6f}) can0 123#{number & 15:02X}{int(20000 + 9000 * sin(number / 30)):04X}"
        for number in range(300)
    ]
    lines += [f"(104.{number:06d}) can0 3A0#{number // 9:02X}" for number in range(40)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_draft_is_written_that_decodes_and_passes(aces: Aces, drive: Path, tmp_path: Path) -> None:
    """From a recording to a spec to records, with the commands that the note names."""
    draft = tmp_path / "draft.py"
    result = aces("spec", "guess", drive, "--no-known", "-o", draft)
    assert result.status == 0
    assert "123  300 frames, every 10 ms ± " in result.out
    assert "next: aces decode" in result.err
    decoded = aces("decode", drive, "-p", draft, "--format", "jsonl")
    assert decoded.summary["decoded"] == decoded.summary["frames"] == 340
    assert decoded.objects[5]["fields"]["counter_0_0"] == 5
    assert aces("spec", "check", draft, "--for", "0", "--against", drive).status == 0
    again = aces("spec", "guess", drive, "--no-known", "-o", draft)
    assert (again.status, "is there already" in again.err) == (2, True)
    assert aces("spec", "guess", drive, "--no-known", "-o", draft, "--force").status == 0


def test_all_of_it_as_json(aces: Aces, drive: Path) -> None:
    """Numbers as numbers, bits as places."""
    result = aces("spec", "guess", drive, "--no-known", "--json")
    found: dict[str, Any] = json.loads(result.out)
    first = found["messages"][0]
    assert (found["link"], found["frames"], first["identifiers"], first["lengths"]) == (
        "can",
        340,
        [0x123],
        [3],
    )
    assert first["period_ms"] == pytest.approx(10)
    assert [(one["kind"], one["start"], one["length"], one["order"]) for one in first["fields"]] == [
        ("counter", 0, 4, "little"),
        ("constant", 4, 4, "little"),
        ("number", 16, 16, "big"),
    ]


def test_several_recordings_are_one_bus(aces: Aces, drive: Path) -> None:
    """Messages of all of them, each once."""
    result = aces("spec", "guess", drive, drive, "--no-known", "--json")
    assert [one["frames"] for one in json.loads(result.out)["messages"]] == [600, 80]


def test_what_is_known_is_said_and_no_draft_is_written(
    aces: Aces, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the command that decodes it."""
    monkeypatch.setattr("aces_bus.protocol.fitting.list_protocols", lambda: ["hubo"])
    path, draft = tmp_path / "walk.log", tmp_path / "draft.py"
    path.write_text("".join(f"({number}.0) can0 063#{number:02X}000000FCFFFFFF\n" for number in range(20)))
    result = aces("spec", "guess", path, "-o", draft)
    assert result.status == 0
    assert "100% is hubo" in result.out
    assert f"  aces decode {path} -p hubo" in result.out
    assert result.messages[0].startswith("no draft was written: the recording is hubo")
    assert not draft.exists()


@pytest.mark.parametrize("text", ["", "no recording\n"])
def test_what_is_no_recording_is_one_line(aces: Aces, tmp_path: Path, text: str) -> None:
    """And no draft."""
    path, draft = tmp_path / "empty.log", tmp_path / "draft.py"
    path.write_text(text)
    result = aces("spec", "guess", path, "-o", draft, "--no-known")
    assert result.status in (0, 2)
    assert len(result.messages) == 1
    assert not draft.exists()


def test_a_wrong_suffix_is_refused(aces: Aces, drive: Path) -> None:
    """A draft is a Python file."""
    result = aces("spec", "guess", drive, "-o", "draft.dbc")
    assert (result.status, ".py" in result.err) == (2, True)


def test_what_a_damaged_recording_holds_is_guessed_nevertheless(aces: Aces, tmp_path: Path) -> None:
    """A packed log that was cut off: what it holds, and exit 2; an empty one is not a recording."""
    lines = "".join(f"({n / 100:.6f}) can0 123#{n % 256:02X}{n * 7919 % 65536:04X}\n" for n in range(4000))
    cut = tmp_path / "cut.log.gz"
    cut.write_bytes(gzip.compress(lines.encode())[:15000])
    result = aces("spec", "guess", cut, "--no-known")
    assert result.status == 2
    assert "ends too early" in result.err
    assert "counter_0" in result.out
    (tmp_path / "empty.log").touch()
    result = aces("spec", "guess", tmp_path / "empty.log")
    assert (result.status, result.out) == (2, "")
    assert "nothing to guess" in result.err
