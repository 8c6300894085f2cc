"""Fields and sizes by bits, many packets at once: drawn layouts, masks and damage, beside live scanner and reference."""

from __future__ import annotations

import random
from contextlib import suppress
from typing import Any

import pytest
from construct import (
    Array,
    Byte,
    Bytes,
    Const,
    Construct,
    Float32b,
    Float64l,
    FocusedSeq,
    GreedyBytes,
    GreedyRange,
    Int16sb,
    Int16ul,
    Int24ub,
    Int32ul,
    Int64ul,
    Rebuild,
    Struct,
    len_,
    this,
)
from hypothesis import settings

from aces_bus import Frame, FrameTable, make_column_scanner
from aces_bus.errors import SpecError
from aces_bus.protocol import BitLayout, Crc, Enumeration, Flags, Present, Protocol, Quantity, Sum, Text, bits
from aces_bus.protocol.columns.rows import RowDecoder
from aces_bus.protocol.columns.stream import StreamColumns
from aces_bus.testing.laws import LAWS, columns_law
from aces_bus.testing.packets import UndrawableError, draw_packet
from aces_bus.testing.scenes import Scene
from aces_bus.testing.source import Dice

#: Drawn layouts; most of them take their time.
SEEDS = [
    *range(3),
    *(
        pytest.param(seed, marks=pytest.mark.slow)
        for seed in range(3, 60 if settings().max_examples > 100 else 20)
    ),
]
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)


def fixed_field(source: random.Random) -> Construct:
    """A field of fixed size, of any kind that columns have."""
    point = Struct("x" / Int16sb, "y" / Quantity(Int16ul, unit="m", scale=0.01, unknown=(0xFFFF,)))
    layout = BitLayout(
        2, "low" / bits(5), "kind" / Enumeration(bits(3), a=0, b=1), "high" / bits(6, signed=True)
    )
    kinds: list[Construct] = [
        Byte,
        Int16sb,
        Int24ub,
        Int64ul,
        Float32b,
        Float64l,
        Quantity(Int16ul, unit="V", scale=0.1, offset=-4, unknown=(0,)),
        Quantity(Int32ul, unit="s", scale=1e-3),
        Enumeration(Byte, off=0, on=1),
        Flags(Byte, hot=0, cold=7),
        Array(3, Int16ul),
        Bytes(3),
        Text(4),
        Const(b"\x5a\xa5"),
        point,
        layout,
        Array(2, point),
    ]
    return source.choice(kinds)


def open_field(source: random.Random) -> Construct:
    """A field that goes on to the end of the packet."""
    group = Struct("a" / Byte, "b" / Int16ul)
    counted = FocusedSeq("items", "count" / Rebuild(Byte, len_(this.items)), "items" / group[this.count])
    return source.choice(
        [GreedyBytes, GreedyRange(group), Struct("n" / Int16ul, "rest" / GreedyBytes), counted]
    )


def fields_by_bits(source: random.Random, *, head: str | None, is_open: bool) -> Struct:
    """A payload whose fields are there by bits of one, two or three masks, which may be there by bits themselves."""
    masks = [head] if head is not None else []
    items: list[Construct] = [f"before{n}" / fixed_field(source) for n in range(source.randint(0, 2))]
    for n in range(source.randint(1, 2) if masks else source.randint(1, 3)):
        mask: Construct = source.choice([Byte, Int16ul, Int24ub, Int64ul, Flags(Byte, one=0, two=1)])
        items.append(f"mask{n}" / (Present(masks[-1], source.randint(0, 7), mask) if masks else mask))
        masks.append(f"mask{n}")
    for n in range(source.randint(1, 7)):
        field = fixed_field(source)
        if source.random() < 0.8:
            field = Present(source.choice(masks), source.randint(0, 7), field)
        items.append(f"field{n}" / field if not isinstance(field, Const) or source.random() < 0.5 else field)
    if is_open:
        items.append("last" / Present(masks[-1], source.randint(0, 7), open_field(source)))
    return Struct(*items)


def a_stream(source: random.Random) -> Protocol:
    """Packets as long as their fields say, or as a header byte says."""
    made = Protocol("drawn", link="serial")
    is_open = source.random() < 0.4
    check = source.choice([None, Crc("CRC16-XMODEM", order="big"), Sum(), Sum(field="sum")])
    heads = [
        name / Byte
        for name in ("groups", *(["size"] if is_open else []), *(["sum"] if check and check.field else []))
    ]
    packet = made.framing(
        sync=source.choice([b"\xfa", b"\xaa\x55"]),
        header=Struct(*heads),
        size=this.size + 0 if is_open else "fields",
        max_size=source.choice([24, 120]),
        check=check,
    )
    packet("M", payload=fields_by_bits(source, head="groups", is_open=is_open))
    return made


def drawn(make: Any, source: random.Random) -> Protocol:
    """The first protocol that can be declared."""
    for _ in range(200):
        with suppress(SpecError):  # more than a frame holds
            made: Protocol = make(source)
            made.variant()
            return made
    raise AssertionError("nothing can be declared")


def damaged(source: random.Random, packet: bytes) -> bytes:
    """A packet, now and then cut off, longer, or with a byte changed."""
    how = source.random()
    if how < 0.1:
        return packet[: source.randint(0, len(packet))]
    if how < 0.2:
        return packet + source.randbytes(source.randint(1, 3))
    if how < 0.35 and packet:
        at = source.randrange(len(packet))
        return packet[:at] + bytes([packet[at] ^ 1 << source.randint(0, 7)]) + packet[at + 1 :]
    return packet


def packets_of(made: Protocol, source: random.Random, count: int) -> list[bytes]:
    """Valid packets or frames' data with drawn masks."""
    dice = Dice(source.randint(0, 1 << 30))
    images: list[bytes] = []
    for _ in range(count):
        with suppress(UndrawableError):  # few masks make a length that a frame of CAN-FD has
            images.append(draw_packet(made["M"], dice).image)
    return [image[4:] for image in images] if made.link == "can" else images


@pytest.mark.parametrize("seed", SEEDS)
def test_drawn_streams_are_the_same_at_once(seed: int) -> None:
    """Packets of drawn layouts, some damaged: live scanner and columns give what the reference gives, however cut."""
    source = random.Random(seed)
    made = drawn(a_stream, source)
    assert isinstance(columns := make_column_scanner([made.variant()]), StreamColumns)
    assert not columns.reason
    if not (packets := packets_of(made, source, 40)):
        pytest.skip("no packet of this layout is as long as its framing takes")
    traffic = b"".join(
        damaged(source, source.choice(packets)) + source.randbytes(source.choice([0, 0, 0, 2]))
        for _ in range(90)
    )
    scene = Scene(traffic)
    for cuts in ((), sorted(source.sample(range(len(traffic)), min(6, len(traffic))))):
        LAWS[1](made.variant(), None, scene, cuts)
        columns_law(made.variant(), None, scene, cuts)


def a_bus(source: random.Random) -> Protocol:
    """A frame of CAN or CAN-FD."""
    made = Protocol("drawn", link="can")
    fd = source.random() < 0.5
    payload = fields_by_bits(source, head=None, is_open=fd or source.random() < 0.4)
    made.message("M", id=0x10, fd=fd, payload=payload)
    made.message("Other", id=0x11, payload=Struct("x" / Int16ul))
    return made


@pytest.mark.parametrize("seed", SEEDS)
def test_drawn_frames_are_the_same_at_once(seed: int) -> None:
    """Frames of drawn layouts, some of another length or with other masks: columns give what the live scanner gives."""
    source = random.Random(seed)
    made = drawn(a_bus, source)
    fd = made["M"].fd
    frames = []
    for data in packets_of(made, source, 40) * 3:
        frame = damaged(source, data)[: 64 if fd else 8]
        frame = frame[: max(size for size in FD_LENGTHS if size <= len(frame))] if fd else frame
        frames.append(Frame(source.choice([0x10, 0x10, 0x10, 0x11]), frame, is_fd=fd))
    assert not RowDecoder(made["M"].plan, message=made["M"]).reason
    scene = Scene(frames)
    LAWS[1](made.variant(), None, scene, (7, 50))
    columns_law(made.variant(), None, scene, (7, 50))


def test_absent_fields_are_null_in_columns_of_numbers() -> None:
    """A field that is there by a bit has the column of its kind, with gaps; those of its parts, too."""
    made = Protocol("one", link="can")
    point = Struct("x" / Int16ul, "y" / Quantity(Byte, unit="m", scale=0.5))
    payload = Struct(
        "mask" / Byte, "speed" / Present("mask", 0, Int16ul), "point" / Present("mask", 9, point)
    )
    made.message("M", id=1, payload=payload)
    frames = [Frame(1, bytes.fromhex(data)) for data in ("010500", "00", "FE", "0107", "03FFFF")]
    (table,) = make_column_scanner([made.variant()]).feed(FrameTable.from_frames(frames))
    assert table.names == ("mask", "speed", "point.x", "point.y")
    assert table["speed"].values.dtype == "u2"
    assert table["speed"].to_list() == [5, None, None, 0xFFFF]
    assert table["point.y"].to_list() == [None] * 4
    assert table["point.y"].kind.unit == "m"
    assert table.row.tolist() == [0, 1, 2, 4]


def test_lists_that_are_not_there_are_null() -> None:
    """An absent list is not an empty one."""
    made = Protocol("one", link="can")
    points = GreedyRange(Struct("x" / Byte))
    made.message("M", id=1, payload=Struct("mask" / Byte, "points" / Present("mask", 0, points)))
    frames = [Frame(1, bytes.fromhex(data)) for data in ("00", "01", "010203")]
    (table,) = make_column_scanner([made.variant()]).feed(FrameTable.from_frames(frames))
    assert table["points.x"].to_list() == [None, [], [2, 3]]
