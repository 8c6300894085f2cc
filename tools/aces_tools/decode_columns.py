"""`aces decode -o walk.parquet`: whole pieces of a capture at once, into files of tables.

1. What is counted, said and left out is what the live way counts, says and leaves out.
2. Memory is bounded whatever the capture's size: a piece is decoded, written and forgotten.
3. The output appears when it is whole: an interrupted or failed run leaves what was there before.
"""

from __future__ import annotations

import argparse
from abc import abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from aces_bus import FrameTable, make_column_scanner, open_recording
from aces_bus.errors import CallerError, CaptureError
from aces_bus.export import open_export
from aces_bus.export.base import Export
from aces_bus.protocol.columns.can import CanColumns
from aces_bus.protocol.columns.can_channels import ChannelColumns
from aces_bus.protocol.columns.decode import feed
from aces_bus.protocol.columns.table import MessageTable, kinds_of
from aces_bus.recordings.base import CanRecording, Recording, SerialRecording

from .console import SHOWN, Progress, check_not_read, say, say_note
from .decode_jobs import FORMS, Jobs, Parts, PieceResult
from .decoding import Decoding, utf8
from .output.shape import Plans
from .patience import Patience
from .reading.pieces import Direction, make_can_scanner, pieces_of
from .reading.selection import AdoptedPieces, KeptFrames, RecordingSelection, part_of
from .reading.totals import Totals
from .reading.where import Rows, WhereColumns


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
        found = self.first_contested(contested, tables)
        if found is not None:
            self._warn(contested, found, found & 0x1FFF_FFFF)

    @staticmethod
    def first_contested(contested: Any, tables: Sequence[MessageTable]) -> int | None:
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

    def __init__(self, arguments: argparse.Namespace, form: str, *, is_worker: bool = False) -> None:
        """Prepare; `is_worker`: this process decodes pieces for another, and has no output of its own."""
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
        self.jobs: Jobs | None = None
        self._notes: dict[str, None] = {}
        self.export: Export | Parts
        if is_worker:
            return
        if arguments.jobs > 1:
            if form not in FORMS:
                raise CallerError(f"--jobs writes {', '.join(FORMS)}; {form} is written by one process")
            self.jobs = Jobs(self, arguments.jobs)
            self.export = Parts(self.open_export, path, form)
        else:
            self.export = self.open_export(path)

    def open_export(self, path: str) -> Export:
        """Open an output of tables, or of a part of them."""
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

    def _can(self, capture: CanRecording, totals: Totals, patience: Patience) -> None:
        jobs, export = self.jobs, self.export
        if jobs is None or not isinstance(export, Parts):
            super()._can(capture, totals, patience)
            return
        if not jobs.are_worth(capture):
            export.begin_own()
            super()._can(capture, totals, patience)
            return
        scanner = self.can_scanner(defer=False)
        tasks = jobs.tasks(capture)
        under_way: deque[Future[PieceResult]] = deque()
        pieces = AdoptedPieces(scanner, self.selection)
        self._start_window(capture)
        try:
            while True:
                while len(under_way) < 2 * jobs.count and not patience.is_over:
                    task = next(tasks, None)
                    if task is None:
                        break
                    under_way.append(jobs.submit(task, export.plan()))
                if not under_way:
                    break
                done = under_way.popleft().result()
                if done.error:
                    raise CaptureError(done.error) if done.is_of_capture else CallerError(done.error)
                export.adopt()
                self._adopt(capture, scanner.contested, pieces, done, totals)
            self._take(pieces.close(totals), totals)
        except BrokenProcessPool as error:
            raise CallerError(
                "a decoding process has died; is there enough memory? Try fewer --jobs"
            ) from error
        finally:
            for future in under_way:
                future.cancel()
            totals.count(scanner.counts)

    def can_scanner(self, *, defer: bool) -> CanColumns | ChannelColumns:
        """Return a scanner of frames; `defer` leaves frames that hang on others to the first process."""
        return make_can_scanner(
            self.variants["can"], direction=self.direction, include_unknown=self.include_unknown, defer=defer
        )

    def _start_window(self, capture: CanRecording) -> None:
        """Set the instant that relative times count from: the first frame of the file, which every process
        must know.
        """
        if self.window is None:
            return
        untimed = self.window.untimed
        with open_recording(capture.name, link="can") as same:
            for table in same.tables():
                self.window.inside(table.time)
                if self.window.first is not None:
                    break
        self.window.untimed = untimed

    def _adopt(
        self,
        capture: CanRecording,
        contested: Mapping[int, tuple[str, str]],
        pieces: AdoptedPieces,
        done: PieceResult,
        totals: Totals,
    ) -> None:
        """Go on behind a piece: its files, its counts, its complaints, and the frames that it left."""
        self._seen(done.channels)
        if self.window is not None:
            self.window.untimed += done.untimed
        if done.contested is not None and not self.is_warned:
            self._warn(contested, done.contested, done.contested & 0x1FFF_FFFF)
        for name, number in done.totals.bins.items():
            totals.add(name, number)
        before = capture.lines
        for name, number in done.counts.items():
            setattr(capture, name, getattr(capture, name) + number)
        if any(done.counts.values()):  # a part of a log, which the process has read itself
            for kind, number in done.others.items():
                capture.others[kind] = capture.others.get(kind, 0) + number
            room = max(0, SHOWN - len(capture.problems))
            capture.problems += [p._replace(line=p.line + before) for p in done.problems[:room]]
        self._notes.update(dict.fromkeys(done.notes))
        before_frames = pieces.frames
        self._take(pieces.adopt(done.handover, totals), totals)
        self.progress.step(pieces.frames - before_frames)

    def _finish(self, *, is_whole: bool) -> None:
        if is_whole:
            for note in self._notes:
                say_note(note)
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
        if self.jobs is not None:
            self.jobs.close()
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
    globs = [pattern.strip() for text in texts for pattern in text.split(",")]
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
