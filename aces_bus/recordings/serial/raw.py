"""A raw serial recording, the bytes and nothing else (`cat /dev/ttyUSB0 > walk.bin`), and the vendor's hex dump of one.

The hex dump is what the vendor's serial monitor prints (`*.dxconf.txt`):

    Port opened by process "DXCONF.exe" (PID: 2568)

     FF FF 01 05 03 1E F6 01 E1 FF FF 01 05 03 1E 29   ÿÿ....ö.áÿÿ....)
     01 AE                                             .®

    Port closed

1. Its lines end at LF only: the character column holds U+0085, which text readers take for a line end. That column is
   ignored; the bytes are those of the hexadecimal cells.
2. Bytes before and after a closed port never share a chunk.
3. Neither says which way the bytes went, nor when.
"""

from __future__ import annotations

import re
import select
from collections.abc import Callable, Iterator

from ..base import Chunk, SerialRecording
from ..source import MAX_LINE

OPENING = b"Port opened by process"
_NOTE = re.compile(rb"Port (?:opened|closed)\b")
_ROW = re.compile(rb" ?((?:[0-9A-F]{2} ){0,15}[0-9A-F]{2})(?: {3}.*|\s*)")


class DxconfCapture(SerialRecording):
    """Bytes of a vendor hex dump; rows that cannot be read are counted."""

    format = "hex dump of the vendor's serial monitor"

    def _chunks(self) -> Iterator[Chunk]:
        for block in self._source.lines():
            parts: list[list[str]] = [[]]
            for line in block[:-1].split(b"\n"):
                self.lines += 1
                if not line.strip():
                    self.lines_blank += 1
                elif _NOTE.match(line):
                    self.lines_comment += 1
                    parts.append([])
                elif len(line) <= MAX_LINE and (row := _ROW.fullmatch(line)):
                    parts[-1].append(row[1].decode())
                else:
                    self._unreadable(self.lines, "not a row of up to 16 hexadecimal bytes", line)
            chunks = [Chunk(bytes.fromhex(" ".join(rows))) for rows in parts if rows]
            self.bytes += sum(len(chunk.data) for chunk in chunks)
            yield from chunks


class RawCapture(SerialRecording):
    """The bytes of a file or pipe; it says neither when nor which way they went."""

    format = "raw serial bytes"

    def _chunks(self) -> Iterator[Chunk]:
        for data in self._source.blocks():
            self.bytes += len(data)
            yield Chunk(data)

    def with_silence(self, gap: Callable[[], float]) -> Iterator[Chunk]:
        """Yield the chunks, and an empty one each time that a live source falls silent for `gap()` seconds (0: never)."""
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
