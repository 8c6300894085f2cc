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
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from aces_bus import FrameTable
from aces_bus.errors import AcesError, CaptureError
from aces_bus.export.base import Export
from aces_bus.export.files import Staging, telling
from aces_bus.protocol.columns.table import MessageTable
from aces_bus.recordings.base import CanRecording, UnreadableEntry
from aces_bus.recordings.open import open_part, split_capture

from .reading.pieces import pieces_of
from .reading.selection import part_of
from .reading.totals import Totals

if TYPE_CHECKING:
    from .decode_columns import ColumnDecoding

#: Bytes of a log that are one piece, at most; each process gets as many. To begin and end the files of 60 messages takes as
#: long as to decode 7 MB, so pieces are large; but what a process leaves to this one comes with its piece, all at once.
PIECE = 64 << 20
#: Bytes of a file that are worth other processes: with less they take as much as they save.
WORTH = 8 << 20
#: What a recording counts of its lines and frames.
COUNTED = ("lines", "lines_unreadable", "lines_comment", "lines_blank", "frames_dropped")
#: Outputs that are folders of tables, which parts can be put into.
FORMS = ("parquet", "arrow", "feather")
#: Name of a recording, a piece of it (its place in a log, or frames), the instant (ns) that relative times count from.
Task = tuple[str, Any, int | None]


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


class PieceDecoder:
    """Decodes pieces of recordings for the first process; `run` has the protocols and what is wanted."""

    def __init__(self, run: ColumnDecoding) -> None:
        self._run = run
        #: Made once: `hand_over` leaves it as new.
        self._scanner = run.can_scanner(defer=True)

    def decode(self, task: Task, place: str) -> PieceResult:
        """Decode a piece into an export of its own at `place`."""
        run, scanner, window = self._run, self._scanner, self._run.window
        name, piece, first = task
        totals, channels = Totals(), set[str]()
        contested: int | None = None
        capture: CanRecording | None = None
        if window is not None:
            window.begin()
            if first is not None:
                window.see(first)
            window.untimed = 0
        tables: Iterable[FrameTable]
        if isinstance(piece, FrameTable):
            tables = [piece]
        else:
            capture = open_part(name, piece)
            tables = pieces_of(capture.tables(), is_live=False)
        with run.open_export(place) as export:
            row = 0
            for frames in tables:
                found = scanner.feed(frames)
                if scanner.contested and contested is None:
                    contested = run.first_contested(scanner.contested, found)
                if run.absent:
                    channels |= {str(frames.channels.names[n]) for n in np.unique(frames.channel).tolist()}
                kept = run.selection.kept(frames)
                if kept is not None:
                    found = [part_of(table, kept[table.row - row], totals) for table in found]
                export.write(run.selection.shown(found, totals), source=name, columns=run.columns)
                row += len(frames)
            notes = export.notes
        done = PieceResult(scanner.hand_over(), totals, channels, contested, notes=notes)
        if window is not None:
            done.untimed = window.untimed
        if capture is not None:
            done.counts = {name: getattr(capture, name) for name in COUNTED}
            done.others, done.problems = capture.others, capture.problems
        return done


class Jobs:
    """The other processes of a run, at most `count`: they are started with the first piece."""

    def __init__(self, run: ColumnDecoding, count: int) -> None:
        self._run, self.count = run, count
        self._pool: ProcessPoolExecutor | None = None

    def are_worth(self, capture: CanRecording) -> bool:
        """Return False for a recording that this process decodes as quickly as others are started."""
        is_small = os.path.isfile(capture.name) and os.path.getsize(capture.name) < WORTH
        return not (capture.live or is_small)

    def tasks(self, capture: CanRecording) -> Iterator[Task]:
        """Yield the pieces of a recording: places in a plain log, else frames that are read here."""
        run = self._run
        spans = None
        if os.path.isfile(capture.name):
            turns = -(-os.path.getsize(capture.name) // (self.count * PIECE))
            spans = split_capture(capture.name, self.count * max(1, turns))
        first = None if run.window is None else run.window.first
        for piece in spans if spans is not None else pieces_of(capture.tables(), is_live=False):
            yield capture.name, piece, first

    def submit(self, task: Task, place: str) -> Future[PieceResult]:
        """Have a piece decoded into an export at `place`."""
        if self._pool is None:
            # A fork has everything imported and generated already; it is safe while no thread runs beside this one.
            can_fork = sys.platform == "linux" and threading.active_count() == 1
            global _decoder
            _decoder = PieceDecoder(self._run)
            self._pool = ProcessPoolExecutor(
                self.count,
                multiprocessing.get_context("fork" if can_fork else "spawn"),
                initializer=_begin,
                initargs=(self._run.arguments, self._run.form),
            )
        return self._pool.submit(_decode, task, place, self._run.arguments.output)

    def close(self) -> None:
        """Wait for the processes to end; pieces that are not begun are dropped."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)


_decoder: PieceDecoder | None = None


def _begin(arguments: argparse.Namespace, form: str) -> None:
    """Start a worker process; leave Ctrl-C to the first process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    global _decoder
    if _decoder is None:
        from .decode_columns import ColumnDecoding

        _decoder = PieceDecoder(ColumnDecoding(arguments, form, is_worker=True))


def _decode(task: Task, place: str, output: str) -> PieceResult:
    assert _decoder is not None
    try:
        return _decoder.decode(task, place)
    except AcesError as error:
        # The piece has a temporary name, which means nothing to the user.
        said = str(error).replace(place, output)
        return PieceResult(None, Totals(), set(), error=said, is_of_capture=isinstance(error, CaptureError))


class Parts:
    """The folder that parts are put into, with what a run uses of an export. `open_export` opens one at a path."""

    def __init__(self, open_export: Callable[[str], Export], path: str, form: str) -> None:
        self._open_export = open_export
        self._path = path.rstrip("/" + os.sep) or path
        suffix = os.path.splitext(self._path)[1]
        self.suffix = suffix if suffix else f".{form}"
        self._staging = Staging(self._path, is_folder=True, is_ours=lambda name: name.endswith(self.suffix))
        self._folder = os.path.join(self._staging.temporary, ".pieces")
        with telling(path):
            os.mkdir(self._folder)
        self._planned = self._adopted = 0
        self._own: Export | None = None
        self.notes: list[str] = []

    def _place(self, number: int) -> str:
        return os.path.join(self._folder, f"{number}{self.suffix}")

    def plan(self) -> str:
        """Return where a process writes the next piece."""
        self._planned += 1
        return self._place(self._planned - 1)

    def adopt(self) -> None:
        """Begin to write the next piece: its files take their places, and those of the piece before are complete."""
        self._close_own()
        self._move(self._place(self._adopted), f"part-{self._adopted:05}")
        self._adopted += 1

    def begin_own(self) -> None:
        """Begin a piece that this process alone writes."""
        self._close_own()
        self._planned += 1
        self._adopted += 1

    def write(
        self, tables: Sequence[MessageTable], *, source: str | None = None, columns: Any = None
    ) -> None:
        """Write tables that this process has decoded itself, of the piece that was adopted or begun last."""
        tables = [table for table in tables if len(table)]
        if not tables:
            return
        if self._own is None:
            self._own = self._open_export(os.path.join(self._folder, f"own{self.suffix}"))
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
        """Move the folder to its place: everything is written."""
        self._close_own()
        shutil.rmtree(self._folder, ignore_errors=True)
        self._staging.commit()

    def abandon(self) -> None:
        """Leave nothing behind."""
        if self._own is not None:
            self._own.abandon()
        self._staging.discard()
