"""Packets of transports as columns are those of the live scanner, in long and bad recordings."""

from __future__ import annotations

import random
from collections.abc import Iterator

import numpy as np
import pytest
from construct import Byte, GreedyBytes, Struct
from msgspec.structs import replace

from aces_bus import Frame, FrameTable, make_column_scanner
from aces_bus.protocol import (
    FastPacket,
    IdField,
    IsoTp,
    J1939Transport,
    Protocol,
    SdoTransfer,
    TailByte,
    Transport,
)
from aces_bus.protocol.columns.key_numbers import KeyNumbers, few_keys
from aces_bus.protocol.live.reassemble import Reassembler
from aces_bus.testing import Scene
from aces_bus.testing.columns import columns_difference
from aces_bus.testing.trial import reference_items, scanned_items

WHO = IdField("who", range(4))
EXTENDED = IdField("priority", range(8)) << 26
TRANSPORTS: dict[str, tuple[Transport, object, bool]] = {
    "ISO-TP": (IsoTp(max_size=4095), 0x600 + WHO, False),
    "ISO-TP, padded": (IsoTp(pad=0xCC, timeout_s=0.3), 0x600 + WHO, False),
    "ISO-TP, extended addresses": (IsoTp(addressing="extended"), 0x600 + WHO, False),
    "ISO-TP, CAN FD": (IsoTp(fd=True), 0x600 + WHO, False),
    "fast packets": (FastPacket(timeout_s=0.3), EXTENDED | 0x1F80100 | WHO, True),
    "fast packets, unpadded": (FastPacket(pad=None), EXTENDED | 0x1F80100 | WHO, True),
    "DroneCAN": (TailByte(version=0, max_size=300), EXTENDED | 0x1F80100 | WHO, True),
    "Cyphal": (TailByte(version=1, max_size=300), EXTENDED | 0x1F80100 | WHO, True),
    "Cyphal, CAN FD": (TailByte(version=1, fd=True, max_size=300), EXTENDED | 0x1F80100 | WHO, True),
    "J1939, to all": (J1939Transport(timeout_s=0.3), EXTENDED | 0xFECA << 8 | WHO, True),
    "J1939, to one": (J1939Transport(), EXTENDED | 0xEF0700 | WHO, True),
    "SDO": (SdoTransfer(max_size=400), 0x600 + IdField("who", range(1, 5)), False),
}


def protocol_of(name: str) -> Protocol:
    """A protocol whose one message is any packet, but for SDO, where packets begin with a command."""
    transport, identifier, is_extended = TRANSPORTS[name]
    protocol = Protocol("packets", link="can")
    protocol.message(
        "Packet",
        transport=transport,
        id=identifier,
        extended=is_extended,
        payload=Struct("head" / Byte, "data" / GreedyBytes),
        check_extra=bytes(range(8)) if name == "DroneCAN" else b"",
    )
    return protocol


def packets(protocol: Protocol, name: str, who: int, source: random.Random) -> Iterator[Frame]:
    """Frames of a sender, packet behind packet, of many sizes."""
    transport, encoder = TRANSPORTS[name][0], protocol.variant().encoder
    most = min(transport.max_size, 250) - 5
    while True:
        head, size = 7, source.choice((3, 5, 6, 7, 12, 13, 20, 20, 20, 61, most))
        if name == "SDO":
            head, size = source.choice(((0x21, size + 3), (0x20, size + 3), (0x23, 7)))
        while not transport.carries(size + 1) or (name == "J1939, to one" and size < 8):
            size += 1
        data = source.randbytes(size)
        more = {"priority": 2 + who} if TRANSPORTS[name][2] else {}
        for frame in encoder.next("Packet", who=who, head=head, data=data, **more):
            yield Frame(
                frame.arbitration_id,
                bytes(frame.data),
                is_extended_id=frame.is_extended_id,
                is_fd=frame.is_fd,
            )


def recording(protocol: Protocol, name: str, source: random.Random, faults: float) -> list[Frame]:
    """Frames of three senders in turn; so many are lost, repeated, late, swapped, cut short, or broken."""
    senders = [packets(protocol, name, who, source) for who in (1, 2, 3)]
    frames: list[Frame] = []
    time = 0.0
    while len(frames) < 500:
        frame = next(source.choice(senders))
        time += 0.001
        frames.append(changed(frame, time))
        fault = source.random() / faults if faults else 7
        if fault < 1:
            frames.pop()
        elif fault < 2:
            frames.append(frames[-1])
        elif fault < 3:
            time += 0.4
        elif fault < 4 and len(frames) > 1:
            frames[-2:] = frames[:-3:-1]
        elif fault < 5:
            data = bytearray(frame.data)
            data[source.randrange(len(data))] ^= 1 << source.randrange(8)
            frames.append(changed(frame, time, bytes(data)))
        elif fault < 6:
            frames.append(changed(frame, time, source.randbytes(source.choice((0, 1, 2, 7, 8)))))
        elif fault < 7:
            frames[-1] = changed(frame, time, frame.data[: source.randrange(min(9, len(frame.data)))])
    return frames


def changed(frame: Frame, time: float, data: bytes | None = None) -> Frame:
    return replace(frame, timestamp=time, data=frame.data if data is None else data)


@pytest.mark.parametrize("faults", [0, 0.01, 0.1])
@pytest.mark.parametrize("name", TRANSPORTS)
def test_columns_are_the_live_packets(name: str, faults: float) -> None:
    """Whole and broken packets alike, in pieces of any size."""
    source = random.Random(f"{name} {faults}")
    protocol = protocol_of(name)
    frames = recording(protocol, name, source, faults)
    cuts = sorted(source.randrange(len(frames)) for _ in range(source.randrange(4)))
    live = protocol.scanner(include_unknown=True)
    variant = protocol.variant()
    assert columns_difference(variant, "both", Scene(frames), cuts, live, False, True) == ""
    assert scanned_items(protocol.scanner(include_unknown=True, raw=True), Scene(frames)) == reference_items(
        variant, "both", Scene(frames)
    )


def test_the_last_frame_is_short_by_number_not_by_arrival() -> None:
    """Columns refuse a fast packet whose short frame arrives last and is not the last one, as live and reference do."""
    protocol = protocol_of("fast packets, unpadded")
    first, second, third = next_packet(protocol, 14)
    padded = changed(third, 0.0, third.data.ljust(8, b"\xff"))
    frames = [first, padded, changed(second, 0.0, second.data[:7])]
    scanner = make_column_scanner([protocol.variant()], include_unknown=True)
    (losses,) = [*scanner.feed(FrameTable.from_frames(frames)), *scanner.close()]
    assert losses["reason"].to_list() == ["malformed: frame 2 of 3 is short"] * 3
    frames = [first, changed(third, 0.0, third.data[:2]), second]
    live = protocol.scanner(include_unknown=True)
    assert columns_difference(protocol.variant(), "both", Scene(frames), [], live, False, True) == ""
    assert live.counts.records == 1


def next_packet(protocol: Protocol, size: int) -> list[Frame]:
    made = protocol.variant().encoder.next("Packet", who=1, head=7, data=bytes(range(size - 1)), priority=3)
    return [Frame(one.arbitration_id, bytes(one.data), 0.0, is_extended_id=True) for one in made]


@pytest.mark.parametrize("name", TRANSPORTS)
def test_what_is_without_fault_is_made_in_columns(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not one frame goes through the live reassembler."""
    source = random.Random(name)
    protocol = protocol_of(name)
    frames = recording(protocol, name, source, 0)
    scanner = make_column_scanner([protocol.variant()])
    with monkeypatch.context() as patched:
        patched.setattr(Reassembler, "take", None)
        count = sum(
            len(table)
            for half in (frames[:300], frames[300:])
            for table in scanner.feed(FrameTable.from_frames(half))
        )
    assert (scanner.counts.malformed, scanner.counts.unknown) == (0, 0)
    assert count == len(protocol.scanner().feed(frames)) > 30


def test_keys_have_numbers_of_their_own() -> None:
    """However many come, in whatever order; a key keeps its number."""
    source = np.random.default_rng(7)
    numbers, known = KeyNumbers(), dict[int, int]()
    for count in (1, 3, 40, 5_000):
        keys = source.integers(0, 1 << 32, count, np.uint32).repeat(3)
        source.shuffle(keys)
        places = numbers.places(keys)
        assert places.max() < numbers.room
        assert len(np.unique(places)) == len(np.unique(keys))
        for key, number in zip(keys.tolist(), numbers.of(keys).tolist(), strict=True):
            assert known.setdefault(key, number) == number
    assert sorted(known.values()) == list(range(len(known)))


@pytest.mark.parametrize("bits", [(0, 0), (0, 8), (3, 5), (21, 8), (24, 8)])
def test_keys_that_differ_in_few_bits_are_told_apart_by_them(bits: tuple[int, int]) -> None:
    """A number says the key; more than eight bits are too many."""
    shift, width = bits
    few = np.arange(1 << width, dtype=np.uint32)[:: max(1, (1 << width) - 3)]
    keys = (np.uint32(0x1F00_0000 if shift < 20 else 0x123) | few << np.uint32(shift)).repeat(2)
    found = few_keys(keys)
    assert found is not None
    assert (found.keys[found.numbers] == keys).all()
    assert found.present().tolist() == np.unique(keys).tolist()
    assert few_keys(np.array([0x100, 0x001], np.uint32)) is None
