"""Raw serial files and the vendor's hex dumps: the bytes, all of them, in order."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from aces_bus import open_recording
from aces_bus.recordings.base import Chunk, SerialRecording

OPENED = b'Port opened by process "DXCONF.exe" (PID: 2568)\n\n'
CLOSED = b"\nPort closed\n\n"


def read(content: bytes) -> tuple[bytes, SerialRecording]:
    capture = open_recording(io.BytesIO(content), link="serial")
    return b"".join(chunk.data for chunk in capture), capture


def dump(data: bytes) -> bytes:
    """The rows that the vendor's monitor prints for these bytes."""
    rows: list[str] = []
    for start in range(0, len(data), 16):
        row = data[start : start + 16]
        characters = "".join("." if byte < 0x20 else chr(byte) for byte in row)
        rows.append(f" {row.hex(' ').upper():47}   {characters:16}\n")
    return "".join(rows).encode()


@example(b"\xa1\xb2\x3c\x4d\x00\x02")  # as a pcap begins
@example(b"Port opened by us")
@example(b"(1.0) can0 1#")
@given(st.binary(max_size=300))
def test_a_raw_file_is_its_bytes(data: bytes) -> None:
    """Nothing is added, lost or reordered, whatever the bytes are, and whatever they look like."""
    capture = open_recording(io.BytesIO(data), link="serial", format="raw")
    assert isinstance(capture, SerialRecording)
    assert b"".join(chunk.data for chunk in capture) == data
    assert capture.bytes == len(data)
    assert (capture.lines, capture.problems) == (0, [])


def test_chunks_are_at_most_64_kib(tmp_path: Path) -> None:
    """A large file comes in bounded pieces, without time and direction."""
    data = bytes(range(256)) * 1000
    path = tmp_path / "walk.log"  # the suffix means nothing
    path.write_bytes(data)
    with open_recording(path, link="serial") as capture:
        chunks = list(capture)
    assert b"".join(chunk.data for chunk in chunks) == data
    assert max(len(chunk.data) for chunk in chunks) <= 1 << 16
    assert {(chunk.time, chunk.direction) for chunk in chunks} == {(None, None)}


def test_a_pipe_gives_what_is_there() -> None:
    """Bytes from a pipe come when they come."""
    reader, writer = os.pipe()
    with open(reader, "rb", buffering=0) as file:
        os.write(writer, b"\xff\xff\x01")
        capture = iter(open_recording(file, link="serial"))
        assert next(capture) == Chunk(b"\xff\xff\x01")
        os.write(writer, b"\x02")
        assert next(capture) == Chunk(b"\x02")
        os.close(writer)
        assert list(capture) == []


def test_a_hex_dump_from_a_pipe_is_told_by_its_first_line() -> None:
    """A dump that arrives byte by byte is a dump all the same."""
    reader, writer = os.pipe()
    with open(reader, "rb", buffering=0) as file:
        text = OPENED + dump(b"\xff\xff\x01") + CLOSED
        os.write(writer, text[:3])
        os.write(writer, text[3:])
        os.close(writer)
        assert [chunk.data for chunk in open_recording(file, link="serial")] == [b"\xff\xff\x01"]


@pytest.mark.parametrize("ending", [b"\n", b"\r\n"], ids=["LF", "CRLF"])
@given(st.binary(min_size=1, max_size=200))
def test_a_hex_dump_is_its_bytes(ending: bytes, data: bytes) -> None:
    """Whatever the character column shows (next-line controls, hexadecimal look-alikes), only the cells count."""
    content = (OPENED + dump(data) + CLOSED).replace(b"\n", ending)
    got, capture = read(content)
    assert got == data
    assert capture.bytes == len(data)
    assert (capture.lines_comment, capture.lines_blank, capture.lines_unreadable) == (2, 3, 0)
    assert capture.lines == content.count(b"\n")


def test_unreadable_rows_are_counted() -> None:
    """A damaged row is named and left out; the rest is there."""
    rows = dump(bytes(range(16))) + b" FF F\n" + b" 00 gg\n" + dump(b"\x10\x11")
    got, capture = read(OPENED + rows + CLOSED)
    assert got == bytes(range(18))
    assert [(problem.line, problem.excerpt) for problem in capture.problems] == [(4, " FF F"), (5, " 00 gg")]
    assert capture.lines == capture.lines_unreadable + capture.lines_comment + capture.lines_blank + 2


def test_a_closed_port_ends_a_chunk() -> None:
    """Bytes of two sessions in one file are two chunks."""
    content = OPENED + dump(b"\x01\x02") + CLOSED + OPENED + dump(b"\x03") + CLOSED
    capture = open_recording(io.BytesIO(content))
    assert isinstance(capture, SerialRecording)
    assert [chunk.data for chunk in capture] == [b"\x01\x02", b"\x03"]


@given(st.binary(max_size=300))
def test_no_dump_does_harm(junk: bytes) -> None:
    """Whatever follows the first line of a dump, each line of it is counted."""
    content = OPENED + dump(b"\x01") + junk
    _, capture = read(content)
    rows = capture.lines - capture.lines_unreadable - capture.lines_comment - capture.lines_blank
    assert capture.lines == content.count(b"\n") + (not content.endswith(b"\n"))
    assert rows >= 1
    assert len(capture.problems) == min(5, capture.lines_unreadable)


@pytest.mark.shared
@pytest.mark.parametrize("direction", ["positioning.to-servo", "ctrl_tbl_read.from-servo"])
def test_the_shared_dumps_hold_the_stated_bytes(shared_captures: Path, direction: str) -> None:
    """The recorded dumps: as many bytes as stated, and the packets where they are stated to be."""
    name = f"robotis/{direction}.dxconf.txt"
    expected = json.loads((shared_captures / "expected.json").read_text())[name]["dxconf_hexdump"]
    capture = open_recording(shared_captures / name)
    assert isinstance(capture, SerialRecording)
    data = b"".join(chunk.data for chunk in capture)
    assert len(data) == capture.bytes == expected["hexdump_bytes"]
    assert capture.lines_unreadable == 0
    for packet in expected["packets"]:
        start = packet["offset"]
        assert data[start : start + 2] == b"\xff\xff"
        assert data[start + 2 : start + 4] == bytes([packet["id"], packet["length"]])
        assert data[start + 5 : start + packet["length"] + 3].hex() == packet["params"]


@pytest.mark.shared
def test_the_shared_dump_and_the_raw_file_agree(shared_captures: Path) -> None:
    """The same session, once dumped and once raw."""
    folder = shared_captures / "robotis"
    both = [
        b"".join(chunk.data for chunk in open_recording(folder / name, link="serial"))
        for name in ("ctrl_tbl_read.from-servo.dxconf.txt", "ctrl_tbl_read.from-servo.bin")
    ]
    assert both[0] == both[1]
