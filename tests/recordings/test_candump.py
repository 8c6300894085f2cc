"""candump's log and screen output: what each line gives, and that every line is counted.

Expected frames are written out by hand from the format's description; python-can's writer is a second witness.
"""

from __future__ import annotations

import io
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, open_recording
from aces_bus.errors import CaptureError
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.base import CanRecording

GOOD = b"(1436509052.249713) can0 044#2A366C2BBA\n"
T = 1436509052.249713


def read(content: bytes) -> tuple[list[Frame], CanRecording]:
    """All frames of a file with this content, and the capture for its counters."""
    capture = open_recording(io.BytesIO(content), link="can")
    return list(capture), capture


def add_up(capture: CanRecording, content: bytes) -> None:
    """Frames + unreadable + comments + blanks = lines, and the lines are those of the file."""
    body = content.removeprefix(b"\xef\xbb\xbf")
    lines = body.count(b"\n") + (not body.endswith(b"\n") and body != b"")
    assert capture.lines == lines
    parts = capture.frames, capture.lines_unreadable, capture.lines_comment, capture.lines_blank
    assert sum(parts) == lines, parts
    assert len(capture.problems) == min(5, capture.lines_unreadable)


class Cut(io.RawIOBase):
    """A file that comes in pieces of given sizes."""

    def __init__(self, content: bytes, sizes: list[int]) -> None:
        self.content, self.sizes = content, sizes

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        size = min(size, self.sizes.pop() if self.sizes else size)
        data, self.content = self.content[:size], self.content[size:]
        return data


LOG = {
    "classic": (b"(1436509052.249713) can0 044#2A366C2BBA", Frame(0x044, b"\x2a\x36\x6c\x2b\xba", T, "can0")),
    "no data": (b"(0.000001) can0 7FF#", Frame(0x7FF, b"", 0.000001, "can0")),
    "eight bytes": (
        b"(1.5) vcan1 000#0011223344556677",
        Frame(0, bytes.fromhex("0011223344556677"), 1.5, "vcan1"),
    ),
    "lower case": (b"(1.5) can0 0ab#cd", Frame(0xAB, b"\xcd", 1.5, "can0")),
    "nanoseconds": (b"(1436509052.249713123) can0 044#", Frame(0x044, b"", 1436509052.249713123, "can0")),
    "no fraction": (b"(7) can0 044#", Frame(0x044, b"", 7.0, "can0")),
    "padded name": (b"(1.5)   can0 044#01", Frame(0x044, b"\x01", 1.5, "can0")),
    "extended": (b"(1.5) can0 00000123#01", Frame(0x123, b"\x01", 1.5, "can0", is_extended_id=True)),
    "extended, highest": (b"(1.5) can0 1FFFFFFF#", Frame(0x1FFFFFFF, b"", 1.5, "can0", is_extended_id=True)),
    "dots": (b"(1.5) can0 123#11.22.33", Frame(0x123, b"\x11\x22\x33", 1.5, "can0")),
    "received": (b"(1.5) can0 123#11 R", Frame(0x123, b"\x11", 1.5, "can0", is_rx=True)),
    "sent": (b"(1.5) can0 123#11 T", Frame(0x123, b"\x11", 1.5, "can0", is_rx=False)),
    "RX": (b"(1.5) can0 123#11 RX", Frame(0x123, b"\x11", 1.5, "can0", is_rx=True)),
    "TX": (b"(1.5) can0 123#11  TX", Frame(0x123, b"\x11", 1.5, "can0", is_rx=False)),
    "remote": (b"(1.5) can0 123#R", Frame(0x123, b"", 1.5, "can0", is_remote_frame=True, dlc=0)),
    "remote, 8 bytes": (
        b"(1.5) can0 123#R8 T",
        Frame(0x123, b"", 1.5, "can0", False, True, is_rx=False, dlc=8),
    ),
    "remote, raw code": (b"(1.5) can0 123#R8_E", Frame(0x123, b"", 1.5, "can0", False, True, dlc=8)),
    "raw length code": (
        b"(1.5) can0 123#1122334455667788_B",
        Frame(0x123, bytes.fromhex("1122334455667788"), 1.5, "can0"),
    ),
    "FD": (b"(1.5) can0 123##1AABB", Frame(0x123, b"\xaa\xbb", 1.5, "can0", is_fd=True, bitrate_switch=True)),
    "FD, error state": (
        b"(1.5) can0 123##2",
        Frame(0x123, b"", 1.5, "can0", is_fd=True, error_state_indicator=True),
    ),
    "FD, both, dots": (
        b"(1.5) can0 12345678##7.AA.BB R",
        Frame(0x12345678, b"\xaa\xbb", 1.5, "can0", True, False, False, True, True, True, True),
    ),
    "FD, 64 bytes": (b"(1.5) can0 123##0" + b"5A" * 64, Frame(0x123, b"\x5a" * 64, 1.5, "can0", is_fd=True)),
    "error frame": (
        b"(1.5) can0 20000004#0004000000000000",
        Frame(0x4, bytes.fromhex("0004000000000000"), 1.5, "can0", is_error_frame=True),
    ),
}

SCREEN = {
    "classic": (b"  can0  123   [2]  11 22", Frame(0x123, b"\x11\x22", None, "can0")),
    "no data": (b"  can0  123   [0]", Frame(0x123, b"", None, "can0")),
    "extended": (b"  can0  00000123   [1]  11", Frame(0x123, b"\x11", None, "can0", is_extended_id=True)),
    "standard, indented": (b"  can0       123   [1]  11", Frame(0x123, b"\x11", None, "can0")),
    "-t a": (b" (1436509052.249713)  can0  123   [1]  11", Frame(0x123, b"\x11", T, "can0")),
    "-t z": (b" (000.000120)  can0  123   [1]  11", Frame(0x123, b"\x11", 0.00012, "can0")),
    "FD": (
        b"  can0  123  [08]  11 22 33 44 55 66 77 88",
        Frame(0x123, bytes.fromhex("1122334455667788"), None, "can0", is_fd=True),
    ),
    "FD, 12 bytes": (
        b"  can0  123  [12] " + b" AB" * 12,
        Frame(0x123, b"\xab" * 12, None, "can0", is_fd=True),
    ),
    "-x received": (b"  can0  RX - -  123   [1]  11", Frame(0x123, b"\x11", None, "can0", is_rx=True)),
    "-x sent, FD": (
        b"  can0  TX B E  123  [01]  11",
        Frame(0x123, b"\x11", None, "can0", False, False, False, True, True, True, False),
    ),
    "remote": (
        b"  can0  123   [4]  remote request",
        Frame(0x123, b"", None, "can0", is_remote_frame=True, dlc=4),
    ),
    "error frame": (
        b"  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME",
        Frame(4, bytes.fromhex("0004000000000000"), None, "can0", is_error_frame=True),
    ),
    "-a": (b"  can0  123   [3]  41 27 20                 'A' '", Frame(0x123, b"A' ", None, "can0")),
    "-a looks like hex": (
        b"  can0  123   [2]  41 42                   'AB'",
        Frame(0x123, b"AB", None, "can0"),
    ),
    "-S": (b"  can0  123   [3]  33`22`11", Frame(0x123, b"\x11\x22\x33", None, "can0")),
    "-S -a": (b"  can0  123   [3]  43`42`41                 `CBA`", Frame(0x123, b"ABC", None, "can0")),
    "-i": (b"  can0  123   [2]  00000001 10000000", Frame(0x123, b"\x01\x80", None, "can0")),
    "-8": (
        b"  can0  123  {B}  11 22 33 44 55 66 77 88",
        Frame(0x123, bytes.fromhex("1122334455667788"), None, "can0"),
    ),
    "-c": (b" \x1b[1;34m can0\x1b[0m  123   [1]  11", Frame(0x123, b"\x11", None, "can0")),
    "early": (b"  can0   12  [2] 11 22", Frame(0x12, b"\x11\x22", None, "can0")),
    "early, extended": (
        b"  can0        12  [2] 11 22",
        Frame(0x12, b"\x11\x22", None, "can0", is_extended_id=True),
    ),
}


@pytest.mark.parametrize("ending", [b"\n", b"\r\n", b""], ids=["LF", "CRLF", "no end"])
def test_a_log_line_gives_its_frame(ending: bytes) -> None:
    """Every form of `candump -L` line is read, whatever ends it."""
    for case, (line, expected) in LOG.items():
        frames, capture = read(line + ending)
        assert frames == [expected], case
        add_up(capture, line + ending)


@pytest.mark.parametrize("ending", [b"\n", b"\r\n", b""], ids=["LF", "CRLF", "no end"])
def test_a_screen_line_gives_its_frame(ending: bytes) -> None:
    """What candump prints on a terminal is read too, with each of its display options."""
    for case, (line, expected) in SCREEN.items():
        frames, capture = read(line + ending)
        assert frames == [expected], case
        add_up(capture, line + ending)


def test_a_date_is_local_time() -> None:
    """`candump -t A` prints local time; its digits are all kept."""
    seconds = int(time.mktime((2015, 7, 9, 10, 24, 12, 0, 0, -1)))
    frames, _ = read(b" (2015-07-09 10:24:12.249713)  can0  123   [1]  11\n")
    assert frames[0].timestamp == float(f"{seconds}.249713")


UNREADABLE = {
    "odd number of hexadecimal digits": b"(1.5) can0 123#112",
    "odd number of hexadecimal digits ": b"(1.5) can0 123##0112",
    "'X' in the data is not hexadecimal": b"(1.5) can0 123#1X",
    "a dot splits a byte": b"(1.5) can0 123#1.12",
    "a classic CAN frame cannot carry 9 data bytes": b"(1.5) can0 123#" + b"11" * 9,
    "a CAN FD frame cannot carry 9 data bytes": b"(1.5) can0 123##0" + b"11" * 9,
    "a CAN FD frame cannot carry 65 data bytes": b"(1.5) can0 123##0" + b"11" * 65,
    "identifier 0x800 is outside 0…0x7ff": b"(1.5) can0 800#11",
    "identifier 0x92345678 is outside 0…0x1fffffff": b"(1.5) can0 92345678#11",
    "identifier 0x60000001 is outside 0…0x1fffffff": b"(1.5) can0 60000001#11",
    "identifier 1234 has 4 digits, not 3 or 8": b"(1.5) can0 1234#11",
    "identifier 12G is not hexadecimal": b"(1.5) can0 12G#11",
    "no flags digit after ##": b"(1.5) can0 123##",
    "after R comes a length of 0 to 8": b"(1.5) can0 123#R9",
    "raw length code with 2 data bytes; only 8 may have one": b"(1.5) can0 123#1122_B",
    "CAN XL is not supported": b"(1.5) can0 123###81000:00:00000000#11",
    "time stamp 'now' is neither seconds nor a date": b"(now) can0 123#11",
    "time stamp '2015-13-09 10:24:12' is not a date": b"(2015-13-09 10:24:12) can0 123#11",
    "[8] bytes are announced, 3 are there": b"  can0  123   [8]  11 22 33",
    "[2] bytes are announced, 1 are there": b"  can0  123   [2]  11 2",
    "more than its [1] bytes, or a remark that candump does not write": b"  can0  123   [1]  11 22",
    "a classic CAN frame cannot carry 9 data bytes ": b"  can0  123   [9] " + b" 11" * 9,
    "not a line of candump": b"(1436509052.249713) can0 04",
    "not a line of candump ": b"hello",
    "not a line of candump  ": b"(1.5) can0 123#11 22",
    "not a line of candump   ": b"(1.5) ca\x00n0 123#11",
    "longer than 4096 bytes": b"(1.5) can0 123#11" + b" " * 4096,
    "longer than 4096 bytes ": b"#" * 4097,
}


@pytest.mark.parametrize("ending", [b"\n", b"\r\n", b""], ids=["LF", "CRLF", "no end"])
def test_an_unreadable_line_is_counted_with_its_reason(ending: bytes) -> None:
    """A wrong line costs nothing but itself: it is counted, and says where it is and why."""
    for reason, line in UNREADABLE.items():
        content = GOOD + line + ending
        frames, capture = read(content)
        assert len(frames) == 1, reason
        assert [(problem.line, problem.reason) for problem in capture.problems] == [(2, reason.strip())]
        assert capture.problems[0].excerpt.isprintable(), reason
        assert len(capture.problems[0].excerpt) <= 4 * 80, reason
        add_up(capture, content)


def test_remarks_and_blank_lines_are_no_faults() -> None:
    """Comments, blank lines, candump's own remarks and its explanations of error frames are counted apart."""
    content = (
        b"# walk of Tuesday\n\n   \r\n"
        + GOOD
        + b"  can0  20000088   [8]  00 00 80 19 00 00 00 00   ERRORFRAME\n"
        + b"\tprotocol-violation{{tx-error}{acknowledge-slot}}\n\tbus-error\n"
        + b"DROPCOUNT: dropped 17 CAN frames on 'can0' socket (total drops 17)\n"
        + GOOD
        + b"\tno explanation of anything\n"
    )
    frames, capture = read(content)
    assert [frame.is_error_frame for frame in frames] == [False, True, False]
    assert (capture.lines_comment, capture.lines_blank, capture.lines_unreadable) == (4, 2, 1)
    assert capture.frames_dropped == 17
    add_up(capture, content)


def test_five_problems_are_kept_and_all_are_counted() -> None:
    """Memory does not grow with the number of faults."""
    content = (GOOD + b"oops\n") * 20
    frames, capture = read(content)
    assert (len(frames), capture.frames, capture.lines_unreadable) == (20, 20, 20)
    assert [problem.line for problem in capture.problems] == [2, 4, 6, 8, 10]
    add_up(capture, content)


def test_junk_in_front_does_not_hide_a_log() -> None:
    """A log whose first lines are something else is decoded, and they are counted."""
    content = b"\x00\x01 junk\n" * 50 + GOOD * 3
    frames, capture = read(content)
    assert (len(frames), capture.lines_unreadable) == (3, 50)
    add_up(capture, content)


def test_a_tail_of_zeros_after_a_power_cut_is_one_unreadable_line() -> None:
    """What a crash leaves at the end of a file does not cost the recording."""
    content = GOOD * 3 + b"\x00" * 5000
    frames, capture = read(content)
    assert (len(frames), capture.lines_unreadable) == (3, 1)
    add_up(capture, content)


def test_an_empty_file_is_an_empty_recording() -> None:
    """No lines, no frames, no fault; nor with remarks alone."""
    for content in (b"", b"\n\n", b"# nothing happened\n", b"\xef\xbb\xbf"):
        frames, capture = read(content)
        assert frames == []
        assert capture.lines_unreadable == 0
        add_up(capture, content)


def test_a_byte_order_mark_is_no_part_of_the_first_line() -> None:
    """Files saved by an editor of another system are read."""
    frames, capture = read(b"\xef\xbb\xbf" + GOOD)
    assert len(frames) == 1
    assert capture.lines_unreadable == 0


def test_faulty_log_lines_alone_are_still_a_log() -> None:
    """A log in which every line is damaged is counted, not refused: it is meant as one."""
    content = b"(1.5) can0 123#112\n" * 300
    frames, capture = read(content)
    assert (frames, capture.lines_unreadable) == ([], 300)
    add_up(capture, content)


@pytest.mark.slow
def test_names_and_identifiers_do_not_fill_the_memory() -> None:
    """A log with ever new names and identifiers is read like any other."""
    content = b"".join(b"(%d.0) if%d %08X#\n" % (i, i, i * 3) for i in range(9000))
    frames, _ = read(content)
    assert [(frame.arbitration_id, frame.channel) for frame in frames] == [
        (i * 3, f"if{i}") for i in range(9000)
    ]


# ---- files, pipes, batches -------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 7, 1024, 100_000])
def test_batches_are_full_and_in_order(tmp_path: Path, n: int) -> None:
    """From a file come lists of n frames, the last one shorter; together they are the frames."""
    path = tmp_path / "walk.log"
    path.write_bytes(b"".join(b"(%d.5) can0 %03X#%04X\n" % (i, i % 0x800, i) for i in range(10_000)))
    with open_recording(path, link="can") as capture:
        sizes, frames = list[int](), list[Frame]()
        for batch in capture.batches(n):
            sizes.append(len(batch))
            frames += batch
    assert set(sizes[:-1]) <= {n}
    assert sizes[-1] == 10_000 % n or sizes[-1] == n
    assert [frame.timestamp for frame in frames] == [i + 0.5 for i in range(10_000)]


@pytest.fixture
def pipe() -> Iterator[tuple[io.FileIO, int]]:
    """A reading end as a file, and a writing end."""
    reader, writer = os.pipe()
    with open(reader, "rb", buffering=0) as file:
        yield file, writer
        try:
            os.close(writer)
        except OSError:
            pass


def test_a_pipe_gives_each_line_when_it_comes(pipe: tuple[io.FileIO, int]) -> None:
    """No frame waits for the next one, nor for a batch to fill."""
    file, writer = pipe
    os.write(writer, GOOD[:10])
    capture = open_recording(file, link="can")
    assert capture.live
    batches = capture.batches(1024)
    os.write(writer, GOOD[10:])
    assert len(next(batches)) == 1
    os.write(writer, GOOD + GOOD + GOOD[:20])
    assert len(next(batches)) == 2
    os.write(writer, GOOD[20:] + b"(1.5) can0 12")
    assert len(next(batches)) == 1
    os.close(writer)
    assert list(batches) == []
    assert (capture.frames, capture.lines_unreadable) == (4, 1)


def test_frames_of_a_pipe_come_one_by_one(pipe: tuple[io.FileIO, int]) -> None:
    """Iterating over a pipe gives what is there before it waits."""
    file, writer = pipe
    os.write(writer, GOOD)
    frames = iter(open_recording(file, link="can"))
    assert next(frames).arbitration_id == 0x044
    os.write(writer, GOOD)
    assert next(frames).arbitration_id == 0x044
    os.close(writer)
    assert list(frames) == []


def test_a_pipe_that_is_no_log_is_refused_while_it_is_read(pipe: tuple[io.FileIO, int]) -> None:
    """Before the first bytes a pipe cannot be judged; after 200 lines, or at its end, it can."""
    file, writer = pipe
    os.write(writer, b"not a log\n" * 200)
    capture = open_recording(file, link="can", name="-")
    with pytest.raises(CaptureError, match="-: not a candump log: line 1 is 'not a log'"):
        list(capture)


def test_counters_hold_what_was_read_so_far() -> None:
    """Whoever stops in the middle (Ctrl-C) finds the counters of what was handed out, and no less."""
    capture = open_recording(io.BytesIO(GOOD * 5000), link="can")
    batches = capture.batches(100)
    next(batches)
    assert 100 <= capture.frames == capture.lines <= 5000


@pytest.mark.shared
def test_the_shared_log_is_read_whole(shared_captures: Path) -> None:
    """The recorded set-up frames: thirteen, on two channels."""
    with open_recording(shared_captures / "hubo-can" / "nameinfo_commands.candump", link="can") as capture:
        frames = list(capture)
    assert len(frames) == capture.lines == 13
    assert frames[0] == Frame(0x001, bytes.fromhex("00010A0A0A8445FD"), 0.0, "can0")
    assert [frame.channel for frame in frames] == ["can0"] * 7 + ["can1"] * 6


# ---- laws ------------------------------------------------------------------------------------------------------------


@st.composite
def log_lines(draw: st.DrawFn) -> tuple[bytes, Frame]:
    """A line as candump writes it, and its frame: built together, from the format's rules."""
    extended = draw(st.booleans())
    identifier = draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF))
    seconds, micros = draw(st.integers(0, 2**31)), draw(st.integers(0, 999_999))
    channel = draw(st.sampled_from(["can0", "vcan12", "slcan-x", "kanål"]))
    kind = draw(st.sampled_from(["classic", "remote", "fd"]))
    size = draw(st.integers(0, 8)) if kind != "fd" else draw(st.sampled_from(FD_LENGTHS))
    data = draw(st.binary(min_size=size, max_size=size)) if kind != "remote" else b""
    flags = draw(st.integers(0, 3)) if kind == "fd" else 0
    is_rx = draw(st.sampled_from([None, True, False]))
    body = {"classic": data.hex(), "remote": f"R{size or ''}", "fd": f"#{flags:X}{data.hex()}"}[kind]
    digits = f"{identifier:08X}" if extended else f"{identifier:03X}"
    suffix = {None: "", True: " R", False: " T"}[is_rx]
    line = f"({seconds:010d}.{micros:06d}) {channel} {digits}#{body.upper()}{suffix}\n"
    frame = Frame(
        identifier,
        data,
        float(f"{seconds}.{micros:06d}"),
        channel,
        extended,
        kind == "remote",
        False,
        kind == "fd",
        bool(flags & 1),
        bool(flags & 2),
        is_rx,
        size if kind == "remote" else None,
    )
    return line.encode(), frame


@given(st.lists(log_lines(), max_size=20))
def test_what_candump_writes_is_read_back(cases: list[tuple[bytes, Frame]]) -> None:
    """Every frame that candump can log comes back as it was."""
    content = b"".join(line for line, _ in cases)
    frames, capture = read(content)
    assert frames == [frame for _, frame in cases]
    add_up(capture, content)


@given(st.lists(log_lines(), min_size=1, max_size=8))
def test_what_python_can_writes_is_read_too(
    tmp_path_factory: pytest.TempPathFactory, cases: list[tuple[bytes, Frame]]
) -> None:
    """A log written by python-can's writer gives the frames that went into it."""
    path = tmp_path_factory.mktemp("logs") / "walk.log"
    clock = 0.0
    with can.CanutilsLogWriter(path) as writer:
        for _, frame in cases:
            clock += 0.25
            writer.on_message_received(
                can.Message(
                    timestamp=clock,
                    arbitration_id=frame.arbitration_id,
                    is_extended_id=frame.is_extended_id,
                    is_remote_frame=frame.is_remote_frame,
                    is_fd=frame.is_fd,
                    bitrate_switch=frame.bitrate_switch,
                    error_state_indicator=frame.error_state_indicator,
                    channel=frame.channel,
                    is_rx=bool(frame.is_rx),
                    dlc=frame.length,
                    data=None if frame.is_remote_frame else frame.data,
                    check=True,
                )
            )
    frames = list(open_recording(path, link="can"))
    names = ["arbitration_id", "data", "is_extended_id", "is_remote_frame", "is_fd", "bitrate_switch"]
    for got, (_, frame) in zip(frames, cases, strict=True):
        assert [getattr(got, name) for name in names] == [getattr(frame, name) for name in names]
        assert got.is_rx is bool(frame.is_rx)
    assert [frame.timestamp for frame in frames] == [0.25 * (i + 1) for i in range(len(cases))]


PIECES = st.one_of(
    log_lines().map(lambda case: case[0]),
    st.sampled_from([line + b"\n" for line, _ in (*LOG.values(), *SCREEN.values())]),
    st.sampled_from([line + b"\r\n" for line in UNREADABLE.values()]),
    st.sampled_from([b"\n", b"# note\n", b"\r\n", b"\x00\x00", b"\t\n", b"[", b"#", b"(1.5) "]),
    st.binary(max_size=12),
)


@given(st.lists(PIECES, max_size=20).map(b"".join), st.lists(st.integers(1, 400), max_size=60))
def test_how_a_file_is_cut_makes_no_difference(content: bytes, sizes: list[int]) -> None:
    """Read whole or in pieces of any size, the frames, the counters and the problems are the same."""
    content = GOOD + content
    whole, one = read(content)
    source: Any = Cut(content, sizes)
    other = open_recording(source, link="can")
    pieces = list(other)
    assert pieces == whole
    assert other.problems == one.problems
    assert (other.lines, other.lines_comment, other.lines_blank) == (
        one.lines,
        one.lines_comment,
        one.lines_blank,
    )
    add_up(one, content)
    add_up(other, content)


@given(st.one_of(st.binary(max_size=600), st.lists(PIECES, max_size=12).map(b"".join)))
def test_no_content_does_harm(content: bytes) -> None:
    """Whatever a file holds: it is refused with a `CaptureError`, or every line of it is counted."""
    message = ""
    try:
        _, capture = read(content)
        add_up(capture, content)
    except CaptureError as error:
        message = str(error)
    assert not message or message.startswith("<stream>: ")
    assert "\n" not in message


@given(log_lines(), st.data())
def test_a_damaged_line_is_a_frame_or_counted(case: tuple[bytes, Frame], data: st.DataObject) -> None:
    """One byte changed, lost or added anywhere: still every line is counted."""
    line = case[0]
    place = data.draw(st.integers(0, len(line) - 1))
    insert = data.draw(st.binary(max_size=2))
    content = GOOD + line[:place] + insert + line[place + data.draw(st.integers(0, 1)) :] + GOOD
    _, capture = read(content)
    add_up(capture, content)
