"""What every export does: takes tables piece by piece, keeps little, and is there at the end or not at all.

1. `write` keeps copies of values and no table. All pieces that wait together are at most about `BUDGET` bytes.
2. A message's schema is the same in every piece; see `aces_bus.protocol.columns.layout`.
3. `close` puts the export in its place; leaving the `with` block by an exception, or `abandon`, leaves nothing behind.
   One that is live grows in its place, and what was committed stays there.
4. No two datasets have names that differ in case alone: file systems and SQLite may not tell them apart. A name is a file
   name on every system: letters, digits, `_`, `-` and dots, not too long.

A dataset is named like its message; where several protocols have a message of that name, `protocol.Message`. What was
not decoded is `_lost`, and of a second kind of link `_lost.2`.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, ClassVar, Self

from ..errors import CallerError
from ..protocol.columns.arrow import is_absolute
from ..protocol.columns.layout import (
    Block,
    DatasetColumn,
    DatasetLayout,
    Labels,
    Objects,
    concat,
    cut_runs,
    empty_table,
    size_of,
)
from ..protocol.columns.table import MessageTable
from ..protocol.declare.protocol import Variant
from .files import InPlace, Staging, size_on_disk, telling

#: Rows of one message that are written at once: row groups of Parquet are read one at a time.
ROWS = 131_072
#: Bytes of values that wait to be written, over all messages.
BUDGET = 48 << 20


LOST = "_lost"
LONGEST = 120
_ODD = re.compile(r"[^\w.-]", re.ASCII)
#: What Windows takes for devices, whatever the suffix.
_DEVICES = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")


class Naming:
    """Names of datasets, each given once."""

    def __init__(self, variants: Sequence[Variant] = (), *, reserved: Collection[str] = ()) -> None:
        self._owners: dict[str, set[str]] = {}
        for variant in variants:
            for name in variant.messages:
                self._owners.setdefault(name.casefold(), set()).add(variant.name)
        self._taken = {name.casefold() for name in reserved}

    def name(self, protocol: str, message: str) -> str:
        """Return the name for a new dataset."""
        if not message:
            return unique_name(LOST, self._taken)
        owners = self._owners.setdefault(message.casefold(), set())
        owners.add(protocol)
        wanted = safe_name(f"{protocol}.{message}" if len(owners) > 1 else message)
        return unique_name(f"{wanted}_" if wanted.casefold() == LOST else wanted, self._taken)


def unique_name(wanted: str, taken: set[str]) -> str:
    """Return the name, with a number behind it where it is taken already (case does not count); it is taken then."""
    name, number = wanted, 2
    while name.casefold() in taken:
        name = f"{wanted}.{number}"
        number += 1
    taken.add(name.casefold())
    return name


def safe_name(name: str) -> str:
    """Return a name that every file system takes."""
    name = _ODD.sub("_", name)[:LONGEST].strip(".") or "_"
    return f"_{name}" if _DEVICES.fullmatch(name) else name


@dataclass(frozen=True)
class Options:
    """How values are written. `names`: enumerations as texts instead of numbers. `float32`: physical values in half the
    size. `only`: one message, which is then written as a file and not as a folder. `sources`: a column `source` tells
    the captures apart. `live`: it grows in its place, from `commit` to `commit`."""

    names: bool = False
    float32: bool = False
    only: str | None = None
    sources: bool = False
    live: bool = False


@dataclass
class Dataset:
    """One message on its way into an export."""

    name: str
    layout: DatasetLayout
    pieces: list[Block] = field(default_factory=list)
    waiting: int = 0
    size: int = 0
    rows: int = 0


class Datasets:
    """The datasets of a stream of tables, one a message that has occurred: names, layouts, labels.

    `rows` counts what was taken, by dataset. `notes` says in sentences what could not be taken as it is.
    """

    def __init__(self, options: Options, variants: Sequence[Variant]) -> None:
        self.options = options
        self.variants = tuple(variants)
        self.labels, self.sources = Labels(), Labels()
        #: Whether times count from 1970; None while none is known.
        self.absolute: bool | None = None
        self._objects = Objects(variants)
        self._naming = Naming(variants, reserved=self._reserved())
        self._datasets: dict[tuple[str, str], list[Dataset]] = {}

    def _reserved(self) -> Collection[str]:
        """Return names that no dataset may have."""
        return ()

    @property
    def rows(self) -> dict[str, int]:
        """Rows so far, by dataset."""
        return {dataset.name: dataset.rows for dataset in self._all()}

    @property
    def notes(self) -> list[str]:
        """Values that could not be written unchanged, one sentence each."""
        return [
            f"{dataset.name}: {number} values of {name} need more than 64 bits and are left empty"
            for dataset in self._all()
            for name, number in dataset.layout.too_wide.items()
        ]

    def plain(self, slot: DatasetColumn, values: Any, absent: Any) -> list[Any]:
        """Return the values of a column of a block: labels as texts, None where there is none."""
        plain: list[Any] = values.tolist()
        if slot.holds == "label":
            names = self.sources.names if slot.role == "source" else self.labels.names
            return [None if code < 0 else names[code] for code in plain]
        if absent is not None:
            plain = [None if gone else value for value, gone in zip(plain, absent.tolist(), strict=True)]
        return plain

    def _all(self) -> list[Dataset]:
        return [dataset for some in self._datasets.values() for dataset in some]

    def see_times(self, tables: Sequence[MessageTable]) -> None:
        """Learn of the first tables whether times count from 1970."""
        for table in tables:
            if self.absolute is None:
                self.absolute = is_absolute(table.time)

    def dataset(self, table: MessageTable, columns: Mapping[str, list[str]]) -> Dataset:
        """Return the dataset of a table, begun where there is none; `columns` as of `Export.write`."""
        some = self._datasets.setdefault((table.protocol, table.message), [])
        for dataset in some:
            if dataset.layout.fits(table):
                return dataset
        layout = DatasetLayout.of(
            table,
            self._objects.of(table),
            columns=columns.get(table.message),
            float32=self.options.float32,
            with_source=self.options.sources,
        )
        made = Dataset(self._naming.name(table.protocol, table.message), layout)
        some.append(made)
        self._begin(made)
        return made

    def _begin(self, dataset: Dataset) -> None:
        """Begin the dataset of a message that occurs for the first time; by default do nothing."""


class Export(Datasets, ABC):
    """Tables on their way into a file or folder; made by `open_export`.

        with open_export("walk.parquet", variants=[hubo.variant()]) as export:
            for frames in capture.tables():
                export.write(scanner.feed(frames))
            export.write(scanner.close())

    `rows` counts what was written, by dataset. `notes` says in sentences what could not be written as it is.
    """

    #: What the format is called, and whether it is a folder of datasets unless a single message is wanted.
    format: ClassVar[str]
    is_folder: ClassVar[bool] = False
    #: How names of datasets are compared: SQLite and many file systems do not distinguish upper from lower case.
    suffix: ClassVar[str] = ""

    def __init__(self, path: str, options: Options, variants: Sequence[Variant]) -> None:
        super().__init__(options, variants)
        self.path = path
        self._is_closed = False
        self.makes_folder = self.is_folder and options.only is None
        suffix = self.suffix
        self._staging: Staging | InPlace
        if options.live:
            self._staging = InPlace(path, is_folder=self.is_folder)
        else:
            self._staging = Staging(
                path,
                is_folder=self.makes_folder,
                is_ours=(lambda name: name.endswith(suffix)) if self.is_folder else None,
            )

    @property
    def place(self) -> str:
        """Path to write to; `close` gives it the export's name."""
        return self._staging.temporary

    def write(
        self,
        tables: Sequence[MessageTable],
        *,
        source: str | None = None,
        columns: dict[str, list[str]] | None = None,
    ) -> None:
        """Take the tables of a piece of a capture. `source` names the capture where `Options.sources` wants it;
        `columns` limits messages to some of their fields (and must not change between calls).

        Raises `CallerError` when the file cannot be written.
        """
        if self._is_closed:
            raise CallerError(f"{self.path}: this export is closed")
        tables = [table for table in tables if len(table)]
        self.see_times(tables)
        with telling(self.path):
            self._write(tables, source, columns or {})

    def commit(self) -> None:
        """Hand everything written to the system, in a live export: a program that is killed afterwards loses
        none of it. Raises `CallerError` when the file cannot be written.
        """
        if isinstance(self._staging, InPlace) and not self._is_closed:
            self._staging.is_kept = True
            with telling(self.path):
                self._commit()

    @property
    def size(self) -> int:
        """Bytes on the disk so far."""
        return size_on_disk(self.place)

    def close(self) -> None:
        """Write what waits, and put the export in its place. A single message that did not occur is a file without rows.

        Raises `CallerError` when that fails; nothing is left behind then.
        """
        if self._is_closed:
            return
        try:
            with telling(self.path):
                if self.options.only is not None and not self._datasets:
                    for variant in self.variants:
                        if self.options.only in variant.messages:
                            self.dataset(empty_table(variant, self.options.only), {})
                            break
                self._finish()
            self._is_closed = True
            self._staging.commit()
        except BaseException:
            self._is_closed = False
            self.abandon()
            raise

    def abandon(self) -> None:
        """Remove what was written; what was at the path before is still there."""
        if not self._is_closed:
            self._is_closed = True
            try:
                self._drop()
            finally:
                self._staging.discard()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    # What a format does.

    @abstractmethod
    def _write(
        self, tables: Sequence[MessageTable], source: str | None, columns: dict[str, list[str]]
    ) -> None:
        """Take tables, none of them empty."""

    def _commit(self) -> None:
        """Hand what waits to the system."""
        raise CallerError(f"{self.path}: {self.format} has its index at its end, and does not grow")

    @abstractmethod
    def _finish(self) -> None:
        """Write what waits, and all that is at a file's end."""

    @abstractmethod
    def _drop(self) -> None:
        """Close whatever is open. Must not raise."""


class Buffered(Export):
    """An export in which each message gathers rows, and writes some at once."""

    rows_at_once = ROWS
    budget = BUDGET

    def __init__(self, path: str, options: Options, variants: Sequence[Variant]) -> None:
        super().__init__(path, options, variants)
        self._size = 0

    @property
    def waiting(self) -> int:
        """About the bytes that wait to be written."""
        return self._size

    def _write(
        self, tables: Sequence[MessageTable], source: str | None, columns: dict[str, list[str]]
    ) -> None:
        for table in tables:
            dataset = self.dataset(table, columns)
            block = dataset.layout.block(table, self.labels, self.sources, source)
            size = size_of(block)
            dataset.pieces.append(block)
            dataset.waiting += len(table)
            dataset.rows += len(table)
            dataset.size += size
            self._size += size
            if dataset.waiting >= self.rows_at_once:
                self._flush(dataset)
        if self._size > self.budget:
            # The largest until half is free: many small flushes would give many small row groups.
            for dataset in sorted(self._all(), key=lambda largest: largest.size, reverse=True):
                if self._size <= self.budget // 2:
                    break
                self._flush(dataset)

    def _commit(self) -> None:
        for dataset in self._all():
            self._flush(dataset)

    def _flush(self, dataset: Dataset) -> None:
        if not dataset.waiting:
            return
        block, rows = concat(dataset.pieces), dataset.waiting
        self._size -= dataset.size
        dataset.pieces, dataset.waiting, dataset.size = [], 0, 0
        for start in range(0, rows, self.rows_at_once):
            whole = rows <= self.rows_at_once
            self._emit(dataset, block if whole else cut_runs(block, start, start + self.rows_at_once))

    def _finish(self) -> None:
        for dataset in self._all():
            self._flush(dataset)
            self._end(dataset)

    @abstractmethod
    def _emit(self, dataset: Dataset, block: Block) -> None:
        """Write rows of a message."""

    @abstractmethod
    def _end(self, dataset: Dataset) -> None:
        """End the rows of a message; none may have come at all."""
