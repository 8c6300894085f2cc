# What asammdf's way gives is read by one process for many files.
# pyright: reportPrivateUsage=false
"""Ordinary MF4 files, read without asammdf: the frames and counts that asammdf's way gives, and no worse when damaged."""

from __future__ import annotations

import importlib
import importlib.util
import io
import itertools
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.errors import CaptureError
from aces_bus.recordings.source import ByteSource
from aces_lab.formats.mf4 import arrays as mdf4
from aces_lab.formats.mf4 import blocks as mdf
from aces_lab.formats.mf4 import data as _mdf_data
from aces_lab.formats.mf4 import reader as mf4
from aces_lab.formats.mf4.fields import field_of, integers
from aces_lab.formats.mf4.reader import Mf4Capture
from aces_lab.formats.mf4.tree import MdfChannel
from tests.recordings.mdf_files import (
    COUNT_MISSING,
    RECORDS,
    SOME,
    Builder,
    circles,
    content_of,
    damaged_files,
    data_frames,
    later_file,
    listed,
    many,
    ordinary_files,
    packed_file,
    plain_file,
    signals_file,
    unsorted_file,
)

LENGTH_MISSING = 4
Said = tuple[list[Frame], int, int, int, dict[str, int], list[Any]]


class NeedsAsammdf(Exception):
    """The file is left to the other process."""


class Direct(Mf4Capture):
    """Reads what can be read without asammdf."""

    def _through_asammdf(self, folder: str, path: str) -> Iterator[FrameTable]:
        raise NeedsAsammdf(self._why)


def said(capture: Mf4Capture, tables: Iterator[FrameTable]) -> Said:
    """The frames of a capture and what it counts."""
    frames = list(itertools.chain.from_iterable(table.frames() for table in tables))
    parts = capture.frames, capture.lines_unreadable, capture.others
    assert capture.frames == len(frames)
    assert capture.lines == capture.frames + capture.lines_unreadable + sum(capture.others.values())
    assert len(capture.problems) == min(5, capture.lines_unreadable)
    return frames, capture.lines, *parts[1:2], capture.frames, capture.others, capture.problems


def read(content: bytes) -> Said:
    """What comes of a file, read without asammdf."""
    with Direct(ByteSource(io.BytesIO(content), "memory")) as capture:
        return said(capture, capture.tables())


def through_asammdf(contents: Sequence[bytes]) -> Iterator[Said]:
    """What comes of files that one process reads with asammdf."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder, f"{number}.mf4") for number in range(len(contents))]
        for path, content in zip(paths, contents, strict=True):
            path.write_bytes(content)
        process = mf4._start(folder, [str(path) for path in paths])
        try:
            for path in paths:
                with Mf4Capture(ByteSource(str(path))) as capture:
                    yield said(capture, capture._read(process, str(path), folder))
        finally:
            mf4._stop(process)


# ---- files that are ordinary ---------------------------------------------------------------------------------------


needs_asammdf = pytest.mark.skipif(
    importlib.util.find_spec("asammdf") is None, reason="asammdf is not installed"
)


def files_of_python_can(tmp_path: Path) -> Iterator[bytes]:
    """All kinds of frames, plain and packed."""
    can = pytest.importorskip("can")
    for level in (0, 2):
        path = tmp_path / f"{level}.mf4"
        with can.MF4Writer(str(path), compression_level=level) as writer:
            for frame in SOME * 4:
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
        yield path.read_bytes()


def files_of_asammdf(tmp_path: Path) -> Iterator[bytes]:
    """Groups of short and of long frames, plain, packed, and transposed and packed."""
    pytest.importorskip("can")  # before asammdf
    asammdf: Any = importlib.import_module("asammdf")

    bus = asammdf.MDF(version="4.11")
    parts = [
        ("BusChannel", "u1"),
        ("ID", "<u4"),
        ("IDE", "u1"),
        ("DLC", "u1"),
        ("DataLength", "u1"),
        ("Dir", "u1"),
        ("EDL", "u1"),
        ("DataBytes", "u1", 64),
    ]
    for width, count in ((64, 900), (8, 4000)):
        layout = [(f"CAN_DataFrame.{name}", *kind) for name, *kind in parts[:-1]]
        frames = np.zeros(count, [*layout, ("CAN_DataFrame.DataBytes", "u1", (width,))])
        numbers = np.arange(count)
        frames["CAN_DataFrame.BusChannel"] = numbers % 3
        frames["CAN_DataFrame.ID"] = numbers % 0x7FF
        frames["CAN_DataFrame.DLC"] = 15 if width == 64 else 8
        frames["CAN_DataFrame.DataLength"] = width
        frames["CAN_DataFrame.EDL"] = width == 64
        frames["CAN_DataFrame.DataBytes"] = numbers[:, None] % 251
        source = importlib.import_module("asammdf.blocks.v4_blocks").SourceInformation(
            source_type=2, bus_type=2
        )
        signal = asammdf.Signal(frames, numbers * 0.001, name="CAN_DataFrame", source=source)
        bus.append(signal, common_timebase=True)
        bus.groups[-1].channel_group.flags = 2
    for compression in (0, 1, 2):
        saved = bus.save(tmp_path / f"asammdf {compression}.mf4", compression=compression, overwrite=True)
        yield Path(saved).read_bytes()
    bus.close()


@pytest.mark.slow
@needs_asammdf
def test_the_same_as_with_asammdf(tmp_path: Path) -> None:
    """Every frame, count and problem of ordinary files, whoever wrote them, is what asammdf's way gives."""
    files = ordinary_files()
    for name in ("less is announced", "unfinished, cut"):  # asammdf does not say what is behind them
        del files[name]
    for level, content in enumerate(files_of_python_can(tmp_path)):
        files[f"python-can {level}"] = content
    for level, content in enumerate(files_of_asammdf(tmp_path)):
        files[f"asammdf {level}"] = content
    for (name, content), theirs in zip(files.items(), through_asammdf([*files.values()]), strict=True):
        ours = read(content)
        assert ours == theirs, name
        assert (
            len(ours[0]) == {"python-can": 4 * len(SOME), "asammdf": 4900}.get(name[:-2], len(ours[0])) > 0
        ), name


@pytest.mark.slow
@needs_asammdf
def test_what_is_not_ordinary_is_left_to_asammdf() -> None:
    """Later versions go the other way, whole, and are read there."""
    with pytest.raises(NeedsAsammdf):
        read(later_file())
    with open_recording(io.BytesIO(later_file()), link="can") as capture:
        assert sum(map(len, capture.tables())) == capture.frames == 9


def test_asammdf_is_not_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ordinary files are opened by their content and read where asammdf is not installed, and no process is started."""
    monkeypatch.setitem(sys.modules, "asammdf", None)
    monkeypatch.delattr("subprocess.Popen")
    with open_recording(io.BytesIO(content_of(SOME)), link="can") as capture:
        assert list(capture) == SOME
        assert capture.channels.names == ["can0", "can1", None]


def test_an_empty_file_of_our_own() -> None:
    """A file that was written without a frame is a capture without frames; one that was never finished is refused."""
    content = content_of([])
    assert read(content)[0] == []
    unfinished = content[:64] + mdf.header(0, 0, 0, 0) + content[64 + 104 :]
    with pytest.raises(CaptureError, match="was never finished"):
        read(unfinished)


@pytest.mark.parametrize(
    "first",
    [
        content_of(SOME),
        plain_file(RECORDS, 9),
        listed([RECORDS], 9, 0),
        plain_file(RECORDS, 0, COUNT_MISSING),
    ],
    ids=["our own", "plain", "packed", "unfinished"],
)
@pytest.mark.parametrize("second", [content_of(SOME), b"UnFinMF " + content_of(SOME)[8:]])
def test_a_file_that_is_joined_behind_is_said(first: bytes, second: bytes) -> None:
    """The first file's frames are read; that another follows, and where, is counted as one unreadable record."""
    frames, lines, unreadable, *_ = read(first)
    both = read(first + second)
    assert (both[0], both[1], both[2]) == (frames, lines + 1, unreadable + 1)
    assert f"another MDF file begins behind it, at byte {len(first)}," in both[5][-1].reason


def test_a_file_joined_behind_records_without_an_end_is_no_record() -> None:
    """Records of which the length is missing end where another file begins."""
    whole = plain_file(RECORDS, 9)
    frames = read(whole)[0]
    build = Builder()
    group = build.group(data_frames(build), 0, 21)
    first = bytearray(build.finish(group, 0))
    first[:8] = b"UnFinMF "
    struct.pack_into("<HH", first, 60, COUNT_MISSING | LENGTH_MISSING, 0)
    place = first.index(b"##DG") + 24 + 8 * 2
    struct.pack_into("<Q", first, place, len(first))
    first += mdf.data_block(b"") + RECORDS
    got = read(bytes(first) + whole)
    assert got[0] == frames
    assert f"at byte {len(first)}," in got[5][-1].reason


@pytest.mark.slow
@needs_asammdf
def test_a_file_that_is_joined_behind_is_said_by_asammdf_s_way() -> None:
    """Whoever reads the first."""
    with open_recording(io.BytesIO(later_file() + content_of(SOME)), link="can") as capture:
        assert sum(map(len, capture.tables())) == 9
        assert capture.lines_unreadable == 1
        assert "another MDF file begins" in capture.problems[0].reason


def test_a_piece_of_a_record_is_counted() -> None:
    """An unfinished file that ends within a record gives the whole ones, and says that there is one more."""
    for content in (
        plain_file(RECORDS[:-4], 0, flags=COUNT_MISSING),
        cut_stream(),
    ):
        frames, lines, unreadable, *_, problems = read(content)
        assert (lines, unreadable) == (len(frames) + 1, 1)
        assert "of the last record only" in problems[0].reason


def cut_stream() -> bytes:
    """Two groups of frames in one stream, the last record of which is not whole."""
    content = bytearray(many(Builder(), [[0, 1] * 5], [8, 9], 1))
    content[:8] = b"UnFinMF "
    struct.pack_into("<HH", content, 60, COUNT_MISSING, 0)
    at = content.index(b"##DT")
    size = struct.unpack_from("<Q", content, at + 8)[0]
    struct.pack_into("<Q", content, at + 8, size - 5)
    return bytes(content)


def test_bytes_as_long_as_another_field_says() -> None:
    """Data bytes of at most so many, of which a field says how many there are, are read where they stand."""
    content = bytearray(plain_file(RECORDS, 9))
    name = content.index(b"CAN_DataFrame.DataBytes") - 24
    at = content.index(b"##CN", name)
    content[at + 24 + 64] = 5
    assert [frame.data for frame in read(bytes(content))[0]] == [bytes([n] * n) for n in range(9)]


@pytest.mark.parametrize("size", [24, 24 + 21, 24 + 9 * 21])
def test_a_last_block_without_its_length(size: int) -> None:
    """Where the writer was stopped, records go on to the end of the file, as it says; a piece of a record is left."""
    whole = plain_file(RECORDS, 0)
    build = Builder()
    group = build.group(data_frames(build), 0, 21)
    content = bytearray(
        build.finish(group, len(build.out) + 64 + 56)
    )  # a data group and the history come before
    data = len(content)
    struct.pack_into("<Q", content, content.index(b"##DG") + 24 + 16, data)
    content += mdf.block(b"DT", (), RECORDS + RECORDS[:7])
    struct.pack_into("<Q", content, data + 8, size)
    content[:8] = b"UnFinMF "
    struct.pack_into("<HH", content, 60, COUNT_MISSING | LENGTH_MISSING, 0)
    content = content[: data + 24 + len(RECORDS) + 7]
    assert len(read(bytes(content))[0]) == 9
    assert read(whole)[0] == []


@st.composite
def fields(draw: st.DrawFn) -> tuple[MdfChannel, int]:
    """A field of integers somewhere in a record of 16 bytes, and a value of it."""
    is_signed = draw(st.booleans())
    bits = draw(st.integers(1, 64))
    shift = draw(st.integers(0, 7)) if bits <= 57 else 0
    size = (bits + shift + 7) // 8
    at = draw(st.integers(0, 16 - size))
    is_high_first = bits in (8, 16, 32, 64) and not shift and draw(st.booleans())
    low = -(1 << (bits - 1)) if is_signed else 0
    value = draw(st.integers(low, low + (1 << bits) - 1))
    return MdfChannel("x", 0, 2 * is_signed + is_high_first, shift, at, bits), value


@given(fields(), st.integers(0, (1 << 128) - 1))
def test_a_field_at_any_bit(drawn: tuple[MdfChannel, int], around: int) -> None:
    """Whatever stands around it, an integer of any bits, sign and byte order is read as it was written."""
    channel, value = drawn
    mask = (1 << channel.bits) - 1
    place = 8 * channel.first_byte + channel.first_bit
    stored = value & mask
    if channel.data_type % 2:
        stored = int.from_bytes(stored.to_bytes(channel.bits // 8, "big"), "little")
    row = (around & ~(mask << place) | stored << place).to_bytes(16, "little")
    rows = np.frombuffer(row * 3, np.uint8).reshape(3, 16)
    assert integers(rows, field_of(channel, 16)).tolist() == [value] * 3


@given(st.lists(st.integers(0, 3), max_size=400), st.sampled_from([1, 2, 4, 8]), st.integers(0, 40))
def test_records_are_found_in_a_stream(numbers: list[int], width: int, cut: int) -> None:
    """However records of several groups follow each other: all that are whole, in order."""
    steps = {number: width + (5, 9, 5, 0)[number] for number in range(4)}
    stream = b"".join(number.to_bytes(width, "little").ljust(steps[number], b"\xff") for number in numbers)
    stream = stream[: max(0, len(stream) - cut)]
    starts = [0, *itertools.accumulate(steps[number] for number in numbers)]
    whole = [start for start, end in itertools.pairwise(starts) if end <= len(stream)]
    finder = _mdf_data.RecordFinder(width, {number: step - width for number, step in steps.items()})
    found, places, at = finder.find(bytearray(stream), np.frombuffer(stream, np.uint8))
    assert found.tolist() == whole
    assert places.tolist() == numbers[: len(whole)]
    assert at == max([end for end in starts if end <= len(stream)])


def test_streams_that_mix_groups_are_sorted_on_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Through small buffers the same frames come; more than may be written is refused."""
    content = many(Builder(), [[0, 1, 2] * 300, [1] * 500], [8, 8, 20], 1)
    whole = read(content)
    for name, value in (("_PIECE", 200), ("_AHEAD", 4), ("_SINGLE", 8)):
        monkeypatch.setattr(_mdf_data, name, value)
    for name, value in (("_SMALL", 1), ("_ROWS", 7)):
        monkeypatch.setattr(mdf4, name, value)
    assert read(content) == whole
    assert len(whole[0]) == 3 * 300 + 500
    monkeypatch.setattr(mdf4, "_DISK", -4 * len(content))
    with pytest.raises(CaptureError, match="sorting its mixed groups needs more room"):
        read(content)


# ---- files that are damaged ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (signals_file(), "it holds no bus logging, but measured signals in 1 groups"),
        (b"MDF     3.30    ".ljust(200, b"\0"), "MDF version '3.30' has no bus logging"),
        (b"MDF     4.10    ", "it breaks off"),
        *((content, "damaged|no CG block") for number, content in enumerate(circles()) if number != 5),
    ],
)
def test_what_is_no_bus_log_is_refused(content: bytes, says: str) -> None:
    """Signals, old versions, circles and what is named twice: one clear sentence, and no other process."""
    with pytest.raises(CaptureError, match=says):
        read(content)


def borders() -> list[bytes]:
    """Files cut at the border of each block, and a little after."""
    found: list[bytes] = []
    for content in (content_of(SOME), unsorted_file(), listed([RECORDS[:42], RECORDS[42:], b""], 9, 1)):
        at = content.find(b"##")
        while at >= 0:
            found += [content[:end] for end in (at, at + 30)]
            at = content.find(b"##", at + 2)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("contents", [borders, damaged_files], ids=["cut", "flipped"])
def test_damage_costs_frames_and_no_more(contents: Any) -> None:
    """Cut at every border of a block, or with a byte changed: frames and counted losses, or a clear refusal."""
    refused = 0
    for content in contents():
        if content[:4] != b"MDF ":
            continue
        try:
            read(content)
        except (CaptureError, NeedsAsammdf):
            refused += 1
    assert refused


def test_damaged_records_cost_the_rest_of_their_group() -> None:
    """A packed block that does not unpack, or is not as long as it says: what stands before is given, the rest counted."""
    content = bytearray(listed([RECORDS[:42], RECORDS[42:84], RECORDS[84:]], 9, 0))
    second = content.index(b"##DZ", content.index(b"##DZ") + 4)
    for at, fault in (
        (second + 24 + 24 + 4, "packed records are damaged"),
        (second + 24 + 8, "should be 43 bytes"),
    ):
        broken = content.copy()
        broken[at] ^= 0x55 if fault.startswith("packed") else 42 ^ 43
        frames, lines, unreadable, _, _, problems = read(bytes(broken))
        assert (len(frames), lines, unreadable) == (2, 3, 1)
        assert problems[0].reason.startswith(
            "CAN_DataFrame group 0 breaks off: 9 records are announced, 2 are there"
        )
        assert fault in problems[0].reason


def test_a_record_of_no_group() -> None:
    """Where a stream names a group that there is not, it can be followed no further, and that is counted."""
    content = bytearray(many(Builder(), [[0, 1] * 20], [8, 9], 1))
    at = content.index(b"##DT") + 24 + 5 * (22 + 23)
    content[at] = 9
    frames, _, unreadable, _, _, problems = read(bytes(content))
    assert (len(frames), unreadable) == (10, 2)
    assert "15 records" not in problems[0].reason
    assert "a record of a group 9 that there is not" in problems[0].reason


_CHILD = """
import io, resource, sys
import numpy as np
from aces_lab.formats.mf4 import reader as mf4
from aces_bus.recordings.source import ByteSource
from aces_bus.errors import CaptureError

class Left(Exception):
    pass

def left(self, folder, path):
    raise Left

mf4.Mf4Capture._through_asammdf = left
with open("/proc/self/statm") as file:
    room = int(file.read().split()[0]) * resource.getpagesize() + (96 << 20)
resource.setrlimit(resource.RLIMIT_AS, (room, room))
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
rng = np.random.default_rng(int(sys.argv[1]))
whole = [open(path, "rb").read() for path in sys.argv[3:]]
done = 0
for number in range(int(sys.argv[2])):
    content = bytearray(whole[number % len(whole)])
    for _ in range(1 + number % 3):
        at = int(rng.integers(16, len(content)))
        content[at] = (content[at] ^ 1 << int(rng.integers(8))) if number % 2 else int(rng.choice([0, 1, 0x7F, 0xFF]))
    try:
        with mf4.Mf4Capture(ByteSource(io.BytesIO(content), "x")) as capture:
            for table in capture.tables():
                done += len(table)
            assert capture.lines == capture.frames + capture.lines_unreadable + sum(capture.others.values())
    except (CaptureError, Left):
        pass
print(done)
"""


@pytest.mark.slow
def test_flips_in_little_memory(tmp_path: Path) -> None:
    """Bits and bytes changed at random, in a process with 96 MiB: no traceback, no hang, no large allocation."""
    count = 2000 if settings().max_examples > 100 else 500  # of the short profile
    pytest.importorskip("resource")
    if not Path("/proc/self/statm").exists():
        pytest.skip("the system does not say how much memory a process has")
    paths: list[str] = []
    for number, content in enumerate((content_of(SOME), *list(ordinary_files().values())[3:])):
        path = tmp_path / f"{number}.mf4"
        path.write_bytes(content)
        paths.append(str(path))
    environment = {"PYTHONPATH": ":".join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
    ended = subprocess.run(
        [sys.executable, "-c", _CHILD, "1", str(count), *paths],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert int(ended.stdout) > count // 2


def test_what_a_file_claims_takes_no_memory() -> None:
    """A trillion records announced, records of 1 MiB, blocks that unpack to terabytes: only what is there is taken."""
    frames, lines, *_ = read(plain_file(RECORDS, 1 << 40))
    assert (len(frames), lines) == (9, 10)
    build = Builder()
    group = build.group(data_frames(build), 1 << 50, 1 << 20)
    frames, lines, *_ = read(build.finish(group, build.put(mdf.data_block(RECORDS))))
    assert (frames, lines) == ([], 1)
    with pytest.raises(NeedsAsammdf):
        read(packed_file(RECORDS, 21, 1 << 40, claimed=1 << 45))
    _, lines, unreadable, *_, problems = read(packed_file(RECORDS, 21, 1 << 40, claimed=1 << 25))
    assert (lines, unreadable) == (1, 1)
    assert "says of itself what cannot be" in problems[0].reason


def test_blocks_over_each_other() -> None:
    """Data blocks within data blocks would be records without end, and one long name for all takes time without end."""
    build = Builder()
    inner = mdf.data_block(RECORDS)
    outer = build.put(mdf.data_block(inner * 90))
    lists = build.put(mdf.data_list([(outer, 0), *((outer + 24 + n * len(inner), 0) for n in range(90))]))
    with pytest.raises(CaptureError, match="lie over each other"):
        read(build.finish(build.group(data_frames(build), 1 << 40, 21), lists))
    build = Builder()
    name, at = build.text("x" * 4000), 0
    for _ in range(2000):
        at = build.put(mdf.channel(mdf.ChannelBlock(name, mdf.VALUE, mdf.UNSIGNED, 0, 8, 0, at)))
    with pytest.raises(NeedsAsammdf, match="over and over"):
        read(build.finish(build.group(at, 1, 21), 0))


@pytest.mark.parametrize("start", [0, 10**18, (1 << 63) - 1])
def test_times_that_are_no_instants(start: int) -> None:
    """A time outside of what 64 bits of nanoseconds hold costs its own record and no other; such a start, the file."""
    content = bytearray(content_of([Frame(n, b"", n * 1.0) for n in range(4)]))
    struct.pack_into("<Q", content, mdf.HD_AT + 24 + 48, start)
    at = content.index(b"##DT") + 24
    size = (struct.unpack_from("<Q", content, at - 16)[0] - 24) // 4
    struct.pack_into("<q", content, at + size, (1 << 63) - 1)
    frames, _, unreadable, _, _, problems = read(bytes(content))
    if start == (1 << 63) - 1:
        assert [frame.arbitration_id for frame in frames] == [0]
        assert unreadable == 3
    else:
        assert [frame.arbitration_id for frame in frames] == ([0, 1, 2, 3] if not start else [0, 2, 3])
        assert unreadable == bool(start)
    assert all(problem.reason.endswith("a time that is not an instant") for problem in problems)
    struct.pack_into("<Q", content, mdf.HD_AT + 24 + 48, 1 << 63)
    with pytest.raises(CaptureError, match="begins at no instant"):
        read(bytes(content))
