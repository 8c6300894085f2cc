"""python-can's SQLite logs: every row a frame or counted, and nothing in the file is run."""

from __future__ import annotations

import io
import sqlite3
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, open_recording
from aces_bus.errors import CaptureError
from aces_bus.frame_table import ns_of, to_ns
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings import sqlite as reader
from aces_bus.recordings.base import CanRecording

SCHEMA = (
    "CREATE TABLE messages (ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, error INTEGER,"
    " dlc INTEGER, data BLOB)"
)
GOOD = (1436509052.249713, 0x123, 0, 0, 0, 2, b"\x01\x02")
FRAME = Frame(0x123, b"\x01\x02", 1436509052.249713)


def database(rows: Iterable[Any], *, schema: str = SCHEMA) -> bytes:
    """The bytes of a database with these rows."""
    connection = sqlite3.connect(":memory:")
    connection.executescript(schema)
    for row in rows:
        connection.execute("INSERT INTO messages VALUES (?,?,?,?,?,?,?)", row)
    connection.commit()
    try:
        return connection.serialize()
    finally:
        connection.close()


def read(content: bytes) -> tuple[list[Frame], CanRecording]:
    """All frames; checks that everything is counted."""
    capture = open_recording(io.BytesIO(content), link="can")
    frames = list(capture)
    assert (
        capture.lines == len(frames) + capture.lines_unreadable == capture.frames + capture.lines_unreadable
    )
    return frames, capture


@st.composite
def rows(draw: st.DrawFn) -> tuple[tuple[Any, ...], Frame]:
    """A row that python-can would write, and the frame that it is."""
    kind = draw(st.sampled_from(["data", "fd", "remote", "error"]))
    extended = draw(st.booleans())
    wide = extended or kind == "error"
    identifier = draw(st.integers(0, 0x1FFFFFFF if wide else 0x7FF))
    size = draw(st.sampled_from(FD_LENGTHS[9:]) if kind == "fd" else st.integers(0, 8))
    data = b"" if kind == "remote" else draw(st.binary(min_size=size, max_size=size))
    time = draw(st.floats(-1e9, 9e9).map(lambda value: round(value, 6)) | st.floats(0, 1e6))
    frame = Frame(
        identifier, data, time, None, extended, kind == "remote", kind == "error", kind == "fd",
        dlc=size if kind == "remote" else None,
    )  # fmt: skip
    return (time, identifier, extended, kind == "remote", kind == "error", size, data), frame


@given(st.lists(rows(), max_size=30))
def test_rows_are_frames(some: list[tuple[tuple[Any, ...], Frame]]) -> None:
    """Each row is its frame, times to the nanosecond, in the order of the table."""
    got, _ = read(database(row for row, _ in some))
    assert [frame.timestamp for frame in got] == [
        pytest.approx(frame.timestamp, abs=1e-9, rel=0) for _, frame in some
    ]
    for mine, (_, frame) in zip(got, some, strict=True):
        assert (mine.arbitration_id, mine.data, mine.length) == (
            frame.arbitration_id,
            frame.data,
            frame.length,
        )
        assert (mine.is_extended_id, mine.is_remote_frame) == (frame.is_extended_id, frame.is_remote_frame)
        assert (mine.is_error_frame, mine.is_fd) == (frame.is_error_frame, frame.is_fd)


@given(st.lists(st.floats() | st.floats(0, 9e9).map(lambda value: round(value, 7)), max_size=50))
def test_many_seconds_are_what_each_is(seconds: list[float]) -> None:
    """Nanoseconds of many floats at once are those of each, whatever the floats are."""
    assert ns_of(np.array(seconds, np.float64)).tolist() == [to_ns(value) for value in seconds]


@pytest.mark.slow
def test_many_rows_come_in_pieces() -> None:
    """Tens of thousands of rows, also around a wrong one, in bounded tables."""
    wrong = (1.0, 0x800, 0, 0, 0, 0, b"")
    some = [(n / 1000, n % 0x800, 0, 0, 0, 8, n.to_bytes(8, "big")) for n in range(40_000)]
    capture = open_recording(io.BytesIO(database([*some[:20_000], wrong, *some[20_000:]])), link="can")
    tables = list(capture.tables())
    assert max(map(len, tables)) < 1 << 15
    numbers = [int.from_bytes(frame.data, "big") for table in tables for frame in table.frames()]
    assert numbers == list(range(40_000))
    assert [(problem.line, problem.reason) for problem in capture.problems] == [
        (20_001, "identifier 0x800 is outside 0…0x7ff")
    ]


@pytest.mark.parametrize(
    ("row", "says"),
    [
        (("now", 1, 0, 0, 0, 0, b""), "ts is not a number"),
        ((1.0, "x", 0, 0, 0, 0, b""), "arbitration_id is not an integer"),
        ((1.0, -1, 0, 0, 0, 0, b""), "identifier -0x1 is outside 0…0x7ff"),
        ((1.0, 1, 0, 0, 0, 3, b"\x01"), "dlc is 3, and there are 1 data bytes"),
        ((1.0, 1, 0, 0, 0, 9, bytes(9)), "a CAN FD frame cannot carry 9 data bytes"),
        ((1.0, 1, 0, 0, 0, 9000, bytes(9000)), "a CAN FD frame cannot carry 9000 data bytes"),
        ((1.0, 1, 0, 1, 0, 9, b""), "dlc 9 of a remote frame is outside 0…8"),
        ((1.0, 1, 0, 1, 1, 0, b""), "a frame is a remote frame or an error frame, not both"),
        ((1.0, 1, 0, 1, 0, 1, b"\x01"), "a remote frame carries no data and exists only in classic CAN"),
        ((1.0, 1, 0, 0, 0, 1, "\x01"), "data is not a blob"),
        ((1.0, 1, None, 0, 0, 0, b""), "extended is not an integer"),
        ((1.0, (1 << 63) - 1, 1, 0, 0, 0, b""), "identifier 0x7fffffffffffffff is outside 0…0x1fffffff"),
    ],
)
def test_wrong_rows_are_named(row: tuple[Any, ...], says: str) -> None:
    """A row that is not a frame is counted with its place and reason; those around it stand."""
    got, capture = read(database([GOOD, row, GOOD]))
    assert got == [FRAME, FRAME]
    assert [(problem.line, problem.reason) for problem in capture.problems] == [(2, says)]


def test_what_may_be_missing() -> None:
    """A row without time or data is a frame without them; whole seconds are seconds."""
    got, _ = read(database([(None, 1, 0, 0, 0, 0, None), (5, 1, 0, 0, 0, 0, b"")]))
    assert [(frame.timestamp, frame.data) for frame in got] == [(None, b""), (5.0, b"")]


@pytest.mark.parametrize(
    "script",
    [
        "CREATE TABLE other (x)",
        "CREATE TABLE messages (ts REAL, data BLOB)",
        "CREATE VIEW messages AS WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT n AS ts,"
        " 0 AS arbitration_id, 0 AS extended, 0 AS remote, 0 AS error, 0 AS dlc, NULL AS data FROM c",
    ],
    ids=["another table", "other columns", "an endless view"],
)
def test_other_databases_are_refused(script: str) -> None:
    """A database without the table is said to be none; a view is not looked into."""
    with pytest.raises(CaptureError, match=r"without python-can's table messages"):
        read(database([], schema=script))


def test_the_time_limit_stops_a_query(monkeypatch: pytest.MonkeyPatch) -> None:
    """When no row comes for too many steps, reading ends with a reason."""
    monkeypatch.setattr(reader, "_STEPS", -1)
    monkeypatch.setattr(reader, "_STEPS_A_CALL", 1)
    with pytest.raises(CaptureError, match="interrupted"):
        read(database([GOOD] * 3))


@pytest.mark.slow
def test_every_truncation(tmp_path: Path) -> None:
    """A database that ends early gives what is there, and the rest is counted or refused."""
    content = database([GOOD] * 600)
    refused = counted = 0
    for size in range(16, len(content), 97):
        try:
            got, capture = read(content[:size])
        except CaptureError:
            refused += 1
        else:
            assert got == [FRAME] * len(got)
            assert capture.lines_unreadable
            counted += 1
    assert min(refused, counted) > 0


@given(st.lists(st.tuples(st.floats(0, 0.9999), st.integers(1, 255)), min_size=1, max_size=6))
def test_flipped_bytes_do_no_harm(flips: list[tuple[float, int]]) -> None:
    """Whatever is wrong in the pages, all is counted, and only a `CaptureError` is raised."""
    damaged = bytearray(database([GOOD] * 300))
    for place, bits in flips:
        damaged[16 + int(place * (len(damaged) - 16))] ^= bits
    try:
        read(bytes(damaged))
    except CaptureError:
        pass


def test_pages_in_circles_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """More rows than the file has room for end the reading."""
    monkeypatch.setattr(reader, "_BATCH", 10)
    monkeypatch.setattr(reader, "_ROWS", 10)
    monkeypatch.setattr(reader, "_ROW_BYTES", 8192 // 20)
    _, capture = read(database([GOOD] * 100))
    assert capture.problems[0].reason.startswith("more rows than the file has room for")


def test_python_can_and_we_agree(tmp_path: Path) -> None:
    """What python-can's own writer and reader make of a log, we make of it."""
    can = pytest.importorskip("can")
    path = tmp_path / "walk.db"
    messages = [
        can.Message(1436509052.25, 0x123, False, data=b"\x01\x02"),
        can.Message(1436509052.249713, 0x1234567, True, data=bytes(8)),
        can.Message(0.5, 0x77, False, is_remote_frame=True, dlc=5),
        can.Message(1.5, 0x80, False, is_error_frame=True, data=bytes(8)),
        can.Message(2.5, 0x10, False, is_fd=True, data=bytes(48), dlc=48),
    ]
    with sqlite3.connect(path) as connection:  # as `SqliteWriter` does, without its thread
        connection.execute(SCHEMA)
        for message in messages:
            row = (
                message.timestamp, message.arbitration_id, message.is_extended_id, message.is_remote_frame,
                message.is_error_frame, message.dlc, memoryview(message.data),
            )  # fmt: skip
            connection.execute("INSERT INTO messages VALUES (?,?,?,?,?,?,?)", row)
    connection.close()
    source = can.SqliteReader(str(path))
    theirs = list(source)
    source.stop()
    with open_recording(path, link="can") as capture:
        ours = list(capture)
    assert len(ours) == len(theirs) == len(messages)
    for frame, message in zip(ours, theirs, strict=True):
        assert (frame.timestamp, frame.arbitration_id) == (message.timestamp, message.arbitration_id)
        assert (frame.data, frame.length) == (bytes(message.data), message.dlc)
        assert (frame.is_extended_id, frame.is_remote_frame) == (
            message.is_extended_id,
            message.is_remote_frame,
        )
        assert frame.is_error_frame == message.is_error_frame


def test_the_file_stays_as_it_was(tmp_path: Path) -> None:
    """Reading writes nothing: no journal, no changed byte, also where the file may not be written."""
    path = tmp_path / "walk's #1?.db"
    content = database([GOOD])
    path.write_bytes(content)
    path.chmod(0o444)
    assert list(open_recording(path, link="can")) == [FRAME]
    assert path.read_bytes() == content
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
