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
    """With the command that decodes it, and exit 1: what was asked for is not there."""
    monkeypatch.setattr("aces_tools.reading.fitting.list_protocols", lambda: ["hubo"])
    path, draft = tmp_path / "walk.log", tmp_path / "draft.py"
    path.write_text("".join(f"({number}.0) can0 063#{number:02X}000000FCFFFFFF\n" for number in range(20)))
    result = aces("spec", "guess", path, "-o", draft)
    assert result.status == 1
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
    assert result.status in (1, 2)
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


def test_a_reference_names_its_field_in_the_draft(aces: Aces, drive: Path, tmp_path: Path) -> None:
    """With scale, offset and unit: the draft decodes what was measured."""
    measured, draft = tmp_path / "gps.csv", tmp_path / "draft.py"
    rows = [(100.12 + n / 100, int(20000 + 9000 * sin(n / 30)) * 0.01 - 200) for n in range(300)]
    measured.write_text("time,speed [m/s]\n" + "".join(f"{time:.3f},{value:.4f}\n" for time, value in rows))
    result = aces("spec", "guess", drive, "--reference", f"{measured}:speed", "-o", draft)
    assert result.status == 0
    assert "speed, 300 instants on the recording's clock, is the first of these." in result.out
    first = result.out.split("leaves\n")[1].splitlines()[0].split()
    assert first[:8] == ["123", "2.0…1.7", "u16", "big", "0.01", "-200", "m/s", "-120"]
    assert "speed" in result.out.split("every 10 ms")[1]
    decoded = aces("decode", drive, "-p", draft, "--format", "jsonl")
    assert decoded.objects[30]["fields"]["speed"] == pytest.approx(rows[30][1])
    assert decoded.summary["decoded"] == 340
    assert aces("spec", "check", draft, "--for", "0", "--against", drive).status == 0
    found = json.loads(aces("spec", "guess", drive, "--reference", f"{measured}:speed", "--json").out)
    assert found["reference"]["guesses"][0]["message"] == "123"


def test_a_reference_that_nothing_follows_is_said(aces: Aces, drive: Path, tmp_path: Path) -> None:
    """With exit 1: a program must not take a guess for it."""
    measured = tmp_path / "gps.csv"
    measured.write_text("time,v\n" + "".join(f"{100 + n / 10},{n * 7919 % 101}\n" for n in range(40)))
    result = aces("spec", "guess", drive, "--reference", f"{measured}:v")
    assert result.status == 1
    assert "v, 40 instants on the recording's clock, is in no field." in result.out


@pytest.mark.parametrize("more", [["--time-column", "t"], ["--unit", "m"], ["--delay", "1s"]])
def test_words_of_a_reference_need_one(aces: Aces, drive: Path, more: list[str]) -> None:
    """Else they would be ignored."""
    result = aces("spec", "guess", drive, *more)
    assert (result.status, "--reference" in result.err) == (2, True)


def test_a_bus_of_many_messages_is_a_summary(aces: Aces, tmp_path: Path) -> None:
    """Of forty lines at most; the draft has all of it."""
    path, draft = tmp_path / "many.log", tmp_path / "draft.py"
    lines = [
        f"({n / 100:.6f}) can0 {0x100 + 7 * key:03X}#{'00' * (key % 7)}{n * (key + 3) % 256:02X}"
        for n in range(20)
        for key in range(60)
    ]
    path.write_text("\n".join(lines) + "\n")
    result = aces("spec", "guess", path, "--no-known", "-o", draft)
    assert result.status == 0
    assert len(result.out.splitlines()) <= 40
    assert "fields and evidence: in the draft (-o draft.py); 23 more" in result.out
    assert draft.read_text().count(".message(") == 60


@pytest.mark.parametrize("stem", ["bits", "class", "this"])
def test_a_draft_of_any_name_loads(aces: Aces, drive: Path, tmp_path: Path, stem: str) -> None:
    """Its protocol hides nothing that it needs."""
    draft = tmp_path / f"{stem}.py"
    assert aces("spec", "guess", drive, "--no-known", "-o", draft).status == 0
    assert aces("decode", drive, "-p", draft).status == 0
