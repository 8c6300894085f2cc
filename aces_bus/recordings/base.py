"""What every capture offers, whatever its format.

1. A capture is read once, front to back, like the file it is.
2. Counters cover what has been read so far, and are up to date before anything is handed out.
3. `lines` is the sum of the lines that gave something, and of the unreadable, comment, blank and other ones. Formats
   that have objects or rows instead of lines count those.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from types import TracebackType
from typing import ClassVar, Literal, NamedTuple, Self

from .._lazy import np
from ..errors import CaptureError
from ..frame_table import Channels, FrameTable
from ..frames import Frame
from .source import ByteSource

Link = Literal["can", "serial"]
Direction = Literal["to device", "from device"]

REMOTE_AND_ERROR = "a frame is a remote frame or an error frame, not both"
#: Enough to see what is wrong with a file; the counter has the rest.
PROBLEMS_KEPT = 5
EXCERPT = 80


class UnreadableEntry(NamedTuple):
    """A line or object that could not be read: its number (from 1), why, and how it begins."""

    line: int
    reason: str
    excerpt: str

    def __str__(self) -> str:
        return f"{self.line}: {self.reason}" + (f": {self.excerpt!r}" if self.excerpt else "")


class Chunk(NamedTuple):
    """Bytes of a serial line. `time` is in seconds, None when the capture does not say; so is `direction`."""

    data: bytes
    time: float | None = None
    direction: Direction | None = None


def printable_start(line: bytes) -> str:
    """Return the beginning of a line, safe to print on a terminal."""
    text = line[:EXCERPT].decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class Recording(ABC):
    """Name, link, format, counters; a context manager that closes the file."""

    link: ClassVar[Link]
    format: ClassVar[str]

    def __init__(self, source: ByteSource) -> None:
        self._source = source
        self.name = source.name
        self.lines = 0
        self.lines_unreadable = 0
        self.lines_comment = 0
        self.lines_blank = 0
        #: What the file holds beside frames, by kind and in words: {"LIN frames": 12, "bus statistics": 3}.
        self.others: dict[str, int] = {}
        self.problems: list[UnreadableEntry] = []

    @property
    def live(self) -> bool:
        """True if this is a pipe or a device, and not a file."""
        return self._source.live

    @property
    def packing(self) -> str:
        """ "gzip" or "zstandard" when that is how the bytes are stored, otherwise ""."""
        return self._source.packing

    def close(self) -> None:
        """Close the file, if it was opened here; reading to the end does so too."""
        self._source.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _other_kind(self, kind: str, count: int = 1) -> None:
        """Count what is readable and no frame."""
        self.others[kind] = self.others.get(kind, 0) + count

    def _unreadable(self, number: int, reason: str, line: bytes) -> None:
        self.lines_unreadable += 1
        if len(self.problems) < PROBLEMS_KEPT:
            self.problems.append(UnreadableEntry(number, reason, printable_start(line)))


class CanRecording(Recording):
    """CAN frames in the order of the recording."""

    link = "can"

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        self.frames = 0
        #: Frames that the recording program itself says it lost.
        self.frames_dropped = 0
        #: The names of channels by the numbers that tables use.
        self.channels = Channels()
        self._stream: Iterator[list[Frame]] | None = None
        self._columns: Iterator[FrameTable] | None = None

    # A format implements one of these two, or both where each is worth its own code.

    def _lists(self) -> Iterator[list[Frame]]:
        """Yield frames as they come out of each block that was read; none of the lists is empty."""
        for table in self._tables():
            yield table.frames()

    def _tables(self) -> Iterator[FrameTable]:
        """Yield the same as columns, with the channels of `self.channels`; none of the tables is empty."""
        for frames in self._lists():
            yield FrameTable.from_frames(frames, self.channels)

    def _pieces(self) -> Iterator[list[Frame]]:
        if self._stream is None:
            self._stream = self._lists()
        return self._stream

    def tables(self) -> Iterator[FrameTable]:
        """Return all frames as columns, in tables of some ten thousand rows; instead of iterating, not beside it."""
        if self._columns is None:
            self._columns = self._tables()
        return self._columns

    def __iter__(self) -> Iterator[Frame]:
        for frames in self._pieces():
            yield from frames

    def batches(self, n: int = 1024) -> Iterator[list[Frame]]:
        """Yield lists of at most `n` frames: full lists from a file; from a live source the frames that are
        there without waiting.
        """
        kept: list[Frame] = []
        try:
            for frames in self._pieces():
                kept += frames
                start = 0
                while len(kept) - start >= n:
                    yield kept[start : start + n]
                    start += n
                del kept[:start]
                if kept and self.live:
                    yield kept
                    kept = []
        except CaptureError:  # what was read before comes first
            if kept:
                yield kept
            raise
        if kept:
            yield kept


class SerialRecording(Recording):
    """Bytes of a serial line in the order of the recording."""

    link = "serial"

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        self.bytes = 0
        self._stream: Iterator[Chunk] | None = None

    @abstractmethod
    def _chunks(self) -> Iterator[Chunk]:
        """Yield chunks of at most 64 KiB, none of them empty."""

    def __iter__(self) -> Iterator[Chunk]:
        if self._stream is None:
            self._stream = self._chunks()
        return self._stream


# Reading in blocks makes and drops the same few arrays again and again. glibc gives the top of its heap back when more
# than twice its threshold is free, and asks for zeroed pages again with the next block; those page faults took up to half of
# the time. The threshold follows the largest block that was ever mapped and freed, so one is: it is never touched, and
# costs nothing. What is kept is bounded by it. *Fact*: mallopt(3), M_MMAP_THRESHOLD, "dynamic mmap threshold".
_KEPT = 1 << 24


def keep_freed_memory() -> None:
    """Ask the C library to keep some freed memory for the next block; where it works otherwise, nothing changes."""
    np.empty(_KEPT, np.uint8)
