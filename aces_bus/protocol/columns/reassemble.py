"""Frames to packets, whole tables at once: the rule of `declare.transport`, for captures.

1. The answer is that of `live.reassemble`, packet for packet and reason for reason. Only what is without fault is put
   together here, in arrays; the frames of anything else go through the live reassembler, run by run.
2. Pieces may be cut anywhere: frames of packets under way stay, and come in front of the next piece.

What each frame is, `carried` says, and which are whole packets, `runs`. Bytes are gathered from all packets of one shape at
once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...frame_table import NO_TIME, FrameFlag, FrameTable
from ..declare.transport import Transport
from ..live.reassemble import Reassembler
from .carried import NEXT, FrameParts, PartReader
from .grouped import GroupedFrames, bare_keys
from .runs import AlikePackets, Runs, sorted_places
from .sessions import part_reader
from .table import Array
from .unwrap import without_check

#: Up to these sizes packets are in one table: short ones do not take the room of long ones.
_SIZES = (8, 64, 512)
#: Above them, up to each further multiple of so many bytes.
_STEP = 1024
#: The flags of a frame that its packet has, too: those of its identifier and of its way.
_KEPT = FrameFlag.EXTENDED | FrameFlag.RX | FrameFlag.TX


class _Alike(NamedTuple):
    """Packets that are alike: so many `frames` each. Places of frames in the table: all are `order` from `starts` on;
    `first` and `last` are where a packet begins and ends. Keys; sizes; bytes (m, width)."""

    order: Array
    frames: int
    starts: Array
    first: Array
    last: Array
    keys: Array
    length: Array
    data: Array


@dataclass
class CarriedTable:
    """Packets as columns, in the order of their last frames.

    `packets` is a table like that of frames: `time` is that of the last frame, `length` and `data` are the packet's. `rows`:
    the last frame's number in the capture; `first_time`: the instant of the first one; `counts`: how many frames. Which
    these are, `frames_of` says: `shapes` has, of packets that are alike, the places of frames and where among them each
    packet's begin; `where` the shape of each packet and its row there.
    """

    packets: FrameTable
    rows: Array
    first_time: Array
    counts: Array
    shapes: list[tuple[Array, Array]]
    where: tuple[Array, Array]

    def frames_of(self, number: int) -> Array:
        """Return the places of the frames of one packet, in the order in which they came, in the table that was decided."""
        shape, row = self.where
        order, starts = self.shapes[int(shape[number])]
        start = int(starts[int(row[number])])
        frames: Array = np.sort(order[start : start + int(self.counts[number])])
        return frames


@dataclass
class DecidedTable:
    """What is decided about frames: packets, and those that are lost, by their places in `table`, with reasons. `rows` are
    the numbers of the table's frames in the capture."""

    table: FrameTable
    rows: Array
    packets: list[CarriedTable]
    lost: Array
    reasons: list[str]


class ColumnReassembler:
    """Makes packets of the frames of one transport, piece by piece; `extra_of` gives the `check_extra` of a packet's key."""

    def __init__(self, transport: Transport, extra_of: Callable[[int], bytes]) -> None:
        self.transport, self._extra_of = transport, extra_of
        self._reader: PartReader | None = part_reader(transport)
        #: Frames of packets under way, in the order of the capture, and their numbers.
        self._left = FrameTable.empty()
        self._left_rows: Array = np.empty(0, np.int64)
        #: Of a transport with acknowledged packets, what goes on from piece to piece: its sessions that are lost.
        self._talks = Reassembler(transport) if transport.has_conversations else None

    @property
    def pending(self) -> int:
        """Frames that are in packets under way."""
        return len(self._left_rows)

    def feed(self, table: FrameTable, rows: Array) -> DecidedTable:
        """Take frames of the transport, and return what they decide; they are `rows` of the capture, in order."""
        if self.pending:
            table = FrameTable.concat([self._left, table])
            rows = np.concatenate([self._left_rows, rows])
        piece = _Piece(self.transport, table, rows, self._extra_of)
        is_quiet = self._talks is None or self._talks.is_idle
        left = piece.in_columns(self._reader) if self._reader is not None and is_quiet else None
        if left is None:
            piece = _Piece(self.transport, table, rows, self._extra_of)
            left = piece.one_by_one() if self._talks is None else piece.gone_on(self._talks)
        self._left, self._left_rows = table.take(left), rows[left]
        return piece.decided()

    def close(self) -> tuple[FrameTable, Array]:
        """End the input; return the frames that are pending, and their numbers."""
        if self._talks is not None:
            self._talks.reset()
        left, rows = self._left, self._left_rows
        self._left, self._left_rows = FrameTable.empty(), np.empty(0, np.int64)
        return left, rows


class _Piece:
    """The frames that are decided at once."""

    def __init__(
        self, transport: Transport, table: FrameTable, rows: Array, extra_of: Callable[[int], bytes]
    ) -> None:
        self.transport, self.table, self.rows, self._extra_of = transport, table, rows, extra_of
        self._unwraps = type(transport).unwrapped is not Transport.unwrapped
        self._check = transport.added_check
        #: By the size up to which they are in one table.
        self._packets: dict[int, list[_Alike]] = {}
        self._lost: list[Array] = []
        self._reasons: list[str] = []

    def decided(self) -> DecidedTable:
        """Return everything that was decided."""
        packets = [self._joined(some) for some in self._packets.values()]
        lost = np.concatenate(self._lost) if self._lost else np.empty(0, np.int64)
        return DecidedTable(self.table, self.rows, packets, lost, self._reasons)

    def _joined(self, some: list[_Alike]) -> CarriedTable:
        """Join packets of one table, in the order of their last frames."""
        table = self.table
        sizes = [len(part.starts) for part in some]
        first, last, keys, length = (
            getattr(some[0], name)
            if len(some) == 1
            else np.concatenate([getattr(part, name) for part in some])
            for name in ("first", "last", "keys", "length")
        )
        data = _stacked([part.data for part in some])
        shape, counts = (
            np.repeat(np.arange(len(some)), sizes),
            np.repeat([part.frames for part in some], sizes),
        )
        row = np.concatenate([np.arange(n) for n in sizes])
        if (last[1:] < last[:-1]).any():
            order = sorted_places(last, len(table))
            last, first, shape, row, counts = (
                last[order],
                first[order],
                shape[order],
                row[order],
                counts[order],
            )
            keys, length, data = keys[order], length[order], data[order]
        flags = table.flags[last] & np.uint8(_KEPT)
        number = keys & np.uint32(0x1FFF_FFFF)
        packets = FrameTable(
            table.time[last], table.channel[last], number, flags, length, data, table.channels
        )
        shapes = [(part.order, part.starts) for part in some]
        return CarriedTable(packets, self.rows[last], table.time[first], counts, shapes, (shape, row))

    def _lose(self, places: Sequence[int] | Array, reason: str) -> None:
        if len(places):
            self._lost.append(np.asarray(places, np.int64))
            self._reasons += [reason] * len(places)

    def _add(self, packets: _Alike) -> None:
        """Add packets that have one number of frames."""
        order, count, starts, first, last, keys, length, data = packets
        if self._unwraps and count > 1:
            good, length, data = self._unwrapped(keys, length, data)
            if not good.all():
                frames = order[starts[~good][:, None] + np.arange(count)]
                self._lose(frames.ravel(), "malformed: checksum")
                starts, first, last, keys = starts[good], first[good], last[good], keys[good]
            if not len(keys):
                return
            packets = _Alike(order, count, starts, first, last, keys, length, data)
        self._packets.setdefault(_class_of(data.shape[1]), []).append(packets)

    def _unwrapped(self, keys: Array, length: Array, data: Array) -> tuple[Array, Array, Array]:
        """Return, for packets of several frames: where the check of their transport is right, and sizes and
        bytes without it.
        """
        if self._check is not None:
            return without_check(self._check, self._extra_of, keys, length, data)
        width, raw, unwrapped = data.shape[1], data.tobytes(), self.transport.unwrapped
        found = [
            unwrapped(raw[at : at + size], self._extra_of(key))
            for key, at, size in zip(keys.tolist(), range(0, len(raw), width), length.tolist(), strict=True)
        ]
        kept = [payload for payload in found if payload is not None]
        rows = np.frombuffer(b"".join(payload.ljust(width, b"\0") for payload in kept), np.uint8).reshape(
            -1, width
        )
        good = np.array([payload is not None for payload in found], bool)
        return good, np.array([len(payload) for payload in kept], np.int64), rows

    # ------------------------------------------------------------------ by the live reassembler

    def one_by_one(self) -> Array:
        """Decide all frames; the places of those that are under way."""
        return self._by_rule([(range(len(self.table)), None)], None)

    def gone_on(self, reassembler: Reassembler) -> Array:
        """Decide the frames that the reassembler has not had yet; the places of all that are under way.

        It numbers frames by their rows in the capture, as their places change from piece to piece.
        """
        begin, made = reassembler.pending, []
        items = self._items(np.arange(begin, len(self.table)))
        place_of = {row: place for place, row in enumerate(self.rows.tolist())}
        for place, item in items.items():
            made += reassembler.take(None, int(self.rows[place]), *item)
        whole: list[tuple[int, bytes, list[int]]] = []
        for packet in made:
            places = [place_of[frame.number] for frame in packet.frames]
            if packet.reason:
                self._lose(places, packet.reason)
            else:
                whole.append((packet.key, packet.data, places))
        self._gather_whole(whole)
        return np.array(sorted(place_of[frame.number] for frame in reassembler.under_way()), np.int64)

    def _by_rule(self, runs: Sequence[tuple[Sequence[int], int | None]], places: Array | None) -> Array:
        """Decide runs of frames, each by itself. A run's second part is the frame that begins the session's next packet: it
        says why this one ended. `places` are those of all the frames in runs, sorted; None: all."""
        items = self._items(places)
        left: list[int] = []
        made: list[tuple[int, bytes, list[int]]] = []
        for run, after in runs:
            reassembler = Reassembler(self.transport)
            for place in [*run, after] if after is not None else run:
                for packet in reassembler.take(None, place, *items[place]):
                    numbers = [frame.number for frame in packet.frames]
                    if numbers == [after]:
                        continue
                    if packet.reason:
                        self._lose(numbers, packet.reason)
                    else:
                        made.append((packet.key, packet.data, numbers))
            left += (
                frame.number
                for packet in reassembler.close()
                for frame in packet.frames
                if frame.number != after
            )
        self._gather_whole(made)
        return np.array(sorted(left), np.int64)

    def _gather_whole(self, made: Sequence[tuple[int, bytes, list[int]]]) -> None:
        """Add packets that the rule has made (key, bytes, places): all of one width and one number of frames
        at once.
        """
        shapes: dict[tuple[int, int], list[tuple[int, bytes, list[int]]]] = {}
        for packet in made:
            shapes.setdefault((_class_of(len(packet[1])), len(packet[2])), []).append(packet)
        for (width, _), some in shapes.items():
            data = np.frombuffer(b"".join(packet[1].ljust(width, b"\0") for packet in some), np.uint8)
            frames = np.array([packet[2] for packet in some], np.int64)
            self._add(
                _Alike(
                    frames.ravel(),
                    frames.shape[1],
                    np.arange(len(frames)) * frames.shape[1],
                    frames[:, 0],
                    frames[:, -1],
                    np.array([packet[0] for packet in some], np.uint32),
                    np.array([len(packet[1]) for packet in some], np.int64),
                    data.reshape(-1, width),
                )
            )

    def _items(self, places: Array | None) -> dict[int, tuple[int, bytes, int, float | None]]:
        """Yield key, data, channel and seconds of frames, by their places."""
        table = self.table if places is None else self.table.take(places)
        width, raw = table.data.shape[1], table.data.tobytes()
        numbers = range(len(table)) if places is None else places.tolist()
        columns = zip(
            numbers,
            bare_keys(table).tolist(),
            range(0, len(raw), width),
            table.length.tolist(),
            table.channel.tolist(),
            table.time.tolist(),
            strict=True,
        )
        return {
            place: (key, raw[at : at + length], channel, time / 1_000_000_000 if time != NO_TIME else None)
            for place, key, at, length, channel, time in columns
        }

    # ------------------------------------------------------------------ in columns

    def in_columns(self, reader: PartReader) -> Array | None:
        """Decide all frames; the places of those that are under way. None where only the rule can say: of
        acknowledged packets, and which packet is given up where more may be under way than there are senders."""
        parts = reader.read(GroupedFrames.of(self.table, reader.sessions(self.table)))
        if parts is None:
            return None
        for places, reason in parts.reasons:
            self._lose(places, reason)
        if not len(parts.frames):
            return self._by_rule([(places.tolist(), None) for places in parts.tied], None)
        runs = Runs(self.transport, parts)
        if runs.most_open() > self.transport.senders:
            return None
        for packets in runs.packets:
            self._gather(parts, packets)
        under_way = runs.frames_of(np.flatnonzero(runs.under_way))
        return np.sort(np.concatenate([under_way, self._faulty(runs, parts.tied)]))

    def _faulty(self, runs: Runs, tied: Sequence[Array]) -> Array:
        """Collect runs that are not a whole packet: frames are lost, or under way at the end of their session."""
        bad = np.flatnonzero(~(runs.good | runs.under_way))
        listed: list[tuple[Sequence[int], int | None]] = [(places.tolist(), None) for places in tied]
        headless: list[Array] = []
        needed: list[Array] = [*tied]
        starts, ends = runs.starts[bad], runs.starts[bad] + runs.sizes[bad]
        for start, end, role, is_last in zip(
            starts.tolist(), ends.tolist(), runs.role[bad].tolist(), runs.is_last[bad].tolist(), strict=True
        ):
            if role == NEXT:
                headless.append(runs.order[start:end])
                continue
            needed.append(runs.order[start : end if is_last else end + 1])
            listed.append((runs.order[start:end].tolist(), None if is_last else int(runs.order[end])))
        if headless:
            self._lose(np.concatenate(headless), "malformed: no first frame")
        if not listed:
            return np.empty(0, np.int64)
        return self._by_rule(listed, np.unique(np.concatenate(needed)))

    def _gather(self, parts: FrameParts, packets: AlikePackets) -> None:
        """Gather the bytes of packets that are alike."""
        starts, count, size, keys = packets.starts, packets.count, packets.size, packets.keys
        frames = parts.frames
        width = frames.data.shape[1]
        # Frames of a packet, which are side by side, as single elements are copied much faster than one by one.
        windows = np.ndarray(len(frames) - count + 1, f"V{width * count}", frames.data, 0, (width,))
        rows = windows[starts].view(np.uint8).reshape(-1, count, width)
        if packets.places is not None:
            rows = np.take_along_axis(rows, packets.places[:, :, None], axis=1)
        length = int(frames.length[starts[0]])
        data = self._bytes(rows, length, parts.around[packets.head], parts.following, size)
        self._add(_Alike(frames.order, count, starts, packets.first, packets.last, keys, size, data))

    def _bytes(
        self, rows: Array, length: int, around: tuple[int, int], following: tuple[int, int], size: Array
    ) -> Array:
        """Return the bytes of packets whose frames are `rows` (m, count, …), the first one of which has `length`:
        uint8 (m, width)
        with zeros behind each. `around` and `following` say how much of the first and the other frames is not theirs."""
        address = self.transport.address
        m, count, _ = rows.shape
        least, most = int(size.min()), int(size.max())
        width = -(-most // 8) * 8
        data = np.empty((m, width), np.uint8)
        data[:, most:] = 0
        begin, behind = around
        end = length - behind if count > 1 else rows.shape[2]
        at = min(most, address + end - begin)
        flat, frame = rows.reshape(m, -1), rows.shape[2]
        _copy(data, (0, 0), flat, (0, 0), address, 1)
        _copy(data, (address, 0), flat, (begin, 0), at - address, 1)
        begin, behind = following
        room = length - begin - behind
        _copy(data, (at, room), flat, (frame + begin, frame), room, count - 2)
        if count > 1:
            at += (count - 2) * room
            _copy(data, (at, 0), flat, ((count - 1) * frame + begin, 0), min(most - at, room), 1)
        if least < most:
            data[:, least:most] *= np.arange(least, most) < size[:, None]
        return data


def _class_of(size: int) -> int:
    """Return the size up to which packets are in one table with those of `size` bytes."""
    return next((most for most in _SIZES if size <= most), -(-size // _STEP) * _STEP)


def _stacked(some: Sequence[Array]) -> Array:
    """Return rows of bytes of several widths as rows of the widest."""
    if len(some) == 1:
        return some[0]
    data = np.zeros((sum(map(len, some)), max(rows.shape[1] for rows in some)), np.uint8)
    at = 0
    for rows in some:
        data[at : at + len(rows), : rows.shape[1]] = rows
        at += len(rows)
    return data


def _copy(to: Array, at: Sequence[int], source: Array, begin: Sequence[int], size: int, count: int) -> None:
    """Copy from each row of `source` to that of `to` the `count` pieces of `size` bytes, the first one of which begins at
    `begin[0]` and is to be at `at[0]`; from one to the next it is `begin[1]` and `at[1]`."""
    if size > 0 and count > 0:
        kind, shape = f"V{size}", (len(to), count)
        pieces = np.ndarray(shape, kind, source, begin[0], (source.strides[0], begin[1]))
        np.ndarray(shape, kind, to, at[0], (to.strides[0], at[1]))[...] = pieces
