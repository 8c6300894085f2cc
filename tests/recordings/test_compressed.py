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
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import open_recording
from aces_bus.errors import CaptureError
from aces_bus.recordings.base import CanRecording, SerialRecording
from aces_bus.recordings.source import BLOCK, ByteSource
from aces_bus.recordings.unpack import may_be_packed, packing

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


def unpacked(content: bytes) -> tuple[bytes, str]:
    """All bytes that a source gives, and what it says then."""
    source = ByteSource(io.BytesIO(content), "walk.log.gz")
    out = bytearray()
    try:
        for block in source.blocks():
            assert 0 < len(block) <= BLOCK
            out += block
    except CaptureError as error:
        return bytes(out), str(error)
    return bytes(out), ""


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


@pytest.mark.parametrize("kind", PACK)
def test_members_follow_each_other(kind: str) -> None:
    """As `cat a.gz b.gz` makes them; an empty one among them, and zeros behind those of gzip."""
    pack = PACK[kind]
    assert unpacked(pack(LOG) + pack(b"") + pack(b"end\n")) == (LOG + b"end\n", "")
    if kind == "gzip":
        assert unpacked(pack(LOG) + bytes(100_000)) == (LOG, "")
        assert unpacked(pack(b"a") + bytes(3) + pack(b"b")) == (b"ab", "")
    else:
        skipped = b"\x5a\x2a\x4d\x18\x04\0\0\0abcd"
        assert unpacked(skipped + pack(LOG) + skipped) == (LOG, "")


@pytest.mark.parametrize("kind", PACK)
def test_an_empty_packed_file_is_an_empty_one(kind: str) -> None:
    """No bytes and no complaint."""
    assert unpacked(PACK[kind](b"")) == (b"", "")


@pytest.mark.parametrize("kind", PACK)
def test_a_cut_file_gives_what_it_holds(kind: str) -> None:
    """Everything that can be unpacked, then one message that says where it ends."""
    packed = PACK[kind](LOG)
    for size in (len(packed) - 1, len(packed) // 2, len(packed) // 3):
        out, said = unpacked(packed[:size])
        assert LOG.startswith(out)
        assert said == (
            f"walk.log.gz: the {kind} data ends too early, after {size:,} bytes; what it holds was read"
        )
    assert len(unpacked(gzip.compress(LOG)[:-4])[0]) == len(LOG)
    assert len(unpacked(gzip.compress(LOG)[: len(gzip.compress(LOG)) // 2])[0]) > len(LOG) // 3


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


def test_gzip_is_read_up_to_the_very_damage() -> None:
    """A wrong checksum is noticed when everything has been read, and everything is given."""
    packed = bytearray(gzip.compress(LOG))
    packed[-6] ^= 1
    out, said = unpacked(bytes(packed))
    assert (out, "damaged gzip data after" in said) == (LOG, True)


def test_the_first_lines_of_a_damaged_file_are_given_too() -> None:
    """Also when the damage is so near that it is met before the format is told."""
    packed = gzip.compress(b"".join(LINES[:200]))
    capture = open_recording(io.BytesIO(packed[:-30]), link="can")
    frames = next(capture.batches(100))
    assert len(frames) == 100
    with pytest.raises(CaptureError, match="ends too early"):
        list(capture)


@given(st.sampled_from(sorted(PACK)), st.data())
def test_flipped_bytes_are_an_error_and_nothing_worse(kind: str, data: st.DataObject) -> None:
    """What comes before is given; what was not noticed is the same."""
    packed = bytearray(PACK[kind](LOG[:3000]))
    place = data.draw(st.integers(4, len(packed) - 1))
    packed[place] ^= data.draw(st.integers(1, 255))
    _, said = unpacked(bytes(packed))
    assert said == "" or f"{kind} data" in said or "reading stopped" in said


@pytest.mark.parametrize("kind", PACK)
def test_something_else_behind_is_an_error(kind: str) -> None:
    """It would be lost otherwise."""
    packed = PACK[kind](b"abc\n")
    out, said = unpacked(packed + b"junk")
    assert out == b"abc\n"
    assert said == f"walk.log.gz: damaged {kind} data after {len(packed):,} bytes: something else follows"


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


def test_a_window_that_is_too_large_is_refused() -> None:
    """As `zstd -d` refuses it: more than 128 MiB would have to be kept."""
    options = zstandard.ZstdCompressionParameters(window_log=28)
    packer = zstandard.ZstdCompressor(compression_params=options).compressobj()
    out, said = unpacked(packer.compress(LOG) + packer.flush())
    assert (out, "too much memory" in said) == (b"", True)


def test_without_the_package_the_message_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """What to install, or how to do without."""
    monkeypatch.setitem(sys.modules, "zstandard", None)
    with pytest.raises(CaptureError, match=r"pip install 'aces-bus\[columns\]'.*zstd -dc"):
        open_recording(io.BytesIO(zstd(LOG)), link="can")


@pytest.mark.parametrize("head", [b"\x1f\x8b\x08\x00", b"\x28\xb5\x2f\xfd", b"\x50\x2a\x4d\x18"])
def test_few_bytes_may_become_packed_ones(head: bytes) -> None:
    """Every beginning of what tells a packing is waited for; nothing else is."""
    assert all(may_be_packed(head[:size]) for size in (1, 2, 3))
    assert packing(head)
    assert not may_be_packed(b"")
    assert not may_be_packed(b"(1.")
    assert not packing(b"\x1f\x8b\x08\xff")  # reserved flags


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
