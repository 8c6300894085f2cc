"""What of a recording goes on to an output: chosen by frame, time, message, column and field.

1. All is recognised first: a reply is known by its request also where the request is left out.
2. What is left out is counted: it moves from its bin to `filtered`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from aces_bus import FrameTable
from aces_bus.protocol.columns.table import MessageTable
from aces_bus.protocol.counts import ScanCounts
from aces_bus.recordings.filters import CanFilter, passing

from .totals import Totals
from .where import Rows, WhereColumns
from .window import TimeWindow


@dataclass
class RecordingSelection:
    """What is wanted: of frames those that pass `filter` and `window`, of messages those of these names (none: all), of
    them these columns (None: all), and the records for which `where` holds. `unknown` says what becomes of the rest."""

    filter: CanFilter | None = None
    window: TimeWindow | None = None
    messages: Collection[str] = ()
    columns: Mapping[str, Sequence[str]] | None = None
    where: WhereColumns | None = None
    unknown: Literal["hide", "show", "only"] = "hide"

    @property
    def shows_losses(self) -> bool:
        """True if traffic that is not decoded is wanted."""
        return self.unknown != "hide"

    @property
    def include_unknown(self) -> bool:
        """True if scanners have to give what is not decoded: filters by frame and by time need it, too."""
        return self.shows_losses or self.filter is not None or self.window is not None

    def kept(self, frames: FrameTable) -> Rows | None:
        """Return which frames pass by their identifiers and times; None: all."""
        kept: Rows | None = None
        if self.window is not None:
            kept = self.window.inside(frames.time)
        if self.filter is not None:
            passed = passing(self.filter, frames)
            kept = passed if kept is None else kept & passed
        return kept

    def inside(self, tables: Sequence[MessageTable], totals: Totals) -> Sequence[MessageTable]:
        """Return what of a serial line is of a wanted time."""
        if self.window is None:
            return tables
        return [part_of(table, self.window.inside(table.time), totals) for table in tables]

    def shown(self, tables: Iterable[MessageTable], totals: Totals) -> list[MessageTable]:
        """Return what is to be written; records that are not wanted go into the bin `filtered`."""
        shown: list[MessageTable] = []
        for table in tables:
            if not table.message:
                if self.shows_losses:
                    shown.append(table)
                continue
            if (self.messages and table.message not in self.messages) or (
                self.columns is not None and table.message not in self.columns
            ):
                totals.reject(table)
                continue
            if self.where is not None:
                table = part_of(table, self.where.holds(table), totals)
            if self.unknown != "only":
                shown.append(table)
        return shown


class KeptFrames:
    """Which frames of a recording pass, piece by piece: a packet may lose frames of pieces before."""

    def __init__(self) -> None:
        self._starts: list[int] = []
        self._kept: list[Rows] = []

    def add(self, first: int, kept: Rows) -> None:
        """Add one more piece, whose first frame is number `first`."""
        self._starts.append(first)
        self._kept.append(kept)

    def of(self, rows: Any) -> Rows:
        """Return whether frames pass, by their numbers."""
        if not self._starts or not len(rows):
            return np.ones(len(rows), bool)
        if int(rows.min()) >= self._starts[-1]:
            last: Rows = self._kept[-1][rows - self._starts[-1]]
            return last
        pieces = np.searchsorted(self._starts, rows, side="right") - 1
        found = np.empty(len(rows), bool)
        for number in np.unique(pieces).tolist():
            mine = pieces == number
            found[mine] = self._kept[number][rows[mine] - self._starts[number]]
        return found


def part_of(table: MessageTable, kept: Rows, totals: Totals) -> MessageTable:
    """Return the rows that are kept; the others go into the bin `filtered`."""
    if kept.all():
        return table
    totals.reject(table.take(np.flatnonzero(~kept)))
    return table.take(np.flatnonzero(kept))


class AdoptedPieces:
    """Pieces of a recording that others have decoded, put together in their order: `scanner` decodes here what they left."""

    def __init__(self, scanner: Any, selection: RecordingSelection) -> None:
        self._scanner, self._selection = scanner, selection
        self._kept = KeptFrames()
        #: Frames of the pieces so far.
        self.frames = 0

    def adopt(self, handover: Any, totals: Totals) -> list[MessageTable]:
        """Go on behind a piece (`CanColumns.hand_over`): the tables of the frames that it left and that pass."""
        handovers = list(handover.values()) if isinstance(handover, dict) else [handover]
        count = max((piece.frames for piece in handovers), default=0)
        selection = self._selection
        if selection.window is not None:  # frames without a time were counted where they were read
            selection = replace(selection, window=copy(selection.window))
        if selection.filter is not None or selection.window is not None:
            kept = np.ones(count, bool)
            for table, rows in (left for piece in handovers for left in piece.deferred):
                kept[rows] = selection.kept(table)
            self._kept.add(self.frames, kept)
        self.frames += count
        return self._passed(self._scanner.adopt(handover), totals)

    @property
    def counts(self) -> ScanCounts:
        """Number of frames by their outcome."""
        counts: ScanCounts = self._scanner.counts
        return counts

    def close(self, totals: Totals) -> list[MessageTable]:
        """End the recording."""
        return self._passed(self._scanner.close(), totals)

    def _passed(self, tables: Iterable[MessageTable], totals: Totals) -> list[MessageTable]:
        return [part_of(table, self._kept.of(table.row), totals) for table in tables]
