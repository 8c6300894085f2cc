"""`aces sniff -o`: the format that the suffix says, there after a kill, in one file or several, for foreign readers."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from aces_bus import Frame, FrameTable, decode, load_protocol, make_column_scanner, open_recording
from aces_bus.errors import CallerError
from aces_bus.export import open_export, recover_parts
from aces_tools.live_log import LiveRecording, LogSeries, PendingFile
from aces_tools.rotation import Rotation
from tests.tools.live import WAIT_S, Node, Opened

Aces = Callable[..., Any]
pytestmark = pytest.mark.usefixtures("quick")
FOREIGN = ["log", "asc", "blf", "trc", "csv", "db"]


def table(first: int, count: int) -> FrameTable:
    """Frames 1 ms apart, their data their number."""
    numbers = range(first, first + count)
    return FrameTable.from_frames(
        [Frame(n & 0x7FF, n.to_bytes(4), 1.7e9 + n / 1000, "can0", is_rx=True) for n in numbers]
    )


def numbers_of(path: Path) -> list[int]:
    """What python-can reads."""
    reader = can.LogReader(str(path))
    found = [int.from_bytes(message.data) for message in reader]
    reader.stop()
    return found


# ---------------------------------------------------------------------- as they grow


@pytest.mark.parametrize("suffix", [*FOREIGN, "pcapng", "gvret"])
def test_what_was_committed_reads_back_at_any_moment(tmp_path: Path, suffix: str) -> None:
    """A log that was never closed has every frame of each commit, to python-can and to us, and nothing else."""
    path = tmp_path / f"walk.{suffix}"
    log = LiveRecording(str(path), "can", "-o")
    sizes = []
    for first, count in [(0, 3), (3, 1), (4, 2000)]:
        log.write(table(first, count))
        log.commit()
        sizes.append(log.size)
        wanted = list(range(first + count))
        with open_recording(path, link="can") as capture:
            frames = list(capture)
            assert capture.lines_unreadable == 0, capture.problems
        assert [int.from_bytes(frame.data) for frame in frames] == wanted
        assert frames[-1].timestamp == pytest.approx(1.7e9 + wanted[-1] / 1000, abs=1e-5)
        if suffix in FOREIGN:
            assert numbers_of(path) == wanted
    assert sizes == sorted(sizes)
    log.write(table(0, 1))
    log.leave()  # what was not committed is not there
    with open_recording(path, link="can") as capture:
        assert len(list(capture)) == 2004


def test_a_write_that_fails_leaves_what_was_committed(tmp_path: Path) -> None:
    """A full disk takes nothing of a piece, and the file still reads back whole, header and all."""
    from tests.limits import small_disk

    path = tmp_path / "walk.blf"
    log = LogSeries(str(path), Rotation(), lambda name: LiveRecording(name, "can", "-o"), option="-o")
    log.write(table(0, 10), 10)
    log.commit()
    with small_disk(os.path.getsize(path) + 10):
        log.write(table(10, 500), 500)
        with pytest.raises(OSError, match="large"):
            log.commit()
        log.leave()
    assert log.committed == 10
    with open_recording(path, link="can") as capture:
        assert len(list(capture)) == 10
        assert capture.lines_unreadable == 0


def exported(path: Path) -> Any:
    """A live export with a walk of hubo committed in pieces, and not closed."""
    variant = load_protocol("hubo").variant()
    scanner = make_column_scanner([variant])
    export = open_export(path, variants=[variant], live=True)
    with open_recording("examples/captures/hubo2plus.log", link="can") as capture:
        (frames,) = capture.tables()
    for start in range(0, len(frames), 200):
        export.write(scanner.feed(frames.take(slice(start, start + 200))))
        export.commit()
    return export


def left_behind(path: Path) -> Path:
    """The files as a program that was killed leaves them."""
    copy = path.parent / "left" / path.name
    copy.parent.mkdir()
    for one in path.parent.glob(f"{path.name}*"):
        (shutil.copytree if one.is_dir() else shutil.copy)(one, copy.parent / one.name)
    return copy


def test_sqlite_that_was_not_closed(tmp_path: Path) -> None:
    """SQLite finds all rows, and the numbers of rows beside them."""
    export = exported(tmp_path / "walk.sqlite")
    base = sqlite3.connect(left_behind(tmp_path / "walk.sqlite"))
    tables = dict(base.execute('SELECT "table", "rows" FROM _messages').fetchall())
    assert tables == export.rows
    assert all(
        base.execute(f'SELECT count(*) FROM "{name}"').fetchone() == (n,) for name, n in tables.items()
    )
    base.close()
    export.close()
    assert sorted(one.name for one in tmp_path.iterdir()) == ["left", "walk.sqlite"]


def test_mcap_that_was_not_closed(tmp_path: Path) -> None:
    """The `mcap` package reads all messages from front to back."""
    stream_reader = pytest.importorskip("mcap.stream_reader")
    exceptions = pytest.importorskip("mcap.exceptions")
    export = exported(tmp_path / "walk.mcap")
    found = 0
    with open(left_behind(tmp_path / "walk.mcap"), "rb") as file:
        try:
            for record in stream_reader.StreamReader(file).records:
                found += type(record).__name__ == "Message"
        except exceptions.EndOfFile:
            pass
    assert found == sum(export.rows.values()) == 1239
    export.close()


def test_an_empty_journal_is_passed_over(tmp_path: Path) -> None:
    """One that was killed before its first row goes, and those behind it become parts."""
    pytest.importorskip("pyarrow")
    export = exported(tmp_path / "walk.parquet")
    left = left_behind(tmp_path / "walk.parquet")
    export.close()
    for folder in (left / "A.parquet", left / "Z.parquet"):
        folder.mkdir()
        (folder / "_part-00000.arrows").touch()
    (left / "Encoder.parquet" / "_part-00000.arrow").touch()  # of another name
    assert recover_parts(left) >= 350
    assert list(left.rglob("_part-*.arrows")) == []
    assert list((left / "Encoder.parquet").glob("part-*.parquet"))


def test_rows_are_written_in_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    """A group is closed as soon as it has its rows: what waits never grows with the recording."""
    from aces_bus.export import parquet

    class Batch:
        def __init__(self, rows: int) -> None:
            self.num_rows = rows

    monkeypatch.setattr(parquet, "GROUP_ROWS", 10)
    batches = map(Batch, (4, 6, 3, 3, 3, 3, 1))
    groups = parquet._grouped(batches)  # pyright: ignore[reportPrivateUsage]
    assert [batch.num_rows for batch in next(groups)] == [4, 6]
    assert [batch.num_rows for batch in next(groups)] == [3, 3, 3, 3]
    assert next(batches, None) is not None  # nothing was read ahead
    assert list(groups) == []


@pytest.mark.slow
def test_parquet_that_was_not_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole parts are Parquet, the rest is Arrow's stream; `recover_parts` makes it one table, as closing does."""
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr("aces_bus.export.parquet_parts.ROWS", 100)
    export = exported(tmp_path / "walk.parquet")
    left = left_behind(tmp_path / "walk.parquet")
    folder = left / "Encoder.parquet"
    whole = parquet.read_table(folder)
    rest = pa.ipc.open_stream(next(folder.glob("_part-*.arrows"))).read_all()
    assert (whole.num_rows + rest.num_rows, rest.num_rows > 0) == (350, True)
    assert len(list(folder.glob("part-*.parquet"))) >= 2
    empty = left / "Begun.parquet" / "_part-00000.arrows"  # killed before its first row was written
    empty.parent.mkdir()
    empty.touch()
    assert recover_parts(left) > 0
    assert not empty.exists()
    export.close()
    closed = parquet.read_table(tmp_path / "walk.parquet" / "Encoder.parquet")
    assert parquet.read_table(folder).equals(closed)
    assert closed.num_rows == 350
    with open_recording("examples/captures/hubo2plus.log", link="can") as capture:
        once = decode(capture, load_protocol("hubo"))["Encoder"]
    assert np.array_equal(closed["position.1"].to_numpy(), once["position.1"].values)
    assert list((tmp_path / "walk.parquet").rglob("_*")) == []
    with pytest.raises(CallerError, match="nothing is to recover"):
        recover_parts(left)


def test_a_journal_that_cannot_be_read_leaves_the_others_to_be_recovered(tmp_path: Path) -> None:
    """It is named when all others are parts."""
    pytest.importorskip("pyarrow")
    export = exported(tmp_path / "walk.parquet")
    left = left_behind(tmp_path / "walk.parquet")
    export.close()
    torn = left / "A.parquet" / "_part-00000.arrows"
    torn.parent.mkdir()
    torn.write_bytes(b"\xff\xff")
    with pytest.raises(CallerError, match=r"A\.parquet/_part-00000\.arrows: no journal of a log"):
        recover_parts(left)
    assert list(left.rglob("_part-*")) == [torn]
    assert list(left.rglob("part-*.parquet"))


@pytest.mark.parametrize("form", ["csv", "npz", "arrow"])
def test_what_needs_its_end_is_not_written_live(tmp_path: Path, form: str) -> None:
    """Such a format is refused, with those that can be."""
    with pytest.raises(CallerError, match=r"needs its end.*parquet, sqlite, mcap"):
        open_export(tmp_path / "walk", form, live=True)
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------------- aces sniff -o


@pytest.mark.parametrize("suffix", [*FOREIGN, "mf4", "log.gz"])
def test_frames_as_they_came(aces: Aces, node: Node, opened: Opened, tmp_path: Path, suffix: str) -> None:
    """Without a protocol the file has the frames that are shown otherwise, and nothing is printed."""
    opened.then(node.walk)
    path = tmp_path / f"walk.{suffix}"
    found = aces("sniff", *node.options, "-o", path, "-n", 3, "--filter", "060~7FF")
    assert (found.status, found.out) == (0, "")
    assert f"wrote 3 frames to {path}" in found.messages
    with open_recording(path, link="can") as capture:
        assert [frame.arbitration_id for frame in capture] == [0x300, 0x7FE, 0x061]
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


@pytest.mark.slow
def test_decoded_tables(aces: Aces, node: Node, opened: Opened, arm: str, tmp_path: Path) -> None:
    """With a protocol: the values that lines show, in tables; counts are those of the lines."""
    parquet = pytest.importorskip("pyarrow.parquet")
    for name, more, number in [
        ("walk.parquet", [], 3),
        ("encoder.parquet", ["-m", "Encoder", "--where", "board=1"], 1),
        ("lost.sqlite", ["--unknown", "show"], 5),
    ]:
        opened.event.clear()
        opened.then(node.walk)
        found = aces("sniff", *node.options, "-p", arm, "-o", tmp_path / name, "-n", number, *more)
        assert (found.status, found.out) == (0, "")
        assert f"wrote {number} records to {tmp_path / name}" in found.messages
    table = parquet.read_table(tmp_path / "walk.parquet" / "Encoder.parquet")
    assert table["position.0"].to_pylist() == [10, 11]
    assert table["channel"].to_pylist() == [node.channel] * 2
    one = parquet.read_table(tmp_path / "encoder.parquet")
    assert (one["board"].to_pylist(), one["position.1"].to_pylist()) == ([1], [-11])
    base = sqlite3.connect(tmp_path / "lost.sqlite")
    assert base.execute('SELECT "reason" FROM "_lost"').fetchall()[0][0].startswith("malformed")
    base.close()


def test_a_log_is_never_written_over(aces: Aces, node: Node, arm: str, tmp_path: Path) -> None:
    """Neither a recording nor tables; the first file of a series neither."""
    for name, more in [
        ("walk.blf", []),
        ("walk.sqlite", ["-p", arm]),
        ("walk.parquet", ["-p", arm]),
        ("walk-00007.blf", ["--rotate", "1MB"]),
    ]:
        path = tmp_path / name
        path.write_text("precious")
        path = tmp_path / "walk.blf" if more[:1] == ["--rotate"] else path
        found = aces("sniff", *node.options, "-o", path, *more)
        assert found.status == 2
        assert "choose another name" in found.err
        assert (tmp_path / name).read_text() == "precious"


def test_a_bus_that_does_not_open_leaves_no_log(aces: Aces, node: Node, arm: str, tmp_path: Path) -> None:
    """No empty file of a run that never began."""
    log = tmp_path / "log"
    log.mkdir()
    for name, more in [("walk.blf", []), ("walk.mcap", ["-p", arm]), ("walk.parquet", ["-p", arm])]:
        found = aces("sniff", "-i", "aces", "-c", node.channel, "-o", log / name, *more)
        assert found.status == 2
        assert "cannot be opened" in found.err
        assert list(log.iterdir()) == []


# ---------------------------------------------------------------------- rotation


def test_a_series_has_each_frame_once(tmp_path: Path) -> None:
    """By size and by time, whichever comes first; every file is whole by itself, to python-can."""
    now = 0
    log = LogSeries(
        str(tmp_path / "walk.asc"),
        Rotation(size=2_000, ns=10**9),
        lambda name: LiveRecording(name, "can", "-o"),
        option="-o",
        now=lambda: now,
    )
    for step, count in enumerate([5, 100, 5, 5, 5]):
        now = step * 4 * 10**8
        log.write(table(step * 1000, count), count)
        log.commit()
    log.close()
    files = sorted(tmp_path.iterdir())
    assert [path.name for path in files] == [f"walk-{n:05}.asc" for n in (1, 2)]
    found = [numbers_of(path) for path in files]
    assert [len(one) for one in found] == [105, 15]
    assert [n // 1000 for one in found for n in one[:1]] == [0, 2]
    assert log.written == f"2 files, {files[0]} to {files[-1]}"
    assert log.committed == 120


def test_a_series_on_the_command_line(
    aces: Aces, node: Node, opened: Opened, arm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tables, too: each file of them is whole."""
    monkeypatch.setattr("aces_tools.sniff.LOG_S", 0.0)

    def slowly() -> None:
        (gate,) = opened.gates[-1:]
        for number in range(6):
            node.send(0x060, "0A000000F6FFFFFF")
            while gate.counters.received <= number:
                time.sleep(0.001)

    opened.then(slowly)
    found = aces("sniff", *node.options, "-p", arm, "-o", tmp_path / "walk.mcap", "--rotate", "1k", "-n", 6)
    assert found.status == 0
    files = sorted(tmp_path.glob("walk*"))
    assert files[0].name == "walk-00001.mcap"
    reader = pytest.importorskip("mcap.reader")
    messages = 0
    for path in files:
        with path.open("rb") as file:
            messages += sum(1 for _ in reader.make_reader(file).iter_messages())
    assert messages == 6
    assert "wrote 6 records to " in found.err


def test_a_disk_that_is_full_when_the_next_file_begins(
    aces: Aces, node: Node, opened: Opened, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is one line that names the file, and no success."""
    commit = PendingFile.commit

    def full(file: Any) -> None:
        if file._new:
            raise OSError(28, "No space left on device")
        commit(file)

    monkeypatch.setattr(PendingFile, "commit", full)
    monkeypatch.setattr("aces_tools.sniff.LOG_S", 1e9)

    def slowly() -> None:
        for _ in range(3):
            node.send(0x060, "0A")
            time.sleep(0.01)

    opened.then(slowly)
    found = aces("sniff", *node.options, "-o", tmp_path / "walk.log", "--rotate", "1ms", "-n", 3)
    assert found.status == 2
    assert "walk-00001.log: cannot be written: No space left on device" in found.err
    assert "wrote 0 frames to" in found.err


def test_a_next_file_that_cannot_be_made_is_not_counted(tmp_path: Path) -> None:
    """What was written is said to be in one file."""
    files = iter([str(tmp_path / "walk-00001.log"), str(tmp_path / "no" / "walk-00002.log")])
    log = LogSeries(
        str(tmp_path / "walk.log"),
        Rotation(ns=1),
        lambda _: LiveRecording(next(files), "can", "-o"),
        option="-o",
        now=iter(range(100)).__next__,
    )
    log.write(table(0, 3), 3)
    with pytest.raises(CallerError, match=r"walk-00002\.log: cannot be written: No such file"):
        log.write(table(3, 1), 1)
    assert (log.files, log.committed) == (1, 3)
    assert log.written == str(tmp_path / "walk-00001.log")


@pytest.mark.parametrize("text", ["", "100", "5 parsecs", "-1MB", "1MBit"])
def test_no_rotation(text: str) -> None:
    """What is neither a size nor a duration is refused with what is."""
    with pytest.raises(CallerError, match="write a size, such as 100MB, or a duration, such as 10min"):
        Rotation.parse([text])


# ---------------------------------------------------------------------- kill -9


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of a Unix system")
def test_kill_9_leaves_what_was_received(tmp_path: Path) -> None:
    """A program that is killed in the midst of it: python-can reads the BLF, pyarrow the tables, from the first frame on."""
    ipc = pytest.importorskip("pyarrow.ipc")
    log = tmp_path / "loop.log"
    log.write_text("".join(f"({n / 1000:.6f}) can0 060#{n:08X}{n:08X}\n" for n in range(1000)))
    started = [
        subprocess.Popen(
            [
                *(sys.executable, "-m", "aces_tools", "sniff", "-i", "aces-replay", "-c", str(log)),
                *("--bus-kwargs", "loop=true", "-o", str(tmp_path / name), *more),
            ],
            stderr=subprocess.DEVNULL,
        )
        for name, more in [("walk.blf", []), ("walk.parquet", ["-p", "hubo"])]
    ]
    journal = tmp_path / "walk.parquet" / "Encoder.parquet" / "_part-00000.arrows"
    try:
        for path in (tmp_path / "walk.blf", journal):
            until = time.monotonic() + WAIT_S
            while not (path.exists() and path.stat().st_size > 5_000):
                assert time.monotonic() < until
                time.sleep(0.05)
    finally:
        for process in started:
            process.send_signal(signal.SIGKILL)
            process.wait()
    found = [int.from_bytes(message.data[:4]) for message in can.BLFReader(str(tmp_path / "walk.blf"))]
    assert found == [n % 1000 for n in range(len(found))]
    assert len(found) > 100
    rows = ipc.open_stream(journal)
    positions: list[int] = []
    with suppress(StopIteration, EOFError, OSError):
        while True:
            positions += rows.read_next_batch()["position.0"].to_pylist()
    swapped = [int.from_bytes((n % 1000).to_bytes(4), "little", signed=True) for n in range(len(positions))]
    assert positions == swapped
    assert len(positions) > 50
