"""CAN columns across processes: pieces decoded apart, put together as if by one."""

from __future__ import annotations

import pickle
import random
from collections.abc import Iterable
from typing import Any

import pytest
from construct import Byte, Bytes, Const, Int16sl, Struct
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, Unknown, load_protocol, make_scanner
from aces_bus.protocol import CanScanner, Counter, IdField, Protocol, Variant
from aces_bus.protocol.columns.can import CanColumns
from aces_bus.protocol.columns.table import MessageTable


def flat(tables: Iterable[MessageTable]) -> list[Any]:
    """Every line of every table, in the order of the capture."""
    lines: list[Any] = []
    for table in tables:
        columns = {column.name: column.to_list() for column in table.columns()}
        for line, row in enumerate(table.row.tolist()):
            time, key, rx = int(table.time[line]), int(table.key[line]), int(table.rx[line])
            channel = table.channels.names[table.channel[line]]
            values = {name: values[line] for name, values in columns.items()}
            lines.append((row, table.message, time, channel, key, rx, values))
    return sorted(lines, key=lambda line: line[0])


def apart(variant: Variant, table: FrameTable, cuts: list[int]) -> tuple[list[Any], Any]:
    """The same from pieces, each decoded by a scanner of its own that hands over through a pipe."""
    whole = CanColumns([variant], include_unknown=True)
    lines: list[Any] = []
    first = 0
    for start, end in zip([0, *cuts], [*cuts, len(table)], strict=True):
        piece = CanColumns([variant], include_unknown=True, defer=True)
        own = flat(piece.feed(table.take(slice(start, end))))
        given_over = pickle.loads(pickle.dumps(piece.hand_over()))
        lines += [(row + first, *rest) for row, *rest in own] + flat(whole.adopt(given_over))
        first += end - start
    return sorted(lines, key=lambda line: line[0]), whole.counts


def hubo_traffic(seed: int, count: int) -> FrameTable:
    """Requests, replies, other frames, losses and errors on two channels."""
    rng = random.Random(seed)
    variant = load_protocol("hubo").variant()
    encode = variant.encoder.encode
    frames: list[Frame] = []
    for number in range(count):
        time, channel = 1e9 + number / 1000, rng.choice(["can0", "can1"])
        kind = rng.randrange(6)
        if kind == 0:
            made = encode("GetParameters", board=3, selector=rng.choice([1, 4, 7]))
        elif kind == 1:
            made = encode("Encoder", board=3, position=(rng.randrange(-999, 999), 4))
        elif kind == 2:
            frames.append(Frame(0x1C3, rng.randbytes(8), time, channel))
            continue
        elif kind == 3:
            frames.append(Frame(rng.randrange(0x800), rng.randbytes(rng.randrange(9)), time, channel))
            continue
        elif kind == 4:
            frames.append(Frame(4, bytes(8), time, channel, is_error_frame=True))
            continue
        else:
            made = encode("SendEncoder", board=3, selector="normal")
        frames.append(
            Frame(made.arbitration_id, bytes(made.data), time, channel, is_rx=rng.choice([True, None]))
        )
    return FrameTable.from_frames(frames)


@pytest.mark.slow
@given(st.integers(0, 10_000), st.lists(st.integers(0, 60), max_size=4).map(sorted))
def test_pieces_decoded_apart_are_the_capture(seed: int, cuts: list[int]) -> None:
    """Replies find their requests across the borders of pieces; losses and counts are those of one scanner."""
    variant = load_protocol("hubo").variant()
    table = hubo_traffic(seed, 60)
    one = CanColumns([variant], include_unknown=True)
    expected = flat(one.feed(table))
    assert len(expected) == len(table)
    lines, counts = apart(variant, table, cuts)
    assert lines == expected
    assert counts == one.counts


def asking() -> Protocol:
    """Commands of one identifier, told apart by their first byte; one of them asks for a value."""
    protocol = Protocol("asking", link="can")
    ask = protocol.message(
        "Ask", id=0x10, direction="to device", payload=Struct(Const(b"\x01"), "which" / Byte)
    )
    protocol.message("Go", id=0x10, direction="to device", payload=Struct(Const(b"\x02"), "speed" / Int16sl))
    protocol.message("Beep", id=0x10, direction="to device", payload=Struct(Const(b"\x03")))
    for which, (name, payload) in enumerate({"Value": Int16sl, "Text": Bytes(2)}.items()):
        reply = ask.where(which=which)
        protocol.message(
            name, id=0x20, direction="from device", reply_to=reply, payload=Struct("it" / payload)
        )
    return protocol


_COMMANDS = st.tuples(st.sampled_from((0x10, 0x10, 0x20)), st.integers(0, 4), st.binary(max_size=3))


@given(st.lists(_COMMANDS, max_size=40))
def test_only_requests_of_a_shared_identifier_are_decided_one_by_one(
    some: list[tuple[int, int, bytes]],
) -> None:
    """Commands beside them are decoded as columns; values and losses are those of the live scanner."""
    variant = asking().variant()
    table = FrameTable.from_frames(
        [Frame(key, bytes([kind]) + more, 1.0, "can0") for key, kind, more in some]
    )
    one = CanColumns([variant], direction="both", include_unknown=True)
    live = CanScanner([variant], direction="both", include_unknown=True)
    lines = flat(one.feed(table))
    assert [name for _, name, *_ in lines] == [
        "" if isinstance(item, Unknown) else type(item).__name__ for item in live.feed(table.frames())
    ]
    assert one.counts == live.counts

    piece = CanColumns([variant], direction="both", defer=True)
    piece.feed(table)
    left = [row for _, rows in piece.hand_over().deferred for row in rows.tolist()]
    asked = [row for row, name, *_ in lines if name == "Ask"]
    assert left == sorted({*asked, *(row for row, (key, *_) in enumerate(some) if key == 0x20)})


def counting() -> Protocol:
    """A device with a rolling counter of four bits' worth."""
    protocol = Protocol("counting", link="can")
    protocol.message(
        "Tick",
        id=0x100 + IdField("node", range(4)),
        payload=Struct("count" / Counter(Byte, modulo=16), "value" / Int16sl),
    )
    return protocol


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 15)), max_size=30), st.data())
def test_missing_counts_are_found_across_pieces(ticks: list[tuple[int, int]], data: st.DataObject) -> None:
    """What rolling counters miss is the same, live, in columns and in pieces."""
    variant = counting().variant()
    frames = [Frame(0x100 + node, bytes([count, 1, 0]), None, "can0") for node, count in ticks]
    table = FrameTable.from_frames(frames)
    live = make_scanner([variant])
    live.feed(frames)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(frames)), max_size=3)))
    _, counts = apart(variant, table, cuts)
    one = CanColumns([variant])
    one.feed(table)
    assert counts.missed == one.counts.missed == live.counts.missed


@given(st.integers(0, 10_000))
def test_records_from_a_table_are_those_of_its_frames(seed: int) -> None:
    """Without frames in between, the live scanner says the same: records, losses, transport, counts."""
    variant = load_protocol("hubo").variant()
    table = hubo_traffic(seed, 60)
    one, other = CanScanner([variant], include_unknown=True), CanScanner([variant], include_unknown=True)
    assert repr(one.feed_table(table)) == repr(other.feed(table.frames()))
    assert one.feed_table(table) == other.feed(table.frames())
    assert one.counts == other.counts
