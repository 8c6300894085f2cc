# One process that reads serves many files.
# pyright: reportPrivateUsage=false
"""MF4 bus logs: read by another process, written by our own blocks, and the same frames either way.

A process that reads takes a second to start; most tests therefore let one read many files.
"""

from __future__ import annotations

import importlib.util
import io
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.errors import CaptureError
from aces_bus.frame_table import Channels
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.merge import KeyedTable, Merge
from aces_bus.recordings.source import ByteSource
from aces_lab.formats.mf4 import child as child
from aces_lab.formats.mf4 import reader as mf4
from aces_lab.formats.mf4.reader import Mf4Capture
from aces_lab.formats.mf4.writer import Mf4Writer
from tests.recordings.mdf_files import (
    COUNT_MISSING,
    RECORDS,
    SOME,
    UNTIMED,
    WRONG,
    circles,
    content_of,
    damaged_files,
    later_file,
    packed_file,
    plain_file,
    signals_file,
    unsorted_file,
    variable_file,
    written,
)

if importlib.util.find_spec("asammdf") is None:  # it is not imported: python-can must be first
    pytest.skip("asammdf is not installed", allow_module_level=True)

#: In the short profile fewer files are drawn.
MANY = 20 if settings().max_examples > 100 else 10

Result = tuple[list[Frame], Mf4Capture] | CaptureError


def read_all(contents: Sequence[bytes]) -> Iterator[Result]:
    """What comes of each content, all read by one process; a stuck one is replaced, as it is in life."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder, f"{number}.mf4") for number in range(len(contents))]
        for path, content in zip(paths, contents, strict=True):
            path.write_bytes(content)
        process = mf4._start(folder, [str(path) for path in paths])
        try:
            for number, path in enumerate(paths):
                capture = Mf4Capture(ByteSource(str(path)))
                frames: list[Frame] = []
                try:
                    for table in capture._read(process, str(path), folder):
                        frames += table.frames()
                except CaptureError as error:
                    if process.poll() is not None:  # otherwise it lives on
                        mf4._stop(process)
                        process = mf4._start(folder, [str(rest) for rest in paths[number + 1 :]])
                    yield error
                else:
                    others = sum(capture.others.values())
                    assert len(frames) == capture.frames
                    assert capture.lines == capture.frames + capture.lines_unreadable + others
                    yield frames, capture
                finally:
                    capture.close()
        finally:
            mf4._stop(process)


def read(content: bytes) -> tuple[list[Frame], Mf4Capture]:
    result = next(read_all([content]))
    if isinstance(result, CaptureError):
        raise result
    return result


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Any frame that a bus can carry, in any order of times."""
    kind = draw(st.sampled_from(["classic", "fd", "remote", "error"]))
    extended = draw(st.booleans()) and kind != "error"
    size = draw(st.sampled_from(FD_LENGTHS) if kind == "fd" else st.integers(0, 8))
    micro = draw(st.integers(0, 4 * 10**15))
    return Frame(
        draw(st.integers(0, 0x1FFFFFFF if extended or kind == "error" else 0x7FF)),
        b"" if kind == "remote" else draw(st.binary(min_size=size, max_size=size)),
        float(f"{micro // 10**6}.{micro % 10**6:06}"),
        draw(st.sampled_from([None, "can0", "can1", "vcan 7", "ÿ", "999"])),
        extended,
        kind == "remote",
        kind == "error",
        kind == "fd",
        kind == "fd" and draw(st.booleans()),
        kind == "fd" and draw(st.booleans()),
        draw(st.sampled_from([None, True, False])),
        size if kind == "remote" else None,
    )


@pytest.mark.slow
@settings(max_examples=2)
@given(st.lists(st.lists(frames(), min_size=1, max_size=30), min_size=MANY, max_size=MANY))
def test_what_is_written_is_read_back(captures: list[list[Frame]]) -> None:
    """Any frames survive MF4: names, directions, instants, and their order whatever the instants are."""
    for (got, capture), some in zip(
        map(_fine, read_all([*map(content_of, captures)])), captures, strict=True
    ):
        assert got == some
        assert capture.problems == []


def _fine(result: Result) -> tuple[list[Frame], Mf4Capture]:
    assert not isinstance(result, CaptureError), str(result)
    return result


def test_python_can_reads_what_we_write(tmp_path: Path) -> None:
    """python-can's own reader, through asammdf, gives the same frames in the order of their times."""
    can = pytest.importorskip("can")
    path = tmp_path / "walk.mf4"
    path.write_bytes(content_of(SOME))
    theirs = list(can.MF4Reader(str(path)))
    assert sorted(message.arbitration_id for message in theirs) == sorted(f.arbitration_id for f in SOME)
    for frame in SOME:
        twin = next(message for message in theirs if message.arbitration_id == frame.arbitration_id)
        assert twin.timestamp == pytest.approx(frame.timestamp, abs=1e-6)
        assert (bytes(twin.data), twin.dlc) == (frame.data, frame.length)
        assert (twin.is_extended_id, twin.is_remote_frame) == (frame.is_extended_id, frame.is_remote_frame)
        assert (twin.is_error_frame, twin.is_fd) == (frame.is_error_frame, frame.is_fd)
        assert (twin.is_rx, twin.bitrate_switch) == (frame.is_rx is not False, frame.bitrate_switch)
        assert twin.channel == {"can0": 0, "can1": 1, None: 2}[frame.channel]


@pytest.mark.slow
def test_we_read_what_python_can_writes(tmp_path: Path) -> None:
    """Files of python-can, plain and packed: the frames that its own reader gives."""
    can = pytest.importorskip("can")
    paths = [tmp_path / f"{level}.mf4" for level in (0, 2)]
    for level, path in zip((0, 2), paths, strict=True):
        with can.MF4Writer(str(path), compression_level=level) as writer:
            for frame in SOME:
                writer(
                    can.Message(
                        timestamp=(frame.timestamp or 0) + 1e9,  # it moves what is before its own start
                        arbitration_id=frame.arbitration_id,
                        is_extended_id=frame.is_extended_id,
                        is_remote_frame=frame.is_remote_frame,
                        is_error_frame=frame.is_error_frame,
                        channel=0 if frame.channel is None else int(frame.channel[-1]),
                        dlc=frame.length,
                        data=frame.data,
                        is_fd=frame.is_fd,
                        bitrate_switch=frame.bitrate_switch,
                        error_state_indicator=frame.error_state_indicator,
                        is_rx=frame.is_rx is not False,
                    )
                )
    for path, result in zip(paths, read_all([path.read_bytes() for path in paths]), strict=True):
        ours, _ = _fine(result)
        theirs = list(can.MF4Reader(str(path)))
        assert len(ours) == len(theirs) == len(SOME)
        for frame, message in zip(ours, theirs, strict=True):
            assert frame.timestamp == pytest.approx(message.timestamp, abs=1e-6)
            assert (frame.arbitration_id, frame.data) == (message.arbitration_id, bytes(message.data))
            assert (frame.is_extended_id, frame.is_fd) == (message.is_extended_id, message.is_fd)
            assert (frame.is_remote_frame, frame.is_error_frame) == (
                message.is_remote_frame,
                message.is_error_frame,
            )
            assert (frame.channel, frame.is_rx) == (str(message.channel), message.is_rx)
            assert frame.bitrate_switch == message.bitrate_switch


def test_a_long_capture_comes_in_bounded_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many blocks of two channels and both sizes: opened by content, the same table, and asammdf not imported here."""
    monkeypatch.setitem(sys.modules, "asammdf", None)  # an import would raise
    n = 150_000
    numbers = np.arange(n)
    is_fd = numbers % 5 == 0
    data = np.zeros((n, 64), np.uint8)
    data[:, :8] = np.arange(n, dtype="<u8").view(np.uint8).reshape(n, 8)
    table = FrameTable(
        numbers // 3 * 1000 + 10**18,
        (numbers % 2).astype(np.uint16),
        (numbers % 0x800).astype(np.uint32),
        np.where(is_fd, 4, 64).astype(np.uint8),
        np.where(is_fd, 64, 8).astype(np.uint8),
        data,
        Channels(["can0", "can1"]),
    )
    path = tmp_path / "long.zip"
    with open(path, "wb") as file:
        writer = Mf4Writer(file, str(path))
        for start in range(0, n, 10_000):
            writer.write(table.take(slice(start, start + 10_000)))
        writer.close()
    capture = open_recording(path, link="can")
    tables = list(capture.tables())
    assert max(map(len, tables)) < n
    got = FrameTable.concat(tables)
    assert capture.channels.names == ["can0", "can1"]
    for name in ("time", "channel", "id", "flags", "length", "data"):
        assert (getattr(got, name) == getattr(table, name)).all(), name


@pytest.fixture(scope="module")
def results() -> dict[str, Result]:
    """What comes of many files, read by one process."""
    untimed, writer = written(FrameTable.from_frames(UNTIMED[:2]), FrameTable.from_frames(UNTIMED[2:]))
    assert writer.lossy == {"times that the capture does not say, written as the frame's before": 2}
    contents = {
        "untimed": untimed,
        "unsorted": unsorted_file(),
        "variable": variable_file(),
        "packed": packed_file(RECORDS, 21, 9),
        "wrong": plain_file(WRONG, 3),
        "short": plain_file(RECORDS, 20),
        "unfinished": plain_file(RECORDS, 0, flags=COUNT_MISSING),
        "signals": signals_file(),
        "old": b"MDF     3.30    ".ljust(200, b"\0"),
        "nothing": b"MDF     4.10    ",
        **{f"circle {number}": content for number, content in enumerate(circles())},
        **{f"damaged {number}": content for number, content in enumerate(damaged_files())},
    }
    return dict(zip(contents, read_all([*contents.values()]), strict=True))


@pytest.mark.slow
def test_what_mf4_cannot_hold_is_counted(results: dict[str, Result]) -> None:
    """A frame without a time gets that of the frame before it, and it is said."""
    got, _ = _fine(results["untimed"])
    assert [(frame.arbitration_id, frame.timestamp) for frame in got] == [
        (1, 0.0),
        (2, 5.0),
        (3, 5.0),
        (4, 6.0),
    ]


def test_unsorted_files(results: dict[str, Result]) -> None:
    """Records of several groups in one stream, as loggers write them; those of other buses are named."""
    got, capture = _fine(results["unsorted"])
    assert [(f.arbitration_id, f.is_extended_id, f.data, f.timestamp, f.channel) for f in got] == [
        (0x123, n > 0, bytes([n] * n), 1e9 + n, "1") for n in range(3)
    ]
    assert capture.others == {"LIN frames": 2}


def test_data_of_variable_length(results: dict[str, Result]) -> None:
    """Data bytes that stand in a block of their own."""
    assert [frame.data for frame in _fine(results["variable"])[0]] == [b"", b"\1\2\3", bytes(range(8))]


@pytest.mark.parametrize("name", ["packed", "short", "unfinished"])
def test_other_ways_to_keep_records(results: dict[str, Result], name: str) -> None:
    """Deflated, shorter than announced, or never finished: the records that are there."""
    got, capture = _fine(results[name])
    assert [(frame.arbitration_id, frame.data, frame.timestamp) for frame in got] == [
        (0x100 + n, bytes([n] * n), 1e9 + n / 2) for n in range(9)
    ]
    assert capture.lines_unreadable == (name == "short")
    for problem in capture.problems:
        assert problem.line == 10
        assert problem.reason.startswith(
            "CAN_DataFrame group 0 breaks off: 20 records are announced, 9 are there"
        )


def test_wrong_records_are_named(results: dict[str, Result]) -> None:
    """A record that is not a frame is counted with its number and reason; the others stand."""
    got, capture = _fine(results["wrong"])
    assert [frame.arbitration_id for frame in got] == [7, 1]
    assert [(problem.line, problem.reason) for problem in capture.problems] == [
        (1, "CAN_DataFrame group 0: an 11-bit identifier above 0x7FF")
    ]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("signals", "it holds no bus logging, but measured signals in 1 groups"),
        ("old", "MDF version '3.30' has no bus logging; only version 4 has"),
        ("nothing", "this MF4 file cannot be read"),
    ],
)
def test_what_is_no_bus_log_is_refused(results: dict[str, Result], name: str, says: str) -> None:
    """Measured signals, old versions and files that are none are refused with what they are."""
    assert isinstance(results[name], CaptureError)
    assert says in str(results[name])


def test_circles_are_found(results: dict[str, Result]) -> None:
    """Blocks that lead back to themselves, or data that are named twice, are refused and not followed."""
    found = [str(result) for name, result in results.items() if name.startswith("circle")]
    assert len(found) == 8
    for said in found:
        assert "linked in circles" in said or "cannot be read" in said


def test_every_kind_of_damage(results: dict[str, Result]) -> None:
    """Truncated and flipped files: counted losses or a clear refusal, and the reader lives on."""
    damaged = [result for name, result in results.items() if name.startswith("damaged")]
    assert len(damaged) > 60
    assert any(isinstance(result, CaptureError) for result in damaged)
    assert any(not isinstance(result, CaptureError) for result in damaged)


@pytest.mark.slow
def test_bombs_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block that unpacks to, or claims, more than is allowed is an error or a counted loss; never the memory."""
    monkeypatch.setattr(child, "MEMORY", 96 << 20)
    records = bytes(21) * 8_000_000
    claims = packed_file(bytes(21), 21, 1 << 40, claimed=1 << 45)
    for result in read_all([packed_file(records, 21, 8_000_000), claims, content_of(SOME)]):
        if not isinstance(result, CaptureError):
            got, capture = result
            assert capture.lines_unreadable or got == SOME
    pytest.importorskip("resource")


@pytest.mark.parametrize(
    ("start", "says"),
    [
        ("import time; time.sleep(60)", "no progress for 0 s while reading this MF4 file"),
        ("import os; os._exit(3)", r"ended early \(status 3\)"),
        (
            "import json, sys; sys.path[:] = json.loads(sys.argv[1]); sys.modules['asammdf'] = None;"
            " from aces_lab.formats.mf4.child import run_child; run_child(sys.argv[2:])",
            r"in a state, that is not known here; such files need asammdf: pip install 'aces-bus\[mf4\]'",
        ),
    ],
    ids=["stuck", "dead", "not installed"],
)
def test_what_becomes_of_the_process_is_said(monkeypatch: pytest.MonkeyPatch, start: str, says: str) -> None:
    """A reader that hangs is stopped; one that dies, or lacks its library, is explained."""
    monkeypatch.setattr(mf4, "_START", start)
    monkeypatch.setattr(mf4, "PATIENCE", 0.3 if "sleep" in start else 30.0)
    with pytest.raises(CaptureError, match=says):
        list(open_recording(io.BytesIO(later_file()), link="can"))


@pytest.mark.slow
def test_leaving_early_stops_the_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who stops reading leaves no process and no file behind."""
    started: list[Any] = []
    real: Callable[..., Any] = mf4._start

    def start(folder: str, paths: list[str]) -> Any:
        started.append((folder, real(folder, paths)))
        return started[-1][1]

    monkeypatch.setattr(mf4, "_start", start)
    capture = Mf4Capture(ByteSource(io.BytesIO(later_file()), "memory"))
    tables = capture.tables()
    next(tables)
    assert Path(started[0][0], "capture").exists()
    capture.close()
    assert started[0][1].poll() is not None
    tables.close()  # type: ignore[attr-defined]
    assert not Path(started[0][0]).exists()


def piece(keys: Sequence[int], source: int) -> KeyedTable:
    n = len(keys)
    key = np.array(keys, np.int64)
    numbers = np.full(n, source)
    data = np.zeros((n, 8), np.uint8)
    return key, FrameTable(key, numbers, np.arange(n), numbers, numbers, data, Channels())


@given(st.lists(st.lists(st.lists(st.integers(0, 20), min_size=1, max_size=5), max_size=5), max_size=4))
def test_groups_are_merged_by_time(groups: list[list[list[int]]]) -> None:
    """However the pieces fall: all rows, sorted, of equal keys those of the earlier group first."""
    rows: list[tuple[int, int]] = []
    sources: list[Iterator[KeyedTable]] = []
    for number, pieces in enumerate(groups):
        keys = sorted(key for keys in pieces for key in keys)
        rows += [(key, number) for key in keys]
        cuts = np.cumsum([len(keys) for keys in pieces]).tolist()
        sources.append(iter([piece(keys[a:b], number) for a, b in zip([0, *cuts], cuts, strict=False)]))
    merged = list(Merge.by_key(sources))
    got = [row for part in merged for row in zip(part.time.tolist(), part.channel.tolist(), strict=True)]
    assert got == sorted(rows)
