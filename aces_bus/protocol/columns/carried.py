"""What each frame of a table is to its transport: `Transport.part`, carried out on columns.

1. The answer is `Transport.part`'s, frame for frame. Transports that are a table of frame kinds have it, and those with a
   reader of their own (`sessions`).
2. What the telling byte says is looked up; whole columns are made of nothing that only a packet's first frame has.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from ...frame_table import FD as FD_FLAG
from ...frame_table import FrameTable
from ..declare.transport import FrameKind, FrameNumber, Transport
from ..keys import FD
from .key_numbers import KeyNumbers
from .table import Array

#: What a frame is: nothing of a packet, a whole one, a first frame, one that follows; not known yet.
NO_PART, SINGLE, FIRST, NEXT, OPEN = range(5)
_ROLES = {"single": SINGLE, "first": FIRST, "next": NEXT, "control": NO_PART}
#: A code is the number of a frame's kind, and its role in the lowest bits.
_ROLE_BITS = 3
#: More kinds than this have no code.
_MOST_KINDS = 30
#: Keys below this are numbers of sessions as they are: those of 11 bits.
_FEW = 0x800
#: The size of packets of which only the last frame says that it is the last.
UNSIZED = -1


@dataclass
class FrameParts:
    """Frames of a transport as columns of n: `role`; `session`, a number below `sessions`; `number` of a following frame.

    Of first and single frames: `kind`, a number of `heads`; `size`, how many bytes the packet has, its address among them,
    or `UNSIZED`; `keys`, the packet's. `heads` are (bytes in front of the packet's, bytes behind them) of such a frame;
    the packet's first `address` bytes stand in front of all. `following` is the same of frames that follow.

    `last`: whether a following frame says that it is the last (None: none says so). `piece`: how many bytes of the packet a
    following frame has (None: as many as there is room). `reasons` are of frames that are no part of a packet, by their
    places. `tied`: frames whose sessions end one another, which only the rule decides, by the number of their party (−1:
    all others).
    """

    role: Array
    session: Array
    sessions: int
    number: Array
    kind: Array
    size: Array
    keys: Array
    heads: list[tuple[int, int]]
    following: tuple[int, int]
    last: Array | None = None
    piece: Array | None = None
    reasons: list[tuple[Array, str]] = field(default_factory=list)
    tied: Array | None = None

    def by_kind(self, places: Array) -> Iterator[tuple[tuple[int, int], Array | None]]:
        """The `heads` of some frames, with which of them each is of (None: all)."""
        kinds = self.kind[places]
        if len(kinds) and (kinds == kinds[0]).all():
            yield self.heads[int(kinds[0])], None
            return
        for number in np.flatnonzero(np.bincount(kinds)).tolist():
            yield self.heads[number], np.flatnonzero(kinds == number)


class PartReader(Protocol):
    """Reads the parts of frames, table after table."""

    def read(self, table: FrameTable) -> FrameParts | None:
        """What each frame of a table is; None where frames are of acknowledged packets, which only the rule knows."""
        ...


def can_table(transport: Transport) -> bool:
    """Whether frames of a transport can be told apart in columns by the table of their kinds."""
    kind = type(transport)
    parts = [one for one in transport.kinds if one.role in ("single", "first", "next")]
    # First frames say the size, or last ones that they are the last.
    sized = {one.size is not None for one in parts if one.role == "first"}
    return (
        all(getattr(kind, name) is getattr(Transport, name) for name in ("part", "room", "lengths"))
        and all(one.role in _ROLES for one in transport.kinds)
        and sum(one.role == "next" for one in parts) == 1
        and sized == {one.last is None for one in parts if one.role == "next"}
        and all(one.last is None for one in parts if one.role != "next")
        and len({one.sequence for one in parts}) == 1
        and all(n is None or n.width <= 8 for one in parts for n in (one.sequence, one.number, one.last))
        and all(_reach(n) <= _needs(one) for one in parts for n in (one.sequence, one.last))
        and transport.modulo <= 256
        and transport.address <= 1
        and len(transport.kinds) <= _MOST_KINDS
    )


def _reach(bits: FrameNumber | None) -> int:
    """How many bytes a frame has in which a number is."""
    return 0 if bits is None else bits.byte + bits.size if bits.byte >= 0 else -bits.byte


def _needs(kind: FrameKind) -> int:
    """How many bytes a frame of a kind has at least, the address aside; a shorter one is malformed."""
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
        self._none = len(kinds)
        self._role_of = [_ROLES[kind.role] for kind in kinds] + [NO_PART]
        self._code_of = np.array([n << _ROLE_BITS | role for n, role in enumerate(self._role_of)], np.uint8)
        #: By the byte that tells: the code, or `OPEN` where more must be looked at.
        self._codes = np.array([self._code(value) for value in range(256)], np.uint8)
        self._needs = np.array([_needs(kind) for kind in kinds] + [0], np.int64)
        self._most_needed = max(1, int(self._needs.max()))
        self._sequence = transport.following.sequence
        self._heads = [(transport.address + kind.head, kind.tail) for kind in kinds]

    def _code(self, value: int) -> int:
        """What a telling byte says: one kind, none, or that there are several."""
        candidates = self.transport.by_telling[value]
        if not candidates:
            return int(self._code_of[self._none])
        kind, is_sure = candidates[0]
        if is_sure and not kind.over:
            return int(self._code_of[self.transport.kinds.index(kind)])
        return OPEN

    def read(self, table: FrameTable) -> FrameParts:
        """What each frame of a table is."""
        transport, following = self.transport, self.transport.following
        rows = _Rows.of(table, transport.address)
        code = self._codes.take(rows.cell(transport.telling))
        open_ones = np.flatnonzero(code == OPEN)
        if len(open_ones):
            code[open_ones] = self._told_apart(rows.at(open_ones))
        if rows.shortest < 1:
            code[rows.length < 1] = self._code_of[self._none]
        role = code & np.uint8((1 << _ROLE_BITS) - 1)
        reasons: list[tuple[Array, str]] = []
        if rows.shortest < self._most_needed:
            short = np.flatnonzero(rows.length < self._most_needed)
            needs = self._needs.take(code[short] >> _ROLE_BITS)
            _lose(role, short[rows.length[short] < needs], "malformed: length", reasons)
        n = len(table)
        kind, size = np.zeros(n, np.uint8), np.zeros(n, np.int32)
        self._read_heads(rows, code, role, kind, size, reasons)
        if int(role.min()) == NO_PART:
            self._name_others(code, reasons)
        cells = np.zeros(n, np.uint8) if following.number is None else rows.number(following.number)
        keys = bare_keys(table)
        session, sessions = self._sessions(table, rows, keys)
        return FrameParts(
            role,
            session,
            sessions,
            cells,
            kind,
            size,
            keys,
            self._heads,
            (transport.address + following.head, following.tail),
            None if following.last is None else rows.number(following.last) == 1,
            None if rows.is_even else rows.length - np.uint8(following.head + following.tail),
            reasons,
        )

    def _told_apart(self, rows: _Rows) -> Array:
        """The codes of frames whose telling byte does not say all."""
        codes = np.full(len(rows), self._code_of[self._none])
        telling = rows.cell(self.transport.telling)
        for value in np.flatnonzero(np.bincount(telling)).tolist():
            left = telling == value
            for kind, is_sure in self.transport.by_telling[value]:
                mine = left & (rows.length > kind.over) if kind.over else left
                for bits, wanted in () if is_sure else kind.match:
                    mine = mine & (rows.number(bits) == wanted) & (rows.length >= _reach(bits))
                codes[mine] = self._code_of[self.transport.kinds.index(kind)]
                left = left & ~mine
        return codes

    def _read_heads(
        self,
        rows: _Rows,
        code: Array,
        role: Array,
        kind: Array,
        size: Array,
        reasons: list[tuple[Array, str]],
    ) -> None:
        """Kinds and sizes of first and single frames; one whose size cannot be is no part any more."""
        transport = self.transport
        places = np.flatnonzero((role == FIRST) | (role == SINGLE))
        numbers = code[places] >> _ROLE_BITS
        kind[places] = numbers
        for number in np.flatnonzero(np.bincount(numbers)).tolist():
            one = transport.kinds[number]
            mine = places if (numbers == number).all() else places[numbers == number]
            some = rows.at(mine)
            piece = some.length.astype(np.int64) - (one.head + one.tail)
            if one.size is None:
                size[mine] = piece + transport.address if one.role == "single" else UNSIZED
                continue
            given = some.number(one.size).astype(np.int64)
            good = (given >= one.least) & (given <= one.most)
            if one.role == "single":
                good &= given <= piece
                most = transport.frame_size
            else:
                most = transport.max_size
            _lose(role, mine[~good], "malformed: length", reasons)
            _lose(role, mine[good & (given > most)], "malformed: too long", reasons)
            size[mine] = np.minimum(given, most) + transport.address

    def _name_others(self, code: Array, reasons: list[tuple[Array, str]]) -> None:
        """The reasons of frames that steer, and of those that are none of the transport."""
        others = np.flatnonzero(code & np.uint8((1 << _ROLE_BITS) - 1) == NO_PART)
        numbers = code[others] >> _ROLE_BITS
        for number in np.flatnonzero(np.bincount(numbers)).tolist():
            is_known = number < self._none
            reasons.append(
                (
                    others[numbers == number],
                    f"control: {self.transport.kinds[number].name}"
                    if is_known
                    else f"malformed: no frame of {self.transport.title}",
                )
            )

    def _sessions(self, table: FrameTable, rows: _Rows, keys: Array) -> tuple[Array, int]:
        """A number for the session of each frame, and what all are below."""
        if len(keys) and int(keys.max()) < _FEW:
            parts = [(keys, _FEW)]
        else:
            parts = [(self._keys.of(keys), len(self._keys))]
        if len(table.channel) and (channels := len(table.channels.names)) > 1:
            parts.append((table.channel, channels))
        if self._sequence is not None:
            parts.append((rows.number(self._sequence), 1 << self._sequence.width))
        if self.transport.address:
            parts.append((np.where(table.length > 0, table.data[:, 0], np.uint8(0)), 256))
        return joined_numbers(parts)


def _lose(role: Array, places: Array, reason: str, reasons: list[tuple[Array, str]]) -> None:
    """Frames that are no part of a packet after all."""
    if len(places):
        role[places] = NO_PART
        reasons.append((places, reason))


def joined_numbers(parts: list[tuple[Array, int]]) -> tuple[Array, int]:
    """One number for several, each of which is below its count; as narrow as may be, for narrow ones are sorted quicker."""
    (first, count), *more = parts
    for _, size in more:
        count *= size
    kind = np.dtype(np.uint8 if count < 1 << 8 else np.uint16 if count < 1 << 16 else np.int64)
    joined = first.astype(kind)
    for part, size in more:
        joined = joined * kind.type(size) + part.astype(kind, copy=False)
    return joined, count


class _Rows:
    """Bytes of frames, or of some of them: `length` of each behind the address (at least 0)."""

    def __init__(self, data: Array, length: Array, address: int, places: Array | None = None) -> None:
        self._data, self._address, self._places = data, address, places
        self.length = length
        self._cells: dict[int, Array] = {}

    @classmethod
    def of(cls, table: FrameTable, address: int) -> _Rows:
        """Those of all frames of a table."""
        length: Array = table.length
        if address:
            length = np.maximum(length, address) - np.uint8(address)
        return cls(table.data, length, address)

    def __len__(self) -> int:
        return len(self.length)

    @cached_property
    def shortest(self) -> int:
        return int(self.length.min()) if len(self.length) else 0

    @cached_property
    def is_even(self) -> bool:
        """Whether all frames have one length."""
        return self.shortest == (int(self.length.max()) if len(self.length) else 0)

    def at(self, places: Array) -> _Rows:
        """Some of all rows."""
        some = _Rows(self._data, self.length.take(places), self._address, places)
        some._cells = {byte: cell.take(places) for byte, cell in self._cells.items()}
        return some

    def cell(self, byte: int) -> Array:
        """A byte of each frame; one from the end (negative) where the frame is long enough."""
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
        """A number of each frame; of those that are too short for it, any."""
        number: Array = self.cell(bits.byte)
        if bits.size > 1:
            steps = range(bits.size) if bits.order == "big" else reversed(range(bits.size))
            number = np.zeros(len(self), np.int64)
            for step in steps:
                number = number << 8 | self.cell(bits.byte + step)
        if bits.mask != (1 << 8 * bits.size) - 1:
            number = number & number.dtype.type(bits.mask)
        return number >> number.dtype.type(bits.shift) if bits.shift else number


def bare_keys(table: FrameTable) -> Array:
    """The keys of frames without the flag of CAN FD."""
    if not len(table.flags) or not int(np.bitwise_or.reduce(table.flags)) & FD_FLAG:
        return table.key
    keys: Array = table.key & np.uint32(~FD & 0xFFFF_FFFF)
    return keys
