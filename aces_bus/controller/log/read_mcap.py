"""Logs as MCAP, read back: our own channel of JSON, closed or not.

1. A file is untrusted: records, chunks and numbers are bounded, and what is wrong is an error with the byte where it is.
2. What a killed writer left is read up to its last whole record; that is noted.
"""

from __future__ import annotations

import os
import struct
import zlib
from array import array
from collections.abc import Iterator
from typing import IO

import msgspec
import numpy as np

from ...errors import CallerError
from .base import About, about_of
from .mcap import CHANNEL, CHUNK, DATA_END, FOOTER, KEY, MAGIC, MESSAGE
from .table import MOST_NUMBERS, Log, LogError, made_log

#: Of a record, and of a chunk unpacked.
MOST_BYTES = 1 << 28

Values = dict[str, float | None]
NAN = float("nan")


class _Cut(Exception):
    """The file ends within a record."""


class _Bytes:
    """A record's content, from its beginning; `struct.error` where it ends too soon."""

    def __init__(self, data: bytes | memoryview) -> None:
        self.data, self.at = memoryview(data), 0

    def take(self, form: str) -> tuple[int, ...]:
        found = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return found

    def bytes(self, form: str = "I") -> memoryview:
        (size,) = self.take(form)
        if size > len(self.data) - self.at:
            raise struct.error("a text that is longer than its record")
        self.at += size
        return self.data[self.at - size : self.at]

    def text(self) -> str:
        return bytes(self.bytes()).decode("utf-8", "replace")

    def rest(self) -> memoryview:
        return self.data[self.at :]


def _records(stream: IO[bytes], size: int) -> Iterator[tuple[int, int, bytes]]:
    """Place, opcode and content of the records up to the end of data."""
    place = len(MAGIC)
    while place < size:
        head = stream.read(9)
        if len(head) < 9:
            raise _Cut
        opcode, length = struct.unpack("<BQ", head)
        if length > MOST_BYTES:
            raise LogError(f"a record of {length} bytes at byte {place}")
        if length > size - place - 9:
            raise _Cut
        content = stream.read(length)
        if len(content) < length:
            raise _Cut
        if opcode in (DATA_END, FOOTER):
            return
        yield place, opcode, content
        place += 9 + length
    raise _Cut


def _unpacked(content: bytes) -> bytes:
    """The records in a chunk."""
    one = _Bytes(content)
    _, _, size, crc = one.take("QQQI")
    kind, packed = one.text(), bytes(one.bytes("Q"))
    if size > MOST_BYTES:
        raise LogError(f"a chunk of {size} bytes")
    if kind == "zstd":
        try:
            import zstandard
        except ImportError as missing:
            raise CallerError(
                f"chunks packed with zstd need zstandard: pip install 'aces-bus[columns]' ({missing})"
            ) from None
        try:
            if zstandard.frame_content_size(packed) not in (-1, size):
                raise LogError("a chunk whose size is another")
            plain = zstandard.ZstdDecompressor().decompress(packed, max_output_size=max(1, size))
        except zstandard.ZstdError as error:
            raise LogError(f"a chunk that cannot be unpacked: {error}") from None
    elif kind:
        raise LogError(f"a chunk packed with {kind[:20]!r}: no log of ours")
    else:
        plain = packed
    if len(plain) != size or (crc and zlib.crc32(plain) != crc):
        raise LogError("a chunk that is damaged")
    return plain


class _Rows:
    """What was found so far."""

    def __init__(self, most_numbers: int) -> None:
        self.about: About | None = None
        self.channel = -1
        self.instants = array("q")
        self.values = array("d")
        self.most = most_numbers
        self._decode = msgspec.json.Decoder(Values).decode

    def take(self, opcode: int, content: bytes | memoryview) -> None:
        """A record."""
        if opcode == CHUNK:
            inside = _Bytes(_unpacked(bytes(content)))
            while inside.at < len(inside.data):
                (kind,) = inside.take("B")
                if kind != CHUNK:
                    self.take(kind, inside.bytes("Q"))
        elif opcode == CHANNEL and self.about is None:
            self._channel(_Bytes(content))
        elif opcode == MESSAGE:
            one = _Bytes(content)
            channel, _, instant, _ = one.take("HIQQ")
            if self.about is not None and channel == self.channel:
                self._message(self.about, instant, one.rest())

    def _channel(self, one: _Bytes) -> None:
        number, _ = one.take("HH")
        one.text()
        encoding, metadata = one.text(), _Bytes(one.bytes())
        while metadata.at < len(metadata.data):
            key, value = metadata.text(), metadata.text()
            if key == KEY and encoding == "json":
                self.about, self.channel = about_of(value), number

    def _message(self, about: About, instant: int, data: memoryview) -> None:
        try:
            values = self._decode(data)
        except msgspec.MsgspecError as error:
            raise LogError(f"a row that is no JSON of numbers ({error})") from None
        if not abs(instant - about.base_ns) < 1 << 63:
            raise LogError(f"a row at an impossible time ({instant})")
        self.instants.append(instant - about.base_ns)
        for column in about.columns:
            value = values.get(column.name)
            self.values.append(NAN if value is None else value)
        if len(self.values) + len(self.instants) > self.most:
            raise LogError(f"more than {self.most} numbers")


def read_mcap_log(path: str, *, most_numbers: int = MOST_NUMBERS) -> Log:
    """Read the first channel that a logger made."""
    rows = _Rows(most_numbers)
    notes: list[str] = []
    place = 0
    try:
        with open(path, "rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            if stream.read(len(MAGIC)) != MAGIC:
                raise LogError("no MCAP")
            for place, opcode, content in _records(stream, size):  # noqa: B007 - the place is for messages
                rows.take(opcode, content)
    except _Cut:
        notes.append(f"{path}: the log was not closed, and is read as far as it was written")
    except LogError as error:
        raise LogError(f"{path}: {error} (record at byte {place})") from None
    except (struct.error, RecursionError) as error:
        raise LogError(f"{path}: a broken record at byte {place}: {error}") from None
    if rows.about is None:
        raise LogError(f"{path}: an MCAP without a channel of a logger; Foxglove and PlotJuggler open it")
    times = np.array(rows.instants, np.int64) / 1e9
    table = np.array(rows.values, np.float64).reshape(len(times), len(rows.about.columns))
    return made_log(path, "mcap", rows.about, table, notes, times)
