"""`aces decode --jobs`: several processes give what one gives."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from aces_bus.recordings import open as parts
from aces_tools import decode_jobs
from aces_tools.main import main
from tests.limits import small_disk

pytest.importorskip("pyarrow")
from pyarrow import parquet

HUBO = Path(__file__).parents[2] / "examples" / "captures" / "hubo2plus.log"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log of five thousand lines, with unreadable lines, comments and two channels."""
    lines = HUBO.read_bytes().splitlines(keepends=True)
    path = tmp_path / "walk.log"
    with path.open("wb") as file:
        for number in range(4):
            part = [line.replace(b"can0", b"can1") if number % 3 == 0 else line for line in lines]
            part.insert(40 * number + 7, b"nonsense %d\n" % number)
            part.insert(11, b"# a remark\n")
            file.writelines(part)
    return path


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces small enough that the log has many."""
    monkeypatch.setattr(decode_jobs, "PIECE", 30_000)
    monkeypatch.setattr(decode_jobs, "WORTH", 0)
    monkeypatch.setattr(parts, "LEAST", 10_000)


def decoded(log: Path, out: Path, *more: str, capfd: Any) -> tuple[int, list[str], dict[str, list[Any]]]:
    """Exit status, what was said, and the rows of each message."""
    capfd.readouterr()
    status = main(["decode", str(log), "-p", "hubo", "-o", str(out), *more])
    said = capfd.readouterr().err.splitlines()
    names = [path.name for path in out.iterdir() if not path.name.startswith(".")] if out.is_dir() else []
    if any(name.startswith("part-") for name in names) or out.is_file():
        return status, said, {"": parquet.read_table(out).to_pylist()}
    return status, said, {name: parquet.read_table(out / name).to_pylist() for name in sorted(names)}


@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    [
        (),
        ("--strict",),
        ("--filter", "can1,060:7F0"),
        ("--filter", "can7,060:7F0"),
        ("--from", "0.2", "--to", "0.45"),
        ("--message", "Encoder"),
        ("--message", "ForceTorque", "--where", "mx>1"),
        ("--signals", "Enc*.position.0", "--names", "--float32"),
        ("--unknown", "show"),
    ],
)
def test_two_processes_give_what_one_gives(
    log: Path, tmp_path: Path, more: tuple[str, ...], capfd: Any
) -> None:
    """Rows, bins, complaints with their line numbers, exit status."""
    one = decoded(log, tmp_path / "one.parquet", *more, capfd=capfd)
    two = decoded(log, tmp_path / "two.parquet", *more, "--jobs", "2", capfd=capfd)
    assert two[1] == one[1]
    assert two[0] == one[0]
    assert {name: sorted(map(repr, rows)) for name, rows in two[2].items()} == {
        name: sorted(map(repr, rows)) for name, rows in one[2].items()
    }
    assert one[2] or "can7,060:7F0" in more


@pytest.mark.slow
def test_parts_are_in_order(log: Path, tmp_path: Path, capfd: Any) -> None:
    """Read by name, the parts of a message are the message, in the order of the capture."""
    one = decoded(log, tmp_path / "one.parquet", capfd=capfd)[2]
    out = tmp_path / "two.parquet"
    decoded(log, out, "--jobs", "2", capfd=capfd)
    for name in ("Encoder.parquet", "ForceTorque.parquet", "Reference.parquet"):
        found = sorted((out / name).iterdir())
        assert len(found) > 3
        assert [row for part in found for row in parquet.read_table(part).to_pylist()] == one[name]


@pytest.mark.slow
def test_a_small_recording_among_large_ones_is_decoded_here(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    """No process is started for it, and its parts have their place in the order of the files."""
    few = tmp_path / "few.log"
    few.write_bytes(HUBO.read_bytes()[:4000])
    monkeypatch.setattr(decode_jobs, "WORTH", 10_000)
    found: list[list[Any]] = []
    for jobs in ("1", "2"):
        out = tmp_path / f"{jobs}.parquet"
        more = (str(log), str(few), str(few), "--message", "Encoder", "--jobs", jobs)
        assert decoded(few, out, *more, capfd=capfd)[0] == 0
        found.append([row for part in _parts(out) for row in parquet.read_table(part).to_pylist()])
    assert found[0] == found[1]

    monkeypatch.setattr(decode_jobs, "ProcessPoolExecutor", None)
    assert decoded(few, tmp_path / "few.parquet", "--jobs", "2", capfd=capfd)[0] == 0


def _parts(out: Path) -> list[Path]:
    return sorted(out.iterdir()) if out.is_dir() else [out]


@pytest.mark.slow
def test_other_formats_are_read_here_and_decoded_there(log: Path, tmp_path: Path, capfd: Any) -> None:
    """A packed log cannot be entered in its middle; the answer is the same."""
    import gzip

    packed = tmp_path / "walk.log.gz"
    packed.write_bytes(gzip.compress(log.read_bytes()))
    one = decoded(packed, tmp_path / "one.parquet", capfd=capfd)
    two = decoded(packed, tmp_path / "two.parquet", "--jobs", "2", capfd=capfd)
    assert two[:2] == one[:2]
    assert {n: len(rows) for n, rows in two[2].items()} == {n: len(rows) for n, rows in one[2].items()}


@pytest.mark.slow
def test_an_earlier_output_is_replaced(log: Path, tmp_path: Path, capfd: Any) -> None:
    """Whole at once, whether parts or files stood there; other folders are left alone."""
    out = tmp_path / "walk.parquet"
    few = "--jobs", "2", "--message", "Encoder"
    for more in (few, few[2:], ("--jobs", "2"), few):
        assert decoded(log, out, *more, capfd=capfd)[0] == 0
    assert all(path.name.startswith("part-") for path in out.iterdir())
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []
    mine = tmp_path / "mine.parquet"
    mine.mkdir()
    (mine / "letter.txt").write_text("dear")
    assert main(["decode", str(log), "-p", "hubo", "-o", str(mine), "--jobs", "2"]) == 2
    assert "holds other files (letter.txt)" in capfd.readouterr().err
    assert (mine / "letter.txt").read_text() == "dear"


def test_what_cannot_be_shared_is_said(log: Path, tmp_path: Path, capfd: Any) -> None:
    """Formats that are one file, text, and no process at all."""
    for more, wanted in (
        (("-o", str(tmp_path / "a.sqlite"), "--jobs", "2"), "written by one process"),
        (("--jobs", "2"), "--jobs is for tables"),
        (("-o", str(tmp_path / "a.parquet"), "--jobs", "-1"), "is not a whole number from 0 on"),
    ):
        assert main(["decode", str(log), "-p", "hubo", *more]) == 2
        assert wanted in capfd.readouterr().err
    assert list(tmp_path.glob("a.*")) == []


def test_a_full_disk_is_said_once(log: Path, tmp_path: Path, capfd: Any) -> None:
    """Whichever process meets it, the error names the output, ends the run, and leaves nothing."""
    out = tmp_path / "out.parquet"
    with small_disk(1000):
        status, said, found = decoded(log, out, "--jobs", "2", capfd=capfd)
    assert (status, found) == (2, {})
    assert [line for line in said if "written" in line] == [f"aces: {out}: cannot be written: File too large"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["walk.log"]


@pytest.mark.slow
def test_frames_without_a_time_are_told_of(log: Path, tmp_path: Path, capfd: Any) -> None:
    """As by one process, also those that hang on requests."""
    found = re.findall(r"(can\d) ([0-9A-F]+)#((?:[0-9A-F]{2})+)\n", log.read_text())
    log.write_text(
        "".join(
            f"{bus} {key} [{len(data) // 2}] {bytes.fromhex(data).hex(' ')}\n" for bus, key, data in found
        )
    )
    one = decoded(log, tmp_path / "one.parquet", "--from", "0", capfd=capfd)
    two = decoded(log, tmp_path / "two.parquet", "--from", "0", "--jobs", "2", capfd=capfd)
    assert "items have none, and are filtered" in one[1][0]
    assert two[:2] == one[:2]
