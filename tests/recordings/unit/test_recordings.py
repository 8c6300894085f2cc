"""Recordings: blocks, packed files and times, in parts that all readers share."""

from __future__ import annotations

import gzip
import io
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import open_recording
from aces_bus.errors import CaptureError
from aces_bus.frame_table import Channels, FrameFlag, ns_of
from aces_bus.plugins import installed_items
from aces_bus.recordings.open import formats
from aces_bus.recordings.source import BLOCK, ByteSource
from aces_bus.recordings.unpack import may_be_packed, packing
from aces_bus.recordings.write import open_writer, writer_formats
from aces_bus.recordings.write.base import WrittenChannels
from tests.recordings.test_compressed import LINES as LINES
from tests.recordings.test_compressed import zstd as zstd
from tests.recordings.test_writers import captures as captures
from tests.recordings.test_writers import contents as contents
from tests.recordings.test_writers import read as read
from tests.recordings.test_writers import rows_of as rows_of
from tests.recordings.test_writers import table_of as table_of
from tests.recordings.test_writers import written as written

Row = tuple[int, str | None, int, int, int, bytes]
CHANNELS = ["can0", "can1", "can4"]
WAYS = st.sampled_from([0, FrameFlag.RX, FrameFlag.TX])
STANDARD, WIDE = st.integers(0, 0x7FF), st.integers(0, 0x1FFF_FFFF)
UNKNOWN = "unknown directions (written as received)"
zstandard = pytest.importorskip("zstandard")
LOG = b"".join(LINES)
PACK: dict[str, Callable[[bytes], bytes]] = {"gzip": gzip.compress, "zstandard": zstd}


THEIRS = """
from aces_bus.recordings.base import CanRecording
from aces_bus.frames import Frame
from aces_bus.recordings.open import RecordingFormat
from aces_bus.recordings.write import FormatOut
from aces_bus.recordings.write.candump import CandumpWriter


class TheirCapture(CanRecording):
    format = "theirs"

    def _lists(self):
        number, data = self._source.head().split()[1:]
        yield [Frame(int(number, 16), bytes.fromhex(data.decode()))]


READER = RecordingFormat("theirs", "THEIR log", "can", lambda head: head.startswith(b"THEIR"), "their_format:TheirCapture")
WRITER = FormatOut("theirs", (".their",), "THEIR log", "can", "their_format", "CandumpWriter", is_text=True)
SAME = RecordingFormat("mf4", "another MF4", "can", lambda head: False, "their_format:TheirCapture")
"""


@pytest.fixture
def their_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A distribution on the path; the test writes its entry points."""
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    info = tmp_path / "their_format-1.0.dist-info"
    info.mkdir()
    (tmp_path / "their_format.py").write_text(THEIRS, encoding="utf-8")
    installed_items.cache_clear()
    yield info / "entry_points.txt"
    sys.modules.pop("their_format", None)
    installed_items.cache_clear()


def test_a_format_of_another_package(their_package: Path, tmp_path: Path) -> None:
    """It is listed, chosen by content and by suffix."""
    their_package.write_text(
        "[aces_bus.readers]\ntheirs = their_format:READER\n\n[aces_bus.writers]\ntheirs = their_format:WRITER\n"
    )
    assert formats()["theirs"] == "THEIR log"
    assert writer_formats()["theirs"].suffixes == (".their",)
    log = tmp_path / "walk.any"
    log.write_bytes(b"THEIR 123 0a0b\n")
    with open_recording(log, link="can") as recording:
        assert [(frame.arbitration_id, frame.data.hex()) for frame in recording] == [(0x123, "0a0b")]
    with open_writer(tmp_path / "walk.their") as writer:
        assert writer.format == "theirs"


@pytest.mark.parametrize(
    ("points", "said"),
    [
        ("theirs = their_format:MISSING", "module 'their_format' has no attribute 'MISSING'"),
        ("theirs = their_nothing:READER", "No module named 'their_nothing'"),
        ("theirs = their_format:WRITER", "is left out"),
        ("theirs = their_format:SAME", "'mf4' is left out: another package has that name"),
    ],
)
def test_a_bad_format_costs_only_itself(their_package: Path, tmp_path: Path, points: str, said: str) -> None:
    """It is left out with a warning that names its package; the others are read."""
    their_package.write_text(f"[aces_bus.readers]\n{points}\n")
    log = tmp_path / "walk.log"
    log.write_text("no recording at all\n")
    with (
        pytest.warns(UserWarning, match="their-format: aces_bus.readers") as warned,
        pytest.raises(CaptureError),
    ):
        open_recording(log, link="can")
    assert said in str(warned[0].message)
    assert formats()["mf4"] == "ASAM MDF 4 bus log"
    assert "theirs" not in formats()


def held(form: str, row: Row) -> Row | None:
    """What CSV and SQLite of python-can, and SavvyCAN's CSV, hold of a row; None where they have no way to say it."""
    time, channel, identifier, flags, length, data = row
    is_fd = FrameFlag.FD * (len(data) > 8)
    if form == "gvret":
        if flags & (FrameFlag.REMOTE | FrameFlag.ERROR):
            return None
        way = flags & FrameFlag.TX or FrameFlag.RX
        kept = flags & FrameFlag.EXTENDED | way | is_fd
        return (time + 500) // 1000 * 1000, str(channel).removeprefix("can"), identifier, kept, length, data
    if form == "sqlite":
        time = int(ns_of(np.array([time / 1e9]))[0])
    return (
        time,
        None,
        identifier,
        flags & (FrameFlag.EXTENDED | FrameFlag.REMOTE | FrameFlag.ERROR) | is_fd,
        length,
        data,
    )


def lost_in(form: str, rows: list[Row]) -> dict[str, int]:
    """The words for what is missing."""
    kept = [row for row in rows if held(form, row) is not None]
    found = {
        "CAN FD flags": sum(
            bool(
                row[3] & (FrameFlag.BITRATE_SWITCH | FrameFlag.ERROR_STATE)
                or (row[3] & FrameFlag.FD and row[4] <= 8)
            )
            for row in kept
        )
    }
    if form == "gvret":
        found["remote frames (left out)"] = sum(bool(row[3] & FrameFlag.REMOTE) for row in rows)
        found["error frames (left out)"] = sum(bool(row[3] & FrameFlag.ERROR) for row in rows)
        found[UNKNOWN] = sum(not row[3] & (FrameFlag.RX | FrameFlag.TX) for row in kept)
        found["times finer than 1 µs"] = sum(row[0] % 1000 > 0 for row in kept)
    else:
        found["channel names"] = len({row[1] for row in rows})
        found["directions"] = sum(bool(row[3] & (FrameFlag.RX | FrameFlag.TX)) for row in rows)
    if form == "sqlite":
        found["times finer than a float of seconds"] = sum(held(form, row)[0] != row[0] for row in rows)  # type: ignore[index]
    return {words: count for words, count in found.items() if count}


@pytest.mark.parametrize("form", ["csv", "sqlite", "gvret"])
@given(rows=captures())
def test_tables_of_values_read_back_as_far_as_they_hold(form: str, rows: list[Row]) -> None:
    """Every frame comes back in order; what does not, and what of it does not, is counted."""
    content, lossy = written(form, table_of(rows))
    assert read(form, content) == [kept for row in rows if (kept := held(form, row)) is not None]
    assert lossy == lost_in(form, rows)


def test_names_of_channels_are_kept_apart() -> None:
    """A number becomes an interface of can, blanks go, and two channels never get one name."""
    names = WrittenChannels()
    given_names = ["can0", "0", "CAN 1", "CAN_1", None, "x" * 200]
    row = names.row(Channels(given_names), len(given_names) - 1)
    assert row[:3] == ["can0", "can0_2", "CAN_1"]
    assert len(set(row)) == len(given_names)
    assert all(len(name) <= 64 and " " not in name for name in row)
    assert names.lost == 5


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


def test_gzip_is_read_up_to_the_very_damage() -> None:
    """A wrong checksum is noticed when everything has been read, and everything is given."""
    packed = bytearray(gzip.compress(LOG))
    packed[-6] ^= 1
    out, said = unpacked(bytes(packed))
    assert (out, "damaged gzip data after" in said) == (LOG, True)


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


def test_a_window_that_is_too_large_is_refused() -> None:
    """As `zstd -d` refuses it: more than 128 MiB would have to be kept."""
    options = zstandard.ZstdCompressionParameters(window_log=28)
    packer = zstandard.ZstdCompressor(compression_params=options).compressobj()
    out, said = unpacked(packer.compress(LOG) + packer.flush())
    assert (out, "too much memory" in said) == (b"", True)


@pytest.mark.parametrize("head", [b"\x1f\x8b\x08\x00", b"\x28\xb5\x2f\xfd", b"\x50\x2a\x4d\x18"])
def test_few_bytes_may_become_packed_ones(head: bytes) -> None:
    """Every beginning of what tells a packing is waited for; nothing else is."""
    assert all(may_be_packed(head[:size]) for size in (1, 2, 3))
    assert packing(head)
    assert not may_be_packed(b"")
    assert not may_be_packed(b"(1.")
    assert not packing(b"\x1f\x8b\x08\xff")  # reserved flags
