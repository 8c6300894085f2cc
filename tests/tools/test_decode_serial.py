"""`aces decode` on serial recordings: offsets, bins, directions, standard input, several links."""

from __future__ import annotations

import gzip
import io
import json
import random
import sys
from pathlib import Path
from typing import Any

import pytest

from aces_bus import load_protocol

from .conftest import Aces

ROBOTIS = load_protocol("robotis")


def robotis(message: str, **fields: Any) -> bytes:
    return bytes(ROBOTIS.encode(message, **fields))


STATUS = robotis("Status", id=1, error=["overload", "range"], parameters=b"\x01\xff")
READ = robotis("Read", id=1, start=0x24, count=2)


def spoilt(packet: bytes) -> bytes:
    return packet[:-1] + bytes([packet[-1] ^ 0xFF])


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Garbage, a packet, one with a bad checksum, a packet, the beginning of one."""
    path = tmp_path / "x.bin"
    path.write_bytes(b"\x00\x01" + STATUS + spoilt(STATUS) + STATUS + STATUS[:4])
    return path


def test_streams_have_offset_and_size(aces: Aces, capture: Path) -> None:
    """A packet's line has its place in the stream instead of an identifier."""
    result = aces("decode", capture, "-p", "robotis", "--direction", "from", "--format", "jsonl")
    assert result.out.splitlines()[1] == (
        f'{{"source": "{capture}", "time": null, "channel": null, "direction": "from device", "offset": 2, "size": 8, '
        '"protocol": "robotis", "message": "Status", '
        '"fields": {"id": 1, "error": ["range", "overload"], "parameters": "01ff"}}'
    )


def test_every_byte_is_in_one_bin(aces: Aces, capture: Path) -> None:
    """The summary of a stream has the documented form and sums to the bytes; the lines cover the stream."""
    result = aces("decode", capture, "-p", "robotis", "--direction", "from", "--format", "jsonl")
    summary = result.summary
    assert list(summary) == [
        "bytes",
        "decoded",
        "unknown",
        "malformed",
        "skipped",
        "filtered",
        "pending",
        "records",
    ]
    assert (summary["bytes"], summary["decoded"], summary["records"], summary["pending"]) == (30, 16, 2, 4)
    assert summary["bytes"] == sum(n for name, n in summary.items() if name not in ("bytes", "records"))
    at = 0
    for line in result.objects:
        assert line["offset"] == at
        at += line["size"]
    assert at == 30
    assert result.objects[-1]["reason"] == "pending"


def test_filtered_bytes_and_records(aces: Aces, capture: Path) -> None:
    """--where takes the bytes of a refused packet from `decoded` to `filtered`, and its record away."""
    result = aces(
        "decode", capture, "-p", "robotis", "--direction", "from", "--where", "id=2", "--format", "jsonl"
    )
    assert result.out == ""
    assert (result.summary["decoded"], result.summary["filtered"], result.summary["records"]) == (0, 16, 0)


def test_an_ambiguous_protocol_asks_for_the_direction(aces: Aces, capture: Path) -> None:
    """Without --direction it is a wrong call, said once, however many files."""
    result = aces("decode", capture, capture, "-p", "robotis")
    assert result.status == 2
    assert len(result.messages) == 1
    assert "--direction" in result.messages[0]
    assert result.out == ""


def test_a_protocol_that_is_not_ambiguous_needs_no_direction(aces: Aces, tmp_path: Path, line: str) -> None:
    """Where bytes tell all, --direction may be left out."""
    path = tmp_path / "x.bin"
    path.write_bytes(b"\xaa\x00\x10\x05" * 3)
    result = aces("decode", path, "-p", line, "--strict")
    assert result.status == 0
    assert result.summary["records"] == 3


def test_both_directions_pair_requests_and_replies(aces: Aces, tmp_path: Path) -> None:
    """--direction both decodes a line on which both sides speak, and a reply without request is unknown."""
    path = tmp_path / "x.bin"
    path.write_bytes(STATUS + READ + STATUS)
    objects = aces("decode", path, "-p", "robotis", "--direction", "both", "--format", "jsonl").objects
    assert [o["message"] for o in objects] == [None, "Read", "Status"]
    assert [o["direction"] for o in objects] == [None, "to device", "from device"]
    assert objects[0]["reason"].startswith("unknown: needs request ")


@pytest.mark.parametrize("seed", range(5))
def test_garbage_is_counted(aces: Aces, tmp_path: Path, seed: int) -> None:
    """Whatever the bytes, the command decodes, counts and ends well."""
    chance = random.Random(seed)
    path = tmp_path / "x.bin"
    path.write_bytes(
        b"".join(chance.choice([STATUS, READ, b"\xff", chance.randbytes(5)]) for _ in range(300))
    )
    for direction in ("to", "from", "both"):
        result = aces("decode", path, "-p", "robotis", "--direction", direction, "--format", "jsonl")
        summary = result.summary
        assert result.status == 0
        assert summary["bytes"] == path.stat().st_size
        assert summary["bytes"] == sum(n for name, n in summary.items() if name not in ("bytes", "records"))
        assert sum(o["size"] for o in result.objects) == summary["bytes"]


def test_long_garbage_is_cut_short_for_people(aces: Aces, tmp_path: Path, line: str) -> None:
    """Text shows the beginning of lost bytes and how many there are; jsonl has all of them."""
    path = tmp_path / "x.bin"
    path.write_bytes(bytes(10_000))
    text = aces("decode", path, "-p", line).out
    assert max(map(len, text.splitlines())) < 120
    assert "(4096 bytes)" in text
    objects = aces("decode", path, "-p", line, "--format", "jsonl").objects
    assert sum(len(o["raw"]) for o in objects) == 20_000


def test_the_dump_of_the_vendors_monitor(aces: Aces, tmp_path: Path) -> None:
    """A hex dump is read as the bytes it shows, and its unreadable rows are counted."""
    path = tmp_path / "x.txt"
    cells = STATUS.hex(" ").upper()
    path.write_text(
        f'Port opened by process "DXCONF.exe" (PID: 1)\n\n {cells}   text\n nonsense\n\nPort closed\n',
        encoding="utf-8",
    )
    result = aces("decode", path, "-p", "robotis", "--direction", "from", "--format", "jsonl", "--strict")
    assert [o["message"] for o in result.objects] == ["Status"]
    assert result.summary["lines_unreadable"] == 1
    assert result.status == 1


def test_standard_input(aces: Aces, monkeypatch: pytest.MonkeyPatch) -> None:
    """`-` reads standard input."""
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(STATUS)))
    (line,) = aces("decode", "-", "-p", "robotis", "--direction", "from", "--format", "jsonl").objects
    assert (line["source"], line["message"]) == ("-", "Status")


def test_each_file_goes_to_the_protocols_of_its_link(aces: Aces, log: Path, arm: str, capture: Path) -> None:
    """CAN and serial protocols together: each file is decoded by its own, with a summary line a link."""
    result = aces(
        "decode", log, capture, "-p", arm, "-p", "robotis", "--direction", "from", "--format", "jsonl"
    )
    assert {o["protocol"] for o in result.objects} == {"arm", "robotis", None}
    last = result.err.splitlines()[-2:]
    assert last[0].startswith("frames=12 ")
    assert last[1].startswith("bytes=30 ")


@pytest.mark.parametrize("is_can", [True, False])
def test_a_file_that_no_protocol_fits(aces: Aces, log: Path, arm: str, capture: Path, is_can: bool) -> None:
    """A serial file with CAN protocols, and the other way round, is one clear message."""
    if is_can:
        result = aces("decode", log, "-p", "robotis", "--direction", "from")
        assert "CAN protocol" in result.messages[0]
    else:
        result = aces("decode", capture, "-p", arm)
        assert "serial protocol" in result.messages[0]
    assert len(result.messages) == 1
    assert result.status == 2


def test_filters_of_candump_are_for_can(aces: Aces, capture: Path) -> None:
    """--filter with serial protocols only is a wrong call."""
    result = aces("decode", capture, "-p", "robotis", "--direction", "from", "--filter", "060:7F0")
    assert result.status == 2
    assert "CAN" in result.err


def test_what_came_before_damage_is_finished(aces: Aces, tmp_path: Path) -> None:
    """Where reading fails the recording ends: records, tables and plots have the same packets, and all of them."""
    path = tmp_path / "x.bin.gz"
    path.write_bytes(gzip.compress(STATUS * 200 + STATUS[:3])[:-8])
    call = (path, "-p", "robotis", "--direction", "from")
    results = [
        aces("decode", *call, "-q"),
        aces("decode", *call, "-o", tmp_path / "x.npz"),
        aces("plot", *call, "--list"),
    ]
    assert {(result.status, result.summary["records"], result.summary["pending"]) for result in results} == {
        (2, 200, 3)
    }
    assert all("the gzip data ends too early" in result.err for result in results)


@pytest.mark.shared
def test_recordings_of_servos(aces: Aces, shared_captures: Path) -> None:
    """Every packet of the real recordings, with its offset, as `expected.json` has it."""
    expected = json.loads((shared_captures / "expected.json").read_text())
    seen = 0
    for path in sorted((shared_captures / "robotis").iterdir()):
        direction = "from" if "from-servo" in path.name else "to"
        result = aces("decode", path, "-p", "robotis", "--direction", direction, "--format", "jsonl")
        kind = "dxconf_hexdump" if path.name.endswith(".dxconf.txt") else "dynamixel1"
        wanted = expected[f"robotis/{path.name}"][kind]["packets"]
        found = [o for o in result.objects if o["message"]]
        assert [(o["offset"], o["fields"]["id"]) for o in found] == [(w["offset"], w["id"]) for w in wanted]
        seen += len(found)
    assert seen > 30


def test_a_packet_with_the_right_head_says_what_is_another(aces: Aces, tmp_path: Path) -> None:
    """One such packet is explained on stderr: which message, which bytes; what has no message's head is not."""
    (tmp_path / "spec.py").write_text(
        "from construct import Byte, Const, Struct, this\n"
        "from aces_bus.protocol import Protocol, Sum\n"
        "p = Protocol('p', link='serial')\n"
        "packet = p.framing(sync=b'\\xa5', header=Struct('length' / Byte, 'kind' / Byte), size=this.length + 3,\n"
        "                   max_size=64, check=Sum())\n"
        "packet('One', match={'kind': 1}, payload=Struct('a' / Byte, Const(7, Byte)))\n"
    )
    log = tmp_path / "x.bin"
    log.write_bytes(bytes.fromhex("A5 03 05 09 07 18  A5 03 01 09 08 15  A5 03 01 09 06 13"))
    result = aces("decode", "-p", tmp_path / "spec.py", log)
    assert [line.split()[:2] for line in result.out.splitlines()[-3:]] == [
        ["0", "unknown"],
        ["6", "unknown"],
        ["12", "unknown"],
    ]
    said = [line for line in result.err.splitlines() if "its head is right" in line]
    assert said == [
        "aces: unknown, though its head is right: packet at offset 6. One: byte 4 07, not 08 (more: aces spec explain)"
    ]


def test_packets_with_half_an_end_are_named(aces: Aces, tmp_path: Path) -> None:
    """A text whose CR LF became LF decodes to nothing, and why is said; other bytes are not taken for that."""
    spec = tmp_path / "lines.py"
    spec.write_text(
        "from construct import *\nfrom aces_bus.protocol import *\nlines = Protocol('lines', link='serial')\n"
        "packet = lines.framing(sync=b'#', end=b'\\r\\n', max_size=20)\npacket('Line', payload=Struct('x' / Text(4)))\n"
    )
    (tmp_path / "log.txt").write_bytes(3 * b"#1234\n")
    (tmp_path / "other.bin").write_bytes(b"\x00\x01\x02" * 40)
    said = (
        "Packets of lines end with 0D 0A, and here is 0A 3 times without 0D before it (unix2dos puts it back)"
    )
    assert said in aces("decode", tmp_path / "log.txt", "-p", spec).err
    assert "Packets of" not in aces("decode", tmp_path / "other.bin", "-p", spec).err
    sentence = bytes(load_protocol("nmea0183")["ZDA"].examples[0].packet.image)
    (tmp_path / "gnss.txt").write_bytes(3 * sentence.replace(b"\r\n", b"\n"))
    assert "records=3" in aces("decode", tmp_path / "gnss.txt", "-p", "nmea0183").err
