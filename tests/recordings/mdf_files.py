"""MF4 files for tests: our own, and what other programs write, built block by block."""

from __future__ import annotations

import io
import itertools
import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from aces_bus import Frame, FrameTable
from aces_bus.frames import FD_LENGTHS
from aces_lab.formats.mf4 import blocks as mdf
from aces_lab.formats.mf4.writer import Mf4Writer

START = 1436509052.25
SOME = [
    Frame(0x123, b"\1\2", 1436509052.249713, "can0", is_rx=True),
    Frame(0x1234567, b"12345678", 1436509053.5, "can1", is_extended_id=True, is_rx=False),
    Frame(0x77, b"", 1436509053.5, "can0", is_remote_frame=True, dlc=5),
    Frame(0x80, b"\0\4" + bytes(6), 1436509053.5, "can1", is_error_frame=True),
    Frame(0x10, bytes(range(48)), 1436509053.5, "can0", is_fd=True, bitrate_switch=True),
    Frame(0x11, b"ab", 1436509052.0, None, is_fd=True, error_state_indicator=True),
]


def written(*tables: FrameTable) -> tuple[bytes, Mf4Writer]:
    file = io.BytesIO()
    writer = Mf4Writer(file, "out.mf4")
    for table in tables:
        writer.write(table)
    writer.close()
    return file.getvalue(), writer


def content_of(frames: Sequence[Frame]) -> bytes:
    return written(FrameTable.from_frames(frames))[0]


# ---- files of other programs, built block by block -----------------------------------------------------------------


class Builder:
    """Blocks one after the other, and their offsets."""

    def __init__(self) -> None:
        self.out = bytearray(mdf.identification() + mdf.header(0, 0, 0, 0))

    def put(self, data: bytes) -> int:
        at = len(self.out)
        self.out += data
        return at

    def text(self, words: str) -> int:
        return self.put(mdf.text_block(words))

    def channel(self, name: str, data_type: int, at: int, bits: int, **more: Any) -> int:
        return self.put(
            mdf.channel(mdf.ChannelBlock(self.text(name), mdf.VALUE, data_type, at, bits, **more))
        )

    def time(self, next_at: int) -> int:
        name = self.text("t")
        real = 4
        return self.put(
            mdf.channel(
                mdf.ChannelBlock(name, mdf.MASTER, real, 0, 64, 0, next_at, is_time=True, is_bus_event=False)
            )
        )

    def group(self, first: int, records: int, size: int, number: int = 0, next_at: int = 0) -> int:
        source = self.put(mdf.source(self.text("CAN"), 0))
        block = bytearray(mdf.channel_group(first, 0, source, records, size))
        struct.pack_into("<Q", block, 24, next_at)
        struct.pack_into("<Q", block, 24 + 48, number)
        return self.put(bytes(block))

    def finish(self, group: int, data: int, number_bytes: int = 0) -> bytes:
        block = bytearray(mdf.data_group(0, group, data))
        block[24 + 32] = number_bytes
        dg = self.put(bytes(block))
        history = self.put(mdf.history(0, 0))
        self.out[mdf.HD_AT : mdf.HD_AT + 104] = mdf.header(dg, history, 0, 10**18)
        self.out[16:24] = b"somebody"
        return bytes(self.out)


FIELDS = ("IDE", "DLC", "DataLength", "EDL", "BRS", "ESI", "BusChannel", "Dir")


def converts(build: Builder, kind: int, parameters: Sequence[float], texts: Sequence[str] = ()) -> int:
    """A conversion; "" is for a text that is missing."""
    links = (0, 0, 0, 0, *(build.text(text) if text else 0 for text in texts))
    head = struct.pack("<BBHHHdd", kind, 0, 0, len(texts), len(parameters), 0.0, 0.0)
    return build.put(mdf.block(b"CC", links, head + struct.pack(f"<{len(parameters)}d", *parameters)))


def patched(build: Builder, channel: int, **values: int) -> int:
    """A channel with other values in its block."""
    places = {
        "data_at": ("<Q", 64),
        "kind": ("<B", 88),
        "sync": ("<B", 89),
        "data_type": ("<B", 90),
        "bits": ("<I", 96),
        "flags": ("<I", 100),
        "invalid_bit": ("<I", 104),
    }
    for name, value in values.items():
        letter, at = places[name]
        struct.pack_into(letter, build.out, channel + at, value)
    return channel


Conversions = Mapping[str, tuple[int, Sequence[float], Sequence[str]]]


def plain_records(n: int, width: int = 64) -> np.ndarray[Any, Any]:
    """Records of a time, an identifier, each of `FIELDS` as a byte, and data: short classic frames, received on bus 1."""
    rows = np.zeros(
        n, [("t", "<f8"), ("ID", "<u4"), *((name, "u1") for name in FIELDS), ("DataBytes", "u1", width)]
    )
    rows["t"], rows["ID"], rows["BusChannel"] = np.arange(n) / 8, 0x100 + np.arange(n), 1
    rows["DLC"] = rows["DataLength"] = np.arange(n) % 9
    rows["DataBytes"] = np.arange(1, n * width + 1).reshape(n, width) % 251
    return rows


def converted_file(
    rows: np.ndarray[Any, Any],
    conversions: Conversions | None = None,
    kind: str = "CAN_DataFrame",
    invalid: bytes = b"",
    **changes: Mapping[str, int],
) -> bytes:
    """A file of `plain_records`: conversions by field ("t" is the time, "" the frame), and changes of their channels.

    `invalid` are invalidation bytes, the same number for each record.
    """
    build = Builder()
    places = {name: converts(build, *what) for name, what in (conversions or {}).items()}
    at = 0
    for name in reversed(("ID", *FIELDS, "DataBytes")):
        dtype, first = rows.dtype.fields[name][:2]
        data_type = mdf.BYTES if name == "DataBytes" else mdf.UNSIGNED
        bits = 8 * dtype.itemsize
        more = {"next_at": at, "conversion_at": places.get(name, 0)}
        at = patched(
            build, build.channel(f"{kind}.{name}", data_type, first, bits, **more), **changes.get(name, {})
        )
    size = rows.dtype.itemsize
    whole = patched(
        build, build.channel(kind, mdf.BYTES, 8, 8 * (size - 8), parts_at=at), **changes.get("whole", {})
    )
    real = 4
    time = mdf.ChannelBlock(
        build.text("t"), mdf.MASTER, real, 0, 64, 0, whole, conversion_at=places.get("t", 0), is_time=True
    )
    first_at = patched(build, build.put(mdf.channel(time)), **changes.get("t", {}))
    group = build.group(first_at, len(rows), size)
    each = len(invalid) // len(rows)
    struct.pack_into("<I", build.out, group + 100, each)
    out = b"".join(row.tobytes() + invalid[n * each : (n + 1) * each] for n, row in enumerate(rows))
    return build.finish(group, build.put(mdf.data_block(out)))


def data_frames(build: Builder, kind: str = "CAN_DataFrame") -> int:
    """Channels of records of 8 + 4 + 1 + 8 bytes: time, identifier with its 29-bit flag, BusChannel | DataLength, data."""
    data = build.channel(f"{kind}.DataBytes", mdf.BYTES, 13, 64)
    length = build.channel(f"{kind}.DataLength", mdf.UNSIGNED, 12, 4, first_bit=4, next_at=data)
    bus = build.channel(f"{kind}.BusChannel", mdf.UNSIGNED, 12, 4, next_at=length)
    identifier = build.channel(f"{kind}.ID", mdf.UNSIGNED, 8, 32, next_at=bus)
    return build.time(build.channel(kind, mdf.BYTES, 8, 13 * 8, parts_at=identifier))


def record(seconds: float, identifier: int, data: bytes, bus: int = 1) -> bytes:
    return struct.pack("<dIB", seconds, identifier, bus | len(data) << 4) + data.ljust(8, b"\0")


def unsorted_file() -> bytes:
    """Two groups in one stream of records, each with its group's number in front, as loggers write."""
    build = Builder()
    lin = build.time(build.channel("LIN_Frame", mdf.BYTES, 8, 8))
    second = build.group(lin, 2, 9, number=2)
    first = build.group(data_frames(build), 3, 21, number=1, next_at=second)
    stream = b""
    for n in range(3):
        stream += b"\x01" + record(n, 0x80000123 if n else 0x123, bytes([n] * n))
        if n < 2:
            stream += b"\x02" + struct.pack("<dB", n, 7)
    return build.finish(first, build.put(mdf.data_block(stream)), 1)


VALUES = (b"", b"\1\2\3", bytes(range(8)))


def variable_file(
    values: Sequence[bytes] = VALUES,
    way: str = "block",
    lengths: Sequence[int] | None = None,
    offsets: Sequence[int] | None = None,
) -> bytes:
    """CAN FD data bytes of variable length, one behind the other: in a "block", in "packed" ones, or in "records".

    `lengths` and `offsets` are what the records say of them, where that is not true.
    """
    build = Builder()
    places = [0, *itertools.accumulate(4 + len(value) for value in values)]
    stream = b"".join(struct.pack("<I", len(value)) + value for value in values)
    lengths = lengths or [len(value) for value in values]
    offsets = offsets or places[:-1]
    signal = group = 0
    if way == "packed":
        parts: list[tuple[int, int]] = []
        for part in (stream[: len(stream) // 3], stream[len(stream) // 3 :]):
            packed = zlib.compress(part)
            head = struct.pack("<2sBBIQQ", b"SD", 0, 0, 0, len(part), len(packed))
            parts.append((build.put(mdf.block(b"DZ", (), head + packed)), len(part)))
        signal = build.put(mdf.block(b"HL", (build.put(mdf.data_list(parts)),), struct.pack("<HB5x", 0, 0)))
    elif way == "records":
        block = bytearray(mdf.channel_group(0, 0, 0, len(values), len(stream) - 4 * len(values)))
        struct.pack_into("<QQH", block, 24 + 48, 2, len(values), 1)
        signal = group = build.put(bytes(block))
    else:
        signal = build.put(mdf.block(b"SD", (), stream))
    kind, variable = "CAN_DataFrame", 1
    data = patched(
        build, build.channel(f"{kind}.DataBytes", mdf.BYTES, 14, 64), kind=variable, data_at=signal
    )
    length = build.channel(f"{kind}.DataLength", mdf.UNSIGNED, 13, 8, next_at=data)
    is_fd = build.channel(f"{kind}.EDL", mdf.UNSIGNED, 12, 4, first_bit=4, next_at=length)
    bus = build.channel(f"{kind}.BusChannel", mdf.UNSIGNED, 12, 4, next_at=is_fd)
    identifier = build.channel(f"{kind}.ID", mdf.UNSIGNED, 8, 32, next_at=bus)
    first = build.time(build.channel(kind, mdf.BYTES, 8, 14 * 8, parts_at=identifier))
    records: list[bytes] = []
    for n, (value, said, offset) in enumerate(zip(values, lengths, offsets, strict=True)):
        record = struct.pack("<dIBBQ", n, 0x80000055, 1 | 16, said, offset)
        if way == "records":
            record = b"\1" + record + b"\2" + struct.pack("<I", len(value)) + value
        records.append(record)
    group = build.group(first, len(values), 22, number=1, next_at=group)
    return build.finish(group, build.put(mdf.data_block(b"".join(records))), way == "records")


def packed_file(records: bytes, size: int, count: int, claimed: int | None = None) -> bytes:
    """Records in a deflated block that claims to unpack to so many bytes."""
    build = Builder()
    packed = zlib.compress(records, 1)
    head = struct.pack("<2sBBIQQ", b"DT", 0, 0, 0, len(records) if claimed is None else claimed, len(packed))
    group = build.group(data_frames(build), count, size)
    return build.finish(group, build.put(mdf.block(b"DZ", (), head + packed)))


def plain_file(records: bytes, count: int, flags: int = 0) -> bytes:
    build = Builder()
    group = build.group(data_frames(build), count, 21)
    content = bytearray(build.finish(group, build.put(mdf.data_block(records))))
    if flags:
        content[:8] = b"UnFinMF "
        struct.pack_into("<HH", content, 60, flags, 0)
    return bytes(content)


def later_file() -> bytes:
    """An ordinary file that says it is of a later version."""
    content = bytearray(plain_file(RECORDS, 9))
    content[8:16], content[28:30] = b"4.30    ", struct.pack("<H", 430)
    return bytes(content)


def signals_file() -> bytes:
    """Measured signals, and no bus."""
    build = Builder()
    group = build.group(build.time(build.channel("speed", mdf.UNSIGNED, 8, 8)), 1, 9)
    content = bytearray(build.finish(group, build.put(mdf.data_block(bytes(9)))))
    struct.pack_into("<H", content, content.index(b"##CG") + 24 + 48 + 16, 0)  # no bus event
    return bytes(content)


RECORDS = b"".join(record(n / 2, 0x100 + n, bytes([n] * n)) for n in range(9))
WRONG = record(0.0, 0x800, b"") + record(1.0, 0x7, bytes(8)) + record(2.0, 0x1, b"")
UNTIMED = [Frame(1), Frame(2, b"", 5.0), Frame(3), Frame(4, b"", 6.0)]
COUNT_MISSING = 1


def damaged_files() -> list[bytes]:
    whole = content_of(SOME * 3)
    rng = np.random.default_rng(3)
    damaged = [whole[:size] for size in range(0, len(whole), 331)]
    for _ in range(60):
        flipped = bytearray(whole)
        flipped[int(rng.integers(64, len(whole)))] ^= int(rng.integers(1, 256))
        damaged.append(bytes(flipped))
    return damaged


def circles() -> list[bytes]:
    """Files in which a group, a channel or a list of data leads back to itself, or a list names its data twice."""
    whole = content_of(SOME)
    found: list[bytes] = []
    for name, link in ((b"##DG", 0), (b"##DG", 1), (b"##CG", 0), (b"##CN", 0), (b"##CN", 1), (b"##FH", 0)):
        content = bytearray(whole)
        at = content.index(name)
        struct.pack_into("<Q", content, at + 24 + 8 * link, at)
        found.append(bytes(content))
    for to_itself in (True, False):
        build = Builder()
        data = build.put(mdf.data_block(RECORDS))
        at = len(build.out)
        block = bytearray(mdf.data_list([(data, len(RECORDS)), (data, len(RECORDS))]))
        struct.pack_into("<Q", block, 24, at if to_itself else 0)
        found.append(build.finish(build.group(data_frames(build), 1 << 40, 21), build.put(bytes(block))))
    return found


def many(build: Builder, streams: Sequence[Sequence[int]], widths: Sequence[int], number_bytes: int) -> bytes:
    """A stream of records of groups of frames, LIN and nothing, by their numbers; `widths` are of their data bytes."""
    group = 0
    counts = [sum(number == each for each in itertools.chain(*streams)) for number in range(len(widths))]
    for number, width in reversed(list(enumerate(widths))):
        first = build.time(build.channel("LIN_Frame", mdf.BYTES, 8, 8)) if width < 8 else data_frames(build)
        group = build.group(first, counts[number], 13 + width, number=number + 1, next_at=group)
    out: list[bytes] = []
    for n, number in enumerate(itertools.chain(*streams)):
        body = record(n // 4 * 0.5, n % 0x800, bytes([n % 256] * (n % 9)), number + 1)[: 13 + widths[number]]
        out.append((number + 1).to_bytes(number_bytes, "little") + body.ljust(13 + widths[number], b"\0"))
    return build.finish(group, build.put(mdf.data_block(b"".join(out))), number_bytes)


def listed(pieces: Sequence[bytes], count: int, packing: int | None, size: int = 21) -> bytes:
    """Records in a list of data blocks, plain (None), deflated (0), or transposed and deflated."""
    build = Builder()
    places: list[tuple[int, int]] = []
    for piece in pieces:
        if packing is None:
            places.append((build.put(mdf.data_block(piece)), len(piece)))
            continue
        data = piece
        if packing:
            rows = len(piece) // size
            table = np.frombuffer(piece, np.uint8, rows * size).reshape(rows, size)
            data = table.T.tobytes() + piece[rows * size :]
        packed = zlib.compress(data)
        head = struct.pack("<2sBBIQQ", b"DT", packing, 0, size if packing else 0, len(data), len(packed))
        places.append((build.put(mdf.block(b"DZ", (), head + packed)), len(data)))
    first = build.put(mdf.data_list(places[2:]))
    block = bytearray(mdf.data_list(places[:2]))
    struct.pack_into("<Q", block, 24, first)
    data_at = build.put(bytes(block))
    if packing is not None:
        data_at = build.put(mdf.block(b"HL", (data_at,), struct.pack("<HB5x", 0, packing)))
    return build.finish(build.group(data_frames(build), count, size), data_at)


def odd_fields(factor: float, offset: float) -> bytes:
    """Fields at odd bits, numbers with a sign, times as 32-bit counts of something."""
    build = Builder()
    kind = "CAN_DataFrame"
    signed, at = mdf.SIGNED, 0
    for name, data_type, first_byte, bits, first_bit in (
        ("DataBytes", mdf.BYTES, 13, 96, 0),
        ("Dir", mdf.UNSIGNED, 12, 1, 7),
        ("ESI", mdf.UNSIGNED, 12, 1, 6),
        ("BRS", mdf.UNSIGNED, 12, 1, 5),
        ("EDL", mdf.UNSIGNED, 12, 1, 4),
        ("DLC", mdf.UNSIGNED, 12, 4, 0),
        ("DataLength", signed, 10, 7, 5),
        ("IDE", mdf.UNSIGNED, 9, 1, 6),
        ("BusChannel", signed, 9, 7, 7),
        ("ID", mdf.UNSIGNED, 5, 29, 7),
    ):
        at = build.channel(f"{kind}.{name}", data_type, first_byte, bits, first_bit=first_bit, next_at=at)
    whole = build.channel(kind, mdf.BYTES, 4, 21 * 8, parts_at=at)
    linear = 1
    conversion = build.put(
        mdf.block(
            b"CC", (0, 0, 0, 0), struct.pack("<BBHHHdddd", linear, 0, 0, 0, 2, 0.0, 0.0, offset, factor)
        )
    )
    time = mdf.ChannelBlock(
        build.text("t"), mdf.MASTER, mdf.UNSIGNED, 0, 32, 0, whole, conversion_at=conversion, is_time=True
    )
    rng = np.random.default_rng(1)
    out: list[bytes] = []
    for n in range(50):
        is_fd, wide = n % 3 == 0, n % 2
        length = (9, n % 9)[not is_fd] if is_fd and n % 2 else n % 9
        fields = int(rng.integers(0, 0x2000_0000 if wide else 0x800)) << 15 | wide << 38
        fields |= (n % 5) << 39 | (length & 0x7F) << 53
        fields |= (length | is_fd << 4 | n % 2 << 5 | (n & 2) >> 1 << 6 | (n & 4) >> 2 << 7) << 64
        out.append(struct.pack("<I", 1000 * n) + fields.to_bytes(9, "little") + rng.bytes(12))
    data = build.put(mdf.data_block(b"".join(out)))
    return build.finish(build.group(build.put(mdf.channel(time)), 50, 25), data)


def in_words() -> bytes:
    """Directions as texts, and lengths as codes only."""
    build = Builder()
    kind, text = "CAN_DataFrame", 6
    way = build.channel(f"{kind}.Dir", text, 22, 16)
    data = build.channel(f"{kind}.DataBytes", mdf.BYTES, 14, 64, next_at=way)
    code = build.channel(f"{kind}.DLC", mdf.UNSIGNED, 13, 8, next_at=data)
    fd = build.channel(f"{kind}.EDL", mdf.UNSIGNED, 12, 8, next_at=code)
    first = build.channel(f"{kind}.ID", mdf.UNSIGNED + 1, 8, 32, next_at=fd)  # its highest byte first
    group = build.group(build.time(build.channel(kind, mdf.BYTES, 8, 16 * 8, parts_at=first)), 40, 24)
    ways = (b"Rx", b"Tx", b"RX", b"rx", b"T\0")
    records = b"".join(
        struct.pack(">d", 0.0)[::-1] + struct.pack(">IBB8s2s", n, n % 2, n % 13, bytes(range(8)), ways[n % 5])
        for n in range(40)
    )
    return build.finish(group, build.put(mdf.data_block(records)))


def long_values() -> list[bytes]:
    """Data bytes of CAN FD in all its lengths."""
    return [bytes(range(n, n + FD_LENGTHS[n % 16])) for n in range(50)]


def ordinary_files() -> dict[str, bytes]:
    halves = (
        RECORDS[:50],
        RECORDS[50:150],
        RECORDS[150:151],
        RECORDS[151:],
    )  # records go over the borders of blocks
    return {
        "ours": content_of(SOME * 40),
        "untimed": written(FrameTable.from_frames(UNTIMED))[0],
        "plain": plain_file(RECORDS, 9),
        "less is announced": plain_file(RECORDS, 5),
        "wrong": plain_file(WRONG, 3),
        "short": plain_file(RECORDS, 20),
        "cut": plain_file(RECORDS[:-4], 9),
        "unfinished": plain_file(RECORDS, 0, flags=COUNT_MISSING),
        "unfinished, cut": plain_file(RECORDS[:-4], 0, flags=COUNT_MISSING),
        "unsorted": unsorted_file(),
        "one group with a number": many(Builder(), [[0] * 30], [8], 1),
        "records alike": many(Builder(), [[0, 1, 1, 0, 2] * 60], [8, 8, 8], 1),
        "records of all sizes": many(Builder(), [[0, 1, 2] * 40, [1] * 200, [2, 0, 0] * 99], [8, 9, 3], 2),
        "long numbers": many(Builder(), [[0, 1, 1] * 9], [8, 10], 8),
        "no instants": plain_file(record(float("nan"), 1, b"") + RECORDS + record(-1e300, 2, b""), 11),
        "directions in words": in_words(),
        "list": listed(halves, 9, None),
        "packed": packed_file(RECORDS, 21, 9),
        "list of packed": listed(halves, 9, 0),
        "list of transposed": listed(halves, 9, 1),
        "variable": variable_file(),
        "variable, packed": variable_file(long_values(), "packed"),
        "variable, in records": variable_file(long_values(), "records"),
        "converted": converted_file(
            plain_records(30),
            {"ID": (1, (2.0, 1.5), ()), "BusChannel": (1, (9.0, 0.0), ()), "Dir": (7, (0.0,), ("Rx", "Tx"))},
            invalid=bytes(range(30)),
            BusChannel={"kind": 6, "bits": 0},
            IDE={"flags": 2, "invalid_bit": 2},
        ),
        "odd": odd_fields(1e-3, 0.25),
        "odd nanoseconds": odd_fields(1e-9, 0.0),
    }
