"""The records of an MDF 4 file, as bytes.

1. In memory is what was asked for, and of packed records one block.
2. Reading stops at the first thing that is wrong; `fault` says what, and everything before it was given.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np

from aces_bus.frame_table import Ints
from aces_bus.recordings.inflate import inflate_first

from .tree import VARIABLE_GROUP, DataGroup, Segment

_PIECE = 1 << 22
#: A run of records of one size is looked for at least so far ahead, and where there is none, so many are taken one by one.
_AHEAD, _SINGLE = 64, 1024
#: In place of the size of records that each have their own.
_OWN = -1
#: Bytes of variable length that are at hand at once.
_WINDOW = 1 << 26


class Bytes:
    """The bytes of segments, one after the other."""

    def __init__(self, file: BinaryIO, segments: Sequence[Segment], fault: str = "") -> None:
        self._file, self._segments = file, segments
        self.size = sum(segment.size for segment in segments)
        self._behind = fault
        self._number = self._at = 0
        self._unpacked = b""
        self.fault = ""

    def stop(self, fault: str) -> None:
        """Give nothing more."""
        self.fault, self._number = fault, len(self._segments)

    def fill(self, view: memoryview) -> int:
        """Fill it from the start; how many bytes there were, less than asked for only at the end."""
        done = 0
        while done < len(view) and self._number < len(self._segments):
            segment = self._segments[self._number]
            size = min(len(view) - done, segment.size - self._at)
            if segment.packing is None:
                self._file.seek(segment.at + self._at)
                size = self._read(view[done : done + size])
            else:
                if not self._at:
                    try:
                        self._unpacked = unpack_segment(self._file, segment)
                    except ValueError as error:
                        self._unpacked, self.fault = b"", str(error)
                size = min(size, len(self._unpacked) - self._at)
                view[done : done + size] = self._unpacked[self._at : self._at + size]
            done += size
            self._at += size
            if self.fault:
                self._number = len(self._segments)
            elif self._at == segment.size:
                self._number, self._at, self._unpacked = self._number + 1, 0, b""
        if done < len(view):
            self.fault = self.fault or self._behind
        return done

    def _read(self, view: memoryview) -> int:
        file: Any = self._file
        done = 0
        while done < len(view):
            count: int = file.readinto(view[done:])
            if not count:
                self.fault = "the file became shorter while it was read"
                break
            done += count
        return done


def unpack_segment(file: BinaryIO, segment: Segment) -> bytes:
    """Return the bytes of a packed segment; raises `ValueError` when it is damaged."""
    file.seek(segment.at)
    size, columns = segment.size, segment.packing
    try:
        data = inflate_first(file.read(segment.stored), size + 1)
    except zlib.error as error:
        raise ValueError(f"packed records are damaged: {error}") from None
    if len(data) != size:
        raise ValueError(f"packed records should be {size} bytes and are {len(data)} or more")
    if columns:  # a table was packed column by column; what is left of a row is behind it
        rows = size // columns
        table = np.frombuffer(data, np.uint8, rows * columns).reshape(columns, rows)
        data = table.T.tobytes() + data[rows * columns :]
    return data


class Variable:
    """Bytes of variable length, each with its length in front, from anywhere in the bytes of segments.

    1. What is at hand is one unpacked block and one window of the bytes, and all windows together are not more than some
       times the bytes.
    """

    def __init__(self, file: BinaryIO, segments: Sequence[Segment]) -> None:
        self._file, self._segments = file, segments
        sizes = [segment.size for segment in segments]
        self._ends = np.cumsum(sizes, dtype=np.int64)
        self.size = sum(sizes)
        self._left = 8 * self.size + _WINDOW
        self._number, self._unpacked = -1, b""

    def window(self, start: int, end: int) -> bytes:
        """Return a window of bytes, fewer at the end. Raises `ValueError` when they cannot be read."""
        end = min(end, self.size)
        self._left -= max(0, end - start)
        if end - start > _WINDOW or self._left < 0:
            raise ValueError("its data bytes of variable length are scattered too far")
        parts: list[bytes] = []
        number = int(np.searchsorted(self._ends, start, side="right"))
        while start < end:
            segment = self._segments[number]
            at = start - (int(self._ends[number]) - segment.size)
            size = min(end - start, segment.size - at)
            if segment.packing is None:
                self._file.seek(segment.at + at)
                parts.append(self._file.read(size))
            else:
                if number != self._number:
                    self._left -= segment.size
                    self._number, self._unpacked = number, unpack_segment(self._file, segment)
                parts.append(self._unpacked[at : at + size])
            start, number = start + size, number + 1
        return b"".join(parts)


def values_at(window: Callable[[int, int], bytes], size: int, offsets: Ints) -> tuple[Ints, Ints]:
    """Return bytes of variable length at offsets: their lengths, -1 for what does not lie in the `size`
    bytes, and rows of them.

    Rows have 8 bytes, or 64; of longer bytes the first 64.
    """
    n = len(offsets)
    lengths = np.full(n, -1, np.int64)
    is_in = (offsets >= 0) & (offsets <= size - 4)
    if not is_in.any():
        return lengths, np.zeros((n, 8), np.uint8)
    first, last = int(offsets[is_in].min()), int(offsets[is_in].max())
    raw = window(first, last + 4 + 64)
    stream = np.frombuffer(raw.ljust(last + 4 + 64 - first, b"\0"), np.uint8)
    places = np.where(is_in, offsets.astype(np.int64) - first, 0)
    found = numbers_of(stream[places[:, None] + np.arange(4)]).astype(np.int64)
    is_in &= (places + first + 4 + found <= size) & (places + 4 + np.minimum(found, 64) <= len(raw))
    lengths[is_in] = found[is_in]
    width = 8 if int(lengths.max()) <= 8 else 64
    return lengths, stream[places[:, None] + 4 + np.arange(width)]


def record_arrays(source: Bytes, size: int, total: int | None, rows: int) -> Iterator[Ints]:
    """Yield records as arrays (n, size) of bytes, n ≤ `rows`, at most `total` records; each array overwrites
    the last.
    """
    rows = min(rows, source.size // size + 1)
    buffer = bytearray(size * (rows if total is None else min(rows, total)))
    left = total
    while left is None or left:
        count = rows if left is None else min(left, rows)
        got = source.fill(memoryview(buffer)[: count * size]) // size
        if got:
            yield np.frombuffer(buffer, np.uint8, got * size).reshape(got, size)
        if got < count:
            return
        left = None if left is None else left - got


def numbers_of(rows: Ints) -> Ints:
    """Return the numbers that rows of 1 to 8 bytes are, the lowest byte first."""
    numbers = np.zeros((len(rows), 8), np.uint8)
    numbers[:, : rows.shape[1]] = rows
    return numbers.view("<u8")[:, 0]


class Sorted:
    """The records of a stream by their groups: those of wanted groups in a file of their own, all of them counted.

    Raises `OSError` when that file cannot be written, and `OverflowError` when it gets longer than `most`.
    """

    def __init__(
        self, file: BinaryIO, stream: DataGroup, wanted: Sequence[int], out: BinaryIO, most: int
    ) -> None:
        self.segments: dict[int, list[Segment]] = {number: [] for number in wanted}
        self.counts: dict[int, int] = {group.number: 0 for group in stream.groups}
        #: Bytes at the end that are not a whole record.
        self.rest = 0
        self._variable = {group.number for group in stream.groups if group.flags & VARIABLE_GROUP}
        self.fault = ""
        self._out, self._most, self._end = out, most, out.seek(0, 2)
        sizes = {
            group.number: None if group.number in self._variable else group.size for group in stream.groups
        }
        self._finder = RecordFinder(stream.number_bytes, sizes)
        source = Bytes(file, stream.segments, stream.fault)
        longest = stream.number_bytes + max((size or 4 for size in sizes.values()), default=0)
        buffer = bytearray(min(max(_PIECE, 2 * longest), source.size + longest + 1))
        kept = 0
        while not self.fault:
            end = kept + source.fill(memoryview(buffer)[kept:])
            done = self._split(buffer, end)
            if not done and end == len(buffer):
                self.fault = self.fault or f"a record of more than {end} bytes"
            if end < len(buffer):
                self.fault, self.rest = self.fault or source.fault, end - done
                return
            buffer[: end - done] = buffer[done:end]
            kept = end - done

    def _split(self, buffer: bytearray, end: int) -> int:
        """Store the whole records of the buffer; where the first begins that is not whole."""
        finder = self._finder
        chunk = np.frombuffer(buffer, np.uint8, end)
        starts, places, at = finder.find(buffer, chunk)
        if at + finder.width <= end and finder.number(buffer, at) not in finder.steps:
            self.fault = f"a record of a group {finder.number(buffer, at)} that there is not"
        for place, count in enumerate(np.bincount(places, minlength=len(finder.numbers)).tolist()):
            group = finder.numbers[place]
            self.counts[group] += count
            if count and group in self.segments:
                rows = starts if count == len(starts) else starts[places == place]
                if group in self._variable:
                    self._store(group, finder.variable_records(buffer, chunk, rows))
                    continue
                windows = np.lib.stride_tricks.sliding_window_view(chunk, finder.steps[group] - finder.width)
                self._store(group, windows[rows + finder.width].tobytes())
        return at

    def _store(self, group: int, data: bytes) -> None:
        if self._end + len(data) > self._most:
            raise OverflowError
        self._out.seek(self._end)
        self._out.write(data)
        pieces = self.segments[group]
        if pieces and pieces[-1].at + pieces[-1].size == self._end:
            size = pieces[-1].size + len(data)
            pieces[-1] = Segment(pieces[-1].at, size, size)
        else:
            pieces.append(Segment(self._end, len(data), len(data)))
        self._end += len(data)


class RecordFinder:
    """Where records begin that have their group's number, of `width` bytes, in front. `sizes` are by that number; None
    where each record has its own in front, of 4 bytes.

    A group's place is that of its number among `numbers`, which go up; `steps` are from one record to the next.
    """

    def __init__(self, width: int, sizes: Mapping[int, int | None]) -> None:
        self.width = width
        self.numbers = sorted(sizes)
        self.steps = {number: _OWN if size is None else width + size for number, size in sizes.items()}
        self._format = struct.Struct({1: "<B", 2: "<H", 4: "<I", 8: "<Q"}[width])
        self._known = np.array(self.numbers, np.uint64)
        self._steps = np.array([*(self.steps[number] for number in self.numbers), 0], np.int64)
        self._table = np.full(256, len(sizes), np.int64)
        for place, number in enumerate(self.numbers):
            if number < 256:
                self._table[number] = place

    def number(self, buffer: bytearray, at: int) -> int:
        """Return the number at this place."""
        return int(self._format.unpack_from(buffer, at)[0])

    def _step(self, buffer: bytearray, at: int, end: int) -> int:
        """Return the step from the record that begins there to the next; 0 where there is none, or it is not whole."""
        step = self.steps.get(self.number(buffer, at), 0)
        if step == _OWN:
            if at + self.width + 4 > end:
                return 0
            step = self.width + 4 + int.from_bytes(buffer[at + self.width : at + self.width + 4], "little")
        return step if at + step <= end else 0

    def variable_records(self, buffer: bytearray, chunk: Ints, rows: Ints) -> bytes:
        """Return the records of variable length that begin there, with their lengths, one after the other."""
        starts = rows + self.width
        ends = starts + 4 + numbers_of(chunk[starts[:, None] + np.arange(4)]).astype(np.int64)
        view = memoryview(buffer)
        pairs = zip(starts.tolist(), ends.tolist(), strict=True)
        return b"".join([view[start:end] for start, end in pairs])

    def _places(self, chunk: Ints, starts: Ints) -> Ints:
        """Return the places of the groups of records that begin there; one behind the last for a number that is none's."""
        if self.width == 1:
            return np.asarray(self._table[chunk[starts]])
        numbers = numbers_of(chunk[starts[:, None] + np.arange(self.width)])
        places = np.searchsorted(self._known, numbers)
        places[places == len(self._known)] = 0
        places[self._known[places] != numbers] = len(self._known)
        return np.asarray(places)

    def find(self, buffer: bytearray, chunk: Ints) -> tuple[Ints, Ints, int]:
        """Return where whole records begin in `chunk`, which is `buffer` as far as it is full, and the places of their
        groups.

        The last number is where the first record begins that is not whole, or of no group. Where records of one size
        follow each other they are found at once, and otherwise one by one.
        """
        width, end, steps = self.width, len(chunk), self.steps
        unpack = self._format.unpack_from
        found = [np.zeros(0, np.int64)]
        at, ahead = 0, _AHEAD
        while at + width <= end:
            step = self._step(buffer, at, end)
            if not step:
                break
            run = np.arange(at, min(at + ahead * step, end - step + 1), step)
            is_alike = self._steps[self._places(chunk, run)] == step
            count = len(run) if is_alike.all() else int(is_alike.argmin())
            found.append(run[:count])
            at += count * step
            if count == ahead:
                ahead = min(2 * ahead, 1 << 16)
            elif count < ahead // 2:
                ahead = _AHEAD
                single: list[int] = []
                for _ in range(_SINGLE):
                    if at + width > end:
                        break
                    step = steps.get(unpack(buffer, at)[0], 0)
                    if step == _OWN:
                        step = self._step(buffer, at, end)
                    if not step or at + step > end:
                        break
                    single.append(at)
                    at += step
                found.append(np.array(single, np.int64))
        starts = np.concatenate(found)
        return starts, self._places(chunk, starts), at
