"""What a source is, and what is said of one that is not a capture."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from aces_bus import open_recording
from aces_bus.errors import CallerError, CaptureError, UnknownNameError
from aces_bus.recordings.base import CanRecording, Link, SerialRecording
from aces_bus.recordings.open import formats

LOG = b"(1436509052.249713) can0 044#2A366C2BBA\n"
DUMP = b'Port opened by process "DXCONF.exe" (PID: 2568)\n\n FF FF   \xc3\xbf\xc3\xbf\n\nPort closed\n'
BINARY = bytes([0xFF, 0xFF, 0x01, 0x02, 0x00, 0xFC]) * 100


@pytest.mark.parametrize(
    ("content", "link", "kind", "form"),
    [
        (LOG, "can", CanRecording, "candump"),
        (LOG, None, CanRecording, "candump"),
        (b"  can0  123   [1]  11\n", None, CanRecording, "candump"),
        (b"", None, CanRecording, "candump"),
        (DUMP, "serial", SerialRecording, "hex dump of the vendor's serial monitor"),
        (DUMP, None, SerialRecording, "hex dump of the vendor's serial monitor"),
        (b"\xef\xbb\xbf\r\n" + DUMP, None, SerialRecording, "hex dump of the vendor's serial monitor"),
        (BINARY, "serial", SerialRecording, "raw serial bytes"),
        (b"$GPGGA,1*00\r\n", "serial", SerialRecording, "raw serial bytes"),
        (b"", "serial", SerialRecording, "raw serial bytes"),
    ],
)
def test_content_tells_the_format(
    tmp_path: Path, content: bytes, link: Link | None, kind: type, form: str
) -> None:
    """The first bytes decide; the suffix never does, the link only where bytes cannot."""
    path = tmp_path / "capture.mp3"
    path.write_bytes(content)
    with open_recording(path, link=link) as capture:
        assert isinstance(capture, kind)
        assert (capture.format, capture.name) == (form, str(path))
        list(capture)


@pytest.mark.parametrize(
    ("content", "link", "says"),
    [
        (BINARY, "can", "not a CAN capture: it looks binary (byte 0x01 at offset 2)"),
        (BINARY, "can", "known are: SQLite log of python-can, "),
        (BINARY, "can", "a serial capture needs a serial protocol"),
        (BINARY, None, "say link='serial'"),
        (b"\x00" * 200_000, "can", "not a CAN capture"),
        (b"Dear diary,\n", "can", "it begins with 'Dear diary,'"),
        (b"0 X Y Z\n0.1 0 0 0\n" * 500, "can", "(candump -L can0 > walk.log)"),
        (LOG, "serial", "a candump log, not a serial capture; name a CAN protocol"),
        (DUMP, "can", "a hex dump of the vendor's serial monitor, of a serial line; name a serial protocol"),
        (b"\x1f\x8b\x08\x00rest", "can", "the gzip data ends too early, after 8 bytes"),
        (
            b"date Tue Jul 9\nbase hex timestamps absolute\n",
            "serial",
            "a Vector ASC log, not a serial capture",
        ),
        (b"\xfd7zXZ\x00\x00", "can", "this is xz; unpack it first"),
        (b"PK\x03\x04\x14\x00", None, "this is a zip archive; unpack it first"),
        (b"PK\x03\x04\x14\x00walk.log" + LOG, "can", "this is a zip archive; unpack it first"),
        (b"PK\x03\x04\x14\x00walk.log" + LOG, "serial", "this is a zip archive; unpack it first"),
        (b"time,id,value\n1,2,3\n", "can", "no column of this CSV is named as data"),
        (LOG.decode().encode("utf-16"), "can", "this is UTF-16 text"),
        (b"junk\n" * 200 + LOG, "can", "it begins with 'junk'"),
    ],
)
def test_a_wrong_file_is_refused_with_what_would_work(
    tmp_path: Path, content: bytes, link: Link | None, says: str
) -> None:
    """One line: the file, what it is, what to do."""
    path = tmp_path / "walk.log"
    path.write_bytes(content)
    with pytest.raises(CaptureError) as caught:
        open_recording(path, link=link)
    assert str(caught.value).startswith(f"{path}: ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_format_may_be_named() -> None:
    """Then the content is not looked at, and a link that the format is not of is refused."""
    capture = open_recording(io.BytesIO(LOG), format="raw")
    assert [chunk.data for chunk in capture] == [LOG]
    with pytest.raises(CallerError, match="format 'raw' is of a serial link, and the protocol speaks can"):
        open_recording(io.BytesIO(LOG), link="can", format="raw")
    with pytest.raises(UnknownNameError, match="no capture format named 'ascii'"):
        open_recording(io.BytesIO(LOG), format="ascii")


def test_formats_are_listed_with_what_they_are() -> None:
    """For help texts: each name once, with a description of one line."""
    listed = formats()
    assert list(listed)[-1] == "raw"  # any bytes are one: nothing may come behind
    assert {"candump", "asc", "trc", "gvret", "crtd", "busmaster", "microchip", "csv", "id-csv"} <= set(
        listed
    )
    assert all(words and "\n" not in words for words in listed.values())


@pytest.mark.parametrize(
    ("pieces", "form"),
    [
        ([b"da", b"te Sam Sep 30 15:06:13.191 2017\nbase hex\n", b"1.0 1 123 Rx d 1 11\n"], "Vector ASC log"),
        ([b"// a remark\n", b"base hex\n1.0 1 123 Rx d 1 11\n"], "Vector ASC log"),
        ([b";", b"$FILEVERSION=1.1\n", b" 1) 1 Rx 0123 1 11\n"], "PEAK trace"),
        (
            [b"timestamp,arbitration_id,", b"extended,remote,error,dlc,data\n1,0x123,0,0,0,1,EQ==\n"],
            "python-can CSV",
        ),
        ([b"# remark\n", b"\n", b"(1.0) can0 123#11\n"], "candump"),
        ([b"(1.", b"0) can0 123#11\n"], "candump"),
        ([b"  can0 ", b" 123   [1]  11\n"], "candump"),
    ],
)
def test_a_pipe_is_told_as_soon_as_it_shows_itself(pieces: list[bytes], form: str) -> None:
    """The first line may come in pieces, behind remarks: it is waited for, and nothing behind it."""
    reader, writer = os.pipe()
    with open(reader, "rb", buffering=0) as file:

        class InPieces(io.RawIOBase):
            """What is written before each read."""

            def fileno(self) -> int:
                return file.fileno()

            def read(self, size: int = -1) -> bytes:
                if pieces:
                    os.write(writer, pieces.pop(0))
                    if not pieces:
                        os.close(writer)
                return file.read(size)

        source: Any = InPieces()
        capture = open_recording(source, link="can", name="pipe")
        assert capture.live
        assert capture.format == form
        assert [frame.data for frame in capture] == [b"\x11"]


def test_a_missing_file_names_one_that_is_near(tmp_path: Path) -> None:
    """A slip of the finger is met with the name that was meant."""
    (tmp_path / "walk.log").write_bytes(LOG)
    with pytest.raises(CaptureError, match=r"walkl\.log: no such file; did you mean '.*walk\.log'"):
        open_recording(tmp_path / "walkl.log", link="can")
    with pytest.raises(CaptureError, match=r"no such file$"):
        open_recording(tmp_path / "zzz", link="can")
    with pytest.raises(CaptureError, match="there is no folder"):
        open_recording(tmp_path / "nowhere" / "walk.log", link="can")


def test_a_folder_is_no_capture(tmp_path: Path) -> None:
    """A folder is named as one."""
    with pytest.raises(CaptureError, match="this is a folder"):
        open_recording(tmp_path, link="can")


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="the superuser may read everything"
)
def test_a_file_without_permission_says_so(tmp_path: Path) -> None:
    """No permission is not no file."""
    path = tmp_path / "walk.log"
    path.write_bytes(LOG)
    path.chmod(0)
    with pytest.raises(CaptureError, match="permission denied"):
        open_recording(path, link="can")


@pytest.mark.parametrize("path", ["a\0b", "x" * 5000])
def test_an_impossible_path_is_refused(path: str) -> None:
    """What the system does not take as a path is the caller's error like any other."""
    with pytest.raises(CaptureError):
        open_recording(path, link="can")


def test_an_open_file_stays_open(tmp_path: Path) -> None:
    """Who opens a file closes it."""
    path = tmp_path / "walk.log"
    path.write_bytes(LOG)
    with path.open("rb") as file:
        with open_recording(file, link="can") as capture:
            assert len(list(capture)) == 1
        assert not file.closed
        assert capture.name == str(path)
    text: Any = path.open()
    with text:
        assert len(list(open_recording(text, link="can", name="by text"))) == 1


def test_a_capture_is_read_once(tmp_path: Path) -> None:
    """Going on after a break goes on, and after the end there is nothing."""
    path = tmp_path / "walk.log"
    path.write_bytes(LOG * 3)
    capture = open_recording(path, link="can")
    assert len(list(capture)) == 3
    assert list(capture) == []


@pytest.mark.parametrize("wrong", [io.StringIO("(1.5) can0 123#11\n"), object(), None])
def test_what_gives_no_bytes_is_refused(wrong: Any) -> None:
    """Text files without bytes behind them, and things that are not files at all."""
    with pytest.raises(CaptureError):
        open_recording(wrong, link="can")


def test_a_link_without_formats_is_refused() -> None:
    """There is no recording of datagrams yet."""
    link: Any = "datagram"
    with pytest.raises(CallerError, match="datagram"):
        open_recording(io.BytesIO(), link=link)


def test_reading_that_fails_is_a_capture_error() -> None:
    """A device that is pulled out while it is read ends the capture with one message."""

    class Pulled(io.RawIOBase):
        left = 2

        def read(self, size: int = -1) -> bytes:
            self.left -= 1
            if self.left < 0:
                raise OSError(5, "Input/output error")
            return LOG * 3000

    source: Any = Pulled()
    capture = open_recording(source, link="can", name="can.fifo")
    with pytest.raises(CaptureError, match=r"can\.fifo: reading stopped: Input/output error"):
        list(capture)
    assert capture.frames == 6000


@pytest.mark.slow
def test_standard_input_is_a_source() -> None:
    """`candump can0 | aces decode … -`."""
    program = (
        "from aces_bus import open_recording\n"
        "for frame in open_recording('-', link='can'): print(frame.channel, hex(frame.arbitration_id))\n"
    )
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(
        [sys.executable, "-c", program], input=b"  can0  123   [1]  11\n" + LOG, capture_output=True, cwd=root
    )
    assert (done.stdout.decode().split(), done.stderr) == (["can0", "0x123", "can0", "0x44"], b"")


def test_a_closed_standard_input_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """A program without standard input gets a message, not a traceback."""
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(CaptureError, match="standard input is closed"):
        open_recording("-", link="can")
