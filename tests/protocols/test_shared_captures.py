"""Real recordings give exactly what is known to be in them, however their bytes arrive.

1. What is known comes from `expected.json`, made by another program than ours.
2. Behind junk that looks like packets nothing is known; there the reference interpreter is the truth.
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus import Unknown, as_dict, make_scanner, open_recording
from aces_bus.protocol import Protocol
from aces_bus.protocol.counts import ScanCounts
from aces_bus.protocol.reference import Reference
from aces_protocols.minihubo_adc.spec import minihubo_adc
from aces_protocols.robotis.spec import robotis

pytestmark = pytest.mark.shared

ROBOTIS = [
    "ctrl_tbl_read.from-servo.bin",
    "ctrl_tbl_read.from-servo.dxconf.txt",
    "ctrl_tbl_read.from-servo.with-newlines.bin",
    "ctrl_tbl_read.to-servo.bin",
    "id12_ctrl_tbl_read.to-servo.bin",
    "positioning.from-servo.bin",
    "positioning.to-servo.dxconf.txt",
    "positioning.to-servo.truncated.bin",
]
FILES = [f"robotis/{name}" for name in ROBOTIS] + ["adc/minihubo_adc_part1.bin"]
#: Offset, message and fields of a record.
Found = tuple[int, str, Mapping[str, Any]]
INSTRUCTIONS = {2: "Read", 3: "Write"}


@dataclass(frozen=True)
class Known:
    """A recording's bytes and what is in them: records as (offset, message, fields), bytes lost by reason."""

    protocol: Protocol
    direction: Literal["to device", "from device"]
    data: bytes
    records: tuple[Found, ...]
    skipped: frozenset[int]
    pending: int


@pytest.fixture(scope="module")
def known(shared_captures: Path) -> Mapping[str, Known]:
    """Every recording, by name."""
    expected = json.loads((shared_captures / "expected.json").read_text(encoding="utf-8"))
    listed = {name for name in expected if name.startswith(("robotis/", "adc/"))}
    assert listed == set(FILES), "the recordings have changed: adapt this test"
    return {name: _known(shared_captures / name, expected[name]) for name in FILES}


def _known(path: Path, expected: Mapping[str, Any]) -> Known:
    if "adc" in expected:
        return _known_adc(path.read_bytes(), expected["adc"])
    described = expected.get("dynamixel1") or expected["dxconf_hexdump"]
    data = _bytes_of(path)
    assert len(data) == described.get("hexdump_bytes", expected["bytes"])
    is_status = described["direction"] == "status"
    records: list[Found] = []
    for packet in described["packets"]:
        params = bytes.fromhex(packet["params"])
        code = packet["instruction_or_error"]
        assert packet["checksum_ok"]
        assert packet["length"] == len(params) + 2
        if is_status:
            name, fields = "Status", {"error": code, "parameters": params}
        elif INSTRUCTIONS[code] == "Read":
            name, fields = "Read", {"start": params[0], "count": params[1]}
        else:
            name, fields = "Write", {"start": params[0], "data": params[1:]}
        records.append((packet["offset"], name, {"id": packet["id"], **fields}))
    return Known(
        robotis,
        "from device" if is_status else "to device",
        data,
        tuple(records),
        frozenset(described["junk_offsets"]),
        len(bytes.fromhex(described["incomplete_tail"])),
    )


def _known_adc(data: bytes, expected: Mapping[str, Any]) -> Known:
    # The file says how many frames there are and where the first begins; they stand one behind the other.
    start, count = expected["leading_bytes_to_skip"], expected["triplets"]
    frames = [data[at : at + 8] for at in range(start, start + 8 * count, 8)]
    values = [tuple(int.from_bytes(frame[i : i + 2], "big") for i in (2, 4, 6)) for frame in frames]
    assert [list(values[0]), list(values[-1])] == [expected["first"], expected["last"]]
    assert [sum(column) for column in zip(*values, strict=True)] == expected["channel_sum"]
    records = tuple((start + 8 * i, "Sample", {"channels": list(v)}) for i, v in enumerate(values))
    pending = expected["trailing_incomplete_bytes"]
    return Known(minihubo_adc, "from device", data, records, frozenset(range(start)), pending)


def _bytes_of(path: Path) -> bytes:
    capture = open_recording(path, link="serial")
    data = b"".join(chunk.data for chunk in capture)
    assert capture.lines_unreadable == 0
    return data


@dataclass
class Read:
    """What a scanner found: records, the reason of each lost byte by offset, and its counts."""

    records: list[Found]
    lost: dict[int, str]
    counts: ScanCounts


def read(known: Known, chunks: Iterable[bytes]) -> Read:
    scanner: Any = make_scanner([known.protocol.variant()], direction=known.direction, include_unknown=True)
    found: list[Any] = [item for chunk in chunks for item in scanner.feed(chunk)] + scanner.close()
    records: list[Found] = []
    lost: dict[int, str] = {}
    at = 0
    for item in found:
        start, at = at, at + item.meta.size
        assert item.meta.offset == start, "records and losses leave no byte out and come in order"
        if isinstance(item, Unknown):
            lost.update(dict.fromkeys(range(start, at), item.reason))
        else:
            records.append((start, type(item).__name__, as_dict(item)))
    assert scanner.counts.balance == 0
    assert (scanner.counts.total, scanner.counts.records) == (at, len(records))
    return Read(records, lost, scanner.counts)


def agrees(known: Known, chunks: Iterable[bytes], *, junk: int = 0) -> None:
    """The chunks give what is known, `junk` bytes later, and the junk is skipped."""
    found = read(known, chunks)
    assert found.records == [(at + junk, name, fields) for at, name, fields in known.records]
    end = junk + len(known.data)
    skipped = {*range(junk), *(at + junk for at in known.skipped)}
    assert found.lost == {
        **dict.fromkeys(skipped, "skipped"),
        **dict.fromkeys(range(end - known.pending, end), "pending"),
    }
    assert (found.counts.skipped, found.counts.pending) == (len(skipped), known.pending)
    assert (found.counts.malformed, found.counts.unknown) == (0, 0)


def cut(data: bytes, cuts: Iterable[int]) -> Iterator[bytes]:
    edges = [0, *sorted(c % (len(data) + 1) for c in cuts), len(data)]
    return (data[a:b] for a, b in pairwise(edges))


IS_LONG = settings().max_examples > 100
#: For tests that read a whole recording for each example.
few = settings() if IS_LONG else settings(max_examples=4)
every_file = pytest.mark.parametrize("name", FILES)


@every_file
def test_whole(known: Mapping[str, Known], name: str) -> None:
    """A recording read at once gives exactly its packets, offsets, values and skipped bytes."""
    agrees(known[name], [known[name].data])


@every_file
def test_byte_by_byte(known: Mapping[str, Known], name: str) -> None:
    """A recording that arrives in single bytes gives the same."""
    agrees(known[name], (bytes([b]) for b in known[name].data))


@every_file
@few
@given(cuts=st.lists(st.integers(0, 1 << 20), max_size=40))
def test_in_random_chunks(known: Mapping[str, Known], name: str, cuts: list[int]) -> None:
    """A recording that arrives in any chunks gives the same."""
    agrees(known[name], cut(known[name].data, cuts))


@every_file
@few
@given(
    junk=st.binary(max_size=300).map(lambda b: b.replace(b"\xff", b"\xfe")),
    cuts=st.lists(st.integers(0, 1 << 20), max_size=10),
)
def test_behind_junk_without_ff(known: Mapping[str, Known], name: str, junk: bytes, cuts: list[int]) -> None:
    """Junk that cannot begin a packet is skipped, to the byte, and costs no packet behind it."""
    agrees(known[name], cut(junk + known[name].data, cuts), junk=len(junk))


#: Junk that looks like packets: headers, small lengths, and pieces of real ones.
looks_real = st.lists(
    st.one_of(
        st.binary(max_size=6),
        st.sampled_from(
            [b"\xff", b"\xff\xff", b"\xff\xff\xff", b"\xff\xff\x01\x02", b"\xff\xff\x01\x34\x00"]
        ),
        st.integers(2, 40).map(lambda n: bytes([0xFF, 0xFF, 1, n])),
        st.sampled_from([b"\xff\xff\x01\x02\x00\xfc", b"\xff\xff\x01\x02\x00\xfd", b"\xff\xff\x01\xff"]),
    ),
    max_size=12,
).map(b"".join)


def plain(value: Any) -> Any:
    """construct's containers without its own entries."""
    if isinstance(value, Mapping):
        pairs = cast("Mapping[str, Any]", value)
        return {name: plain(inner) for name, inner in pairs.items() if not name.startswith("_")}
    if isinstance(value, list):
        items: list[Any] = value
        return [plain(inner) for inner in items]
    return value


def equals_reference(known: Known, data: bytes, cuts: Iterable[int]) -> None:
    found = read(known, cut(data, cuts))
    records: list[Found] = []
    lost: dict[int, str] = {}
    for item in Reference([known.protocol.variant()], direction=known.direction).stream(data):
        if item.message is None:
            lost.update(dict.fromkeys(range(item.offset, item.offset + item.size), item.reason))
        else:
            assert item.fields is not None
            records.append((item.offset, item.message, plain(item.fields)))
    assert found.records == records
    assert found.lost == lost


@every_file
@given(junk=looks_real, cuts=st.lists(st.integers(0, 1 << 20), max_size=10), end=st.integers(0, 400))
def test_behind_any_junk(
    known: Mapping[str, Known], name: str, junk: bytes, cuts: list[int], end: int
) -> None:
    """Behind any junk, however cut and wherever broken off, scanner and reference interpreter find the same."""
    equals_reference(known[name], junk + known[name].data[:end], cuts)


@every_file
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_whole_recording_behind_junk(known: Mapping[str, Known], name: str, seed: int) -> None:
    """The same for whole recordings, behind junk drawn from a seed."""
    rng = random.Random(seed)
    junk = bytes(rng.choice([0xFF, 0xFF, 1, 2, 5, rng.randrange(256)]) for _ in range(200))
    data = junk + known[name].data
    equals_reference(known[name], data, [rng.randrange(len(data)) for _ in range(20)])


@every_file
@given(start=st.integers(0, 1 << 20), at=st.integers(0, 599), value=st.integers(0, 255))
def test_a_damaged_recording(known: Mapping[str, Known], name: str, start: int, at: int, value: int) -> None:
    """With any byte damaged, scanner and reference interpreter still find the same."""
    data = known[name].data
    start %= max(1, len(data) - 600)
    damaged = bytearray(data[start : start + 600])
    damaged[at % len(damaged)] = value
    equals_reference(known[name], bytes(damaged), [at])
