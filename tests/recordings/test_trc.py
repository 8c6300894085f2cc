"""PEAK's traces: what each line of each version gives, and that python-can's files read back as they were written."""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.recordings.base import CanRecording
from tests.recordings.formats import accounted

DAY = 86_400_000_000_000
#: 41766.5 days: noon of 7 May 2014.
START = (41766 - 25569) * DAY + DAY // 2
HEAD_21 = ";$FILEVERSION=2.1\n;$STARTTIME=41766.5\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
HEAD_20 = ";$FILEVERSION=2.0\n;$STARTTIME=41766.5\n;$COLUMNS=N,O,T,I,d,l,D\n"


def read(text: str) -> tuple[list[Frame], CanRecording]:
    """All frames of a trace, and the capture for its counters."""
    capture = open_recording(io.BytesIO(text.encode()), link="can", format="trc")
    frames = list(capture)
    accounted(capture)
    return frames, capture


def instants(text: str) -> list[int]:
    """The nanoseconds of all frames."""
    capture = open_recording(io.BytesIO(text.encode()), link="can", format="trc")
    return [time for table in capture.tables() for time in table.time.tolist()]


AT = 1.5
TWELVE = "01 02 03 04 05 06 07 08 09 0A 0B 0C"
OF_TWELVE = bytes(range(1, 13))

LINES = {
    "2.1 data": (
        "2.1",
        "1 1500.000 DT 1      0300 Rx -  2    00 A1 ",
        Frame(0x300, b"\0\xa1", AT, "0", is_rx=True),
    ),
    "2.1 extended": (
        "2.1",
        "1 1500.000 DT 2  18EFC034 Tx -  8    01 02 03 04 05 06 07 08",
        Frame(0x18EFC034, bytes(range(1, 9)), AT, "1", True, is_rx=False),
    ),
    "2.1 extended, small": (
        "2.1",
        "1 1500.000 DT 1  00000100 Tx -  0",
        Frame(0x100, b"", AT, "0", True, is_rx=False),
    ),
    "2.1 FD": (
        "2.1",
        f"5 1500.000 FD 1 0500 Tx - 9 {TWELVE}",
        Frame(0x500, OF_TWELVE, AT, "0", is_fd=True, is_rx=False),
    ),
    "2.1 FD, rate switch": (
        "2.1",
        f"5 1500.000 FB 1 0500 Rx - 9 {TWELVE}",
        Frame(0x500, OF_TWELVE, AT, "0", is_fd=True, bitrate_switch=True, is_rx=True),
    ),
    "2.1 FD, error state": (
        "2.1",
        f"5 1500.000 FE 1 0500 Rx - 9 {TWELVE}",
        Frame(0x500, OF_TWELVE, AT, "0", is_fd=True, error_state_indicator=True, is_rx=True),
    ),
    "2.1 FD, both": (
        "2.1",
        f"5 1500.000 BI 1 0500 Rx - 9 {TWELVE}",
        Frame(0x500, OF_TWELVE, AT, "0", False, False, False, True, True, True, True),
    ),
    "2.1 remote": (
        "2.1",
        "13 1500.0 RR 1 0100 Rx -  3",
        Frame(0x100, b"", AT, "0", False, True, is_rx=True, dlc=3),
    ),
    "2.1 error": (
        "2.1",
        "6 1500.000 ER 1 - Rx - 5 04 00 02 00 00",
        Frame(0, b"", AT, "0", is_error_frame=True),
    ),
    "2.1 length code above 8": (
        "2.1",
        "1 1500.000 DT 1 0300 Rx - 12 01 02 03 04 05 06 07 08",
        Frame(0x300, bytes(range(1, 9)), AT, "0", is_rx=True),
    ),
    "2.0 data": ("2.0", "1 1500.000 DT 0300 Rx 2 00 A1", Frame(0x300, b"\0\xa1", AT, None, is_rx=True)),
    "2.0 FD": (
        "2.0",
        f"5 1500.000 FD 0500 Tx 12 {TWELVE}",
        Frame(0x500, OF_TWELVE, AT, None, is_fd=True, is_rx=False),
    ),
    "2.0 error": (
        "2.0",
        "6 1500.000 ER          Rx    04 00 02 00 00",
        Frame(0, b"", AT, None, is_error_frame=True),
    ),
    "2.0 remote": (
        "2.0",
        "10 1500.000 RR 0100 Rx 3",
        Frame(0x100, b"", AT, None, False, True, is_rx=True, dlc=3),
    ),
    "1.0 data": ("1.0", "1) 1500 0001  2  00 A1", Frame(1, b"\0\xa1", AT)),
    "1.0 extended": ("1.0", "1) 1500 00000001  1  A1", Frame(1, b"\xa1", AT, None, True)),
    "1.0 remote": ("1.0", "4) 1500 0100  3  RTR", Frame(0x100, b"", AT, None, False, True, dlc=3)),
    "1.0 error": ("1.0", "2) 1500 0008  4  ERROR 00 19 08 08", Frame(0, b"", AT, None, is_error_frame=True)),
    "1.1 data": ("1.1", "1) 1500.0 Rx 0300  2  00 A1", Frame(0x300, b"\0\xa1", AT, None, is_rx=True)),
    "1.1 sent": ("1.1", "3) 1500.0 Tx 0400  2  00 00", Frame(0x400, b"\0\0", AT, None, is_rx=False)),
    "1.1 remote": (
        "1.1",
        "7) 1500.0 Rx 0100  3  RTR",
        Frame(0x100, b"", AT, None, False, True, is_rx=True, dlc=3),
    ),
    "1.1 error": (
        "1.1",
        "6) 1500.0 Error 0008  4  00 19 08 08",
        Frame(0, b"", AT, None, is_error_frame=True),
    ),
    "1.2 data": ("1.2", "1) 1500.000  1  Rx  0300  2  00 A1", Frame(0x300, b"\0\xa1", AT, "0", is_rx=True)),
    "1.2 error": (
        "1.2",
        "6) 1500.000  2  Error  0008  4  00 19 08 08",
        Frame(0, b"", AT, "1", is_error_frame=True),
    ),
    "1.3 data": (
        "1.3",
        "1) 1500.000 1  Rx  0300 -  2    00 A1",
        Frame(0x300, b"\0\xa1", AT, "0", is_rx=True),
    ),
    "1.3 remote": (
        "1.3",
        "7) 1500.000 1  Rx  0100 -  3    RTR",
        Frame(0x100, b"", AT, "0", False, True, is_rx=True, dlc=3),
    ),
}


def header(version: str) -> str:
    """A header without a start time, so that times are those of the lines."""
    if version == "1.0":
        return ";##########################################################################\n"
    return f";$FILEVERSION={version}\n"


@pytest.mark.parametrize(("version", "line", "frame"), LINES.values(), ids=LINES)
def test_a_line_gives_its_frame(version: str, line: str, frame: Frame) -> None:
    """One line, one frame; a version has its columns, whether or not the header names them."""
    frames, capture = read(f"{header(version)}     {line}\n")
    assert frames == [frame]
    assert capture.lines_unreadable == 0
    many, _ = read(header(version) + f"   {line} \r\n" * 40)
    assert many == [frame] * 40


@pytest.mark.parametrize("version", ["1.0", "1.1", "1.2", "1.3", "2.0", "2.1"])
def test_the_version_is_told_by_content(version: str) -> None:
    """By the header, and without one by the lines of the older versions."""
    lines = [f"   {line}\n" for of, line, _ in LINES.values() if of == version]
    capture = open_recording(io.BytesIO((header(version) + "".join(lines)).encode()), link="can")
    assert capture.format == "PEAK trace"
    frames = list(capture)
    assert len(frames) == len(lines)
    if version < "1.3":
        assert list(open_recording(io.BytesIO("".join(lines).encode()), link="can")) == frames


@pytest.mark.parametrize(
    ("version", "line", "kind"),
    [
        ("2.1", "7 1334.224 EV 1  User-defined event for bus 1", "events"),
        ("2.1", "8 1334.225 EV -  User-defined event for all busses", "events"),
        ("2.1", "9 1334.231 ST 1         - Rx -  4    00 00 00 08", "hardware states"),
        ("2.0", "7 1334.531 ST          Rx    00 00 00 08", "hardware states"),
        ("2.1", "11 1334.643 EC 1         - Rx -  2    02 02", "error counters"),
        ("2.0", "8 1334.643 EC          Rx    02 02", "error counters"),
        (
            "2.0",
            "8 1334.643 DT 18EFC034 Rx 9 01 02 03 04 05 06 07 08 09",
            "J1939 messages longer than a frame",
        ),
        ("1.0", "3) 1843  FFFFFFFF  4  00 00 00 04 -- -- -- --  BUSLIGHT", "bus warnings"),
        ("1.1", "5) 1346.8  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT", "bus warnings"),
        ("1.3", "5) 1346.834 1  Warng FFFFFFFF -  4    00 00 00 04  BUSLIGHT", "bus warnings"),
    ],
)
def test_what_is_no_frame_is_named_and_counted(version: str, line: str, kind: str) -> None:
    """Nothing readable is dropped in silence."""
    frames, capture = read(f"{header(version)}   {line}\n")
    assert (frames, capture.others, capture.lines_unreadable) == ([], {kind: 1}, 0)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("1 1500.0 DT 1 0300 Rx - 3 00 A1", "3 bytes are announced, 2 are there"),
        ("1 1500.0 DT 1 0300 Rx - 1 00 A1", "more than the 1 bytes"),
        ("1 1500.0 DT 1 0300 Rx - 1 0G", "byte '0G' is not a hexadecimal number"),
        ("1 1500.0 DT 1 0800 Rx - 1 00", "identifier 0x800 is outside"),
        ("1 1500.0 DT 1 20000000 Rx - 1 00", "identifier 0x20000000 is outside"),
        ("1 1500.0 DT 1 03x0 Rx - 1 00", "identifier '03x0' is not a hexadecimal number"),
        ("1 later DT 1 0300 Rx - 1 00", "time 'later' is not a number"),
        ("1 1500.0 FD 1 0300 Rx - 16 00", "length code 16 is more than 15"),
        ("1 1500.0 RR 1 0300 Rx - x", "length code 'x' is not a decimal number"),
        ("1 1500.0 QQ 1 0300 Rx - 1 00", "message type 'QQ' is not known"),
        ("1 1500.0 DT 1", "no identifier"),
        ("1 1500.0 DT 1 0300", "no length"),
        ("1 1500.0 DT x 0300 Rx - 1 00", "bus 'x' is not a decimal number"),
        ("1 1500.0 DT 1 0300 Up - 1 00", "direction 'Up' is neither Rx nor Tx"),
        ("hello", "not a line of a trace of version 2.1"),
    ],
)
def test_a_faulty_line_is_counted_with_its_reason(line: str, reason: str) -> None:
    """Faults lose their own line and no other."""
    good = "1 1500.0 DT 1 0300 Rx - 1 00\n"
    frames, capture = read(f"{HEAD_21}{good}{line}\n{good}")
    assert len(frames) == 2
    assert (capture.lines_unreadable, capture.problems[0].line) == (1, 5)
    assert reason in capture.problems[0].reason


def test_times_are_exact_from_1970() -> None:
    """Days and milliseconds are added as integers, to the last digit."""
    line = "1 {} DT 0300 Rx 1 00\n"
    assert instants(HEAD_20 + line.format("1059.9") + line.format("1283.231") + line.format("7")) == [
        START + 1_059_900_000,
        START + 1_283_231_000,
        START + 7_000_000,
    ]
    assert instants(HEAD_20 + line.format("1283.231") * 50) == [START + 1_283_231_000] * 50
    exact = HEAD_20.replace("41766.5", "41766.46489638720005")
    assert instants(exact + line.format("0.0")) == [(41766 - 25569) * DAY + 40_167_047_854_084]


def test_a_version_without_a_start_has_times_from_its_start() -> None:
    """1.0 says when it starts in a remark alone, whose form depends on the country."""
    assert instants(";####\n 1) 1841 0001 1 00\n") == [1_841_000_000]


@pytest.mark.parametrize(
    ("head", "reason"),
    [
        (";$FILEVERSION=7.1\n", "version '7.1' is not known"),
        (";$FILEVERSION=2.1\n;$STARTTIME=now\n", "the start time is not a number"),
        (";$FILEVERSION=2.1\n;$STARTTIME=9999999\n", "the start time is out of range"),
        (";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,T\n", "columns are single letters, each once"),
    ],
)
def test_a_header_that_is_none_is_counted(head: str, reason: str) -> None:
    """Its line is unreadable; lines that say all by themselves are read."""
    frames, capture = read(
        head + "1) 15.0 Rx 0300 1 00\n" if "7.1" in head else head + "1 15.0 DT 1 0300 Rx - 1 00\n"
    )
    assert len(frames) == 1
    assert capture.lines_unreadable == 1
    assert reason in capture.problems[0].reason


@given(data=st.data())
def test_columns_stand_in_any_order(data: st.DataObject) -> None:
    """$COLUMNS says where things are; letters that are not known are passed over."""
    values = {"N": "1", "O": "1500.250", "T": "DT", "B": "2", "I": "18EFC034", "d": "Tx", "R": "-", "s": "AB"}
    size = data.draw(st.sampled_from(["l", "L"]))
    values[size] = "3"
    order = data.draw(st.permutations([*values, "D"]))
    if order[0] != "N":  # a line begins with its number
        order.remove("N")
        order.insert(0, "N")
    line = " ".join("01 02 A3" if column == "D" else values[column] for column in order)
    for many in (1, 40):
        frames, capture = read(f";$FILEVERSION=2.1\n;$COLUMNS={','.join(order)}\n" + f" {line}\n" * many)
        assert frames == [Frame(0x18EFC034, b"\x01\x02\xa3", 1.50025, "1", True, is_rx=False)] * many
        assert capture.lines_unreadable == 0


# ---- python-can's files --------------------------------------------------------------------------------------------


@st.composite
def messages(draw: st.DrawFn) -> list[can.Message]:
    """Messages in order of time of the one kind that python-can's writer takes."""
    start = draw(st.integers(10**9, 2 * 10**9))
    found: list[can.Message] = []
    for offset in [0, *sorted(draw(st.lists(st.integers(0, 10**9), max_size=30)))]:
        extended = draw(st.booleans())
        found.append(
            can.Message(
                timestamp=float(f"{start * 1_000_000 + offset}e-6"),
                arbitration_id=draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF)),
                is_extended_id=extended,
                is_rx=draw(st.booleans()),
                channel=draw(st.integers(0, 9)),
                data=draw(st.binary(max_size=8)),
            )
        )
    return found


@pytest.mark.parametrize("version", [can.TRCFileVersion.V1_0, can.TRCFileVersion.V2_1])
@given(written=messages())
def test_what_python_can_writes_reads_back(version: can.TRCFileVersion, written: list[can.Message]) -> None:
    """Frames and times as they were given to its writer, and as its reader has them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.trc"
        with can.TRCWriter(str(path)) as writer:
            writer.file_version = version
            for message in written:
                writer.on_message_received(message)
        content = path.read_bytes()
        theirs = list(can.TRCReader(str(path)))
    capture = open_recording(io.BytesIO(content), link="can")
    table = FrameTable.concat(list(capture.tables()))
    accounted(capture)
    assert capture.lines_unreadable == 0
    is_old = version == can.TRCFileVersion.V1_0
    assert [(f.arbitration_id, f.is_extended_id, f.data, f.channel, f.is_rx) for f in table.frames()] == [
        (
            m.arbitration_id,
            m.is_extended_id,
            bytes(m.data),
            None if is_old else str(m.channel),
            None if is_old else m.is_rx,
        )
        for m in written
    ]
    for time, message, their in zip(table.time.tolist(), written, theirs, strict=True):
        assert abs(time / 1e9 - their.timestamp) < 1e-6
        if not is_old:  # which rounds to ms, and does not say when it starts
            assert abs(time - round(message.timestamp * 1e9)) < 3000
