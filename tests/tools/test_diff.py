"""`aces diff`: what is compared with what, what is printed, and what is refused."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from .conftest import Aces

PRESSES = [(12.0, 13.5), (20.0, 21.0), (31.0, 33.0)]
ROOT = Path(__file__).resolve().parents[2]


def is_pressed(at: float) -> bool:
    return any(start <= at < stop for start, stop in PRESSES)


@pytest.fixture
def car(tmp_path: Path) -> Path:
    """40 s: a counter, a button's bit in 2A0, an identifier that is there while it is pressed."""
    lines: list[str] = []
    for n in range(4000):
        at = n / 100
        lines.append(f"({1700000000 + at:.6f}) can0 2A0#{n & 15:02X}{0x20 if is_pressed(at) else 0:02X}00")
        if is_pressed(at) and n % 5 == 0:
            lines.append(f"({1700000000 + at + 0.001:.6f}) can0 18FEF100#0102")
    path = tmp_path / "car.log"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def marks(tmp_path: Path) -> Path:
    """When the button was pressed and released."""
    path = tmp_path / "marks.txt"
    path.write_text(
        "# a button\n" + "".join(f"{start} pressed\n{stop} released\n" for start, stop in PRESSES)
    )
    return path


def changes(aces: Aces, *arguments: Any) -> list[tuple[str, str, str]]:
    """Kind, subject and place of each change."""
    found = json.loads(aces("diff", "--json", *arguments).out)["changes"]
    return [
        (
            one["kind"],
            one["subject"],
            one.get("signal") or (f"{one['byte']}:{one['bits']}" if "byte" in one else ""),
        )
        for one in found
    ]


BUTTON = [("appears", "18FEF100", ""), ("differs", "2A0", "1:[5]")]


def test_marks_find_the_button_and_only_it(aces: Aces, car: Path, marks: Path) -> None:
    """B is what the first mark names, A the rest; the report says in how many times the bit is set."""
    result = aces("diff", car, "--marks", marks)
    assert result.status == 1
    assert result.out.splitlines()[0] == "A  car.log, the rest: 3550 frames, 1 identifier in 35.46 s"
    assert result.out.splitlines()[1] == "B  car.log, pressed: 540 frames, 2 identifiers in 4.47 s"
    rows = [line.split(None, 3) for line in result.out.splitlines()[4:]]
    assert [row[1] for row in rows] == ["appears", "differs"]
    assert rows[1][3].split() == [
        "byte",
        "1",
        "bit",
        "5",
        "00",
        "20",
        "450",
        "of",
        "450,",
        "3",
        "of",
        "3",
        "times",
    ]
    assert result.summary == {
        "changes": 2,
        "less_telling": 0,
        "frames_a": 3550,
        "identifiers_a": 1,
        "frames_b": 540,
        "identifiers_b": 2,
        "lines_unreadable": 0,
    }


def test_times_say_the_same_as_marks(aces: Aces, car: Path, marks: Path) -> None:
    """Seconds from the first frame, since 1970, by name, by a pattern; of several B's; between two files."""
    assert changes(aces, car, "--marks", marks, "--a", "rel*", "--b", "PRESSED") == BUTTON
    assert changes(aces, car, *(part for a, b in PRESSES for part in ("--b", f"{a}..{b}"))) == BUTTON
    assert changes(aces, car, "--a", "0..12", "--b", "1700000012..1700000013.5") == BUTTON
    assert changes(aces, car, car, "--a", "..12", "--b", "12..13.5") == BUTTON


def test_a_mark_lasts_as_long_as_is_asked_for(aces: Aces, car: Path, tmp_path: Path) -> None:
    """Presses without releases."""
    marks = tmp_path / "presses.txt"
    marks.write_text("".join(f"{start} pressed\n" for start, _ in PRESSES))
    assert changes(aces, car, "--marks", marks, "--for", "1s", "--a", "0..12") == BUTTON


def test_nothing_differs(aces: Aces, car: Path) -> None:
    """The same file twice: no difference, exit status 0."""
    result = aces("diff", car, car, "--least", "0")
    assert (result.status, result.out.splitlines()[-1]) == (0, "no difference")
    assert json.loads(aces("diff", car, car, "--json").out)["changes"] == []


def test_what_is_hardly_telling_is_counted(aces: Aces, car: Path) -> None:
    """`--least` says how much is printed, and with it the exit status."""
    all_of_it = aces("diff", car, "--b", "12..13.5", "--a", "0..12", "--least", "0")
    some = aces("diff", car, "--b", "12..13.5", "--a", "0..12", "--least", "1")
    assert [line.split()[1] for line in some.out.splitlines()[4:]] == ["appears"]
    assert (some.summary["changes"], some.summary["less_telling"]) == (1, 1)
    assert (all_of_it.summary["changes"], all_of_it.summary["less_telling"]) == (2, 0)
    weak = aces("diff", car, "--a", "0..12", "--b", "12..13.5", "--filter", "2A0:7FF", "--least", "1")
    assert (weak.status, weak.summary["less_telling"]) == (0, 1)


def test_a_filter_keeps_to_some_identifiers(aces: Aces, car: Path, marks: Path) -> None:
    """As candump writes it."""
    assert changes(aces, car, "--marks", marks, "--filter", "2A0:7FF") == [BUTTON[1]]


def test_a_protocol_names_signals(aces: Aces, arm: str, tmp_path: Path) -> None:
    """Messages, devices and signals instead of identifiers and bytes; what is not of the protocol byte by byte."""
    paths = [tmp_path / "a.log", tmp_path / "b.log"]
    for path, position, other in zip(paths, (7, 1000), ("00", "01"), strict=True):
        path.write_text(
            "".join(
                f"({1000 + n / 100:.6f}) can0 061#{position.to_bytes(4, 'little').hex()}00000000\n"
                f"({1000 + n / 100:.6f}) can0 7AA#{other}\n"
                for n in range(50)
            )
        )
    assert changes(aces, *paths, "-p", arm) == [
        ("differs", "7AA", "0:[0]"),
        ("differs", "Encoder[board=1]", "position.0"),
    ]


@pytest.mark.slow
def test_streams_need_a_protocol(aces: Aces) -> None:
    """By name, with what to do; with one, messages are compared."""
    adc = ROOT / "examples" / "captures" / "adc.bin"
    refused = aces("diff", adc, adc)
    assert refused.status == 2
    assert "no identifiers to compare: say what is spoken" in refused.err
    assert aces("diff", adc, adc, "-p", "minihubo_adc", "--least", "0").status == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["car.log"], "say when B is"),
        (["car.log", "car.log", "car.log"], "these are 3"),
        (["-", "-"], "standard input is read once"),
        (["car.log", "--b", "12"], "--b '12' is no range of time; write START..STOP"),
        (["car.log", "--b", "13..12"], "its end 12 is not later than --b 13"),
        (["car.log", "--b", "50..60"], "nothing is in the times of --b"),
        (["car.log", "--b", "0..60"], "nothing is in what --b leaves of the recording"),
        (["car.log", "--marks", "none.txt"], "--marks none.txt: cannot be read: No such file"),
        (
            ["car.log", "--marks", "marks.txt", "--b", "held"],
            r"no mark is named 'held' (there are: pressed, released)",
        ),
        (["car.log", "car.log", "--marks", "marks.txt"], "--marks is for one recording"),
        (["car.log", "--b", "1..2", "--for", "1s"], "--for is for marks"),
        (["car.log", "--b", "1..2", "--least", "2"], "'2' is not a number from 0 to 1"),
        (["car.log", "none.log"], "none.log"),
        (["car.log", "car.log", "-o", "car.txt"], "the suffix says the format"),
    ],
)
def test_a_wrong_call_is_refused(
    arguments: list[str], said: str, aces: Aces, car: Path, marks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one line, with what would work, and status 2."""
    monkeypatch.chdir(car.parent)
    result = aces("diff", *arguments)
    assert result.status == 2
    assert said in result.err
    assert len(result.err.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_a_picture_has_a_lane_for_each_change(
    aces: Aces, car: Path, marks: Path, tmp_path: Path, suffix: str
) -> None:
    """Its labels are those of the report; the same call gives the same bytes."""
    pytest.importorskip("matplotlib")
    path = tmp_path / f"diff.{suffix}"
    assert aces("diff", car, "--marks", marks, "-o", path).status == 1
    first = path.read_bytes()
    if suffix == "svg":
        for label in ("2A0  byte 1 bit 5", "18FEF100  appears", "time in s"):
            assert f"<!-- {label} -->".encode() in first
    assert aces("diff", car, "--marks", marks, "-o", path).status == 1
    assert path.read_bytes() == first


def test_two_recordings_have_a_part_each(aces: Aces, car: Path, tmp_path: Path) -> None:
    """Side by side; and where no identifier differs nothing is drawn."""
    pytest.importorskip("matplotlib")
    short = tmp_path / "short.log"
    short.write_text("".join(car.read_text().splitlines(keepends=True)[:1000]))
    path = tmp_path / "diff.svg"
    assert aces("diff", short, car, "-o", path).status == 1
    assert "<!-- A  short.log -->" in path.read_text()
    assert "<!-- B  car.log -->" in path.read_text()
    path.unlink()
    same = aces("diff", car, car, "-o", path)
    assert same.status == 0
    assert not path.exists()


def test_a_pipe_is_compared_and_a_closed_one_is_no_error(car: Path) -> None:
    """Standard input is a recording; whoever reads only the first line is left alone."""
    command = [sys.executable, "-m", "aces_tools", "diff", "-", str(car)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(one for one in sys.path if one)}
    with car.open("rb") as file:
        done = subprocess.run(
            command, stdin=file, capture_output=True, env=environment, timeout=120, check=False
        )
    assert done.returncode == 0, done.stderr
    assert b"no difference" in done.stdout
