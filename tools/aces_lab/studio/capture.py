"""What the studio has of a recording or a bus: frames of each identifier, or packets of each kind, as columns.

1. One thread adds, pages read: whatever is read is taken under `lock`, as arrays that nobody writes to any more.
2. Of the newest `KEPT` frames all bytes are kept; older ones are left out and counted (`left_out`). Counts, periods and
   flips are of all.
3. A bit is named as plans name it: 8 × byte + bit, bit 0 being the least significant of its byte.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from aces_bus import Frame, FrameTable
from aces_bus.frame_table import NO_TIME, widened
from aces_bus.frames import FD, REMOTE
from aces_tools.reading.traffic import BusIdentifier, FrameCount, IdentifierCounts

from .pictures import Array

#: Frames whose bytes are kept: 17 to 25 bytes each.
KEPT = 20_000_000
#: Bytes of a packet that are looked at.
LONGEST = 512
#: Pieces of a row that are joined.
PIECES = 64


class Columns(NamedTuple):
    """Frames of a row in order: instants (ns, `NO_TIME` where the recording has none), bytes (n, width), lengths."""

    times: Array
    data: Array
    lengths: Array

    def __len__(self) -> int:  # frames, not columns
        return len(self.times)

    @property
    def places_s(self) -> Array:
        """Seconds since 1970 or of the recording; without times the number of the frame."""
        if (self.times == NO_TIME).any():
            return np.arange(len(self.times), dtype=np.float64)
        return self.times / 1e9

    def between(self, low: float, high: float) -> Columns:
        """Return the frames whose place is from `low` to `high`."""
        places = self.places_s
        begin, end = np.searchsorted(places, (low, high), side="left")
        return Columns(*(array[int(begin) : max(int(end), int(begin) + 1)] for array in self))


@dataclass(eq=False)
class TrafficRow:
    """Frames of one identifier, or packets of one kind. `name` says which message it is, if a protocol says so."""

    identifier: BusIdentifier
    name: str = ""
    counts: FrameCount = field(default_factory=FrameCount)
    #: Of each bit how often it flipped, and the instant of the last flip.
    flips: Array = field(default_factory=lambda: np.zeros(0, np.int64))
    flipped_ns: Array = field(default_factory=lambda: np.zeros(0, np.int64))
    last_ns: int = NO_TIME
    #: The newest record of a stream; of CAN the newest frame is decoded when it is shown.
    record: Any = None
    _pieces: list[Columns] = field(default_factory=list)
    _pace: tuple[int, tuple[float, float] | None] = (0, None)

    @property
    def frames(self) -> int:
        """Number of frames or packets."""
        return self.counts.frames

    @property
    def kept(self) -> int:
        """Number of frames whose bytes are kept."""
        return sum(map(len, self._pieces))

    @property
    def label(self) -> str:
        """The identifier as candump writes it, or the kind of packet."""
        return self.name if self.identifier.key < 0 else str(self.identifier)

    @property
    def last(self) -> Columns:
        """The newest frame alone."""
        return Columns(*(array[-1:] for array in self._pieces[-1]))

    @property
    def data(self) -> bytes:
        """The bytes of the newest frame."""
        if not self._pieces:
            return b""
        _, data, lengths = self._pieces[-1]
        return bytes(data[-1, : int(lengths[-1])])

    @property
    def pace_ms(self) -> tuple[float, float] | None:
        """Median period and jitter (the range of the middle 80 % of all periods) in ms; None where there are too few."""
        before, pace = self._pace
        if before != self.frames and (self.frames < 2000 or self.frames > before * 1.01):
            found = self.counts.gaps.quantiles_ns((0.5, 0.1, 0.9))
            pace = None if found is None else (found[0] / 1e6, (found[2] - found[1]) / 1e6)
            self._pace = self.frames, pace
        return pace

    def add(self, times: Array, data: Array, lengths: Array) -> None:
        """Add frames in their order; `data` is uint8 of shape (n, width), zero behind a frame's length."""
        if self.identifier.key >= 0 and self.identifier.key & REMOTE:
            lengths = np.zeros_like(lengths)
        self.counts.count(times, np.minimum(lengths, 64))
        width = max(int(lengths.max(initial=0)), len(self.flips) // 8)
        data = widened(data, width)[:, :width]
        if 8 * width > len(self.flips):
            more = 8 * width - len(self.flips)
            self.flips = np.pad(self.flips, (0, more))
            self.flipped_ns = np.pad(self.flipped_ns, (0, more), constant_values=NO_TIME)
        before = self._pieces[-1].data[-1:] if self._pieces else data[:1]
        changes: Array = data ^ np.concatenate((widened(before, width)[:, :width], data[:-1]))
        rows = np.flatnonzero(changes.any(axis=1))
        if len(rows):
            bits = np.unpackbits(changes[rows], axis=1, bitorder="little")
            self.flips += bits.sum(axis=0, dtype=np.int64)
            last = len(rows) - 1 - bits[::-1].argmax(axis=0)
            self.flipped_ns = np.where(bits.any(axis=0), times[rows[last]], self.flipped_ns)
        self.last_ns = int(times[-1])
        self._pieces.append(Columns(times, data, lengths))
        if len(self._pieces) > PIECES:
            self.columns()

    def columns(self) -> Columns:
        """Return all frames that are kept."""
        if len(self._pieces) != 1:
            width = max((piece.data.shape[1] for piece in self._pieces), default=0)
            times = [piece.times for piece in self._pieces] or [np.zeros(0, np.int64)]
            data = [widened(piece.data, width)[:, :width] for piece in self._pieces]
            lengths = [piece.lengths for piece in self._pieces] or [np.zeros(0, np.uint8)]
            joined = np.concatenate(data or [np.zeros((0, 0), np.uint8)])
            whole = Columns(np.concatenate(times), joined, np.concatenate(lengths))
            if (np.diff(whole.times) < 0).any():  # of several recordings, or several clocks
                order = np.argsort(whole.times, kind="stable")
                whole = Columns(*(array[order] for array in whole))
            self._pieces = [whole]
        return self._pieces[0]

    def leave_out_half(self) -> int:
        """Forget the older half of the frames; return how many these are."""
        whole = self.columns()
        half = len(whole) // 2
        self._pieces = [Columns(*(array[half:].copy() for array in whole))]
        return half

    def newest(self) -> Frame | None:
        """Return the newest CAN frame, None of a packet."""
        if self.identifier.key < 0 or not self._pieces:
            return None
        key, channel = self.identifier.key, self.identifier.channel
        return Frame(
            arbitration_id=self.identifier.number,
            data=self.data,
            is_extended_id=self.identifier.is_extended,
            is_remote_frame=bool(key & REMOTE),
            is_fd=bool(key & FD),
            is_error_frame=self.identifier.is_error,
            channel=channel,
            timestamp=None if self.last_ns == NO_TIME else self.last_ns / 1e9,
        )


class Capture:
    """Rows of a recording or a bus. `is_live` where more comes while one looks; `is_done` once nothing more comes."""

    def __init__(self, *, is_live: bool = False, kept: int = KEPT) -> None:
        self.lock = threading.Lock()
        self.is_live, self.is_done = is_live, False
        self._kept = kept
        self._rows: IdentifierCounts[TrafficRow] = IdentifierCounts(TrafficRow)
        self._packets: dict[tuple[str, ...], TrafficRow] = {}
        self.left_out = 0
        self.first_ns = self.last_ns = NO_TIME
        #: What should be known of how it was read: failures, bytes that are no packets.
        self.notes: list[str] = []

    @property
    def rows(self) -> list[TrafficRow]:
        """The rows, in the order of their first frames."""
        return [*self._rows.values(), *self._packets.values()]

    @property
    def frames(self) -> int:
        """Number of frames and packets."""
        return self._rows.frames + sum(row.frames for row in self._packets.values())

    @property
    def beyond(self) -> int:
        """Frames of identifiers for which there was no row."""
        return self._rows.beyond

    def add_frames(self, table: FrameTable) -> None:
        """Add CAN frames, in order."""
        if not len(table):
            return
        with self.lock:
            for row, places in self._rows.groups(table):
                row.add(table.time[places], table.data[places], table.length[places])
            self._note_times(table.time)

    def add_packets(self, name: str, channel: str | None, packets: Sequence[tuple[int, bytes, Any]]) -> None:
        """Add packets of one kind, in order: instant (ns), bytes, record."""
        raw = [data[:LONGEST] for _, data, _ in packets]
        width = max(map(len, raw))
        data = np.frombuffer(b"".join(part.ljust(width, b"\0") for part in raw), np.uint8)
        times = np.array([time for time, _, _ in packets], np.int64)
        with self.lock:
            row = self._packets.get((name,))
            if row is None:
                row = self._packets[(name,)] = TrafficRow(BusIdentifier(channel, -1), name)
            row.add(times, data.reshape(len(raw), width), np.array([len(part) for part in raw], np.uint16))
            row.record = packets[-1][2]
            self._note_times(times)

    def _note_times(self, times: Array) -> None:
        known = times[times != NO_TIME]
        if len(known):
            low, high = int(known.min()), int(known.max())
            self.first_ns = low if self.first_ns == NO_TIME else min(low, self.first_ns)
            self.last_ns = max(high, self.last_ns)
        while sum(row.kept for row in self.rows) > self._kept:
            self.left_out += max(self.rows, key=lambda row: row.kept).leave_out_half()
