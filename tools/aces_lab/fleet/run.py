"""A run over a fleet's recordings: what is missing or changed is decoded, the rest stands.

1. Nothing is read before the call is known to be right; nothing is sent that is not data.
2. So many tasks are under way as keep the workers busy, however many inputs there are.
3. What is done is in the manifest within `FOLD_S`, and in the journal at once: a run that is cut off goes on where it was.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from aces_bus import open_recording
from aces_bus.errors import CallerError, CaptureError
from aces_bus.frame_table import NO_TIME
from aces_bus.protocol.columns.arrow import load_pyarrow
from aces_bus.recordings.base import Link
from aces_bus.recordings.open import LEAST, may_be_split
from aces_bus.recordings.source import cut_lines
from aces_tools.reading.pieces import Direction
from aces_tools.reading.totals import Totals

from .cluster import Workers, exposure, open_workers
from .manifest import FleetDataset, FleetInput, joined_totals, uri_key
from .recipe import FleetProtocol, Recipe, Unknown
from .stores import Place, StoredFile, StoreError, StoreReader, cause_of
from .work import FleetPiece, FleetTask, decode_input, decode_piece, finish_input

#: Seconds between two writings of the manifest, at least; and how much longer than one writing takes.
FOLD_S, FOLD_SHARE = 30.0, 20
#: An input is split when it is larger than a worker's share by this part, and its pieces have at least so many bytes.
SHARE, SPLIT = 4, 32 << 20
#: Pieces that an input has at most for each worker.
PIECES = 16
#: Workers that read one recording from its start, at most: what each decodes gets less, what it reads does not.
TURNS = 8


@dataclass
class FleetProgress:
    """How far a run is. Bytes are those of the inputs as they are stored."""

    inputs: int
    bytes: int
    #: Inputs that stood already, and are not among the others.
    stood: int = 0
    done: int = 0
    faulty: int = 0
    bytes_done: int = 0
    items: int = 0
    began: float = field(default_factory=time.monotonic)

    @property
    def seconds(self) -> float:
        """Since the run began to decode."""
        return max(time.monotonic() - self.began, 1e-9)

    @property
    def rate(self) -> float:
        """Bytes a second."""
        return self.bytes_done / self.seconds

    @property
    def seconds_left(self) -> float | None:
        """As long as what is left takes at this rate; None before anything is done."""
        return (self.bytes - self.bytes_done) / self.rate if self.bytes_done else None


@dataclass
class FleetRun:
    """What a run did. `inputs` are those that were decoded now, `stood` is the number of those that stood."""

    dataset: str
    inputs: list[FleetInput]
    stood: int
    seconds: float
    #: Ctrl-C ended it; the next run goes on.
    interrupted: bool = False

    @property
    def total(self) -> dict[Link, Totals]:
        """Frames and bytes by their outcome, per link: the sum over the inputs."""
        return joined_totals(self.inputs)

    @property
    def failed(self) -> list[FleetInput]:
        """Inputs of which something could not be read, or nothing."""
        return [entry for entry in self.inputs if entry.faults or entry.state != "done"]


def decode(
    inputs: str | Iterable[str],
    protocol: str | FleetProtocol | Iterable[str | FleetProtocol],
    dataset: str,
    *,
    cluster: Any = None,
    direction: Direction | None = None,
    message: str | Iterable[str] = (),
    columns: Mapping[str, Sequence[str]] | None = None,
    unknown: Unknown = "hide",
    names: bool = False,
    float32: bool = False,
    where: str | Iterable[str] = (),
    filter: str | Iterable[str] = (),
    start: str | None = None,
    stop: str | None = None,
    progress: Callable[[FleetProgress], object] | None = None,
    note: Callable[[str], object] | None = None,
) -> FleetRun:
    """Decode recordings into a Parquet dataset for each message, partitioned by day: `DATASET/Encoder/utc_day=…/….parquet`.

    `inputs` are paths, URIs and patterns of them (`s3://logs/2026/**/*.mf4`). `protocol` is what `load_protocol` takes,
    or a `FleetProtocol` (dialect, configuration, channel); several for recordings of several. `dataset` is a folder or a
    URI; a second run into it decodes what is missing, has changed, or had another recipe.

    `cluster` is "local:4" (processes of this machine), an address of Dask's scheduler ("tls://…", "tcp://…"), a
    `distributed.Client`, or None: this process. `message`, `columns`, `unknown`, `names`, `float32`, `where` and `filter`
    mean what the options of `aces decode` do; `start` and `stop` are `--from` and `--to`, and no times of day. `progress` is
    called when an input is done, `note` with sentences (default: warnings).

    Raises `CallerError` for a wrong call, a dataset or a cluster that cannot be used. What is wrong with an input is in its
    entry.
    """
    load_pyarrow()
    note = note or (lambda text: warnings.warn(text, stacklevel=3))
    given = [protocol] if isinstance(protocol, (str, FleetProtocol)) else list(protocol)
    recipe = Recipe.of(
        given,
        direction=direction,
        message=message,
        columns=columns,
        unknown=unknown,
        names=names,
        float32=float32,
        where=where,
        filter=filter,
        start=start,
        stop=stop,
    )
    if exposed := exposure(cluster):
        note(exposed)
    run = _Run(FleetDataset(dataset), recipe, progress or (lambda _: None))
    run.plan([inputs] if isinstance(inputs, str) else inputs)
    return run.run(cluster)


class _Run:
    def __init__(
        self, dataset: FleetDataset, recipe: Recipe, progress: Callable[[FleetProgress], object]
    ) -> None:
        self.dataset, self.report_progress = dataset, progress
        dataset.check()
        data = recipe.encoded()
        self.recipe, self.key = recipe, Recipe.key_of(data)
        dataset.add_recipe(data, self.key)
        self.known = dataset.manifest()
        self.todo: list[FleetTask] = []
        self.failed: list[FleetInput] = []
        self.results: list[FleetInput] = []
        self.stood = 0
        self._leftovers: dict[str, list[str]] = {}
        #: Files of the journal that the manifest makes unnecessary.
        self._folding: list[str] = []
        self._folded, self._fold_s = time.monotonic(), 0.0
        self._recover()
        #: Tasks by the identity of their futures, which are kept with them.
        self._under_way: dict[int, tuple[Any, FleetTask]] = {}
        self.progress = FleetProgress(0, 0)

    # ------------------------------------------------------------------ before

    def _recover(self) -> None:
        """Take over the inputs that an earlier run left in the journal."""
        journal = self.dataset.journal()
        whole = {entry.uri: entry for entry in journal.values() if entry.state != "placing"}
        for name, entry in journal.items():
            if entry.state != "placing":
                self._keep(entry)
            elif entry.uri in whole:  # pieces of it: what is not in the whole is of an attempt before it
                known = set(whole[entry.uri].outputs)
                self.dataset.remove(output for output in entry.outputs if output not in known)
                self._folding.append(name)
            else:
                self._leftovers.setdefault(entry.uri, []).extend(entry.outputs)

    def plan(self, inputs: Iterable[str]) -> None:
        """Decide which inputs there are, and which are to be decoded."""
        found: dict[str, StoredFile] = {}
        for uri in inputs:
            place = Place(uri)
            try:
                some = list(place.files())
                if not some:
                    raise StoreError(f"{uri}: no such files")
            except StoreError as error:
                self.failed.append(FleetInput(uri=place.uri, recipe=self.key, faults=[str(error)]))
                continue
            found.update((entry.uri, entry) for entry in some)
        for file in found.values():
            before, leftovers = self.known.get(file.uri), self._leftovers.get(file.uri, [])
            if before is not None and not leftovers and before.is_of(file, self.key):
                self.stood += 1
                continue
            self.todo.append(
                FleetTask(
                    dataset=self.dataset.uri,
                    recipe=self.key,
                    uri=file.uri,
                    size=file.size,
                    stamp=file.stamp,
                    before=before,
                    leftovers=leftovers,
                )
            )
        self.todo.sort(
            key=lambda task: (-task.size, task.uri)
        )  # the largest first: none is left alone at the end
        self.progress = FleetProgress(len(self.todo), sum(task.size for task in self.todo), stood=self.stood)

    # ------------------------------------------------------------------ running

    def run(self, cluster: Any) -> FleetRun:
        """Decode what is to be decoded."""
        interrupted = False
        if self.todo:
            workers = open_workers(cluster)
            self.progress.began = time.monotonic()
            try:
                for entry in self._entries(workers):
                    self._done(entry)
            except KeyboardInterrupt:
                interrupted = True
            finally:
                workers.close()
                self._fold()
            if not interrupted:
                self.dataset.sweep()
        elif self._folding:
            self._fold()
        seconds = self.progress.seconds if self.todo else 0.0
        return FleetRun(self.dataset.uri, [*self.failed, *self.results], self.stood, seconds, interrupted)

    def _entries(self, workers: Workers) -> Iterator[FleetInput]:
        """Yield the entries of all tasks, as they get done. What a dying worker took with it is tried once more, alone."""
        share = self.progress.bytes / workers.width
        suspects: list[FleetTask] = []
        again = False
        waiting = iter(self.todo)
        while True:
            while len(self._under_way) < (1 if again else workers.capacity):
                task = next(waiting, None)
                if task is None:
                    break
                self._submit(workers, task, share)
            if not self._under_way:
                if again or not suspects:
                    return
                again, waiting = True, iter(suspects)
                continue
            future = workers.done()
            _, task = self._under_way.pop(id(future))
            try:
                yield msgspec.json.decode(workers.result(future), type=FleetInput)
            except CallerError as error:
                if not isinstance(error, StoreError):
                    raise
                yield self._missing(task, str(error))
            except (
                Exception
            ) as error:  # Dask's: a worker died over it again and again, or the cluster is gone
                kind = type(error).__name__
                if kind in ("CancelledError", "FutureCancelledError", "CommClosedError"):
                    raise CallerError(f"the cluster is gone: {cause_of(error)}") from error
                if kind == "KilledWorker" and not again:
                    suspects.append(task)
                    continue
                words = "its workers died: too little memory?" if kind == "KilledWorker" else cause_of(error)
                yield self._missing(task, f"{task.uri}: {words}")

    def _missing(self, task: FleetTask, fault: str) -> FleetInput:
        return FleetInput(
            uri=task.uri,
            size=task.size,
            stamp=task.stamp,
            recipe=self.key,
            faults=[fault],
            # What the dataset has of it stands: the next attempt takes it away.
            outputs=task.before.outputs if task.before is not None else [],
        )

    def _submit(self, workers: Workers, task: FleetTask, share: float) -> None:
        pieces = self._pieces(task, workers, share) if workers.width > 1 else []
        data = msgspec.json.encode(task)
        if not pieces:
            future = workers.submit(decode_input, data)
        else:
            parts = [msgspec.structs.replace(task, piece=piece) for piece in pieces]
            done = [workers.submit(decode_piece, msgspec.json.encode(part)) for part in parts]
            future = workers.submit(finish_input, data, *done)
        self._under_way[id(future)] = future, task
        workers.watch(future)

    def _pieces(self, task: FleetTask, workers: Workers, share: float) -> list[FleetPiece]:
        """Return the pieces of an input; none where it is decoded as a whole."""
        if task.size <= max(share / SHARE, 2 * SPLIT) or "can" not in self.recipe.links:
            return []
        found = cut_input(task.uri, task.size, min(workers.width * PIECES, -(-task.size // SPLIT)))
        if found is None:
            return []
        spans, began = found
        if spans:
            if len(spans) == 1:
                return []
            return [FleetPiece(number, len(spans), span, began) for number, span in enumerate(spans)]
        # All read all of it: only so many as bring it to its end with the others.
        turns = min(workers.width, TURNS, math.ceil(task.size / share))
        return [FleetPiece(number, turns) for number in range(turns)] if turns > 1 else []

    # ------------------------------------------------------------------ what is done

    def _keep(self, entry: FleetInput) -> None:
        self.known[entry.uri] = entry
        if entry.is_settled:  # else the journal says what an attempt may have placed
            self._folding.append(f"{uri_key(entry.uri)}.json")

    def _done(self, entry: FleetInput) -> None:
        self.results.append(entry)
        self._keep(entry)
        progress = self.progress
        progress.done += 1
        progress.faulty += bool(entry.faults)
        progress.bytes_done += entry.size
        progress.items += entry.counts.get("total", 0)
        if time.monotonic() - self._folded > max(FOLD_S, FOLD_SHARE * self._fold_s):
            self._fold()
        self.report_progress(progress)

    def _fold(self) -> None:
        """Move the entries of the journal into the manifest."""
        began = time.monotonic()
        if self._folding or any(not result.is_settled for result in self.results):
            self.dataset.write_manifest(self.known)
            self.dataset.forget(self._folding)
            self._folding = []
        self._folded = time.monotonic()
        self._fold_s = self._folded - began


def cut_input(uri: str, size: int, pieces: int) -> tuple[list[tuple[int, int]], int | None] | None:
    """Return where a plain candump log can be cut, and the instant of its first frame that has one; no places for
    other recordings of CAN, which can only be read from their start. None for what is none, or cannot be read."""
    try:
        reader = StoreReader(uri)
    except StoreError:
        return None
    try:
        with open_recording(reader, link="can", name=uri) as capture:  # type: ignore[call-overload]
            if not may_be_split(capture):
                return [], None
            known = (table.time[table.time != NO_TIME] for table in capture.tables())
            began = next((int(times[0]) for times in known if len(times)), None)
        return cut_lines(reader.read_at, size, pieces, LEAST), began
    except (CaptureError, StoreError):
        return None  # the worker that decodes it reports why
    finally:
        reader.close()
