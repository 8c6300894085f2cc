"""Bytes of a serial line without anything else, and as the hex dump of the vendor's serial monitor.

1. Neither holds when bytes came and which way they went; chunks that say so are counted.
2. Rows of a dump go on over chunks: sixteen bytes each, but the last.
"""

from __future__ import annotations

from typing import BinaryIO, ClassVar

from ..base import Chunk

_ROW = 16
_CHARACTERS = bytes(code if 0x20 <= code < 0x7F else ord(".") for code in range(256))


class RawWriter:
    """The bytes and nothing else."""

    format: ClassVar[str] = "raw"

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file = file
        self.lossy: dict[str, int] = {}

    def write(self, chunk: Chunk) -> None:
        """Write the bytes."""
        _count(chunk, self.lossy)
        self._file.write(chunk.data)

    def close(self) -> None:
        """Nothing is kept back."""


class DxconfWriter:
    """Rows of sixteen bytes with their characters."""

    format: ClassVar[str] = "dxconf"

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file = file
        self._kept = b""
        self.lossy: dict[str, int] = {}
        file.write(b'Port opened by process "aces"\n\n')

    def write(self, chunk: Chunk) -> None:
        """Write the rows that are full."""
        _count(chunk, self.lossy)
        data = self._kept + chunk.data
        full = len(data) - len(data) % _ROW
        self._file.write(b"".join(_row(data[start : start + _ROW]) for start in range(0, full, _ROW)))
        self._kept = data[full:]

    def close(self) -> None:
        """Write the last row, and the end."""
        if self._kept:
            self._file.write(_row(self._kept))
        self._file.write(b"\nPort closed\n")


def _row(data: bytes) -> bytes:
    cells = data.hex(" ").upper().ljust(3 * _ROW - 1).encode()
    return b" %b   %b\n" % (cells, data.translate(_CHARACTERS))


def _count(chunk: Chunk, lossy: dict[str, int]) -> None:
    for kind, value in (("times of chunks", chunk.time), ("directions of chunks", chunk.direction)):
        if value is not None:
            lossy[kind] = lossy.get(kind, 0) + 1
