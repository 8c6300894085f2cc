"""`aces convert`: what is written, what is counted, what is said, and what is left when it ends early."""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.recordings.filters import parse_filter, passing
from aces_bus.recordings.merge import Merge
from aces_bus.recordings.open import formats
from aces_tools import console, convert

from .conftest import LOG, Aces

#: Nothing in it that any of the formats with numbered channels cannot hold.
PLAIN = """\
(1436509052.000000) can0 060#0A000000F6FFFFFF R
(1436509052.010000) can1 00012345#0100 T
(1436509052.020000) can0 300#R8 R
(1436509052.030000) can1 123##1000102030405060708090A0B T
(1436509052.040000) can0 7FF# R
"""


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """A candump log that all formats hold."""
    path = tmp_path / "plain.log"
    path.write_text(PLAIN, encoding="utf-8")
    return path


def lines(path: Path) -> list[str]:
    """The lines of a log."""
    return path.read_text(encoding="utf-8").splitlines()


# ---------------------------------------------------------------------- there and back


@pytest.mark.parametrize("suffix", ["log", "asc", "blf", "trc", "pcapng", "mf4", "log.gz", "blf.zst"])
def test_there_and_back(aces: Aces, plain: Path, tmp_path: Path, suffix: str) -> None:
    """A log converted to a format and back is the same log, and nothing is said to be lost on either way."""
    if suffix.split(".")[0].replace("log", "candump") not in formats():
        pytest.skip(f"no reader of {suffix}")
    there, back = tmp_path / f"there.{suffix}", tmp_path / "back.log"
    first = aces("convert", plain, there, "--strict")
    assert (first.status, first.messages) == (0, [])
    assert first.summary == {"frames": 5, "written": 5, "filtered": 0, "errors": 0, "lines_unreadable": 0}
    second = aces("convert", there, back, "--strict")
    assert (second.status, [text for text in second.messages if " is named can" not in text]) == (0, [])
    assert back.read_text(encoding="utf-8") == PLAIN


@pytest.mark.parametrize(
    ("suffix", "status"), [("asc", 1), ("blf", 1), ("trc", 1), ("pcapng", 0), ("mf4", 0)]
)
def test_the_direction_of_an_error_frame_is_a_loss(
    aces: Aces, tmp_path: Path, suffix: str, status: int
) -> None:
    """Where the format has none it is said, and --strict knows it."""
    log = tmp_path / "walk.log"
    log.write_text("(1.0) can0 20000080#0000000000000000 T\n(1.1) can0 123#00 T\n", encoding="utf-8")
    result = aces("convert", log, tmp_path / f"walk.{suffix}", "--strict")
    assert result.status == status
    assert any("1 directions of error frames" in line for line in result.messages) == bool(status)


@pytest.mark.parametrize(("lost", "said"), [(1, "1 frame"), (17, "17 frames")])
def test_what_the_recorder_lost_is_counted(aces: Aces, tmp_path: Path, lost: int, said: str) -> None:
    """One frame is one frame."""
    log = tmp_path / "walk.log"
    log.write_text(
        f"(1.0) can0 123#00\nDROPCOUNT: dropped {lost} CAN frames on 'can0' socket (total drops {lost})\n",
        encoding="utf-8",
    )
    result = aces("convert", log, tmp_path / "walk.asc")
    assert f"the recorder says that it lost {said}" in result.messages


def test_serial_recordings(aces: Aces, tmp_path: Path) -> None:
    """Raw bytes become a hex dump and come back; the summary counts bytes."""
    raw, dump, back = tmp_path / "a.bin", tmp_path / "a.dxconf.txt", tmp_path / "b.bin"
    raw.write_bytes(bytes(range(100)))
    result = aces("convert", raw, dump)
    assert result.summary == {"bytes": 100, "written": 100, "filtered": 0, "lines_unreadable": 0}
    assert aces("convert", dump, back, "--strict").status == 0
    assert back.read_bytes() == bytes(range(100))


def test_our_serial_log(aces: Aces, tmp_path: Path) -> None:
    """A serial log of ours becomes raw bytes, with what these do not hold counted, and a part of it by time."""
    if "slog" not in formats():
        pytest.skip("no reader of slog")
    from aces_bus.recordings.base import Chunk
    from aces_bus.recordings.write import open_writer

    log, raw = tmp_path / "a.slog", tmp_path / "a.bin"
    with open_writer(log) as writer:
        for number in range(4):
            writer.write(Chunk(bytes([number]), 100.0 + number, "to device"))
    result = aces("convert", log, raw, "--from", "1", "--to", "3")
    assert raw.read_bytes() == b"\x01\x02"
    assert result.messages == [
        "raw serial bytes does not hold: 2 times of chunks",
        "raw serial bytes does not hold: 2 directions of chunks",
    ]
    assert result.summary == {"bytes": 4, "written": 2, "filtered": 2, "lines_unreadable": 0}
    assert aces("convert", log, raw, "--strict").status == 1


# ---------------------------------------------------------------------- what is said


def test_everything_is_accounted_for(aces: Aces, log: Path, tmp_path: Path) -> None:
    """Unreadable lines are shown with their number, losses are said a line each, and the parts sum to the total."""
    out = tmp_path / "out.asc"
    result = aces("convert", log, out)
    assert result.status == 0
    assert result.messages == [
        f"{log}:7: not a line of candump: 'not a line of a log'",
        "Vector ASC does not hold: 11 unknown directions (written as received)",
        "Vector ASC does not hold: 1 classes and data of error frames",
    ]
    assert result.summary == {"frames": 12, "written": 12, "filtered": 0, "errors": 1, "lines_unreadable": 1}
    strict = aces("convert", log, out, "--strict")
    assert strict.status == 1
    assert strict.messages[-1].startswith("--strict: 11 unknown directions")
    assert strict.messages[-1].endswith("1 unreadable line")
    assert sum(line.count("ErrorFrame") for line in lines(out)) == 1


def test_filters_and_times(aces: Aces, log: Path, tmp_path: Path) -> None:
    """Filters are candump's; times count from the first frame, or since 1970, and end before --to."""
    out = tmp_path / "out.log"
    result = aces("convert", log, out, "--filter", "060:7FF", "--filter", "can1")
    assert [line.split()[1:] for line in lines(out)] == [
        ["can0", "060#0A000000F6FFFFFF"],
        ["can0", "060#0102"],
        ["can1", "400#"],
        ["can1", "700#R"],
    ]
    assert (result.summary["written"], result.summary["filtered"]) == (4, 8)
    aces("convert", log, out, "--from", "0.01", "--to", "0.03")
    assert [line.split("#")[0][-3:] for line in lines(out)] == ["062", "300"]
    aces("convert", log, out, "--from", "1436509052.1", "--filter", "400:7FF")
    assert [line.split()[0] for line in lines(out)] == ["(1436509052.100000)"]


def test_channels_get_other_names(aces: Aces, plain: Path, tmp_path: Path) -> None:
    """--channel renames, two channels into one as well; --filter goes by the old names; what is not there is said."""
    out = tmp_path / "out.log"
    result = aces("convert", plain, out, "--map", "can0=drive", "--map", "x=y", "--filter", "can0")
    assert [line.split()[1] for line in lines(out)] == ["drive"] * 3
    assert result.messages == ["--map: no frame came from 'x' (there are: can0, can1)"]
    aces("convert", plain, out, "--map", "can0=body", "--map", "can1=body")
    assert [line.split()[1] for line in lines(out)] == ["body"] * 5
    absent = aces("convert", plain, out, "--filter", "can7")
    assert absent.messages == ["--filter: no frame came from 'can7' (there are: can0, can1)"]


def test_an_unnamed_channel_gets_a_name(aces: Aces, tmp_path: Path) -> None:
    """`--channel =NAME` names the channel of recordings that do not say it."""
    if "trc" not in formats():
        pytest.skip("no reader of TRC")
    trace, out = tmp_path / "a.trc", tmp_path / "out.log"
    trace.write_bytes(
        b";$FILEVERSION=1.1\r\n;$STARTTIME=42195.5\r\n     1)        10.0  Rx     0001  1  0A\r\n"
    )
    with open_recording(trace, link="can") as capture:
        (frame,) = capture
    if frame.channel is not None:
        pytest.skip("the reader names it")
    aces("convert", trace, out, "--map", "=drive")
    assert [line.split()[1:] for line in lines(out)] == [["drive", "001#0A", "R"]]


# ---------------------------------------------------------------------- several files


def test_several_files(aces: Aces, tmp_path: Path) -> None:
    """Files follow one another as they are named; with --merge all frames are in order of time."""
    one, two, out = tmp_path / "1.log", tmp_path / "2.log", tmp_path / "out.log"
    one.write_text("(3.0) can0 001#\n(5.0) can1 001#\n", encoding="utf-8")
    two.write_text("(1.0) can1 002#\n(4.0) can0 002#\n(4.0) can2 002#\n(6.0) can0 002#\n", encoding="utf-8")
    assert aces("convert", one, two, out).summary["written"] == 6
    assert [line.split()[0][10:12] for line in lines(out)] == ["3.", "5.", "1.", "4.", "4.", "6."]
    assert aces("convert", "--merge", one, two, out).summary["written"] == 6
    assert [(line[10:12], line.split()[1]) for line in lines(out)] == [
        ("1.", "can1"),
        ("3.", "can0"),
        ("4.", "can0"),
        ("4.", "can2"),
        ("5.", "can1"),
        ("6.", "can0"),
    ]


@given(
    times=st.lists(st.lists(st.integers(0, 50), max_size=20).map(sorted), min_size=1, max_size=4),
    sizes=st.lists(st.integers(1, 7), min_size=1, max_size=5),
)
def test_merging_sorts_and_loses_nothing(times: list[list[int]], sizes: list[int]) -> None:
    """Whatever tables captures come in, the merged frames are a stable sort by time of all of them."""
    captures: list[list[FrameTable]] = []
    for number, row in enumerate(times):
        whole = FrameTable.from_frames(
            [Frame(number, bytes([place]), time) for place, time in enumerate(row)]
        )
        cuts = np.cumsum(sizes)
        captures.append(
            [whole.take(slice(a, b)) for a, b in zip([0, *cuts], [*cuts, len(whole)], strict=True)]
        )
    found = [
        (f.timestamp, f.arbitration_id, f.data[0])
        for table in Merge.by_time(captures)
        for f in table.frames()
    ]
    expected = [(time, number, place) for number, row in enumerate(times) for place, time in enumerate(row)]
    assert found == sorted(expected)


def test_merging_keeps_the_order_of_a_capture() -> None:
    """A frame that is earlier than one before it in its capture, or has no time, comes right behind that."""
    one = FrameTable.from_frames([Frame(1, b"", t) for t in (1.0, 5.0, 2.0, None, 6.0)])
    two = FrameTable.from_frames([Frame(2, b"", t) for t in (3.0, 5.5)])
    found = [frame.timestamp for table in Merge.by_time([[one], [two]]) for frame in table.frames()]
    assert found == [1.0, 3.0, 5.0, 2.0, None, 5.5, 6.0]


FILTERS = [
    "123:7FF",
    "123~7FF",
    "00012345:DFFFFFFF",
    "0:0",
    "can0",
    "can1,100:700",
    "#FFFFFFFF",
    "100:700,200:700,#1",
    "100:700,123~7FF,j",
    "any,40000000:40000000",
]


@given(
    frames=st.lists(
        st.one_of(
            st.builds(Frame, st.integers(0, 0x7FF), channel=st.sampled_from(["can0", "can1", None])),
            st.builds(
                Frame,
                st.sampled_from([0x100, 0x123, 0x200]),
                channel=st.sampled_from(["can0", "can1", None]),
                is_error_frame=st.booleans(),
            ),
            st.builds(Frame, st.just(0x12345), is_extended_id=st.just(True), is_remote_frame=st.booleans()),
        ),
        max_size=30,
    ),
    texts=st.lists(st.sampled_from(FILTERS), min_size=1, max_size=3),
)
def test_filters_on_tables_are_those_on_frames(frames: list[Frame], texts: list[str]) -> None:
    """A frame passes as a row of a table when it passes by itself."""
    wanted = parse_filter(*texts)
    assert passing(wanted, FrameTable.from_frames(frames)).tolist() == [wanted.matches(f) for f in frames]


# ---------------------------------------------------------------------- pipes, Ctrl-C, wrong calls


def piped(monkeypatch: pytest.MonkeyPatch, content: bytes) -> None:
    """A pipe with this content as standard input."""
    reading, writing = os.pipe()
    os.write(writing, content)
    os.close(writing)
    monkeypatch.setattr(sys, "stdin", os.fdopen(reading, encoding="utf-8"))


def test_from_a_pipe_to_standard_output(aces: Aces, monkeypatch: pytest.MonkeyPatch) -> None:
    """`-` is standard input, and with --format standard output."""
    piped(monkeypatch, PLAIN.encode())
    result = aces("convert", "-", "-", "--format", "candump")
    assert (result.status, result.out) == (0, PLAIN)


def interrupting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while the first frames are converted; give --filter."""

    def press(*arguments: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return passing(*arguments)

    monkeypatch.setattr(convert, "passing", press)


def test_ctrl_c_leaves_no_half_file(
    aces: Aces, plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While files are read, Ctrl-C leaves what was there before, says so, and the status is 130."""
    out = tmp_path / "out.blf"
    out.write_bytes(b"precious")
    interrupting(monkeypatch)
    result = aces("convert", plain, out, "--filter", "can0")
    assert result.status == 130
    assert result.messages == [f"interrupted: {out} is not written"]
    assert out.read_bytes() == b"precious"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.blf", "plain.log"]


def test_ctrl_c_ends_a_live_recording(aces: Aces, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What had come from a pipe when Ctrl-C ended it is a whole file, and all is well."""
    piped(monkeypatch, PLAIN.encode())
    interrupting(monkeypatch)
    out = tmp_path / "out.log"
    result = aces("convert", "-", out, "--filter", "can0")
    assert result.status == 0
    assert [line.split()[1] for line in lines(out)] == ["can0"] * 3


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["{plain}"], "name what to read and, last, what to write"),
        (["{plain}", "{plain}"], "is one of the files to read"),
        (["{plain}", "{folder}/out.xyz"], "the suffix names no format"),
        (["{plain}", "-"], "name the format: --format candump|csv"),
        (["{folder}/absent.log", "{folder}/out.asc"], "no such file"),
        (
            ["{plain}", "{folder}/out.bin"],
            "CAN frames, which raw serial bytes does not hold; write one of .log",
        ),
        (["{dump}", "{folder}/out.asc"], "bytes of a serial line, which Vector ASC does not hold"),
        (["{plain}", "{folder}/out.log", "--map", "drive"], "write OLD=NEW"),
        (["{plain}", "{folder}/out.log", "--map", "a=b", "--map", "a=c"], "has a new name already"),
        (["{plain}", "{folder}/out.log", "--from", "noon"], "--from 'noon' is not a time"),
        (["{plain}", "{folder}/out.log", "--to", "inf"], "--to 'inf' is not a time"),
        (["{plain}", "{folder}/out.log", "--filter", "060"], "has no mask"),
        (["{dump}", "{folder}/out.bin", "--filter", "060:7FF"], "--filter is for CAN frames"),
        (["{dump}", "{folder}/out.bin", "--merge"], "--merge is for CAN frames"),
        (["{plain}", "{folder}/absent/out.log"], "cannot be written: there is no folder"),
        (["{plain}", "{folder}/out.log", "--format", "mdf"], "no format named 'mdf'"),
    ],
)
def test_wrong_calls(aces: Aces, plain: Path, tmp_path: Path, arguments: list[str], complaint: str) -> None:
    """A wrong call is one line that says what is wrong and what would work, status 2, and no file."""
    dump = tmp_path / "dump.txt"
    dump.write_bytes(b'Port opened by process "x"\n\n FF FF 01\n')
    names = {"plain": plain, "dump": dump, "folder": tmp_path}
    result = aces("convert", *(argument.format(**names) for argument in arguments))
    assert result.status == 2
    assert complaint in result.err
    assert len(result.messages) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dump.txt", "plain.log"]
    assert plain.read_text(encoding="utf-8") == PLAIN


def test_chunks_without_a_time_are_counted_as_chunks(aces: Aces, tmp_path: Path) -> None:
    """One chunk of three bytes is one; the bytes are in the summary."""
    dump = tmp_path / "dump.txt"
    dump.write_bytes(b'Port opened by process "x"\n\n FF FF 01\n')
    result = aces("convert", dump, tmp_path / "out.bin", "--from", "0")
    assert result.messages == ["chunks without a time, which are outside of --from and --to: 1"]
    assert (result.summary["bytes"], result.summary["filtered"]) == (3, 3)


def test_a_fault_in_a_later_file_leaves_nothing(aces: Aces, plain: Path, tmp_path: Path) -> None:
    """When one of several files cannot be read, none is written, and what was unreadable before is still said."""
    bad, out = tmp_path / "bad.log", tmp_path / "out.log"
    bad.write_text(LOG, encoding="utf-8")
    result = aces("convert", bad, tmp_path / "nowhere" / "else.log", out)
    assert result.status == 2
    assert [message.split(": ")[1] for message in result.messages] == [
        "not a line of candump",
        f"no such file; there is no folder '{tmp_path / 'nowhere'}' either",
    ]
    assert not out.exists()


# ---------------------------------------------------------------------- progress


class Terminal(io.StringIO):
    """A terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("make", [Terminal, io.StringIO])
def test_progress_is_shown_on_a_terminal_only(
    aces: Aces,
    plain: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    make: Callable[[], io.StringIO],
) -> None:
    """Large files get a bar with rate on a terminal, small ones and other outputs none."""
    monkeypatch.setattr(console, "LARGE", 0)
    monkeypatch.setenv("TERM", "xterm")
    stderr = make()
    monkeypatch.setattr(sys, "stderr", stderr)
    aces("convert", plain, tmp_path / "out.log")
    shown = stderr.getvalue()
    assert ("frames/s" in shown) == stderr.isatty()
    assert shown.splitlines()[-1].endswith("frames=5 written=5 filtered=0 errors=0 lines_unreadable=0")
