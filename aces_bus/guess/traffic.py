"""Frames of a CAN bus that nobody can read, as guesses: messages with their timing and fields, and what belongs together.

1. Of a recording the first `FRAMES` frames are kept, of at most `IDENTIFIERS` identifiers; others are counted.
2. One identifier is looked at at a time, on the channel where it has most frames.
3. A guess says what it rests on; what is not found is not said.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from .._lazy import np
from ..frame_table import ERROR, NO_TIME, FrameTable, rows_at
from ..protocol.keys import EXTENDED, FD, REMOTE
from .fields import Array, FieldGuess, fields_of
from .known import TRIED_FRAMES, FittingProtocol, fitting_protocols, undecoded
from .nodes import Members, NodeGuess, families
from .pairs import PairGuess, pairs_of
from .protocols import ProtocolGuess, recognised

#: Frames that are kept, and identifiers that are looked at.
FRAMES, IDENTIFIERS = 2_000_000, 2048
#: Bytes of payloads, of all messages together, whose fields are sought: 1024 messages of 8 bytes. Others stay bytes.
BYTES = 8192
#: Transports by the names of standards, as a spec declares them.
TRANSPORTS = {"ISO-TP": "IsoTp()", "fast packet": "FastPacket()"}
#: Lengths of one identifier that become messages of their own.
LENGTHS = 4
#: Frames from which on there is a period, and the share of it that gaps may differ by for it to be one.
GAPS, REGULAR = 6, 0.3


@dataclass(frozen=True)
class TimingGuess:
    """How often a message comes: `period_ns` is the median gap, `jitter_ns` the range of the middle 80 % of all gaps."""

    period_ns: int
    jitter_ns: int

    @property
    def is_regular(self) -> bool:
        """Whether it is sent by the clock."""
        return self.jitter_ns <= REGULAR * self.period_ns


@dataclass(frozen=True)
class MessageGuess:
    """One message: its identifiers, its length, its timing and its fields.

    `keys` are identifiers with their flags (`aces_bus.protocol.keys`), several where `node` says how a node number is part
    of them. `length` is in bytes; None where it varies, and then `size` bytes are always there.
    """

    name: str
    keys: tuple[int, ...]
    frames: int
    length: int | None
    size: int
    lengths: tuple[int, ...]
    timing: TimingGuess | None
    fields: tuple[FieldGuess, ...]
    node: NodeGuess | None = None
    #: What carries it in several frames, as a spec declares it: "IsoTp()".
    transport: str = ""

    @property
    def identifier(self) -> int:
        """The identifier, or the lowest one."""
        return self.keys[0] & 0x1FFF_FFFF

    @property
    def shown(self) -> str:
        """The identifiers as candump writes them."""
        digits = 8 if self.keys[0] & EXTENDED else 3
        first, last = (f"{key & 0x1FFF_FFFF:0{digits}X}" for key in (self.keys[0], self.keys[-1]))
        return first if len(self.keys) == 1 else f"{first}…{last}"

    def as_dict(self) -> dict[str, Any]:
        """The guess in JSON's kinds."""
        return {
            "name": self.name,
            "identifiers": [key & 0x1FFF_FFFF for key in self.keys],
            "extended": bool(self.keys[0] & EXTENDED),
            "fd": bool(self.keys[0] & FD),
            "remote": bool(self.keys[0] & REMOTE),
            "transport": self.transport or None,
            "node": None if self.node is None else self.node.as_dict(),
            "frames": self.frames,
            "lengths": list(self.lengths),
            "period_ms": None if self.timing is None else self.timing.period_ns / 1e6,
            "jitter_ms": None if self.timing is None else self.timing.jitter_ns / 1e6,
            "fields": [one.as_dict() for one in self.fields],
        }


@dataclass(frozen=True)
class TrafficGuess:
    """What a recording of a CAN bus was found to be."""

    #: Frames of the recording; those that were looked at; those that a known protocol decodes.
    frames: int
    kept: int
    decoded: int
    known: tuple[FittingProtocol, ...] = ()
    messages: tuple[MessageGuess, ...] = ()
    pairs: tuple[PairGuess, ...] = ()
    protocols: tuple[ProtocolGuess, ...] = ()
    #: Error frames, and frames of identifiers beyond `IDENTIFIERS`.
    errors: int = 0
    beyond: int = 0

    def as_dict(self) -> dict[str, Any]:
        """The guess in JSON's kinds."""
        return {
            "link": "can",
            "frames": self.frames,
            "looked_at": self.kept,
            "error_frames": self.errors,
            "beyond": self.beyond,
            "known": [{"share": round(one.share, 4), "protocol": one.name} for one in self.known],
            "decoded_by_known": self.decoded,
            "protocols": [one.as_dict() for one in self.protocols],
            "messages": [one.as_dict() for one in self.messages],
            "pairs": [one.as_dict() for one in self.pairs],
        }


class Traffic:
    """Frames as they are read; `guess` says what they are."""

    def __init__(self) -> None:
        #: Frames that were added, and the error frames among them.
        self.frames = self.errors = 0
        self._tables: list[FrameTable] = []
        self._kept = 0

    def add(self, table: FrameTable) -> None:
        """More frames of the same recordings; the tables of one recording share their channels."""
        self.frames += len(table)
        is_error = (table.flags & ERROR) != 0
        self.errors += int(is_error.sum())
        room = FRAMES - self._kept
        rows = np.flatnonzero(~is_error)[: max(0, room)]
        if len(rows):
            # Copies: what is kept must not hold on to buffers that the reader uses again.
            self._tables.append(table.take(rows))
            self._kept += len(rows)

    def guess(self, *, known: bool = True) -> TrafficGuess:
        """What the frames are. With `known`, what the best of the installed protocols decodes is not guessed."""
        frames = _one_table(self._tables)
        self._tables = [frames]
        fitting: list[FittingProtocol] = []
        decoded = 0
        if known and len(frames):
            fitting = fitting_protocols(frames.take(slice(0, TRIED_FRAMES)))
            if fitting:
                left = undecoded(fitting[0].variant, frames)
                decoded = len(frames) - len(left)
                frames = frames.take(left)
        standards = tuple(recognised(frames))
        messages, beyond = _messages(frames, _carried(standards))
        return TrafficGuess(
            self.frames,
            self._kept,
            decoded,
            tuple(fitting),
            tuple(messages),
            tuple(pairs_of(frames, _clocked(messages))),
            standards,
            self.errors,
            beyond,
        )


def _one_table(tables: list[FrameTable]) -> FrameTable:
    """All frames as one table; those of another recording are on channels of its own."""
    if not tables:
        return FrameTable.empty()
    first = tables[0].channels
    if all(table.channels is first for table in tables):
        return FrameTable.concat(tables)
    numbered: dict[int, int] = {}
    for table in tables:
        numbered.setdefault(id(table.channels), len(numbered) % 256)
    moved = [
        FrameTable(
            t.time,
            t.channel + np.uint16(numbered[id(t.channels)] << 8),
            t.id,
            t.flags,
            t.length,
            t.data,
            first,
        )
        for t in tables
    ]
    return FrameTable.concat(moved)


def by_key(frames: FrameTable) -> Iterator[tuple[int, Array]]:
    """Each key with its rows, in order, channel by channel: those of the one where it has most frames first."""
    order = np.argsort(frames.key, kind="stable")
    keys = frames.key[order]
    starts = np.flatnonzero(np.diff(keys, prepend=~keys[:1])).tolist()
    for start, end in pairwise([*starts, len(keys)]):
        rows = order[start:end]
        channels = frames.channel[rows]
        if (channels != channels[0]).any():
            rows = rows[np.argsort(-np.bincount(channels)[channels], kind="stable")]
        yield int(keys[start]), rows


def timing_of(times: Array) -> TimingGuess | None:
    """Period and jitter of a message by the instants (int64 ns) of its frames; None where there are too few."""
    times = times[times != NO_TIME]
    gaps = np.diff(times)
    if len(gaps) < GAPS:
        return None
    low, middle, high = np.quantile(gaps, (0.1, 0.5, 0.9))
    return TimingGuess(round(middle), round(high - low)) if middle > 0 else None


def _carried(standards: Iterable[ProtocolGuess]) -> dict[int, str]:
    """The transport of each key whose frames are parts of packets, as a spec declares it."""
    return {key: TRANSPORTS[one.name] for one in standards if one.name in TRANSPORTS for key in one.keys}


def _messages(frames: FrameTable, carried: Mapping[int, str]) -> tuple[list[MessageGuess], int]:
    groups: list[Members] = []
    beyond = 0
    for key, rows in by_key(frames):
        if len(groups) >= IDENTIFIERS:
            beyond += len(rows)
            continue
        own = rows[frames.channel[rows] == frames.channel[rows[0]]]
        lengths = tuple(np.unique(frames.length[rows]).tolist())
        groups.append(Members((key,), rows, lengths, timing_of(frames.time[own])))
    found: list[MessageGuess] = []
    looked_at = 0
    for group in families(frames, [one for one in groups if one.keys[0] not in carried]):
        found += _messages_of(frames, group, with_fields=looked_at < BYTES)
        looked_at += sum(group.lengths[-LENGTHS:])
    for group in groups:
        if group.keys[0] in carried:
            found.append(_packets(frames, group, carried[group.keys[0]]))
    return sorted(found, key=lambda one: (one.keys[0], one.length or 0)), beyond


def _packets(frames: FrameTable, group: Members, transport: str) -> MessageGuess:
    """Frames that are parts of packets, as packets of bytes."""
    rows = group.rows
    return MessageGuess(
        _name(group), group.keys, len(rows), None, 0, group.lengths, group.timing, (), transport=transport
    )


def _messages_of(frames: FrameTable, group: Members, with_fields: bool) -> Iterator[MessageGuess]:
    """The messages of an identifier: one a length where there are few, else one of what all lengths have."""
    name = _name(group)
    if len(group.lengths) == 1 or group.keys[0] & REMOTE:
        yield _message(frames, group, name, group.rows, group.lengths[0], with_fields)
    elif len(group.lengths) <= LENGTHS:
        for length in group.lengths:
            rows = group.rows[frames.length[group.rows] == length]
            yield _message(frames, group, f"{name}Length{length}", rows, length, with_fields)
    else:
        yield _message(frames, group, name, group.rows, None, with_fields)


def _message(
    frames: FrameTable, group: Members, name: str, rows: Array, length: int | None, with_fields: bool
) -> MessageGuess:
    size = group.lengths[0] if length is None else length
    key = group.keys[0]
    fields: list[FieldGuess] = []
    if with_fields and not key & REMOTE and size:
        digits = 4 if key & EXTENDED else 2
        prefix = (frames.id[rows].astype(">u4").view(np.uint8).reshape(-1, 4))[:, 4 - digits :]
        fields = fields_of(rows_at(frames.data, rows)[:, :size], frames.time[rows], prefix)
    return MessageGuess(
        name,
        group.keys,
        len(rows),
        length,
        0 if key & REMOTE else size,
        group.lengths if length is None else (length,),
        group.timing,
        tuple(fields),
        group.node,
    )


def _clocked(messages: Iterable[MessageGuess]) -> set[int]:
    """The keys of messages that come at a fixed rate."""
    return {key for one in messages if one.timing is not None and one.timing.is_regular for key in one.keys}


def _name(group: Members) -> str:
    key = group.keys[0]
    digits = 8 if key & EXTENDED else 3
    name = f"Id{key & 0x1FFF_FFFF:0{digits}X}"
    if group.node is not None:
        name += group.node.name.capitalize()
    return name + ("Fd" if key & FD else "") + ("Remote" if key & REMOTE else "")
