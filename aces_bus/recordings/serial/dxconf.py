"""The hex dump that the vendor's serial monitor prints (`*.dxconf.txt`).

    Port opened by process "DXCONF.exe" (PID: 2568)

     FF FF 01 05 03 1E F6 01 E1 FF FF 01 05 03 1E 29   ÿÿ....ö.áÿÿ....)
     01 AE                                             .®

    Port closed

1. Lines end at LF only: the character column holds U+0085, which text readers take for a line end.
2. The character column is ignored; the bytes are those of the hexadecimal cells.
3. Bytes before and after a closed port never share a chunk.

The dump does not say which way the bytes went, nor when.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

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
