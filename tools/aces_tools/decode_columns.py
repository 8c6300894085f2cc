"""`aces decode -o walk.parquet`: whole pieces of a capture at once, into files of tables.

1. What is counted, said and left out is what the live way counts, says and leaves out.
2. Memory is bounded whatever the capture's size: a piece is decoded, written and forgotten.
3. The output appears when it is whole: an interrupted or failed run leaves what was there before.
"""

from __future__ import annotations

import argparse
from abc import abstractmethod
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from aces_bus.errors import CallerError
from aces_bus.export import Export, open_export
from aces_bus.frame_table import FrameTable
from aces_bus.protocol.columns.decode import feed
from aces_bus.protocol.columns.scanner import make_column_scanner
from aces_bus.protocol.columns.table import MessageTable, kinds_of
from aces_bus.recordings import CanRecording, Recording, SerialRecording
from aces_bus.recordings.pieces import Direction, pieces_of
from aces_bus.recordings.selection import KeptFrames, RecordingSelection, part_of
from aces_bus.recordings.totals import Totals
from aces_bus.recordings.where import Rows, WhereColumns

from .console import Progress, check_not_read, say, say_note
from .decoding import Decoding, utf8
from .output.shape import Plans
from .patience import Patience


class TableDecoding(Decoding):
    """A run that decodes whole pieces into tables; what becomes of them, a subclass says in `_take`."""

    #: Whether what is not decoded is wanted, too.
    include_unknown = False

    def __init__(self, arguments: argparse.Namespace) -> None:
        super().__init__(arguments)
        self.progress = Progress(self.files)
        self.selection = RecordingSelection(self.filter, self.window)

    def _opened(self, capture: CanRecording | SerialRecording) -> None:
        self.progress.opened(capture)

    @abstractmethod
    def _take(self, tables: Sequence[MessageTable], totals: Totals) -> None:
        """Take decoded tables."""

    def _stream_scanner(self, direction: Direction | None) -> Any:
        return make_column_scanner(
            self.variants["serial"], direction=direction, include_unknown=self.include_unknown
        )

    def _can(self, capture: CanRecording, totals: Totals, patience: Patience) -> None:
        scanner = make_column_scanner(
            self.variants["can"], direction=self.direction, include_unknown=self.include_unknown
        )
        first = 0
        passed = KeptFrames()
        try:
            for frames in pieces_of(patience.each(capture.tables()), is_live=capture.live):
                tables = scanner.feed(frames)
                contested = getattr(scanner, "contested", None)
                if contested and not self.is_warned:
                    self._warn_of(contested, tables)
                if self.absent:
                    numbers = np.unique(frames.channel).tolist()
                    self._seen({str(frames.channels.names[number]) for number in numbers})
                kept = self._kept(frames)
                if kept is not None:
                    passed.add(first, kept)
                    tables = [part_of(table, passed.of(table.row), totals) for table in tables]
                self._take(tables, totals)
                first += len(frames)
                self._after(capture, len(frames))
                del frames, tables  # or they wait for the next piece to be read and decoded
            self._take([part_of(table, passed.of(table.row), totals) for table in scanner.close()], totals)
        finally:
            totals.count(scanner.counts)

    def _feed(self, scanner: Any, data: bytes, time: float | None) -> Any:
        return feed(scanner, data, time)

    def _found(self, items: Any, totals: Totals) -> None:
        self._take(self._inside(items, totals), totals)

    def _kept(self, frames: FrameTable) -> Rows | None:
        """Return which frames go on to `_take`, by their identifiers and times; None: all."""
        return self.selection.kept(frames)

    def _inside(self, tables: Sequence[MessageTable], totals: Totals) -> Sequence[MessageTable]:
        """Return what of a serial line goes on to `_take`, by its times."""
        return self.selection.inside(tables, totals)

    def _after(self, capture: Recording, frames: int = 0) -> None:
        self.progress.step(frames)
        if capture.live:
            self._problems(capture)

    def _warn_of(self, contested: Any, tables: Sequence[MessageTable]) -> None:
        """Warn when a decoded frame is of an identifier that two protocols claim: of the first such frame."""
        found = self._first_contested(contested, tables)
        if found is not None:
            self._warn(contested, found, found & 0x1FFF_FFFF)

    @staticmethod
    def _first_contested(contested: Any, tables: Sequence[MessageTable]) -> int | None:
        """Return the key of the first decoded frame that two protocols claim."""
        keys = np.fromiter(contested, np.uint32, len(contested))
        found: list[tuple[int, int]] = []
        for table in tables:
            if table.message:
                places = np.flatnonzero(np.isin(table.key, keys))
                if len(places):
                    found.append((int(table.row[places[0]]), int(table.key[places[0]])))
        return min(found)[1] if found else None


class ColumnDecoding(TableDecoding):
    """One run into an output of tables. A wrong call raises before anything is read or written."""

    def __init__(self, arguments: argparse.Namespace, form: str) -> None:
        super().__init__(arguments)
        self.columns = wanted_columns(arguments.signals, self.plans)
        self.selection = RecordingSelection(
            self.filter,
            self.window,
            self.messages,
            self.columns,
            WhereColumns(arguments.where, self.plans.only(self.messages)) if arguments.where else None,
            arguments.unknown or "hide",
        )
        self.include_unknown = self.selection.include_unknown
        self.source: str | None = None
        path: str = arguments.output
        check_not_read(path, self.files)
        self.form = form
        self.export: Export = self._open_export(path)

    def _open_export(self, path: str) -> Export:
        arguments = self.arguments
        return open_export(
            path,
            self.form,
            variants=[variant for some in self.variants.values() for variant in some],
            only=self._only(),
            names=arguments.names,
            float32=arguments.float32,
            sources=len(self.files) > 1,
        )

    def _only(self) -> str | None:
        """Return the one message that is wanted: it is written as a file and not as a folder."""
        if len(self.messages) != 1 or self.selection.shows_losses:
            return None
        name = next(iter(self.messages))
        owners = [v for some in self.variants.values() for v in some if name in v.messages]
        return name if len(owners) == 1 else None

    # ------------------------------------------------------------------ running

    def _opened(self, capture: CanRecording | SerialRecording) -> None:
        super()._opened(capture)
        self.source = utf8(capture.name)

    def _finish(self, *, is_whole: bool) -> None:
        self.progress.close()
        if not self.totals:
            return  # no file could be opened: what is at the output stays
        if not is_whole:
            self.interrupted = True
            return
        notes = self.export.notes
        self.export.close()
        for note in notes:
            say_note(note)

    def _flush(self) -> None:
        """Flush nothing: the output is not printed."""

    def _clean_up(self) -> None:
        self.progress.close()
        self.export.abandon()  # nothing, once it is closed
        if self.interrupted:
            self.status = self.status or 130
            say(f"interrupted: {self.arguments.output} is not written")

    # ------------------------------------------------------------------ tables

    def _take(self, tables: Sequence[MessageTable], totals: Totals) -> None:
        """Write what is to be shown; what --message, --signals and --where refuse goes into the bin `filtered`."""
        self.export.write(self.selection.shown(tables, totals), source=self.source, columns=self.columns)


def wanted_columns(texts: Sequence[str], plans: Plans) -> dict[str, list[str]] | None:
    """Return the columns that --signals names, of each message that has some; None: all."""
    globs = [one.strip() for text in texts for one in text.split(",")]
    if not globs:
        return None
    found: dict[str, list[str]] = {}
    known: list[str] = []
    used: set[str] = set()
    for kind, plan in plans.items():
        for column in kinds_of(plan):
            full = f"{kind.__name__}.{column.name}"
            known.append(full)
            matching = {glob for glob in globs if fnmatchcase(full, glob)}
            if matching:
                used |= matching
                names = found.setdefault(kind.__name__, [])
                if column.name not in names:
                    names.append(column.name)
    for glob in globs:
        if glob not in used:
            some = ", ".join(sorted(known)[:8])
            raise CallerError(
                f"--signals {glob!r} fits no column; they are named Message.field, with * and ? for any: {some}, …"
            )
    return found
