"""A raw serial recording: the bytes and nothing else (`cat /dev/ttyUSB0 > walk.bin`)."""

from __future__ import annotations

from collections.abc import Iterator

from .base import Chunk, SerialCapture


class RawCapture(SerialCapture):
    """The bytes of a file or pipe; it says neither when nor which way they went."""

    format = "raw serial bytes"

    def _chunks(self) -> Iterator[Chunk]:
        for data in self._source.blocks():
            self.bytes += len(data)
            yield Chunk(data)
