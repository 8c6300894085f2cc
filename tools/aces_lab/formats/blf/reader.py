"""Vector's binary log (BLF): a header, then containers of compressed objects, of which the CAN ones give frames.

    "LOGG", header size u32, …, at 32 the number of objects u32, at 40 the start of the measurement (SYSTEMTIME, UTC)
    "LOBJ", header size u16, version u16, object size u32, type u32 = 10      a container:
           16  method u16 (0 stored, 2 zlib), …, unpacked size u32 at 24, then the packed bytes at 32

1. Unpacked containers are one stream of objects; an object may begin in one and end in the next.
2. Sizes are claims. Nothing is unpacked or kept that is larger than the limits below, and an object is believed when
   the next one begins where it ends.
3. After damage reading goes on at the next "LOBJ"; what lies between is one unreadable thing, with its offset.
4. What the header states is compared with what was read: objects that are missing are one unreadable thing, with their
   number. A header that states none is of a log that was not closed.
5. No number replaces another: an object whose length code and number of bytes differ, or whose identifier has bits
   that mean nothing, is unreadable.

Objects are counted like lines: `lines` is their number, with one for each damaged stretch. Times are those of the
objects after the start of the measurement, exact to the nanosecond.

*Facts*: python-can `can/io/blf.py`; Wireshark `wiretap/blf.h` (objects may come before the containers). Objects are
padded: the next begins within 8 bytes. Vector's programs pad with zeros behind the last one, which is not damage. Logs may
be joined: another header begins another log, with its own start. The number of objects is without containers.
*Choice*: the start is taken as UTC, as python-can takes it; Vector's programs write the local time of their machine.
"""

from __future__ import annotations

import datetime
import re
import struct
import zlib
from collections.abc import Iterator

import numpy as np

from aces_bus import FrameTable
from aces_bus.errors import CaptureError
from aces_bus.frame_table import Ints, joined_tables
from aces_bus.recordings.base import CanRecording, keep_freed_memory
from aces_bus.recordings.inflate import inflate_whole
from aces_bus.recordings.merge import Merge
from aces_bus.recordings.source import ByteSource
from aces_bus.recordings.unpack import up_to_damage

from ..beginnings import BLF
from .objects import LOG_CONTAINER, DecodedObjects, decode_objects, is_can

_OBJECT = b"LOBJ"
_OBJECT_WORD = int.from_bytes(_OBJECT, "little")
_BASE = struct.Struct("<4sHHLL")
_HEADER, _LARGEST_HEADER = 144, 4096
_BEGIN = re.compile(rb"LOBJ|LOGG")
#: Bytes of a packed container and of what it holds, of an object, and of a CAN object.
_CONTAINER, _LARGEST, _LARGEST_CAN = 1 << 26, 1 << 24, 1 << 12
#: A container of so many bytes holds at most 1,032 times as many (zlib), which is less than `_CONTAINER`.
_SMALL = 60_000
#: Bytes that are read, unpacked and looked at together.
LARGE = 1 << 20
#: Rows of a table, unless the source is live or ends.
TABLE_ROWS = 1 << 16
#: Behind the last object, so that whole objects may be gathered.
_SLACK = bytes(256)
#: Objects that are worth the calls of finding them all at once, and how many are found one by one where they are fewer.
_FEW, _STEPS = 64, 1024
#: The next object begins within so many bytes behind one.
_PADDING = 8


class BlfCapture(CanRecording):
    """Frames of a Vector BLF log, error frames too. A channel is named by its number from 0, as in python-can; channel 0
    of the log, which counts from 1, is none.

    Reading raises `CaptureError` when not even the header is there.
    """

    format = "Vector BLF"

    def __init__(self, source: ByteSource) -> None:
        super().__init__(source)
        self._objects = 0  # of the log at hand, and how many its header states
        self._stated = 0

    def _tables(self) -> Iterator[FrameTable]:
        keep_freed_memory()
        return joined_tables(self._piece_tables(), TABLE_ROWS, is_live=self.live)

    def _piece_tables(self) -> Iterator[FrameTable]:
        stream = _Stream(self)
        try:
            for piece in self._contents(stream):
                yield from stream.feed(piece, flush=self.live)
        except CaptureError:
            yield from stream.end()
            raise
        yield from stream.end()
        self._compare()

    def _contents(self, stream: _Stream) -> Iterator[bytes | None]:
        """Yield the unpacked bytes of all containers; None where some are missing."""
        file = _File(self._source.blocks(lambda: LARGE))
        if not file.want(_HEADER // 2) or not file.data.startswith(BLF):
            raise CaptureError(f"{self.name}: no Vector BLF log, or one that ends within its header")
        stream.start_ns = self._header(file)
        while file.want(_BASE.size + _PADDING) or file.data:
            at = file.data.find(_OBJECT, 0, _PADDING + 3)
            if at < 0 or len(file.data) - at < _BASE.size:
                yield None
                if file.data.startswith(BLF) and file.want(_HEADER // 2):
                    stream.end_lost()
                    self._compare()
                    stream.start_ns = self._header(file)
                else:
                    self._resync(file, 1, "")
                continue
            file.drop(at)
            _, _, _, size, kind = _BASE.unpack_from(file.data)
            if not self._can_be(size, kind):
                yield None
                self._resync(file, 4, f"an object of {size:,} bytes; ")
                continue
            whole = file.want(size)
            if kind == LOG_CONTAINER:
                yield from self._container(file.first(size), file.offset)
            else:
                yield file.first(size)
            if not whole:
                yield None
                self.damaged(f"the file ends within the object at offset {file.offset:,}", b"")
            file.drop(size)

    def _header(self, file: _File) -> int:
        """Skip the header; return the start of the measurement in ns, 0 if the header has none."""
        size = int.from_bytes(file.data[4:8], "little")
        start = _system_time(file.data[40:56])
        self._objects, self._stated = 0, int.from_bytes(file.data[32:36], "little")
        size = size if _HEADER // 2 <= size <= _LARGEST_HEADER else _HEADER
        if not file.want(size):
            self._stated = 0
            self.damaged(f"the file ends within its header of {size} bytes", file.first(24))
        file.drop(size)
        return start

    def _compare(self) -> None:
        """Count what the header states and is not there."""
        if self._objects < self._stated:
            missing = self._stated - self._objects
            self.damaged(
                f"the header states {self._stated:,} objects, {self._objects:,} are there: {missing:,} are missing",
                b"",
            )

    def _container(self, container: bytes, offset: int) -> Iterator[bytes | None]:
        method = int.from_bytes(container[16:18], "little")
        if method == 0:
            yield container[32:]
            return
        if method != 2:
            yield None
            self.damaged(f"container at offset {offset:,}: packing method {method} is not known", container)
            return
        claimed = int.from_bytes(container[24:28], "little")
        if (
            len(container) <= _SMALL and claimed <= LARGE
        ):  # quicker, and bounded by what so few bytes can hold
            try:
                whole = inflate_whole(memoryview(container)[32:], max(claimed, 1))
            except zlib.error:
                pass  # step by step, up to the damage
            else:
                yield from (whole[start : start + LARGE] for start in range(0, len(whole), LARGE))
                return
        unpacker, total = zlib.decompressobj(), 0
        packed: bytes | memoryview = memoryview(container)[32:]
        damage = ""
        while not unpacker.eof and not damage:
            before = unpacker.copy()
            try:
                piece = unpacker.decompress(packed, LARGE)
            except zlib.error:
                piece, _, damage = up_to_damage(before, packed)
            else:
                packed = unpacker.unconsumed_tail
                if len(piece) < LARGE and not packed and not unpacker.eof:
                    damage = "it ends too early"
            total += len(piece)
            if total > _CONTAINER:
                damage = f"more than {_CONTAINER:,} bytes"
            elif piece:
                yield piece
        if damage:
            yield None
            self.damaged(
                f"container at offset {offset:,} is damaged after {total:,} bytes: {damage}", container
            )

    @staticmethod
    def _can_be(size: int, kind: int) -> bool:
        return 32 <= size <= _CONTAINER if kind == LOG_CONTAINER else _BASE.size <= size <= _limit(kind)

    def _resync(self, file: _File, step: int, why: str) -> None:
        """Drop everything up to the next object or header; zeros in front of a header and of the end are padding."""
        offset, first, place, is_blank = file.offset, bytes(file.data[:32]), step, True
        while True:
            found = _BEGIN.search(file.data, place)
            if found is None:
                end = max(len(file.data) - 3, place)
            elif not file.want(found.start() + _BASE.size) or self._can_begin(file.data, found.start()):
                end = found.start()
            else:
                place = found.start() + 4
                continue
            is_blank = is_blank and not file.first(end).strip(b"\0")
            file.drop(end)
            place = 0
            if found is not None:
                break
            if not file.want(len(file.data) + 1):
                is_blank = is_blank and not file.data.strip(b"\0")
                file.drop(len(file.data))
                break
        if not is_blank or file.data.startswith(_OBJECT):
            self.damaged(f"{why}{file.offset - offset:,} bytes at offset {offset:,} are not an object", first)

    def _can_begin(self, data: bytearray, place: int) -> bool:
        signature, _, _, long, kind = _BASE.unpack_from(data, place)
        if signature == BLF:
            return _HEADER // 2 <= int.from_bytes(data[place + 4 : place + 8], "little") <= _LARGEST_HEADER
        return self._can_be(long, kind)

    def damaged(self, reason: str, excerpt: bytes) -> None:
        """Count bytes that are not an object, of which `excerpt` are the first."""
        self.lines += 1
        self._unreadable(self.lines, reason, excerpt[:24].hex(" ").encode())

    def decoded(
        self, data: Ints, begins: Ints, sizes: Ints, damages: list[tuple[int, str]], start_ns: int
    ) -> FrameTable:
        """Return the frames of these objects; counts everything. Each of `damages` is before one of the objects."""
        found = (
            decode_objects(data, begins, sizes, start_ns, self.channels)
            if len(begins)
            else DecodedObjects([], [], {})
        )
        problems = sorted(
            [(place, 0, reason) for place, reason in damages] + [(p, 1, r) for p, r in found.unreadable]
        )
        before = 0  # damages so far, each of which is counted like an object
        for place, is_object, reason in problems:
            begin = int(begins[place]) if is_object else 0
            excerpt = data[begin : begin + 24].tobytes().hex(" ") if is_object else ""
            self._unreadable(self.lines + place + before + 1, reason, excerpt.encode())
            before += not is_object
        for kind, count in found.others.items():
            self._other_kind(kind, count)
        self.lines += len(begins) + before
        self._objects += len(begins)
        if not found.frames:
            return FrameTable.empty(self.channels)
        table = Merge.in_order(
            len(begins), [places for places, _ in found.frames], [part for _, part in found.frames]
        )
        self.frames += len(table)
        return table


class _File:
    """Bytes of the file from an offset on, as many as are wanted."""

    def __init__(self, blocks: Iterator[bytes]) -> None:
        self.data, self.offset = bytearray(), 0
        self._blocks = blocks

    def want(self, size: int) -> bool:
        """Read until so many bytes are there; False when the file has fewer."""
        while len(self.data) < size:
            block = next(self._blocks, b"")
            if not block:
                return False
            self.data += block
        return True

    def first(self, size: int) -> bytes:
        """Return `size` bytes, or what there is."""
        with memoryview(self.data) as view:
            return bytes(view[:size])

    def drop(self, size: int) -> None:
        size = min(size, len(self.data))
        del self.data[:size]
        self.offset += size


class _Stream:
    """The unpacked bytes: keeps what waits for more, walks from object to object, goes on after damage."""

    def __init__(self, capture: BlfCapture) -> None:
        self.start_ns = 0
        self._capture = capture
        self._waiting: list[bytes] = []
        self._size = 0
        self._offset = 0  # of the first byte that waits
        self._lost: int | None = None  # offset of the first byte that is not an object
        self._is_blank = False  # all bytes from there on are zeros, which is padding where nothing follows

    def feed(self, piece: bytes | None, flush: bool) -> Iterator[FrameTable]:
        """Yield the frames that are complete with this piece, once there is enough to look at."""
        if piece is not None:
            self._waiting.append(piece)
            self._size += len(piece)
        if self._size and (piece is None or flush or self._size >= LARGE):
            yield from self._read(final=piece is None)
        if piece is None and self._size:  # nothing continues what is left
            left = b"".join(self._waiting)
            if self._lost is None:
                self._lose(self._offset)
            self._is_blank = self._is_blank and not left.strip(b"\0")
            self._offset += self._size
            self._waiting, self._size = [], 0

    def end(self) -> list[FrameTable]:
        """End the input; return the rest."""
        tables = list(self._read(final=True))
        left = b"".join(self._waiting)
        if self._lost is not None:
            self._is_blank = self._is_blank and not left.strip(b"\0")
            self._offset += len(left)
            self.end_lost()
        elif left.strip(b"\0"):
            self._capture.damaged(f"the log ends within the object at unpacked offset {self._offset:,}", left)
        self._waiting, self._size = [], 0
        return tables

    def end_lost(self) -> None:
        """Count the bytes at the end that are not an object, unless they are padding."""
        if self._lost is not None and not self._is_blank:
            self._capture.damaged(self._found(self._offset), b"")
        self._lost = None

    def _lose(self, offset: int, is_blank: bool = True) -> None:
        self._lost, self._is_blank = offset, is_blank

    def _read(self, final: bool = False) -> Iterator[FrameTable]:
        """Yield the frames of all objects that are whole."""
        size, place = self._size, 0
        data = b"".join((*self._waiting, _SLACK))
        view = np.frombuffer(data, np.uint8)
        begins: list[Ints] = []
        sizes: list[Ints] = []
        one: list[int] = []  # begins and sizes that were found one by one; the last may yet turn out wrong
        each: list[int] = []
        count = 0  # objects before these
        damages: list[tuple[int, str]] = []
        steps = 0  # to go before many are looked for at once
        while True:
            if self._lost is not None:
                lost = place
                place, found = _next_object(data, place, size, final)
                if not found:
                    self._is_blank = self._is_blank and not data[lost:place].strip(b"\0")
                    break
                damages.append((count + len(one), self._found(self._offset + place)))
                steps = _STEPS  # damage seldom comes alone
            at = data.find(_OBJECT, place, min(place + _PADDING + 3, size))
            if at < 0:
                if size - place < _PADDING + 3:
                    break
                wrong, is_blank = place, True
                if one and (inner := data.find(_OBJECT, one[-1] + 4, place)) >= 0:
                    wrong, place = one.pop(), inner  # its size was wrong: it swallowed another object
                    each.pop()
                    is_blank = False
                self._lose(self._offset + wrong, is_blank)
                continue
            if at + _BASE.size > size:
                break
            _, _, _, length, kind = _BASE.unpack_from(data, at)
            if not _BASE.size <= length <= _limit(kind):
                self._lose(self._offset + at, is_blank=False)
                place = at + 4
            elif at + length > size:
                if not final or data.find(_OBJECT, at + 4, size) < 0:
                    break
                self._lose(self._offset + at, is_blank=False)
                place = at + 4  # it does not end, but there is another one within it
            elif steps > 0:
                steps -= 1
                one.append(at)
                each.append(length)
                place = at + length
            else:
                begin, long = _run(view, size, at)
                begins += [np.array(one, np.int64), begin[:-1]]
                sizes += [np.array(each, np.int64), long[:-1]]
                count += len(one) + len(begin) - 1
                one, each = [int(begin[-1])], [int(long[-1])]
                place = one[0] + each[0]
                steps = _STEPS if len(begin) < _FEW else 0
        begins.append(np.array(one, np.int64))
        sizes.append(np.array(each, np.int64))
        table = self._capture.decoded(
            view, np.concatenate(begins), np.concatenate(sizes), damages, self.start_ns
        )
        if len(table):
            yield table
        self._offset += place
        self._waiting, self._size = [data[place:size]], size - place

    def _found(self, offset: int) -> str:
        """Return the end of the damage, in words."""
        assert self._lost is not None
        lost, self._lost = self._lost, None
        return f"{offset - lost:,} bytes at unpacked offset {lost:,} are not an object"


def _next_object(data: bytes, place: int, size: int, final: bool) -> tuple[int, bool]:
    """Return where an object begins whose size can be, or else where to go on when there is more; and whether one was
    found.
    """
    while (at := data.find(_OBJECT, place, size)) >= 0:
        if at + _BASE.size > size:
            return (size if final else at), False
        _, _, _, length, kind = _BASE.unpack_from(data, at)
        if _BASE.size <= length <= _limit(kind) and not (final and at + length > size):
            return at, True
        place = at + 4
    return (size if final else max(place, size - 3)), False


def _limit(kind: int) -> int:
    return _LARGEST_CAN if is_can(kind) else _LARGEST


def _run(view: Ints, size: int, place: int) -> tuple[Ints, Ints]:
    """Return objects of which each begins where the one before ends: at least the one at `place`, which is
    known to be whole.
    """
    step = int(np.ndarray((1,), "<u4", view, place + 8, (4,))[0])
    if step <= _LARGEST_CAN:
        count = min((size - place) // step, LARGE // step)
        even = np.ndarray((count,), "<u4", view, place, (step,)) == _OBJECT_WORD
        even &= np.ndarray((count,), "<u4", view, place + 8, (step,)) == step
        count = count if even.all() else int(even.argmin())
        if count >= _FEW:
            return np.arange(place, place + count * step, step), np.full(count, step)
    words = np.ndarray((min(size - place, LARGE) // 4,), "<u4", view, place, (4,))
    found = np.flatnonzero(words == _OBJECT_WORD)
    found = found[: np.searchsorted(found, len(words) - 3)]
    begins = place + 4 * found
    sizes = words[found + 2].astype(np.int64)
    ends = begins + sizes
    gaps = begins[1:] - ends[:-1]
    good = (gaps >= 0) & (gaps < _PADDING)
    good &= sizes[1:] >= _BASE.size
    good &= ends[1:] <= size
    kinds = words[found[1:] + 3]
    good &= (sizes[1:] <= _LARGEST_CAN) | ((sizes[1:] <= _LARGEST) & ~is_can(kinds))
    count = len(good) if good.all() else int(good.argmin())
    return begins[: count + 1], sizes[: count + 1]


def _system_time(raw: bytes | bytearray) -> int:
    """Return nanoseconds since 1970 of a SYSTEMTIME (year, month, day of the week, day, hour, minute, second,
    ms), or 0.
    """
    year, month, _, day, hour, minute, second, milliseconds = struct.unpack("<8H", raw)
    try:
        when = datetime.datetime(year, month, day, hour, minute, second, tzinfo=datetime.UTC)
    except ValueError:
        return 0
    seconds = (when - datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)) // datetime.timedelta(seconds=1)
    nanoseconds = seconds * 1_000_000_000 + min(milliseconds, 999) * 1_000_000
    return nanoseconds if abs(nanoseconds) < 1 << 62 else 0
