"""`aces decode -o walk.parquet --jobs N`: one capture, several processes.

1. The answer is that of one process: the same rows, counts and complaints. Only the files differ: each message is a folder
   of parts (`Encoder.parquet/part-00000.parquet`, …), which readers of Parquet take for one table.
2. Pieces are put together in the order of the capture. Frames that hang on others (requests, replies, modes) come back
   undecoded, and this process decodes them; so a reply finds its request across any border.
3. No more pieces are under way than processes can chew: memory does not grow with the file.

A plain candump log is entered at several places at once; other formats are read here and decoded there. What is as quickly
decoded as other processes are started is decoded here.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import signal
import sys
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from aces_bus.errors import AcesError, CallerError, CaptureError
from aces_bus.export import Export
from aces_bus.export.files import Staging, telling
from aces_bus.frame_table import FrameTable
from aces_bus.protocol.columns.can import CanColumns
from aces_bus.protocol.columns.can_channels import ChannelColumns
from aces_bus.protocol.columns.table import MessageTable
from aces_bus.recordings import CanRecording, UnreadableEntry, open_recording
from aces_bus.recordings.open import open_part, split_capture
from aces_bus.recordings.pieces import make_can_scanner, pieces_of
from aces_bus.recordings.selection import AdoptedPieces, part_of
from aces_bus.recordings.totals import Totals

from .console import SHOWN, say_note
from .decode_columns import ColumnDecoding
from .patience import Patience

#: Bytes of a log that are one piece, at most; each process gets as many. To begin and end the files of 60 messages takes as
#: long as to decode 7 MB, so pieces are large; but what a process leaves to this one comes with its piece, all at once.
PIECE = 64 << 20
#: Bytes of a file that are worth other processes: with less they take as much as they save.
WORTH = 8 << 20
#: What a recording counts of its lines and frames.
COUNTED = ("lines", "lines_unreadable", "lines_comment", "lines_blank", "frames_dropped")
#: Outputs that are folders of tables, which parts can be put into.
FORMS = ("parquet", "arrow", "feather")


@dataclass
class PieceResult:
    """What a process says of a piece. It can be pickled."""

    handover: Any
    totals: Totals
    channels: set[str]
    #: The key of the first frame that two protocols claim.
    contested: int | None = None
    #: What a part of a log counts, by the names of its attributes; none where the frames came from this process.
    counts: dict[str, int] = field(default_factory=dict)
    others: dict[str, int] = field(default_factory=dict)
    problems: list[UnreadableEntry] = field(default_factory=list)
    #: Frames without a time, where times are asked for.
    untimed: int = 0
    notes: list[str] = field(default_factory=list)
    error: str = ""
    #: Whether the error is of the capture; otherwise of the output, and ends the run.
    is_of_capture: bool = True


class JobsDecoding(ColumnDecoding):
    """One run over several processes."""

    def __init__(self, arguments: argparse.Namespace, form: str) -> None:
        if form not in FORMS:
            raise CallerError(f"--jobs writes {', '.join(FORMS)}; {form} is written by one process")
        super().__init__(arguments, form)
        self._pool: ProcessPoolExecutor | None = None
        self._piece = 0
        self._notes: dict[str, None] = {}
        self._deferring: CanColumns | ChannelColumns | None = None

    def _open_export(self, path: str) -> Export:
        return Parts(self, path)  # type: ignore[return-value]  # what this class uses of an export

    def part(self, path: str) -> Export:
        """Return an export of its own for a part."""
        return super()._open_export(path)

    # ------------------------------------------------------------------ this process

    def _can(self, capture: CanRecording, totals: Totals, patience: Patience) -> None:
        if capture.live or (os.path.isfile(capture.name) and os.path.getsize(capture.name) < WORTH):
            self._piece += 1
            self.export.begin_own()  # type: ignore[attr-defined]
            super()._can(capture, totals, patience)
            return
        scanner = self._column_scanner(defer=False)
        tasks = self._tasks(capture)
        under_way: deque[Future[PieceResult]] = deque()
        pieces = AdoptedPieces(scanner, self.selection)
        self._start_window(capture)
        try:
            while True:
                while len(under_way) < 2 * self.arguments.jobs and not patience.is_over:
                    task = next(tasks, None)
                    if task is None:
                        break
                    under_way.append(self._submit(task))
                if not under_way:
                    break
                self._adopt(capture, scanner, pieces, under_way.popleft().result(), totals)
            self._take(pieces.close(totals), totals)
        except BrokenProcessPool as error:
            raise CallerError(
                "a decoding process has died; is there enough memory? Try fewer --jobs"
            ) from error
        finally:
            for future in under_way:
                future.cancel()
            totals.count(scanner.counts)

    def _start_window(self, capture: CanRecording) -> None:
        """Relative times count from the first frame of the file: every process must know it."""
        if self.window is None:
            return
        untimed = self.window.untimed
        with open_recording(capture.name, link="can") as same:
            for table in same.tables():
                self.window.inside(table.time)
                if self.window.first is not None:
                    break
        self.window.untimed = untimed

    def _tasks(self, capture: CanRecording) -> Iterator[Any]:
        spans = None
        if os.path.isfile(capture.name):
            jobs = self.arguments.jobs
            turns = -(-os.path.getsize(capture.name) // (jobs * PIECE))
            spans = split_capture(capture.name, jobs * max(1, turns))
        first = None if self.window is None else self.window.first
        if spans is not None:
            for span in spans:
                yield ("span", capture.name, span, first)
            return
        for table in pieces_of(capture.tables(), is_live=False):
            yield ("table", capture.name, table, first)

    def _submit(self, task: Any) -> Future[PieceResult]:
        if self._pool is None:
            self._pool = self._make_pool()
        number, self._piece = self._piece, self._piece + 1
        return self._pool.submit(_work, task, self.export.piece(number))  # type: ignore[attr-defined]

    def _make_pool(self) -> ProcessPoolExecutor:
        # A fork has everything imported and generated already; it is safe while no thread runs beside this one.
        can_fork = sys.platform == "linux" and threading.active_count() == 1
        global _worker
        _worker = self
        return ProcessPoolExecutor(
            self.arguments.jobs,
            multiprocessing.get_context("fork" if can_fork else "spawn"),
            initializer=_begin,
            initargs=(self.arguments, self.form),
        )

    def _adopt(
        self,
        capture: CanRecording,
        scanner: Any,
        pieces: AdoptedPieces,
        done: PieceResult,
        totals: Totals,
    ) -> None:
        """Go on behind a piece: its files, its counts, its complaints, and the frames that it left."""
        if done.error:
            raise CaptureError(done.error) if done.is_of_capture else CallerError(done.error)
        export: Any = self.export
        export.adopt()
        self._seen(done.channels)
        if self.window is not None:
            self.window.untimed += done.untimed
        contested = scanner.contested
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
        super()._finish(is_whole=is_whole)

    def _clean_up(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        super()._clean_up()

    # ------------------------------------------------------------------ the other processes

    def _column_scanner(self, *, defer: bool) -> CanColumns | ChannelColumns:
        return make_can_scanner(
            self.variants["can"], direction=self.direction, include_unknown=self.include_unknown, defer=defer
        )

    def work(self, task: Any, place: str) -> PieceResult:
        """Decode a piece into an export of its own at `place`."""
        kind, name, piece, first = task
        if self._deferring is None:  # made once: `hand_over` leaves it as new
            self._deferring = self._column_scanner(defer=True)
        scanner = self._deferring
        totals, channels = Totals(), set[str]()
        contested: int | None = None
        capture: CanRecording | None = None
        if self.window is not None:
            self.window.begin()
            self.window.see(first)
            self.window.untimed = 0
        tables: Iterable[FrameTable] = [piece]
        if kind == "span":
            capture = open_part(name, piece)
            tables = pieces_of(capture.tables(), is_live=False)
        self.source = name
        with self.part(place) as self.export:
            row = 0
            for frames in tables:
                found = scanner.feed(frames)
                if scanner.contested and contested is None:
                    contested = self._first_contested(scanner.contested, found)
                if self.absent:
                    channels |= {str(frames.channels.names[n]) for n in np.unique(frames.channel).tolist()}
                kept = self.selection.kept(frames)
                if kept is not None:
                    found = [part_of(table, kept[table.row - row], totals) for table in found]
                self._take(found, totals)
                row += len(frames)
            notes = self.export.notes
        done = PieceResult(scanner.hand_over(), totals, channels, contested, notes=notes)
        if self.window is not None:
            done.untimed = self.window.untimed
        if capture is not None:
            done.counts = {name: getattr(capture, name) for name in COUNTED}
            done.others, done.problems = capture.others, capture.problems
        return done


_worker: JobsDecoding | None = None


def _begin(arguments: argparse.Namespace, form: str) -> None:
    """Start a worker process; leave Ctrl-C to the first process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    global _worker
    if _worker is None:
        _worker = DecodeWorker(arguments, form)


def _work(task: Any, place: str) -> PieceResult:
    assert _worker is not None
    try:
        return _worker.work(task, place)
    except AcesError as error:
        # The piece has a temporary name, which means nothing to the user.
        said = str(error).replace(place, _worker.arguments.output)
        return PieceResult(None, Totals(), set(), error=said, is_of_capture=isinstance(error, CaptureError))


class DecodeWorker(JobsDecoding):
    """The run as another process has it that could not be forked: without an output of its own."""

    def _open_export(self, path: str) -> Export:
        return None  # type: ignore[return-value]  # each piece has its own


class Parts:
    """The folder that parts are put into; it has of an export what `ColumnDecoding` uses."""

    def __init__(self, run: JobsDecoding, path: str) -> None:
        self._run = run
        self._path = path.rstrip("/" + os.sep) or path
        suffix = os.path.splitext(self._path)[1]
        self.suffix = suffix if suffix else f".{run.form}"
        self._staging = Staging(self._path, is_folder=True, is_ours=lambda name: name.endswith(self.suffix))
        self._folder = os.path.join(self._staging.temporary, ".pieces")
        with telling(path):
            os.mkdir(self._folder)
        self._adopted = 0
        self._own: Export | None = None
        self.notes: list[str] = []

    def piece(self, number: int) -> str:
        """Return where a process writes piece `number`."""
        return os.path.join(self._folder, f"{number}{self.suffix}")

    def adopt(self) -> None:
        """Begin to write the next piece: its files take their places, and those of the piece before are complete."""
        self._close_own()
        self._move(self.piece(self._adopted), f"part-{self._adopted:05}")
        self._adopted += 1

    def begin_own(self) -> None:
        """Begin a piece that this process alone writes."""
        self._close_own()
        self._adopted += 1

    def write(
        self, tables: Sequence[MessageTable], *, source: str | None = None, columns: Any = None
    ) -> None:
        """Tables that this process has decoded itself, of the piece that was adopted or begun last."""
        tables = [table for table in tables if len(table)]
        if not tables:
            return
        if self._own is None:
            self._own = self._run.part(os.path.join(self._folder, f"own{self.suffix}"))
        self._own.write(tables, source=source, columns=columns)

    def _close_own(self) -> None:
        if self._own is not None:
            self.notes += self._own.notes
            self._own.close()
            self._own = None
            name = f"part-{max(0, self._adopted - 1):05}-in-context"
            self._move(os.path.join(self._folder, f"own{self.suffix}"), name)

    def _move(self, place: str, part: str) -> None:
        """Move the files of a piece, each into the folder of its message."""
        with telling(self._path):
            if os.path.isfile(place):  # a single message: the parts are the folder
                os.rename(place, os.path.join(self._staging.temporary, f"{part}{self.suffix}"))
                return
            for name in os.listdir(place):
                folder = os.path.join(self._staging.temporary, name)
                os.makedirs(folder, exist_ok=True)
                os.rename(os.path.join(place, name), os.path.join(folder, f"{part}{self.suffix}"))
            shutil.rmtree(place, ignore_errors=True)

    def close(self) -> None:
        """Everything is written: the folder takes its place."""
        self._close_own()
        shutil.rmtree(self._folder, ignore_errors=True)
        self._staging.commit()

    def abandon(self) -> None:
        """Leave nothing behind."""
        if self._own is not None:
            self._own.abandon()
        self._staging.discard()
