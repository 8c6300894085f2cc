"""`aces decode --cluster` and `aces fleet status`: the call, the summary, the exit status; what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from aces_lab.fleet import FleetProgress
from aces_lab.fleet.decode_verb import duration_text, progress_line
from aces_tools.main import main
from tests.fleet.recordings import needs_fleet, record, truck

needs_fleet()


def called(capfd: Any, *arguments: str) -> tuple[int, str, str]:
    """Status, standard output, standard error."""
    capfd.readouterr()
    status = main(list(arguments))
    out, err = capfd.readouterr()
    return status, out, err


def test_a_dataset_is_made_and_told_of(tmp_path: Path, capfd: Any) -> None:
    """The summary is that of one process; the second run does nothing; faults are named, and are status 2."""
    (tmp_path / "in").mkdir()
    for number in (0, 4):
        record(tmp_path / "in", number)
    dbc, lake, inputs = truck(tmp_path), str(tmp_path / "lake"), str(tmp_path / "in" / "*")
    call = ("decode", inputs, "-p", dbc, "-o", lake, "--cluster", "here")
    status, _, err = called(capfd, *call)
    assert status == 0
    assert err.startswith("frames=120 decoded=")
    status, _, err = called(capfd, *call)
    assert (status, err) == (0, "aces: 2 inputs stand as they were decoded before\n")
    status, out, _ = called(capfd, "fleet", "status", lake)
    assert status == 0
    assert out.startswith("2 inputs (2 done), ")
    assert "2 datasets: Brake, Speed" in out
    (tmp_path / "in" / "letter.txt").write_text("dear all\n")
    status, _, err = called(capfd, *call)
    assert status == 2
    assert "letter.txt: not a CAN capture" in err
    status, out, _ = called(capfd, "fleet", "status", lake, "--json")
    assert status == 1
    found = json.loads(out)
    assert found["states"] == {"done": 2, "unreadable": 1}
    assert found["total"]["can"]["total"] == 120


@pytest.mark.parametrize(
    ("more", "wanted"),
    [
        (("-o", "lake", "--cluster", "here", "--count", "1"), "--count is for lines"),
        (
            ("-o", "lake", "--cluster", "here", "--from", "14:05"),
            "a time of day is one of this machine's zone",
        ),
        (("-o", "lake", "--cluster", "here", "--jobs", "2"), "--jobs or --cluster"),
        (("--cluster", "here"), "--cluster writes folders of Parquet"),
        (("-o", "lake", "--cluster", "everywhere"), "is not a cluster; write here, local:4"),
        (("-o", "s3://lake/truck.parquet"), "URIs are for fleets: --cluster here"),
    ],
)
def test_what_is_refused(
    more: tuple[str, ...], wanted: str, tmp_path: Path, capfd: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one line, before anything is read."""
    monkeypatch.chdir(tmp_path)
    log = record(tmp_path, 0)
    status, _, err = called(capfd, "decode", str(log), "-p", truck(tmp_path), *more)
    assert status == 2
    assert wanted in err


def test_progress_says_rate_and_time_left() -> None:
    """In one line, in units for people."""
    progress = FleetProgress(10, 10_000_000, began=0.0)
    progress.done, progress.faulty, progress.bytes_done = 2, 1, 2_000_000
    assert progress_line(progress).startswith("2 of 10 inputs, ")
    assert "1 with faults" in progress_line(progress)
    assert progress_line(progress).endswith(" left")
    assert [duration_text(seconds) for seconds in (40, 720, 12_600, 181_440)] == [
        "40 s",
        "12 min",
        "3.5 h",
        "2.1 d",
    ]
