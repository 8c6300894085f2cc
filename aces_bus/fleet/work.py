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
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import msgspec

from .. import __version__
from ..errors import AcesError, CallerError, CaptureError
from ..protocol.columns.decode import feed
from ..protocol.columns.scanner import make_column_scanner
from ..protocol.columns.table import MessageTable
from ..protocol.declare.protocol import Variant
from ..recordings import CanRecording, SerialRecording, open_recording
from ..recordings.base import Link
from ..recordings.open import open_part
from ..recordings.pieces import CaptureReading, SerialWays, make_can_scanner, open_any, pieces_of
from ..recordings.totals import Totals
from .manifest import FLEET, FleetDataset, FleetInput, InputState, uri_key
from .parts import DayParts, LocalPart
from .recipe import Recipe
from .stores import Place, StoreError, StoreReader, cause_of, hash_of_file

T = TypeVar("T")

#: Seconds before an input is begun anew, once.
AGAIN_S = 1.0


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
    version: str = __version__


class PieceDone(msgspec.Struct):
    """A piece of an input, decoded and placed. Dask hands it from worker to worker."""

    entry: FleetInput
    handover: Any = None
    problems: list[tuple[int, str, str]] = []
    lines: int = 0


#: Recipes that this process has loaded, by their hash: the recipe, its variants, the folder of their files.
_loaded: dict[str, tuple[Recipe, dict[Link, list[Variant]], Any]] = {}


def _recipe_of(dataset: FleetDataset, task: FleetTask) -> tuple[Recipe, dict[Link, list[Variant]]]:
    if task.version != __version__:
        raise CallerError(
            f"a worker has aces-bus {__version__}, and the run is of {task.version}: install the same on all"
        )
    if task.recipe not in _loaded:
        recipe = Recipe.decoded(dataset.recipe(task.recipe), task.recipe)
        folder = tempfile.TemporaryDirectory(prefix="aces-specs-", ignore_cleanup_errors=True)
        variants: Any = recipe.variants(folder.name)
        _loaded[task.recipe] = recipe, variants, folder
    recipe, variants, _ = _loaded[task.recipe]
    return recipe, variants


def decode_input(data: bytes) -> bytes:
    """Decode the input of an encoded `FleetTask`; its encoded entry. Raises `CallerError` for a recipe that is of no use."""
    task = msgspec.json.decode(data, type=FleetTask)
    return msgspec.json.encode(InputWork(task).whole())


def decode_piece(data: bytes, number: int, span: tuple[int, int], absolute: bool | None) -> PieceDone:
    """Decode bytes `span` of a candump log."""
    task = msgspec.json.decode(data, type=FleetTask)
    return InputWork(task).piece(number, span, absolute)


def finish_input(data: bytes, absolute: bool | None, *pieces: PieceDone) -> bytes:
    """Put the pieces of an input together: what hangs on frames of other pieces, the counts, the entry."""
    task = msgspec.json.decode(data, type=FleetTask)
    return msgspec.json.encode(InputWork(task).joined(absolute, pieces))


class InputWork:
    """The work on one input."""

    def __init__(self, task: FleetTask) -> None:
        self.task = task
        self.dataset = FleetDataset(task.dataset)
        self.recipe, self.variants = _recipe_of(self.dataset, task)
        self._began = time.monotonic()

    # ------------------------------------------------------------------ an input as a whole

    def whole(self) -> FleetInput:
        """Decode it; its entry, which is in the journal."""
        try:
            return self._tried(self._whole)
        except Exception as error:
            return self.entry("missing", faults=[_words(self.task.uri, error)])

    def _tried(self, call: Callable[[], T]) -> T:
        try:
            return call()
        except StoreError:  # which has been patient already: of what cannot be read on, or has changed
            time.sleep(AGAIN_S)
            return call()

    def _whole(self) -> FleetInput:
        task, before = self.task, self.task.before
        is_here = Place(task.uri).is_local
        reader = None if is_here else StoreReader(task.uri)
        try:
            found = hash_of_file(task.uri) if is_here else ""
            if is_here and before is not None and self._is_same(before, found):
                return self._again(before)
            with self._folder() as folder:
                entry, parts = self._decoded(folder, task.uri if reader is None else reader)
                if reader is not None:
                    if reader.failure is not None:
                        raise reader.failure
                    reader.drain()
                    found = reader.digest.hexdigest()
                    if before is not None and self._is_same(before, found):
                        return self._again(before)
                self._check_unchanged()
                entry.hash = found
                self._place(entry, parts)
        except OSError as error:
            raise StoreError(f"{task.uri}: {cause_of(error)}") from error
        finally:
            if reader is not None:
                reader.close()
        return entry

    def _is_same(self, before: FleetInput, found: str) -> bool:
        """Whether the dataset has all that would be decoded; then only the store's word for the version is new."""
        return (
            before.is_settled
            and before.hash == found
            and before.recipe == self.task.recipe
            and not self.task.leftovers
        )

    def _again(self, before: FleetInput) -> FleetInput:
        entry = msgspec.structs.replace(before, stamp=self.task.stamp, size=self.task.size)
        self.dataset.note(entry)
        return entry

    def _check_unchanged(self) -> None:
        """Raise `StoreError` where the input is no longer the one of the task: the hash would be of neither."""
        task = self.task
        now = Place(task.uri).file()
        if (now.size, now.stamp) != (task.size, task.stamp):
            # The next attempt is of what is there by then.
            task.size, task.stamp = now.size, now.stamp
            raise StoreError(f"{task.uri}: changed while it was read")

    def entry(self, state: InputState, **more: Any) -> FleetInput:
        """An entry for the input as the task has it."""
        task = self.task
        if state == "missing":  # what the dataset has of it stands until the next attempt
            more["outputs"] = self._stale(())
        return FleetInput(
            uri=task.uri,
            size=task.size,
            stamp=task.stamp,
            recipe=task.recipe,
            state=state,
            seconds=time.monotonic() - self._began,
            **more,
        )

    @contextmanager
    def _folder(self) -> Generator[str]:
        """A folder for parts before they are placed: on the dataset's disk, or where Dask cleans up behind dead workers."""
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

    def _decoded(self, folder: str, source: str | StoreReader) -> tuple[FleetInput, list[LocalPart]]:
        """Decode into parts of this machine. What could be read of a damaged recording stays, as in one process."""
        try:
            capture = self._open(source)
        except CaptureError as error:
            if isinstance(source, StoreReader) and source.failure is not None:
                raise source.failure from error
            if isinstance(source, str) and not os.path.isfile(source):
                raise StoreError(str(error)) from error
            return self.entry("unreadable", faults=[str(error)]), []
        totals, faults = Totals(), list[str]()
        parts = self._parts(folder, self.variants[capture.link])
        with capture:
            try:
                if isinstance(capture, CanRecording):
                    self._can(capture, parts, totals)
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
        totals.lines_unreadable += capture.lines_unreadable
        totals.dropped += getattr(capture, "frames_dropped", 0)
        faults += [f"{capture.name}:{problem}" for problem in capture.problems]
        return self._filled(parts, totals, capture.link, capture.format, faults), made

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
            notes=list(parts.notes),
        )

    def _open(self, source: str | StoreReader) -> CanRecording | SerialRecording:
        links: list[Link] = [link for link, variants in self.variants.items() if variants]
        file: Any = source
        if len(links) == 1:
            return open_recording(file, link=links[0], name=self.task.uri)
        if isinstance(source, str):
            return open_any(source)
        return open_recording(file, name=self.task.uri)

    def _parts(self, folder: str, variants: Sequence[Variant], absolute: bool | None = None) -> DayParts:
        return DayParts(folder, self.recipe, variants, self.task.uri, absolute=absolute)

    @property
    def _shows_losses(self) -> bool:
        return self.recipe.unknown != "hide"

    def _can(self, capture: CanRecording, parts: DayParts, totals: Totals) -> None:
        scanner = make_column_scanner(
            self.variants["can"], direction=self.recipe.direction, include_unknown=self._shows_losses
        )
        try:
            for frames in pieces_of(capture.tables(), is_live=False):
                self._take(scanner.feed(frames), parts, totals)
            self._take(scanner.close(), parts, totals)
        finally:
            totals.count(scanner.counts)

    def _serial(self, capture: SerialRecording, parts: DayParts, totals: Totals) -> None:
        variants = self.variants["serial"]

        def make(direction: Any) -> Any:
            return make_column_scanner(variants, direction=direction, include_unknown=self._shows_losses)

        ways = SerialWays(variants, self.recipe.direction, make, feed)
        reading = CaptureReading(ways.chunks(capture))
        try:
            for chunk in reading:
                for tables in ways.feed(chunk):
                    self._take(tables, parts, totals)
            for tables in ways.close():
                self._take(tables, parts, totals)
            reading.check()
        finally:
            for counts in ways.counts:
                totals.count(counts)

    def _take(self, tables: Iterable[MessageTable], parts: DayParts, totals: Totals) -> None:
        """Write what is wanted; what the recipe leaves out goes into the bin `filtered`."""
        recipe = self.recipe
        shown: list[MessageTable] = []
        for table in tables:
            if not table.message:
                if self._shows_losses:
                    shown.append(table)
            elif (recipe.messages is not None and table.message not in recipe.messages) or (
                recipe.columns is not None and table.message not in recipe.columns
            ):
                totals.reject(table)
            elif recipe.unknown != "only":
                shown.append(table)
        parts.write(shown)

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
        """Parts that are known of this input and no longer of it; `noted` are those of a dead attempt of this task."""
        before = self.task.before
        known = [*self.task.leftovers, *(before.outputs if before is not None else ()), *noted]
        return [name for name in dict.fromkeys(known) if name not in set(new)]

    # ------------------------------------------------------------------ an input in pieces

    def piece(self, number: int, span: tuple[int, int], absolute: bool | None) -> PieceDone:
        """Decode and place one of several pieces; what hangs on others is handed over."""
        return self._tried(lambda: self._piece(number, span, absolute))

    def _piece(self, number: int, span: tuple[int, int], absolute: bool | None) -> PieceDone:
        reader = StoreReader(self.task.uri, span)
        scanner = make_can_scanner(
            self.variants["can"],
            direction=self.recipe.direction,
            include_unknown=self._shows_losses,
            defer=True,
        )
        totals = Totals()
        file: Any = reader
        capture = open_part(file, span)
        try:
            with self._folder() as folder:
                parts = self._parts(folder, self.variants["can"], absolute)
                try:
                    for frames in pieces_of(capture.tables(), is_live=False):
                        self._take(scanner.feed(frames), parts, totals)
                except BaseException:
                    parts.abandon()
                    raise
                made = parts.close()
                if reader.failure is not None:
                    raise reader.failure
                totals.lines_unreadable = capture.lines_unreadable
                entry = self._filled(parts, totals, "can", capture.format, [])
                entry.hash = reader.digest.hexdigest()
                self._place(entry, made, f"-p{number:05}")
        except CaptureError as error:
            raise reader.failure or StoreError(str(error)) from error
        finally:
            reader.close()
        problems = [(one.line, one.reason, one.excerpt) for one in capture.problems]
        return PieceDone(entry, scanner.hand_over(), problems, capture.lines)

    def joined(self, absolute: bool | None, pieces: Sequence[PieceDone]) -> FleetInput:
        """The entry of an input whose pieces are placed, which is in the journal."""
        try:
            return self._tried(lambda: self._joined(absolute, pieces))
        except Exception as error:
            return self.entry("missing", faults=[_words(self.task.uri, error)])

    def _joined(self, absolute: bool | None, pieces: Sequence[PieceDone]) -> FleetInput:
        self._check_unchanged()
        variants = self.variants["can"]
        scanner = make_can_scanner(
            variants, direction=self.recipe.direction, include_unknown=self._shows_losses, defer=False
        )
        totals, faults, lines = Totals(), list[str](), 0
        with self._folder() as folder:
            parts = self._parts(folder, variants, absolute)
            for piece in pieces:
                self._take(scanner.adopt(piece.handover), parts, totals)
                totals.join(piece.entry.totals)
                faults += [
                    f"{self.task.uri}:{line + lines}: {reason}" + (f": {start!r}" if start else "")
                    for line, reason, start in piece.problems
                ]
                lines += piece.lines
            self._take(scanner.close(), parts, totals)
            made = parts.close()
            totals.count(scanner.counts)
            for piece in pieces:
                parts.notes.update(dict.fromkeys(piece.entry.notes))
                for name, number in piece.entry.rows.items():
                    parts.rows[name] = parts.rows.get(name, 0) + number
            known = [piece.entry for piece in pieces]
            parts.first = _least([parts.first, *(one.first for one in known)], min)
            parts.last = _least([parts.last, *(one.last for one in known)], max)
            entry = self._filled(parts, totals, "can", pieces[0].entry.format, faults[:5])
            entry.hash = uri_key(" ".join(one.hash for one in known))
            entry.seconds += sum(one.seconds for one in known)
            self._place_joined(entry, made, [name for one in known for name in one.outputs])
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
    known = [one for one in some if one is not None]
    found: int | None = choose(known) if known else None
    return found


def _words(uri: str, error: BaseException) -> str:
    """What is said of an input that could not be decoded for another reason than its contents."""
    text = str(error) if isinstance(error, AcesError) else f"{type(error).__name__}: {cause_of(error)}"
    return text if uri in text else f"{uri}: {text}"
