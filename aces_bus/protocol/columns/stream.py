"""The column scanner of byte streams: whole buffers searched, checked and decoded at once.

1. It gives what the live scanner gives, byte for byte: records, instants, losses, counts; only faster, and as tables.
2. Small pieces are gathered until there are `GATHER` bytes, so that tables come late; `flush` decides what is there.
3. Where packets do not say their size behind sync bytes, where they are stuffed, or where several framings share the wire,
   the live scanner does the work (`reason` says why).

A packet's instant is that of the piece with which it was decided: the one that holds its last byte, or the last byte of
a false header before it that promised more. With `include_unknown`, pieces of different instants are not gathered.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..counts import ScanCounts
from ..declare.message import GivenWay
from ..declare.protocol import Variant
from ..live.scanner import make_scanner
from ..live.stream import RUN, WORTH, StreamScanner
from ..record import Record
from .packets import Batch, PacketTables
from .scanner import RecordColumns
from .survey import Decided, LossRuns, Survey, losses_of, totals_of
from .table import Array, MessageTable, by_message

#: How many bytes of small pieces are gathered, and how many of a large one are decided at once.
GATHER = 1 << 16
PIECE = 1 << 20
#: Zeros behind a buffer, so that its last packets can be read in rows.
AIR = bytes(64)


class StreamColumns:
    """Finds the packets of one or more protocols in a byte stream, as tables; made by `make_column_scanner`."""

    def __init__(
        self,
        variants: Sequence[Variant],
        *,
        direction: GivenWay | None = None,
        include_unknown: bool = False,
        raw: bool = False,
    ) -> None:
        scanner = make_scanner(variants, direction=direction, include_unknown=include_unknown, raw=raw)
        assert isinstance(scanner, StreamScanner)
        self.include_unknown = include_unknown
        self.raw = raw
        self.link = scanner.link
        self.scanner = scanner
        self._records = RecordColumns(variants, include_unknown=include_unknown, raw=raw, scanner=scanner)
        self._held: list[bytes] = []
        self._size = 0
        #: Of what is held: (place in the stream where a piece ends, its instant in seconds).
        self._marks: list[tuple[int, float | None]] = []
        #: Why everything goes through the live scanner; empty where it does not.
        self.reason = "several framings share the wire"
        self._survey: Survey | None = None
        if len(scanner.framings) == 1:
            framing = scanner.framings[0]
            decider = next(d for d in scanner.deciders if any(m.framing is framing for m in d.messages))
            messages = [message for message in decider.messages if message.framing is framing]
            extras = framing.extras_of(m for d in scanner.deciders for m in d.messages)
            self.reason = Survey.why_not(framing, extras)
            if not self.reason:
                self._survey = Survey(framing, extras)
                decode = decider.decide(messages)
                self._tables = PacketTables(decider, messages, decode, self._records.channels, raw=raw)

    @property
    def counts(self) -> ScanCounts:
        """Number of bytes so far by their outcome; gathered bytes are pending."""
        return self.scanner.counts

    # ------------------------------------------------------------------ feeding

    def feed(self, data: bytes, time: float | None = None) -> list[MessageTable]:
        """Take `data`; return the tables of what it completes, one a message, in declared order; none while little is there.

        `time` (seconds) becomes the time of the packets. Raises nothing, whatever the bytes.
        """
        scanner = self.scanner
        if self._survey is None:
            return self._records.tables(scanner.feed(data, time), None)
        if time is None:
            time = self._marks[-1][1] if self._marks else scanner.time
        tables: list[MessageTable] = []
        if self.include_unknown and self._marks and self._marks[-1][1] != time:
            tables = self.flush()
        counts = scanner.counts
        if data:
            self._held.append(bytes(data))
            self._size += len(data)
            counts.total += len(data)
            counts.pending += len(data)
        elif len(self._marks) > 1 and self._marks[-2][0] == counts.total:
            self._marks.pop()  # waiting costs no memory
        if data or self._marks:
            self._marks.append((counts.total, time))
        else:
            scanner.time = time
        if self._size >= GATHER:
            tables = _merged([*tables, *self.flush()])
        return tables

    def flush(self) -> list[MessageTable]:
        """Decide what is gathered, now."""
        if not self._marks:
            return []
        data = b"".join(self._held)
        marks = self._marks
        self._held, self._size, self._marks = [], 0, []
        scanner = self.scanner
        time = marks[-1][1]
        if len(marks) == 1 and len(data) < WORTH:
            return self._records.tables(scanner.advance(data, time, silent=False), None)
        tables: list[MessageTable] = []
        for at in range(0, len(data), PIECE):
            tables += self._decide(data[at : at + PIECE] if len(data) > PIECE else data, marks)
        # The last few bytes, which may be the beginning of sync bytes, are the live scanner's.
        tables += self._records.tables(scanner.advance(b"", time, silent=False), None)
        return _merged(tables)

    def idle(self, time: float | None = None) -> list[MessageTable]:
        """Give up an incomplete packet: the line is silent. See `StreamScanner.idle`."""
        tables = self.flush()
        return _merged([*tables, *self._records.tables(self.scanner.idle(time), None)])

    def close(self) -> list[MessageTable]:
        """End the stream; return the last tables."""
        tables = self.flush()
        return _merged([*tables, *self._records.tables(self.scanner.close(), None)])

    def sent(self, data: bytes, time: float | None = None) -> list[MessageTable]:
        """Note our own transmission, one packet: a request that replies may need. Return the tables of what
        came before it.
        """
        tables = self.flush()
        self.scanner.sent(data, time)
        return tables

    def reset(self) -> None:
        """Forget everything seen, counts included: as if just made."""
        self._held, self._size, self._marks = [], 0, []
        self.scanner.reset()

    # ------------------------------------------------------------------ one buffer

    def _decide(self, data: bytes, marks: Sequence[tuple[int, float | None]]) -> list[MessageTable]:
        """Decide what can be decided of what is left of the stream so far and `data`."""
        assert self._survey is not None
        scanner = self.scanner
        counts = scanner.counts
        size = len(scanner.buffer) + len(data)
        buffer = b"".join((scanner.buffer, data, AIR))
        base = scanner.base
        decided = self._survey.decide(buffer, size)
        sizes = decided.sizes
        times, when = _instants(decided, base, marks)
        scanner.time = times[-1] if when is None else marks[-1][1]
        batch = Batch(buffer, base, decided.starts, sizes, times, when, decided.rows)
        tables, unknown, reasons = self._tables.tables(batch)
        accepted = int(sizes.sum())
        counts.records += len(sizes) - len(unknown)
        counts.decoded += accepted - int(sizes[unknown].sum())
        if self.include_unknown:
            tables += self._lost(losses_of(decided, unknown, reasons), buffer, base, decided.stop)
        else:
            for reason, number in totals_of(decided, unknown, reasons).items():
                counts.lose(number, reason)
        scanner.base += decided.stop
        scanner.buffer = buffer[decided.stop : size]
        return tables

    def _lost(self, losses: LossRuns, buffer: bytes, base: int, stop: int) -> list[MessageTable]:
        """Return tables of lost bytes. A run that may go on is left to the live scanner, which knows how to end it."""
        scanner, records = self.scanner, self._records
        first, last = 0, len(losses)
        if last and scanner.run is not None:
            first = 1
        if last > first and int(losses.starts[-1] + losses.sizes[-1]) == stop:
            last -= 1
        if len(losses) and int(losses.sizes.max()) >= RUN:
            first = last = len(losses)  # a long run comes in pieces
        tables: list[MessageTable] = []

        def one_by_one(indices: range) -> None:
            found: list[Record] = []
            for index in indices:
                loss = losses.item(index, base, buffer)
                if scanner.run is not None and loss[0] != scanner.run[0] + len(scanner.run[2]):
                    scanner.end_run(found)
                scanner.add_loss(loss, found)
            at = base + int(losses.starts[indices.stop]) if indices.stop < len(losses) else base + stop
            if scanner.run is not None and at != scanner.run[0] + len(scanner.run[2]):
                scanner.end_run(found)
            tables.extend(records.tables(found, None))

        one_by_one(range(first))
        if last > first:
            found: list[Record] = []
            scanner.end_run(found)
            tables += records.tables(found, None)
            some = slice(first, last)
            tables.append(losses.table(some, base, buffer, scanner.time, records.channels))
            for reason, number in losses.by_reason(some).items():
                scanner.counts.lose(number, reason)
        if last < len(losses):
            one_by_one(range(last, len(losses)))
        return tables


def _instants(
    decided: Decided, base: int, marks: Sequence[tuple[int, float | None]]
) -> tuple[list[float | None], Array | None]:
    """Return the instants of pieces, and which of them each packet has; see the text above."""
    times = [time for _, time in marks]
    if all(time == times[0] for time in times):
        return times[-1:], None
    known_at = decided.ends
    if len(decided.bad):
        before = np.searchsorted(decided.bad, decided.starts) - 1
        furthest = np.maximum.accumulate(decided.bad_ends)[before]
        known_at = np.where(before >= 0, np.maximum(known_at, furthest), known_at)
    ends = np.array([end for end, _ in marks], np.int64) - base
    return times, np.minimum(np.searchsorted(ends, known_at), len(times) - 1)


def _merged(tables: list[MessageTable]) -> list[MessageTable]:
    """Merge tables that follow each other to one a message; columns are still computed when asked for."""
    return [MessageTable.concat(some, is_lazy=True) for some in by_message(tables)]
