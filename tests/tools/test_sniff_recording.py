"""`aces sniff --record`: any format, never over a file, whole when it ends, and as much as can be when it is killed."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from aces_bus import open_recording
from aces_bus.recordings.write.candump import CandumpWriter
from tests.limits import small_disk
from tests.tools.live import Node, Opened, posix

Aces = Callable[..., Any]
#: The short profile leaves out what differs little from another case: Ctrl-C ends it in this process too.
IS_LONG = settings().max_examples > 100
pytestmark = pytest.mark.usefixtures("quick")


@pytest.mark.parametrize("name", ["walk", "walk.log", "walk.blf", "walk.asc.gz", "walk.pcapng"])
def test_recordings_of_any_format(aces: Aces, node: Node, opened: Opened, tmp_path: Path, name: str) -> None:
    """The suffix says the format, and nothing else stays behind."""
    opened.then(node.walk)
    record = tmp_path / name
    found = aces("sniff", *node.options, "-n", 5, "-q", "--record", record)
    assert found.status == 0
    frames = list(open_recording(record, link="can"))
    assert [frame.arbitration_id for frame in frames] == [0x060, 0x300, 0x060, 0x7FE, 0x061]
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert f"recorded 5 frames in {record}" in found.messages


def test_a_recording_is_never_written_over(aces: Aces, node: Node, tmp_path: Path) -> None:
    """A file that is there stays, and so does what a run that was killed has left."""
    record = tmp_path / "walk.log"
    record.write_text("precious")
    found = aces("sniff", *node.options, "--record", record)
    assert found.status == 2
    assert "there is such a file already" in found.err
    left = tmp_path / "walk.mf4.log"
    left.write_text("precious")
    found = aces("sniff", *node.options, "--record", tmp_path / "walk.mf4")
    assert found.status == 2
    assert "cut short; convert it first" in found.err
    assert record.read_text() == left.read_text() == "precious"


def test_a_bus_that_cannot_be_opened_leaves_no_recording(aces: Aces, node: Node, tmp_path: Path) -> None:
    """No empty file of a run that never began."""
    record = tmp_path / "walk.log"
    found = aces("sniff", "-i", "aces", "-c", node.channel, "--record", record)
    assert found.status == 2
    assert f"{node.channel} (interface aces) cannot be opened" in found.err
    assert not record.exists()


def test_a_recording_that_fails_ends_the_run(
    aces: Aces, node: Node, opened: Opened, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk is said, at once, and is not a success."""

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(CandumpWriter, "write", full)
    opened.then(node.walk)
    found = aces("sniff", *node.options, "--record", tmp_path / "walk.log")
    assert found.status == 2
    assert "recording stopped: No space left on device" in found.err


def test_a_database_that_fails_ends_the_run(
    aces: Aces, node: Node, opened: Opened, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite's own errors are an end like any other, said with the file."""
    monkeypatch.setattr(
        "aces_bus.recordings.write.canlog.CanlogSqliteWriter.INSERT", "INSERT INTO lost VALUES (?)"
    )
    opened.then(node.walk)
    record = tmp_path / "walk.db"
    found = aces("sniff", *node.options, "--record", record)
    assert found.status == 2
    assert f"recording stopped: {record}: cannot be written: no such table: lost" in found.err


@pytest.mark.parametrize("size", [0, *([100] if IS_LONG else []), 200])
def test_what_a_full_disk_took_is_counted(
    aces: Aces, node: Node, opened: Opened, tmp_path: Path, size: int
) -> None:
    """The frames said to be recorded are those in the file, whole; with those said to be missing they are all."""
    opened.then(node.walk)
    record = tmp_path / "walk.log"
    with small_disk(size):
        found = aces("sniff", *node.options, "--record", record)
    assert found.status == 2
    assert "recording stopped: File too large" in found.err
    said = re.search(r"recorded (\d+) frames in (\S+), (\d+) are not in it", found.err)
    assert said is not None
    assert said[2] == str(record)
    assert int(said[1]) + int(said[3]) == found.summary["frames"]
    data = record.read_bytes()
    assert data.count(b"\n") == int(said[1])
    assert (int(said[1]) > 0) is (size > 0)
    assert data[-1:] in (b"", b"\n")


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """`running("-n", "5")`: sniffs a replay that goes on for ever at 1,000 frames/s."""
    log = tmp_path / "loop.log"
    log.write_text("".join(f"({n / 1000:.6f}) can0 {n:03X}#{n:04X}\n" for n in range(1000)))
    started: list[subprocess.Popen[bytes]] = []

    def run(*arguments: object) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [
                *(sys.executable, "-m", "aces_tools", "sniff", "-i", "aces-replay", "-c", str(log)),
                *("--bus-kwargs", "loop=true", *map(str, arguments)),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        alarm = threading.Timer(60, process.kill)
        alarm.daemon = True
        alarm.start()
        started.append(process)
        return process

    yield run
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.slow
@posix
def test_kill_9_loses_less_than_a_second(
    running: Callable[..., subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    """Of a recording into any format, all but the last second is there after SIGKILL, and can be read."""
    record = tmp_path / "walk.mf4"
    process = running("--record", record, "--format", "jsonl")
    assert process.stdout is not None
    shown = [json.loads(process.stdout.readline()) for _ in range(1300)]
    process.send_signal(signal.SIGKILL)
    process.wait()
    with open_recording(f"{record}.log", link="can") as capture:
        kept = list(capture)
        assert capture.lines_unreadable <= 1
    assert len(kept) >= len(shown) - 1000
    assert len(kept) >= 300
    pairs = zip(kept, shown, strict=False)
    assert all(frame.arbitration_id == one["id"] and frame.data.hex() == one["raw"] for frame, one in pairs)


@pytest.mark.slow
@posix
@pytest.mark.parametrize("number", [*([signal.SIGINT] if IS_LONG else []), signal.SIGTERM])
def test_signals_end_it_with_a_whole_recording(
    running: Callable[..., subprocess.Popen[bytes]], tmp_path: Path, number: int
) -> None:
    """Ctrl-C and `kill` end it: the summary is printed, and the recording is in its format."""
    record = tmp_path / "walk.blf"
    process = running("--record", record)
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(number)
    shown = 1 + len(process.stdout.read().splitlines())
    assert process.stderr is not None
    assert b"frames=%d " % shown in process.stderr.read().splitlines()[-1]
    assert process.wait() == 0
    assert len(list(open_recording(record, link="can"))) == shown


@pytest.mark.slow
@posix
def test_nobody_reads_any_more(running: Callable[..., subprocess.Popen[bytes]]) -> None:
    """`| head -1` ends it without a complaint."""
    process = running()
    assert process.stdout is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr is not None
    said = process.stderr.read()
    assert process.wait() == 0
    assert b"Traceback" not in said
    process.stdout = None
