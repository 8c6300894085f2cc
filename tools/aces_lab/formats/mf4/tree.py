"""What an MDF 4 file says it holds: groups of records, their channels, and where the records are.

1. Nothing is believed: a block is looked at only where it lies within the file, each group, channel and data block once, and
   no more of them than `BLOCKS`. So this ends soon on any file, in memory that the file's size bounds.
2. What is damaged is `Damaged`; what is in order and not read here is `UnusualFile`, and needs asammdf.
3. Records are not touched; `data.py` reads them.
4. Nothing that changes what a number means is left out: a channel has its data type, its invalidation bit and its
   conversion. What of these is not read is refused by `group.py`, with the channel's name.

A file is a tree. Its header leads to data groups, each a stream of records and the channel groups whose records they are; a
channel group leads to its channels, and a channel to its parts: CAN_DataFrame to CAN_DataFrame.ID and so on. *Facts*: the
layout as ASAM describes MDF 4.0 to 4.2, and as asammdf reads it, beside which the tests put this.
"""

from __future__ import annotations

import struct
from datetime import UTC, datetime
from typing import BinaryIO, NamedTuple

import numpy as np

from ..beginnings import MDF
from .conversions import ChannelConversion, conversion_of

BLOCK_HEAD = struct.Struct("<4sIQQ")
HEADER_AT = 64
#: Heads with so many links.
_SHAPES = [struct.Struct(f"<4sIQQ{links}Q") for links in range(9)]
_CHANNEL = struct.Struct("<BBBBIIII")
_GROUP = struct.Struct("<QQHHIII")
_CONVERSION = struct.Struct("<BBHHHdd")
_PACKED = struct.Struct("<2sBBIQQ")

#: Groups, channels and data blocks that are followed. A day's log of a busy bus in blocks of 64 KiB has some 50,000.
BLOCKS = 1 << 18
#: A name that is longer is none that is looked for.
_TEXT = 1 << 12
#: A packed block is unpacked as a whole. Writers pack 4 MiB at a time, as ASAM recommends.
PACKED_MOST = 1 << 26

#: How a file begins, finished or not.
#: Bytes that are looked through at once.
_LOOK = 1 << 22

# Of `Channel`.
VALUE, VARIABLE, MASTER, VIRTUAL_MASTER, SIZED, VIRTUAL = 0, 1, 2, 3, 5, 6
ALL_INVALID, HAS_INVALID = 0x1, 0x2
#: Of the master channel: it has times.
TIMES = 1
# Of `Group.flags`.
VARIABLE_GROUP, BUS_EVENT, REMOTE_MASTER = 0x1, 0x2, 0x8
# Of `Tree.unfinished`: record counts are missing; the length of the last data block is; the last list of data blocks is.
COUNTS, _LAST_LENGTH, _LAST_LIST, _OFFSETS = 0x1, 0x4, 0x10, 0x40
#: Of the header: it begins at a local time.
_LOCAL = 0x1

_FRAMES = ("CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame")

JOINED = (
    "another MDF file begins behind it, at byte {}, and is not read; take them apart, and read each by itself"
)
CIRCLES = "its blocks are linked in circles, or one is named twice; it is damaged"
_AGAIN = "its blocks lie over each other; it is damaged"


class UnusualFile(Exception):
    """The file is in order, as far as can be seen, and has what is not read here."""


class Damaged(Exception):
    """The file is not in order."""


class Segment(NamedTuple):
    """A piece of a stream of records: `size` bytes, at `at` in the file, where they take `stored` bytes.

    `packing`: None, or how many columns a table had that was transposed and deflated; 0 for what is just deflated.
    """

    at: int
    stored: int
    size: int
    packing: int | None = None


class MdfChannel(NamedTuple):
    """A channel: `kind`, `data_type`, `sync` and `flags` as in the file; where its bits are in a record.

    `data_at` is where its data are if they have a place of their own; of bytes of variable length `segments` are those, if
    they are in blocks and not in records of a group there, and `fault` what is wrong behind the last.
    """

    name: str
    kind: int
    data_type: int
    first_bit: int
    first_byte: int
    bits: int
    sync: int = 0
    flags: int = 0
    invalid_bit: int = 0
    is_array: bool = False
    conversion: ChannelConversion = ChannelConversion()
    data_at: int = 0
    segments: tuple[Segment, ...] = ()
    fault: str = ""


class ChannelGroup(NamedTuple):
    """A channel group, which is at `at`. `number` is in front of its records; `records` are announced.

    A record has `size` bytes: those of the data, and behind them the invalidation bits. Those of a `VARIABLE_GROUP` have
    their length in front, and no channels.
    """

    at: int
    number: int
    records: int
    flags: int
    data_bytes: int
    size: int
    bus: int
    path: str
    channels: list[MdfChannel]


class DataGroup(NamedTuple):
    """A data group: records of one group, or of several with their group's number of `number_bytes` in front.

    `fault` is what is wrong behind the last segment, "" when nothing is.
    """

    number_bytes: int
    groups: list[ChannelGroup]
    segments: list[Segment]
    fault: str


class MdfTree(NamedTuple):
    """A file. `start_ns` is when it begins, since 1970; `has_history` whether it was written to its end.

    `joined_at` is where another file begins behind it, 0 where none does.
    """

    program: bytes
    unfinished: int
    start_ns: int
    has_history: bool
    streams: list[DataGroup]
    joined_at: int = 0


def start_of(time_ns: int, flags: int) -> int:
    """Return the instant at which a file begins; a local time, which says so in its flags, is taken as that of this
    machine.
    """
    if not flags & _LOCAL:
        return time_ns
    seconds, rest = divmod(time_ns, 1_000_000_000)
    try:
        local = datetime.fromtimestamp(seconds, UTC).replace(tzinfo=None)
        return int(local.timestamp()) * 1_000_000_000 + rest
    except (OverflowError, OSError, ValueError):
        raise Damaged("it begins at no instant") from None


class _Block(NamedTuple):
    links: list[int]
    data: bytes


def tree_of(file: BinaryIO, size: int) -> MdfTree:
    """Return the tree of a file of `size` bytes. Raises `UnusualFile`, `Damaged` and `OSError`."""
    return Blocks(file, size).tree()


class Blocks:
    """The walk through one file."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size
        self._seen: set[int] = set()
        #: Bytes of blocks still to be read; some blocks are named by many, and none by all.
        self._left = 4 * size + (1 << 20)
        self._records_left = size
        #: Where known blocks begin: one of which the length is missing ends at the next.
        self._ends: list[int] = []
        self._unfinished = 0
        self._conversions: dict[int, ChannelConversion] = {}

    def tree(self) -> MdfTree:
        head = self._bytes(0, 64)
        version = struct.unpack_from("<H", head, 28)[0]
        if not head[8:12].startswith(b"4."):
            words = head[8:12].decode("ascii", "replace").strip("\0 ")
            raise Damaged(f"MDF version {words!r} has no bus logging; only version 4 has")
        self._unfinished, custom = struct.unpack_from("<HH", head, 60)
        if not 400 <= version <= 420 or custom or self._unfinished & (_LAST_LIST | _OFFSETS):
            raise UnusualFile("it is of a version, or in a state, that is not known here")
        header = self._block(HEADER_AT, b"##HD", 6, 13)
        start = start_of(*struct.unpack("<Q4xB", header.data))
        streams: list[DataGroup] = []
        at = header.links[0]
        while at:
            group = self._block(at, b"##DG", 4, 1)
            streams.append(self._stream(group))
            at = group.links[0]
        joined = self.joined_at()
        if self._unfinished & _LAST_LENGTH:
            for stream in streams:
                if stream.segments and stream.segments[-1].packing is None:
                    last = stream.segments[-1] = self._stretched(stream.segments[-1])
                    if found := self._another_in(last):
                        joined, size = found, found - last.at
                        stream.segments[-1] = Segment(last.at, size, size)
        return MdfTree(head[16:24], self._unfinished, start, bool(header.links[1]), streams, joined)

    def joined_at(self) -> int:
        """Return where another file begins behind the last of the blocks that were met, and those that follow it; 0:
        nowhere.
        """
        at = max(self._ends, default=HEADER_AT)
        for _ in range(BLOCKS):
            self._file.seek(at)
            head = self._file.read(BLOCK_HEAD.size)
            if head[:8] in MDF:
                return at
            if len(head) == BLOCK_HEAD.size and head[:2] == b"##":
                at += max(BLOCK_HEAD.size, BLOCK_HEAD.unpack(head)[2])
            elif at % 8:
                at += -at % 8
            else:
                break
            if at >= self._size:
                break
        return 0

    def _another_in(self, segment: Segment) -> int:
        """Return where another file begins in records of which the length is missing; 0: nowhere."""
        end = segment.at + segment.size
        for at in range(segment.at, end, _LOOK):
            self._file.seek(at)
            data = self._file.read(min(_LOOK + len(MDF[0]) + 2, end - at))
            found = [place for magic in MDF if (place := data.find(magic + b"4.")) >= 0]
            if found:
                return at + min(found)
        return 0

    # ---- blocks

    def _bytes(self, at: int, size: int) -> bytes:
        self._left -= size
        if self._left < 0:
            raise UnusualFile("its blocks name the same ones over and over")
        if at + size <= self._size:
            self._file.seek(at)
            data = self._file.read(size)
            if len(data) == size:
                return data
        raise Damaged(f"it breaks off: of a block at byte {at} it has not all")

    def _head(self, at: int) -> tuple[bytes, int, int]:
        name, _, size, count = BLOCK_HEAD.unpack(self._bytes(at, BLOCK_HEAD.size))
        if name[:2] != b"##" or size < BLOCK_HEAD.size + 8 * count:
            raise Damaged(f"at byte {at} there is no block, though one is named there; it is damaged")
        self._ends.append(at)
        return name, size, count

    def _once(self, at: int) -> None:
        if at in self._seen:
            raise Damaged(CIRCLES)
        if len(self._seen) >= BLOCKS:
            raise UnusualFile(f"it has more than {BLOCKS} blocks")
        self._seen.add(at)

    def _block(self, at: int, name: bytes, links: int, data: int, *, once: bool = True) -> _Block:
        """Return a block of this name, with at least so many links and bytes; of what it has more, nothing is read."""
        shape = _SHAPES[links]
        front = self._bytes(at, shape.size)
        found, _, size, count, *there = shape.unpack(front)
        if found != name or count < links or size < BLOCK_HEAD.size + 8 * count + data:
            raise Damaged(f"at byte {at} there is no {name[2:].decode()} block, though one is named there")
        self._ends.append(at)
        if once:
            self._once(at)
        return _Block(there, self._bytes(at + BLOCK_HEAD.size + 8 * count, data))

    def _text(self, at: int) -> str:
        if not at:
            return ""
        name, size, count = self._head(at)
        if name not in (b"##TX", b"##MD"):
            raise Damaged(f"at byte {at} there is no text, though one is named there; it is damaged")
        raw = self._bytes(at + BLOCK_HEAD.size + 8 * count, min(size - BLOCK_HEAD.size - 8 * count, _TEXT))
        text = raw.split(b"\0", 1)[0]
        if len(text) == _TEXT:
            raise UnusualFile("it has a very long name")
        return text.strip(b" \r\t\n").decode("utf-8", "replace")

    # ---- groups and channels

    def _stream(self, block: _Block) -> DataGroup:
        groups: list[ChannelGroup] = []
        at = block.links[1]
        while at:
            group = self._block(at, b"##CG", 6, _GROUP.size)
            groups.append(self._group(at, group))
            at = group.links[0]
        width = block.data[0]
        if width not in (0, 1, 2, 4, 8):
            raise Damaged(f"numbers of groups of {width} bytes are not numbers")
        segments: list[Segment] = []
        fault = ""
        try:
            self._segments(block.links[2], segments)
        except Damaged as error:
            if str(error) in (CIRCLES, _AGAIN):
                raise
            fault = str(error)
        return DataGroup(width, groups, segments, fault)

    def _group(self, group_at: int, block: _Block) -> ChannelGroup:
        number, records, flags, _, _, data_bytes, more = _GROUP.unpack(block.data)
        bus, path = 0, ""
        if source := block.links[3]:
            found = self._block(source, b"##SI", 3, 3, once=False)
            bus, path = found.data[1], self._text(found.links[1])
        channels: list[MdfChannel] = []
        ahead = [block.links[1]]  # the channels that follow, of the innermost composition last
        while ahead:
            at = ahead.pop()
            if at:
                channel, then, parts = self._channel(at)
                channels.append(channel)
                ahead += then, parts
        return ChannelGroup(
            group_at, number, records, flags, data_bytes, data_bytes + more, bus, path, channels
        )

    def _channel(self, at: int) -> tuple[MdfChannel, int, int]:
        """Return a channel, the one after it, and the first of its parts."""
        block = self._block(at, b"##CN", 8, _CHANNEL.size)
        following, parts, name_at, _, conversion_at, data_at, *_ = block.links
        kind, sync, data_type, first_bit, first_byte, bits, flags, invalid_bit = _CHANNEL.unpack(block.data)
        is_array = bool(parts) and self._head(parts)[0] != b"##CN"
        name = self._text(name_at)
        conversion = ChannelConversion()
        if conversion_at and (kind in (MASTER, VIRTUAL_MASTER) or name.startswith(_FRAMES)):
            conversion = self.conversion(conversion_at)
        segments: list[Segment] = []
        fault = ""
        if kind == VARIABLE and data_at and name.startswith(_FRAMES):
            try:
                if self._head(data_at)[0] != b"##CG":
                    self._segments(data_at, segments, b"SD")
            except Damaged as error:
                if str(error) in (CIRCLES, _AGAIN):
                    raise
                fault = str(error)
        channel = MdfChannel(
            name,
            kind,
            data_type,
            first_bit,
            first_byte,
            bits,
            sync,
            flags,
            invalid_bit,
            is_array,
            conversion,
            data_at,
            tuple(segments),
            fault,
        )
        return channel, following, 0 if is_array else parts

    def conversion(self, at: int) -> ChannelConversion:
        """Return the conversion that is there. Raises `UnusualFile` and `OSError`."""
        if (known := self._conversions.get(at)) is not None:
            return known
        try:
            found = self._conversion(at)
        except Damaged:
            found = ChannelConversion(fault="a damaged conversion")
        self._conversions[at] = found
        return found

    def _conversion(self, at: int) -> ChannelConversion:
        block = self._block(at, b"##CC", 4, _CONVERSION.size, once=False)
        kind, _, _, texts, numbers, _, _ = _CONVERSION.unpack(block.data)
        _, size, count = self._head(at)
        if 4 + texts > count or size < BLOCK_HEAD.size + 8 * count + _CONVERSION.size + 8 * numbers:
            raise Damaged(f"the conversion at byte {at} is shorter than it says; it is damaged")
        links = struct.unpack(f"<{texts}Q", self._bytes(at + BLOCK_HEAD.size + 32, 8 * texts))
        raw = self._bytes(at + BLOCK_HEAD.size + 8 * count + _CONVERSION.size, 8 * numbers)
        # a text may be another conversion, which is none of the texts that are understood
        said = tuple(
            self._text(link) if link and self._head(link)[0] in (b"##TX", b"##MD") else "" for link in links
        )
        return conversion_of(kind, np.frombuffer(raw, "<f8"), said)

    # ---- where the records are

    def _segments(self, at: int, out: list[Segment], of: bytes = b"DT") -> None:
        """Collect the data blocks that exist: of records, or of bytes of variable length."""
        if not at:
            return
        name, _, _ = self._head(at)
        if name == b"##HL":
            at = self._block(at, b"##HL", 1, 0).links[0]
            name = self._head(at)[0] if at else b""
        if name == b"##DL":
            self._list(at, out, of)
        elif at:
            self._data(at, out, of)

    def _list(self, at: int, out: list[Segment], of: bytes) -> None:
        while at:
            _, _, count = self._head(at)
            if count > BLOCKS:
                raise UnusualFile(f"it has more than {BLOCKS} blocks")
            block = self._block(at, b"##DL", 1, 8)
            said = min(struct.unpack_from("<I", block.data, 4)[0], count - 1)
            for link in struct.unpack(f"<{said}Q", self._bytes(at + BLOCK_HEAD.size + 8, 8 * said)):
                self._data(link, out, of)
            at = block.links[0]

    def _data(self, at: int, out: list[Segment], of: bytes) -> None:
        name, size, count = self._head(at)
        if name == b"##" + of:
            self._once(at)
            first = at + BLOCK_HEAD.size + 8 * count
            there = max(0, min(at + size, self._size) - first)
            self._add(out, Segment(first, there, there))
            if at + size > self._size and not self._unfinished & _LAST_LENGTH:
                raise Damaged("the file ends within the records")
        elif name == b"##DZ":
            block = self._block(at, b"##DZ", 0, _PACKED.size)
            packed, packing, _, columns, size, stored = _PACKED.unpack(block.data)
            first = at + BLOCK_HEAD.size + 8 * count + _PACKED.size
            if packing > 1 or packed != of or size > PACKED_MOST:
                raise UnusualFile("its records are packed in a way that is not known here")
            if first + stored > self._size:
                raise Damaged("the file ends within packed records")
            if size > 1040 * (stored + 16) or (packing and not columns):  # deflate cannot
                raise Damaged("a packed block says of itself what cannot be")
            self._add(out, Segment(first, stored, size, columns if packing else 0))
        elif name in (b"##LD", b"##DL", b"##HL", b"##DV"):
            raise UnusualFile(f"its records are in {name[2:].decode()} blocks that are not known here")
        else:
            raise Damaged(f"at byte {at} there are no records, though some are named there")

    def _add(self, out: list[Segment], segment: Segment) -> None:
        self._records_left -= segment.stored
        if self._records_left < 0:
            raise Damaged(_AGAIN)
        out.append(segment)

    def _stretched(self, last: Segment) -> Segment:
        """Return a data block of which the length may be missing: it goes on to the end of the file."""
        end = last.at + last.size
        if end == self._size:
            return last
        behind = [at for at in self._ends if at >= last.at]
        if not behind:
            return Segment(last.at, self._size - last.at, self._size - last.at)
        if min(behind) - end in range(8):
            return last
        raise UnusualFile("of a block in its middle the length is missing")
