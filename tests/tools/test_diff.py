"""`aces diff`: what is compared with what, what is printed, and what is refused."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from aces_tools.reading import traffic

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


@pytest.fixture
def states(arm: str, tmp_path: Path) -> tuple[Path, Path, str]:
    """Two boards for 2 s; in the second recording board 1 is hot and in torque, turns further, and something else speaks."""
    paths = tmp_path / "a.log", tmp_path / "b.log"
    for path in paths:
        lines: list[str] = []
        for n in range(200):
            is_on = path is paths[1] and 50 <= n < 150
            for board in (1, 2):
                mine = is_on and board == 1
                angle = (2000 if mine else n % 20).to_bytes(2, "big").hex()
                lines.append(
                    f"({1000 + n / 100:.6f}) can0 {0x300 + board:03X}#{2 * mine:02X}{mine:02X}{angle}00000000"
                )
            if is_on:
                lines.append(f"({1000 + n / 100 + 0.001:.6f}) can0 7AA#00")
        path.write_text("\n".join(lines) + "\n")
    return *paths, arm


def test_a_selection_keeps_to_messages_and_records(aces: Aces, states: tuple[Path, Path, str]) -> None:
    """`-m` and `--where` as of decode: messages in any case and with *, conditions on their fields; frames that are not
    decoded are left out."""
    a, b, arm = states
    hot = [("changes", "State[board=1]", "mode"), ("changes", "State[board=1]", "error.hot")]
    call = a, b, "-p", arm
    assert ("appears", "7AA", "") in changes(aces, *call)
    assert changes(aces, *call, "-m", "st*")[:2] == hot
    assert changes(aces, *call, "--where", "board=1")[:2] == hot
    assert changes(aces, *call, "-m", "State", "--where", "board=2") == []
    assert changes(aces, *call, "--where", "mode=torque") == [("appears", "State[board=1]", "")]
    result = aces("diff", *call, "--where", "board=1")
    assert result.out.splitlines()[0] == "A  a.log: 200 messages in 1.99 s"
    (first, *_) = json.loads(aces("diff", *call, "--json", "-m", "State").out)["changes"]
    assert (first["message"], first["device"]) == ("State", {"board": "1"})


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-m", "State"], "--message needs a protocol: -p NAME"),
        (["--where", "board=1"], "--where needs a protocol"),
        (["-p", "ARM", "-m", "Stat"], "no message named 'Stat'"),
        (["-p", "ARM", "--where", "bord=1"], "no field named 'bord'"),
        (
            ["-p", "ARM", "--where", "board=3"],
            "nothing is compared: no message is what -m and --where ask for",
        ),
        (["--filter", "123:7FF"], "nothing is compared: no frame passes --filter"),
    ],
)
def test_a_selection_of_nothing_is_refused(
    arguments: list[str], said: str, aces: Aces, states: tuple[Path, Path, str]
) -> None:
    """And is not `no difference`."""
    a, b, arm = states
    result = aces("diff", a, b, *(arm if one == "ARM" else one for one in arguments))
    assert result.status == 2
    assert said in result.err
    assert len(result.err.splitlines()) == 1


def test_a_filter_may_keep_to_what_one_side_has(aces: Aces, states: tuple[Path, Path, str]) -> None:
    """A was looked at all the time: that it has none of these frames tells as much as without the filter."""
    a, b, _ = states
    (found,) = json.loads(aces("diff", a, b, "--json", "--filter", "7AA:7FF").out)["changes"]
    assert (found["kind"], found["score"]) == ("appears", 1.0)


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_signals_that_change_have_lanes(
    aces: Aces, states: tuple[Path, Path, str], tmp_path: Path, suffix: str
) -> None:
    """Numbers with their range and unit, names as levels, flags, and how often messages came; of two files, and of one."""
    pytest.importorskip("matplotlib")
    a, b, arm = states
    path = tmp_path / f"diff.{suffix}"
    result = aces("diff", a, b, "-p", arm, "-o", path)
    assert (result.status, result.messages) == (1, [])
    first = path.read_bytes()
    if suffix == "svg":
        for label in (
            "State[board=1]  mode",
            "torque",
            "State[board=1]  error.hot",
            "State[board=1]  angle (°)",
            "20",
        ):
            assert f"<!-- {label} -->".encode() in first
    assert aces("diff", a, b, "-p", arm, "-o", path).status == 1
    assert path.read_bytes() == first
    only = aces("diff", b, "--b", "0.5..1.5", "-p", arm, "-m", "State", "--where", "mode=torque", "-o", path)
    assert (only.status, only.messages) == (1, [])
    if suffix == "svg":
        assert "<!-- State[board=1]  appears -->" in path.read_text()


@pytest.mark.slow
def test_lanes_of_a_line_count_bytes_or_seconds(aces: Aces, tmp_path: Path) -> None:
    """A recording without times has its bytes for an axis."""
    pytest.importorskip("matplotlib")
    data = (ROOT / "examples/captures/adc.bin").read_bytes()
    short, path = tmp_path / "short.bin", tmp_path / "diff.svg"
    short.write_bytes(data[:80])
    assert aces(
        "diff", short, ROOT / "examples/captures/adc.bin", "-p", "minihubo_adc", "--least", "0", "-o", path
    ).status
    text = path.read_text()
    assert "<!-- Sample  channels.0" in text
    assert "<!-- byte -->" in text


def test_an_empty_side_is_said(aces: Aces, car: Path, tmp_path: Path) -> None:
    """Of a recording of nothing all of the other is new; that is likely to be a wrong file."""
    empty = tmp_path / "empty.log"
    empty.write_text("# candump of nothing\n")
    result = aces("diff", empty, car)
    assert result.status == 1
    assert result.messages == ["empty.log holds nothing to compare, so that all of the other is new or gone"]


def test_what_there_is_no_room_for_is_said(
    aces: Aces, car: Path, marks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Identifiers are counted one by one up to a limit: it is not hidden that there are more."""
    monkeypatch.setattr(traffic, "MOST_IDENTIFIERS", 1)
    result = aces("diff", car, "--marks", marks)
    said = (
        "car.log, pressed: 90 frames or messages are not compared: there are too many identifiers or devices"
    )
    assert result.messages == [said]


@pytest.mark.slow
def test_a_line_whose_bytes_do_not_tell_needs_its_direction(aces: Aces) -> None:
    """As of decode: which way they went; replies find their requests."""
    session = ROOT / "examples/captures/robotis_session.bin"
    refused = aces("diff", session, session, "-p", "robotis")
    assert (refused.status, "say which way they went: --direction" in refused.err) == (2, True)
    same = aces("diff", session, session, "-p", "robotis", "--direction", "both")
    assert (same.status, same.out.splitlines()[-1]) == (0, "no difference")


@pytest.mark.slow
def test_streams_need_a_protocol(aces: Aces) -> None:
    """By name, with what to do; with one, messages are compared."""
    adc = ROOT / "examples" / "captures" / "adc.bin"
    refused = aces("diff", adc, adc)
    assert refused.status == 2
    assert "no identifiers to compare: name the protocol" in refused.err
    assert aces("diff", adc, adc, "-p", "minihubo_adc", "--least", "0").status == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["car.log"], "say when B is"),
        (["car.log", "car.log", "car.log"], "these are 3"),
        (["-", "-"], "standard input is read once"),
        (["car.log", "--b", "12"], "--b '12' is not a range of time; write START..STOP"),
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
        (["empty.log", "empty.log"], "nothing is compared: empty.log holds nothing"),
        (["car.log", "car.log", "-o", "car.txt"], "the suffix says the format"),
    ],
)
def test_a_wrong_call_is_refused(
    arguments: list[str], said: str, aces: Aces, car: Path, marks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one line, with what would work, and status 2."""
    monkeypatch.chdir(car.parent)
    Path("empty.log").write_text("# candump of nothing\n")
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
