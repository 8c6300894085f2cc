"""Ordinary MDF 4 bus logs, read here and in arrays.

1. What is not ordinary is told before the first frame, as `Unusual`; `mf4.py` then has another reader.
2. Memory is bounded: of each group some ten thousand records are at hand, of packed ones a block, and the streams that mix
   groups are sorted in a file on disk, which is bounded too.
3. A group that breaks off costs the rest of that group; what was read of it, and the other groups, stand.

Ordinary is: records of fixed size, one group's or several's with their numbers in front, plain or deflated, finished or cut;
fields of a frame that are integers of up to 64 bits, at any bit; data bytes as bytes; times as numbers that a factor makes
seconds. Not ordinary are data of variable length in blocks of their own, columns in files of their own (MDF 4.2), and more.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from ..frame_table import FrameTable, Ints
from ._mdf import ORDER, PROGRAM
from ._mdf_data import Bytes, Sorted, numbers_of, records
from ._mdf_fields import Field, bytes_at, field_of, integers, number_of, reals
from ._mdf_tree import (
    BUS_EVENT,
    COUNTS,
    MASTER,
    REMOTE_MASTER,
    SIZED,
    VALUE,
    VARIABLE_GROUP,
    Channel,
    Damaged,
    Group,
    Segment,
    Stream,
    Tree,
    Unusual,
    tree_of,
)
from ._mf4_frames import (
    Fault,
    Piece,
    broken_off,
    channels_of,
    fields_of,
    group_kind,
    instants,
    instants_of_seconds,
    merged,
    no_log,
    other_words,
    piece_of,
)
from .base import PROBLEMS_KEPT, CanCapture

_ROWS = 1 << 15
#: Records at hand in all groups together, and unpacked blocks.
_KEPT = 1 << 28
_GROUPS = 1 << 10
_RECORD = 1 << 20
#: What sorting may write, beside four times the file's size, and from how much on it goes to disk.
_DISK, _SMALL = 1 << 30, 1 << 24
_REALS, _BYTES = (4, 5), 10

_PARTS = ("ID", "IDE", "DLC", "DataLength", "EDL", "BRS", "ESI", "BusChannel")

#: Count so many records as unreadable; the number of the first in its group, and why, may be kept.
Lose = Callable[[int, str, int], None]


class Frames(NamedTuple):
    """A group of frames, and where their fields are. `announced` is None where the file does not say."""

    place: int
    kind: str
    group: Group
    announced: int | None
    time: Field
    factor: float
    offset: float
    order: Field | None
    numbers: dict[str, Field]
    data: Field | None
    sent: Field | None


class BusLog:
    """An ordinary bus log, of which nothing but the tree was read.

    `file` is that of the capture, of `size` bytes. Raises `Unusual` and `Damaged` when it is not ordinary or not one.
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size
        tree = self._tree = tree_of(file, size)
        self._is_ours = tree.program == PROGRAM
        if tree.start_ns >= 1 << 63:
            raise Damaged("it begins at no instant")
        self._frames: list[Frames | None] = []  # of each group in the file
        has_bus = False
        for stream in tree.streams:
            if len({group.number for group in stream.groups}) < len(stream.groups):
                raise Unusual("groups share a number")
            if not stream.number_bytes and len(stream.groups) > 1:
                raise Unusual("groups share records")
            for group in stream.groups:
                names = [channel.name for channel in group.channels]
                kind = group_kind(names)
                has_bus = has_bus or kind is not None or bool(group.flags & BUS_EVENT)
                self._frames.append(self._layout(stream, group, kind))
        wanted = sum(frames is not None for frames in self._frames)
        largest = sum(
            max((segment.size for segment in stream.segments if segment.packing is not None), default=0)
            for stream in tree.streams
        )
        if wanted > _GROUPS or largest > 2 * _KEPT:
            raise Unusual("it has very many groups")
        self._rows = _KEPT // max(wanted, 1)
        if not has_bus:
            self._refuse(tree)

    def _refuse(self, tree: Tree) -> None:
        groups = len(self._frames)
        if groups or not self._is_ours:
            raise Damaged(no_log(groups))
        if not tree.has_history:  # it is written last, and without a frame there is nothing else
            raise Damaged("it was never finished: the blocks that say what it holds are missing")

    def _layout(self, stream: Stream, group: Group, kind: str | None) -> Frames | None:
        """Where the fields of a group of frames are; None for a group that has none."""
        is_open = bool(self._tree.unfinished & COUNTS)
        if group.flags & (VARIABLE_GROUP | REMOTE_MASTER) or (stream.number_bytes and group.size > _RECORD):
            raise Unusual("its records have no size, or times elsewhere")
        if kind is None or not (group.records or (is_open and stream.segments)):
            return None
        if not 0 < group.size <= _RECORD:
            raise Unusual("its records have no size")
        named: dict[str, Channel] = {}
        for channel in group.channels:
            if channel.name in named and (channel.name.startswith(kind) or channel.name == ORDER):
                raise Unusual("channels share a name")
            named[channel.name] = channel
        times = [channel for channel in group.channels if channel.is_time]
        if len(times) != 1 or times[0].kind != MASTER or times[0].factor is None or not times[0].name:
            raise Unusual("its times are not numbers")
        numbers: dict[str, Field] = {}
        for part in _PARTS:
            if (found := named.get(f"{kind}.{part}")) is not None:
                numbers[part] = number_of(found, group.data_bytes)
        if "ID" not in numbers and kind != "CAN_ErrorFrame":
            raise Unusual("its frames have no identifiers")
        data = None if kind == "CAN_RemoteFrame" else named.get(f"{kind}.DataBytes")
        if data is not None and (data.kind not in (VALUE, SIZED) or data.data_type != _BYTES):
            raise Unusual("its data bytes stand in blocks of their own")
        sent, order = named.get(f"{kind}.Dir"), named.get(ORDER) if self._is_ours else None
        time = field_of(times[0], group.data_bytes)
        if time.is_bytes or (sent is not None and (sent.data_type == _BYTES or sent.data_type in _REALS)):
            raise Unusual("its times or directions are not numbers")
        return Frames(
            len(self._frames),
            kind,
            group,
            None if is_open else group.records,
            time,
            times[0].factor,
            times[0].offset,
            None if order is None else number_of(order, group.data_bytes),
            numbers,
            None if data is None else field_of(data, group.data_bytes),
            None if sent is None else field_of(sent, group.data_bytes),
        )

    def tables(self, capture: CanCapture, folder: str, lose: Lose) -> Iterator[FrameTable]:
        """All frames in the order of their times, of our own files in that of the recording.

        Counts into `capture`. `folder` is for temporary files. Raises `OSError`, and `OverflowError` when sorting would
        take more room there than is allowed.
        """
        with tempfile.SpooledTemporaryFile(_SMALL, dir=folder) as spool:
            store: Any = spool
            sources: list[Iterator[Piece]] = []
            index = 0
            for stream in self._tree.streams:
                frames = self._frames[index : index + len(stream.groups)]
                index += len(stream.groups)
                sources += self._sources(stream, frames, store, capture, lose)
            for piece in merged(sources):
                yield FrameTable(*piece[1:], capture.channels)

    def _sources(
        self,
        stream: Stream,
        frames: list[Frames | None],
        store: BinaryIO,
        capture: CanCapture,
        lose: Lose,
    ) -> Iterator[Iterator[Piece]]:
        """The frames of each group of a stream."""
        is_open = bool(self._tree.unfinished & COUNTS)
        there: dict[int, int] = {}
        pieces: dict[int, list[Segment]] = {}
        fault = stream.fault
        if len(stream.groups) > 1 and (is_open or any(frames)):
            wanted = [each.group.number for each in frames if each is not None]
            done = Sorted(self._file, stream, wanted, store, _DISK + 4 * self._size)
            there, pieces, fault = done.counts, done.segments, done.fault
        elif len(stream.groups) == 1:
            step = stream.number_bytes + stream.groups[0].size
            there[stream.groups[0].number] = (
                sum(segment.size for segment in stream.segments) // step if step else 0
            )
        for group, each in zip(stream.groups, frames, strict=True):
            if each is not None:
                reader = Bytes(store, pieces[group.number], fault) if pieces else None
                front = 0 if pieces else stream.number_bytes
                yield self._guarded(
                    each, reader or Bytes(self._file, stream.segments, fault), front, capture, lose
                )
                continue
            count = group.records
            if group.size and group.number in there:
                count = there[group.number] if is_open else min(count, there[group.number])
            if count:
                names = [channel.name for channel in group.channels]
                words = other_words(names, bool(group.flags & BUS_EVENT), group.bus)
                capture.others[words] = capture.others.get(words, 0) + count
                capture.lines += count

    def _guarded(
        self, frames: Frames, source: Bytes, front: int, capture: CanCapture, lose: Lose
    ) -> Iterator[Piece]:
        """The frames of a group; where it breaks off, the rest counts as one unreadable record."""
        done = 0
        reason = ""
        try:
            for count, piece in self._pieces(frames, source, front, capture, lose):
                done += count
                capture.lines += count
                capture.frames += len(piece.time)
                if len(piece.time):
                    yield piece
        except ValueError as error:
            reason = str(error)
        reason, announced = reason or source.fault, frames.announced
        if done < announced if announced is not None else reason:
            capture.lines += 1
            lose(done + 1, broken_off(frames.kind, frames.place, announced, done, reason), 1)

    def _pieces(
        self, frames: Frames, source: Bytes, front: int, capture: CanCapture, lose: Lose
    ) -> Iterator[tuple[int, Piece]]:
        """How many records were looked at, and the frames in them."""
        kind, size = frames.kind, front + frames.group.size
        seen, last = 0, None
        for rows in records(source, size, frames.announced, max(1, min(_ROWS, self._rows // (size + 128)))):
            if front:
                wrong = numbers_of(rows[:, :front]) != frames.group.number
                if wrong.any():
                    rows = rows[: int(wrong.argmax())]
                    source.stop("a record of a group that there is not")
                    if not len(rows):
                        return
                rows = rows[:, front:]
            time = self._time(frames, rows)
            key = time if frames.order is None else integers(rows, frames.order).astype(np.int64)
            key = np.maximum.accumulate(key)
            if last is not None and key[0] < last:
                key = np.maximum(key, last)
            last = key[-1]
            piece, faults = self._piece(frames, rows, key, time, capture)
            for wrong, reason in faults:
                reason = f"{kind} group {frames.place}: {reason}"
                for row in wrong[:PROBLEMS_KEPT].tolist():
                    lose(seen + row + 1, reason, 0)
                capture.lines_unreadable += len(wrong)
            seen += len(rows)
            yield len(rows), piece

    def _time(self, frames: Frames, rows: Ints) -> Ints:
        if not frames.time.is_real and frames.factor == 1e-9 and not frames.offset:
            return instants(integers(rows, frames.time), self._tree.start_ns)
        values = reals(rows, frames.time) if frames.time.is_real else integers(rows, frames.time)
        if (frames.factor, frames.offset) != (1, 0):
            values = values * frames.factor
            if frames.offset:
                values += frames.offset
        return instants_of_seconds(values.astype(np.float64), self._tree.start_ns)

    def _piece(
        self, frames: Frames, rows: Ints, key: Ints, time: Ints, capture: CanCapture
    ) -> tuple[Piece, list[Fault]]:
        n = len(rows)

        def number(part: str) -> Ints | None:
            field = frames.numbers.get(part)
            return None if field is None else integers(rows, field)

        is_sent: Ints | None = None
        if frames.sent is not None and frames.sent.is_bytes:
            is_sent = np.char.lower(bytes_at(rows, frames.sent).view(f"S{frames.sent.size}")[:, 0]) != b"rx"
        elif frames.sent is not None:
            is_sent = integers(rows, frames.sent) != 0
        data = None if frames.data is None else bytes_at(rows, frames.data)
        numbers = None if self._is_ours else number("BusChannel")
        if numbers is None:
            name = frames.group.path or None if self._is_ours else None
            channel = np.full(n, capture.channels.number(name), np.uint16)
        else:
            channel = channels_of(numbers, capture.channels.number)
        return piece_of(frames.kind, key, time, channel, fields_of(frames.kind, number, data, is_sent, n))
