"""What can-utils' candump writes: its log (`candump -L`, `-l`) and its screen output, also mixed.

1. Every line is one of: frame, unreadable (with its reason), comment, blank.
2. One pattern consumes one line a match: its first alternative is the common log line, its last takes any line. What
   the first accepts always makes a frame; all else goes the slow way (`line.py`), which alone knows the whole
   language.
3. Frames, counters and problems do not depend on the way: as objects, as columns, in whatever blocks.

Line by line the common log line takes 1 to 1.5 µs, any other 4 to 6 µs; as columns (`columns.py`) it takes 0.05 to
0.1 µs, and 0.5 µs more to become an object. So files are read as columns, in which uncommon lines go line by line and
are merged back to their places; live sources, which come in small blocks, are read line by line unless columns are
wanted.

*Doubt*: A last line without its LF is taken as it stands: it may have been cut.
"""

from __future__ import annotations

import re
from binascii import unhexlify
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ...errors import CaptureError
from ...frame_table import FrameTable
from ...frames import Frame
from ..base import CanRecording
from ..merge import merge_in_order
from ..source import BLOCK, MAX_LINE, ByteSource
from .columns import CandumpColumns, ParsedLines
from .line import COLOUR, NAME, RECEIVED, ChannelNames, UnreadableLine, line_time_ns, read_line

#: A file without anything like a candump line in this many lines is not a candump log.
PATIENCE = 200
EXAMPLE = "(1436509052.249713) can0 044#2A366C2BBA"

#: What is read at once for columns: enough to outweigh a call, and little enough for the processor's cache.
LARGE = 1 << 20
#: A smaller block is quicker line by line.
SMALL = 1 << 13
#: Rows of a table, unless the source is live or ends.
TABLE_ROWS = 1 << 16

_LINE = re.compile(
    rb"(?:\(([0-9]{1,12}+\.[0-9]{1,9}+)\) {1,32}+(" + NAME + rb"+) "
    rb"([0-7][0-9A-Fa-f]{2}|[01][0-9A-Fa-f]{7})#([0-9A-Fa-f]{16}|(?:[0-9A-Fa-f]{2}){0,7})( [TR])?+\r?+"
    rb"|([^\n]*))\n"
)
_LIKE = re.compile(
    rb"\s*\([0-9][0-9: -]*(?:\.[0-9]+\)\s+\S+|\)\s+\S+\s+[0-9A-Fa-f]{1,8}#)"
    rb"|\s*\S+(?:\s+[TR]X \S \S)?\s+[0-9A-Fa-f]{1,8}\s+[\[{][0-9A-F]{1,4}[\]}]"
)
_DROPPED = re.compile(rb"DROPCOUNT: dropped ([0-9]{1,10}) CAN frame")


class _Identifiers(dict[bytes, tuple[int, bool]]):
    """Digits → number and whether they are eight; bounded, as a hostile log may use all identifiers."""

    def __missing__(self, digits: bytes) -> tuple[int, bool]:
        if len(self) >= 4096:
            self.clear()
        found = self[digits] = int(digits, 16), len(digits) == 8
        return found


class CandumpCapture(CanRecording):
    """Frames of a candump log or of candump's screen output.

    Reading raises `CaptureError` when the source turns out to hold nothing like a candump line.
    """

    format = "candump"

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        self._identifiers, self._names = _Identifiers(), ChannelNames()
        #: Something like a candump line was seen.
        self.is_known = False
        self._explained = False  # an error frame came, which -e explains on lines that follow

    # ---- as objects

    def _lists(self) -> Iterator[list[Frame]]:
        if self.live:
            yield from self._by_line()
        else:  # as columns first: two thirds of the time
            for table in self._block_tables():
                yield table.frames()

    def _by_line(self) -> Iterator[list[Frame]]:
        """Frames of each block, line by line: little work for little blocks, and what the columns are held against."""
        for block in self._source.lines():
            frames = self._read(block)
            self._check_patience()
            if frames:
                yield frames
        self._check_end()

    def _read(self, block: bytes) -> list[Frame]:
        """The frames of a block of whole lines; counts everything."""
        identifiers, names, received = self._identifiers, self._names, RECEIVED.get
        rows = _LINE.findall(block)
        frames: list[Frame] = []
        add = frames.append
        elsewhere = 0  # lines so far that gave no frame
        for stamp, channel, digits, data, suffix, other in rows:
            if digits:
                identifier, extended = identifiers[digits]
                add(
                    Frame(
                        identifier,
                        unhexlify(data),
                        float(stamp),
                        names[channel],
                        extended,
                        False,
                        False,
                        False,
                        False,
                        False,
                        received(suffix),
                    )
                )
            elif frame := self._other(other, self.lines + len(frames) + elsewhere + 1):
                add(frame)
            else:
                elsewhere += 1
        self.lines += len(rows)
        self.frames += len(frames)
        self.is_known = self.is_known or bool(frames)
        return frames

    def _other(self, line: bytes, number: int) -> Frame | None:
        """Any line at all: its frame, or None when it was counted as something else."""
        explained, self._explained = self._explained, False
        text = line.strip()
        if len(line) > MAX_LINE:
            self._unreadable(number, f"longer than {MAX_LINE} bytes", line)
        elif not text:
            self.lines_blank += 1
        elif text.startswith(b"#") or (explained and line.startswith(b"\t")):
            self.lines_comment += 1
            self._explained = explained
        elif text.startswith(b"DROP") and (found := _DROPPED.match(text)):
            self.lines_comment += 1
            self.frames_dropped += int(found[1])
        else:
            try:
                frame = read_line(text, self._names)
            except UnreadableLine as reason:
                self.is_known = self.is_known or bool(_LIKE.match(line))
                self._unreadable(number, str(reason), line)
            else:
                self._explained = explained or frame.is_error_frame
                return frame
        return None

    # ---- as columns

    def _tables(self) -> Iterator[FrameTable]:
        pending: list[FrameTable] = []
        rows = 0
        try:
            for table in self._block_tables():
                pending.append(table)
                rows += len(table)
                if rows >= TABLE_ROWS or self.live:
                    yield FrameTable.concat(pending)
                    pending, rows = [], 0
        except CaptureError:
            if pending:  # what was read is given first
                yield FrameTable.concat(pending)
            raise
        if pending:
            yield FrameTable.concat(pending)

    def _block_tables(self) -> Iterator[FrameTable]:
        """The frames of each block; none of the tables is empty."""
        columns = CandumpColumns(self.channels)
        # What may yet be refused is read in the blocks that `_by_line` reads.
        for block in self._source.lines(lambda: LARGE if self.is_known else BLOCK):
            table = self._read_table(block, columns)
            self._check_patience()
            if len(table):
                yield table
        self._check_end()

    def _read_table(self, block: bytes, columns: CandumpColumns) -> FrameTable:
        """The frames of a block of whole lines as columns; counts everything."""
        if len(block) < SMALL:
            lines = block.count(b"\n")
            common: list[ParsedLines] = []
            rest: Sequence[int] = range(lines)
            text = block
        else:
            lines, common, others = columns.read(block)
            self.is_known = self.is_known or bool(common)
            rest, text = others.places, others.text
        parts = [rows.table for rows in common]
        places = [rows.places for rows in common]
        if text:
            found, table = self._one_by_one(text, rest)
            if len(table):
                parts.append(table)
                places.append(np.array(found, np.int64))
        self.lines += lines
        whole = merge_in_order(lines, places, parts) if parts else FrameTable.empty(self.channels)
        self.frames += len(whole)
        self.is_known = self.is_known or bool(len(whole))
        return whole

    def _one_by_one(self, text: bytes, places: Sequence[int]) -> tuple[list[int], FrameTable]:
        """The frames of whole lines that stand at these places (from 0) of the block, and the places of the frames."""
        found: list[int] = []
        frames: list[Frame] = []
        times: list[int] = []
        for place, (stamp, channel, digits, data, suffix, other) in zip(places, _rows(text), strict=True):
            if digits:
                identifier, extended = self._identifiers[digits]
                frame: Frame | None = Frame(
                    identifier,
                    unhexlify(data),
                    0.0,
                    self._names[channel],
                    extended,
                    is_rx=RECEIVED.get(suffix),
                )
                line = b"(" + stamp + b")"
            else:
                frame = self._other(other, self.lines + place + 1)
                line = other.strip()
            if frame is not None:
                found.append(place)
                frames.append(frame)
                times.append(line_time_ns(line, frame))
        table = FrameTable.from_frames(frames, self.channels)
        return found, replace(table, time=np.array(times, np.int64))

    # ---- whether it is one at all

    def _check_patience(self) -> None:
        if not self.is_known and self.lines_unreadable >= PATIENCE:
            raise self._not_a_log()

    def _check_end(self) -> None:
        if not self.is_known and self.lines_unreadable:
            raise self._not_a_log()

    def _not_a_log(self) -> CaptureError:
        first = self.problems[0]
        return not_a_log(self.name, f"line {first.line} is {first.excerpt!r}")


def _rows(text: bytes) -> Iterator[tuple[bytes, ...]]:
    """What the pattern finds, with the memory of one small block."""
    start = 0
    while start < len(text):
        end = text.rfind(b"\n", start, start + BLOCK) + 1 or text.index(b"\n", start) + 1
        yield from _LINE.findall(text, start, end)
        start = end


def not_a_log(name: str, what: str) -> CaptureError:
    """One message for all that is given as a CAN recording and is none."""
    return CaptureError(
        f"{name}: not a candump log: {what}; a line of one reads {EXAMPLE} (candump -L can0 > walk.log), "
        "and a serial capture needs a serial protocol"
    )


def looks_like_candump(head: bytes) -> bool:
    """Whether one of the first lines is at least meant as candump's: even a faulty one tells a log from other files."""
    lines = (COLOUR.sub(b"", line[:MAX_LINE]) for line in head.split(b"\n", PATIENCE)[:PATIENCE])
    return any(_LIKE.match(line) for line in lines)


def only_remarks(head: bytes) -> bool:
    """Whether the lines so far are all blank or comments: nothing that says what follows."""
    return all(not line or line.startswith(b"#") for line in map(bytes.strip, head.split(b"\n")))
