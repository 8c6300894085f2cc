"""What each frame of a table is to its transport: `Transport.part`, carried out on columns.

1. The answer is `Transport.part`'s, frame for frame. Transports that are a table of frame kinds have it, and those with a
   reader of their own (`sessions`).
2. What the telling byte says is looked up; whole columns are made of nothing that only a packet's first frame has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ...frame_table import FrameTable
from ..declare.transport import FrameKind, FrameNumber, Transport
from .grouped import GroupedFrames, bare_keys
from .key_numbers import KeyNumbers, few_keys
from .table import Array

#: What a frame is: nothing of a packet, a whole one, a first frame, one that follows.
NO_PART, SINGLE, FIRST, NEXT = range(4)
_ROLES = {"single": SINGLE, "first": FIRST, "next": NEXT, "control": NO_PART}
#: The number of a frame's kind, where more must be looked at than the telling byte.
_OPEN = 255
#: The size of packets of which only the last frame says that it is the last.
UNSIZED = -1


@dataclass
class FrameParts:
    """Frames of a transport that are parts of packets, n of them, session behind session.

    `heads` are the m first and single frames (places in `frames`, rising). Of each: `role`; `kind`, a number of `around`;
    `size`, how many bytes the packet has, its address among them, or `UNSIZED`; `keys`, the packet's. `around` are (bytes in
    front of the packet's, bytes behind them) of such a frame; the packet's first `address` bytes stand in front of all.
    `following` is the same of frames that follow: all others.

    `broadcast` is the number of the kind that begins a broadcast (−1: none does).

    `number` (n): of a following frame. `last` (n): whether it says that it is the last (None: none says so). `piece` (n):
    how many bytes of the packet it has (None: as many as there is room). `reasons` are of frames that are not a part of a
    packet, by their places in the table. `tied`: frames whose sessions end one another, which only the rule decides, as
    places in the table, a party each; `tied_sessions` is how many sessions these are.
    """

    frames: GroupedFrames
    heads: Array
    role: Array
    kind: Array
    size: Array
    keys: Array
    number: Array
    around: list[tuple[int, int]]
    following: tuple[int, int]
    last: Array | None = None
    piece: Array | None = None
    reasons: list[tuple[Array, str]] = field(default_factory=list)
    tied: list[Array] = field(default_factory=list)
    tied_sessions: int = 0
    broadcast: int = -1

    def lose(self, lost: Sequence[tuple[Array, str]], party: Array | None = None) -> None:
        """Take frames away that are not parts of packets after all (places in `frames`, no place twice), and of the others
        those that are tied: `party` (n) is the number of their party, −1 of all that are free."""
        lost = [run for run in lost if len(run[0])]
        if not lost and party is None:
            return
        order = self.frames.order
        kept = np.ones(len(order), bool)
        for places, reason in lost:
            kept[places] = False
            self.reasons.append((order[places], reason))
        if party is not None:
            is_tied = kept & (party >= 0)
            kept &= ~is_tied
            self.tied = [
                np.sort(order[is_tied & (party == session)]) for session in np.unique(party[is_tied])
            ]
            self.tied_sessions = len(np.unique(self.frames.session[is_tied]))
        places = np.flatnonzero(kept)
        which = np.flatnonzero(kept.take(self.heads))
        self.frames = self.frames.take(places)
        self.heads = np.searchsorted(places, self.heads[which])
        self.role, self.kind, self.size, self.keys = (
            column[which] for column in (self.role, self.kind, self.size, self.keys)
        )
        self.number = self.number[places]
        self.last = None if self.last is None else self.last[places]
        self.piece = None if self.piece is None else self.piece[places]


class PartReader(Protocol):
    """Reads the parts of frames, table after table."""

    def sessions(self, table: FrameTable) -> Array:
        """Return a number for the session of each frame, as narrow as may be."""
        ...

    def read(self, frames: GroupedFrames) -> FrameParts | None:
        """Return what each frame is; None where some are of acknowledged packets, which only the rule knows."""
        ...


def can_table(transport: Transport) -> bool:
    """Return whether frames of a transport can be told apart in columns by the table of their kinds."""
    kind = type(transport)
    parts = [form for form in transport.kinds if form.role in ("single", "first", "next")]
    # First frames say the size, or last ones that they are the last.
    sized = {part.size is not None for part in parts if part.role == "first"}
    return (
        all(getattr(kind, name) is getattr(Transport, name) for name in ("part", "room", "lengths"))
        and all(form.role in _ROLES for form in transport.kinds)
        and sum(part.role == "next" for part in parts) == 1
        and sized == {part.last is None for part in parts if part.role == "next"}
        and all(part.last is None for part in parts if part.role != "next")
        and len({part.sequence for part in parts}) == 1
        and all(n is None or n.width <= 8 for part in parts for n in (part.sequence, part.number, part.last))
        and all(_reach(n) <= _needs(part) for part in parts for n in (part.sequence, part.last))
        and transport.modulo <= 256
        and transport.address <= 1
        and len(transport.kinds) < _OPEN
    )


def _reach(bits: FrameNumber | None) -> int:
    """Return how many bytes a frame has in which a number is."""
    return 0 if bits is None else bits.byte + bits.size if bits.byte >= 0 else -bits.byte


def _needs(kind: FrameKind) -> int:
    """Return how many bytes a frame of a kind has at least, the address aside; a shorter one is malformed."""
    if kind.role == "control":
        return 0
    size = None if kind.role == "next" else kind.size
    return max(kind.head + kind.tail, _reach(kind.number), _reach(size))


class KindReader:
    """Reads frames of a transport that is a table of frame kinds."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self._keys = KeyNumbers()
        kinds = transport.kinds
        #: The number of the frames that are of no kind, and of those that follow.
        self._none, self._next = len(kinds), kinds.index(transport.following)
        self._role_of = np.array([*(_ROLES[kind.role] for kind in kinds), NO_PART], np.uint8)
        #: By the byte that tells: the number of the kind, or `_OPEN`.
        self._kinds = np.array([self._kind(value) for value in range(256)], np.uint8)
        self._needs = np.array([_needs(kind) for kind in kinds] + [0], np.uint8)
        self._most_needed = max(1, int(self._needs.max()))
        self._sequence = transport.following.sequence
        self._around = [(transport.address + kind.head, kind.tail) for kind in kinds]

    def _kind(self, value: int) -> int:
        """Return what a telling byte says: one kind, none, or that there are several."""
        candidates = self.transport.by_telling[value]
        if not candidates:
            return self._none
        kind, is_sure = candidates[0]
        return self.transport.kinds.index(kind) if is_sure and not kind.over else _OPEN

    def sessions(self, table: FrameTable) -> Array:
        """Return a number for the session of each frame."""
        keys = bare_keys(table)
        few = few_keys(keys)
        if few is not None:
            parts = [(few.numbers, len(few.keys))]
        else:
            parts = [(self._keys.places(keys), self._keys.room)]
        if (channels := len(table.channels.names)) > 1:
            parts.append((table.channel, channels))
        if self._sequence is not None:
            rows = _Rows.of(table.data, table.length, self.transport.address)
            parts.append((rows.number(self._sequence), 1 << self._sequence.width))
        if self.transport.address:
            parts.append((np.where(table.length > 0, table.data[:, 0], np.uint8(0)), 256))
        return joined_numbers(parts)

    def read(self, frames: GroupedFrames) -> FrameParts:
        """Return what each frame is."""
        transport, following = self.transport, self.transport.following
        rows = _Rows.of(frames.data, frames.length, transport.address)
        kinds = self._kinds.take(rows.cell(transport.telling))
        if rows.shortest < 1:
            kinds[rows.length < 1] = self._none
        heads = np.flatnonzero(kinds != self._next)
        kind = kinds[heads]
        open_ones = np.flatnonzero(kind == _OPEN)
        if len(open_ones):
            kind[open_ones] = self._distinguished(rows.at(heads[open_ones]))
            if (is_next := kind == self._next).any():
                kinds[heads[is_next]] = self._next
                heads, kind = heads[~is_next], kind[~is_next]
        lost: list[tuple[Array, str]] = []
        role, size = self._read_heads(rows, heads, kind, lost)
        if rows.shortest < int(self._needs[self._next]):
            is_short = (kinds == self._next) & (rows.length < self._needs[self._next])
            lost.append((np.flatnonzero(is_short), "malformed: length"))
        parts = FrameParts(
            frames,
            heads,
            role,
            kind,
            size,
            frames.keys_of(heads),
            rows.cell(0) if following.number is None else rows.number(following.number),
            self._around,
            self._around[self._next],
            None if following.last is None else rows.number(following.last) == 1,
            None if rows.is_even else rows.length - np.uint8(following.head + following.tail),
        )
        parts.lose(lost)
        return parts

    def _distinguished(self, rows: _Rows) -> Array:
        """Return the kinds of frames whose telling byte does not say all."""
        found = np.full(len(rows), self._none, np.uint8)
        telling = rows.cell(self.transport.telling)
        for value in numbers_in(telling):
            left = telling == value
            for kind, is_sure in self.transport.by_telling[value]:
                mine = left & (rows.length > kind.over) if kind.over else left
                for bits, wanted in () if is_sure else kind.match:
                    mine = mine & (rows.number(bits) == wanted) & (rows.length >= _reach(bits))
                found[mine] = self.transport.kinds.index(kind)
                left = left & ~mine
        return found

    def _read_heads(
        self, rows: _Rows, heads: Array, kinds: Array, lost: list[tuple[Array, str]]
    ) -> tuple[Array, Array]:
        """Return the roles and sizes of frames that do not follow, which are of these kinds; `lost` are those that are
        no part.
        """
        transport = self.transport
        role, size = self._role_of.take(kinds), np.zeros(len(heads), np.int32)
        for number in numbers_in(kinds):
            which: Any = np.flatnonzero(kinds == number)
            if len(which) == len(heads):
                which = slice(None)
            places = heads[which]
            if number == self._none:
                lost.append((places, f"malformed: no frame of {transport.title}"))
                continue
            form = transport.kinds[number]
            if form.role == "control":
                lost.append((places, f"control: {form.name}"))
                continue
            some = rows.at(places)
            if rows.shortest < self._most_needed:
                is_short = some.length < self._needs[number]
                lost.append((places[is_short], "malformed: length"))
            else:
                is_short = np.False_
            piece = some.length.astype(np.int32) - np.int32(form.head + form.tail)
            if form.size is None:
                size[which] = piece + transport.address if form.role == "single" else UNSIZED
                continue
            given = some.number(form.size)
            good = (given >= form.least) & (given <= form.most)
            if form.role == "single":
                good &= given <= piece
                most = transport.frame_size
            else:
                most = transport.max_size
            if not good.all():
                lost.append((places[~(good | is_short)], "malformed: length"))
            if (is_long := given > most).any():
                lost.append((places[is_long & good & ~is_short], "malformed: too long"))
                given = np.minimum(given, most)
            size[which] = given
            if transport.address:
                size[which] += transport.address
        return role, size


def numbers_in(column: Array) -> list[int]:
    """Return the small numbers that there are in a column, rising."""
    if len(column) and (column == column[0]).all():
        return [int(column[0])]
    found: list[int] = np.flatnonzero(np.bincount(column)).tolist()
    return found


def joined_numbers(parts: Sequence[tuple[Array, int]]) -> Array:
    """Return one number for several, each below its count; as narrow as may be, for narrow numbers are sorted
    quicker.
    """
    most = math.prod(count for _, count in parts) - 1
    kind = np.dtype(np.uint8 if most < 1 << 8 else np.uint16 if most < 1 << 16 else np.int64)
    joined = parts[0][0].astype(kind, copy=False)
    for part, count in parts[1:]:
        if count <= most:
            joined = joined * kind.type(count)
        joined = joined + part.astype(kind, copy=False)
    return joined


class _Rows:
    """Bytes of frames, or of some of them: `length` of each behind the address (at least 0)."""

    def __init__(self, data: Array, length: Array, address: int, places: Array | None = None) -> None:
        self._data, self._address, self._places = data, address, places
        self.length = length
        self._cells: dict[int, Array] = {}

    @classmethod
    def of(cls, data: Array, length: Array, address: int) -> _Rows:
        """Return those of frames of these lengths."""
        return cls(data, np.maximum(length, address) - np.uint8(address) if address else length, address)

    def __len__(self) -> int:
        return len(self.length)

    @cached_property
    def shortest(self) -> int:
        return int(self.length.min()) if len(self.length) else 0

    @cached_property
    def is_even(self) -> bool:
        """True if all frames have one length."""
        return self.shortest == (int(self.length.max()) if len(self.length) else 0)

    def at(self, places: Array) -> _Rows:
        """Return some of the rows."""
        some = _Rows(self._data, self.length.take(places), self._address, places)
        some._cells = {byte: cell.take(places) for byte, cell in self._cells.items()}
        return some

    def cell(self, byte: int) -> Array:
        """Return a byte of each frame; one from the end (negative) where the frame is long enough."""
        found = self._cells.get(byte)
        if found is None:
            data, places = self._data, self._places
            if byte >= 0 or self.is_even:
                place = self._address + byte + (0 if byte >= 0 else self.shortest)
                if not 0 <= place < data.shape[1]:
                    found = np.zeros(len(self), np.uint8)
                else:
                    found = (
                        np.ascontiguousarray(data[:, place])
                        if places is None
                        else data.ravel().take(places * data.shape[1] + place)
                    )
            else:
                end = np.maximum(self.length.astype(np.int64) + (self._address + byte), 0)
                found = data[np.arange(len(data)) if places is None else places, end]
            self._cells[byte] = found
        return found

    def number(self, bits: FrameNumber) -> Array:
        """Return a number of each frame; of those that are too short for it, any."""
        number: Array = self.cell(bits.byte)
        if bits.size > 1:
            steps = range(bits.size) if bits.order == "big" else reversed(range(bits.size))
            number = np.zeros(len(self), np.int32 if bits.size < 4 else np.int64)
            for step in steps:
                number = number << 8 | self.cell(bits.byte + step)
        if bits.mask != (1 << 8 * bits.size) - 1:
            number = number & number.dtype.type(bits.mask)
        return number >> number.dtype.type(bits.shift) if bits.shift else number
