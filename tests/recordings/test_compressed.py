"""gzip and zstandard captures: unpacked as they are read, bounded, with what damage leaves."""

from __future__ import annotations

import contextlib
import gzip
import io
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aces_bus import open_recording
from aces_bus.errors import CaptureError
from aces_bus.recordings.base import CanRecording, SerialRecording
from aces_bus.recordings.source import ByteSource

zstandard = pytest.importorskip("zstandard")

LINES = [
    b"(1436509052.%06d) can0 %03X#%016X\n" % (i, i % 2048, i * 0x9E3779B97F4A7C15 % (1 << 64))
    for i in range(6000)
]
LOG = b"".join(LINES)


def zstd(data: bytes, **options: Any) -> bytes:
    """One zstandard frame."""
    packed: bytes = zstandard.ZstdCompressor(**options).compress(data)
    return packed


PACK: dict[str, Callable[[bytes], bytes]] = {"gzip": gzip.compress, "zstandard": zstd}


class Cut(io.RawIOBase):
    """A file that comes in pieces of one size."""

    def __init__(self, content: bytes, size: int) -> None:
        self.content, self.size = content, size

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        data, self.content = self.content[: self.size], self.content[self.size :]
        return data


@pytest.mark.parametrize("kind", PACK)
@pytest.mark.parametrize("suffix", ["log", "gz", "mp3"])
def test_a_packed_capture_is_read_like_a_plain_one(tmp_path: Path, kind: str, suffix: str) -> None:
    """Told by content, not by the name; frames and columns, line numbers and the name are the same."""
    path = tmp_path / f"walk.{suffix}"
    path.write_bytes(PACK[kind](LOG + b"oops\n"))
    with open_recording(path, link="can") as capture:
        frames = list(capture)
    assert (len(frames), capture.problems[0].line, capture.name) == (6000, 6001, str(path))
    with open_recording(path, link="can") as capture:
        assert [frame for table in capture.tables() for frame in table.frames()] == frames
    with contextlib.closing(ByteSource(path)) as source:
        assert source.packing == kind


@pytest.mark.parametrize("kind", PACK)
def test_other_formats_may_be_packed_too(kind: str) -> None:
    """A hex dump, and raw serial bytes."""
    dump = b'Port opened by process "DXCONF.exe" (PID: 1)\n\n FF FE   ..\n'
    capture = open_recording(io.BytesIO(PACK[kind](dump)))
    assert isinstance(capture, SerialRecording)
    assert [chunk.data for chunk in capture] == [b"\xff\xfe"]
    raw = open_recording(io.BytesIO(PACK[kind](b"\xff\xff\x01")), link="serial")
    assert [chunk.data for chunk in raw] == [b"\xff\xff\x01"]


@pytest.mark.parametrize("kind", PACK)
@pytest.mark.parametrize("size", [1, 3, 1000])
def test_pieces_of_any_size_are_unpacked(kind: str, size: int) -> None:
    """Also when the first of them does not tell the packing."""
    source: Any = Cut(PACK[kind](LOG[:4000]), size)
    assert b"".join(ByteSource(source, "pipe").blocks()) == LOG[:4000]


@pytest.mark.parametrize("batch", [None, 1, 1024])
def test_frames_before_the_damage_are_given_first(batch: int | None) -> None:
    """Then one error; the counters say how far it went, and the line in the damage is not given."""
    packed = gzip.compress(LOG)
    capture = open_recording(io.BytesIO(packed[: len(packed) // 2]), link="can", name="walk.log.gz")
    assert isinstance(capture, CanRecording)
    count = 0

    def read() -> None:
        nonlocal count
        for piece in capture.tables() if batch is None else capture.batches(batch):
            count += len(piece)

    with pytest.raises(CaptureError, match=r"walk\.log\.gz: the gzip data ends too early"):
        read()
    assert 2000 < count == capture.frames == capture.lines
    assert capture.lines_unreadable == 0


def test_the_first_lines_of_a_damaged_file_are_given_too() -> None:
    """Also when the damage is so near that it is met before the format is told."""
    packed = gzip.compress(b"".join(LINES[:200]))
    capture = open_recording(io.BytesIO(packed[:-30]), link="can")
    frames = next(capture.batches(100))
    assert len(frames) == 100
    with pytest.raises(CaptureError, match="ends too early"):
        list(capture)


@pytest.mark.parametrize("outer", PACK)
@pytest.mark.parametrize("inner", PACK)
def test_what_is_packed_twice_is_refused(inner: str, outer: str) -> None:
    """It is a mistake, or a trap."""
    with pytest.raises(CaptureError, match=f"{inner} data within {outer} data; unpack it once before"):
        open_recording(io.BytesIO(PACK[outer](PACK[inner](LOG))), link="can")


@pytest.mark.parametrize("kind", PACK)
def test_a_bomb_is_read_with_little_memory(kind: str) -> None:
    """Sixty megabytes out of a few kilobytes: never more than a few of them at once."""
    packed = PACK[kind](bytes(60_000_000))
    assert len(packed) < 100_000
    tracemalloc.start()
    try:
        source = ByteSource(io.BytesIO(packed), "bomb")
        assert sum(map(len, source.blocks())) == 60_000_000
        assert tracemalloc.get_traced_memory()[1] < 40_000_000
    finally:
        tracemalloc.stop()


def test_without_the_package_the_message_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """What to install, or how to do without."""
    monkeypatch.setitem(sys.modules, "zstandard", None)
    with pytest.raises(CaptureError, match=r"pip install 'aces-bus\[columns\]'.*zstd -dc"):
        open_recording(io.BytesIO(zstd(LOG)), link="can")


def test_standard_input_may_be_packed() -> None:
    """`aces decode … - < walk.log.gz`, also through a pipe."""
    program = (
        "from aces_bus import open_recording\n"
        "capture = open_recording('-', link='can')\n"
        "print(sum(map(len, capture.tables())), capture.live)\n"
    )
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", program], input=gzip.compress(LOG), capture_output=True, cwd=root
    )
    assert (done.stdout.decode().split(), done.stderr) == (["6000", "True"], b"")
