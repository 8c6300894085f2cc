"""Our own recording of a serial line: bytes, which way they went, when, and in which pieces they came.

    # aces serial capture 1
    (1436509052.249713000) > [6] FFFF010201FB      to the device, at this host time in seconds
    (1436509052.250413000) < [6] FFFF010200FC      from the device
    (1436509052.250425000) <+ [1024] 00…           the chunk goes on in the next line
    (-) ? [1] 7F                                   neither time nor direction is known

1. A line is whole by itself: a file may be cut anywhere, appended to, searched with grep and joined with cat.
2. A line says how many bytes it has, so that one that was cut is known by that; it is unreadable, not shorter.
3. What is read is what was written: bytes, boundaries, directions, and times to the nanosecond.

One file is one line; which one, a comment may say. Lines that begin with # are comments, the first among them. A chunk of
more than `LINE_BYTES` takes several lines; all but its last have a +. Each has the same time and direction. Where
one is missing, it counts as an unreadable line, and the chunk ends before it.

*Choice*: text, like candump's, because a recording is looked at with the tools at hand first; hexadecimal digits cost twice
the bytes, and `.slog.gz` takes that back.
"""

from __future__ import annotations

import re
from binascii import unhexlify
from collections.abc import Iterator

from ...errors import CaptureError
from ..base import Chunk, Direction, SerialRecording
from ..source import MAX_LINE

OPENING = b"# aces serial capture "
VERSION = 1
#: Bytes a written line has at most; read are lines of up to 2,000.
LINE_BYTES = 1024
#: A chunk is never longer, whatever the lines say.
CHUNK_BYTES = 1 << 16

_LINE = re.compile(
    rb"\((-|-?[0-9]{1,12}(?:\.[0-9]{1,9})?)\) ([<>?])(\+?) \[([0-9]{1,5})\] ((?:[0-9A-Fa-f]{2})*)\s*"
)
_MEANT = re.compile(rb"\((?:-|-?[0-9]{1,12}(?:\.[0-9]{1,9})?)\) [<>?]\+? \[[0-9]{1,5}\] [0-9A-Fa-f]{2}")
_WAYS: dict[bytes, Direction | None] = {b">": "to device", b"<": "from device", b"?": None}
SIGNS: dict[Direction | None, str] = {"to device": ">", "from device": "<", None: "?"}


def looks_like_serial_log(head: bytes) -> bool:
    """Return whether a file begins like one of ours: with the first line, or, where it is a piece of one, with any other."""
    if head.startswith(OPENING):
        return True
    for line in head.split(b"\n", 200)[:200]:
        if line.strip() and not line.startswith(b"#"):
            return bool(_MEANT.match(line))
    return False


class SerialLogCapture(SerialRecording):
    """Chunks of our own serial recording, with time and direction.

    Reading raises `CaptureError` when the first line names a version that this release does not know.
    """

    format = "serial log of aces-bus"

    def _chunks(self) -> Iterator[Chunk]:
        kept: list[bytes] = []  # of a chunk that goes on
        size = number = 0
        stamp: tuple[bytes, bytes] = b"", b""
        for block in self._source.lines():
            chunks: list[Chunk] = []
            for line in block[:-1].split(b"\n"):
                number += 1
                self.lines += 1
                found = _LINE.fullmatch(line) if len(line) <= MAX_LINE else None
                data = unhexlify(found[5]) if found else b""
                is_chunk = found is not None and len(data) == int(found[4]) > 0
                said = (found[1], found[2]) if found else stamp
                is_open, others = bool(kept), self.lines_unreadable
                if kept and (not is_chunk or said != stamp or size + len(data) > CHUNK_BYTES):
                    chunks.append(
                        _chunk(b"".join(kept), stamp)
                    )  # what follows is another, or there is a hole
                    kept, size = [], 0
                if found is None or not is_chunk:
                    self._other_line(number, line, found, len(data))
                if is_open and (said != stamp or not is_chunk) and self.lines_unreadable == others:
                    self._missing(number, line)
                if found is None or not is_chunk:
                    continue
                self.bytes += len(data)
                if found[3]:
                    kept.append(data)
                    size += len(data)
                    stamp = said
                elif kept:
                    chunks.append(_chunk(b"".join((*kept, data)), said))
                    kept, size = [], 0
                else:
                    chunks.append(_chunk(data, said))
            yield from chunks
        if kept:
            self._missing(number + 1, b"")
            yield _chunk(b"".join(kept), stamp)

    def _missing(self, number: int, line: bytes) -> None:
        """Count a line that should have been there."""
        self.lines += 1
        self._unreadable(
            number, "the chunk before goes on, as its + says, and its next line is missing", line
        )

    def _other_line(self, number: int, line: bytes, found: re.Match[bytes] | None, size: int) -> None:
        """Count a line that gives no bytes."""
        if len(line) > MAX_LINE:
            self._unreadable(number, f"longer than {MAX_LINE} bytes", line)
        elif not line.strip():
            self.lines_blank += 1
        elif line.startswith(b"#"):
            version = line[len(OPENING) :].split()[:1] if line.startswith(OPENING) else []
            if version and version[0] != b"%d" % VERSION and version[0].isdigit():
                raise CaptureError(
                    f"{self.name}: a serial log of version {version[0][:9].decode()}; this release reads version"
                    f" {VERSION}, a newer one of aces-bus may read it"
                )
            self.lines_comment += 1
        elif found is None:
            self._unreadable(number, "not a line of a serial log: (SECONDS) > [BYTES] HEX", line)
        elif not size:
            self._unreadable(number, "a chunk without bytes", line)
        else:
            announced = int(found[4])
            self._unreadable(number, f"[{announced}] bytes are announced, {size} are there", line)


def _chunk(data: bytes, stamp: tuple[bytes, bytes]) -> Chunk:
    return Chunk(data, None if stamp[0] == b"-" else float(stamp[0]), _WAYS[stamp[1]])
