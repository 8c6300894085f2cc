"""Which frames of a transport are whole packets: all sessions of a table at once.

1. A run is a first or single frame and what follows it in its session. It is a packet when it has as many frames as the
   first one promises, in their places, full and in time; it is under way when it is so far without fault and nothing
   of its session follows. Of all other runs this file says only that they are neither.
2. Frames whose sessions end one another (`FrameParts.tied`) are in no run.

Frames come in the order of their sessions, where those of a run are side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...frame_table import NO_TIME
from ..declare.transport import Transport
from .carried import FIRST, NEXT, SINGLE, UNSIZED, FrameParts, numbers_in
from .table import Array


@dataclass(frozen=True)
class AlikePackets:
    """m packets of `count` frames each, which stand side by side from `starts` on, in the order of their last frames.

    `head` is the number of their kind (`FrameParts.around`), `keys` are theirs, `size` says how many bytes each has, its
    address among them. `first` and `last` are the places in the table of the first and the last frame to come. `places`
    (m, count) says where the frames belong that are not in their places; None: all are.
    """

    starts: Array
    count: int
    head: int
    keys: Array
    size: Array
    first: Array
    last: Array
    places: Array | None = None

    def take(self, which: Array, head: int) -> AlikePackets:
        """Return some of the packets, which are of one kind."""
        starts, keys, size, first, last = (
            column[which] for column in (self.starts, self.keys, self.size, self.first, self.last)
        )
        places = None if self.places is None else self.places[which]
        return AlikePackets(starts, self.count, head, keys, size, first, last, places)


class Runs:
    """Frames in the order of their sessions, in runs. `good` are whole packets, `under_way` what may become one."""

    def __init__(self, transport: Transport, parts: FrameParts) -> None:
        self.transport, self.parts = transport, parts
        self.time, self.order = parts.frames.table.time, parts.frames.order
        n, session = len(self.order), parts.frames.session
        self._is_new = np.ones(n + 1, bool)
        np.not_equal(session[1:], session[:-1], out=self._is_new[1:n])
        #: Of each run: where it begins in `order`, what its first frame is, how many frames it has.
        self.starts, self.role, self._kind, self._size, self._keys = self._begun()
        self.sizes = np.empty_like(self.starts)
        np.subtract(self.starts[1:], self.starts[:-1], out=self.sizes[:-1])
        self.sizes[-1] = n - self.starts[-1]
        #: The whole packets, in each item in the order of their last frames.
        self.packets: list[AlikePackets] = []
        self.good = (self.role == SINGLE) & (self.sizes == 1)
        self.under_way = np.zeros(len(self.starts), bool)
        if self.good.any():
            alone = self.starts[self.good]
            self._put_together(np.flatnonzero(self.good), self._size[self.good], np.ones(len(alone), bool))
        firsts = np.flatnonzero(self.role == FIRST)
        if len(firsts):
            self._judge(firsts, slice(None) if len(firsts) == len(self.starts) else firsts)

    def _begun(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return where runs begin: with first and single frames, and where a session does. What is known of their
        first frames.
        """
        parts = self.parts
        known = parts.heads, parts.role, parts.kind, parts.size, parts.keys
        sessions = np.flatnonzero(self._is_new[:-1])
        at = np.searchsorted(parts.heads, sessions)
        is_headless = np.append(parts.heads, -1)[at] != sessions
        if not is_headless.any():
            return known
        at, headless = at[is_headless], sessions[is_headless]
        starts, role, kind, size, keys = (
            np.insert(column, at, more) for column, more in zip(known, (headless, NEXT, 0, 0, 0), strict=True)
        )
        return starts, role, kind, size, keys

    @cached_property
    def is_last(self) -> Array:
        """True for each run that is the last of its session."""
        found: Array = self._is_new[self.starts + self.sizes]
        return found

    def frames_of(self, which: Array) -> Array:
        """Return the places of all frames of some runs, one run behind the other."""
        sizes = self.sizes[which]
        found: Array = self.order[_ranges(self.starts[which], sizes)]
        return found

    def most_open(self) -> int:
        """Return how many packets are under way at once, or more than that."""
        others = self.parts.tied_sessions
        sessions = int(np.count_nonzero(self._is_new)) - 1
        senders = self.transport.senders
        if sessions + others <= senders:
            return sessions + others
        more = np.flatnonzero((self.role == FIRST) & ((self.sizes > 1) | ~self.good))
        if len(more) + others <= senders:
            return len(more) + others
        n = len(self.time)
        last = self.starts[more] + self.sizes[more]
        until = np.where(self.is_last[more], n, self.order[np.minimum(last, len(self.order) - 1)])
        if not self.transport.any_order:
            until = np.where(self.good[more], self.order[last - 1], until)
        begun = np.bincount(self.order[self.starts[more]], minlength=n + 1)
        return int(np.cumsum(begun - np.bincount(until, minlength=n + 1)).max()) + others

    # ------------------------------------------------------------------ what is without fault

    def _judge(self, firsts: Array, which: slice | Array) -> None:
        """Judge which runs that begin with a first frame are whole packets, and which are under way; `which`
        are these runs.
        """
        transport, parts = self.transport, self.parts
        begin, sizes, size = self.starts[which], self.sizes[which], self._size[which]
        length = _same(parts.frames.length.take(begin))
        around = np.array([before + behind for before, behind in parts.around], np.int32)
        # Bytes of the packet in the first frame, its address among them; room in those that follow.
        piece = length - around[_same(self._kind[which])] + np.int32(transport.address)
        room = length - np.int32(sum(parts.following))
        size = _same(size)
        is_unsized = size == UNSIZED
        count = (np.maximum(size - piece, 0) + (room - 1)) // np.maximum(room, 1) + 1
        is_full = (length == 8) if not transport.fd else np.isin(length, np.array(transport.lengths()))
        is_full = is_full & (room > 0)
        is_whole = np.where(is_unsized, sizes > 1, sizes == count) & (is_full | (sizes == 1) & (room > 0))
        is_due = self._are_due()[which]
        may_go_on = (is_unsized | (sizes < count)) & is_full & self.is_last[which] & is_due
        if not transport.any_order:
            is_whole &= is_due
        else:
            is_whole &= (sizes <= transport.modulo) & (is_due | ~self._is_broadcast[which])
            may_go_on &= sizes <= transport.modulo
        if parts.piece is not None or parts.last is not None:
            end, is_end, is_even = self._ends(which, begin, sizes, room)
            so_far = piece + (sizes - 2) * room + end
            fits = so_far <= transport.longest + transport.overhead
            is_whole &= is_even & is_end
            # Which frame is the last one by its number, its place does not say where frames are not in order.
            is_whole &= is_due | (end == room) if parts.last is None else is_due
            is_whole &= np.where(is_unsized, (end <= room) & fits, (sizes == 1) | (so_far >= size))
            may_go_on &= is_even & (end == room) & (fits | ~is_unsized)
            if parts.last is not None:
                may_go_on &= ~is_end | (sizes == 1)
            size = np.where(is_unsized, so_far, size)
        whole = self._in_time(firsts, np.flatnonzero(is_whole))
        if len(whole):
            runs, size, is_due = firsts[whole], np.broadcast_to(size, len(firsts))[whole], is_due[whole]
            for some in _alike(sizes[whole] * 128 + (length if length.ndim == 0 else length[whole])):
                self._put_together(runs[some], size[some], is_due[some])
        left = np.flatnonzero(may_go_on)
        if len(left):
            left = left[~self.good[firsts[left]]]
            self.under_way[firsts[self._in_time(firsts, left)]] = True

    @cached_property
    def _is_broadcast(self) -> Array:
        """Which runs begin with the announcement of a broadcast."""
        found: Array = self._kind == self.parts.broadcast
        return found

    def _are_due(self) -> Array:
        """Return whether the frames of each run have the numbers that are due, one behind the other."""
        transport = self.transport
        due = self.parts.number.copy()
        due[self.starts] = (transport.first_number - 1) % transport.modulo
        due += 1  # 256 is 0 by itself
        if transport.modulo & transport.modulo - 1:
            due %= transport.modulo
        else:
            due &= transport.modulo - 1
        return self._without(self.parts.number[1:] != due[:-1], self.starts[1:] - 1, begin=1)

    def _ends(
        self, which: slice | Array, begin: Array, sizes: Array, room: Array
    ) -> tuple[Array, Array, Array]:
        """Return, for runs that begin at `begin`: bytes of the packet in the last frame (`room` in a lone
        frame), whether that frame says it is the last, and whether the frames between are full and say
        that they are not the last.
        """
        parts, starts = self.parts, self.starts
        last = begin + (sizes - 1)
        ends = last if isinstance(which, slice) else starts + (self.sizes - 1)
        end, is_end, is_even = room, np.ones(len(begin), bool), np.ones(len(begin), bool)
        if parts.piece is not None:
            full = room
            if room.ndim:
                of_runs = np.zeros(len(starts), np.int32)
                of_runs[which] = room
                full = np.repeat(of_runs, self.sizes)
            end = np.where(sizes > 1, parts.piece.take(last), room)
            is_even &= self._without(parts.piece != full, starts, ends)[which]
        if parts.last is not None:
            is_end = parts.last.take(last) | (sizes == 1)
            is_even &= self._without(parts.last.copy(), starts, ends)[which]
        return end, is_end, is_even

    def _without(self, is_wrong: Array, *but: Array, begin: int = 0) -> Array:
        """Return whether none of each run's frames is wrong, of those that begin at `begin` of `order`; `but` are never."""
        for some in but:
            is_wrong[some] = False
        found = np.ones(len(self.starts), bool)
        if is_wrong.any():
            wrong = np.flatnonzero(is_wrong)
            found[np.searchsorted(self.starts, wrong + begin, "right") - 1] = False
        return found

    def _put_together(self, runs: Array, size: Array, is_due: Array) -> None:
        """Note whole runs of one shape as packets; look for the places of frames that are out of order."""
        count, places = int(self.sizes[runs[0]]), None
        last = self.order.take(self.starts.take(runs) + (count - 1))
        if (last[1:] < last[:-1]).any():
            by_last = sorted_places(last, len(self.time))
            runs, size, is_due, last = runs[by_last], size[by_last], is_due[by_last], last[by_last]
        starts = self.starts.take(runs)
        first = self.order.take(starts)
        if not is_due.all():
            places, is_right = self._places(starts, count)
            if not is_right.all():
                runs, starts, size, first, last, places = (
                    column[is_right] for column in (runs, starts, size, first, last, places)
                )
        if not len(runs):
            return
        self.good[runs] = True
        kinds = self._kind.take(runs)
        keys, size = self._keys.take(runs), size.astype(np.int64)
        packets = AlikePackets(starts, count, int(kinds[0]), keys, size, first, last, places)
        several = numbers_in(kinds)
        self.packets += (
            [packets]
            if len(several) == 1
            else [packets.take(np.flatnonzero(kinds == kind), kind) for kind in several]
        )

    def _in_time(self, firsts: Array, which: Array) -> Array:
        """Return those of some runs (numbers in `firsts`) of which no frame is late."""
        if not len(which):
            return which
        runs, time = firsts[which], self.time
        limit: Any = self.transport.timeout_s
        if self.parts.broadcast >= 0:
            limit = np.where(self._is_broadcast[runs], min(limit, self.transport.broadcast_gap_s), limit)
        starts, sizes = self.starts[runs], self.sizes[runs]
        first, last = self.order.take(starts), self.order.take(starts + (sizes - 1))
        slow = np.arange(len(runs))
        if self._is_in_time_order:
            slow = np.flatnonzero(time.take(last) - time.take(first) > limit * 1e9 - 1000)
        slow = slow[sizes[slow] > 1]
        if not len(slow):
            return which
        sizes = sizes[slow]
        limits = np.repeat(np.broadcast_to(limit, len(runs))[slow], sizes)[:-1]
        is_late = np.append(self._late(self.order[_ranges(starts[slow], sizes)], limits), False)
        is_late[np.cumsum(sizes) - 1] = False
        is_late = np.logical_or.reduceat(is_late, np.cumsum(sizes) - sizes)
        found: Array = np.delete(which, slow[is_late])
        return found

    @cached_property
    def _is_in_time_order(self) -> bool:
        """True if all frames have an instant, and none is earlier than the frame before."""
        time = self.time
        return bool((time[1:] >= time[:-1]).all()) and int(time[0]) != NO_TIME

    def _late(self, frames: Array, limits: Array) -> Array:
        """Return where more than `limits` (n - 1, in s) goes by between two of n frames, as the live reassembler says it."""
        time = self.time[frames]
        known = time != NO_TIME
        seconds = time / 1_000_000_000
        late = np.greater(seconds[1:] - seconds[:-1], limits)
        late &= known[1:] & known[:-1]
        found: Array = late
        return found

    def _places(self, starts: Array, count: int) -> tuple[Array, Array]:
        """Return by place in each packet where behind its start that frame is (m, count); in which packets all are there,
        each once."""
        transport = self.transport
        number = self.parts.number[starts[:, None] + np.arange(1, count)].astype(np.int64)
        place = (number - transport.first_number) % transport.modulo + 1
        found = np.argsort(place, axis=1, kind="stable") + 1
        is_all: Array = (np.take_along_axis(place, found - 1, axis=1) == np.arange(1, count)).all(axis=1)
        return np.insert(found, 0, 0, axis=1), is_all


def _same(column: Array) -> Array:
    """Return a column as int32; as one number where all are the same, with which to go on is quicker."""
    few = column[:1] if (column == column[0]).all() else column
    return few.astype(np.int32).reshape(-1 if len(few) == len(column) > 1 else ())


def _alike(shape: Array) -> Sequence[slice | Array]:
    """Return which have one shape each; their order stays."""
    if (shape == shape[0]).all():
        return [slice(None)]
    order = np.argsort(shape, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(shape[order])) + 1)


def _ranges(starts: Array, sizes: Array) -> Array:
    """Return `sizes` numbers from each start on, one range behind the other."""
    before = np.cumsum(sizes) - sizes
    found: Array = np.arange(int(sizes.sum())) + np.repeat(starts - before, sizes)
    return found


def sorted_places(places: Array, count: int) -> Array:
    """Return the order of places in a table of `count` frames: of a small one by their 16 bits, which is much quicker."""
    return np.argsort(places.astype(np.uint16) if count <= 1 << 16 else places, kind="stable")
