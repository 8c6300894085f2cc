"""MDF 4 bus logs, read here and in arrays.

1. What cannot be read here is refused before the first frame, as `UnusualFile`; `reader.py` then has the records copied.
2. Memory is bounded: of each group some ten thousand records are at hand, of packed ones a block, and the streams that mix
   groups are sorted in a file on disk, which is bounded too.
3. A group that breaks off costs the rest of that group; what was read of it, and the other groups, are given.
4. What a file says of itself is held against what is there: more or fewer records than announced are counted and said.

Here are found the records: of fixed size, one group's or several's with their numbers in front, plain or deflated, finished
or cut, and bytes of variable length in blocks or records of their own. What they mean is said in `group.py`, also where
asammdf finds the records: later versions than 4.2, lists of columns, offsets or lists that were never finished, and more.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from typing import Any, BinaryIO, NamedTuple

from aces_bus import FrameTable
from aces_bus.frame_table import Ints
from aces_bus.recordings.base import CanRecording
from aces_bus.recordings.merge import KeyedTable, Merge

from .blocks import PROGRAM
from .data import Bytes, Sorted, Variable, numbers_of, record_arrays
from .frames import group_kind, no_log, other_words
from .group import GroupReader, Lose, frames_of
from .tree import (
    BUS_EVENT,
    COUNTS,
    JOINED,
    VARIABLE,
    VARIABLE_GROUP,
    ChannelGroup,
    Damaged,
    DataGroup,
    MdfChannel,
    MdfTree,
    Segment,
    UnusualFile,
)

_ROWS = 1 << 15
#: Records at hand in all groups together, and unpacked blocks.
_KEPT = 1 << 28
_GROUPS = 1 << 10
_RECORD = 1 << 20
#: What sorting may write, beside four times the file's size, and from how much on it goes to disk.
_DISK, _SMALL = 1 << 30, 1 << 24


class FrameGroup(NamedTuple):
    """A group of frames, and the bytes of variable length that it has. `announced` is None where the file does not say."""

    place: int
    kind: str
    group: ChannelGroup
    announced: int | None
    variable: MdfChannel | None


class BusLog:
    """A bus log, of which nothing but the tree was read.

    `file` has the records, as `tree` says; the capture has `size` bytes. Raises `UnusualFile` and `Damaged` when it is not
    ordinary or not one.
    """

    def __init__(self, file: BinaryIO, size: int, tree: MdfTree) -> None:
        self._file, self._size, self._tree = file, size, tree
        self._is_ours = tree.program.rstrip(b"\0 ") == PROGRAM
        if tree.start_ns >= 1 << 63:
            raise Damaged("it begins at no instant")
        self._frames: list[FrameGroup | None] = []  # of each group in the file
        has_bus = False
        for stream in tree.streams:
            if len({group.number for group in stream.groups}) < len(stream.groups):
                raise UnusualFile("groups share a number")
            if not stream.number_bytes and len(stream.groups) > 1:
                raise UnusualFile("groups share records")
            for group in stream.groups:
                names = [channel.name for channel in group.channels]
                kind = group_kind(names)
                has_bus = has_bus or kind is not None or bool(group.flags & BUS_EVENT)
                self._frames.append(self._layout(stream, group, kind))
        wanted = sum(frames is not None for frames in self._frames)
        packed: list[Sequence[Segment]] = [stream.segments for stream in tree.streams]
        packed += [each.variable.segments for each in self._frames if each is not None and each.variable]
        largest = sum(
            max((segment.size for segment in segments if segment.packing is not None), default=0)
            for segments in packed
        )
        if wanted > _GROUPS or largest > 2 * _KEPT:
            raise UnusualFile("it has very many groups")
        self._rows = _KEPT // max(wanted, 1)
        if not has_bus:
            self._refuse(tree)

    def _refuse(self, tree: MdfTree) -> None:
        groups = len(self._frames)
        if groups or not self._is_ours:
            raise Damaged(no_log(groups))
        if not tree.has_history:  # it is written last, and without a frame there is nothing else
            raise Damaged("it was never finished: the blocks that say what it holds are missing")

    def _layout(self, stream: DataGroup, group: ChannelGroup, kind: str | None) -> FrameGroup | None:
        """Return a group of frames; None for a group that has none."""
        is_open = bool(self._tree.unfinished & COUNTS)
        is_variable = bool(group.flags & VARIABLE_GROUP)
        if is_variable and not stream.number_bytes:
            raise UnusualFile("its records have no size")
        if stream.number_bytes and group.size > _RECORD and not is_variable:
            raise UnusualFile("its records have no size")
        if kind is None or not (group.records or (is_open and stream.segments)):
            return None
        if is_variable or not 0 < group.size <= _RECORD:
            raise UnusualFile("its records have no size")
        variable = next(
            (
                channel
                for channel in group.channels
                if channel.kind == VARIABLE and channel.name == f"{kind}.DataBytes"
            ),
            None,
        )
        return FrameGroup(len(self._frames), kind, group, None if is_open else group.records, variable)

    def tables(self, capture: CanRecording, folder: str, lose: Lose) -> Iterator[FrameTable]:
        """Yield all frames in the order of their times, of our own files in that of the recording.

        Counts into `capture`. `folder` is for temporary files. Raises `OSError`, and `OverflowError` when sorting would
        take more room there than is allowed.
        """
        with tempfile.SpooledTemporaryFile(_SMALL, dir=folder) as spool:
            store: Any = spool
            sources: list[Iterator[KeyedTable]] = []
            index = 0
            for stream in self._tree.streams:
                frames = self._frames[index : index + len(stream.groups)]
                index += len(stream.groups)
                sources += self._sources(stream, frames, store, capture, lose)
            yield from Merge.by_key(sources)
        if self._tree.joined_at:
            capture.lines += 1
            lose(capture.lines, JOINED.format(self._tree.joined_at), 1)

    def _sources(
        self,
        stream: DataGroup,
        frames: list[FrameGroup | None],
        store: BinaryIO,
        capture: CanRecording,
        lose: Lose,
    ) -> Iterator[Iterator[KeyedTable]]:
        """Yield the frames of each group of a stream."""
        is_open = bool(self._tree.unfinished & COUNTS)
        there: dict[int, int] = {}
        pieces: dict[int, list[Segment]] = {}
        fault = stream.fault
        number_at = {group.at: group.number for group in stream.groups if group.flags & VARIABLE_GROUP}
        if len(stream.groups) > 1 and (is_open or any(frames)):
            wanted = {each.group.number for each in frames if each is not None}
            variable = {each.variable.data_at for each in frames if each is not None and each.variable}
            wanted |= {number for at, number in number_at.items() if at in variable}
            done = Sorted(self._file, stream, sorted(wanted), store, _DISK + 4 * self._size)
            there, pieces, fault = done.counts, done.segments, done.fault
            if is_open and done.rest and not fault:
                capture.lines += 1
                lose(sum(there.values()) + 1, f"of the last record only {done.rest} bytes are there", 1)
        elif len(stream.groups) == 1 and not number_at:
            step = stream.number_bytes + stream.groups[0].size
            there[stream.groups[0].number] = (
                sum(segment.size for segment in stream.segments) // step if step else 0
            )
        for group, each in zip(stream.groups, frames, strict=True):
            if each is not None:
                reader = self._reader(each, capture)
                if (channel := each.variable) is not None and channel.data_at in number_at:
                    bytes_of = Variable(store, pieces[number_at[channel.data_at]])
                    reader.store = bytes_of.size, bytes_of.window
                elif channel is not None and (channel.segments or not channel.fault):
                    bytes_of = Variable(self._file, channel.segments)
                    reader.store = bytes_of.size, bytes_of.window
                source = Bytes(store, pieces[group.number], fault) if pieces else None
                batches = self._batches(
                    each,
                    source or Bytes(self._file, stream.segments, fault),
                    0 if pieces else stream.number_bytes,
                    there[group.number],
                )
                yield frames_of(reader, each.place, each.announced, batches, capture, lose)
                continue
            count = group.records
            if group.flags & VARIABLE_GROUP:  # its records are parts of others
                continue
            if group.size and group.number in there:
                count = there[group.number] if is_open else min(count, there[group.number])
            if count:
                names = [channel.name for channel in group.channels]
                words = other_words(names, bool(group.flags & BUS_EVENT), group.bus)
                capture.others[words] = capture.others.get(words, 0) + count
                capture.lines += count

    def _reader(self, frames: FrameGroup, capture: CanRecording) -> GroupReader:
        return GroupReader(
            frames.kind, frames.group, self._tree.start_ns, capture.channels, is_ours=self._is_ours
        )

    def _batches(self, frames: FrameGroup, source: Bytes, front: int, there: int) -> Iterator[Ints]:
        """Yield the records of a group, without what is in `front` of each; `there` are so many.

        Raises `ValueError` where there are fewer or more than announced, when there is a reason.
        """
        size, announced = front + frames.group.size, frames.announced
        done = 0
        for rows in record_arrays(source, size, announced, max(1, min(_ROWS, self._rows // (size + 128)))):
            if front:
                wrong = numbers_of(rows[:, :front]) != frames.group.number
                if wrong.any():
                    rows = rows[: int(wrong.argmax())]
                    source.stop("a record of a group that there is not")
                rows = rows[:, front:]
            done += len(rows)
            if len(rows):
                yield rows
        if announced is None and not source.fault and (rest := source.size % size):
            raise ValueError(f"of the last record only {rest} bytes are there")
        if source.fault and (announced is None or done < announced):
            raise ValueError(source.fault)
        if announced is not None and announced == done < there:
            raise ValueError(f"{announced} records are announced, {there} are there")
