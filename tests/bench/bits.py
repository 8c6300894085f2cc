"""`python -m tests.bench bits`: fields that are there by bits and sizes by bits, beside fixed layouts of the same fields.

1. Each subject is one message declared twice: with fields that are there by bits (or a size by bits), and with all of them
   always there. The ratio is the time of a packet by bits to that of a packet of the fixed layout, in the same run.
2. By bits there are packets of one shape with all fields, as a device sends that was set up once; packets of four shapes;
   and packets whose bits are all drawn. Beside the last two, in which fields are missing, the fixed layout still has all.
3. Live is the records of a feed, of a fifth of the packets; columns are all values of all tables.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from construct import Array, Byte, Float32l, GreedyRange, Int16sl, Int16ul, Int32ul, Int64ul, Struct, this

from aces_bus import Frame, FrameTable, make_column_scanner
from aces_bus.protocol import Crc, Present, Protocol, Quantity

from .rows import BenchRow, fastest

#: At most so many times the time of a fixed layout.
TARGET = 1.5
#: Bytes of a stream that are fed at once.
CHUNK = 4096
#: Frames that are fed at once.
BATCH = 64
CRC = Crc("CRC16-XMODEM", order="big")
#: Groups of an inertial sensor's binary output, after VectorNav's: by mask, their fields.
GROUPS: dict[str, dict[str, Any]] = {
    "common": {
        "time": Quantity(Int64ul, unit="s", scale=1e-9),
        "angles": Array(3, Float32l),
        "quaternion": Array(4, Float32l),
        "rates": Array(3, Float32l),
    },
    "imu": {
        "status": Int16ul,
        "acceleration": Array(3, Float32l),
        "temperature": Quantity(Int16sl, unit="°C", scale=0.01),
        "pressure": Float32l,
        "field": Array(3, Float32l),
    },
}


def can_protocol(*, fd: bool, by_bits: bool) -> Protocol:
    """Return one message: a mask and three scaled numbers; of CAN-FD a mask and 15 floats."""
    field = Float32l if fd else Quantity(Int16sl, scale=0.01, unit="rad")
    names = [f"x{n}" for n in range(15 if fd else 3)]
    fields = [name / (Present("mask", n, field) if by_bits else field) for n, name in enumerate(names)]
    made = Protocol("bench", link="can")
    made.message("State", id=0x10, fd=fd, payload=Struct("mask" / (Int32ul if fd else Byte), *fields))
    return made


def groups_protocol(*, by_bits: bool) -> Protocol:
    """Return one message of a stream: a byte of groups, a mask for each of them, then the fields of the masks."""
    fields: dict[str, Any] = {}
    for n, mask in enumerate(GROUPS):
        fields[mask] = Present("groups", n, Int16ul) if by_bits else Int16ul
    for mask, inside in GROUPS.items():
        for n, (name, field) in enumerate(inside.items()):
            fields[name] = Present(mask, n, field) if by_bits else field
    size = 4 + sum(field.sizeof() for inside in GROUPS.values() for field in inside.values()) + 4
    made = Protocol("bench", link="serial")
    packet = made.framing(
        sync=b"\xfa",
        header=Struct("groups" / Byte),
        size="fields" if by_bits else size,
        max_size=size,
        check=CRC,
    )
    packet("Binary", payload=Struct(*(name / field for name, field in fields.items())))
    return made


def points_protocol(*, by_bits: bool) -> Protocol:
    """Return one message of a stream: points of three bytes, as many as five bits say; or a byte has the packet's size."""
    made = Protocol("bench", link="serial")
    packet = made.framing(
        sync=b"\x54",
        header=Struct("kind" / Byte),
        size=(this.kind & 31) * 3 + 8 if by_bits else this.kind + 0,
        max_size=8 + 31 * 3,
        check=CRC,
    )
    point = Struct("distance" / Int16ul, "intensity" / Byte)
    packet("Scan", payload=Struct("speed" / Int16ul, "start" / Int16ul, "points" / GreedyRange(point)))
    return made


# ---------------------------------------------------------------------- traffic


class Drawn:
    """Draws masks: all bits set, of one of four shapes, or any; and bytes of fields."""

    def __init__(self, how: str) -> None:
        self.how, self.source = how, random.Random(7)
        # Their low 15 bits, and all of a field's sizes, make frames of a length that there is.
        self.shapes = [0x7FFF, 0x3F5D, 0x0A51, 0x141A]
        self.bytes = self.source.randbytes

    def mask(self, bits: int) -> int:
        """Return a number of so many bits."""
        if self.how == "all fields":
            return (1 << bits) - 1
        if self.how == "four shapes":
            return self.source.choice(self.shapes) & (1 << bits) - 1
        return self.source.getrandbits(bits)


def can_data(drawn: Drawn, *, fd: bool, by_bits: bool) -> bytes:
    """Return the data of a frame."""
    if not fd:
        mask = drawn.mask(3)
        return bytes([mask]) + drawn.bytes(2 * mask.bit_count())
    while (mask := drawn.mask(15)).bit_count() not in (0, 1, 2, 3, 4, 5, 7, 11, 15):
        pass  # a frame has no such length
    return mask.to_bytes(4, "little") + drawn.bytes(4 * mask.bit_count())


def groups_packet(drawn: Drawn, *, by_bits: bool) -> bytes:
    """Return a packet of groups."""
    sizes = [[field.sizeof() for field in inside.values()] for inside in GROUPS.values()]
    which = drawn.mask(len(sizes) + sum(map(len, sizes)))
    groups, which = which & 3, which >> 2
    body, size = bytes([groups]), 0
    for n, inside in enumerate(sizes):
        mask, which = which & (1 << len(inside)) - 1, which >> len(inside)
        if groups >> n & 1:
            body += mask.to_bytes(2, "little")
            size += sum(width for bit, width in enumerate(inside) if mask >> bit & 1)
    body += drawn.bytes(size)
    return b"\xfa" + body + CRC.compute(body).to_bytes(2, "big")


def points_packet(drawn: Drawn, *, by_bits: bool) -> bytes:
    """Return a packet of points."""
    count = drawn.mask(5)
    body = bytes([0xE0 | count if by_bits else 8 + 3 * count]) + drawn.bytes(4 + 3 * count)
    return b"\x54" + body + CRC.compute(body).to_bytes(2, "big")


# ---------------------------------------------------------------------- contenders


def live(protocol: Protocol, traffic: bytes | list[Frame]) -> None:
    """Decode to records, a chunk of a stream or 64 frames at a time."""
    scanner = protocol.scanner()
    size = CHUNK if isinstance(traffic, bytes) else BATCH
    pieces: list[Any] = [traffic[at : at + size] for at in range(0, len(traffic), size)]
    found = sum(len(scanner.feed(piece)) for piece in pieces)
    assert scanner.counts.records == found > 0


def columns(protocol: Protocol, traffic: bytes | FrameTable) -> None:
    """Decode to columns, and compute all of them."""
    scanner = make_column_scanner([protocol.variant()])
    tables = [*scanner.feed(traffic), *scanner.close()]
    assert sum(len(column) for table in tables for column in table.columns()) > 0


#: How masks are drawn; a size by bits has no shapes.
SHAPES = ("all fields", "four shapes", "any masks")


class Subject(NamedTuple):
    """What is measured: how a protocol is made, and a packet of it."""

    name: str
    protocol: Callable[..., Protocol]
    packet: Callable[..., bytes]
    shapes: Sequence[str] = SHAPES


SUBJECTS = (
    Subject("CAN frame, 3 fields by bits", partial(can_protocol, fd=False), partial(can_data, fd=False)),
    Subject("CAN-FD frame, 15 fields by bits", partial(can_protocol, fd=True), partial(can_data, fd=True)),
    Subject("stream, 9 fields by bits", groups_protocol, groups_packet),
    Subject("stream, size by bits", points_protocol, points_packet, SHAPES[-1:]),
)


def contender(subject: Subject, how: str, count: int) -> dict[str, Callable[[], None]]:
    """Return what is measured, by name: a protocol and traffic, live and in columns; `how` is "fixed" or one of `SHAPES`."""
    by_bits = how != "fixed"
    drawn = Drawn(how if by_bits else subject.shapes[0])
    protocol = subject.protocol(by_bits=by_bits)
    packets = [subject.packet(drawn, by_bits=by_bits) for _ in range(count)]
    few: Any = b"".join(packets[: count // 5])
    table: Any = b"".join(packets)
    if protocol.link == "can":
        frames = [Frame(0x10, data, is_fd="FD" in subject.name) for data in packets]
        few, table = frames[: count // 5], FrameTable.from_frames(frames)
    return {"live": partial(live, protocol, few), "columns": partial(columns, protocol, table)}


def run(*, quick: bool) -> list[BenchRow]:
    """Return all rows."""
    most, rounds = (4_000, 3) if quick else (20_000, 25)
    rows: list[BenchRow] = []
    for subject in SUBJECTS:
        count = most if len(subject.shapes) > 1 else most // 20  # columns of lists take long
        contenders = {how: contender(subject, how, count) for how in ("fixed", *subject.shapes)}
        for way in ("live", "columns"):
            best = fastest(
                {how: given[way] for how, given in contenders.items()}, rounds=rounds, one_thread=True
            )
            name = f"{subject.name}, {way}"
            done = count // 5 if way == "live" else count
            rows.append(BenchRow(name, "fixed layout", done / best["fixed"], "packets/s"))
            for how in subject.shapes:
                ratio = best[how] / best["fixed"]
                rows.append(
                    BenchRow(name, how, done / best[how], "packets/s", ratio, f"≤ {TARGET}", ratio <= TARGET)
                )
    return rows
