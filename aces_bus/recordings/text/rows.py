"""What readers of line-based formats share: a slow way that knows the whole format, and a quick one for its usual lines.

1. Every line is counted once: frame, comment, blank, another kind, or unreadable with its reason.
2. The quick way takes the lines that it is sure of; the slow way reads the others, and their frames are put back to their
   places. Both ways give the same for a line that the quick one takes: what is quick is a matter of speed alone.
3. Of a last line without its end a frame is believed only if its last byte has two digits: where a file is cut, half a
   byte is another byte. (A line that was cut between two bytes is known by the length that it states.)
4. Lines that change how later ones are read (`_TURN`) are read in order, between the lines before and after them.

5. A line in which another frame's line begins (a cut file was appended to) is unreadable as a whole: neither frame is whole
   for certain, and the second one would vanish. The quick way takes no such line.

A format gives `_line`, the slow way, which returns a `Row`, or None when it has counted the line itself. A format whose
files are large also gives `_quick`, with the columns of `_words`.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from ..._lazy import np
from ...errors import CallerError, CaptureError
from ...frame_table import NO_TIME, FrameTable, joined_tables
from ...frames import Frame
from ..base import REMOTE_AND_ERROR, CanRecording, printable_start
from ..merge import Merge
from ..source import MAX_LINE

if TYPE_CHECKING:
    import numpy.typing as npt

#: Without a line of its format among this many unreadable ones, a file is not of the format.
PATIENCE = 200
#: So often in a block may headers change how lines are read; a file that does it more often is read slowly.
_TRIES = 5
#: Characters at a time. More would leave the processor's cache.
_BLOCK = 1 << 18


_HALF_A_BYTE = re.compile(rb"(?:[\s,;]|0x)[0-9A-Fa-f]\Z")


class UnreadableRow(Exception):
    """The reason, in words."""


class FrameRow(NamedTuple):
    """A frame without its time stamp, and its instant in nanoseconds."""

    frame: Frame
    time: int = NO_TIME


class LineCapture(CanRecording):
    """Reads line after line; see the top of this file.

    Reading raises `CaptureError` when the source holds no line of the format at all.
    """

    _TURN: ClassVar[re.Pattern[bytes] | None] = None
    #: How the line of a frame begins; None: no other field of the format may hold what would be the next line.
    _BEGINS: ClassVar[re.Pattern[bytes] | None] = None

    #: Tables of a file have at least so many rows, but the last.
    _ROWS: ClassVar = 8192
    #: So few characters are not worth arrays.
    _FEW: ClassVar = 800

    #: Something of the format was seen.
    is_known = False
    _is_last = False  # what comes is a line without its end

    @abstractmethod
    def _line(self, text: bytes) -> FrameRow | None:
        """Return the frame of a line without blanks around; None when the line was counted. Raises `UnreadableRow`."""

    def _quick(self, block: bytes) -> tuple[npt.NDArray[np.bool_], FrameTable] | None:
        """Return which of the lines are usual, and their frames in a table, one each; None when none can be, as things
        are.
        """
        return None

    # What the lines are counted as.

    def _comment(self) -> None:
        self.lines_comment += 1
        self.is_known = True

    def _other(self, kind: str) -> None:
        self._other_kind(kind)
        self.is_known = True

    def _tables(self) -> Iterator[FrameTable]:
        return joined_tables(self._block_tables(), self._ROWS, is_live=self.live)

    def _block_tables(self) -> Iterator[FrameTable]:
        for block in self._blocks():
            tables: list[FrameTable] = []
            self._read(block, tables)
            self._found(sum(map(len, tables)))
            yield from tables
        self._check_end()

    def _found(self, count: int) -> int:
        """Count the frames of a block; raises `CaptureError` when nothing of the format comes."""
        self.frames += count
        self.is_known = self.is_known or bool(count)
        if not self.is_known and self.lines_unreadable >= PATIENCE:
            raise self._not_one()
        return count

    def _check_end(self) -> None:
        if not self.is_known and self.lines_unreadable:
            raise self._not_one()

    def _blocks(self) -> Iterator[bytes]:
        """Yield blocks of whole lines: of a live source what is there, of a file enough for arrays to be worth it."""
        kept: list[bytes] = []
        size = 0
        for block in self._source.lines():
            if self._source.is_open_ended:
                if kept:
                    yield b"".join(kept)
                self._is_last = True
                kept, size = [], 0
            kept.append(block)
            size += len(block)
            if size >= _BLOCK or self.live:
                yield b"".join(kept)
                kept, size = [], 0
        if kept:
            yield b"".join(kept)

    def _read(self, block: bytes, tables: list[FrameTable]) -> None:
        """Add the frames of a block of whole lines; counts everything but them."""
        for _ in range(_TRIES):
            found = self._quick(block) if len(block) > self._FEW and not self._is_last else None
            if found is None or not found[0].any():
                break
            block = self._mixed(block, *found, tables)
        if block:
            self._slowly(block[:-1].split(b"\n"), tables)

    def _mixed(
        self, block: bytes, usual: npt.NDArray[np.bool_], table: FrameTable, tables: list[FrameTable]
    ) -> bytes:
        """Read the block up to the first change between usual and unusual lines, and the line next to it;
        return the rest.
        """
        if usual.all():
            self.lines += len(usual)
            tables.append(table)
            return b""
        ends = np.flatnonzero(np.frombuffer(block, np.uint8) == 0x0A)
        starts = np.concatenate([[0], ends[:-1] + 1])
        unusual = np.flatnonzero(~usual)
        rows: list[FrameRow] = []
        places: list[int] = []
        before, end = self.lines, len(ends)
        for place, start, stop in zip(
            *(of.tolist() for of in (unusual, starts[unusual], ends[unusual])), strict=True
        ):
            text = block[start:stop]
            if self._TURN is not None and self._TURN.match(text):
                end = place
                break
            self.lines = before + place + 1
            if (row := self._one(text)) is not None:
                rows.append(row)
                places.append(place)
        self.lines = before + end
        common = np.flatnonzero(usual[:end])
        table = table.take(slice(0, len(common)))
        if rows:
            odd = np.array(places, np.int64)
            table = Merge.in_order(end, [common, odd], [table, self._table(rows)])
        if len(table):
            tables.append(table)
        turns: list[bytes] = []
        for start, stop in zip(starts[end:].tolist(), ends[end:].tolist(), strict=True):
            if self._TURN is None or not self._TURN.match(block[start:stop]):
                break
            turns.append(block[start:stop])
        self._slowly(turns, tables)
        rest = end + len(turns)
        return block[starts[rest] :] if rest < len(starts) else b""

    def _slowly(self, lines: Sequence[bytes], tables: list[FrameTable]) -> None:
        if rows := self._rows(lines):
            tables.append(self._table(rows))

    def _rows(self, lines: Sequence[bytes]) -> list[FrameRow]:
        rows: list[FrameRow] = []
        for line in lines:
            self.lines += 1
            if (row := self._one(line)) is not None:
                rows.append(row)
        return rows

    def _one(self, line: bytes) -> FrameRow | None:
        """Read any line; count it unless it is a frame."""
        text = line.strip()
        if len(line) > MAX_LINE:
            self._unreadable(self.lines, f"longer than {MAX_LINE} bytes", line)
        elif not text:
            self.lines_blank += 1
        elif b"\r" in text:
            self._unreadable(
                self.lines,
                "a carriage return within the line; lines end with a line feed: tr '\\r' '\\n'",
                line,
            )
        else:
            try:
                self._check_single(text)
                row = self._line(text)
                if self._is_last and row is not None and row.frame.data and _HALF_A_BYTE.search(text):
                    raise UnreadableRow("the line has no end, and its last byte one digit: it was cut")
                if row is not None and not NO_TIME <= row.time < -NO_TIME:
                    raise UnreadableRow("the time is out of range")
                return row
            except (UnreadableRow, CallerError) as error:  # CallerError: a frame that cannot exist
                self._unreadable(self.lines, str(error), line)
        return None

    def _check_single(self, text: bytes) -> None:
        """Raise `UnreadableRow` where another frame's line begins behind this one's beginning."""
        if self._BEGINS is None:
            return
        own = self._BEGINS.match(text)
        found = self._BEGINS.search(text, own.end() if own is not None else 0)
        if found is not None and text[: found.start()].strip(b"/;# \t"):  # else a frame that is commented out
            raise UnreadableRow(f"two lines run together at column {found.start() + 1}")

    def _table(self, rows: list[FrameRow]) -> FrameTable:
        table = FrameTable.from_frames([row.frame for row in rows], self.channels)
        return replace(table, time=np.array([row.time for row in rows], np.int64))

    def _not_one(self) -> CaptureError:
        first = self.problems[0]
        return CaptureError(
            f"{self.name}: not a {self.format}: line {first.line} is {printable_start(first.excerpt.encode())!r}"
        )


# ---- numbers in a line ---------------------------------------------------------------------------------------------


class RowText:
    """Cells of a row as values; a cell that is not a value raises `UnreadableRow`."""

    #: Starts of recordings lie within ±2^62 ns of 1970 (until 2116), so that start and offset fit 64 bits together.
    MAX_ORIGIN = 1 << 62
    CLASSIC_LENGTHS: ClassVar[dict[int, int]] = {code: min(code, 8) for code in range(16)}
    FD_LENGTHS_BY_CODE: ClassVar[dict[int, int]] = dict(
        enumerate((0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64))
    )

    @staticmethod
    def nanoseconds(text: bytes, unit: int = 1_000_000_000) -> int:
        """Return a decimal number of units of so many nanoseconds, exact to the last digit. Raises `UnreadableRow`.

        >>> ns = RowText.nanoseconds
        >>> ns(b"1.25"), ns(b"-17.5", 1_000_000), ns(b"1e-06")
        (1250000000, -17500000, 1000)
        """
        whole, _, fraction = text.partition(b".")
        if (
            whole.isdigit()
            and len(whole) <= 18
            and (fraction.isdigit() or not fraction)
            and len(fraction) <= 18
        ):
            return round_half_even(int(whole + fraction) * unit, 10 ** len(fraction))
        return _any_number(text, unit)

    @staticmethod
    def integer(text: bytes, base: int, what: str) -> int:
        """Parse digits of a base, without sign. Raises `UnreadableRow`."""
        digits = text
        if base == 16 and text[:2] in (b"0x", b"0X"):
            digits = text[2:]
        if not digits.isalnum() or len(digits) > 16:
            raise UnreadableRow(f"{what} {printable_start(text)!r} is not a {_BASES[base]} number")
        try:
            return int(digits, base)
        except ValueError:
            raise UnreadableRow(f"{what} {printable_start(text)!r} is not a {_BASES[base]} number") from None

    @staticmethod
    def data(cells: Sequence[bytes], size: int, base: int = 16) -> bytes:
        """Parse `size` bytes of cells with a number each; raise `UnreadableRow` when there are fewer, or one is
        not a byte.
        """
        there = next((place for place, cell in enumerate(cells) if not cell), len(cells))
        if there < size:
            raise UnreadableRow(f"{size} bytes are announced, {there} are there")
        out = bytearray()
        for cell in cells[:size]:
            value = RowText.integer(cell, base, "byte")
            if value > 255:
                raise UnreadableRow(f"byte {printable_start(cell)} is more than 255")
            out.append(value)
        return bytes(out)

    @staticmethod
    def is_received(text: bytes) -> bool:
        """Return which way Rx and Tx are, in whatever case. Raises `UnreadableRow`."""
        if (found := _WAYS.get(text.lower())) is None:
            raise UnreadableRow(f"direction {printable_start(text)!r} is neither Rx nor Tx")
        return found

    @staticmethod
    def check_remote(is_remote: bool, is_error: bool, size: int) -> None:
        """Raise `UnreadableRow` for a remote frame that cannot exist."""
        if is_remote and is_error:
            raise UnreadableRow(REMOTE_AND_ERROR)
        if is_remote and size > 8:
            raise UnreadableRow(f"a remote frame asks for at most 8 bytes, not {size}")

    @staticmethod
    def one_less(number: int) -> str | None:
        """Return the name of a channel that a file counts from 1: ours count from 0. None for a channel 0, which there is
        not.
        """
        return str(number - 1) if number > 0 else None


def round_half_even(number: int, scale: int) -> int:
    """Return `number / scale` as the nearest integer."""
    found, rest = divmod(number, scale)
    twice = 2 * rest
    return found + (twice > scale or (twice == scale and found & 1))


_NUMBER = re.compile(rb"[+-]?(?:[0-9]{1,30}(?:\.[0-9]{0,30})?|\.[0-9]{1,30})(?:[eE][+-]?[0-9]{1,3})?")


def _any_number(text: bytes, unit: int) -> int:
    from decimal import Decimal

    if not _NUMBER.fullmatch(text):
        raise UnreadableRow(f"time {printable_start(text)!r} is not a number")
    return int((Decimal(text.decode()) * unit).to_integral_value())


_BASES = {10: "decimal", 16: "hexadecimal"}


_WAYS = {b"rx": True, b"tx": False}
