"""Logs as MCAP, for Foxglove and PlotJuggler: one channel `/log`, a JSON object a row.

1. What is appended is one chunk with its index: a process that is killed leaves whole chunks, which readers that go
   through a file in order take; `recover` gives the others the index at its end.
2. A row's `log_time` is the start (ns since 1970, in virtual time of its clock) plus the row's ns, exactly.

*Choice*: written here and not by foxglove-sdk, which has `aces decode`'s exports: a logger needs chunks that end when a time
is up, and files that stay whole when the disk is full. *Facts*: https://mcap.dev/spec (opcodes, records, magic).
Unknown is null. Chunks are packed with zstd where the extra `[columns]` (zstandard) is installed, else they are plain.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping, Sequence

import msgspec

from .base import About, AppendFile, LogSink, Row

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 1, 2, 3, 4, 5, 6
MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, SUMMARY_OFFSET, DATA_END = 7, 8, 11, 14, 15
#: Where the log's `About` stands among a channel's metadata.
KEY = "aces_log"
TOPIC = "/log"


def mcap_record(opcode: int, content: bytes) -> bytes:
    """A record: opcode, length, content."""
    return struct.pack("<BQ", opcode, len(content)) + content


def mcap_text(value: str | bytes) -> bytes:
    """A string, or bytes, with their length before them."""
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def texts(values: Mapping[str, str]) -> bytes:
    """A map of strings."""
    return mcap_text(b"".join(mcap_text(key) + mcap_text(value) for key, value in values.items()))


def packer() -> tuple[str, Callable[[bytes], bytes]]:
    """The name of the compression, and what does it."""
    try:
        import zstandard
    except ImportError:
        return "", bytes
    return "zstd", zstandard.ZstdCompressor(level=3).compress


class McapSink(LogSink):
    """`walk.mcap`."""

    format = "mcap"

    def __init__(self, path: str, about: About) -> None:
        super().__init__(path, about)
        self._compression, self._pack = packer()
        self._encode = msgspec.json.Encoder().encode
        self._file = AppendFile(path)
        self._declared = _schema(about) + _channel(about)
        self._file.write(MAGIC + mcap_record(HEADER, mcap_text("") + mcap_text("aces-bus")) + self._declared)
        self._rows = 0
        self._first = self._last = about.base_ns
        #: Of each chunk: start, end, place, length, length of its index, packed and plain size.
        self._chunks: list[tuple[int, ...]] = []

    def append(self, rows: Sequence[Row]) -> None:
        """One chunk, and the index of its messages."""
        base, names = self.about.base_ns, self.about.names
        messages: list[bytes] = []
        places: list[bytes] = []
        place = 0
        times: list[int] = []
        for number, (ns, values) in enumerate(rows, self._rows):
            time = max(0, base + ns)
            head = struct.pack("<HIQQ", 1, number & 0xFFFFFFFF, time, time)
            message = mcap_record(MESSAGE, head + self._encode(dict(zip(names, values, strict=True))))
            messages.append(message)
            places.append(struct.pack("<QQ", time, place))
            times.append(time)
            place += len(message)
        plain = b"".join(messages)
        packed = self._pack(plain)
        start, end = min(times), max(times)
        head = struct.pack("<QQQI", start, end, len(plain), zlib.crc32(plain)) + mcap_text(self._compression)
        chunk = mcap_record(CHUNK, head + struct.pack("<Q", len(packed)) + packed)
        index = mcap_record(MESSAGE_INDEX, struct.pack("<H", 1) + mcap_text(b"".join(places)))
        at = self._file.size
        self._file.write(chunk + index)
        self._chunks.append((start, end, at, len(chunk), len(index), len(packed), len(plain)))
        self._first = start if not self._rows else min(self._first, start)
        self._last = max(self._last, end)
        self._rows += len(rows)

    def sync(self) -> None:
        """To the disk."""
        self._file.sync()

    def close(self) -> None:
        """Write the index, and close."""
        try:
            self._file.write(self._end())
        finally:
            self._file.close()

    def _end(self) -> bytes:
        data_end = mcap_record(DATA_END, struct.pack("<I", 0))
        start = self._file.size + len(data_end)
        groups = [(SCHEMA, _schema(self.about)), (CHANNEL, _channel(self.about))]
        groups.append((STATISTICS, self._statistics()))
        groups.append((CHUNK_INDEX, b"".join(map(self._chunk_index, self._chunks))))
        summary, offsets = b"", b""
        for opcode, group in groups:
            if group:
                offsets += mcap_record(
                    SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start + len(summary), len(group))
                )
                summary += group
        footer = mcap_record(FOOTER, struct.pack("<QQI", start, start + len(summary), 0))
        return data_end + summary + offsets + footer + MAGIC

    def _statistics(self) -> bytes:
        counts = struct.pack("<QHIIII", self._rows, 1, 1, 0, 0, len(self._chunks))
        times = struct.pack("<QQ", self._first if self._rows else 0, self._last if self._rows else 0)
        return mcap_record(STATISTICS, counts + times + mcap_text(struct.pack("<HQ", 1, self._rows)))

    def _chunk_index(self, chunk: tuple[int, ...]) -> bytes:
        start, end, at, length, index, packed, plain = chunk
        content = struct.pack("<QQQQ", start, end, at, length)
        content += mcap_text(struct.pack("<HQ", 1, at + length)) + struct.pack("<Q", index)
        content += mcap_text(self._compression) + struct.pack("<QQ", packed, plain)
        return mcap_record(CHUNK_INDEX, content)


def _schema(about: About) -> bytes:
    properties: dict[str, dict[str, str]] = {}
    for column in about.columns:
        kind = properties[column.name] = {"type": "number"}
        if column.unit:
            kind["unit"] = column.unit
            kind["description"] = f"in {column.unit}"
    schema = {"type": "object", "title": "log", "properties": properties}
    content = (
        struct.pack("<H", 1)
        + mcap_text("log")
        + mcap_text("jsonschema")
        + mcap_text(msgspec.json.encode(schema))
    )
    return mcap_record(SCHEMA, content)


def _channel(about: About) -> bytes:
    metadata = {"robot": about.robot, "clock": about.clock, KEY: about.to_json()}
    return mcap_record(
        CHANNEL, struct.pack("<HH", 1, 1) + mcap_text(TOPIC) + mcap_text("json") + texts(metadata)
    )
