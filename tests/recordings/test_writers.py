"""Recordings written: what comes back when they are read, and what is said to be lost.

1. `LIMITS` says what a format cannot hold; all else must come back equal.
2. python-can reads what we write, wherever its readers are right.
"""

from __future__ import annotations

import csv
import io
import random
import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.errors import CallerError
from aces_bus.frame_table import Channels, FrameFlag
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.open import formats
from aces_bus.recordings.write import open_writer, writer_formats
from aces_bus.recordings.write.base import ChannelNumbers

CAN_FORMATS = [form.name for form in writer_formats().values() if form.link == "can"]
#: Time in ns, channel, identifier, flags, length, data.
Row = tuple[int, str | None, int, int, int, bytes]


# ---- what is drawn -------------------------------------------------------------------------------------------------

CHANNELS = ["can0", "can1", "can4"]
WAYS = st.sampled_from([0, FrameFlag.RX, FrameFlag.TX])
STANDARD, WIDE = st.integers(0, 0x7FF), st.integers(0, 0x1FFF_FFFF)


@st.composite
def contents(draw: st.DrawFn) -> tuple[int, int, int, bytes]:
    """Identifier, flags, length and data of one possible frame."""
    way = draw(WAYS)
    kind = draw(st.sampled_from(["data", "data", "remote", "error", "fd"]))
    if kind == "error":  # Linux makes them with eight bytes, files may have any
        flags = (
            FrameFlag.ERROR
            | way
            | draw(
                st.sampled_from(
                    [
                        0,
                        0,
                        0,
                        FrameFlag.FD,
                        FrameFlag.FD | FrameFlag.BITRATE_SWITCH,
                        FrameFlag.FD | FrameFlag.ERROR_STATE,
                    ]
                )
            )
        )
        size = draw(st.sampled_from(FD_LENGTHS if flags & FrameFlag.FD else [0, 8, 8, 3]))
        return draw(st.integers(0, 0x1FF)), flags, size, draw(st.binary(min_size=size, max_size=size))
    extended = draw(st.booleans())
    identifier, flags = draw(WIDE if extended else STANDARD), way | FrameFlag.EXTENDED * extended
    if kind == "remote":
        return identifier, flags | FrameFlag.REMOTE, draw(st.integers(0, 8)), b""
    if kind == "fd":
        size = draw(st.sampled_from(FD_LENGTHS))
        flags |= FrameFlag.FD | draw(
            st.sampled_from(
                [
                    0,
                    FrameFlag.BITRATE_SWITCH,
                    FrameFlag.ERROR_STATE,
                    FrameFlag.BITRATE_SWITCH | FrameFlag.ERROR_STATE,
                ]
            )
        )
        return identifier, flags, size, draw(st.binary(min_size=size, max_size=size))
    data = draw(st.binary(max_size=8))
    return identifier, flags, len(data), data


@st.composite
def captures(draw: st.DrawFn) -> list[Row]:
    """A few frames in order of time, from 1970, from today, in µs or ns."""
    time = draw(st.sampled_from([0, 1_436_509_052_249_713_000, 1_700_000_000_000_000_123]))
    grain = draw(st.sampled_from([1, 1000]))
    rows: list[Row] = []
    for step, channel, content in draw(
        st.lists(st.tuples(st.integers(0, 5_000_000), st.sampled_from(CHANNELS), contents()), max_size=12)
    ):
        rows.append((time, channel, *content))
        time += step * grain
    return rows


def table_of(rows: list[Row]) -> FrameTable:
    """The columns of rows."""
    width = 64 if any(len(row[5]) > 8 for row in rows) else 8
    channels = Channels()
    return FrameTable(
        np.array([row[0] for row in rows], np.int64),
        np.array([channels.number(row[1]) for row in rows], np.uint16),
        np.array([row[2] for row in rows], np.uint32),
        np.array([row[3] for row in rows], np.uint8),
        np.array([row[4] for row in rows], np.uint8),
        np.frombuffer(b"".join(row[5].ljust(width, b"\0") for row in rows), np.uint8).reshape(-1, width),
        channels,
    )


def rows_of(tables: Any) -> list[Row]:
    """The rows of tables."""
    return [
        (
            time,
            table.channels.names[channel],
            identifier,
            flags,
            length,
            data[:length] if not flags & FrameFlag.REMOTE else b"",
        )
        for table in tables
        for time, channel, identifier, flags, length, data in zip(
            table.time.tolist(),
            table.channel.tolist(),
            table.id.tolist(),
            table.flags.tolist(),
            table.length.tolist(),
            [bytes(row) for row in table.data],
            strict=True,
        )
    ]


def written(form: str, *tables: FrameTable) -> tuple[bytes, dict[str, int]]:
    """The bytes of a file, and what it does not hold."""
    file = io.BytesIO()
    with open_writer(file, form) as writer:
        for table in tables:
            writer.write(table)
    return file.getvalue(), writer.lossy


def read(form: str, content: bytes) -> list[Row]:
    """The rows of a file, every line or object of which must be accounted for."""
    if form not in formats():
        pytest.skip(f"no reader of {form}")
    with open_recording(io.BytesIO(content), link="can") as capture:
        rows = rows_of(capture.tables())
        assert capture.lines_unreadable == 0, capture.problems
        assert capture.frames == len(rows)
        assert capture.lines == len(rows) + capture.lines_comment + capture.lines_blank + sum(
            capture.others.values()
        )
    return rows


# ---- the same frames come back -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Limits:
    """What a format cannot hold, with the words that count it."""

    #: Channels have numbers: "can4" comes back as "4".
    numbers: bool = False
    #: Received or sent: a frame of which it is not known comes back as received.
    directions: str = ""
    #: Error frames come back without class and data, or without data above 8 bytes.
    errors: str = ""
    error_bytes: str = ""
    #: Times are in µs.
    microseconds: str = ""
    #: Error frames come back without a direction, and without flags of CAN FD.
    error_directions: str = ""
    error_fd: str = ""

    def keep(self, row: Row) -> Row:
        """What comes back of a row."""
        time, channel, identifier, flags, length, data = row
        if self.numbers and channel is not None:
            channel = channel.removeprefix("can")
        if self.microseconds:
            time = (time + 500) // 1000 * 1000
        if flags & FrameFlag.ERROR and self.error_directions:
            flags &= ~(FrameFlag.RX | FrameFlag.TX)
        if flags & FrameFlag.ERROR and self.error_fd:
            flags &= ~(FrameFlag.FD | FrameFlag.BITRATE_SWITCH | FrameFlag.ERROR_STATE)
        if flags & FrameFlag.ERROR and self.error_bytes:
            length, data = min(length, 8), data[:8]
        if flags & FrameFlag.ERROR and self.errors:
            identifier, length, data = 0, 0, b""
        elif self.directions and not flags & (FrameFlag.RX | FrameFlag.TX | FrameFlag.ERROR):
            flags |= FrameFlag.RX
        return time, channel, identifier, flags, length, data


UNKNOWN = "unknown directions (written as received)"
CLASSES = "classes and data of error frames"
WAYS_OF_ERRORS, FD_ERRORS = "directions of error frames", "CAN FD flags of error frames"
LIMITS: dict[str, Limits] = {
    "candump": Limits(),
    "asc": Limits(
        numbers=True,
        directions=UNKNOWN,
        errors=CLASSES,
        error_directions=WAYS_OF_ERRORS,
        error_fd=FD_ERRORS,
    ),
    "blf": Limits(
        numbers=True,
        directions=UNKNOWN,
        error_bytes="error frames with more than 8 bytes",
        error_directions=WAYS_OF_ERRORS,
        error_fd=FD_ERRORS,
    ),
    "trc": Limits(
        numbers=True,
        directions=UNKNOWN,
        errors=CLASSES,
        error_directions=WAYS_OF_ERRORS,
        error_fd=FD_ERRORS,
        microseconds="times finer than 1 µs",
    ),
    "pcapng": Limits(),
    "mf4": Limits(),
}


def check(form: str, rows: list[Row], *tables: FrameTable) -> None:
    """What is read is what the format holds of the rows, and what it does not hold is counted, each kind by itself."""
    limits = LIMITS[form]
    content, lossy = written(form, *tables)
    assert read(form, content) == [limits.keep(row) for row in rows]
    lost = {
        limits.directions: sum(not row[3] & (FrameFlag.RX | FrameFlag.TX | FrameFlag.ERROR) for row in rows),
        limits.errors: sum(bool(row[3] & FrameFlag.ERROR and (row[2] or row[4])) for row in rows),
        limits.error_bytes: sum(bool(row[3] & FrameFlag.ERROR and row[4] > 8) for row in rows),
        limits.error_directions: sum(
            bool(row[3] & FrameFlag.ERROR and row[3] & (FrameFlag.RX | FrameFlag.TX)) for row in rows
        ),
        limits.error_fd: sum(bool(row[3] & FrameFlag.ERROR and row[3] & FrameFlag.FD) for row in rows),
    }
    expected = {words: count for words, count in lost.items() if words and count}
    assert {words: count for words, count in lossy.items() if words != limits.microseconds} == expected
    if limits.microseconds:
        assert bool(lossy.get(limits.microseconds)) == any(row[0] % 1000 for row in rows)


@pytest.mark.parametrize("form", LIMITS)
@given(rows=captures())
def test_what_is_written_reads_back_equal(form: str, rows: list[Row]) -> None:
    """Every frame comes back in order, but for what the format cannot hold, and that is counted."""
    check(form, rows, table_of(rows))


@pytest.mark.parametrize("form", LIMITS)
def test_large_tables_read_back_equal(form: str) -> None:
    """Tables of more rows than are worked on at a time, of all kinds of frames mixed, come back equal."""
    rows, table = large()
    cut = len(rows) * 3 // 4
    check(form, rows, table.take(slice(0, cut)), table.take(slice(0, 0)), table.take(slice(cut, None)))


@cache
def large() -> tuple[list[Row], FrameTable]:
    """Frames of all kinds: in the short profile above the 8,192 rows of text formats, in the long one of all."""
    random_ = random.Random(7)
    rows: list[Row] = []
    for number in range(48_000 if settings().max_examples > 100 else 12_000):
        kind = random_.choice(
            [
                0,
                0,
                0,
                FrameFlag.EXTENDED,
                FrameFlag.REMOTE,
                FrameFlag.REMOTE | FrameFlag.EXTENDED,
                FrameFlag.ERROR,
                FrameFlag.FD,
                FrameFlag.FD | FrameFlag.EXTENDED,
            ]
        )
        flags = kind | random_.choice([0, FrameFlag.RX, FrameFlag.TX])
        size = (
            random_.choice(FD_LENGTHS)
            if kind & FrameFlag.FD
            else 8
            if kind & FrameFlag.ERROR
            else random_.randrange(9)
        )
        if kind & FrameFlag.FD:
            flags |= random_.choice(
                [
                    0,
                    FrameFlag.BITRATE_SWITCH,
                    FrameFlag.ERROR_STATE,
                    FrameFlag.BITRATE_SWITCH | FrameFlag.ERROR_STATE,
                ]
            )
        identifier = random_.randrange(0x2000_0000 if kind & FrameFlag.EXTENDED else 0x800)
        data = b"" if kind & FrameFlag.REMOTE else random_.randbytes(size)
        rows.append((10**18 + number * 1_000, random_.choice(CHANNELS), identifier, flags, size, data))
    return rows, table_of(rows)


@pytest.mark.parametrize("form", CAN_FORMATS)
def test_an_empty_recording_is_a_file_of_its_format(form: str) -> None:
    """Without frames the headers are written all the same, and are read as a recording without frames."""
    content, lossy = written(form)
    assert lossy == {}
    if form == "candump":
        assert content == b""  # a log without a line has no header either
    else:
        assert read(form, content) == []


# ---- tables of values, which hold less ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("form", ["csv", "sqlite"])
@settings(max_examples=25)
@given(rows=captures())
def test_python_can_reads_its_own_formats_from_us(form: str, rows: list[Row]) -> None:
    """CSVReader and SqliteReader give the frames; that they know no remote frame's missing data is theirs."""
    content, _ = written(form, table_of(rows))
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/log.{'csv' if form == 'csv' else 'db'}"
        with open(path, "wb") as file:
            file.write(content)
        reader = can.LogReader(path)
        messages = list(reader)
        reader.stop()
    assert len(messages) == len(rows)
    for message, (time, _, identifier, flags, length, data) in zip(messages, rows, strict=True):
        assert abs(message.timestamp - time / 1e9) < 1e-6
        assert (message.arbitration_id, message.dlc, bytes(message.data)) == (identifier, length, data)
        assert message.is_extended_id == bool(flags & FrameFlag.EXTENDED)
        assert message.is_remote_frame == bool(flags & FrameFlag.REMOTE)
        assert message.is_error_frame == bool(flags & FrameFlag.ERROR)


def test_what_sqlite_refuses_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A writer raises the package's errors, and leaves no file."""
    monkeypatch.setattr(
        "aces_bus.recordings.write.canlog.CanlogSqliteWriter.INSERT", "INSERT INTO lost VALUES (?)"
    )
    path = tmp_path / "walk.db"
    table = FrameTable.from_frames([Frame(1, b"", 1.0)])
    with (
        pytest.raises(CallerError, match=r"walk\.db: cannot be written: no such table: lost"),
        open_writer(path) as writer,
    ):
        writer.write(table)
    assert list(tmp_path.iterdir()) == []


def test_gvret_has_its_published_columns() -> None:
    """SavvyCAN's header, and for each frame: microseconds, eight digits, true or false, way, bus from 0, length, bytes."""
    rows: list[Row] = [
        (1_436_509_052_249_713_000, "can0", 0x5F4, FrameFlag.RX, 8, bytes.fromhex("00091C4600000001")),
        (1_436_509_052_249_714_000, "can1", 0x18DAF110, FrameFlag.EXTENDED | FrameFlag.TX, 2, b"\x02\x1a"),
        (0, "can0", 1, FrameFlag.FD | FrameFlag.RX, 12, bytes(range(12))),
    ]
    content, _ = written("gvret", table_of(rows))
    header, *lines = csv.reader(io.StringIO(content.decode(), newline=""))
    assert header == ["Time Stamp", "ID", "Extended", "Dir", "Bus", "LEN", *(f"D{n}" for n in range(1, 9))]
    assert lines[0] == [
        "1436509052249713",
        "000005F4",
        "false",
        "Rx",
        "0",
        "8",
        "00",
        "09",
        "1C",
        "46",
        "00",
        "00",
        "00",
        "01",
        "",
    ]
    assert lines[1] == [
        "1436509052249714",
        "18DAF110",
        "true",
        "Tx",
        "1",
        "2",
        "02",
        "1A",
        "00",
        "00",
        "00",
        "00",
        "00",
        "00",
        "",
    ]
    assert lines[2][5:] == ["12", *(f"{n:02X}" for n in range(12)), ""]


# ---- python-can reads it -------------------------------------------------------------------------------------------

READERS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "candump": (can.CanutilsLogReader, {}),
    "asc": (can.ASCReader, {"relative_timestamp": False}),
    "blf": (can.BLFReader, {}),
    "trc": (can.TRCReader, {}),
}


def excused(form: str, row: Row) -> bool:
    """What python-can's readers get wrong of a right file."""
    flags, length = row[3], row[4]
    if form == "candump":  # an error frame is given as data, or if it is a bus error, without its class
        return bool(flags & FrameFlag.ERROR)
    if form == "asc":  # one without data is taken for a remote frame
        return bool(flags & FrameFlag.FD) and not length
    # Error frames are left out; FE and BI are taken for other flags than in PEAK's description.
    return form == "trc" and bool(flags & (FrameFlag.ERROR | FrameFlag.ERROR_STATE))


@pytest.mark.parametrize("form", READERS)
@given(rows=captures())
def test_python_can_reads_what_we_write(form: str, rows: list[Row]) -> None:
    """python-can's reader gives the same frames, to the precision of its float seconds."""
    rows = [LIMITS[form].keep(row) for row in rows if not excused(form, row)]
    content, _ = written(form, table_of(rows))
    reader, options = READERS[form]
    file: Any = io.BytesIO(content) if form == "blf" else io.StringIO(content.decode(), newline="")
    messages = list(reader(file, **options)) if rows or form != "trc" else []
    assert len(messages) == len(rows)
    for message, (time, channel, identifier, flags, length, data) in zip(messages, rows, strict=True):
        assert abs(message.timestamp - time / 1e9) < 1e-6
        number = int(channel.removeprefix("can")) if channel is not None else 0
        assert message.channel == {"candump": channel, "trc": number + 1}.get(form, number)
        assert message.arbitration_id == identifier
        assert message.is_error_frame == bool(flags & FrameFlag.ERROR)
        assert message.is_remote_frame == bool(flags & FrameFlag.REMOTE)
        assert message.is_fd == bool(flags & FrameFlag.FD)
        assert message.bitrate_switch == bool(flags & FrameFlag.BITRATE_SWITCH)
        assert message.error_state_indicator == bool(flags & FrameFlag.ERROR_STATE)
        assert bytes(message.data) == data
        if not flags & FrameFlag.ERROR:
            assert message.is_extended_id == bool(flags & FrameFlag.EXTENDED)
            assert message.is_rx == (not flags & FrameFlag.TX)
        if not flags & FrameFlag.FD:
            assert message.dlc == length


# ---- what they look like -------------------------------------------------------------------------------------------


def test_candump_lines() -> None:
    """A line is candump's own, nine digits only where there are nanoseconds, R and T only where it is known."""
    frames = [
        Frame(0x44, bytes.fromhex("2A366C2BBA"), 1436509052.249713, "can0"),
        Frame(0x44, b"", 0.5, "can0", is_extended_id=True, is_rx=True),
        Frame(0x7, b"", 1.0, "can0", is_remote_frame=True, dlc=0, is_rx=False),
        Frame(0x7, b"", 1.0, "can0", is_remote_frame=True, dlc=8),
        Frame(0x4, bytes(8), 2.0, "vcan1", is_error_frame=True),
        Frame(0x1, b"\xaa", 3.0, "vcan1", is_fd=True, error_state_indicator=True),
        Frame(0x1, b"", 3.000000001, "vcan1"),
    ]
    content, lossy = written("candump", FrameTable.from_frames(frames))
    assert content.decode().splitlines() == [
        "(1436509052.249713) can0 044#2A366C2BBA",
        "(0000000000.500000) can0 00000044# R",
        "(0000000001.000000) can0 007#R T",
        "(0000000001.000000) can0 007#R8",
        "(0000000002.000000) vcan1 20000004#0000000000000000",
        "(0000000003.000000) vcan1 001##2AA",
        "(0000000003.000000001) vcan1 001#",
    ]
    assert lossy == {}


def test_unknown_times_are_counted() -> None:
    """A frame without a time, or with one before the start, is written at the start and counted."""
    frames = [Frame(1, b"", 1e9, "can0", is_rx=True), Frame(2, b"", None, "can0", is_rx=True)]
    late = [Frame(3, b"", 1e9 - 5, "can0", is_rx=True)]
    for form, words in (
        ("candump", {"unknown times (written as 0)": 1}),
        *(
            (
                form,
                {
                    "unknown times (written as the start)": 1,
                    "times before the start of the file (written as the start)": 1,
                },
            )
            for form in ("asc", "blf", "trc")
        ),
    ):
        assert written(form, FrameTable.from_frames(frames), FrameTable.from_frames(late))[1] == words


def test_a_start_without_a_time() -> None:
    """Where the first frames have no time, the start is zero, and later times are kept all the same."""
    nobody_knows = FrameTable.from_frames([Frame(1, b"", None, "can0", is_rx=True)])
    known = FrameTable.from_frames([Frame(2, b"", 1436509052.25, "can0", is_rx=True)])
    for form in ("asc", "blf", "trc"):
        content, lossy = written(form, nobody_knows, known)
        assert lossy == {"unknown times (written as the start)": 1}
        assert [row[0] for row in read(form, content)] == [0, 1436509052_250000000]


def test_what_cannot_be_on_a_bus_is_bounded() -> None:
    """A remote frame that asks for more than 8 bytes asks for 8, and is counted."""
    frames = [Frame(1, b"", 1.0, "can0", is_remote_frame=True, dlc=dlc, is_rx=True) for dlc in (8, 12)]
    for form in ("candump", "asc", "trc"):
        content, lossy = written(form, FrameTable.from_frames(frames))
        assert lossy == {"lengths above 8 that remote frames ask for": 1}
        assert [row[4] for row in read(form, content)] == [8, 8]


def test_jitter_in_the_first_table_loses_no_time() -> None:
    """The start is the earliest of the first frames, not the first one's, so that channels may be out of order a bit."""
    rows: list[Row] = [
        (10**18 + step, "can0", 1, FrameFlag.RX, 0, b"") for step in (5_000_000_000, 0, 7_000_000)
    ]
    for form in ("asc", "blf", "trc"):
        content, lossy = written(form, table_of(rows))
        assert lossy == {}
        assert [row[0] for row in read(form, content)] == [row[0] for row in rows]


def test_a_blf_header_says_what_the_file_holds() -> None:
    """Sizes, number of objects, start and end of a BLF file of several containers are right, whatever the file's place."""
    n = 10_000
    table = FrameTable.from_frames([Frame(1, b"12345678", 1e9 + step / 1000, "can0") for step in range(n)])
    content, _ = written("blf", table)
    size, unpacked, objects = struct.unpack_from("<QQL", content, 16)
    containers = 0
    place, total = 144, 144
    while place < len(content):
        _, _, _, object_size, kind = struct.unpack_from("<4sHHLL", content, place)
        assert (content[place : place + 4], kind) == (b"LOBJ", 10)
        total += 32 + struct.unpack_from("<L", content, place + 24)[0]
        place += object_size + object_size % 4
        containers += 1
    assert (size, unpacked, objects) == (len(content), total, n)
    assert containers == -(-n * 48 // (128 * 1024))
    assert struct.unpack_from("<8H", content, 40) == (2001, 9, 0, 9, 1, 46, 40, 0)
    assert struct.unpack_from("<8H", content, 56) == (2001, 9, 0, 9, 1, 46, 49, 999)


def test_an_asc_date_is_never_of_the_hour_that_comes_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where clocks go back an hour, the start is put before it, so that the file is read at the same instants."""
    if not hasattr(__import__("time"), "tzset"):
        pytest.skip("the zone cannot be changed here")
    import time

    monkeypatch.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")
    time.tzset()
    try:
        for instant in (1_445_734_800, 1_445_738_400, 1_445_742_000):  # 2015-10-25, 03:00 CEST to 03:00 CET
            rows: list[Row] = [(instant * 10**9 + 1000, "can0", 1, FrameFlag.RX, 0, b"")]
            content, lossy = written("asc", table_of(rows))
            assert lossy == {}
            (message,) = can.ASCReader(io.StringIO(content.decode()), relative_timestamp=False)
            assert abs(message.timestamp - rows[0][0] / 1e9) < 1e-6
    finally:
        monkeypatch.undo()
        time.tzset()


# ---- channels ------------------------------------------------------------------------------------------------------


def test_numbers_of_channels_are_kept_apart() -> None:
    """A name gets the number at its end plus one, never one that another has, and names that are lost are counted."""
    numbers = ChannelNumbers()
    names = ["can0", "0", "vcan0", None, "can70000", "drive", "5"]
    row = numbers.row(Channels(names), len(names) - 1)
    assert row[0] == 1
    assert row[-1] == 6
    assert len(set(row)) == len(names)
    assert numbers.lost == 5
    assert numbers.row(Channels(["5", "can0"]), 1) == [6, 1]  # another capture's, the same file


def test_what_takes_another_form_is_noted() -> None:
    """A channel that is a number and gets a name, and the 29-bit flag of an error frame: no losses, but said."""
    frames = [
        Frame(0x123, b"\x01", 1_500_000_000.0, "0"),
        Frame(0, b"", 1_500_000_001.0, "1", is_extended_id=True, is_error_frame=True),
    ]
    notes = {}
    for form in ("candump", "asc", "blf"):
        with open_writer(io.BytesIO(), form) as writer:
            writer.write(FrameTable.from_frames(frames))
        notes[form] = writer.notes
    flag = "1 error frames lose their 29-bit flag, which means nothing on a bus"
    assert notes == {
        "candump": ["channel 0 is named can0", "channel 1 is named can1", flag],
        "asc": [flag],
        "blf": [],
    }
