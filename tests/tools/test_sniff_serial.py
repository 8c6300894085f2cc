"""`aces sniff` on serial lines and UDP: bytes and datagrams are decoded, recorded and counted; nothing is written."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import serial

from aces_bus import open_recording
from aces_bus.errors import CallerError
from tests.limits import small_disk
from tests.tools.live import Opened, posix

Aces = Callable[..., Any]
pytestmark = pytest.mark.usefixtures("quick")


@posix
def test_a_serial_line_is_decoded_and_recorded(
    aces: Aces, opened: Opened, pty: tuple[int, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Packets come as records, the recording has the bytes, their times and pieces; nothing is written to the line."""
    far, near = pty
    written: list[bytes] = []
    monkeypatch.setattr(serial.Serial, "write", lambda _, data: written.append(data))
    opened.then(lambda: os.write(far, bytes.fromhex("FFFF010200FC")))
    record = tmp_path / "line.slog"
    found = aces(
        "sniff", "--serial", near, "-p", "robotis", "--direction", "from", "-n", 1, "--format", "jsonl",
        "--record", record,
    )  # fmt: skip
    (one,) = found.objects
    assert (one["message"], one["offset"], one["size"], one["direction"]) == ("Status", 0, 6, "from device")
    assert found.summary["decoded"] == 6
    chunks = list(open_recording(record, link="serial"))
    assert b"".join(chunk.data for chunk in chunks) == bytes.fromhex("FFFF010200FC")
    assert {chunk.direction for chunk in chunks} == {"from device"}
    assert all(chunk.time is not None and chunk.time > 1.7e9 for chunk in chunks)
    assert written == []
    with pytest.raises(CallerError, match="only listens"):
        opened.gates[0].send(b"\0")


@posix
def test_bytes_that_a_full_disk_took_are_counted(
    aces: Aces, opened: Opened, pty: tuple[int, str], tmp_path: Path
) -> None:
    """Bytes said to be recorded are those in the file; a piece that did not fit leaves no part of it."""
    far, near = pty
    opened.then(lambda: os.write(far, bytes(range(100))))
    record = tmp_path / "line.slog"
    with small_disk(200):
        found = aces("sniff", "--serial", near, "--record", record, "-q")
    assert found.status == 2
    assert f"recorded 0 bytes in {record}, 100 are not in it" in found.err
    assert record.read_bytes() == b"# aces serial capture 1\n"


@posix
def test_a_silent_line_ends_what_is_incomplete(aces: Aces, opened: Opened, pty: tuple[int, str]) -> None:
    """Half a packet is shown as malformed after the protocol's gap, though nothing follows."""
    far, near = pty
    opened.then(lambda: os.write(far, bytes.fromhex("FFFF0105")))
    found = aces(
        "sniff", "--serial", near, "-p", "robotis", "--direction", "from", "-n", 1, "--format", "jsonl"
    )
    (one,) = found.objects
    assert one["reason"] == "malformed: incomplete"


@posix
def test_bytes_without_a_protocol(aces: Aces, opened: Opened, pty: tuple[int, str]) -> None:
    """They are shown as they came, and are unknown."""
    far, near = pty
    opened.then(lambda: os.write(far, b"\x01\x02"))
    found = aces("sniff", "--serial", near, "-n", 1)
    assert found.out.endswith(f"{near} ?  [2]  01 02\n")
    assert found.summary["unknown"] == found.summary["bytes"] == 2


def test_datagrams_are_whole(aces: Aces, opened: Opened) -> None:
    """What a datagram leaves incomplete the next one does not continue."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    packet = bytes.fromhex("FFFF010200FC")

    def work() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for data in (packet[:3], packet[3:], packet):
                sender.sendto(data, ("127.0.0.1", port))

    opened.then(work)
    found = aces(
        "sniff", "--udp", port, "-p", "robotis", "--direction", "from", "--message", "Status", "-n", 1
    )
    assert found.summary["decoded"] == 6
    assert found.summary["bytes"] == 12
