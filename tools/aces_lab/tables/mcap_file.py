"""MCAP as a file of records: written chunk by chunk, read back record by record.

1. Each chunk is one write of an `AppendFile`: a killed process leaves whole chunks, which programs that read a file from
   front to back take. `close` adds the index that the others need.
2. A file that is read is not trusted: records and chunks are bounded, and a fault names the byte where it is.

*Choice*: written here and not by a library: a log needs chunks that end when a time is up, and a file that stays whole when
the disk is full. *Facts*: https://mcap.dev/spec (opcodes, records, magic). Chunks are packed with zstd where zstandard is
installed (extra `[columns]`), else they are plain.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import IO

from aces_bus.errors import CallerError
from aces_bus.export.files import AppendFile

from . import MAGIC

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 1, 2, 3, 4, 5, 6
MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, SUMMARY_OFFSET, DATA_END = 7, 8, 11, 14, 15
#: Bytes of a record that is read, and of a chunk unpacked.
MOST_BYTES = 1 << 28


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _text(value: str | bytes) -> bytes:
    """Return a string, or bytes, with its length in front."""
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def _packer() -> tuple[str, Callable[[bytes], bytes]]:
    """Return the name of the compression, and the function that does it."""
    try:
        import zstandard
    except ImportError:
        return "", bytes
    return "zstd", zstandard.ZstdCompressor(level=3).compress


class McapWriter:
    """An MCAP, uncut at any moment, of a profile ("": none). Raises `OSError` where the file cannot be written."""

    def __init__(self, path: str, *, profile: str = "") -> None:
        self._compression, self._pack = _packer()
        self._file = AppendFile(path)
        self._schemas = self._channels = b""
        #: The index record of each chunk.
        self._chunks: list[bytes] = []
        #: Messages so far, by channel.
        self._counts: dict[int, int] = {}
        self._first, self._last = 1 << 64, 0
        self._is_closed = False
        self._file.write(MAGIC + _record(HEADER, _text(profile) + _text("aces-bus")))

    def channel(
        self,
        topic: str,
        title: str,
        schema: bytes,
        metadata: Mapping[str, str],
        *,
        schema_encoding: str = "jsonschema",
        encoding: str = "json",
    ) -> int:
        """Declare a channel of messages, JSON that a JSON schema describes if nothing else is said; returns its number."""
        number = len(self._counts) + 1
        pairs = b"".join(_text(key) + _text(value) for key, value in metadata.items())
        head = struct.pack("<H", number) + _text(title) + _text(schema_encoding)
        described = _record(SCHEMA, head + _text(schema))
        declared = _record(
            CHANNEL, struct.pack("<HH", number, number) + _text(topic) + _text(encoding) + _text(pairs)
        )
        self._file.write(described + declared)
        self._schemas += described
        self._channels += declared
        self._counts[number] = 0
        return number

    def chunk(self, messages: Sequence[tuple[int, int, bytes]]) -> None:
        """Append one chunk of messages, (channel, instant in ns, content), and the index of each channel in it."""
        places: dict[int, list[bytes]] = {}
        parts: list[bytes] = []
        place = 0
        for channel, time, data in messages:
            mine = places.setdefault(channel, [])
            number = (self._counts[channel] + len(mine)) & 0xFFFF_FFFF
            parts += struct.pack("<BQHIQQ", MESSAGE, 22 + len(data), channel, number, time, time), data
            mine.append(struct.pack("<QQ", time, place))
            place += 31 + len(data)
        plain = b"".join(parts)
        packed = self._pack(plain)
        times = [time for _, time, _ in messages]
        first, last = min(times), max(times)
        span = struct.pack("<QQ", first, last)
        head = span + struct.pack("<QI", len(plain), zlib.crc32(plain)) + _text(self._compression)
        chunk = _record(CHUNK, head + struct.pack("<Q", len(packed)) + packed)
        at, index, offsets = self._file.size, b"", b""
        for channel, mine in places.items():
            offsets += struct.pack("<HQ", channel, at + len(chunk) + len(index))
            index += _record(MESSAGE_INDEX, struct.pack("<H", channel) + _text(b"".join(mine)))
        self._file.write(chunk + index)
        content = span + struct.pack("<QQ", at, len(chunk)) + _text(offsets) + struct.pack("<Q", len(index))
        content += _text(self._compression) + struct.pack("<QQ", len(packed), len(plain))
        self._chunks.append(_record(CHUNK_INDEX, content))
        self._first, self._last = min(self._first, first), max(self._last, last)
        for channel, mine in places.items():
            self._counts[channel] += len(mine)

    def sync(self) -> None:
        """Wait until the disk has it."""
        self._file.sync()

    def close(self) -> None:
        """Write the index, and close; a second call does nothing."""
        if not self._is_closed:
            self._is_closed = True
            try:
                self._file.write(self._summary())
            finally:
                self._file.close()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._is_closed = True
        self._file.close()

    def _summary(self) -> bytes:
        data_end = _record(DATA_END, struct.pack("<I", 0))
        start = self._file.size + len(data_end)
        total, number = sum(self._counts.values()), len(self._counts)
        counts = struct.pack("<QHIIII", total, number, number, 0, 0, len(self._chunks))
        times = struct.pack("<QQ", self._first if total else 0, self._last)
        each = b"".join(struct.pack("<HQ", *count) for count in self._counts.items())
        statistics = _record(STATISTICS, counts + times + _text(each))
        summary, offsets = b"", b""
        for opcode, group in (
            (SCHEMA, self._schemas),
            (CHANNEL, self._channels),
            (STATISTICS, statistics),
            (CHUNK_INDEX, b"".join(self._chunks)),
        ):
            if group:
                span = struct.pack("<BQQ", opcode, start + len(summary), len(group))
                offsets += _record(SUMMARY_OFFSET, span)
                summary += group
        footer = _record(FOOTER, struct.pack("<QQI", start, start + len(summary), 0))
        return data_end + summary + offsets + footer + MAGIC


class McapFault(ValueError):
    """What is wrong with a file, and at which byte."""


class Fields:
    """A record's content from its beginning; raises `struct.error` where it ends too soon."""

    def __init__(self, data: bytes | memoryview) -> None:
        self.data, self.at = memoryview(data), 0

    def __bool__(self) -> bool:
        return self.at < len(self.data)

    def take(self, form: str) -> tuple[int, ...]:
        """Return numbers of these formats."""
        found = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return found

    def bytes(self, form: str = "I") -> memoryview:
        """Return bytes with their number in front."""
        (size,) = self.take(form)
        if size > len(self.data) - self.at:
            raise struct.error("a text that is longer than its record")
        self.at += size
        return self.data[self.at - size : self.at]

    def text(self) -> str:
        """Return a string."""
        return bytes(self.bytes()).decode("utf-8", "replace")


class McapReader:
    """The records of a file in order, those in chunks too. `is_cut` says that the file ends before its index."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.is_cut = False
        self._size = os.fstat(stream.fileno()).st_size
        self._place = 0

    def records(self) -> Iterator[tuple[int, Fields]]:
        """Yield opcode and content of each record up to the end of data; raise `McapFault`."""
        try:
            for opcode, content in self._outer():
                if opcode != CHUNK:
                    yield opcode, Fields(content)
                    continue
                inside = Fields(_unpacked(Fields(content)))
                while inside:
                    (kind,) = inside.take("B")
                    yield kind, Fields(inside.bytes("Q"))
        except McapFault as fault:
            raise McapFault(f"{fault} (record at byte {self._place})") from None
        except struct.error as error:
            raise McapFault(f"a broken record at byte {self._place}: {error}") from None

    def _outer(self) -> Iterator[tuple[int, bytes]]:
        stream = self._stream
        if stream.read(len(MAGIC)) != MAGIC:
            raise McapFault("no MCAP")
        self._place = len(MAGIC)
        while len(head := stream.read(9)) == 9:
            opcode, length = struct.unpack("<BQ", head)
            if length > MOST_BYTES:
                raise McapFault(f"a record of {length} bytes at byte {self._place}")
            content = stream.read(length) if length <= self._size - self._place - 9 else b""
            if len(content) < length:
                break
            if opcode in (DATA_END, FOOTER):
                return
            yield opcode, content
            self._place += 9 + length
        self.is_cut = True


def _unpacked(chunk: Fields) -> bytes:
    """Return the records in a chunk."""
    _, _, size, crc = chunk.take("QQQI")
    kind, packed = chunk.text(), bytes(chunk.bytes("Q"))
    if size > MOST_BYTES:
        raise McapFault(f"a chunk of {size} bytes")
    plain = packed
    if kind == "zstd":
        try:
            import zstandard
        except ImportError as missing:
            raise CallerError(
                f"chunks packed with zstd need zstandard: pip install 'aces-bus[columns]' ({missing})"
            ) from None
        try:
            if zstandard.frame_content_size(packed) not in (-1, size):
                raise McapFault("a chunk whose size is another")
            plain = zstandard.ZstdDecompressor().decompress(packed, max_output_size=max(1, size))
        except zstandard.ZstdError as error:
            raise McapFault(f"a chunk that cannot be unpacked: {error}") from None
    elif kind:
        raise McapFault(f"a chunk packed with {kind[:20]!r}, which is not read")
    if len(plain) != size or (crc and zlib.crc32(plain) != crc):
        raise McapFault("a chunk that is damaged")
    return plain
