"""What can-utils' candump writes: its log (`candump -L`, `-l`) and its screen output, also mixed.

1. Every line is one of: frame, unreadable (with its reason), comment, blank.
2. Common log lines are read as columns (`columns.py`); all else goes the slow way (`line.py`), which alone knows the whole
   language, and is put back to its place.
3. Frames, counters and problems do not depend on the way: as objects, as columns, in whatever blocks.

Line by line a common log line takes some 3 µs, any other 4 to 6 µs; as columns it takes 0.05 to 0.1 µs, and 0.5 µs more to
become an object. So files are read as columns; live sources, which come in small blocks, line by line unless columns are
wanted.

*Doubt*: A last line without its LF is read as it is: it may have been cut.
"""

from __future__ import annotations

import re
from binascii import unhexlify
from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING

from ...errors import CaptureError
from ...frame_table import NO_TIME, FrameTable, Ints
from ...frames import Frame
from ..source import BLOCK, MAX_LINE, ByteSource
from ..text.rows import PATIENCE, FrameRow, LineCapture, UnreadableRow
from .line import COLOUR, NAME, RECEIVED, ChannelNames, line_time_ns, read_line

if TYPE_CHECKING:
    from .columns import CandumpColumns

EXAMPLE = "(1436509052.249713) can0 044#2A366C2BBA"

#: What is read at once for columns: enough to outweigh a call, and little enough for the processor's cache.
LARGE = 1 << 20
#: A smaller block is quicker line by line.
SMALL = 1 << 13
_COMMON = re.compile(
    rb"\(([0-9]{1,12}+)\.([0-9]{1,9}+)\) {1,32}+(" + NAME + rb"+) "
    rb"([0-7][0-9A-Fa-f]{2}|[01][0-9A-Fa-f]{7})#([0-9A-Fa-f]{16}|(?:[0-9A-Fa-f]{2}){0,7})( [TR])?+\r?+"
)
_LIKE = re.compile(
    rb"\s*\([0-9][0-9: -]*(?:\.[0-9]+\)\s+\S+|\)\s+\S+\s+[0-9A-Fa-f]{1,8}#)"
    rb"|\s*\S+(?:\s+[TR]X \S \S)?\s+[0-9A-Fa-f]{1,8}\s+[\[{][0-9A-F]{1,4}[\]}]"
)
_DROPPED = re.compile(rb"DROPCOUNT: dropped ([0-9]{1,10}) CAN frame")


class CandumpCapture(LineCapture):
    """Frames of a candump log or of candump's screen output.

    Reading raises `CaptureError` when the source turns out to hold nothing like a candump line.
    """

    format = "candump"
    _ROWS = 1 << 16
    _FEW = 0

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        self._names = ChannelNames()
        self._explained = False  # an error frame came, which -e explains on lines that follow

    @cached_property
    def _columns_of(self) -> CandumpColumns:
        from .columns import CandumpColumns  # NumPy is loaded only where much is read

        return CandumpColumns(self.channels)

    def _lists(self) -> Iterator[list[Frame]]:
        if self.live or len(self._source.head()) < SMALL:
            return self._by_line()
        return super()._lists()  # as columns first: two thirds of the time

    def _by_line(self) -> Iterator[list[Frame]]:
        """Frames of each block, line by line: little work for little blocks, and what the columns are held against."""
        for block in self._source.lines():
            frames: list[Frame] = []
            for line in block[:-1].split(b"\n"):
                if common := _COMMON.fullmatch(line):
                    self.lines += 1
                    frames.append(self._frame(common))
                else:
                    frames += [row.frame for row in self._rows([line])]
            if self._found(len(frames)):
                yield frames
        self._check_end()

    def _blocks(self) -> Iterator[bytes]:
        # What may yet be refused is read in the blocks that `_by_line` reads.
        return self._source.lines(lambda: LARGE if self.is_known else BLOCK)

    def _quick(self, block: bytes) -> tuple[Ints, FrameTable] | None:
        return None if len(block) < SMALL else self._columns_of.read(block)

    def _one(self, line: bytes) -> FrameRow | None:
        if common := _COMMON.fullmatch(line):
            time = int(common[1] + common[2].ljust(9, b"0"))
            return FrameRow(self._frame(common), time if time < -NO_TIME else NO_TIME)
        explained, self._explained = self._explained, False
        text = line.strip()
        is_remark = text.startswith(b"#") or (explained and text != b"" and line.startswith(b"\t"))
        dropped = _DROPPED.match(text)
        if len(line) <= MAX_LINE and (is_remark or dropped):
            self.lines_comment += 1
            self._explained = explained and is_remark
            self.frames_dropped += int(dropped[1]) if dropped and not is_remark else 0
            return None
        row = super()._one(line)
        self._explained = row is not None and (explained or row.frame.is_error_frame)
        return row

    def _frame(self, common: re.Match[bytes]) -> Frame:
        whole, fraction, name, digits, data, suffix = common.groups()
        seconds, way = float(b"%b.%b" % (whole, fraction)), RECEIVED.get(suffix)
        return Frame(
            int(digits, 16), unhexlify(data), seconds, self._names[name], len(digits) == 8, is_rx=way
        )

    def _line(self, text: bytes) -> FrameRow:
        try:
            frame = read_line(text, self._names)
        except UnreadableRow:
            self.is_known = self.is_known or bool(_LIKE.match(text))
            raise
        return FrameRow(frame, line_time_ns(text, frame))

    def _not_one(self) -> CaptureError:
        first = self.problems[0]
        return CaptureError(
            f"{self.name}: not a candump log: line {first.line} is {first.excerpt!r}; a line of one reads {EXAMPLE}"
            " (candump -L can0 > walk.log), and a serial capture needs a serial protocol"
        )


def begins_like_candump(head: bytes) -> bool:
    """Return whether the first line is a common one of a candump log: no other format has such a line."""
    return _COMMON.fullmatch(head[:MAX_LINE].partition(b"\n")[0]) is not None


def looks_like_candump(head: bytes) -> bool:
    """Return whether one of the first lines is at least meant as candump's: even a faulty one tells a log from other
    files.
    """
    lines = (COLOUR.sub(b"", line[:MAX_LINE]) for line in head.split(b"\n", PATIENCE)[:PATIENCE])
    return any(_LIKE.match(line) for line in lines)
