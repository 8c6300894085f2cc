"""What a worker does: one input, or a piece of one that is large, into parts of the dataset.

1. Tasks and answers are data: a worker gets names, sizes and the hash of a recipe, and runs what is installed there.
2. In this order: decode into files of this machine; name in the journal what will be placed; place it; take away what an
   earlier content or a dead attempt has left; say in the journal that it is whole. Cut anywhere, it can be done again.
3. A store that fails is tried again, and so is an input that changed while it was read. Nothing of an input raises, but for
   a recipe that cannot be used: then no input can be decoded.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import zip_longest
from typing import Any, NamedTuple, TypeVar

import msgspec

from aces_bus import make_column_scanner, open_recording
from aces_bus.errors import AcesError, CallerError, CaptureError
from aces_bus.frame_table import NO_TIME, to_ns
from aces_bus.protocol import Variant
from aces_bus.protocol.columns.decode import feed
from aces_bus.protocol.columns.layout import ABSOLUTE_NS
from aces_bus.recordings.base import CanRecording, Link, SerialRecording, UnreadableEntry
from aces_bus.recordings.open import open_part
from aces_bus.version import __version__
from aces_tools.reading.pieces import (
    CaptureReading,
    SerialWays,
    frame_runs,
    make_can_scanner,
    open_any,
    pieces_of,
)
from aces_tools.reading.selection import AdoptedPieces, KeptFrames, RecordingSelection, part_of
from aces_tools.reading.totals import Totals

from .manifest import FLEET, FleetDataset, FleetInput, InputState, uri_key
from .parts import DayParts, LocalPart
from .recipe import Recipe
from .stores import Place, StoreError, StoreReader, cause_of, hash_of_file

T = TypeVar("T")

#: Seconds before an input is begun anew, once.
AGAIN_S = 1.0
#: Frames that one worker decodes before another goes on, where several read the same recording.
RUN = 1 << 18


class FleetPiece(msgspec.Struct, frozen=True, omit_defaults=True):
    """One of `of` pieces of an input: the bytes of `span`, which are lines; else, of frames in runs of `RUN`, runs `number`,
    `number` + `of`, … of a recording that every worker reads from its start."""

    number: int
    of: int
    span: tuple[int, int] | None = None
    #: Of a span: the instant of the recording's first frame that has one.
    began: int | None = None

    @property
    def says_faults(self) -> bool:
        """True if this piece reports the faults of its file."""
        return self.span is not None or self.number == 0


class FleetTask(msgspec.Struct, kw_only=True, omit_defaults=True):
    """An input that is to be decoded into a dataset."""

    dataset: str
    #: The hash of the recipe, and the version of aces-bus that made the task.
    recipe: str
    uri: str
    size: int
    stamp: str
    #: What the dataset has of it, if anything.
    before: FleetInput | None = None
    #: Parts that dead attempts may have placed.
    leftovers: list[str] = []
    #: Only this of it.
    piece: FleetPiece | None = None
    version: str = __version__


class PieceDone(msgspec.Struct):
    """A piece of an input, decoded and placed. Dask hands it from worker to worker."""

    entry: FleetInput
    piece: FleetPiece | None = None
    #: What hangs on frames of other pieces: of a span, or of each run.
    handovers: list[Any] = []
    problems: list[UnreadableEntry] = []
    lines: int = 0
    #: The instant of the recording's first frame that has one.
    began: int | None = None
    #: Frames without a time, where times are asked for.
    untimed: int = 0


class _Loaded(NamedTuple):
    """A recipe that this process uses; `folder` has its files."""

    recipe: Recipe
    variants: dict[Link, list[Variant]]
    selection: RecordingSelection
    folder: Any


#: By their hash.
_loaded: dict[str, _Loaded] = {}


def _recipe_of(dataset: FleetDataset, task: FleetTask) -> _Loaded:
    if task.version != __version__:
        raise CallerError(
            f"a worker has aces-bus {__version__}, and the run is of {task.version}: install the same on all"
        )
    if task.recipe not in _loaded:
        recipe = Recipe.decoded(dataset.recipe(task.recipe), task.recipe)
        folder = tempfile.TemporaryDirectory(prefix="aces-specs-", ignore_cleanup_errors=True)
        variants: Any = recipe.variants(folder.name)
        _loaded[task.recipe] = _Loaded(recipe, variants, recipe.selection(variants), folder)
    return _loaded[task.recipe]


def decode_input(data: bytes) -> bytes:
    """Decode the input of an encoded `FleetTask`; its encoded entry. Raises `CallerError` for a recipe that is of no use."""
    task = msgspec.json.decode(data, type=FleetTask)
    return msgspec.json.encode(InputWork(task).whole())


def decode_piece(data: bytes) -> PieceDone:
    """Decode the piece of an encoded `FleetTask`."""
    task = msgspec.json.decode(data, type=FleetTask)
    return InputWork(task).piece()


def finish_input(data: bytes, *pieces: PieceDone) -> bytes:
    """Put the pieces of an input together: what hangs on frames of other pieces, the counts, the entry."""
    task = msgspec.json.decode(data, type=FleetTask)
    return msgspec.json.encode(InputWork(task).joined(pieces))


class InputWork:
    """The work on one input."""

    def __init__(self, task: FleetTask) -> None:
        self.task = task
        self.dataset = FleetDataset(task.dataset)
        self.recipe, self.variants, self._selection, _ = _recipe_of(self.dataset, task)
        self._started = time.monotonic()

    # ------------------------------------------------------------------ an input as a whole

    def whole(self) -> FleetInput:
        """Decode it; its entry, which is in the journal."""
        try:
            return self._tried(self._done, self._renew).entry
        except Exception as error:
            return self.entry("missing", faults=[_words(self.task.uri, error)])

    def _tried(self, call: Callable[[], T], renew: Callable[[], None] = lambda: None) -> T:
        try:
            return call()
        except StoreError:  # which has been patient already: of what cannot be read on, or has changed
            time.sleep(AGAIN_S)
            renew()
            return call()

    def _renew(self) -> None:
        """Begin another attempt, from the parts that are there by now."""
        now = Place(self.task.uri).file()
        self.task.size, self.task.stamp = now.size, now.stamp

    def _done(self) -> PieceDone:
        """Return the input, or its piece, decoded and placed."""
        task, piece = self.task, self.task.piece
        span = None if piece is None else piece.span
        is_here = Place(task.uri).is_local and span is None
        reader = None if is_here else StoreReader(task.uri, span)
        try:
            found = hash_of_file(task.uri) if is_here else ""
            if is_here and self._is_same(found):
                return PieceDone(self._again())
            with self._folder() as folder:
                done, parts = self._decoded(folder, task.uri if reader is None else reader)
                if reader is not None:
                    if reader.failure is not None:
                        raise reader.failure
                    reader.drain()
                    found = reader.digest.hexdigest()
                    if self._is_same(found):
                        return PieceDone(self._again())
                self._check_unchanged()
                done.entry.hash = found
                self._place(done.entry, parts, "" if piece is None else f"-p{piece.number:05}")
        except OSError as error:
            raise StoreError(f"{task.uri}: {cause_of(error)}") from error
        finally:
            if reader is not None:
                reader.close()
        return done

    def _is_same(self, found: str) -> bool:
        """Return whether the dataset has all that would be decoded; then only the store's word for the version is new."""
        before = self.task.before
        return (
            before is not None
            and self.task.piece is None
            and before.is_settled
            and before.hash == found
            and before.recipe == self.task.recipe
            and not self.task.leftovers
        )

    def _again(self) -> FleetInput:
        assert self.task.before is not None
        entry = msgspec.structs.replace(self.task.before, stamp=self.task.stamp, size=self.task.size)
        self.dataset.note(entry)
        return entry

    def _check_unchanged(self) -> None:
        """Raise `StoreError` where the input is no longer the one of the task: the hash would be of neither."""
        task = self.task
        now = Place(task.uri).file()
        if (now.size, now.stamp) != (task.size, task.stamp):
            raise StoreError(f"{task.uri}: changed while it was read")

    def entry(self, state: InputState, **more: Any) -> FleetInput:
        """Return an entry for the input as the task has it."""
        task = self.task
        if state == "missing":  # what the dataset has of it stands until the next attempt
            more["outputs"] = self._stale(())
        return FleetInput(
            uri=task.uri,
            size=task.size,
            stamp=task.stamp,
            recipe=task.recipe,
            state=state,
            seconds=time.monotonic() - self._started,
            **more,
        )

    @contextmanager
    def _folder(self) -> Generator[str]:
        """Yield a folder for parts before they are placed: on the dataset's disk, or where Dask cleans up
        after dead workers.
        """
        where = None
        if self.dataset.place.is_local:
            where = self.dataset.path(FLEET, "work")
            os.makedirs(where, exist_ok=True)
        elif (distributed := sys.modules.get("distributed")) is not None:
            try:
                where = distributed.get_worker().local_directory
            except ValueError:  # no worker: the run's own process
                where = None
        with tempfile.TemporaryDirectory(prefix="parts-", dir=where, ignore_cleanup_errors=True) as folder:
            yield folder

    # ------------------------------------------------------------------ decoding

    def _decoded(self, folder: str, source: str | StoreReader) -> tuple[PieceDone, list[LocalPart]]:
        """Decode into parts of this machine. What could be read of a damaged recording stays, as in one process."""
        piece = self.task.piece
        self._begin(None if piece is None else piece.began)
        done = PieceDone(self.entry("unreadable"), piece)
        try:
            capture = self._open(source)
        except CaptureError as error:
            if isinstance(source, StoreReader) and source.failure is not None:
                raise source.failure from error
            if isinstance(source, str) and not os.path.isfile(source):
                raise StoreError(str(error)) from error
            done.entry.faults = [str(error)]
            return done, []
        totals, faults = Totals(), list[str]()
        parts = self._parts(folder, self.variants[capture.link])
        with capture:
            try:
                if isinstance(capture, CanRecording):
                    self._can(capture, parts, totals, done.handovers)
                else:
                    self._serial(capture, parts, totals)
            except CaptureError as error:
                if isinstance(source, StoreReader) and source.failure is not None:
                    parts.abandon()
                    raise source.failure from error
                faults.append(str(error))
            except BaseException:
                parts.abandon()
                raise
            made = parts.close()
        done.began = self.began
        done.untimed = 0 if self.selection.window is None else self.selection.window.untimed
        if piece is None or piece.says_faults:
            totals.lines_unreadable += capture.lines_unreadable
            totals.dropped += getattr(capture, "frames_dropped", 0)
            done.problems, done.lines = list(capture.problems), capture.lines
        else:
            faults = []
        if piece is None:
            faults += [f"{capture.name}:{problem}" for problem in capture.problems]
        done.entry = self._filled(parts, totals, capture.link, capture.format, faults)
        return done, made

    def _begin(self, began: int | None) -> None:
        """Begin an attempt; `began` is the instant of the recording's first frame, if it is known."""
        self.began: int | None = began
        self.selection = replace(self._selection, window=self.recipe.window)
        if began is not None and self.selection.window is not None:
            self.selection.window.see(began)

    def _see(self, time: Any, parts: DayParts) -> None:
        """Take the instants of frames: the first one says how the recording counts them."""
        if self.began is None:
            known = time[time != NO_TIME]
            if len(known):
                self.began = int(known[0])
                if self.selection.window is not None:
                    self.selection.window.see(self.began)
                parts.absolute = self._absolute

    @property
    def _absolute(self) -> bool | None:
        """True if the recording's times count from 1970; None until this is known."""
        return None if self.began is None else self.began >= ABSOLUTE_NS

    def _filled(
        self, parts: DayParts, totals: Totals, link: Link, form: str, faults: list[str]
    ) -> FleetInput:
        return self.entry(
            "done",
            link=link,
            format=form,
            counts={name: number for name, number in totals.bins.items() if number},
            lines_unreadable=totals.lines_unreadable,
            missed=totals.missed,
            dropped=totals.dropped,
            rows=parts.rows,
            first=parts.first,
            last=parts.last,
            faults=faults,
            notes=[*parts.notes, *self._untimed()],
        )

    def _untimed(self) -> Iterator[str]:
        window = self.selection.window
        if window is not None and window.untimed and self.task.piece is None:
            yield f"--from and --to need times: {window.untimed} items have none, and are filtered"

    def _open(self, source: str | StoreReader) -> CanRecording | SerialRecording:
        links: list[Link] = [link for link, variants in self.variants.items() if variants]
        file: Any = source
        piece = self.task.piece
        if piece is not None:
            if piece.span is not None:
                return open_part(file, piece.span)
            links = ["can"]
        if len(links) == 1:
            return open_recording(file, link=links[0], name=self.task.uri)
        if isinstance(source, str):
            return open_any(source)
        return open_recording(file, name=self.task.uri)

    def _parts(self, folder: str, variants: Sequence[Variant]) -> DayParts:
        return DayParts(folder, self.recipe, variants, self.task.uri, absolute=self._absolute)

    def _can(self, capture: CanRecording, parts: DayParts, totals: Totals, handovers: list[Any]) -> None:
        """Decode frames; of a piece its own, and what hangs on others goes to `handovers`."""
        piece, selection = self.task.piece, self.selection
        turns = piece if piece is not None and piece.span is None else None
        scanner = self._can_scanner(defer=piece is not None)
        runs = pieces_of(capture.tables(), is_live=False)
        first, kept = 0, KeptFrames()
        try:
            for number, frames in enumerate(frame_runs(runs, RUN) if turns is not None else runs):
                self._see(frames.time, parts)
                if turns is not None and number % turns.of != turns.number:
                    continue
                tables = scanner.feed(frames)
                passed = selection.kept(frames)
                if passed is not None:
                    kept.add(first, passed)
                    tables = [part_of(table, kept.of(table.row), totals) for table in tables]
                parts.write(selection.shown(tables, totals))
                first += len(frames)
                if turns is not None:
                    handovers.append(scanner.hand_over())
                    first, kept = 0, KeptFrames()
            if piece is None:
                tables = [part_of(table, kept.of(table.row), totals) for table in scanner.close()]
                parts.write(selection.shown(tables, totals))
        finally:
            if piece is None:
                totals.count(scanner.counts)
            elif turns is None:
                handovers.append(scanner.hand_over())

    def _can_scanner(self, *, defer: bool) -> Any:
        return make_can_scanner(
            self.variants["can"],
            direction=self.recipe.direction,
            include_unknown=self.selection.include_unknown,
            defer=defer,
        )

    def _serial(self, capture: SerialRecording, parts: DayParts, totals: Totals) -> None:
        variants, selection = self.variants["serial"], self.selection

        def make(direction: Any) -> Any:
            return make_column_scanner(
                variants, direction=direction, include_unknown=selection.include_unknown
            )

        ways = SerialWays(variants, self.recipe.direction, make, feed)
        reading = CaptureReading(ways.chunks(capture))
        try:
            for chunk in reading:
                if chunk.data and selection.window is not None:
                    selection.window.see(to_ns(chunk.time))
                for tables in ways.feed(chunk):
                    parts.write(selection.shown(selection.inside(tables, totals), totals))
            for tables in ways.close():
                parts.write(selection.shown(selection.inside(tables, totals), totals))
            reading.check()
        finally:
            for counts in ways.counts:
                totals.count(counts)

    # ------------------------------------------------------------------ placing

    def _place(self, entry: FleetInput, parts: Sequence[LocalPart], piece: str = "") -> None:
        """Put parts into the dataset and say so in the journal."""
        key = f"{uri_key(entry.uri)}-{uri_key(f'{entry.hash} {entry.recipe}')[:12]}{piece}"
        named = [(part.file, f"{part.folder}/{key}-{part.number}.parquet") for part in parts]
        entry.outputs = [name for _, name in named]
        noted = self.dataset.noted(entry.uri, piece)
        old = self._stale(entry.outputs, () if noted is None else noted.outputs)
        self.dataset.note(
            msgspec.structs.replace(entry, state="placing", outputs=[*entry.outputs, *old]), piece
        )
        for file, name in named:
            self.dataset.place.put(file, self.dataset.path(name))
        if not piece:
            self.dataset.remove(old)
            self.dataset.note(entry)

    def _stale(self, new: Sequence[str], noted: Sequence[str] = ()) -> list[str]:
        """Return parts that are known of this input and no longer of it; `noted` are those of a dead attempt
        of this task.
        """
        before = self.task.before
        known = [*self.task.leftovers, *(before.outputs if before is not None else ()), *noted]
        return [name for name in dict.fromkeys(known) if name not in set(new)]

    # ------------------------------------------------------------------ an input in pieces

    def piece(self) -> PieceDone:
        """Decode and place one of several pieces; what hangs on others is handed over."""
        return self._tried(self._done)

    def joined(self, pieces: Sequence[PieceDone]) -> FleetInput:
        """Return the entry of an input whose pieces are placed, which is in the journal."""
        try:
            return self._tried(lambda: self._joined(pieces))
        except Exception as error:
            return self.entry("missing", faults=[_words(self.task.uri, error)])

    def _joined(self, pieces: Sequence[PieceDone]) -> FleetInput:
        self._check_unchanged()
        known = [piece.entry for piece in pieces]
        hashes = [part.hash for part in known]
        is_cut = pieces[0].piece is not None and pieces[0].piece.span is not None
        if not is_cut and len(set(hashes)) > 1:
            raise StoreError(f"{self.task.uri}: changed while it was read")
        self._begin(pieces[0].began)
        adopted = AdoptedPieces(self._can_scanner(defer=False), self.selection)
        totals, faults, lines = Totals(), list[str](), 0
        with self._folder() as folder:
            parts = self._parts(folder, self.variants["can"])
            for piece in pieces:
                totals.join(piece.entry.totals)
                faults += [
                    f"{self.task.uri}:{problem._replace(line=problem.line + lines)}"
                    for problem in piece.problems
                ]
                lines += piece.lines
                if self.selection.window is not None:
                    self.selection.window.untimed += piece.untimed
            # Spans have one each; runs were decoded in turns.
            for turn in zip_longest(*(piece.handovers for piece in pieces)):
                for handover in turn:
                    if handover is not None:
                        parts.write(self.selection.shown(adopted.adopt(handover, totals), totals))
            parts.write(self.selection.shown(adopted.close(totals), totals))
            made = parts.close()
            totals.count(adopted.counts)
            for part in known:
                parts.notes.update(dict.fromkeys(part.notes))
                for name, number in part.rows.items():
                    parts.rows[name] = parts.rows.get(name, 0) + number
            parts.first = _least([parts.first, *(part.first for part in known)], min)
            parts.last = _least([parts.last, *(part.last for part in known)], max)
            stopped = [fault for part in known for fault in part.faults]
            entry = self._filled(parts, totals, "can", known[0].format, [*stopped, *faults[:5]])
            entry.state = known[0].state
            entry.hash = uri_key(" ".join(hashes)) if is_cut else hashes[0]
            entry.seconds += sum(part.seconds for part in known)
            self._place_joined(entry, made, [name for part in known for name in part.outputs])
        return entry

    def _place_joined(self, entry: FleetInput, parts: Sequence[LocalPart], placed: Sequence[str]) -> None:
        self._place(entry, parts, "-joined")
        entry.outputs = [*placed, *entry.outputs]
        self.dataset.note(entry)
        self.dataset.remove(self._stale(entry.outputs))
        names = [f"{uri_key(entry.uri)}{piece}.json" for piece in self._piece_names(len(placed))]
        self.dataset.forget(name for name in names)

    def _piece_names(self, count: int) -> Iterator[str]:
        yield "-joined"
        for number in range(count):
            yield f"-p{number:05}"


def _least(some: Sequence[int | None], choose: Any) -> int | None:
    known = [value for value in some if value is not None]
    found: int | None = choose(known) if known else None
    return found


def _words(uri: str, error: BaseException) -> str:
    """Return what is said of an input that could not be decoded for another reason than its contents."""
    text = str(error) if isinstance(error, AcesError) else f"{type(error).__name__}: {cause_of(error)}"
    return text if uri in text else f"{uri}: {text}"
