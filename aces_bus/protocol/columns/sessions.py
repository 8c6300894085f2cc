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
    bare_keys,
    can_table,
    joined_numbers,
)
from .key_numbers import KeyNumbers
from .table import Array


def part_reader(transport: Transport) -> PartReader | None:
    """What reads the frames of a transport in columns; None where only the rule can."""
    if type(transport) is j1939.J1939Transport:
        return J1939Reader(transport)
    if type(transport) is SdoTransfer:
        return SdoReader(transport)
    return KindReader(transport) if can_table(transport) else None


class _ConversationReader:
    """What both have in common: conversations of two ends, whose sessions are the two ways."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self._ways = KeyNumbers()
        #: By the number of a way, the lower number of the two ways of its conversation.
        self._party: Array = np.empty(0, np.int64)

    def _sessions(
        self, table: FrameTable, way: Array, back: Callable[[Array], Array]
    ) -> tuple[Array, int, Array]:
        """The session of each frame, what these are below, and its conversation; `way` says who sends to whom, `back` the
        other way."""
        numbers = self._ways.of(way)
        known = self._ways.known
        if len(self._party) < len(known):
            self._ways.of(back(known))
            known = self._ways.known
            self._party = np.minimum(np.arange(len(known)), self._ways.of(back(known)))
        parts: list[tuple[Array, int]] = [(numbers, len(known))]
        parties: list[tuple[Array, int]] = [(self._party.take(numbers), len(known))]
        if (channels := len(table.channels.names)) > 1:
            parts.append((table.channel, channels))
            parties.append((table.channel, channels))
        session, count = joined_numbers(parts)
        return session, count, joined_numbers(parties)[0]


#: The role of what ties a conversation.
_TIES = 255


def _tied(role: Array, party: Array, ends: Array, is_apart: Array | None = None) -> Array | None:
    """By frame the number of its conversation where one of `ends` is in it, else −1; None where none is."""
    if not ends.any():
        return None
    is_tied = np.isin(party, np.unique(party[ends])) & (role != NO_PART)
    if is_apart is not None:
        is_tied &= ~is_apart
    return np.where(is_tied, party.astype(np.int64), -1)


class J1939Reader(_ConversationReader):
    """Frames of J1939's transport protocol: what opens and steers sessions, their data, and whole parameter groups."""

    def read(self, table: FrameTable) -> FrameParts:
        """What each frame of a table is."""
        transport = self.transport
        keys, length, data = bare_keys(table), table.length, table.data
        group = (keys >> np.uint32(16) & np.uint32(0x3FF)).astype(np.uint16)
        addresses = keys & np.uint32(0xFFFF)  # destination, source
        n = len(table)
        is_data, is_connection = group == j1939.DATA, group == j1939.CONNECTION
        is_single = ~(is_data | is_connection)
        first = np.ascontiguousarray(data[:, 0])
        role = np.full(n, SINGLE, np.uint8)
        role[is_data] = NEXT
        packet, size = keys.copy(), length.astype(np.int32)
        reasons: list[tuple[Array, str]] = []

        def lose(places: Array, reason: str) -> None:
            if len(places):
                role[places] = NO_PART
                reasons.append((places, reason))

        lose(np.flatnonzero(is_data & (length < 2)), "malformed: length")
        places = np.flatnonzero(is_connection)
        command = first[places]
        left = length[places] >= 8
        lose(places[~left], "malformed: length")
        for control, name in j1939.STEERING.items():
            mine = left & (command == control)
            lose(places[mine], f"control: {name}")
            left &= ~mine
        mine = left & (command == j1939.ABORT)
        role[places[mine]] = _TIES
        left &= ~mine
        to_all = (keys[places] >> np.uint32(8) & np.uint32(0xFF)) == j1939.EVERYBODY
        opens = (command == j1939.RTS) & ~to_all | (command == j1939.BAM) & to_all
        lose(places[left & ~opens], f"malformed: no frame of {transport.title}")
        left &= opens
        places = places[left]
        head = data[places].astype(np.int64)
        total, count = head[:, 1] | head[:, 2] << 8, head[:, 3]
        fits = (total >= j1939.LEAST) & (total <= j1939.MOST) & (count == -(-total // j1939.PIECE))
        lose(places[~fits], "malformed: length")
        lose(places[fits & (total > transport.max_size)], "malformed: too long")
        role[places[fits & (total <= transport.max_size)]] = FIRST
        number = head[:, 5] | head[:, 6] << 8 | head[:, 7] << 16
        key = keys[places].astype(np.int64)
        is_addressed = (number >> 8 & 0xFF) < j1939.BROADCAST
        number = np.where(is_addressed, number & ~0xFF | key >> 8 & 0xFF, number) & 0x3FFFF
        packet[places] = (key & 0x9C00_0000 | number << 8 | key & 0xFF).astype(np.uint32)
        size[places] = total
        session, sessions, party = self._sessions(table, addresses, _swapped)
        # Whole groups begin and end nothing: a session that all of them share.
        session = np.where(is_single, session.dtype.type(sessions), session)
        kind = np.zeros(n, np.uint8)
        kind[places] = 1
        return FrameParts(
            role,
            session,
            sessions + 1,
            first,
            kind,
            size,
            packet,
            [(0, 0), (8, 0)],
            (1, 0),
            None,
            None if ((length == 8) | ~is_data).all() else length - np.uint8(1),
            reasons,
            _tied(role, party, role == _TIES, is_single),
        )


def _swapped(addresses: Array) -> Array:
    """The same two addresses, the other way."""
    return (addresses >> np.uint32(8) | addresses << np.uint32(8)) & np.uint32(0xFFFF)


class SdoReader(_ConversationReader):
    """Frames of CANopen's service data: what each is, the first of its eight bytes says, in each way otherwise."""

    #: Bytes of a frame; where the size is in a first frame, behind what is the packet's; bits of a node in an identifier.
    _FRAME, _SIZE_AT, _NODE_BITS = 8, 4, 7

    def __init__(self, transport: Transport) -> None:
        super().__init__(transport)
        self._kinds = KeyNumbers()
        #: By 256 times the number of a way, plus the first byte: role, number, piece and whether it is the last or has a
        #: size, as `part` says; −1 as role of what ties a conversation.
        self._said: list[tuple[int, int, int, bool, bool]] = []
        self._reasons: list[str] = []
        #: By the same: whether it is of an acknowledged packet.
        self._acknowledged: list[bool] = []

    def _learn(self, key: int) -> None:
        """Ask for every first byte that a frame of a way may have."""
        for byte in range(256):
            part = self.transport.part(key, bytes([byte, 0, 0, 0, 1, 0, 0, 0]))
            role = {"single": SINGLE, "first": FIRST, "next": NEXT}.get(part.role, NO_PART)
            if part.role == "abort":
                role = _TIES
            self._acknowledged.append(part.is_acknowledged)
            self._said.append((role, part.number, len(part.data), part.is_last, part.size is not None))
            self._reasons.append(part.reason)

    def read(self, table: FrameTable) -> FrameParts | None:
        """What each frame of a table is; None where there are block transfers."""
        keys, data, n = bare_keys(table), table.data, len(table)
        way = keys >> np.uint32(self._NODE_BITS)
        kinds = self._kinds.of(way)
        for one in range(len(self._said) // 256, len(self._kinds)):
            self._learn(int(keys[np.argmax(kinds == one)]))
        said = np.array(self._said, np.uint8)
        which = kinds * 256 + data[:, 0]
        if np.array(self._acknowledged).take(which).any():
            return None
        role, number, piece, last, is_sized = (said[:, k].take(which) for k in range(5))
        reasons: list[tuple[Array, str]] = []
        other = np.flatnonzero(role == NO_PART)
        for one in np.unique(which[other]).tolist():
            reasons.append((other[which[other] == one], self._reasons[one]))
        short = np.flatnonzero(table.length != self._FRAME)
        if len(short):
            reasons = [(places[table.length[places] == self._FRAME], why) for places, why in reasons]
            role[short] = NO_PART
            reasons.append((short, "malformed: length"))
        size = np.full(n, self._FRAME, np.int32)
        firsts = np.flatnonzero(role == FIRST)
        given = data[firsts, self._SIZE_AT : self._FRAME].copy().view("<u4").ravel().astype(np.int64)
        given[is_sized[firsts] == 0] = 0
        total = given + self._SIZE_AT
        size[firsts] = np.where(given > 0, np.minimum(total, self.transport.max_size), UNSIZED)
        if (is_long := total > self.transport.max_size).any():
            role[firsts[is_long]] = NO_PART
            reasons.append((firsts[is_long], "malformed: too long"))
        session, sessions, party = self._sessions(table, keys, self._back)
        tied = _tied(role, party, role == _TIES)
        is_first = (role == FIRST).astype(np.uint8)
        heads = [(0, 0), (0, self._FRAME - self._SIZE_AT)]
        return FrameParts(
            role,
            session,
            sessions,
            number,
            is_first,
            size,
            keys,
            heads,
            (1, 0),
            last == 1,
            piece,
            reasons,
            tied,
        )

    def _back(self, keys: Array) -> Array:
        """The keys of the other ways: of the sessions that an abort may end, too."""
        abort = bytes([0x80, 0, 0, 0, 0, 0, 0, 0])
        return np.array([self.transport.part(key, abort).other for key in keys.tolist()], np.uint32)
