"""MF4 files for tests: our own, and what other programs write, built block by block."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from aces_bus.capture import _mdf as mdf
from aces_bus.capture.write.mf4 import Mf4Writer
from aces_bus.frame import Frame
from aces_bus.frame_table import FrameTable

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
        return self.put(mdf.text(words))

    def channel(self, name: str, data_type: int, at: int, bits: int, **more: Any) -> int:
        return self.put(mdf.channel(mdf.Channel(self.text(name), mdf.VALUE, data_type, at, bits, **more)))

    def time(self, next_at: int) -> int:
        name = self.text("t")
        real = 4
        return self.put(
            mdf.channel(
                mdf.Channel(name, mdf.MASTER, real, 0, 64, 0, next_at, is_time=True, is_bus_event=False)
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


def variable_file() -> bytes:
    """Data bytes of variable length, in a block of their own."""
    build = Builder()
    values = [b"", b"\1\2\3", bytes(range(8))]
    stream = b"".join(struct.pack("<I", len(value)) + value for value in values)
    signal = build.put(mdf.block(b"SD", (), stream))
    variable = 1
    name = build.text("CAN_DataFrame.DataBytes")
    block = bytearray(mdf.channel(mdf.Channel(name, variable, mdf.BYTES, 13, 64)))
    struct.pack_into("<Q", block, 24 + 8 * 5, signal)
    data = build.put(bytes(block))
    length = build.channel("CAN_DataFrame.DataLength", mdf.UNSIGNED, 12, 4, first_bit=4, next_at=data)
    bus = build.channel("CAN_DataFrame.BusChannel", mdf.UNSIGNED, 12, 4, next_at=length)
    identifier = build.channel("CAN_DataFrame.ID", mdf.UNSIGNED, 8, 32, next_at=bus)
    first = build.time(build.channel("CAN_DataFrame", mdf.BYTES, 8, 13 * 8, parts_at=identifier))
    records = b""
    offset = 0
    for n, value in enumerate(values):
        records += struct.pack("<dIBQ", n, 0x55, 1 | len(value) << 4, offset)
        offset += 4 + len(value)
    group = build.group(first, len(values), 21)
    return build.finish(group, build.put(mdf.data_block(records)))


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
