"""Which frames of a transport are whole packets: all sessions of a table at once.

1. A run is a first or single frame and what follows it in its session. It is a packet when it has as many frames as the
   first one promises, in their places, full and in time; it is under way when it is so far without fault and nothing
   of its session follows. Of all other runs this file says only that they are neither.
2. Frames whose sessions end one another (`FrameParts.tied`) are in no run.

Packets that are alike (as many frames, first frames of one length) are judged together, in rows of frames: a column of all
frames costs as much as all that is done with the first frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...frame_table import NO_TIME, FrameTable
from ..declare.transport import Transport
from .carried import FIRST, NEXT, NO_PART, SINGLE, UNSIZED, FrameParts
from .table import Array


@dataclass(frozen=True)
class AlikePackets:
    """Packets of as many frames each, whose first frames have one length: their frames' places (m, count), the place of the
    frame that came last, and how many bytes each has, its address among them."""

    frames: Array
    last: Array
    size: Array


class Runs:
    """Frames in the order of their sessions, in runs. `good` are whole packets, `under_way` what may become one."""

    def __init__(self, transport: Transport, table: FrameTable, parts: FrameParts) -> None:
        self.transport, self.table, self.parts = transport, table, parts
        session = parts.session
        is_in = parts.role != NO_PART if parts.reasons else None
        if parts.tied is not None:
            is_in = parts.tied < 0 if is_in is None else is_in & (parts.tied < 0)
        if is_in is None:
            self.order = np.argsort(session, kind="stable")
        else:
            some = np.flatnonzero(is_in)
            self.order = some[np.argsort(session[some], kind="stable")]
        n = len(self.order)
        role = parts.role.take(self.order)
        session = session.take(self.order)
        self._is_new = np.ones(n + 1, bool)
        np.not_equal(session[1:], session[:-1], out=self._is_new[1:n])
        begins = role != NEXT
        begins |= self._is_new[:n]
        #: Of each run: where it begins in `order`, how many frames it has, what its first frame is.
        self.starts = np.flatnonzero(begins)
        self.sizes = np.empty_like(self.starts)
        np.subtract(self.starts[1:], self.starts[:-1], out=self.sizes[:-1])
        self.sizes[-1:] = n - self.starts[-1:]
        self.role = role.take(self.starts)
        #: The whole packets, in each item in the order of their last frames.
        self.packets: list[AlikePackets] = []
        self.good = (self.role == SINGLE) & (self.sizes == 1)
        self.under_way = np.zeros(len(self.starts), bool)
        alone = self.order[self.starts[self.good]]
        if len(alone):
            alone.sort()
            self.packets.append(AlikePackets(alone[:, None], alone, parts.size[alone].astype(np.int64)))
        firsts = np.flatnonzero(self.role == FIRST)
        if len(firsts):
            self._judge(firsts)

    @cached_property
    def is_last(self) -> Array:
        """Whether nothing of a run's session follows it."""
        found: Array = self._is_new[self.starts + self.sizes]
        return found

    def frames_of(self, which: Array) -> Array:
        """The places of all frames of some runs, one run behind the other."""
        sizes = self.sizes[which]
        found: Array = self.order[_ranges(self.starts[which], sizes)]
        return found

    def most_open(self) -> int:
        """How many packets are under way at once, or more than that."""
        tied = self.parts.tied
        others = 0 if tied is None else int(np.count_nonzero(np.bincount(self.parts.session[tied >= 0])))
        sessions = int(np.count_nonzero(self._is_new)) - 1
        senders = self.transport.senders
        if sessions + others <= senders:
            return sessions + others
        more = np.flatnonzero((self.role == FIRST) & ((self.sizes > 1) | ~self.good))
        if len(more) + others <= senders:
            return len(more) + others
        n = len(self.parts.role)
        last = self.starts[more] + self.sizes[more]
        until = np.where(self.is_last[more], n, self.order[np.minimum(last, len(self.order) - 1)])
        if not self.transport.any_order:
            until = np.where(self.good[more], self.order[last - 1], until)
        begun = np.bincount(self.order[self.starts[more]], minlength=n + 1)
        return int(np.cumsum(begun - np.bincount(until, minlength=n + 1)).max()) + others

    # ------------------------------------------------------------------ what is without fault

    def _judge(self, firsts: Array) -> None:
        """Which runs that begin with a first frame are whole packets, and which are under way."""
        transport, table, parts = self.transport, self.table, self.parts
        begin, sizes = self.starts[firsts], self.sizes[firsts]
        head = self.order.take(begin)
        length = table.length.take(head).astype(np.int64)
        around = np.array([before + behind for before, behind in parts.heads], np.int64)
        #: Bytes of the packet in the first frame, its address among them; room in those that follow.
        piece = length - around.take(parts.kind.take(head)) + transport.address
        room = length - sum(parts.following)
        size = parts.size.take(head).astype(np.int64)
        rest = size - piece
        count = np.where(rest > 0, -(-rest // np.maximum(room, 1)), 0) + 1
        is_full = length == 8 if not transport.fd else np.isin(length, np.array(transport.lengths()))
        is_full &= room > 0
        is_whole = (sizes == count) & (is_full | (sizes == 1) & (room > 0))
        may_go_on = (sizes < count) & is_full
        if (is_unsized := size == UNSIZED).any():
            is_whole = np.where(is_unsized, (sizes > 1) & is_full, is_whole)
            may_go_on = np.where(is_unsized, is_full, may_go_on)
        if transport.any_order:
            is_whole &= sizes <= transport.modulo
        self._first, self._room, self._size = piece, room, size
        whole = np.flatnonzero(is_whole)
        if len(whole):
            last = self.order.take(begin[whole] + (sizes[whole] - 1))
            whole = whole[sorted_places(last, len(parts.role))]
            for some in _alike(whole, sizes[whole] * 128 + length[whole]):
                self._judge_alike(firsts, some)
        left = np.flatnonzero(may_go_on & ~self.good[firsts] & self.is_last[firsts])
        if len(left):
            self._judge_under_way(firsts, left)

    def _judge_alike(self, firsts: Array, some: Array) -> None:
        """Of runs that are alike, and have as many frames as they should, those that are packets."""
        transport, parts = self.transport, self.parts
        runs = firsts[some]
        count, room = int(self.sizes[runs[0]]), int(self._room[some[0]])
        frames = self.order.take(self.starts[runs][:, None] + np.arange(count))
        last, size = frames[:, -1].copy(), self._size[some]
        is_right = np.ones(len(some), bool)
        due = (np.arange(count - 1) + transport.first_number) % transport.modulo
        is_due = parts.number.take(frames)[:, 1:] == due.astype(np.uint8)
        if not is_due.all():
            is_right = is_due.all(axis=1)
            if transport.any_order:
                shuffled = np.flatnonzero(~is_right)
                frames[shuffled], is_right[shuffled] = self._in_places(frames[shuffled])
        if not self._is_soon(frames[:, 0], last):
            # The order in which they came.
            is_right &= ~self._late(np.sort(frames, axis=1)).any(axis=1)
        end: Array = np.full(len(some), room)
        if parts.piece is not None and count > 1:
            piece = parts.piece.take(frames)[:, 1:]
            end = piece[:, -1].astype(np.int64)
            if not (is_full := piece[:, :-1] == room).all():
                is_right &= is_full.all(axis=1)
        if parts.piece is not None or parts.last is not None:
            before = self._first[some] + (count - 2) * room
            is_unsized = size == UNSIZED
            is_right &= np.where(is_unsized, end <= room, (count < 2) | (before + end >= size))
            size = np.where(is_unsized, before + end, size)
            is_right &= ~is_unsized | (size <= transport.longest + transport.overhead)
        if parts.last is not None and count > 1:
            says_last = parts.last.take(frames)[:, 1:]
            is_right &= says_last[:, -1]
            if says_last[:, :-1].any():
                is_right &= ~says_last[:, :-1].any(axis=1)
        if not is_right.all():
            frames, last, size, runs = frames[is_right], last[is_right], size[is_right], runs[is_right]
        if len(runs):
            self.good[runs] = True
            self.packets.append(AlikePackets(frames, last, size))

    def _judge_under_way(self, firsts: Array, some: Array) -> None:
        """Of runs at the ends of their sessions, those that are packets without fault so far."""
        transport, parts = self.transport, self.parts
        runs = firsts[some]
        starts, sizes = self.starts[runs], self.sizes[runs]
        frames = self.order[_ranges(starts, sizes)]
        begin = np.cumsum(sizes) - sizes
        place = np.arange(len(frames)) - np.repeat(begin, sizes)
        due = (place + (transport.first_number - 1)) % transport.modulo
        is_right = parts.number[frames] == due
        room = self._room[some]
        if parts.piece is not None:
            is_right &= parts.piece[frames] == np.repeat(room, sizes)
        if parts.last is not None:
            is_right &= ~parts.last[frames]
        is_right[1:] &= ~self._late(frames)
        is_right[begin] = True
        good = np.logical_and.reduceat(is_right, begin)
        if transport.any_order:
            good &= sizes <= transport.modulo
        so_far = self._first[some] + (sizes - 1) * room
        good &= (self._size[some] != UNSIZED) | (so_far <= transport.longest + transport.overhead)
        self.under_way[runs] = good

    def _is_soon(self, first: Array, last: Array) -> bool:
        """Whether packets are so short, from the first to the last frame, that no frame can be late."""
        time = self.table.time
        most = int((time.take(last) - time.take(first)).max())
        return self._is_in_time_order and most <= self.transport.timeout_s * 1e9 - 1000

    @cached_property
    def _is_in_time_order(self) -> bool:
        """Whether all frames have an instant, none an earlier one than the frame before it."""
        time = self.table.time
        return bool((time[1:] >= time[:-1]).all()) and int(time[0]) != NO_TIME

    def _late(self, frames: Array) -> Array:
        """Where more than the time-out goes by between two frames (…, n), as the live reassembler computes it (…, n - 1)."""
        time = self.table.time[frames]
        known = time != NO_TIME
        seconds = time / 1_000_000_000
        late = np.greater(seconds[..., 1:] - seconds[..., :-1], self.transport.timeout_s)
        late &= known[..., 1:] & known[..., :-1]
        found: Array = late
        return found

    def _in_places(self, frames: Array) -> tuple[Array, Array]:
        """Frames of packets (m, count) in the places that they say they have; in which all are there, each once."""
        transport, parts = self.transport, self.parts
        count = frames.shape[1]
        number = parts.number[frames[:, 1:]].astype(np.int64)
        place = (number - transport.first_number) % transport.modulo + 1
        order = np.argsort(place, axis=1, kind="stable")
        is_all = (np.take_along_axis(place, order, axis=1) == np.arange(1, count)).all(axis=1)
        return np.concatenate(
            [frames[:, :1], np.take_along_axis(frames[:, 1:], order, axis=1)], axis=1
        ), is_all


def _alike(which: Array, shape: Array) -> list[Array]:
    """Runs of one shape each; their order stays."""
    if (shape == shape[0]).all():
        return [which]
    order = np.argsort(shape, kind="stable")
    return np.split(which[order], np.flatnonzero(np.diff(shape[order])) + 1)


def _ranges(starts: Array, sizes: Array) -> Array:
    """`sizes` numbers from each start on, one range behind the other."""
    before = np.cumsum(sizes) - sizes
    found: Array = np.arange(int(sizes.sum())) + np.repeat(starts - before, sizes)
    return found


def sorted_places(places: Array, count: int) -> Array:
    """The order of places in a table of `count` frames: of a small one by their 16 bits, which is much quicker."""
    return np.argsort(places.astype(np.uint16) if count <= 1 << 16 else places, kind="stable")
