"""Frames of an unknown CAN bus as guesses: messages with their timing and fields, and what belongs together.

1. Of a recording the first `FRAMES` frames are kept, of at most `IDENTIFIERS` identifiers; others are counted.
2. One identifier is looked at at a time, on the channel where it has most frames.
3. A guess says what it rests on; what is not found is not said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from aces_bus import FrameTable
from aces_bus._lazy import np
from aces_bus.frame_table import NO_TIME, FrameFlag, rows_at
from aces_bus.frames import EXTENDED, FD, REMOTE
from aces_tools.reading.fitting import FittingProtocol, fitting_protocols, undecoded
from aces_tools.reading.traffic import BusIdentifier, FrameCount, GapCounts, rows_of_each

from .fields import Array, FieldGuess, fields_of
from .nodes import Members, NodeGuess, families
from .pairs import PairGuess, pairs_of
from .protocols import ProtocolGuess, recognised
from .reference import LATEST, MeasuredQuantity, Messages, ReferenceGuesses, sought

#: Frames that are kept, and identifiers that are looked at.
FRAMES, IDENTIFIERS = 2_000_000, 2048
#: Bytes of payloads, of all messages together, whose fields are sought: 1024 messages of 8 bytes. Others stay bytes.
BYTES = 8192
#: Transports by the names of standards, as a spec declares them.
TRANSPORTS = {
    "ISO-TP": "IsoTp()",
    "fast packet": "FastPacket()",
    "J1939 transport": "J1939Transport()",
    "Cyphal": "TailByte()",
}
#: Lengths of one identifier that become messages of their own.
LENGTHS = 4
#: Frames from which on there is a period, and the share of it that gaps may differ by for it to be one.
GAPS, REGULAR = 6, 0.3


def runs_text(numbers: Sequence[int], step: int = 1, text: Callable[[int], str] = str) -> str:
    """Return rising numbers, of which those at equal distances are a run.

    >>> runs_text([1, 2, 3, 5, 8, 9]), runs_text([0x20, 0x40, 0x60], 0x20, hex)
    ('1…3, 5, 8, 9', '0x20…0x60')
    """
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + step:
            runs[-1].append(number)
        else:
            runs.append([number])
    parts = [f"{text(run[0])}…{text(run[-1])}" if len(run) > 2 else ", ".join(map(text, run)) for run in runs]
    return ", ".join(parts)


@dataclass(frozen=True)
class TimingGuess:
    """How often a message comes: `period_ns` is the median gap, `jitter_ns` the range of the middle 80 % of all gaps."""

    period_ns: int
    jitter_ns: int

    @property
    def is_regular(self) -> bool:
        """True if the message is sent by the clock."""
        return self.jitter_ns <= REGULAR * self.period_ns


@dataclass(frozen=True)
class MessageGuess:
    """One message: its identifiers, its length, its timing and its fields.

    `keys` are identifiers with their flags (`aces_bus.frames`), several where `node` says how a node number is part
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
        """The identifiers as candump writes them: `123`, `123 FD`, `201…204`, `201, 202, 205`."""
        kind = (" FD" if self.keys[0] & FD else "") + (" remote" if self.keys[0] & REMOTE else "")
        numbers = [key & 0x1FFF_FFFF for key in self.keys]
        shift = 0 if self.node is None else self.node.shift
        return runs_text(numbers, 1 << shift, lambda n: f"{n:0{8 if self.keys[0] & EXTENDED else 3}X}") + kind

    def as_dict(self) -> dict[str, Any]:
        """Return the guess in JSON's kinds."""
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
            "fields": [field.as_dict() for field in self.fields],
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
    reference: ReferenceGuesses | None = None
    #: Error frames, and frames of identifiers beyond `IDENTIFIERS`.
    errors: int = 0
    beyond: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Return the guess in JSON's kinds."""
        return {
            "link": "can",
            "frames": self.frames,
            "looked_at": self.kept,
            "error_frames": self.errors,
            "beyond": self.beyond,
            "known": [
                {"share": round(protocol.share, 4), "protocol": protocol.name} for protocol in self.known
            ],
            "decoded_by_known": self.decoded,
            "protocols": [protocol.as_dict() for protocol in self.protocols],
            "reference": None if self.reference is None else self.reference.as_dict(),
            "messages": [message.as_dict() for message in self.messages],
            "pairs": [pair.as_dict() for pair in self.pairs],
        }


class Traffic:
    """Frames as they are read; `guess` says what they are."""

    def __init__(self) -> None:
        #: Frames that were added, and the error frames among them.
        self.frames = self.errors = 0
        self._tables: list[FrameTable] = []
        self._kept = 0

    def add(self, table: FrameTable) -> None:
        """Add frames of the same recordings; the tables of one recording share their channels."""
        self.frames += len(table)
        is_error = (table.flags & FrameFlag.ERROR) != 0
        self.errors += int(is_error.sum())
        room = FRAMES - self._kept
        rows = np.flatnonzero(~is_error)[: max(0, room)]
        if len(rows):
            # Copies: what is kept must not hold on to buffers that the reader uses again.
            self._tables.append(table.take(rows))
            self._kept += len(rows)

    @property
    def first_frames(self) -> FrameTable:
        """The first table of the frames that were kept; all of them once they were guessed."""
        return self._tables[0] if self._tables else FrameTable.empty()

    def guess(
        self, *, known: bool = True, quantity: MeasuredQuantity | None = None, latest_s: float = LATEST
    ) -> TrafficGuess:
        """Return what the frames are. With `known`, what the best of the installed protocols decodes is not guessed; with a
        quantity, the fields that follow it are sought, with delays of up to `latest_s`.
        """
        frames = _one_table(self._tables)
        self._tables = [frames]
        fitting: list[FittingProtocol] = []
        decoded = 0
        if known and len(frames):
            fitting = fitting_protocols(frames)
            if fitting:
                left = undecoded(fitting[0].variant, frames)
                decoded = len(frames) - len(left)
                frames = frames.take(left)
        standards = tuple(recognised(frames))
        reference = None if quantity is None else _reference(frames, standards, quantity, latest_s)
        messages, beyond = _messages(frames, standards, reference)
        return TrafficGuess(
            self.frames,
            self._kept,
            decoded,
            tuple(fitting),
            tuple(messages),
            tuple(pairs_of(frames, _clocked(messages))),
            standards,
            reference,
            self.errors,
            beyond,
        )


def _one_table(tables: list[FrameTable]) -> FrameTable:
    """Return all frames as one table; those of another recording are on channels of its own."""
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


def rows_by_key(frames: FrameTable) -> dict[int, list[Array]]:
    """Return the rows of each key, lowest first: those of each channel in order, the one with most frames first."""
    found: dict[int, list[Array]] = {}
    for rows in rows_of_each(frames.channel.astype(np.uint64) << np.uint64(32) | frames.key):
        found.setdefault(int(frames.key[rows[0]]), []).append(rows)
    return {key: sorted(found[key], key=len, reverse=True) for key in sorted(found)}


def timing_of(gaps: GapCounts) -> TimingGuess | None:
    """Return period and jitter of a message by the gaps between its frames; None where there are too few."""
    found = gaps.quantiles_ns((0.1, 0.5, 0.9))
    if found is None or gaps.count < GAPS:
        return None
    return TimingGuess(round(found[1]), round(found[2] - found[0]))


def _carried(standards: Iterable[ProtocolGuess]) -> dict[int, str]:
    """Return the transport of each key of packets, as a spec declares it."""
    return {
        key: TRANSPORTS[standard.name]
        for standard in standards
        if standard.name in TRANSPORTS
        for key in ([packet.key for packet in standard.packets] or standard.keys)
    }


def _reference(
    frames: FrameTable, standards: Sequence[ProtocolGuess], quantity: MeasuredQuantity, latest_s: float
) -> ReferenceGuesses:
    """Return the fields that follow a quantity, by (key, length): of each identifier on the channel where it has most
    frames, and apart for each of its lengths where these are few (0: of what all lengths have).
    """
    apart = {key for standard in standards if standard.name in TRANSPORTS for key in standard.keys}

    def messages() -> Iterator[Messages]:
        for key, by_channel in list(rows_by_key(frames).items())[:IDENTIFIERS]:
            rows = by_channel[0][frames.time[by_channel[0]] != NO_TIME]
            lengths = np.unique(frames.length[rows]).tolist()
            if key in apart or key & REMOTE:
                continue
            for length in lengths if len(lengths) <= LENGTHS else lengths[:1]:
                some = rows[frames.length[rows] == length] if len(lengths) <= LENGTHS else rows
                if length:
                    data = np.ascontiguousarray(rows_at(frames.data, some)[:, :length])
                    of_length = length if len(lengths) <= LENGTHS else 0
                    shown = BusIdentifier(None, key).digits
                    yield Messages((key, of_length), frames.time[some] * 1e-9, data, shown)

    timed = frames.time[frames.time != NO_TIME]
    return sought(messages(), timed * 1e-9, quantity, latest_s)


def _messages(
    frames: FrameTable, standards: Sequence[ProtocolGuess], reference: ReferenceGuesses | None
) -> tuple[list[MessageGuess], int]:
    carried = _carried(standards)
    parts = {key for standard in standards if standard.packets for key in standard.keys}
    groups: list[Members] = []
    beyond = 0
    for key, by_channel in rows_by_key(frames).items():
        if key in parts:
            continue
        rows = np.concatenate(by_channel)
        if len(groups) >= IDENTIFIERS:
            beyond += len(rows)
            continue
        counts = [FrameCount(exact=FRAMES) for _ in by_channel]
        for count, own in zip(counts, by_channel, strict=True):
            count.count(frames.time[own], frames.length[own])
        lengths = sorted({length for count in counts for length in count.lengths_seen})
        groups.append(Members((key,), rows, tuple(lengths), timing_of(counts[0].gaps)))
    found: list[MessageGuess] = []
    looked_at = 0
    for group in families(frames, [candidate for candidate in groups if candidate.keys[0] not in carried]):
        found += _messages_of(frames, group, reference, with_fields=looked_at < BYTES)
        looked_at += sum(group.lengths[-LENGTHS:])
    for group in groups:
        if group.keys[0] in carried:
            found.append(_packets(group, carried[group.keys[0]]))
    seen = {group.keys[0] for group in groups}
    for packet in (packet for standard in standards for packet in standard.packets if packet.key not in seen):
        group = Members((packet.key,), np.zeros(packet.frames), packet.sizes, None)
        found.append(_packets(group, carried[packet.key]))
    return sorted(found, key=lambda message: (message.keys[0], message.length or 0)), beyond


def _packets(group: Members, transport: str) -> MessageGuess:
    """Return frames that are parts of packets, as packets of bytes."""
    lengths, timing = group.lengths, group.timing
    return MessageGuess(
        _name(group), group.keys, len(group.rows), None, 0, lengths, timing, (), transport=transport
    )


def _messages_of(
    frames: FrameTable, group: Members, reference: ReferenceGuesses | None, with_fields: bool
) -> Iterator[MessageGuess]:
    """Yield the messages of an identifier: one a length where there are few, else one of what all lengths have."""
    name = _name(group)
    if len(group.lengths) == 1 or group.keys[0] & REMOTE:
        yield _message(frames, group, name, group.rows, group.lengths[0], reference, with_fields)
    elif len(group.lengths) <= LENGTHS:
        for length in group.lengths:
            rows = group.rows[frames.length[group.rows] == length]
            yield _message(frames, group, f"{name}Length{length}", rows, length, reference, with_fields)
    else:
        yield _message(frames, group, name, group.rows, None, reference, with_fields)


def _message(
    frames: FrameTable,
    group: Members,
    name: str,
    rows: Array,
    length: int | None,
    reference: ReferenceGuesses | None,
    with_fields: bool,
) -> MessageGuess:
    size = group.lengths[0] if length is None else length
    key = group.keys[0]
    fields: list[FieldGuess] = []
    given = () if reference is None else reference.fields_of((key, length or 0) for key in group.keys)
    if (with_fields or given) and not key & REMOTE and size:
        digits = 4 if key & EXTENDED else 2
        prefix = (frames.id[rows].astype(">u4").view(np.uint8).reshape(-1, 4))[:, 4 - digits :]
        fields = fields_of(rows_at(frames.data, rows)[:, :size], frames.time[rows], prefix, given)
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
    """Return the keys of messages that come at a fixed rate."""
    return {
        key
        for message in messages
        if message.timing is not None and message.timing.is_regular
        for key in message.keys
    }


def _name(group: Members) -> str:
    key = group.keys[0]
    name = f"Id{BusIdentifier(None, key).digits}"
    if group.node is not None:
        name += group.node.name.capitalize()
    return name + ("Fd" if key & FD else "") + ("Remote" if key & REMOTE else "")
