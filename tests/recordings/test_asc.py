"""Vector's ASC log: what each line gives, times, and that python-can's files read back as they were written.

Expected frames are written out by hand from the format's description; python-can's writer is a second witness.
"""

from __future__ import annotations

import io
import tempfile
from datetime import datetime
from pathlib import Path

import can
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.base import CanRecording
from aces_lab.formats.asc import date_ns
from tests.recordings.formats import accounted

HEAD = "date Sam Sep 30 15:06:13.191 2017\nbase hex  timestamps absolute\ninternal events logged\n"
START = int(datetime(2017, 9, 30, 15, 6, 13).timestamp()) * 1_000_000_000 + 191_000_000


def read(text: str | bytes) -> tuple[list[Frame], CanRecording]:
    """All frames of a log, and the capture for its counters."""
    content = text.encode() if isinstance(text, str) else text
    capture = open_recording(io.BytesIO(content), link="can", format="asc")
    frames = list(capture)
    accounted(capture)
    return frames, capture


def instants(text: str | bytes) -> list[int]:
    """The nanoseconds of all frames."""
    content = text.encode() if isinstance(text, str) else text
    capture = open_recording(io.BytesIO(content), link="can", format="asc")
    return [time for table in capture.tables() for time in table.time.tolist()]


def fd(flags: int, size: int = 8, rest: str = "") -> str:
    """A CANFD line with this flags field."""
    data = " ".join(f"{n:02x}" for n in range(size))
    code = FD_LENGTHS.index(size)
    marks = f"{flags >> 13 & 1} {flags >> 14 & 1} {code:x} {size:>2}"
    tail = f"102203  133   {flags:x} e0006659 46500250 4b140250 20011736 2001040d"
    return f"CANFD   3 Rx        30a{rest}    {marks} {data}  {tail}"


LINES = {
    "standard": ("1  123             Rx   d 2 01 A0", Frame(0x123, b"\x01\xa0", 1.5, "0", is_rx=True)),
    "extended": (
        "2  18EBFF00x       Tx   d 8 01 A0 0F A6 60 3B D1 40  Length = 273910 BitCount = 141 ID = 418119424x",
        Frame(0x18EBFF00, bytes.fromhex("01A00FA6603BD140"), 1.5, "1", True, is_rx=False),
    ),
    "one blank": ("1 123 Rx d 1 11", Frame(0x123, b"\x11", 1.5, "0", is_rx=True)),
    "no data": ("1  7FF             Rx   d 0", Frame(0x7FF, b"", 1.5, "0", is_rx=True)),
    "no data, blank behind": ("1  7FF             Rx   d 0 ", Frame(0x7FF, b"", 1.5, "0", is_rx=True)),
    "length code above 8": (
        "1  3FF             Tx   d D 55 AA 01 02 03 04 05 06  Length = 232016 BitCount = 119 ID = 1023",
        Frame(0x3FF, bytes.fromhex("55AA010203040506"), 1.5, "0", is_rx=False),
    ),
    "channel with digits": ("62  1  Rx d 1 00", Frame(1, b"\0", 1.5, "61", is_rx=True)),
    "channel 0 is none": ("0  1  Rx d 1 00", Frame(1, b"\0", 1.5, None, is_rx=True)),
    "a name for the identifier": (
        "1  EngineData      Rx   d 1 11 Length = 230125 BitCount = 118 ID = 291",
        Frame(0x123, b"\x11", 1.5, "0", is_rx=True),
    ),
    "a name that looks like a number": (
        "1  ABBA            Rx   d 1 11  Length = 230125 BitCount = 118 ID = 291x",
        Frame(0x123, b"\x11", 1.5, "0", True, is_rx=True),
    ),
    "flags behind": (
        "1  123  Rx d 1 11  Length = 1 BitCount = 1 ID = 291 TE",
        Frame(0x123, b"\x11", 1.5, "0", is_rx=True),
    ),
    "remote without length": ("2  100 Rx r", Frame(0x100, b"", 1.5, "1", False, True, is_rx=True, dlc=0)),
    "remote with a length": (
        "2  300x Tx r 8 Length = 1704000 BitCount = 145 ID = 768x",
        Frame(0x300, b"", 1.5, "1", True, True, is_rx=False, dlc=8),
    ),
    "remote with remarks alone": (
        "2 200 Tx r Length = 1704000 BitCount = 145 ID = 512",
        Frame(0x200, b"", 1.5, "1", False, True, is_rx=False, dlc=0),
    ),
    "error frame": ("1  ErrorFrame", Frame(0, b"", 1.5, "0", is_error_frame=True)),
    "error frame with its code": (
        "3  ErrorFrame\tECC: 10100010",
        Frame(0, b"", 1.5, "2", is_error_frame=True),
    ),
    "error frame with flags": (
        "2  ErrorFrame\tFlags = 0xe\tCodeExt = 0x20a2\tCode = 0x82\tID = 0\tDLC = 0\tPosition = 5\tLength = 11300",
        Frame(0, b"", 1.5, "1", is_error_frame=True),
    ),
    "ID contradicts": (
        "1  123  Rx d 1 11  Length = 0 BitCount = 0 ID = 292",
        Frame(0x123, b"\x11", 1.5, "0", is_rx=True),
    ),
    "ID contradicts, 29 bits": (
        "1  123x  Rx d 1 11  Length = 0 BitCount = 0 ID = 291",
        Frame(0x123, b"\x11", 1.5, "0", is_extended_id=True, is_rx=True),
    ),
    "a name that reads as a number": (
        "1  Beef  Rx d 1 11  Length = 0 BitCount = 0 ID = 291",
        Frame(0x123, b"\x11", 1.5, "0", is_rx=True),
    ),
    "FD": (fd(0x301000, 8), Frame(0x30A, bytes(range(8)), 1.5, "2", is_fd=True, is_rx=True)),
    "FD, long": (fd(0x301000, 64), Frame(0x30A, bytes(range(64)), 1.5, "2", is_fd=True, is_rx=True)),
    "FD, empty": (fd(0x301000, 0), Frame(0x30A, b"", 1.5, "2", is_fd=True, is_rx=True)),
    "FD, rate switch": (
        fd(0x303000, 12),
        Frame(0x30A, bytes(range(12)), 1.5, "2", is_fd=True, bitrate_switch=True, is_rx=True),
    ),
    "FD, error state": (
        fd(0x305000, 2),
        Frame(0x30A, b"\0\1", 1.5, "2", is_fd=True, error_state_indicator=True, is_rx=True),
    ),
    "FD, with a name": (
        fd(0x307000, 3, "  Generic_Name_12"),
        Frame(0x30A, b"\0\1\2", 1.5, "2", False, False, False, True, True, True, True),
    ),
    "classic frame on an FD channel": (fd(0x300000, 8), Frame(0x30A, bytes(range(8)), 1.5, "2", is_rx=True)),
    "remote frame on an FD channel": (
        "CANFD   3 Tx     50005x                                0 1 5 0 140000 73 200050 7a60 46500250 460a0250 2 2",
        Frame(0x50005, b"", 1.5, "2", True, True, is_rx=False, dlc=5),
    ),
    "error frame on an FD channel": (
        "CANFD   5 Tx ErrorFrame Not Acknowledge error, dominant error flag fffe c7 31ca Arb. 556 44 0 0 f 64 00 00 11",
        Frame(0, b"", 1.5, "4", is_error_frame=True, is_rx=False),
    ),
}


@pytest.mark.parametrize(("line", "frame"), LINES.values(), ids=LINES)
def test_a_line_gives_its_frame(line: str, frame: Frame) -> None:
    """One line, one frame; without a date times are those of the measurement."""
    frames, capture = read(f"base hex timestamps absolute\n   1.500000 {line}\n")
    assert frames == [frame]
    assert capture.lines_unreadable == 0
    many, _ = read("base hex timestamps absolute\n" + f"   1.500000 {line}\r\n" * 40)
    assert many == [frame] * 40


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("1  123 Rx d 3 11 22", "3 bytes are announced, 2 are there"),
        ("1  123 Rx d 1 11 22", "more than the 1 bytes"),
        ("1  123 Rx d 1 1G", "byte '1G' is not a hexadecimal number"),
        ("1  123 Rx d", "no data length code"),
        ("1  123 Rx d 10 11", "data length code 10 is more than 15"),
        ("1  800 Rx d 0", "identifier 0x800 is outside"),
        ("1  20000000x Rx d 0", "identifier 0x20000000 is outside"),
        ("1  Name Rx d 1 11", "identifier 'Name' is not a hexadecimal number"),
        ("1  123 Up d 1 11", "neither a frame nor an event"),
        ("1  123 Rx q 1 11", "neither a frame nor an event"),
        (fd(0x1000, 12).replace("0b", ""), "byte 102203 is more than 255"),
        ("CANFD 1 Rx 123 0 0 2 2 11 0 0 1000 0 0 0 0 0", "2 bytes are announced, and not so many"),
        ("CANFD 1 Rx 123 0 0 9 13 " + "00 " * 13, "a CAN FD frame cannot carry 13 data bytes"),
        ("CANFD 1 Rx 123 0 0 8", "a CANFD line needs"),
        (fd(0x1000, 8).replace(" 8  8 ", " 9  8 "), "length code 9 means 12 bytes, and 8 are announced"),
        (fd(0, 3).replace(" 3  3 ", " 5  3 "), "length code 5 means 5 bytes, and 3 are announced"),
        ("CANFD 1 Rx 123 0 0 2 2 11 22", "the line ends before its flags"),
        ("123456  ErrorFrame", "neither a frame nor an event"),
    ],
)
def test_a_faulty_line_is_counted_with_its_reason(line: str, reason: str) -> None:
    """Faults lose their own line and no other."""
    frames, capture = read(f"{HEAD}1.0 1 123 Rx d 1 11\n1.5 {line}\n1.6 1 123 Rx d 1 12\n")
    assert [frame.data for frame in frames] == [b"\x11", b"\x12"]
    assert capture.lines_unreadable == 1
    assert reason in capture.problems[0].reason
    assert capture.problems[0].line == 5


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%", "bus statistics"),
        ("CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0", "chip states"),
        ("1  OverloadFrame", "overload frames"),
        ("Li 1 Rx 8 11 22 33 44 55 66 77 88 checksum = 77", "LIN frames"),
        ("L2 TransmErr 1", "LIN events"),
        ("1  J1939TP FEE3p        6    0  0   -   Rx   d 9 A0 0F A6 60 3B D1 40 1F DE", "J1939 events"),
        ("Fr RMSG 0 0 1 1 7 Rx", "FlexRay events"),
        ("ETH 1 Rx 4a:ffff", "Ethernet events"),
        ("SV: 2 0 1 ::Namespace::Signal = 5", "system variables"),
        ("Start of measurement", "measurement events"),
        ("EnvSpeed := 12.5", "variables"),
        ("1  123 TxRq d 1 11", "transmit requests"),
        ("CANXL 1 Rx 123 0 0", "CAN XL frames"),
        ("TFS: [1,2] test case started", "other events"),
    ],
)
def test_events_are_named_and_counted(line: str, kind: str) -> None:
    """What is readable and no frame is never dropped in silence."""
    frames, capture = read(f"{HEAD}   1.5 {line}\n")
    assert frames == []
    assert capture.others == {kind: 1}
    assert (capture.lines, capture.lines_comment, capture.lines_unreadable) == (4, 3, 0)


# ---- times ---------------------------------------------------------------------------------------------------------

LOCAL = int(datetime(2023, 3, 3, 21, 21, 13).timestamp()) * 1_000_000_000


@pytest.mark.parametrize(
    ("date", "expected"),
    [
        (b"Fri Mar 3 21:21:13 2023", LOCAL),
        (b"Fri Mar 3 21:21:13.159 2023", LOCAL + 159_000_000),
        (b"Fri Mar 3 21:21:13.15 2023", LOCAL + 15_000_000),  # python-can's 15 ms
        (b"Fri Mar 3 21:21:13.159123 2023", LOCAL + 159_123_000),
        (b"Fri Mar 3 09:21:13.159 pm 2023", LOCAL + 159_000_000),
        (b"Fri Mar 03 9:21:13 PM 2023", LOCAL),
        (b"Fr Mrz 3 21:21:13 2023", LOCAL),
        ("Fre Mär 3 21:21:13 2023".encode(), LOCAL),
        (b"Fre M\xe4r 3 21:21:13 2023", LOCAL),
        ("ven. 3月 3 21:21:13 2023".encode(), LOCAL),
        (b"Mar 3 21:21:13 2023", LOCAL),
        (b"Fri Mar 3 12:00:00 am 2023", int(datetime(2023, 3, 3).timestamp()) * 1_000_000_000),
        (b"Fri Mar 3 12:00:00 pm 2023", int(datetime(2023, 3, 3, 12).timestamp()) * 1_000_000_000),
        (
            b"Fri Mar 3 9:1:3.5 pm 2023",
            int(datetime(2023, 3, 3, 21, 1, 3).timestamp()) * 1_000_000_000 + 5_000_000,
        ),
        (b"Fri Mar 33 21:21:13 2023", None),
        (b"Fri Foo 3 21:21:13 2023", None),
        (b"Fri Mar 3 25:21:13 2023", None),
        (b"Fri Mar 3 21:21:13 9999", None),
        (b"today", None),
        (b"", None),
    ],
)
def test_dates_are_local_time(date: bytes, expected: int | None) -> None:
    """In all the forms that Vector's tools and python-can write, English and German."""
    assert date_ns(date) == expected


ENGLISH = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


@pytest.mark.parametrize(
    ("name", "number"),
    [*zip(ENGLISH, range(1, 13), strict=True), ("Mai", 5), ("Okt", 10), ("Dez", 12), ("Mär", 3)],
)
def test_months_have_names(name: str, number: int) -> None:
    """English and German ones."""
    expected = int(datetime(2020, number, 9, 1, 2, 3).timestamp()) * 1_000_000_000
    assert date_ns(f"Xyz {name} 9 01:02:03 2020".encode()) == expected


FRAME = "1 123 Rx d 1 11\n"


def test_times_are_exact_from_1970() -> None:
    """Date and offset are added as integers, to the last digit."""
    text = f"{HEAD}0.000001 {FRAME}3.098426 {FRAME}4.123456789 {FRAME}"
    expected = [START + 1_000, START + 3_098_426_000, START + 4_123_456_789]
    assert instants(text) == expected
    assert instants(HEAD + f"3.098426 {FRAME}" * 50) == [expected[1]] * 50
    frames, _ = read(text)
    assert [frame.timestamp for frame in frames] == [time / 1_000_000_000 for time in expected]


def test_without_a_date_times_are_those_of_the_measurement() -> None:
    """Neither the clock of this machine nor a guess."""
    assert instants(f"base hex\n0.5 {FRAME}") == [500_000_000]


def test_the_first_trigger_block_says_when_it_began() -> None:
    """python-can's header holds when the file was written, and its block when the first frame came."""
    block = "Begin Triggerblock Sam Sep 30 15:06:14.191 2017\n"
    assert instants(f"{HEAD}{block}0.5 {FRAME}") == [START + 1_500_000_000]
    assert instants(f"{HEAD}Begin Triggerblock\n0.5 {FRAME}") == [START + 500_000_000]


def test_later_trigger_blocks_go_on() -> None:
    """Times of a second block count from the start of the measurement, unless one starts there."""
    later = "End TriggerBlock\nBegin Triggerblock Sam Sep 30 15:07:13.191 2017\n"
    first = f"{HEAD}Begin Triggerblock Sam Sep 30 15:06:13.191 2017\n1.0 {FRAME}"
    assert instants(f"{first}{later}61.0 {FRAME}") == [START + 10**9, START + 61 * 10**9]
    again = f"{first}{later}0.0 Start of measurement\n1.0 {FRAME}"
    assert instants(again) == [START + 10**9, START + 61 * 10**9]


def test_two_files_in_one_have_their_own_dates() -> None:
    """`cat a.asc b.asc`."""
    other = HEAD.replace("15:06", "15:07")
    assert instants(f"{HEAD}1.0 {FRAME}{other}1.0 {FRAME}") == [START + 10**9, START + 61 * 10**9]


def test_relative_times_are_added_up() -> None:
    """Each counts from the line before it, whatever that line is."""
    text = (
        HEAD.replace("absolute", "relative")
        + f"0.5 {FRAME}0.25 1 ErrorFrame\n0.25 CAN 1 Status:x\n0.5 {FRAME}"
    )
    assert instants(text) == [START + n for n in (500_000_000, 750_000_000, 1_500_000_000)]


def test_a_date_that_is_none_is_unreadable() -> None:
    """Its line is counted, and times are those of the measurement."""
    frames, capture = read(f"date yesterday at 5\nbase hex\n0.5 {FRAME}")
    assert (capture.lines_unreadable, capture.problems[0].line) == (1, 1)
    assert [frame.timestamp for frame in frames] == [0.5]


def test_decimal_files_have_decimal_numbers() -> None:
    """Identifiers and bytes; what is more than a byte is none."""
    text = HEAD.replace("hex", "dec") + (
        "0.5 1 257 Rx d 8 115  93 255   3   2 255  63   0  Length = 227972 BitCount = 118 ID = 257\n"
        "0.6 1 418119424x Tx d 1 10\n0.7 1 257 Rx d 1 300\n0.8 1 ABC Rx d 1 30\n"
    )
    frames, capture = read(text)
    assert [(frame.arbitration_id, frame.data) for frame in frames] == [
        (257, bytes([115, 93, 255, 3, 2, 255, 63, 0])),
        (418119424, b"\x0a"),
    ]
    assert [problem.reason for problem in capture.problems] == [
        "byte 300 is more than 255",
        "identifier 'ABC' is not a decimal number",
    ]


def test_a_header_may_turn_up_anywhere() -> None:
    """Lines before it are read as the header before says, those after as it says, in blocks of many lines too."""
    many = "0.5 1 16 Rx d 1 16\n" * 60
    frames, _ = read(f"base hex\n{many}base dec\n{many}base hex\n{many}")
    assert [frame.arbitration_id for frame in frames] == [0x16] * 60 + [16] * 60 + [0x16] * 60
    assert [frame.data[0] for frame in frames] == [0x16] * 60 + [16] * 60 + [0x16] * 60


def test_headers_that_go_back_and_forth_take_no_time() -> None:
    """A hostile file changes its base at every line."""
    content = (f"base dec\n1.0 {FRAME}base hex\n1.0 {FRAME}" * 3000).encode()
    frames, capture = read(content)
    assert len(frames) == 6000
    assert capture.lines_comment == 6000


# ---- python-can's files --------------------------------------------------------------------------------------------


@st.composite
def messages(draw: st.DrawFn) -> list[can.Message]:
    """Messages in order of time, of all kinds that python-can's writer takes."""
    start = draw(st.integers(0, 2**31)) * 1000 + draw(st.integers(0, 999))  # ms: what a date holds
    local = datetime.fromtimestamp(start // 1000)
    assume(local.replace(fold=0).timestamp() == local.replace(fold=1).timestamp())  # an hour that comes once
    offsets = sorted(draw(st.lists(st.integers(0, 10**9), min_size=1, max_size=30)))
    found: list[can.Message] = []
    for offset in [0, *offsets]:
        kind = draw(st.sampled_from(["data", "data", "remote", "error", "fd"]))
        extended = draw(st.booleans())
        size = draw(st.sampled_from(FD_LENGTHS[1:])) if kind == "fd" else draw(st.integers(0, 8))
        found.append(
            can.Message(
                timestamp=float(f"{start * 1000 + offset}e-6"),
                arbitration_id=draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF)),
                is_extended_id=extended,
                is_remote_frame=kind == "remote",
                is_error_frame=kind == "error",
                is_fd=kind == "fd",
                bitrate_switch=kind == "fd" and draw(st.booleans()),
                error_state_indicator=kind == "fd" and draw(st.booleans()),
                is_rx=draw(st.booleans()),
                channel=draw(st.integers(0, 9)),
                dlc=size,
                data=None if kind in ("remote", "error") else draw(st.binary(min_size=size, max_size=size)),
            )
        )
    return found


def expected(message: can.Message) -> Frame:
    """What a written message is: an error frame says nothing but that it was."""
    if message.is_error_frame:
        return Frame(0, b"", None, str(message.channel), is_error_frame=True)
    return Frame(
        message.arbitration_id,
        bytes(message.data),
        None,
        str(message.channel),
        message.is_extended_id,
        message.is_remote_frame,
        False,
        message.is_fd,
        message.bitrate_switch,
        message.error_state_indicator,
        message.is_rx,
        message.dlc if message.is_remote_frame else None,
    )


@given(written=messages())
def test_what_python_can_writes_reads_back(written: list[can.Message]) -> None:
    """Frames and times as they were given to its writer, which is more than its own reader keeps."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.asc"
        with can.ASCWriter(str(path)) as writer:
            for message in written:
                writer.on_message_received(message)
        content = path.read_bytes()
    capture = open_recording(io.BytesIO(content), link="can")
    assert capture.format == "Vector ASC log"
    table = FrameTable.concat(list(capture.tables()))
    accounted(capture)
    assert capture.lines_unreadable == 0
    assert [frame_without_time(frame) for frame in table] == [expected(message) for message in written]
    for time, message in zip(table.time.tolist(), written, strict=True):
        assert abs(time - round(message.timestamp * 1e9)) <= 1000  # six digits, and floats of 1970


def frame_without_time(frame: Frame) -> Frame:
    """A frame as though its capture did not say when."""
    return Frame(
        frame.arbitration_id,
        frame.data,
        None,
        frame.channel,
        frame.is_extended_id,
        frame.is_remote_frame,
        frame.is_error_frame,
        frame.is_fd,
        frame.bitrate_switch,
        frame.error_state_indicator,
        frame.is_rx,
        frame.dlc,
    )
