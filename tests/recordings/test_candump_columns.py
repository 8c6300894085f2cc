# The line by line reader is private to its class.
# pyright: reportPrivateUsage=false
"""candump logs as columns: the same frames, counters and problems as line by line, whatever the lines and the cuts.

The line by line reader, which `test_candump` checks against the format's description, is the truth here.
"""

from __future__ import annotations

import io
import os
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable
from aces_bus.errors import CallerError, CaptureError
from aces_bus.frame_table import NO_TIME, Channels, to_ns
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.candump import columns as candump_columns
from aces_bus.recordings.candump import reader as candump
from aces_bus.recordings.candump.reader import CandumpCapture
from aces_bus.recordings.source import BLOCK, ByteSource, split_lines

HEX = "0123456789ABCDEFabcdef"
BYTES = b"()#. \t\r\n0189afAFgRTrt-\x00\xa0\xff"


class Cut(io.RawIOBase):
    """A file that comes in pieces of given sizes, and then whole."""

    def __init__(self, content: bytes, sizes: list[int]) -> None:
        self.content, self.sizes = content, sizes

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        size = min(size, self.sizes.pop() if self.sizes else size)
        data, self.content = self.content[:size], self.content[size:]
        return data


class Writer:
    """Lines like those of a log, and others, by a dice."""

    def __init__(self, dice: random.Random) -> None:
        self.dice = dice
        self.names = dice.choices(
            ["can0", "vcan1", "can#0", "kän", "x", "slcan_of_the_left_arm", "n" * 64], k=dice.randint(1, 3)
        )
        self.seconds = dice.choice(
            [
                "1436509052",
                "1436509053",
                "7",
                "0",
                "999",
                "9223372036",
                "9999999999",
                "123456789",
                "12345678901",
            ]
        )
        self.fraction = dice.choice([6, 6, 6, 1, 3, 9])
        self.suffix = dice.choice(["", "", " R", " T"])
        self.end = dice.choice(["\n", "\n", "\r\n"])

    def digits(self, count: int) -> str:
        return "".join(self.dice.choices(HEX, k=count))

    def common(self) -> str:
        dice = self.dice
        seconds = self.seconds if dice.random() < 0.98 else str(dice.getrandbits(dice.randint(1, 40)))
        fraction = "".join(dice.choices("0123456789", k=self.fraction))
        if dice.random() < 0.7:
            identifier = f"{dice.getrandbits(11 if dice.random() < 0.95 else 12):03X}"
        else:
            identifier = f"{dice.getrandbits(29 if dice.random() < 0.95 else 32):08X}"
        if dice.random() < 0.15:
            data = f"#{dice.choice(HEX)}{self.digits(2 * dice.choice(FD_LENGTHS))}"
        else:
            data = self.digits(2 * dice.randint(0, 8))
        return f"({seconds}.{fraction}) {dice.choice(self.names)} {identifier}#{data}{self.suffix}{self.end}"

    def odd(self) -> str:
        dice = self.dice
        number = dice.randint(0, 0x7FF)
        return dice.choice(
            [
                "\n",
                " \t\r\n",
                "# remark\n",
                "\tprotocol violation\n",
                "DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)\n",
                f"(1.5) can0 20000004#{self.digits(16)}\n",
                f"(1.5) can0 {number:03X}#R8 T\n",
                f"(1.5) can0 {number:03X}#11.22.33\n",
                f"(1.5) can0 {number:03X}#{self.digits(16)}_B\n",
                f"(1.5)  can0   {number:03X}#11\n",
                f"(1.5)   can0 {number:03X}#11\n",
                f"(1.5) can0 {number:03X}#123\n",
                f"(1.5) can0 {number:03X}##0{self.digits(2 * 9)}\n",
                f"(2020-02-03 04:05:06.123456) can0 {number:03X}#11\n",
                f" (1.5)  can0  RX - -  {number:03X}   [2]  11 22\n",
                f"  can0  {number:03X}   [1]  11\n",
                "garbage\n",
                "x" * dice.choice([100, 4095, 4096, 4097, 9000]) + "\n",
            ]
        )

    def log(self, lines: int, oddness: float) -> bytes:
        text = bytearray()
        for _ in range(lines):
            line = (self.odd() if self.dice.random() < oddness else self.common()).encode("latin-1")
            if self.dice.random() < oddness / 2:
                place = self.dice.randrange(len(line))
                line = line[:place] + self.dice.choice(BYTES).to_bytes(1, "big") + line[place + 1 :]
            text += line
        if self.dice.random() < 0.3:
            del text[-self.dice.randint(1, 3) :]
        return (b"\xef\xbb\xbf" if self.dice.random() < 0.2 else b"") + bytes(text)


def ended(capture: CandumpCapture, as_columns: bool) -> tuple[object, ...]:
    """Everything that a capture tells, with the words it ends with."""
    frames: list[Frame] = []
    said = ""
    try:
        for piece in capture.tables() if as_columns else capture._by_line():
            assert len(piece)
            frames += piece.frames() if isinstance(piece, FrameTable) else piece
    except CaptureError as error:
        said = str(error)
    if not as_columns:  # an instant beyond 63 bits is none in a table
        frames = [frame if to_ns(frame.timestamp) != NO_TIME else _without_time(frame) for frame in frames]
    counts = (
        capture.lines,
        capture.frames,
        capture.lines_unreadable,
        capture.lines_comment,
        capture.lines_blank,
        capture.frames_dropped,
    )
    assert capture.lines == sum(counts[1:5])
    return (*counts, capture.problems, said, frames)


def _without_time(frame: Frame) -> Frame:
    values: list[Any] = [getattr(frame, name) for name in Frame.__struct_fields__]
    values[2] = None
    return Frame(*values)


def same(content: bytes, sizes: list[int] | None = None) -> CandumpCapture:
    """Both ways agree; gives the capture that was read as columns."""
    files: list[Any] = [Cut(content, list(sizes or [])) for _ in range(2)]
    ways = [CandumpCapture(ByteSource(file, "walk.log")) for file in files]
    by_line, by_column = ended(ways[0], False), ended(ways[1], True)
    for one, other in zip(by_line, by_column, strict=True):
        assert one == other
    return ways[1]


@pytest.fixture
def eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns from the first line on, instead of where they begin to pay."""
    monkeypatch.setattr(candump, "SMALL", 0)
    monkeypatch.setattr(candump_columns, "FEW", 1)


@pytest.mark.usefixtures("eager")
@pytest.mark.parametrize("seeds", [range(30), range(30, 60)], ids=str)
def test_columns_are_what_the_lines_give(seeds: range) -> None:
    """Any mix of lines: the same frames in the same order, the same counters, problems and last words."""
    for seed in seeds:
        dice = random.Random(seed)
        content = Writer(dice).log(dice.choice([1, 2, 30, 300]), dice.choice([0.0, 0.02, 0.3, 1.0]))
        same(content)


@pytest.mark.usefixtures("eager")
@given(st.integers(0, 1 << 32), st.lists(st.integers(1, 200), max_size=40))
def test_cuts_change_nothing(seed: int, sizes: list[int]) -> None:
    """Wherever the blocks of a file end, also within a line."""
    dice = random.Random(seed)
    same(Writer(dice).log(60, 0.1), sizes)


@pytest.mark.usefixtures("eager")
@given(st.binary(max_size=120), st.integers(0, 40))
def test_any_bytes_may_stand_in_a_log(garbage: bytes, place: int) -> None:
    """Garbage anywhere costs the lines that it stands in, and is counted."""
    log = b"".join(b"(1436509052.%06d) can0 %03X#%016X\n" % (i, i, i) for i in range(20))
    same(log[: 20 * place] + garbage + log[20 * place :])


@pytest.mark.usefixtures("eager")
def test_one_wrong_byte_is_found_at_every_place() -> None:
    """Every column of an even log is checked."""
    line = b"(1436509052.249713) can0 044#0011223344556677 R\n"
    for place in range(len(line) - 2):
        wrong = [line[:place] + bytes([byte]) + line[place + 1 :] for byte in BYTES]
        for number in range(0, len(wrong), 5):  # as many problems are kept
            same(b"".join(line * 3 + one + line * 2 for one in wrong[number : number + 5]))


@pytest.mark.usefixtures("eager")
def test_lines_of_equal_length_may_be_of_different_kinds() -> None:
    """FD and classic, 11 and 29 bits, with and without direction, names: all in lines of one length."""
    lines = [
        b"(1436509052.249713) can0 123##1AABB\n",
        b"(1436509052.249713) can0 123#A1AABB\n",
        b"(1436509052.249713) can0 00000123#1\n",
        b"(1436509052.249713) can0 12345678#\r\n",
        b"(1436509052.249713) can0 123#1122 R\n",
        b"(1436509052.249713) can0 123#11 T\r\n"[:-3] + b" T\n",
        b"(1436509052.249713) vcan10 123#AABB\n",
        b"(143650905.2249713) can0 123#A1AABB\n",
        b"(1436509052.249713) can0 123#R8    \n",
    ]
    for first in lines:
        for second in lines:
            same(first + second + first)


@pytest.mark.parametrize("ending", [b"\n", b"\r\n", b" R\n", b" T\r\n"])
@pytest.mark.parametrize("stamp", [b"1436509052.%06d", b"7.%09d", b"123456789.%03d"])
def test_common_lines_are_read_together(stamp: bytes, ending: bytes) -> None:
    """No line of a usual log goes the slow way, so none becomes slow unseen."""
    bodies = [b"%03X#0102030405060708", b"%03X#", b"%08X#0102", b"%03X##3" + b"AB" * 12]
    lines = [
        b"(" + stamp % number + b") can%d " % (number % 3) + bodies[number % 4] % number + ending
        for number in range(800)
    ]
    columns = candump_columns.CandumpColumns(Channels())
    for some in (lines, lines[::4]):
        usual, table = columns.read(b"".join(some))
        assert (len(usual), int(usual.sum()), len(table)) == (len(some),) * 3


@pytest.mark.slow
def test_a_long_file_is_read_in_large_tables(tmp_path: Path) -> None:
    """Blocks of a mebibyte, tables of at least 65,536 rows but for the last, and none of the times rounded."""
    writer = Writer(random.Random(5))
    even = b"".join(
        b"(1436509052.%09d) can%d %03X#%016X\n" % (i, i % 2, i % 2048, i * 0x9E3779B97F4A7C15 % (1 << 64))
        for i in range(90_000)
    )
    path = tmp_path / "walk.log"
    path.write_bytes(even + writer.log(2_000, 0.1))
    capture = CandumpCapture(ByteSource(path))
    tables = list(capture.tables())
    assert all(len(table) >= 65_536 for table in tables[:-1])
    whole = FrameTable.concat(tables)
    rows = np.arange(90_000)
    assert (whole.time[:90_000] == 1436509052_000000000 + rows).all()
    assert (whole.id[:90_000] == rows % 2048).all()
    assert [capture.channels.names[number] for number in whole.channel[:2]] == ["can0", "can1"]
    data = whole.data[:90_000, :8].copy().view(">u8")[:, 0]
    assert (data == rows.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)).all()
    other = CandumpCapture(ByteSource(path))
    assert ended(CandumpCapture(ByteSource(path)), True) == ended(other, False)


def test_a_live_source_hands_over_what_is_there() -> None:
    """A table for each piece that a pipe gives, without waiting for more."""

    lines = b"(1.5) can0 123#11\n" * 10
    pieces: Any = Cut(lines * 3, [len(lines)] * 3)
    source = ByteSource(pieces)
    source.live = True
    capture = CandumpCapture(source)
    tables = capture.tables()
    assert (len(next(tables)), capture.frames) == (10, 10)
    assert (len(next(tables)), capture.frames) == (10, 20)


def test_what_was_read_before_a_failure_is_given_first() -> None:
    """A device that is pulled out: the frames so far, then one message."""

    class Pulled(Cut):
        def read(self, size: int = -1) -> bytes:
            if not self.content:
                raise OSError(5, "Input/output error")
            return super().read(size)

    pulled: Any = Pulled(b"(1.5) can0 123#11\n" * 9000, [])
    capture = CandumpCapture(ByteSource(pulled, "can.fifo"))
    tables = capture.tables()
    assert len(next(tables)) == 9000
    with pytest.raises(CaptureError, match=r"can\.fifo: reading stopped: Input/output error"):
        next(tables)


@pytest.mark.parametrize("pieces", [1, 2, 3, 7])
def test_parts_of_a_file_add_up_to_it(tmp_path: Path, pieces: int) -> None:
    """Each line is in one part; the parts' lines and frames are those of the whole, in order."""
    path = tmp_path / "walk.log"
    path.write_bytes(Writer(random.Random(3)).log(4_000, 0.05))
    whole = CandumpCapture(ByteSource(path))
    frames = list(whole)
    spans = split_lines(path, pieces, at_least=10_000)
    assert len(spans) == pieces
    assert spans[0][0] == 0
    assert [end for _, end in spans[:-1]] == [start for start, _ in spans[1:]]
    assert spans[-1][1] == path.stat().st_size
    parts = [CandumpCapture(ByteSource(path, span=span)) for span in spans]
    found = [frame for part in parts for table in part.tables() for frame in table.frames()]
    assert [frame.data for frame in found] == [frame.data for frame in frames]
    assert sum(part.lines for part in parts) == whole.lines
    assert sum(part.lines_unreadable for part in parts) == whole.lines_unreadable


def test_a_small_or_packed_file_or_a_pipe_is_one_part(tmp_path: Path) -> None:
    """Nothing is gained by splitting a small file, and nothing packed can be entered in its middle."""
    path = tmp_path / "walk.log"
    path.write_bytes(b"(1.5) can0 123#11\n" * 100)
    assert split_lines(path, 4) == [(0, 1800)]
    path.write_bytes(b"\x1f\x8b\x08\x00" + b"\n" * 5_000_000)
    assert split_lines(path, 4) == [(0, 5_000_004)]
    path.write_bytes(b"")
    assert split_lines(path, 4) == [(0, 0)]
    with pytest.raises(CaptureError, match="no such file"):
        split_lines(tmp_path / "nothing.log", 4)


def test_a_part_needs_a_file_that_has_it(tmp_path: Path) -> None:
    """A stream has no parts, and no part ends before it begins."""
    path = tmp_path / "walk.log"
    path.write_bytes(b"(1.5) can0 123#11\n")
    with pytest.raises(CallerError, match="not a part of a file"):
        ByteSource(path, span=(5, 4))
    assert (
        b"".join(ByteSource(io.BytesIO(b"abc"), span=(7, 10)).blocks()) == b"abc"
    )  # which gives the part already
    reading, writing = os.pipe()
    os.close(writing)
    with open(reading, "rb") as pipe, pytest.raises(CallerError, match="only of a plain file"):
        ByteSource(pipe, span=(0, 3))


def test_blocks_stay_small_until_a_line_is_likely() -> None:
    """What is not a log is refused as early as line by line."""
    capture = CandumpCapture(ByteSource(io.BytesIO(b"junk\n" * 100_000), "walk.log"))
    with pytest.raises(CaptureError, match="not a candump log"):
        list(capture.tables())
    assert capture.lines <= BLOCK
