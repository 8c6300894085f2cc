"""The blocks of an MDF 4.10 file that a bus log needs, as bytes.

1. Plain functions from values to bytes; who writes them knows the offsets. Nothing here is state.

Every block begins with its name, its length and the number of its links; links are offsets of other blocks in the file, 0
where there is none. *Facts*: ASAM MDF 4.1 as other programs write it; each file is read back by asammdf in the tests.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

ALIGNMENT = 8
ID_BYTES, HD_AT = 64, 64
PROGRAM = b"aces_bus"
#: The channel of our own that says how many frames come before one.
ORDER = "aces_bus.order"

# Of `channel`: what a channel is, and how its bits are to be read.
VALUE, MASTER = 0, 2
UNSIGNED, SIGNED, BYTES = 0, 2, 10
#: Of channels that hold fields of an event on a bus, and of their group.
_BUS_EVENT_CHANNEL, _BUS_EVENT_GROUP, _PLAIN_BUS_EVENT = 0x400, 0x2, 0x4


class ChannelBlock(NamedTuple):
    """A channel: its kind, where its bits are, and its links."""

    name_at: int
    kind: int
    data_type: int
    first_byte: int
    bits: int
    first_bit: int = 0
    next_at: int = 0
    parts_at: int = 0
    conversion_at: int = 0
    unit_at: int = 0
    is_time: bool = False
    is_bus_event: bool = True


def block(name: bytes, links: Sequence[int], data: bytes) -> bytes:
    """Return a block, with zeros up to where the next one may begin."""
    size = 24 + 8 * len(links) + len(data)
    head = struct.pack(f"<4sIQQ{len(links)}Q", b"##" + name, 0, size, len(links), *links)
    return head + data + bytes(-size % ALIGNMENT)


def identification() -> bytes:
    """Return the first 64 bytes of a file."""
    return struct.pack("<8s8s8sIH26sHH", b"MDF     ", b"4.10    ", PROGRAM, 0, 410, b"", 0, 0).ljust(
        ID_BYTES, b"\0"
    )


def header(first_group_at: int, history_at: int, comment_at: int, start_ns: int) -> bytes:
    """Return the block at `HD_AT`; `start_ns` is UTC, since 1970."""
    links = (first_group_at, history_at, 0, 0, 0, comment_at)
    return block(b"HD", links, struct.pack("<QhhBBBBdd", start_ns, 0, 0, 0, 0, 0, 0, 0.0, 0.0))


def history(comment_at: int, time_ns: int) -> bytes:
    """Return the block that says who wrote the file."""
    return block(b"FH", (0, comment_at), struct.pack("<QhhB3x", time_ns, 0, 0, 0))


def text_block(words: str, *, is_xml: bool = False) -> bytes:
    """Return a text, or a comment in XML."""
    return block(b"MD" if is_xml else b"TX", (), words.encode("utf-8", "backslashreplace") + b"\0")


def source(name_at: int, path_at: int) -> bytes:
    """Return a CAN bus."""
    bus, can = 2, 2
    return block(b"SI", (name_at, path_at, 0), struct.pack("<BBB5x", bus, can, 0))


def ns_conversion(unit_at: int) -> bytes:
    """Return the conversion from integer nanoseconds to seconds."""
    linear = 1
    return block(
        b"CC", (0, unit_at, 0, 0), struct.pack("<BBHHHdddd", linear, 0, 0, 0, 2, 0.0, 0.0, 0.0, 1e-9)
    )


def channel(what: ChannelBlock) -> bytes:
    """Return a channel."""
    links = (what.next_at, what.parts_at, what.name_at, 0, what.conversion_at, 0, what.unit_at, 0)
    data = struct.pack(
        "<BBBBIIIIBBHdddddd",
        what.kind,
        1 if what.is_time else 0,
        what.data_type,
        what.first_bit,
        what.first_byte,
        what.bits,
        _BUS_EVENT_CHANNEL if what.is_bus_event else 0,
        0,
        0,
        0,
        0,
        *(0.0,) * 6,
    )
    return block(b"CN", links, data)


def channel_group(
    first_channel_at: int, name_at: int, source_at: int, records: int, record_bytes: int
) -> bytes:
    """Return a group of plain bus events."""
    flags = _BUS_EVENT_GROUP | _PLAIN_BUS_EVENT
    data = struct.pack("<QQHHIII", 0, records, flags, ord("."), 0, record_bytes, 0)
    return block(b"CG", (0, first_channel_at, name_at, source_at, 0, 0), data)


def data_group(next_at: int, group_at: int, data_at: int) -> bytes:
    """Return a group of records without numbers in front."""
    return block(b"DG", (next_at, group_at, data_at, 0), struct.pack("<B7x", 0))


def data_list(pieces: Sequence[tuple[int, int]]) -> bytes:
    """Return the list of data blocks: offset in the file and number of bytes of each."""
    offsets: list[int] = []
    total = 0
    for _, size in pieces:
        offsets.append(total)
        total += size
    count = len(pieces)
    data = struct.pack(f"<B3xI{count}Q", 0, count, *offsets)
    return block(b"DL", (0, *(at for at, _ in pieces)), data)


def data_block(records: bytes) -> bytes:
    """Return a data block of records."""
    return block(b"DT", (), records)
