"""SavvyCAN's, OVMS', BUSMASTER's, Microchip's and python-can's text files, and CSV with named columns: what lines give."""

from __future__ import annotations

import io
import tempfile
from datetime import UTC, datetime
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, open_recording
from aces_bus.errors import CaptureError
from aces_bus.frames import FD_LENGTHS
from aces_bus.recordings.base import CanRecording
from tests.recordings.formats import SAMPLES, Sample, accounted


def read(form: str, text: str) -> tuple[list[Frame], CanRecording]:
    """All frames of a file of this format, and the capture for its counters."""
    capture = open_recording(io.BytesIO(text.encode()), link="can", format=form)
    frames = list(capture)
    accounted(capture)
    return frames, capture


def instants(form: str, text: str) -> list[int]:
    """The nanoseconds of all frames."""
    capture = open_recording(io.BytesIO(text.encode()), link="can", format=form)
    return [time for table in capture.tables() for time in table.time.tolist()]


GVRET = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
CRTD = "0.5 CXX log\n"
BUSMASTER = "***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***HEX***\n***SYSTEM MODE***\n"
MICROCHIP = "//-----\nMicrochip Technology Inc.\nCAN BUS Analyzer\n//-----\n"
CSV = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
ELEVEN = "00 01 02 03 04 05 06 07 08 09 0a 0b"
TWELVE = bytes(range(12))

LINES = {
    "gvret": (GVRET, "1500000,000005F4,false,Rx,0,2,00,A9,", Frame(0x5F4, b"\0\xa9", 1.5, "0", is_rx=True)),
    "gvret, padded": (
        GVRET,
        "1500000,18DAF110,true,Tx,1,2,02,1A,00,00,00,00,00,00,",
        Frame(0x18DAF110, b"\x02\x1a", 1.5, "1", True, is_rx=False),
    ),
    "gvret, short cells": (
        GVRET,
        "1500000,5F4,0,rx,0,3,0,A,1F",
        Frame(0x5F4, b"\0\x0a\x1f", 1.5, "0", is_rx=True),
    ),
    "gvret, FD": (
        GVRET,
        f"1500000,000005F4,false,Rx,0,12,{ELEVEN.replace(' ', ',').upper()},",
        Frame(0x5F4, TWELVE, 1.5, "0", is_fd=True, is_rx=True),
    ),
    "gvret without direction": (
        GVRET.replace("Dir,", ""),
        "1500000,000005F4,false,0,2,00,A9,",
        Frame(0x5F4, b"\0\xa9", 1.5, "0"),
    ),
    "crtd": (CRTD, "1.500000 1R11 7E8 02 00", Frame(0x7E8, b"\2\0", 1.5, "0", is_rx=True)),
    "crtd, sent": (
        CRTD,
        "1.5 2T29 18DB33F1 2 1 c",
        Frame(0x18DB33F1, b"\2\1\x0c", 1.5, "1", True, is_rx=False),
    ),
    "crtd, no bus": (CRTD, "1.500 R29 1 00", Frame(1, b"\0", 1.5, "0", True, is_rx=True)),
    "crtd, no data": (CRTD, "1.500 T11 7ff", Frame(0x7FF, b"", 1.5, "0", is_rx=False)),
    "busmaster": (BUSMASTER, "00:00:01:5000 Rx 1 0x023 s 1 40", Frame(0x23, b"\x40", 1.5, "0", is_rx=True)),
    "busmaster, extended": (
        BUSMASTER,
        "0:0:1:5000 Tx 2 0x18FEF100 x 2 40 41 ",
        Frame(0x18FEF100, b"\x40\x41", 1.5, "1", True, is_rx=False),
    ),
    "busmaster, milliseconds": (
        BUSMASTER,
        "00:00:01:500 Rx 1 0x023 s 1 40",
        Frame(0x23, b"\x40", 1.5, "0", is_rx=True),
    ),
    "busmaster, no 0x": (
        BUSMASTER,
        "0:00:01:5000 Rx 1 0000021A s 1 40",
        Frame(0x21A, b"\x40", 1.5, "0", is_rx=True),
    ),
    "busmaster, remote": (
        BUSMASTER,
        "00:00:01:5000 Rx 1 0x023 sr 3",
        Frame(0x23, b"", 1.5, "0", False, True, is_rx=True, dlc=3),
    ),
    "busmaster, remote, extended": (
        BUSMASTER,
        "00:00:01:5000 Rx 1 0x023 xr 3",
        Frame(0x23, b"", 1.5, "0", True, True, is_rx=True, dlc=3),
    ),
    "busmaster, FD": (
        BUSMASTER,
        f"00:00:01:5000 Rx 1 0x023 s-fd 12 {ELEVEN}",
        Frame(0x23, TWELVE, 1.5, "0", is_fd=True, is_rx=True),
    ),
    "busmaster, FD, code": (
        BUSMASTER,
        f"00:00:01:5000 Rx 1 0x023 x-fd 9 {ELEVEN}",
        Frame(0x23, TWELVE, 1.5, "0", True, is_fd=True, is_rx=True),
    ),
    "busmaster, FD, a code that is a length, too": (
        BUSMASTER,
        f"00:00:01:5000 Rx 1 0x023 s-fd 12 {ELEVEN} {ELEVEN}",
        Frame(0x23, TWELVE * 2, 1.5, "0", is_fd=True, is_rx=True),
    ),
    "busmaster, error": (
        BUSMASTER,
        "00:00:01:5000 ERR 1 stuff",
        Frame(0, b"", 1.5, None, is_error_frame=True),
    ),
    "busmaster, error on": (
        BUSMASTER,
        "00:00:01:5000 Rx 2 ErrorFrame",
        Frame(0, b"", 1.5, "1", is_error_frame=True),
    ),
    "microchip": (MICROCHIP, "1500;RX;0x21A;2;0xFE;0x36;", Frame(0x21A, b"\xfe\x36", 1.5, None, is_rx=True)),
    "microchip, seconds": (
        MICROCHIP,
        "1.5;TX;0x21A;1;0xFE;;;;;;",
        Frame(0x21A, b"\xfe", 1.5, None, is_rx=False),
    ),
    "microchip, extended": (MICROCHIP, "1500;RX;0x0CFEx;0", Frame(0xCFE, b"", 1.5, None, True, is_rx=True)),
    "microchip, extended by size": (
        MICROCHIP,
        "1500;RX;0x800;0;",
        Frame(0x800, b"", 1.5, None, True, is_rx=True),
    ),
    "microchip, padded": (
        MICROCHIP,
        "1500;RX;0x236;1;0x01;0x00;0xF0",
        Frame(0x236, b"\1", 1.5, None, is_rx=True),
    ),
    "microchip, decimal": (MICROCHIP, "1500;RX;100;2;10;255", Frame(100, b"\x0a\xff", 1.5, None, is_rx=True)),
    "csv": (CSV, "1.5,0xdadada,1,0,0,7,WzQyLCA5XQ==", Frame(0xDADADA, b"[42, 9]", 1.5, None, True)),
    "csv, exponent": (CSV, "15e-1,0x123,0,0,0,0,", Frame(0x123, b"", 1.5)),
    "csv, remote": (CSV, "1.5,0x123,0,1,0,3,", Frame(0x123, b"", 1.5, None, False, True, dlc=3)),
    "csv, error": (CSV, "1.5,0x0,1,0,1,0,", Frame(0, b"", 1.5, None, is_error_frame=True)),
    "csv, FD": (CSV, "1.5,0x123,0,0,0,12,AAECAwQFBgcICQoL", Frame(0x123, TWELVE, 1.5, None, is_fd=True)),
}


@pytest.mark.parametrize(("head", "line", "frame"), LINES.values(), ids=LINES)
def test_a_line_gives_its_frame(head: str, line: str, frame: Frame, request: pytest.FixtureRequest) -> None:
    """One line, one frame, alone and among many; and the header tells the format."""
    form = request.node.callspec.id.split(",")[0].split(" ")[0]
    frames, capture = read(form, f"{head}{line}\n")
    assert frames == [frame]
    assert capture.lines_unreadable == 0
    many, _ = read(form, head + f"{line}\r\n" * 40)
    assert many == [frame] * 40
    told = open_recording(io.BytesIO(f"{head}{line}\n".encode()))
    assert type(told) is type(capture)


FAULTS = {
    "gvret": [
        ("1,5F4,false,Rx,0,3,00,A9,", "3 bytes are announced, 2 are there"),
        ("1,5F4,maybe,Rx,0,1,00", "extended is 'maybe'"),
        ("1,5F4,false,Up,0,1,00", "direction 'Up' is neither Rx nor Tx"),
        ("1,800,false,Rx,0,1,00", "identifier 0x800 is outside"),
        ("1,5F4,false,Rx,0,9,1,2,3,4,5,6,7,8,9", "a CAN FD frame cannot carry 9 data bytes"),
        ("soon,5F4,false,Rx,0,1,00", "time 'soon' is not a number"),
        ("1,5F4", "2 columns"),
    ],
    "crtd": [
        ("1.5 1R11 7E8 00 01 02 03 04 05 06 07 08", "a classic CAN frame cannot carry 9"),
        ("1.5 1R11 7E8 0G", "byte '0G' is not a hexadecimal number"),
        ("1.5 1R11 800", "identifier 0x800 is outside"),
        ("1.5 1R11", "no identifier"),
        ("1.5 1X11 1", "record type X11 is not known"),
        ("hello", "not a CRTD record"),
    ],
    "busmaster": [
        ("00:00:01:5000 Rx 1 0x023 s 2 40", "2 bytes are announced, 1 are there"),
        ("00:00:01:5000 Rx 1 0x023 q 1 40", "a line needs direction"),
        ("00:00:01:5000 Up 1 0x023 s 1 40", "direction 'Up' is neither"),
        ("00:00:01:5000 Rx 1 0x023 s 99 40", "length 99 is more than a frame holds"),
        ("00:00:01 Rx 1 0x023 s 1 40", "not a line of a BUSMASTER log"),
        ("00:00:01:5000 Rx 1 0x023 s 1 40 41", "1 bytes are announced, 2 are there"),
        (f"00:00:01:5000 Rx 1 0x023 s-fd 11 {ELEVEN}", "20 bytes are announced, 12 are there"),
    ],
    "microchip": [
        ("505.7063;RX;0x65;64;;;;;;;;;", "64 bytes are announced, 0 are there"),
        ("5;RX;0x65;1;0x100", "byte 0x100 is more than 255"),
        ("5;RX;0x65;1;0x10;what", "what follows the bytes is none"),
        ("5;UP;0x65;1;0x10", "direction 'UP' is neither Rx nor Tx"),
        ("5;RX", "a line needs time"),
    ],
    "csv": [
        ("1.5,0x123,0,0,0,6,WzQyLCA5XQ==", "6 bytes are announced, 7 are there"),
        ("1.5,0x123,0,0,0,3,Wz!y", "the data are not base64"),
        ("1.5,0x123,0,0,0,3,WzQyL", "the data are not base64"),
        ("1.5,0x123,2,0,0,0,", "'2' is neither 0 nor 1"),
        ("1.5,0x123,0,0,0", "5 columns, not 7"),
        ("None,0x123,0,0,0,0,", "time 'None' is not a number"),
        ("1e99,0x123,0,0,0,0,", "the time is out of range"),
        ("1.5,0x123,0,1,0,9,", "asks for at most 8 bytes"),
        ("1.5,0x4,0,0,1,8,WzQyLCA5XQ==", "8 bytes are announced, 7 are there"),
        ("1.5,0x4,0,1,1,0,", "a frame is a remote frame or an error frame, not both"),
    ],
}
HEADS = {"gvret": GVRET, "crtd": CRTD, "busmaster": BUSMASTER, "microchip": MICROCHIP, "csv": CSV}


@pytest.mark.parametrize(
    ("form", "line", "reason"), [(form, *fault) for form, faults in FAULTS.items() for fault in faults]
)
def test_a_faulty_line_is_counted_with_its_reason(form: str, line: str, reason: str) -> None:
    """Faults lose their own line and no other."""
    good = LINES[form][1]
    frames, capture = read(form, f"{HEADS[form]}{good}\n{line}\n{good}\n")
    assert len(frames) == 2
    assert capture.lines_unreadable == 1
    assert reason in capture.problems[0].reason


@pytest.mark.parametrize(
    ("form", "line", "kind"),
    [
        ("crtd", "19292.299819 CEV vehicle.alert this is a textual vehicle alert", "events"),
        ("crtd", "198923.283738 1CST intr=0 rxpkt=0 txpkt=0", "statistics"),
        ("crtd", "2783.384726 CER intr=0 rxpkt=0", "error records"),
        ("crtd", "1.5 1CBC L 500000", "commands"),
        ("crtd", "1.5 CZZ what", "other records"),
        ("busmaster", "***PROTOCOL LIN***\n00:00:01:5000 Rx 1 0x023 8 40", "LIN frames"),
        ("busmaster", "***PROTOCOL J1939***\n00:00:01:5000 1 0x18FEF100", "messages of another protocol"),
    ],
)
def test_what_is_no_frame_is_named_and_counted(form: str, line: str, kind: str) -> None:
    """Nothing readable is dropped in silence."""
    frames, capture = read(form, f"{HEADS[form]}{line}\n")
    assert (frames, capture.others, capture.lines_unreadable) == ([], {kind: 1}, 0)


def test_a_time_is_exact_to_the_last_digit() -> None:
    """Digits become nanoseconds without a float between."""
    assert instants("crtd", "1542473901.020305 1R11 213 00\n1542473901.021 R11 213\n") == [
        1542473901_020305000,
        1542473901_021000000,
    ]
    assert instants("gvret", f"{GVRET}1542473901020305,5F4,false,Rx,0,0\n") == [1542473901_020305000]
    assert instants("csv", f"{CSV}1542473901.0203056,0x1,0,0,0,0,\n") == [1542473901_020305600]
    assert instants("microchip", "1247;RX;0xC2;0;\n505.7052;RX;0xC2;0;\n") == [1_247_000_000, 505_705_200_000]


# ---- BUSMASTER -----------------------------------------------------------------------------------------------------


def test_busmaster_times_of_day_have_the_day_of_the_start() -> None:
    """Midnight begins the next day; a clock that goes back a little does not."""
    start = "***START DATE AND TIME 8:8:2014 23:49:7:965***\n"
    line = "{} Rx 1 0x023 s 1 40\n"
    day = int(datetime(2014, 8, 8).timestamp()) * 10**9
    second = 10**9
    assert instants(
        "busmaster",
        BUSMASTER
        + start
        + "".join(
            map(
                line.format,
                ("23:49:12:9420", "23:49:12:0001", "00:00:01:0000", "23:00:00:0000", "00:00:01:0000"),
            )
        ),
    ) == [
        day + 85752 * second + 942_000_000,
        day + 85752 * second + 100_000,
        day + 86401 * second,
        day + (86400 + 82800) * second,
        day + 2 * 86400 * second + second,
    ]
    impossible, capture = read(
        "busmaster", f"{BUSMASTER}{start.replace('8:8', '8:18')}{line.format('0:0:1:5000')}"
    )
    assert [frame.timestamp for frame in impossible] == [1.5]
    assert capture.lines_unreadable == 1


def test_busmaster_relative_times_are_added_up() -> None:
    """Each counts from the line before it."""
    text = BUSMASTER.replace("SYSTEM", "RELATIVE") + "00:00:00:5000 Rx 1 0x023 s 1 40\n" * 3
    assert instants("busmaster", text) == [500_000_000, 1_000_000_000, 1_500_000_000]
    start = "***START DATE AND TIME 8:8:2014 23:49:7:965***\n"
    absolute = BUSMASTER.replace("SYSTEM", "ABSOLUTE") + start + "00:00:00:5000 Rx 1 0x023 s 1 40\n" * 2
    assert instants("busmaster", absolute) == [500_000_000] * 2


def test_busmaster_decimal_files_have_decimal_numbers() -> None:
    """Identifiers and bytes."""
    frames, _ = read("busmaster", BUSMASTER.replace("HEX", "DEC") + "00:00:01:5000 Rx 1 291 s 2 64 255\n")
    assert frames == [Frame(0x123, b"\x40\xff", 1.5, "0", is_rx=True)]


# ---- CSV with named columns ----------------------------------------------------------------------------------------

NAMED = {
    "plain": ("time,id,data", "1.5,0x123,01 02 0A", Frame(0x123, b"\1\2\x0a", 1.5)),
    "together": ("time,id,data", "1.5,123,01020A", Frame(0x123, b"\1\2\x0a", 1.5)),
    "with 0x": ("time,id,data", "1.5,123,0x01020A", Frame(0x123, b"\1\2\x0a", 1.5)),
    "each with 0x": ("time,id,data", "1.5,123,0x01 0x2 0xA", Frame(0x123, b"\1\2\x0a", 1.5)),
    "dashes": ("time,id,data", "1.5,123,01-02-0A", Frame(0x123, b"\1\2\x0a", 1.5)),
    "no data": ("time,id,data", "1.5,123,", Frame(0x123, b"", 1.5)),
    "no time": ("ID,Data", "123,01", Frame(0x123, b"\1")),
    "quotes": ('"Time","ID","Data"', '"1.5","123","01,02"', Frame(0x123, b"\1\2", 1.5)),
    "semicolons, decimal comma": ("Zeit;Time;CAN-ID;Data", "x;1,5;123;01 02", Frame(0x123, b"\1\2", 1.5)),
    "tabs": ("Timestamp\tCAN ID\tPayload", "1.5\t123\t01 02", Frame(0x123, b"\1\2", 1.5)),
    "milliseconds": ("Timestamp (ms),ID,Data", "1500,123,01", Frame(0x123, b"\1", 1.5)),
    "microseconds": ("time_us,ID,Data", "1500000,123,01", Frame(0x123, b"\1", 1.5)),
    "µs": ("Time [µs],ID,Data", "1500000,123,01", Frame(0x123, b"\1", 1.5)),
    "nanoseconds": ("timestamp_ns,ID,Data", "1500000000,123,01", Frame(0x123, b"\1", 1.5)),
    "seconds": ("Time [s],ID,Data", "1.5,123,01", Frame(0x123, b"\1", 1.5)),
    "a date": (
        "time,id,data",
        "2023-05-01T12:00:00.5Z,123,01",
        Frame(0x123, b"\1", datetime(2023, 5, 1, 12, tzinfo=UTC).timestamp() + 0.5),
    ),
    "a local date": (
        "time,id,data",
        "2023-05-01 12:00:00.500,123,01",
        Frame(0x123, b"\1", datetime(2023, 5, 1, 12).timestamp() + 0.5),
    ),
    "decimal identifier": ("time,id (dec),data", "1.5,291,01", Frame(0x123, b"\1", 1.5)),
    "decimal identifier with 0x": ("time,id_dec,data", "1.5,0x123,01", Frame(0x123, b"\1", 1.5)),
    "decimal data": ("time,id,data (dec)", "1.5,123,1 255 10", Frame(0x123, b"\1\xff\x0a", 1.5)),
    "extended by size": ("time,id,data", "1.5,0x18FEF100,01", Frame(0x18FEF100, b"\1", 1.5, None, True)),
    "extended by x": ("time,id,data", "1.5,123x,01", Frame(0x123, b"\1", 1.5, None, True)),
    "extended by column": ("time,id,extended,data", "1.5,123,true,01", Frame(0x123, b"\1", 1.5, None, True)),
    "extended by word": ("time,id,IdType,data", "1.5,123,Ext,01", Frame(0x123, b"\1", 1.5, None, True)),
    "channel": ("time,bus,id,data", "1.5,2,123,01", Frame(0x123, b"\1", 1.5, "2")),
    "direction": ("time,dir,id,data", "1.5,Tx,123,01", Frame(0x123, b"\1", 1.5, is_rx=False)),
    "length": ("time,id,dlc,data", "1.5,123,2,01 02", Frame(0x123, b"\1\2", 1.5)),
    "length code": ("time,id,dlc,data", f"1.5,123,9,{ELEVEN}", Frame(0x123, TWELVE, 1.5, is_fd=True)),
    "byte columns from 0": ("time,id,dlc,d0,d1,d2", "1.5,123,2,01,A,", Frame(0x123, b"\1\x0a", 1.5)),
    "byte columns from 1": ("time,id,byte1,byte2,byte3", "1.5,123,01,02,", Frame(0x123, b"\1\2", 1.5)),
    "byte columns, padded": ("time,id,dlc,b0,b1,b2", "1.5,123,1,01,00,00", Frame(0x123, b"\1", 1.5)),
    "remote": ("time,id,rtr,dlc,data", "1.5,123,1,4,", Frame(0x123, b"", 1.5, None, False, True, dlc=4)),
    "error": ("time,id,error,data", "1.5,4,1,00", Frame(4, b"\0", 1.5, is_error_frame=True)),
    "FD": (
        "time,id,fd,brs,esi,data",
        "1.5,123,1,1,0,01",
        Frame(0x123, b"\1", 1.5, is_fd=True, bitrate_switch=True),
    ),
    "FD by its rate switch": (
        "time,id,brs,data",
        "1.5,123,1,01",
        Frame(0x123, b"\1", 1.5, is_fd=True, bitrate_switch=True),
    ),
    "length code, byte columns": (
        "time,id,dlc," + ",".join(f"d{n}" for n in range(24)),
        f"1.5,123,12,{','.join(['aa'] * 24)}",
        Frame(0x123, b"\xaa" * 24, 1.5, is_fd=True),
    ),
    "of comma.ai": ("time,addr,bus,data", "1.5,0x123,0,0x0102", Frame(0x123, b"\1\2", 1.5, "0")),
    "of another": (
        "Bus,MessageID,Message,MessageLength",
        "0,0x123,0x0102,2",
        Frame(0x123, b"\1\2", None, "0"),
    ),
}


@pytest.mark.parametrize(("head", "line", "frame"), NAMED.values(), ids=NAMED)
def test_columns_are_told_by_their_names(head: str, line: str, frame: Frame) -> None:
    """Separator, unit, base and place of everything are in the header."""
    capture = open_recording(io.BytesIO(f"{head}\n{line}\n".encode()), link="can")
    assert capture.format == "CSV with named columns"
    assert list(capture) == [frame]
    accounted(capture)


@pytest.mark.parametrize(
    ("head", "line", "reason"),
    [
        ("time,id,dlc,data", "1.5,123,3,01 02", "3 bytes are announced, 2 are there"),
        ("time,id,data", "1.5,123,012", "odd number of hexadecimal digits"),
        ("time,id,data", "1.5,123,01 0G", "byte '0G' is not a hexadecimal number"),
        ("time,id,data", "1.5,,01", "identifier '' is not a hexadecimal number"),
        ("time,id,data", "soon,123,01", "time 'soon' is not a number"),
        ("time,id,data", "2023-13-01 12:00:00,123,01", "is neither a number nor a date"),
        ("time,id,extended,data", "1.5,123,perhaps,01", "extended is 'perhaps', neither true nor false"),
        ("time,id,extended,data", "1.5,800,0,01", "identifier 0x800 is outside"),
        ("time,id,data (dec)", "1.5,123,256", "byte 100 is more than 255"),
        ("time,id,data", "1.5,123," + "00" * 65, "65 bytes are more than a frame holds"),
        ("time,id,dlc,d0,d1,d2", "1.5,123,3,01,02,", "3 bytes are announced, 2 are there"),
        ("time,id,dlc,data", "1.5,123", "2 columns; the header names more, and data, length in them"),
        ("time,id,dlc,d0,d1", "1.5,12", "2 columns; the header names more, and length in them"),
        ("time,id,dir,data", "1.5,123,up,01", "direction is 'up', neither received nor sent"),
        ("time,id,fd,brs,data", "1.5,123,0,1,01", "exist only in CAN FD"),
        ("time,id,fd,data", "1.5,123,0," + "00" * 12, "a classic CAN frame cannot carry 12 data bytes"),
    ],
)
def test_a_faulty_line_of_named_columns_is_counted(head: str, line: str, reason: str) -> None:
    """Faults lose their own line and no other."""
    frames, capture = read("id-csv", f"{head}\n{line}\n")
    assert (len(frames), capture.lines_unreadable) == (0, 1)
    assert reason in capture.problems[0].reason


@pytest.mark.parametrize(
    ("head", "says"),
    [
        ("time,id,value", "no column of this CSV is named as data .*: time, id, value"),
        ("time,id,dlc,d2,d3", "not numbered from 0 or 1"),
        ("time,id,dlc,d0,d2", "not numbered from 0 or 1"),
        ("time,id,data,d0,d1", "which to take is not said"),
    ],
)
def test_what_names_do_not_say_is_not_guessed(head: str, says: str) -> None:
    """The file is refused with what is missing, before anything is read."""
    with pytest.raises(CaptureError, match=says):
        open_recording(io.BytesIO(f"{head}\n1,2,3,4,5\n".encode()), link="can")


def test_a_csv_without_an_identifier_is_no_capture() -> None:
    """Neither told by content, nor read by name."""
    with pytest.raises(CaptureError, match="not a CAN capture"):
        open_recording(io.BytesIO(b"time,speed\n1,2\n"), link="can")
    with pytest.raises(CaptureError, match="no column of this CSV is named as an identifier"):
        open_recording(io.BytesIO(b"time,data\n1,2\n"), link="can", format="id-csv")


# ---- python-can's files --------------------------------------------------------------------------------------------


@given(data=st.data())
def test_what_python_can_writes_as_csv_reads_back(data: st.DataObject) -> None:
    """Frames and times as they were given to its writer."""
    written: list[can.Message] = []
    for _ in range(data.draw(st.integers(0, 20))):
        kind = data.draw(st.sampled_from(["data", "data", "remote", "error", "fd"]))
        extended = data.draw(st.booleans())
        size = (
            data.draw(st.sampled_from([n for n in FD_LENGTHS if n > 8]))
            if kind == "fd"
            else data.draw(st.integers(0, 8))
        )
        written.append(
            can.Message(
                timestamp=data.draw(st.floats(0, 2**31)),
                arbitration_id=data.draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF)),
                is_extended_id=extended,
                is_remote_frame=kind == "remote",
                is_error_frame=kind == "error",
                is_fd=kind == "fd",
                dlc=size,
                data=None if kind == "remote" else data.draw(st.binary(min_size=size, max_size=size)),
            )
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "walk.csv"
        with can.CSVWriter(str(path)) as writer:
            for message in written:
                writer.on_message_received(message)
        content = path.read_bytes()
    capture = open_recording(io.BytesIO(content), link="can")
    assert capture.format == "python-can CSV"
    table = FrameTable.concat(list(capture.tables()))
    accounted(capture)
    assert capture.lines_unreadable == 0
    assert [
        (f.arbitration_id, f.is_extended_id, f.is_remote_frame, f.is_error_frame, f.is_fd, f.data, f.length)
        for f in table.frames()
    ] == [
        (
            m.arbitration_id,
            m.is_extended_id and not m.is_error_frame,  # an error frame has a class, of 29 bits by itself
            m.is_remote_frame,
            m.is_error_frame,
            m.is_fd,
            bytes(m.data),
            m.dlc,
        )
        for m in written
    ]
    for time, message in zip(table.time.tolist(), written, strict=True):
        assert abs(time / 1e9 - message.timestamp) <= 1e-6


TEXTS = [
    sample for sample in SAMPLES if sample.kind == "lines" and sample.format not in ("candump", "dxconf")
]


@pytest.mark.parametrize("many", [1, 40])
@pytest.mark.parametrize("sample", TEXTS, ids=lambda one: one.format)
def test_lines_that_ran_together_lose_no_frame_unsaid(sample: Sample, many: int) -> None:
    """Where a line end is missing (a cut file was appended to), each frame that is gone is of an unreadable line."""
    lines = sample.content.decode("latin-1").splitlines()

    def counted(some: list[str]) -> tuple[int, int]:
        content = "\n".join([*some, ""]).encode("latin-1")
        try:
            capture = open_recording(io.BytesIO(content), link="can", format=sample.format)
            return sum(map(len, capture.tables())), capture.lines_unreadable
        except CaptureError:  # of the only lines that are known
            return 0, 1 << 20

    lines += lines[-4:] * many
    frames, unreadable = counted(lines)
    for place in range(len(lines) - 8, len(lines) - 1) if many > 1 else range(len(lines) - 1):
        for between in ("", " "):
            joined = lines[place] + between + lines[place + 1]
            left, missing = counted([*lines[:place], joined, *lines[place + 2 :]])
            _, of_others = counted([*lines[:place], *lines[place + 2 :]])
            if of_others == unreadable:  # both lines are right when they stand alone
                assert left >= frames or missing > unreadable, joined
