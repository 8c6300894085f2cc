"""Frames to packets, whole tables at once: the rule of `declare.transport`, for captures.

1. The answer is that of `live.reassemble`, packet for packet and reason for reason. Only what is without fault is put
   together here, in arrays; the frames of anything else go through the live reassembler, run by run.
2. Pieces may be cut anywhere: frames of packets under way stay, and come in front of the next piece.

Frames are sorted by session. A run is a first or single frame and what follows it in its session; it is a packet when it has
as many frames as the first one promises, in their places, full and in time. Bytes are gathered from all packets of one shape
at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...frame_table import EXTENDED, NO_TIME, RX, TX, FrameTable, rows_at
from ..declare.transport import Transport
from ..keys import FD
from ..live.reassemble import Reassembler
from .carried import FIRST, NEXT, NO_PART, SINGLE, FrameParts, bare_keys, can_table
from .key_numbers import KeyNumbers
from .table import Array

#: Widths of the tables of packets: short packets do not take the room of long ones.
_WIDTHS = (8, 64, 512)
#: Above this width, by so many bytes.
_STEP = 1024
#: The flags of a frame that its packet has, too: those of its identifier and of its way.
_KEPT = EXTENDED | RX | TX


@dataclass
class CarriedTable:
    """Packets as columns, in the order of their last frames.

    `packets` is a table like that of frames: `time` is that of the last frame, `length` and `data` are the packet's. `rows`:
    the last frame's number in the capture; `first_time`: the instant of the first one; `counts`: how many frames. Which
    these are, `frames_of` says: `shapes` has the places of all frames of packets that are alike, `where` the shape of each
    packet and its row there.
    """

    packets: FrameTable
    rows: Array
    first_time: Array
    counts: Array
    shapes: list[Array]
    where: tuple[Array, Array]

    def frames_of(self, number: int) -> Array:
        """The places of the frames of one packet, in the order in which they came, in the table that was decided."""
        shape, row = self.where
        frames: Array = np.sort(self.shapes[int(shape[number])][:, int(row[number])])
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
        self._has_columns = can_table(transport)
        #: Frames of packets under way, in the order of the capture, and their numbers.
        self._left = FrameTable.empty()
        self._left_rows: Array = np.empty(0, np.int64)
        self._keys = KeyNumbers()
        #: Of a transport with acknowledged packets, what goes on from piece to piece: its sessions that are lost.
        self._talks = Reassembler(transport) if transport.has_conversations else None

    @property
    def pending(self) -> int:
        """Frames that are in packets under way."""
        return len(self._left_rows)

    def feed(self, table: FrameTable, rows: Array) -> DecidedTable:
        """What frames of the transport decide, which are `rows` of the capture, in order."""
        if self.pending:
            table = FrameTable.concat([self._left, table])
            rows = np.concatenate([self._left_rows, rows])
        piece = _Piece(self.transport, table, rows, self._extra_of)
        left = piece.in_columns(self._keys) if self._has_columns else None
        if left is None:
            piece = _Piece(self.transport, table, rows, self._extra_of)
            left = piece.one_by_one() if self._talks is None else piece.gone_on(self._talks)
        self._left, self._left_rows = table.take(left), rows[left]
        return piece.decided()

    def close(self) -> tuple[FrameTable, Array]:
        """The frames that are pending at the end, and their numbers."""
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
        #: By width: of packets that are alike, their frames' places (count, m), keys, sizes, bytes.
        self._packets: dict[int, list[tuple[Array, Array, Array, Array]]] = {}
        self._lost: list[Array] = []
        self._reasons: list[str] = []

    def decided(self) -> DecidedTable:
        """Everything."""
        packets = [self._joined(some) for some in self._packets.values()]
        lost = np.concatenate(self._lost) if self._lost else np.empty(0, np.int64)
        return DecidedTable(self.table, self.rows, packets, lost, self._reasons)

    def _joined(self, some: list[tuple[Array, Array, Array, Array]]) -> CarriedTable:
        """Packets of one width, in the order of their last frames."""
        table = self.table
        in_order = self.transport.any_order
        shapes = [frames for frames, _, _, _ in some]
        last = np.concatenate([f.max(axis=0) if in_order else f[-1] for f in shapes])
        first = np.concatenate([frames[0] for frames in shapes])
        sizes = [frames.shape[1] for frames in shapes]
        shape = np.repeat(np.arange(len(shapes)), sizes)
        row = np.concatenate([np.arange(n) for n in sizes])
        keys, length, data = (
            np.concatenate([one[k] for one in some]) if len(some) > 1 else some[0][k] for k in (1, 2, 3)
        )
        if (last[1:] < last[:-1]).any():
            order = _sorted_places(last, len(table))
            last, first, shape, row = last[order], first[order], shape[order], row[order]
            keys, length, data = keys[order], length[order], data[order]
        flags = table.flags[last] & np.uint8(_KEPT)
        number = keys & np.uint32(0x1FFF_FFFF)
        packets = FrameTable(
            table.time[last], table.channel[last], number, flags, length, data, table.channels
        )
        counts = np.array([len(frames) for frames in shapes])[shape]
        return CarriedTable(packets, self.rows[last], table.time[first], counts, shapes, (shape, row))

    def _lose(self, places: Sequence[int] | Array, reason: str) -> None:
        if len(places):
            self._lost.append(np.asarray(places, np.int64))
            self._reasons += [reason] * len(places)

    def _add(self, frames: Array, keys: Array, length: Array, data: Array) -> None:
        """Packets of as many frames each."""
        if self._unwraps and len(frames) > 1:
            frames, keys, length, data = self._unwrapped(frames, keys, length, data)
        self._packets.setdefault(data.shape[1], []).append((frames, keys, length, data))

    def _unwrapped(
        self, frames: Array, keys: Array, length: Array, data: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Packets of several frames without the check that their transport has added; those where it is wrong are lost."""
        width, raw, unwrapped = data.shape[1], data.tobytes(), self.transport.unwrapped
        found = [
            unwrapped(raw[at : at + size], self._extra_of(key))
            for key, at, size in zip(keys.tolist(), range(0, len(raw), width), length.tolist(), strict=True)
        ]
        good = np.array([one is not None for one in found], bool)
        self._lose(frames[:, ~good].ravel(), "malformed: checksum")
        kept = [one for one in found if one is not None]
        rows = np.frombuffer(b"".join(one.ljust(width, b"\0") for one in kept), np.uint8).reshape(-1, width)
        return frames[:, good], keys[good], np.array([len(one) for one in kept], np.int64), rows

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
            places = [place_of[one.number] for one in packet.frames]
            if packet.reason:
                self._lose(places, packet.reason)
            else:
                whole.append((packet.key, packet.data, places))
        self._gather_whole(whole)
        return np.array(sorted(place_of[one.number] for one in reassembler.under_way()), np.int64)

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
                    numbers = [one.number for one in packet.frames]
                    if numbers == [after]:
                        continue
                    if packet.reason:
                        self._lose(numbers, packet.reason)
                    else:
                        made.append((packet.key, packet.data, numbers))
            left += (
                one.number for packet in reassembler.close() for one in packet.frames if one.number != after
            )
        self._gather_whole(made)
        return np.array(sorted(left), np.int64)

    def _gather_whole(self, made: Sequence[tuple[int, bytes, list[int]]]) -> None:
        """Packets that the rule has made, as key, bytes and places: all of one width and so many frames at once."""
        shapes: dict[tuple[int, int], list[tuple[int, bytes, list[int]]]] = {}
        for one in made:
            shapes.setdefault((_width_of(len(one[1])), len(one[2])), []).append(one)
        for (width, _), some in shapes.items():
            data = np.frombuffer(b"".join(one[1].ljust(width, b"\0") for one in some), np.uint8)
            self._add(
                np.array([one[2] for one in some], np.int64).T,
                np.array([one[0] for one in some], np.uint32),
                np.array([len(one[1]) for one in some], np.int64),
                data.reshape(-1, width),
            )

    def _items(self, places: Array | None) -> dict[int, tuple[int, bytes, int, float | None]]:
        """Key, data, channel and seconds of frames, by their places."""
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

    def in_columns(self, keys: KeyNumbers) -> Array | None:
        """Decide all frames; the places of those that are under way. None where more packets may be under way than there
        are senders: which of them is given up, only the rule says."""
        parts = FrameParts(self.transport, self.table)
        for places, reason in parts.reasons:
            self._lose(places, reason)
        numbers = keys.of(bare_keys(self.table))
        session = parts.sessions(numbers, len(keys))
        if parts.reasons:
            some = np.flatnonzero(parts.role != NO_PART)
            order = some[np.argsort(session[some], kind="stable")]
        else:
            order = np.argsort(session, kind="stable")
        if not len(order):
            return order
        runs = _Runs(parts, order, session[order])
        if runs.most_open() > self.transport.senders:
            return None
        self._gather(parts, runs)
        return self._faulty(runs)

    def _faulty(self, runs: _Runs) -> Array:
        """Runs that are no whole packet: frames are lost, or under way where the session has nothing behind them."""
        bad = np.flatnonzero(~runs.good)
        if not len(bad):
            return np.empty(0, np.int64)
        starts, ends = runs.starts[bad], runs.starts[bad] + runs.sizes[bad]
        listed: list[tuple[Sequence[int], int | None]] = []
        headless: list[Array] = []
        needed: list[Array] = []
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
        return self._by_rule(listed, np.unique(np.concatenate(needed))) if listed else np.empty(0, np.int64)

    def _gather(self, parts: FrameParts, runs: _Runs) -> None:
        """The bytes of whole packets, all that are alike at once."""
        alone = runs.starts[(runs.sizes == 1) & runs.good]
        if len(alone):
            places = runs.order[alone]
            self._alike(parts, places[None, :], parts.size[places])
        for which, frames in runs.shapes:
            good = runs.good[which]
            frames = frames if good.all() else frames[:, good]
            is_sized = parts.is_sized
            total = parts.size[frames[0]] if is_sized else parts.piece[frames].sum(axis=0, dtype=np.int64)
            if frames.shape[1]:
                self._alike(parts, frames, total)

    def _alike(self, parts: FrameParts, frames: Array, total: Array) -> None:
        """Packets of as many frames each, with first frames of one length: `frames` are their places (count, m), `total` how
        many bytes they have, the address aside."""
        table, address, count = self.table, self.transport.address, len(frames)
        following = self.transport.following
        for kind, some in parts.by_kind(frames[0]):
            mine, size = (frames, total) if some is None else (frames[:, some], total[some])
            size = size.astype(np.int64) + address
            least, most = int(size.min()), int(size.max())
            width = _width_of(most)
            first = rows_at(table.data, mine[0])
            begin = address + kind.head
            data = np.zeros((len(size), width), np.uint8)
            data[:, :address] = first[:, :address]
            end = int(table.length[mine[0, 0]]) - kind.tail if count > 1 else first.shape[1]
            reach = min(width - address, end - begin)
            data[:, address : address + reach] = first[:, begin : begin + reach]
            at, step = address + reach, address + following.head
            for places in mine[1:]:
                stop = min(end + kind.tail - following.tail, step + width - at)
                data[:, at : at + stop - step] = rows_at(table.data, places)[:, step:stop]
                at += stop - step
            if least == most:
                data[:, most:] = 0
            else:
                data *= np.arange(width) < size[:, None]
            keys = table.key[mine[0]] & np.uint32(~FD & 0xFFFF_FFFF)
            self._add(mine, keys, size, data)


class _Runs:
    """Frames in the order of their sessions, in runs: each begins with a first or single frame, or with a session."""

    def __init__(self, parts: FrameParts, order: Array, session: Array) -> None:
        self.parts, self.order, self._session = parts, order, session
        n = len(order)
        role = parts.role[order]
        self._is_new = np.ones(n + 1, bool)
        np.not_equal(session[1:], session[:-1], out=self._is_new[1:n])
        #: Of each run: where it begins in `order`, how many frames it has, what its first frame is.
        self.starts = np.flatnonzero(self._is_new[:n] | (role != NEXT))
        self.sizes = np.diff(np.append(self.starts, n))
        self.role = role[self.starts]
        #: Whether it is a whole packet without fault.
        self.good = (self.role == SINGLE) & (self.sizes == 1)
        #: Runs of several frames that are alike: which, and where their frames are, first to last (count, m).
        self.shapes: list[tuple[Array, Array]] = []
        firsts = np.flatnonzero(self.role == FIRST)
        if len(firsts):
            self._whole(firsts)

    @property
    def is_last(self) -> Array:
        """Whether nothing of a run's session follows it."""
        found: Array = self._is_new[self.starts + self.sizes]
        return found

    def most_open(self) -> int:
        """How many packets are under way at once, or more than that."""
        senders = self.parts.transport.senders
        sessions = int(np.count_nonzero(self._is_new)) - 1
        more = np.flatnonzero((self.role == FIRST) & ((self.sizes > 1) | ~self.good))
        if min(sessions, len(more)) <= senders:
            return min(sessions, len(more))
        n = len(self.parts.role)
        last = self.starts[more] + self.sizes[more]
        until = np.where(self.is_last[more], n, self.order[np.minimum(last, len(self.order) - 1)])
        if not self.parts.transport.any_order:
            until = np.where(self.good[more], self.order[last - 1], until)
        begun = np.bincount(self.order[self.starts[more]], minlength=n + 1)
        return int(np.cumsum(begun - np.bincount(until, minlength=n + 1)).max())

    def _whole(self, firsts: Array) -> None:
        """Which of the runs that begin with a first frame are whole packets without fault."""
        parts, transport = self.parts, self.parts.transport
        begin, sizes = self.starts[firsts], self.sizes[firsts]
        head = self.order[begin]
        length = parts.table.length[head].astype(np.int64)
        following = transport.following
        room = length - (transport.address + following.head + following.tail)
        rest = parts.size[head] - parts.piece[head].astype(np.int64)
        if parts.is_sized:
            good = np.where(rest > 0, -(-rest // np.maximum(room, 1)), 0) + 1 == sizes
        else:
            good = (sizes > 1) | parts.last[head]
        is_full = length == 8
        if transport.fd:
            is_full = np.isin(length, np.array(transport.lengths()))
        good &= (room > 0) & (is_full | (sizes == 1))
        self.good[firsts] = good
        more = np.flatnonzero(good & (sizes > 1))
        if not len(more):
            return
        # In the order of their last frames, as they are wanted in the end.
        more = more[_sorted_places(self.order[begin[more] + sizes[more] - 1], len(parts.role))]
        shape = sizes[more] * 128 + length[more]
        by_shape = np.argsort(shape, kind="stable") if (shape != shape[0]).any() else np.arange(len(shape))
        for some in np.split(more[by_shape], np.flatnonzero(np.diff(shape[by_shape])) + 1):
            count = int(sizes[some[0]])
            frames = self.order[np.arange(count)[:, None] + begin[some]]
            frames, right = self._right(frames, int(room[some[0]]), rest[some])
            self.good[firsts[some]] = right
            self.shapes.append((firsts[some], frames))

    def _right(self, frames: Array, room: int, rest: Array) -> tuple[Array, Array]:
        """Of runs of as many frames each (count, m): the frames in their places, and which runs are without fault. `rest` is
        how many bytes there are behind the first frame's."""
        parts, transport, table = self.parts, self.parts.transport, self.parts.table
        count = len(frames)
        is_right = np.ones(frames.shape[1], bool)
        for step, places in enumerate(frames[1:]):
            is_right &= parts.number[places] == (transport.first_number + step) % transport.modulo
        begun, done = table.time[frames[0]], table.time[frames[-1]]
        slow = done - begun > transport.timeout_s * 1e9 - 1000
        if slow.any() or not parts.is_in_time_order or int(begun.min()) == NO_TIME:
            is_right &= ~_late(table.time[frames], transport.timeout_s)
        if transport.any_order and not is_right.all() and count <= transport.modulo:
            place = (
                parts.number[frames[1:]].astype(np.int64) - transport.first_number
            ) % transport.modulo + 1
            sort = np.argsort(place, axis=0, kind="stable")
            is_all = (np.take_along_axis(place, sort, axis=0) == np.arange(1, count)[:, None]).all(axis=0)
            is_right |= is_all & ~_late(table.time[frames], transport.timeout_s)
            frames = np.concatenate([frames[:1], np.take_along_axis(frames[1:], sort, axis=0)])
        if not parts.is_even or not parts.is_sized:
            piece = parts.piece[frames[1:]]
            is_right &= (piece[:-1] == room).all(axis=0)
            if parts.is_sized:
                is_right &= piece[-1] >= rest - (count - 2) * room
            else:
                last = parts.last[frames]
                is_right &= last[-1] & ~last[:-1].any(axis=0) & (piece[-1] <= room)
                total = parts.piece[frames].sum(axis=0, dtype=np.int64) + transport.address
                is_right &= total <= transport.longest + transport.overhead
        return frames, is_right


def _late(time: Array, timeout_s: float) -> Array:
    """In which columns (count, m) more than the time-out goes by between two frames, as the live reassembler computes it."""
    seconds = time / 1_000_000_000
    late = np.greater(np.diff(seconds, axis=0), timeout_s)
    known = time != NO_TIME
    found: Array = (late & known[1:] & known[:-1]).any(axis=0)
    return found


def _sorted_places(places: Array, count: int) -> Array:
    """The order of places in a table of `count` frames: of a small one by their 16 bits, which is much quicker."""
    return np.argsort(places.astype(np.uint16) if count <= 1 << 16 else places, kind="stable")


def _width_of(size: int) -> int:
    """How wide the table is that a packet of `size` bytes is in."""
    return next((width for width in _WIDTHS if size <= width), -(-size // _STEP) * _STEP)
