"""A raw serial recording: the bytes and nothing else (`cat /dev/ttyUSB0 > walk.bin`)."""

from __future__ import annotations

import select
from collections.abc import Callable, Iterator

from ..base import Chunk, SerialRecording


class RawCapture(SerialRecording):
    """The bytes of a file or pipe; it says neither when nor which way they went."""

    format = "raw serial bytes"

    def _chunks(self) -> Iterator[Chunk]:
        for data in self._source.blocks():
            self.bytes += len(data)
            yield Chunk(data)

    def with_silence(self, gap: Callable[[], float]) -> Iterator[Chunk]:
        """The chunks, and an empty one each time that a live source falls silent for `gap()` seconds (0: never)."""
        # Of packed bytes more may be there that is not unpacked yet. Asked now: later it would take bytes away.
        tells = self.live and not self._source.packing
        for chunk in self:
            yield chunk
            if tells and (seconds := gap()) and self._is_silent(seconds):
                yield Chunk(b"")

    def _is_silent(self, seconds: float) -> bool:
        try:
            return not select.select([self._source.fileno()], [], [], seconds)[0]
        except (OSError, ValueError):  # nothing that the system can wait for
            return False
