"""Bytes of a serial line: our own recording, the bytes alone, and the hex dump of the vendor's serial monitor.

1. The last two hold neither when bytes came nor which way they went; chunks that say so are counted.
2. Rows of a dump go on over chunks: sixteen bytes each, but the last.
3. Each `write` of our own recording hands its lines to the file at once.
"""

from __future__ import annotations

from typing import BinaryIO

from ...frame_table import NO_TIME, to_ns
from ..base import Chunk
from ..serial.slog import LINE_BYTES, OPENING, SIGNS, VERSION
from .base import RecordingWriter

_ROW = 16
_CHARACTERS = bytes(code if 0x20 <= code < 0x7F else ord(".") for code in range(256))


def _bytes_alone(writer: RecordingWriter, chunk: Chunk) -> bytes:
    """Return the bytes of a chunk; what else it says is counted as lost."""
    writer.lose("times of chunks", chunk.time is not None)
    writer.lose("directions of chunks", chunk.direction is not None)
    return chunk.data


class RawWriter(RecordingWriter):
    """The bytes and nothing else."""

    format = "raw"

    def write(self, chunk: Chunk) -> None:
        """Write the bytes of a chunk."""
        self._file.write(_bytes_alone(self, chunk))


class DxconfWriter(RecordingWriter):
    """Rows of sixteen bytes with their characters."""

    format = "dxconf"

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        self._kept = b""
        file.write(b'Port opened by process "aces"\n\n')

    def write(self, chunk: Chunk) -> None:
        """Write the rows that are full."""
        data = self._kept + _bytes_alone(self, chunk)
        full = len(data) - len(data) % _ROW
        self._kept = data[full:]
        self._file.write(b"".join(_row(data[start : start + _ROW]) for start in range(0, full, _ROW)))

    def close(self) -> None:
        """Write the last row, and the end."""
        self._file.write((_row(self._kept) if self._kept else b"") + b"\nPort closed\n")


def _row(data: bytes) -> bytes:
    cells = data.hex(" ").upper().ljust(3 * _ROW - 1).encode()
    return b" %b   %b\n" % (cells, data.translate(_CHARACTERS))


class SerialLogWriter(RecordingWriter):
    """Our own serial recording. Times finer than nanoseconds, or beyond the year 2262, are counted as lost."""

    format = "serial log of aces-bus"

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        file.write(OPENING + b"%d\n" % VERSION)

    def write(self, chunk: Chunk) -> None:
        """Write a chunk; an empty one leaves no trace."""
        data = chunk.data
        head = f"({self._time(chunk.time)}) {SIGNS[chunk.direction]}"
        lines: list[str] = []
        for start in range(0, len(data), LINE_BYTES):
            piece = data[start : start + LINE_BYTES]
            more = "+" if start + LINE_BYTES < len(data) else ""
            lines.append(f"{head}{more} [{len(piece)}] {piece.hex().upper()}\n")
        self._file.write("".join(lines).encode())

    def _time(self, seconds: float | None) -> str:
        if seconds is None:
            return "-"
        ns = to_ns(seconds)
        if ns == NO_TIME or abs(ns) >= 10**21:
            self.lose("times that are not an instant")
            return "-"
        text = f"{'-' if ns < 0 else ''}{abs(ns) // 10**9}.{abs(ns) % 10**9:09}"
        self.lose("times finer than 1 ns", float(text) != seconds)
        return text
