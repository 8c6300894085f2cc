"""Our own serial recording: bytes, directions, times and boundaries, line by line."""

from __future__ import annotations

import io
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import open_recording
from aces_bus.errors import CaptureError
from aces_bus.recordings.base import Chunk, SerialRecording
from aces_bus.recordings.write.serial import SerialLogWriter

LOG = b"""# aces serial capture 1
# port /dev/ttyUSB0
(1436509052.249713000) > [6] FFFF010201FB
(1436509052.250413001) < [2] ffff

(-) ? [1] 7F
"""
CHUNKS = [
    Chunk(b"\xff\xff\x01\x02\x01\xfb", 1436509052.249713, "to device"),
    Chunk(b"\xff\xff", 1436509052.250413001, "from device"),
    Chunk(b"\x7f"),
]

microseconds = st.integers(-(10**12), 4 * 10**15).map(
    lambda n: float(f"{'-' if n < 0 else ''}{abs(n) // 10**6}.{abs(n) % 10**6:06}")
)
chunks = st.builds(
    Chunk,
    st.binary(min_size=1, max_size=3000),
    st.none() | microseconds,
    st.sampled_from([None, "to device", "from device"]),
)


def read(content: bytes) -> tuple[list[Chunk], SerialRecording]:
    capture = open_recording(io.BytesIO(content), link="serial")
    return list(capture), capture


def write(some: list[Chunk]) -> tuple[bytes, SerialLogWriter]:
    file = io.BytesIO()
    writer = SerialLogWriter(file, "out.slog")
    for chunk in some:
        writer.write(chunk)
    writer.close()
    return file.getvalue(), writer


def test_the_lines_say_what_they_say() -> None:
    """The format as it is documented, and what is counted."""
    capture = open_recording(io.BytesIO(LOG))
    assert isinstance(capture, SerialRecording)
    assert capture.format == "serial log of aces-bus"
    assert list(capture) == CHUNKS
    assert (capture.bytes, capture.lines, capture.lines_comment, capture.lines_blank) == (9, 6, 2, 1)


@given(st.lists(chunks, max_size=8))
def test_what_is_written_is_read_back(some: list[Chunk]) -> None:
    """Bytes, boundaries, directions and times, whatever they are; two equal chunks stay two."""
    content, writer = write(some)
    got, capture = read(content)
    assert got == some
    assert writer.lossy == {}
    assert capture.bytes == sum(len(chunk.data) for chunk in some)
    assert max(len(line) for line in content.split(b"\n")) < 4096


def test_a_long_chunk_is_one_chunk() -> None:
    """A chunk of 64 KiB takes many lines and comes back whole; equal ones beside it stay apart."""
    some = [Chunk(bytes(range(256)) * 256, 1.5, "from device")] * 2
    content, _ = write(some)
    assert read(content)[0] == some
    assert content.count(b"\n") == 129


def test_a_piece_of_a_log_is_a_log() -> None:
    """What grep or tail leaves has no first line, and is told by its lines; joined files are one."""
    piece = b"\n".join(LOG.split(b"\n")[2:4])
    assert read(piece)[0] == CHUNKS[:2]
    assert read(LOG + LOG)[0] == CHUNKS * 2
    with pytest.raises(CaptureError, match="serial log of aces-bus"):
        open_recording(io.BytesIO(piece), link="can")


def test_every_truncation() -> None:
    """A file that ends anywhere gives its whole lines; one that was cut is unreadable, and no shorter chunk."""
    for size in range(len(LOG)):
        got, capture = read(LOG[:size])
        if capture.format == "raw serial bytes":  # the first line is not yet there
            assert size < len(b"# aces serial capture ")
            continue
        assert got == CHUNKS[: len(got)]
        assert capture.lines_unreadable <= 1
        whole = len(got) + capture.lines_unreadable + capture.lines_comment + capture.lines_blank
        assert capture.lines == whole


@given(st.lists(st.tuples(st.integers(24, len(LOG) - 1), st.integers(1, 255)), min_size=1, max_size=4))
def test_flipped_bytes_are_counted(flips: list[tuple[int, int]]) -> None:
    """Wrong lines are unreadable, each of them, and the others stand."""
    damaged = bytearray(LOG)
    for place, bits in flips:
        damaged[place] ^= bits
    got, capture = read(bytes(damaged))
    assert capture.lines == len(got) + capture.lines_unreadable + capture.lines_comment + capture.lines_blank
    assert capture.bytes == sum(len(chunk.data) for chunk in got)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b"(1.0) > [3] FFFF", "[3] bytes are announced, 2 are there"),
        (b"(1.0) > [2] FFF", "not a line of a serial log: (SECONDS) > [BYTES] HEX"),
        (b"(1.0) > [0] ", "a chunk without bytes"),
        (b"(now) > [1] FF", "not a line of a serial log: (SECONDS) > [BYTES] HEX"),
        (b"(1.0) > [2100] " + b"00" * 2100, "longer than 4096 bytes"),
    ],
)
def test_wrong_lines_are_named(line: bytes, says: str) -> None:
    """The number of the line and what is wrong with it."""
    got, capture = read(LOG + line + b"\n" + LOG)
    assert got == CHUNKS * 2
    assert [(problem.line, problem.reason) for problem in capture.problems] == [(7, says)]


@pytest.mark.parametrize(
    ("rest", "number"),
    [
        (b"", 3),
        (b"(2.0) > [1] 22\n", 3),
        (b"(1.0) < [1] 22\n", 3),
        (b"# moved\n(1.0) > [1] 22\n", 3),
        (b"\n", 3),
    ],
    ids=["end", "time", "direction", "comment", "blank"],
)
def test_a_missing_continuation_is_counted(rest: bytes, number: int) -> None:
    """A chunk that says that it goes on, and does not, is handed out as far as it is there, and the hole is counted."""
    content = b"# aces serial capture 1\n(1.0) >+ [1] 11\n" + rest
    got, capture = read(content)
    assert [chunk.data for chunk in got] == [b"\x11", *([b"\x22"] if b"22" in rest else [])]
    (problem,) = capture.problems
    assert (problem.line, capture.lines_unreadable) == (number, 1)
    assert "its next line is missing" in problem.reason
    assert capture.lines == len(got) + capture.lines_unreadable + capture.lines_comment + capture.lines_blank


def test_a_cut_continuation_is_one_unreadable_line() -> None:
    """What is there and cannot be read is not missing as well."""
    _, capture = read(b"# aces serial capture 1\n(1.0) >+ [1] 11\n(1.0) > [2] 22\n(2.0) > [3] 11\n")
    assert [problem.line for problem in capture.problems] == [3, 4]
    assert capture.lines_unreadable == 2


def test_hostile_continuations_are_bounded() -> None:
    """Lines that all say that the chunk goes on give chunks of at most 64 KiB."""
    content = LOG + b"(1.0) >+ [1000] " + b"00" * 1000 + b"\n"
    got, _ = read(content + (b"(1.0) >+ [1000] " + b"00" * 1000 + b"\n") * 200)
    assert sum(len(chunk.data) for chunk in got) == 9 + 201_000
    assert max(len(chunk.data) for chunk in got) <= 1 << 16


def test_a_newer_version_is_refused() -> None:
    """A log of a version to come is not guessed at."""
    with pytest.raises(CaptureError, match="a serial log of version 2; this release reads version 1"):
        read(b"# aces serial capture 2\n(1.0) ! whatever\n")


def test_times_that_do_not_fit_are_counted() -> None:
    """Fractions of a nanosecond are rounded, what is not an instant becomes no time, and both are said."""
    content, writer = write([Chunk(b"\1", 0.1 + 0.2), Chunk(b"\1", float("nan")), Chunk(b"\1", 1e300)])
    assert [chunk.time for chunk in read(content)[0]] == [0.3, None, None]
    assert writer.lossy == {"times finer than 1 ns": 1, "times that are not an instant": 2}


def test_a_pipe_gives_chunks_as_they_come(tmp_path: Path) -> None:
    """A log that is still being written gives each line at once, and can be appended to."""
    reader, end = os.pipe()
    with open(reader, "rb", buffering=0) as file, open(end, "wb", buffering=0) as out:
        writer = SerialLogWriter(out, "pipe")
        writer.write(CHUNKS[0])
        capture = iter(open_recording(file, link="serial"))
        assert next(capture) == CHUNKS[0]
        writer.write(CHUNKS[1])
        assert next(capture) == CHUNKS[1]
        out.close()
        assert list(capture) == []
    path = tmp_path / "walk.slog"
    for chunk in CHUNKS:
        with open(path, "ab") as log:
            SerialLogWriter(log, "walk.slog").write(chunk)
    assert list(open_recording(path, link="serial")) == CHUNKS
