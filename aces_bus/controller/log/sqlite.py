"""Logs as SQLite: a table `log`, and what it is about in `columns` and `about`.

1. Rows go in by transactions, into the write-ahead log: a process that is killed loses none that was committed, and whoever
   opens the database next finds them. When the log is closed there is one file.
2. A database that is read is not trusted: nothing in it is run (no view, no trigger, no trusted schema), and values, rows
   and work without a row are bounded. The write-ahead log of a writer that was killed, or that still writes, is read too.

`log(time REAL, "RHY" REAL, "RHY(rate)" REAL, …)`: seconds since the start, and NULL for unknown. `columns(place, name,
state, attribute, unit)`, `about(key, value)`: robot, rate_hz, clock, start_ns, wall_ns (ns since 1970), and all of it as
JSON.
"""

from __future__ import annotations

import sqlite3
from array import array
from collections.abc import Sequence
from contextlib import closing

import numpy as np

from ...export.sqlite import JournaledDatabase, sql_name
from ...recordings.sqlite import UntrustedDatabase
from .base import About, Log, LogError, LogSink, Row, about_columns
from .columns import MOST_COLUMNS

_ROWS = 1024
#: Steps of SQLite's machine for a batch: a row of 2,000 columns takes some 4,000.
_STEPS = 50_000_000
_VALUE_BYTES = 1 << 22


class SqliteSink(LogSink):
    """`walk.db`."""

    def __init__(self, path: str, about: About) -> None:
        super().__init__(path, about)
        self._file: JournaledDatabase = JournaledDatabase(path)
        columns = "".join(f", {sql_name(name)} REAL" for name in about.names)
        place = "place INTEGER PRIMARY KEY, name TEXT, state TEXT, attribute TEXT, unit TEXT"
        known = {name: getattr(about, name) for name in ("robot", "rate_hz", "clock", "start_ns", "wall_ns")}
        with self._file.transaction() as database:
            database.execute(f"CREATE TABLE log (time REAL NOT NULL{columns})")
            database.execute(f"CREATE TABLE columns ({place})")
            database.execute("CREATE TABLE about (key TEXT PRIMARY KEY, value)")
            database.executemany(
                "INSERT INTO columns VALUES (?, ?, ?, ?, ?)",
                [(i, c.name, c.state, c.attribute, c.unit) for i, c in enumerate(about.columns, 1)],
            )
            database.executemany(
                "INSERT INTO about VALUES (?, ?)", [*known.items(), ("json", about.to_json())]
            )
        self._insert = f"INSERT INTO log VALUES ({', '.join('?' * (1 + len(about.columns)))})"

    def append(self, rows: Sequence[Row]) -> None:
        """Write one transaction."""
        with self._file.transaction() as database:
            # SQLite keeps NaN as NULL, which is what unknown is.
            database.executemany(self._insert, [(ns / 1e9, *values) for ns, values in rows])


def read_sqlite_log(path: str, most_numbers: int) -> Log:
    """Read the table `log` of a database."""
    try:
        source = UntrustedDatabase(path, _STEPS, _VALUE_BYTES)
        with closing(source.database):
            source.protect("trusted_schema = OFF", "query_only = ON")
            return _read(source, path, most_numbers)
    except sqlite3.Error as error:
        raise LogError(f"{path}: an SQLite file that cannot be read: {error}") from None


def _read(source: UntrustedDatabase, path: str, most_numbers: int) -> Log:
    # A virtual table has no pages of its own.
    tables = source.rows(
        "SELECT name FROM sqlite_schema WHERE type = 'table' AND rootpage > 0 AND name IN ('log', 'about')",
        10,
    )
    if ("log",) not in tables:
        raise LogError(f"{path}: an SQLite file without a table `log`: no log")
    # `hidden` is not 0 for columns that are computed, which no logger makes.
    found = source.rows("PRAGMA table_xinfo(log)", MOST_COLUMNS + 2)
    if any(row[6] for row in found) or not found or found[0][1] != "time" or len(found) < 2:
        raise LogError(f"{path}: its table `log` does not begin with `time`, or computes: no log")
    if len(found) > MOST_COLUMNS + 1:
        raise LogError(f"{path}: more than {MOST_COLUMNS} columns")
    query = "SELECT value FROM about WHERE key = 'json' AND typeof(value) = 'text'"
    said = source.rows(query, 1) if ("about",) in tables else []
    names = [str(row[1]) for row in found]
    about = about_columns(path, said[0][0] if said else "", names[1:])
    numbers = array("d")
    row = 0
    for rows in source.batches(f"SELECT {', '.join(map(sql_name, names))} FROM log ORDER BY rowid", _ROWS):
        for values in rows:
            row += 1
            try:
                numbers.extend([np.nan if value is None else value for value in values])
            except (TypeError, OverflowError):
                raise LogError(f"{path}: row {row} of the table `log` holds what is not a number") from None
        if len(numbers) > most_numbers:
            raise LogError(f"{path}: more than {most_numbers} numbers; read it with SQLite, in parts")
    table = np.array(numbers, np.float64).reshape(-1, len(names))
    return Log.of_table(path, "sqlite", about, table, [])
