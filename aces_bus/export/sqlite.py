"""SQLite: one table a message, and the tables `_messages` and `_columns` that say what is in them.

1. Every foreign name is quoted; no value is ever part of a statement.
2. An export is written without a journal: it has another name until it is whole. What must survive a kill is written with
   one: a live export, `JournaledDatabase`.

    time_ns    INTEGER: ns since 1970, or as the recording counts (`_messages.time` says which); NULL unknown.
               `datetime(time_ns / 1000000000, 'unixepoch')` is a date
    integers   INTEGER; what 64 signed bits do not hold is TEXT, its decimal digits
    NaN        NULL, as SQLite has none; `_columns` cannot tell it from an absent value
    bytes      BLOB; enumerations are numbers, or with `names` their names
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Collection, Generator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from ..errors import CallerError
from ..protocol.columns.arrow import GrowingDictionary, field_metadata, schema_metadata
from ..protocol.columns.layout import Block, DatasetColumn
from ..protocol.declare.protocol import Variant
from .base import Buffered, Dataset, Options, unique_name
from .files import telling

#: Columns of a table and of a statement, as SQLite is usually built.
MOST = 2000
TRANSACTION = 200_000

_TABLES = """
CREATE TABLE "_messages" ("table" TEXT PRIMARY KEY, "protocol" TEXT, "message" TEXT, "direction" TEXT, "doc" TEXT,
  "time" TEXT, "aces_bus" TEXT, "rows" INTEGER) WITHOUT ROWID;
CREATE TABLE "_columns" ("table" TEXT, "column" TEXT, "path" TEXT, "unit" TEXT, "doc" TEXT, "names" TEXT, "flags" TEXT,
  "holds" TEXT, PRIMARY KEY ("table", "column")) WITHOUT ROWID;
"""


class SqliteExport(Buffered):
    """`walk.sqlite`."""

    format = "SQLite"
    suffix = ".sqlite"
    rows_at_once = 1 << 16

    def __init__(self, path: str, options: Options, variants: Sequence[Variant]) -> None:
        super().__init__(path, options, variants)
        self._pending = 0
        self._inserts: dict[str, str] = {}
        self._enumerations: dict[str, dict[str, GrowingDictionary]] = {}
        #: Rows that `_messages` says of a table.
        self._stated: dict[str, int] = {}
        try:
            with telling(path):
                self._base = sqlite3.connect(self.place, isolation_level=None)
                # In WAL mode a commit waits for no disk, and survives the program.
                safety = "PRAGMA journal_mode=WAL; PRAGMA synchronous=NORMAL;"
                if not options.live:
                    safety = "PRAGMA journal_mode=OFF; PRAGMA synchronous=OFF; PRAGMA locking_mode=EXCLUSIVE;"
                self._base.executescript(safety + _TABLES)
                self._base.execute("BEGIN")
        except CallerError:
            self.abandon()
            raise

    def _reserved(self) -> Collection[str]:
        return ("_messages", "_columns")

    def _begin(self, dataset: Dataset) -> None:
        slots = dataset.layout.slots
        if len(slots) > MOST:
            raise CallerError(
                f"{self.path}: {dataset.name} has {len(slots)} columns, and SQLite takes {MOST}; write Parquet instead"
            )
        names = _column_names(slots)
        if self.options.names:
            self._enumerations[dataset.name] = {
                slot.name: GrowingDictionary(slot.kind.names)
                for slot in slots
                if slot.holds == "number" and slot.kind is not None and slot.kind.names is not None
            }
        known = self._enumerations.get(dataset.name, {})
        columns = ", ".join(
            f"{sql_name(name)} {'TEXT' if slot.name in known else _type(slot)}"
            for name, slot in zip(names, slots, strict=True)
        )
        self._base.execute(f"CREATE TABLE {sql_name(_table(dataset))} ({columns})")
        self._base.executemany(
            'INSERT INTO "_columns" VALUES (?, ?, ?, ?, ?, ?, ?, ?)',
            [self._about(dataset, name, slot) for name, slot in zip(names, slots, strict=True)],
        )
        self._inserts[dataset.name] = (
            f"INSERT INTO {sql_name(_table(dataset))} VALUES ({', '.join('?' * len(slots))})"
        )

    @staticmethod
    def _about(dataset: Dataset, name: str, slot: DatasetColumn) -> tuple[str | None, ...]:
        known = field_metadata(slot)
        path = slot.kind.name if slot.kind is not None else None
        return (_table(dataset), name, path, *map(known.get, ("unit", "doc", "names", "flags", "holds")))

    def _emit(self, dataset: Dataset, block: Block) -> None:
        known = self._enumerations.get(dataset.name, {})
        columns = [
            self._cells(slot, values, absent, known.get(slot.name))
            for slot, (values, absent) in zip(dataset.layout.slots, block, strict=True)
        ]
        self._base.executemany(self._inserts[dataset.name], zip(*columns, strict=True))
        self._pending += len(block[0].values)
        if self._pending >= TRANSACTION and not self.options.live:
            self._base.execute("COMMIT")
            self._base.execute("BEGIN")
            self._pending = 0

    def _commit(self) -> None:
        super()._commit()
        for dataset in self._all():
            if self._stated.get(dataset.name) != dataset.rows:
                self._end(dataset)
        self._base.execute("COMMIT")
        self._base.execute("BEGIN")

    def _cells(
        self, slot: DatasetColumn, values: Any, absent: Any, names: GrowingDictionary | None
    ) -> list[Any]:
        if names is not None:
            values = np.array(names.labels.names, object)[names.codes(values)]
        plain = self.plain(slot, values, absent)
        if names is None and values.dtype.kind == "u" and values.dtype.itemsize == 8:
            plain = [str(value) if value is not None and value >= 1 << 63 else value for value in plain]
        return plain

    def _end(self, dataset: Dataset) -> None:
        known = schema_metadata(dataset.layout, absolute=bool(self.absolute))
        about = [known.get(name) for name in ("protocol", "message", "direction", "doc", "time", "aces_bus")]
        self._base.execute(
            'INSERT OR REPLACE INTO "_messages" VALUES (?, ?, ?, ?, ?, ?, ?, ?)',
            (_table(dataset), *about, dataset.rows),
        )
        self._stated[dataset.name] = dataset.rows

    def _finish(self) -> None:
        super()._finish()
        self._base.execute("COMMIT")
        if self.options.live:
            _leave_wal(self._base)
        self._base.close()

    def _drop(self) -> None:
        if (base := getattr(self, "_base", None)) is not None:
            with suppress(sqlite3.Error):
                base.close()


class JournaledDatabase:
    """A database with a write-ahead log: what a transaction wrote survives a kill. After `close` there is one file.

    Raises `sqlite3.Error` and `OSError`. Replaces what is at `path`.
    """

    def __init__(self, path: str) -> None:
        for end in ("", "-wal", "-shm", "-journal"):
            if os.path.isfile(path + end):
                os.remove(path + end)
        self._database = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        self._database.execute("PRAGMA journal_mode = WAL")
        # In WAL mode a commit then waits for no disk; `sync` does.
        self._database.execute("PRAGMA synchronous = NORMAL")

    @contextmanager
    def transaction(self) -> Generator[sqlite3.Connection]:
        """Yield the database; commit everything that is done within, or nothing."""
        self._database.execute("BEGIN IMMEDIATE")
        try:
            yield self._database
            self._database.execute("COMMIT")
        except BaseException:
            if self._database.in_transaction:
                with suppress(sqlite3.Error):  # SQLite may have rolled back by itself
                    self._database.execute("ROLLBACK")
            raise

    def sync(self) -> None:
        """Bring it to the disk, as far as readers allow."""
        self._database.execute("PRAGMA wal_checkpoint(PASSIVE)")

    def close(self) -> None:
        """Put everything into one file."""
        try:
            _leave_wal(self._database)
        finally:
            self._database.close()


def _leave_wal(database: sqlite3.Connection) -> None:
    """Put everything into one file; who still reads it keeps the second one for as long."""
    database.execute("PRAGMA busy_timeout = 0")
    with suppress(sqlite3.OperationalError):
        database.execute("PRAGMA journal_mode = DELETE").fetchall()


def _table(dataset: Dataset) -> str:
    """Return a table's name; SQLite keeps names that begin with `sqlite_` for itself."""
    name = dataset.name
    return f"_{name}" if name.casefold().startswith("sqlite_") else name


def _column_names(slots: Sequence[DatasetColumn]) -> list[str]:
    """Return names of columns, which SQLite compares without case."""
    taken: set[str] = set()
    return [unique_name("time_ns" if slot.role == "time" else slot.name, taken) for slot in slots]


def sql_name(name: str) -> str:
    """Return a name as SQL has it."""
    return '"' + name.replace('"', '""').replace("\0", "") + '"'


def _type(slot: DatasetColumn) -> str:
    if slot.holds == "bytes":
        return "BLOB"
    if slot.holds in ("label", "text", "wide", "json"):
        return "TEXT"
    if slot.holds in ("time", "bool", "integer"):
        return "INTEGER"
    # A column without affinity keeps the digits of large integers as text.
    return "REAL" if slot.dtype.kind == "f" else "" if slot.dtype == "u8" else "INTEGER"
