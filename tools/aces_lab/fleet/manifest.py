"""What a dataset consists of: for each input what was read, counted and written, and what was wrong.

    lake/truck/Encoder/utc_day=2026-11-23/4f2c….parquet     parts; named by URI, contents, recipe
    lake/truck/_fleet/manifest.parquet                      a row an input
    lake/truck/_fleet/journal/4f2c….json                    inputs that came to it since
    lake/truck/_fleet/recipes/81ab….json                    what they were decoded with

1. Before the first part of an input has its name, the journal lists all of them; behind the last one it says that they are
   whole. What an attempt that died has left, the next one knows, and takes away.
2. The journal's entries go into the manifest, and leave the journal only then.
3. One run at a time writes a dataset; readers may come at any time.
4. A dataset may come from a stranger: a name in its manifest or journal that is not a part of its own input, and a link that
   leads out of its folder, are refused before anything is removed.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Iterable, Iterator
from types import ModuleType
from typing import Any, Literal

import msgspec

from aces_bus.errors import CallerError
from aces_bus.protocol.record import PlainValue
from aces_bus.recordings.base import Link
from aces_bus.version import __version__
from aces_tools.reading.totals import Totals

from .stores import Place, StoredFile, StoreError, patiently

InputState = Literal["placing", "done", "unreadable", "missing"]

FLEET = "_fleet"


class FleetInput(msgspec.Struct, kw_only=True, omit_defaults=True):
    """An input of a dataset: what it was, what it gave.

    `state`: "done" (decoded; `faults` says of what could not be read of it), "unreadable" (no recording: tried again when it
    changes), "missing" (the store or the worker failed: tried again by the next run), "placing" (an attempt was cut off).
    """

    uri: str
    #: Bytes as they are stored, and what the store says of their version.
    size: int = 0
    stamp: str = ""
    #: BLAKE2b of the contents; of an input that was split, of its pieces' hashes.
    hash: str = ""
    recipe: str = ""
    state: InputState = "missing"
    link: Link | None = None
    format: str = ""
    #: Frames (CAN) or bytes by bin; `total` is their sum.
    counts: dict[str, int] = {}
    lines_unreadable: int = 0
    missed: int = 0
    dropped: int = 0
    #: Rows by message.
    rows: dict[str, int] = {}
    #: Instants (ns) of the first and the last decoded message, as the recording counts them.
    first: int | None = None
    last: int | None = None
    faults: list[str] = []
    notes: list[str] = []
    #: Parts, below the dataset.
    outputs: list[str] = []
    #: Seconds that a worker took.
    seconds: float = 0.0
    #: Of aces-bus.
    version: str = __version__

    @property
    def duration_s(self) -> float | None:
        """From the first to the last decoded message; None where times are not known."""
        return None if self.first is None or self.last is None else (self.last - self.first) / 1e9

    @property
    def totals(self) -> Totals:
        """The bins."""
        return Totals(dict(self.counts), self.lines_unreadable, self.missed, self.dropped)

    @property
    def is_settled(self) -> bool:
        """True if only another content or another recipe can change the outcome."""
        return self.state in ("done", "unreadable")

    def is_of(self, file: StoredFile, recipe: str) -> bool:
        """Return whether the input is known to be the one that was decoded: only where the store says something of
        versions.
        """
        return (
            self.is_settled
            and self.recipe == recipe
            and self.size == file.size
            and self.stamp == file.stamp != ""
        )


def uri_key(uri: str) -> str:
    """Return what the parts of an input are named after."""
    return hashlib.blake2b(uri.encode("utf-8", "surrogateescape"), digest_size=10).hexdigest()


class FleetDataset:
    """The folder of a run: parts, manifest, journal. Raises `CallerError` for a folder that holds something else."""

    def __init__(self, uri: str) -> None:
        self.place = Place(uri)
        self.uri = self.place.uri.rstrip("/")

    def path(self, *names: str) -> str:
        """Return a path below the dataset."""
        return self.place.join(*names)

    def check(self) -> None:
        """Raise `CallerError` unless the dataset is one, or nothing yet."""
        names = self.place.names(self.place.path)
        if names and FLEET not in names:
            raise CallerError(f"{self.uri}: holds other files ({sorted(names)[0]}); choose another folder")
        for name in ("work", "journal", "recipes"):
            self._check_inside(self.path(FLEET, name, ""))

    def _check_inside(self, path: str) -> None:
        """Raise `StoreError` where links lead from the dataset to a file elsewhere on this machine."""
        if not self.place.is_local:
            return
        root, folder = os.path.realpath(self.place.path), os.path.realpath(os.path.dirname(path))
        if os.path.commonpath([root, folder]) != root:
            raise StoreError(f"{path}: a link leads out of the dataset to {folder}; remove the link")

    # ------------------------------------------------------------------ recipes

    def add_recipe(self, data: bytes, key: str) -> None:
        """Put a recipe beside the parts."""
        path = self.path(FLEET, "recipes", f"{key}.json")
        if not self.place.exists(path):
            self.place.write(path, data)

    def recipe(self, key: str) -> bytes:
        """Return a recipe as it lies there."""
        return self.place.read(self.path(FLEET, "recipes", f"{key}.json"))

    # ------------------------------------------------------------------ the journal

    def note(self, entry: FleetInput, piece: str = "") -> None:
        """Write an input's entry of the journal; of a piece of one, beside that."""
        self.place.write(self._journal(entry.uri, piece), msgspec.json.encode(entry))

    def noted(self, uri: str, piece: str = "") -> FleetInput | None:
        """Return an input's entry of the journal, if there is one."""
        path = self._journal(uri, piece)
        if not self.place.exists(path):
            return None
        return _entry(self.place.read(path), self.place.uri_of(path))

    def _journal(self, uri: str, piece: str = "") -> str:
        return self.path(FLEET, "journal", f"{uri_key(uri)}{piece}.json")

    def journal(self) -> dict[str, FleetInput]:
        """Return the entries of the journal by their file names."""
        folder = self.path(FLEET, "journal")
        found: dict[str, FleetInput] = {}
        for name in self.place.names(folder):
            if not name.startswith(".") and name.endswith(".json"):
                found[name] = _entry(
                    self.place.read(f"{folder}/{name}"), f"{self.uri}/{FLEET}/journal/{name}"
                )
        return found

    def forget(self, names: Iterable[str]) -> None:
        """Remove entries of the journal."""
        for name in names:
            self.place.remove(self.path(FLEET, "journal", name))

    def remove(self, outputs: Iterable[str]) -> None:
        """Remove parts."""
        for name in outputs:
            self._check_inside(self.path(name))
            self.place.remove(self.path(name))

    # ------------------------------------------------------------------ the manifest

    def manifest(self) -> dict[str, FleetInput]:
        """Return all inputs that the manifest has, by URI; raises `StoreError` where it cannot be read."""
        path = self.path(FLEET, "manifest.parquet")
        if not self.place.exists(path):
            return {}
        data = self.place.read(path)
        from pyarrow import parquet

        try:
            rows = parquet.read_table(io.BytesIO(data)).to_pylist()
            entries = [msgspec.convert({**row, **_opened(row)}, FleetInput) for row in rows]
        except Exception as error:  # pyarrow's own, a column that is not there
            raise StoreError(f"{self.uri}/{FLEET}/manifest.parquet: cannot be read: {error}") from error
        for entry in entries:
            _check_outputs(entry, f"{self.uri}/{FLEET}/manifest.parquet")
        return {entry.uri: entry for entry in entries}

    def write_manifest(self, entries: dict[str, FleetInput]) -> None:
        """Write the whole manifest anew."""
        import pyarrow as pa
        from pyarrow import parquet

        rows = [{**msgspec.structs.asdict(entry), **_closed(entry)} for _, entry in sorted(entries.items())]
        sink = io.BytesIO()
        parquet.write_table(pa.Table.from_pylist(rows, _schema(pa)), sink, compression="zstd")
        self.place.write(self.path(FLEET, "manifest.parquet"), sink.getvalue())

    def folders(self) -> Iterator[str]:
        """Yield the names of the datasets of messages."""
        for name in sorted(self.place.names(self.place.path)):
            if name != FLEET and not name.startswith("."):
                yield name

    def sweep(self) -> None:
        """Take away what killed workers have left of their work; only while none works."""
        if self.place.is_local:
            path = self.path(FLEET, "work")

            def remove() -> None:
                try:
                    if self.place.exists(path):
                        self.place.fs.rm(path, recursive=True)
                except FileNotFoundError:  # a worker that is just ending has taken away its own: once more
                    raise OSError("its files are being taken away") from None

            patiently(self.uri, remove)


def _entry(data: bytes, name: str) -> FleetInput:
    try:
        entry = msgspec.json.decode(data, type=FleetInput)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise StoreError(f"{name}: cannot be read: {error}") from error
    _check_outputs(entry, name)
    return entry


def _check_outputs(entry: FleetInput, file: str) -> None:
    """Raise `StoreError` unless every output is a part that a run can have placed for this input."""
    for name in entry.outputs:
        *folders, part = name.split("/")
        is_part = part.startswith(f"{uri_key(entry.uri)}-") and part.endswith(".parquet")
        if not (is_part and folders) or {"", ".", "..", FLEET} & set(folders) or set("\\:\0") & set(name):
            raise StoreError(
                f"{file}: names {name!r} as a part of {entry.uri}, which no run can have placed; nothing was"
                " removed: decode into another folder"
            )


#: Columns of the manifest that are JSON texts: their names hang on the protocol.
_MAPS = ("counts", "rows")


def _closed(entry: FleetInput) -> dict[str, str]:
    return {name: msgspec.json.encode(getattr(entry, name)).decode() for name in _MAPS}


def _opened(row: dict[str, Any]) -> dict[str, PlainValue]:
    return {name: msgspec.json.decode(row[name], type=dict[str, int]) for name in _MAPS}


def _schema(pa: ModuleType) -> Any:
    kinds = {
        "size": pa.int64(),
        "lines_unreadable": pa.int64(),
        "missed": pa.int64(),
        "dropped": pa.int64(),
        "first": pa.int64(),
        "last": pa.int64(),
        "seconds": pa.float64(),
        "faults": pa.list_(pa.string()),
        "notes": pa.list_(pa.string()),
        "outputs": pa.list_(pa.string()),
    }
    return pa.schema([(name, kinds.get(name, pa.string())) for name in FleetInput.__struct_fields__])


def joined_totals(entries: Iterable[FleetInput]) -> dict[Link, Totals]:
    """Return the bins of all inputs together, by link."""
    found: dict[Link, Totals] = {}
    for entry in entries:
        if entry.link is not None:
            found.setdefault(entry.link, Totals()).join(entry.totals)
    return found
