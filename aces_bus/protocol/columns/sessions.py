"""What each frame is to transports whose frames are told apart by their identifiers, too: J1939 and CANopen's service data.

1. The answer is that of `J1939Transport.part` and `SdoTransfer.part`, frame for frame.
2. Where an abort comes, or a block transfer, both ways of a conversation hang together: all its frames of the piece are
   `tied`, and only the rule decides them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...frame_table import FrameTable
from ..declare import j1939
from ..declare.sdo import SdoTransfer
from ..declare.transport import Transport
from .carried import (
    FIRST,
    NEXT,
    NO_PART,
    SINGLE,
    UNSIZED,
    FrameParts,
    KindReader,
    PartReader,
    can_table,
    joined_numbers,
)
from .grouped import GroupedFrames, bare_keys
from .key_numbers import KeyNumbers, few_keys
from .table import Array


def part_reader(transport: Transport) -> PartReader | None:
    """Return what reads the frames of a transport in columns; None where only the rule can."""
    if type(transport) is j1939.J1939Transport:
        return J1939Reader(transport)
    if type(transport) is SdoTransfer:
        return SdoReader(transport)
    return KindReader(transport) if can_table(transport) else None


class _Ways:
    """The sessions of conversations of two ends: each has one a way."""

    def __init__(self) -> None:
        self._known = KeyNumbers()

    def sessions(self, table: FrameTable, way: Array) -> tuple[Array, int]:
        """Return a number for the session of each frame, and what all are below; `way` says who sends to whom."""
        few = few_keys(way)
        number, count = (
            (few.numbers, len(few.keys)) if few is not None else (self._known.places(way), self._known.room)
        )
        channels = len(table.channels.names)
        joined = joined_numbers(
            [(number, count), (table.channel, channels)] if channels > 1 else [(number, count)]
        )
        return joined, count * max(1, channels)


def _tied(frames: GroupedFrames, way: Array, back: Callable[[Array], Array], ends: Array) -> Array | None:
    """Return by frame the number of its conversation where one of `ends` (places) is in it, else −1; None: there are none.
    `back` gives the other ways of conversations."""
    if not len(ends):
        return None
    known, which = np.unique(way, return_inverse=True)
    party = np.minimum(known, back(known)).astype(np.int64)[which] << 16 | frames.channel
    return np.where(np.isin(party, party[ends]), party, -1)


#: The number of the kind of frames that announce a broadcast.
_BROADCAST = 2


class J1939Reader:
    """Frames of J1939's transport protocol: what opens and steers sessions, their data, and whole parameter groups."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self._ways = _Ways()

    def sessions(self, table: FrameTable) -> Array:
        """Return a number for the session of each frame."""
        keys = bare_keys(table)
        session, count = self._ways.sessions(table, keys & np.uint32(0xFFFF))
        group = _group(keys)
        is_single = (group != j1939.DATA) & (group != j1939.CONNECTION)
        if not is_single.any():
            return session
        # Whole groups begin and end nothing: a session that all of them share.
        return joined_numbers([(np.where(is_single, np.int64(count), session), count + 1)])

    def read(self, frames: GroupedFrames) -> FrameParts:
        """Return what each frame is."""
        transport = self.transport
        keys, length, data = frames.keys, frames.length, frames.data
        group = _group(keys)
        is_data = group == j1939.DATA
        lost: list[tuple[Array, str]] = []
        if int(length.min()) < 2:
            lost.append((np.flatnonzero(is_data & (length < 2)), "malformed: length"))
        heads = np.flatnonzero(~is_data)
        role = np.full(len(heads), SINGLE, np.uint8)
        packet, size = keys[heads], length[heads].astype(np.int32)
        # What opens and steers sessions, as places among the heads.
        opening = np.flatnonzero(group[heads] == j1939.CONNECTION)
        places = heads[opening]
        head, key = data[places].astype(np.int64), packet[opening].astype(np.int64)
        command = head[:, 0]
        left = length[places] >= 8
        lost.append((places[~left], "malformed: length"))
        for control, name in j1939.STEERING.items():
            mine = left & (command == control)
            lost.append((places[mine], f"control: {name}"))
            left &= ~mine
        aborts = places[left & (command == j1939.ABORT)]
        left &= command != j1939.ABORT
        to_all = (key >> 8 & 0xFF) == j1939.EVERYBODY
        opens = (command == j1939.RTS) & ~to_all | (command == j1939.BAM) & to_all
        lost.append((places[left & ~opens], f"malformed: no frame of {transport.title}"))
        left &= opens
        total, count = head[:, 1] | head[:, 2] << 8, head[:, 3]
        fits = (total >= j1939.LEAST) & (total <= j1939.MOST) & (count == -(-total // j1939.PIECE))
        lost.append((places[left & ~fits], "malformed: length"))
        lost.append((places[left & fits & (total > transport.max_size)], "malformed: too long"))
        role[opening] = FIRST
        number = head[:, 5] | head[:, 6] << 8 | head[:, 7] << 16
        is_addressed = (number >> 8 & 0xFF) < j1939.BROADCAST
        number = np.where(is_addressed, number & ~0xFF | key >> 8 & 0xFF, number) & 0x3FFFF
        packet[opening] = (key & 0x9C00_0000 | number << 8 | key & 0xFF).astype(np.uint32)
        size[opening] = total
        kind = np.zeros(len(heads), np.uint8)
        kind[opening] = np.where(to_all, _BROADCAST, 1)
        parts = FrameParts(
            frames,
            heads,
            role,
            kind,
            size,
            packet,
            np.ascontiguousarray(data[:, 0]),
            [(0, 0), (8, 0), (8, 0)],
            (1, 0),
            None,
            None if (length == 8).all() else length - np.uint8(1),
            broadcast=_BROADCAST,
        )
        party = _tied(frames, keys & np.uint32(0xFFFF), _swapped, aborts)
        if party is not None:
            party[heads[role == SINGLE]] = -1
        parts.lose(lost, party)
        return parts


def _group(keys: Array) -> Array:
    """Return the parameter groups of keys, without the byte that may be an address."""
    return (keys >> np.uint32(16)).astype(np.uint16) & np.uint16(0x3FF)


def _swapped(addresses: Array) -> Array:
    """Return the same two addresses, the other way."""
    return (addresses >> np.uint32(8) | addresses << np.uint32(8)) & np.uint32(0xFFFF)


class SdoReader:
    """Frames of CANopen's service data: what each is, the first of its eight bytes says, in each way otherwise."""

    #: Bytes of a frame; where the size is in a first frame, behind what is the packet's; bits of a node in an identifier.
    _FRAME, _SIZE_AT, _NODE_BITS = 8, 4, 7

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self._ways = _Ways()
        self._kinds = KeyNumbers()
        #: By 256 times the number of a way, plus the first byte: role, number, piece and whether it is the last or has a
        #: size, as `part` says.
        self._said: list[tuple[int, int, int, bool, bool]] = []
        self._reasons: list[str] = []
        #: By the same: whether it ends a packet before its end; whether it is of an acknowledged packet.
        self._ends: list[bool] = []
        self._acknowledged: list[bool] = []

    def _learn(self, key: int) -> None:
        """Ask for every first byte that a frame of a way may have."""
        for byte in range(256):
            part = self.transport.part(key, bytes([byte, 0, 0, 0, 1, 0, 0, 0]))
            role = {"single": SINGLE, "first": FIRST, "next": NEXT}.get(part.role, NO_PART)
            self._ends.append(part.role == "abort")
            self._acknowledged.append(part.is_acknowledged)
            self._said.append((role, part.number, len(part.data), part.is_last, part.size is not None))
            self._reasons.append(part.reason)

    def sessions(self, table: FrameTable) -> Array:
        """Return a number for the session of each frame."""
        return self._ways.sessions(table, bare_keys(table))[0]

    def read(self, frames: GroupedFrames) -> FrameParts | None:
        """Return what each frame is; None where there are block transfers."""
        keys, data = frames.keys, frames.data
        kinds = self._kinds.of(keys >> np.uint32(self._NODE_BITS))
        for place in range(len(self._said) // 256, len(self._kinds)):
            self._learn(int(keys[np.argmax(kinds == place)]))
        which = kinds * 256 + data[:, 0]
        if np.array(self._acknowledged).take(which).any():
            return None
        said = np.array(self._said, np.uint8)
        role, number, piece, last, is_sized = (said[:, k].take(which) for k in range(5))
        is_end = np.array(self._ends).take(which)
        is_short = frames.length != self._FRAME
        lost = [(np.flatnonzero(is_short), "malformed: length")]
        other = np.flatnonzero((role == NO_PART) & ~is_end & ~is_short)
        for place in np.unique(which[other]).tolist():
            lost.append((other[which[other] == place], self._reasons[place]))
        heads = np.flatnonzero((role == SINGLE) | (role == FIRST))
        size = np.full(len(heads), self._FRAME, np.int32)
        firsts = np.flatnonzero(role[heads] == FIRST)
        places = heads[firsts]
        given = data[places, self._SIZE_AT : self._FRAME].copy().view("<u4").ravel().astype(np.int64)
        given[is_sized[places] == 0] = 0
        total = given + self._SIZE_AT
        size[firsts] = np.where(given > 0, np.minimum(total, self.transport.max_size), UNSIZED)
        is_long = (total > self.transport.max_size) & ~is_short[places]
        lost.append((places[is_long], "malformed: too long"))
        parts = FrameParts(
            frames,
            heads,
            role[heads],
            (role[heads] == FIRST).astype(np.uint8),
            size,
            keys[heads],
            number,
            [(0, 0), (0, self._FRAME - self._SIZE_AT)],
            (1, 0),
            last == 1,
            piece,
        )
        parts.lose(lost, _tied(frames, keys, self._back, np.flatnonzero(is_end & ~is_short)))
        return parts

    def _back(self, keys: Array) -> Array:
        """Return the keys of the other ways: of the sessions that an abort may end, too."""
        abort = bytes([0x80, 0, 0, 0, 0, 0, 0, 0])
        return np.array([self.transport.part(key, abort).other for key in keys.tolist()], np.uint32)
