"""What a malicious or broken sender can do to a scanner: cost time in proportion to what it sends, and nothing else.

Work is counted, not timed: the calls of Python functions. Twice the input may cost twice as many.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pytest
from hypothesis import settings

from aces_bus import Frame, make_column_scanner, make_scanner
from aces_bus.protocol import CanScanner, Variant
from aces_bus.protocol.declare.framing import Framing
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.testing.scenes import Way
from tests.counting import calls
from tests.laws.corners import CORNERS
from tests.laws.drawn import wires_of
from tests.laws.wires import PROTOCOLS, REGISTERED

#: Bytes of a stream, and frames of a bus, that are sent once and twice.
LEAST_BYTES, MOST_BYTES, FRAMES = (300, 800, 200) if settings().max_examples > 100 else (150, 350, 60)
#: Twice the input may cost so much more than twice the work: the ends of a stream are not its middle.
MARGIN = 1.15
#: Bytes a chunk.
CHUNK = 61


def wires(link: str) -> list[tuple[Variant, Way]]:
    """Every registered protocol in every dialect and direction that has framings of its own; of the others one."""
    found: list[tuple[Variant, Way]] = []
    for name, protocol in PROTOCOLS.items():
        if protocol.link == "can" and link == "can":
            found += wires_of(protocol)[: 2 if name in REGISTERED or name in CORNERS else 1]
        elif protocol.link != "can" and link != "can":
            wires = wires_of(protocol)[: None if name in REGISTERED else 1]
            # The first of each set of framings: what is sent is made of them alone.
            first: dict[Any, tuple[Variant, Way]] = {
                frozenset(m.framing for m in variant.messages_for(way)): (variant, way)
                for variant, way in reversed(wires)
            }
            found += first.values()
    return found


def labelled(value: object) -> str:
    return value.label if isinstance(value, Variant) else str(value or "any").replace(" ", "_")


# ---------------------------------------------------------------------- what is sent


def _header(framing: Framing, length: int | None) -> bytes:
    """The first bytes of a packet, with the length that is promised."""
    head = bytearray(framing.sync)
    for part in framing.heads:
        head += bytes(part.size)
    if framing.affine is not None and length is not None:
        field = framing.affine.length
        most = min(
            (1 << 8 * field.size) - 1, (framing.max_size - framing.affine.constant) // framing.affine.factor
        )
        head[field.offset : field.offset + field.size] = field.bytes(max(0, min(length, most)))
    return bytes(head) or b"\0"


def streams(framing: Framing, size: int) -> Iterator[tuple[str, bytes]]:
    """Streams that are dear to read."""

    def filled(unit: bytes) -> bytes:
        return (unit * (size // len(unit) + 1))[:size]

    mark = framing.sync or framing.end or b"\0"
    yield "headers alone", filled(_header(framing, 1))
    yield "longest lengths", filled(_header(framing, 1 << 30))
    yield "nested headers", filled(b"".join(_header(framing, n) for n in (40, 30, 20, 10, 5, 0)))
    yield "sync bytes", filled(mark)
    yield "halves of a sync", filled(mark[:1] + b"\x01")
    yield "end marks", filled((framing.end or b"\n") + mark)
    yield "escapes", filled(b"\xdb\xdd\x7d\x5d\x00\xfd")


def hostile(framings: Sequence[Framing]) -> list[tuple[str, bytes]]:
    """Different streams for all framings, each of an even number of bytes: some times the longest packet."""
    longest = max(framing.max_size for framing in framings)
    size = 2 * min(max(4 * longest, LEAST_BYTES), MOST_BYTES)
    found = {data: f"{name}, {framing}" for framing in framings for name, data in streams(framing, size)}
    return [(name, data) for data, name in found.items()]


# ---------------------------------------------------------------------- how much it costs


def fed(scanner: StreamScanner, data: bytes) -> None:
    """All of a stream in chunks; what is held stays bounded, and every byte has its bin."""
    for at in range(0, len(data), CHUNK):
        scanner.feed(data[at : at + CHUNK])
        assert scanner.buffered <= scanner.max_size
    scanner.close()
    assert scanner.counts.balance == 0
    assert scanner.counts.total == len(data)


@pytest.mark.parametrize(("variant", "direction"), wires("serial"), ids=labelled)
def test_a_hostile_stream_costs_in_proportion(variant: Variant, direction: Way) -> None:
    """Headers without an end, promises of length, sync bytes in a row: calls double with the bytes; checks have law 7."""
    scanner = make_scanner([variant], direction=direction)
    assert isinstance(scanner, StreamScanner)
    for name, data in hostile(scanner.framings):
        work: list[int] = []
        for part in (data[: len(data) // 2], data):
            scanner.reset()
            work.append(calls(lambda part=part: fed(scanner, part)))  # type: ignore[misc]
        assert work[1] <= 2 * MARGIN * work[0] + 400, (name, work)


@pytest.mark.parametrize(("variant", "direction"), wires("serial"), ids=labelled)
def test_a_hostile_stream_reads_the_same_as_columns(variant: Variant, direction: Way) -> None:
    """A column scanner takes the same streams, in one piece, and counts them as the live one does."""
    live = make_scanner([variant], direction=direction)
    assert isinstance(live, StreamScanner)
    for name, data in hostile(live.framings):
        live.reset()
        live.feed(data)
        live.close()
        columnar: Any = make_column_scanner([variant], direction=direction)
        columnar.feed(data)
        columnar.close()
        assert (columnar.counts.total, columnar.counts.reasons) == (len(data), live.counts.reasons), name


# ---------------------------------------------------------------------- frames


def floods(variant: Variant, count: int) -> Iterator[tuple[str, list[Frame]]]:
    """Frames that are dear to read."""
    asked = [m for m in variant.messages.values() if m.identifier.captures or m.identifier.constant]
    known = [m.identifier.constant for m in asked] or [1]
    extended = [m.extended for m in asked] or [False]
    yield "every identifier", [Frame(n % FRAMES * 7 & 0x7FF, bytes(8), timestamp=0.0) for n in range(count)]
    yield (
        "extended ones",
        [
            Frame(n % FRAMES * 7919 & 0x1FFFFFFF, bytes(8), is_extended_id=True, timestamp=0.0)
            for n in range(count)
        ],
    )
    yield (
        "remote requests",
        [
            Frame(
                known[n % len(known)],
                b"",
                is_remote_frame=True,
                is_extended_id=extended[n % len(known)],
                dlc=n % 9,
            )
            for n in range(count)
        ],
    )
    yield (
        "requests that nobody answers",
        [
            Frame(
                known[n % len(known)],
                bytes([n & 0xFF, n >> 8 & 0xFF] * 4),
                is_extended_id=extended[n % len(known)],
            )
            for n in range(count)
        ],
    )
    yield (
        "channels without end",
        [
            Frame(
                known[n % len(known)],
                bytes([n & 0xFF] * 8),
                channel=f"can{n}",
                is_extended_id=extended[n % len(known)],
            )
            for n in range(count)
        ],
    )


@pytest.mark.parametrize(("variant", "direction"), wires("can"), ids=labelled)
def test_a_flood_of_frames_costs_in_proportion(variant: Variant, direction: Way) -> None:
    """Identifiers, remote frames, requests and channels without end: twice the frames, twice the calls."""
    scanner = make_scanner([variant], direction=direction)
    assert isinstance(scanner, CanScanner)
    for name, frames in floods(variant, 2 * FRAMES):
        work: list[int] = []
        scanner.feed(frames)  # tables of what was met are made once
        for part in (frames[:FRAMES], frames):
            scanner.reset()
            work.append(calls(lambda part=part: scanner.feed(part)))  # type: ignore[misc]
            assert scanner.counts.balance == 0
            assert scanner.counts.total == len(part)
        assert work[1] <= 2 * MARGIN * work[0] + 400, (name, work)
