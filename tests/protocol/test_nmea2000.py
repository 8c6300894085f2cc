"""Fast packets of real boats: canboat's golden files, put together as canboat does it."""

from __future__ import annotations

import re
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import pytest
from construct import GreedyBytes, Struct

from aces_bus import Frame, FrameTable, Unknown, decode
from aces_bus.protocol import FastPacket, IdField, Protocol

#: The fast packets among the golden files' parameter groups.
FAST = (126208, 126720, 129029, 130817, 130823)


def boat() -> Protocol:
    """Any parameter group: its bytes."""
    protocol = Protocol("boat", link="can")
    fast = FastPacket()
    priority, source, destination = (
        IdField(n, range(k)) for n, k in (("priority", 8), ("source", 254), ("to", 256))
    )
    for group in (*FAST, 130311):
        is_addressed = group >> 8 & 0xFF < 240
        pattern = priority << 26 | group << 8 | source
        protocol.message(
            f"Group{group}",
            transport=fast if group in FAST else None,
            id=pattern | destination << 8 if is_addressed else pattern,
            extended=True,
            payload=Struct("data" / GreedyBytes),
        )
    return protocol


def cases_of(path: Path) -> list[list[Frame]]:
    """The cases of a file of canboat's, frames each: time, priority, group, source, destination, length, bytes."""
    found: list[list[Frame]] = [[]]
    for line in path.read_text().splitlines():
        if line.startswith("#"):
            continue
        if not line:
            found.append([])
            continue
        time, *numbers, text = line.split(",", 6)
        priority, group, source, to, size = map(int, numbers)
        to = to if group >> 8 & 0xFF < 240 else 0
        stamp = datetime.strptime(time, "%Y-%m-%d-%H:%M:%S.%f").replace(tzinfo=UTC).timestamp()
        data = bytes.fromhex(text.replace(",", " "))[:size]
        found[-1].append(Frame(priority << 26 | (group | to) << 8 | source, data, stamp, is_extended_id=True))
    return [case for case in found if case]


@pytest.mark.shared
@pytest.mark.parametrize(("name", "refused"), [("recombine-frames", [5]), ("pgn-126208-request-130817", [])])
def test_golden_files_of_canboat(name: str, refused: list[int], shared_captures: Path) -> None:
    """The packets, their order and their bytes are those that canboat prints; so are they in columns.

    One we refuse: a frame of it came before its first one, and may be of the packet before, which lacks one. canboat joins
    the two; what fits by chance would be wrong data.
    """
    folder = shared_captures / "nmea2000"
    protocol = boat()
    lines = (folder / f"{name}.out").read_text().splitlines()
    wanted = [(int(m[1]), line) for line in lines if (m := re.search(r'(?:"pgn":| 255 )(\d+)', line))]
    wanted = [one for number, one in enumerate(wanted) if number not in refused]
    given = []
    for frames in cases_of(folder / f"{name}.in"):
        scanner = protocol.scanner(include_unknown=True)
        records = [one for one in scanner.feed(frames) if not isinstance(one, Unknown)]
        given += records
        decoded = decode(FrameTable.from_frames(frames), protocol)
        scanner.close()
        assert sum(map(len, decoded.values())) == len(records)
        assert decoded.counts == scanner.counts
    assert [int(type(one).__name__.removeprefix("Group")) for one in given] == [group for group, _ in wanted]
    for record, (_, line) in zip(given, wanted, strict=True):
        at = 0
        for text in re.findall(r'\(bytes = "([0-9A-F ]+)"\)', line):  # fields of whole bytes
            at = record.data.index(bytes.fromhex(text), at)


@pytest.mark.slow
@pytest.mark.shared
def test_what_is_lost_in_them_is_said(shared_captures: Path) -> None:
    """Frames of packets that lack one are malformed; canboat is silent about them."""
    reasons: Counter[str] = Counter()
    for frames in cases_of(shared_captures / "nmea2000" / "recombine-frames.in"):
        scanner = boat().scanner(include_unknown=True)
        reasons.update(
            one.reason for one in scanner.feed(frames) + scanner.close() if isinstance(one, Unknown)
        )
    assert reasons == {
        "malformed: frame 2 of 7 missing": 6,  # begun anew
        "malformed: repeated": 1,  # its third frame, once more
        "pending": 6,  # the one behind it, whose third frame came before its first
        "malformed: no first frame": 6,  # the first frame was lost
    }


@pytest.mark.shared
def test_a_short_first_frame(shared_captures: Path) -> None:
    """canboat fills what is missing with FF and decodes it; we say that a frame is short, and decode nothing."""
    (frames,) = cases_of(shared_captures / "nmea2000" / "short-frame.in")
    scanner = boat().scanner(include_unknown=True)
    assert [one.reason for one in scanner.feed(frames) if isinstance(one, Unknown)] == [
        "malformed: first frame is short",
        "malformed: no first frame",
    ]
