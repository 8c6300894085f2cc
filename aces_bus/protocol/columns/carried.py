"""What each frame of a table is to its transport: `Transport.part`, carried out on columns.

1. The answer is `Transport.part`'s, frame for frame. Only transports that are a table of frame kinds have it (`can_table`).
2. Whole columns of bytes are cheaper than some places of them: kinds are masks over all frames, sizes are read where they
   are.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from ...frame_table import FD as FD_FLAG
from ...frame_table import FrameTable
from ..declare.transport import FrameKind, FrameNumber, Transport
from ..keys import FD
from .table import Array

#: What a frame is: nothing of a packet, a whole one, a first frame, one that follows.
NO_PART, SINGLE, FIRST, NEXT = range(4)
_ROLES = {"single": SINGLE, "first": FIRST, "next": NEXT}


def can_table(transport: Transport) -> bool:
    """Whether frames of a transport can be told apart in columns."""
    kind = type(transport)
    parts = [one for one in transport.kinds if one.role in _ROLES]
    # First frames say the size, or last ones that they are the last.
    sized = {one.size is not None for one in parts if one.role == "first"}
    return (
        all(getattr(kind, name) is getattr(Transport, name) for name in ("part", "room", "lengths"))
        and all(one.role in (*_ROLES, "control") for one in transport.kinds)
        and sum(one.role == "next" for one in parts) == 1
        and sized == {one.last is None for one in parts if one.role == "next"}
        and all(one.last is None for one in parts if one.role != "next")
        and len({one.sequence is None for one in parts}) == 1
        and all(n is None or n.width <= 8 for one in parts for n in (one.sequence, one.number, one.last))
        and transport.modulo <= 256
        and transport.address <= 1
    )


class FrameParts:
    """Frames of a transport as columns of n, uint8: `role`; `piece`, how many bytes of a packet it has, the address aside;
    `number`, `last`, `sequence`; `kind`, the number of its kind.

    `reasons` are of frames that are no part of a packet: by their places.
    """

    def __init__(self, transport: Transport, table: FrameTable) -> None:
        n = len(table)
        self.transport, self.table = transport, table
        self._cells: dict[int, Array] = {}
        #: The lengths behind the address (at least 0), and the shortest.
        self._length = table.length.astype(np.uint8)
        if transport.address:
            self._length = np.maximum(self._length, transport.address) - np.uint8(transport.address)
        self._shortest = int(self._length.min()) if n else 0
        self.role = np.zeros(n, np.uint8)
        self.piece = np.zeros(n, np.uint8)
        self.number = np.zeros(n, np.uint8)
        self.last = np.zeros(n, bool)
        self.sequence = np.zeros(n, np.uint8)
        self.kind = np.full(n, len(transport.kinds), np.uint8)
        #: The sizes of packets, the address aside, of first and single frames; made when the first one comes.
        self.size: Array = np.zeros(n, np.int32)
        self.reasons: list[tuple[Array, str]] = []
        left = np.ones(n, bool)
        for number, kind in enumerate(transport.kinds):
            mine = self._fits(kind, left)
            if mine.any():
                self._read(number, kind, mine)
                left &= ~mine
                if not left.any():
                    return
        self.reasons.append((np.flatnonzero(left), f"malformed: no frame of {transport.title}"))

    def _fits(self, kind: FrameKind, left: Array) -> Array:
        """Which of the frames that are left are of a kind."""
        fits = left.copy() if self._shortest > kind.over else left & (self._length > kind.over)
        for bits, value in sorted(kind.match, key=lambda one: one[0].size):
            if bits.size == 1:
                numbers, there = self._number(bits)
                fits &= numbers == value
                if there is not None:
                    fits &= there
            elif fits.any():
                places = np.flatnonzero(fits)
                numbers, there = self._wide(bits, places)
                fits[places] = (numbers == value) & there
        return fits

    def _cell(self, byte: int) -> Array:
        """A byte of each frame; one from the end (negative) where the frame is long enough."""
        found = self._cells.get(byte)
        if found is None:
            data, address = self.table.data, self.transport.address
            if byte >= 0:
                place = address + byte
                found = (
                    np.ascontiguousarray(data[:, place])
                    if place < data.shape[1]
                    else np.zeros(len(data), np.uint8)
                )
            else:
                end = self._length.astype(np.int64) + (address + byte)
                found = data[np.arange(len(data)), np.maximum(end, 0)]
            self._cells[byte] = found
        return found

    def _number(self, bits: FrameNumber) -> tuple[Array, Array | None]:
        """A number of one byte of all frames, and where they are long enough for it (None: everywhere)."""
        reach = bits.byte + 1 if bits.byte >= 0 else -bits.byte
        there = None if self._shortest >= reach else self._length >= reach
        cell = self._cell(bits.byte)
        if bits.mask != 0xFF:
            cell = cell & np.uint8(bits.mask)
        return (cell >> np.uint8(bits.shift) if bits.shift else cell), there

    def _wide(self, bits: FrameNumber, places: Array) -> tuple[Array, Array]:
        """A number of any width of some frames, and where they are long enough for it."""
        length = self._length[places].astype(np.int64)
        start = length + bits.byte if bits.byte < 0 else np.full(len(places), bits.byte)
        there = (start >= 0) & (start + bits.size <= length)
        start = np.where(there, start, 0) + self.transport.address
        number = np.zeros(len(places), np.int64)
        last = self.table.data.shape[1] - 1
        for k in range(bits.size) if bits.order == "big" else reversed(range(bits.size)):
            number = number << 8 | self.table.data[places, np.minimum(start + k, last)]
        return (number & bits.mask) >> bits.shift, there

    def _read(self, number: int, kind: FrameKind, mine: Array) -> None:
        """What frames of a kind have in them."""
        if kind.role == "control":
            self.reasons.append((np.flatnonzero(mine), f"control: {kind.name}"))
            return
        around = kind.head + kind.tail
        good = mine if self._shortest >= around else mine & (self._length >= around)
        piece = self._length - np.uint8(around)
        for bits, column in (
            (kind.number, self.number),
            (kind.sequence, self.sequence),
            (kind.last, self.last),
        ):
            if bits is not None:
                numbers, there = self._number(bits)
                if there is not None and bits is kind.number:
                    good = good & there
                np.copyto(column, numbers if bits is not kind.last else numbers == 1, where=mine)
        np.copyto(self.kind, np.uint8(number), where=mine)
        np.copyto(self.piece, piece, where=good)
        if kind.role != "next":
            good = self._sized(kind, mine, good)
        if good is not mine and (bad := mine & ~good).any():
            known = np.zeros(len(mine), bool)
            for places, _ in self.reasons:
                known[places] = True
            self.reasons.append((np.flatnonzero(bad & ~known), "malformed: length"))
        np.copyto(self.role, np.uint8(_ROLES[kind.role]), where=good)

    def _sized(self, kind: FrameKind, mine: Array, good: Array) -> Array:
        """The sizes of first or single frames; which of them may have theirs."""
        places = np.flatnonzero(good)
        if kind.size is None:
            self.size[places] = self.piece[places]
            return good
        size, there = self._wide(kind.size, places)
        fits = there & (size >= kind.least) & (size <= kind.most)
        if kind.role == "single":
            fits &= size <= self.piece[places]
        else:
            is_long = fits & (size > self.transport.max_size)
            if is_long.any():
                self.reasons.append((places[is_long], "malformed: too long"))
                fits &= ~is_long
        self.size[places] = np.minimum(size, (1 << 31) - 1)
        if fits.all():
            return good
        good = good.copy()
        good[places[~fits]] = False
        return good

    @cached_property
    def is_even(self) -> bool:
        """Whether all frames have one length: then all are as full as the first one of their packet."""
        length = self.table.length
        return bool((length == length[0]).all()) if len(length) else True

    @cached_property
    def is_in_time_order(self) -> bool:
        """Whether no frame has an earlier instant than the one before it."""
        time = self.table.time
        return bool((time[1:] >= time[:-1]).all())

    @cached_property
    def is_sized(self) -> bool:
        """Whether first frames say how long their packets are; else last frames say that they are the last."""
        return any(kind.role == "first" and kind.size is not None for kind in self.transport.kinds)

    def sessions(self, keys: Array, count: int) -> Array:
        """A number for the session of each frame; `keys` are numbers of their keys, below `count`."""
        table, transport = self.table, self.transport
        session: Array = keys.astype(np.uint16, copy=False) if count <= 1 << 16 else keys
        parts: list[tuple[Array, int]] = []
        channels = len(table.channels.names)
        if channels > 1:
            parts.append((table.channel, channels))
        widest = max((k.sequence.width for k in transport.kinds if k.sequence is not None), default=0)
        if widest:
            parts.append((self.sequence, 1 << widest))
        if transport.address:
            parts.append((np.where(table.length > 0, table.data[:, 0], np.uint8(0)), 256))
        for part, size in parts:
            count *= size
            kind = np.dtype(np.uint16 if count <= 1 << 16 else np.int64)
            session = session.astype(kind, copy=False) * kind.type(size) + part.astype(kind, copy=False)
        return session

    def by_kind(self, places: Array) -> Iterator[tuple[FrameKind, Array | None]]:
        """The kinds of some frames, with which of them are of each (None: all)."""
        kinds = self.kind[places]
        if len(kinds) and (kinds == kinds[0]).all():
            yield self.transport.kinds[int(kinds[0])], None
            return
        for number in np.flatnonzero(np.bincount(kinds)).tolist():
            yield self.transport.kinds[number], np.flatnonzero(kinds == number)


def bare_keys(table: FrameTable) -> Array:
    """The keys of frames without the flag of CAN FD."""
    if not len(table.flags) or not int(np.bitwise_or.reduce(table.flags)) & FD_FLAG:
        return table.key
    keys: Array = table.key & np.uint32(~FD & 0xFFFF_FFFF)
    return keys
