"""Logs as SQLite, read back.

1. The database is untrusted: nothing in it is run (no view, no trigger, no trusted schema), and values, rows and work
   without a row are bounded.
2. A write-ahead log left by a writer that was killed, or by one that still writes, is read with it.
"""

from __future__ import annotations

import os
import sqlite3
from array import array
from contextlib import closing
from typing import Any
from urllib.parse import quote

import numpy as np

from .base import About, about_of
from .columns import MOST_COLUMNS
from .sqlite import sql_name
from .table import MOST_NUMBERS, Log, LogError, made_log, named_columns

_ROWS = 1024
_STEPS_A_CALL = 100_000
#: Steps of SQLite's machine for a batch: a row of 2,000 columns takes some 4,000.
_STEPS = 50_000_000
_VALUE_BYTES = 1 << 22


class _Reader:
    def __init__(self, path: str) -> None:
        self.path, self.steps = path, 0
        # Without a journal nobody writes, and the file need not be locked: its folder may be read-only.
        is_quiet = not any(os.path.exists(path + end) for end in ("-wal", "-journal"))
        where = f"file:{quote(os.path.abspath(path))}?mode=ro{'&immutable=1' if is_quiet else ''}"
        self.database = sqlite3.connect(where, uri=True, isolation_level=None)
        for limit, value in (
            (sqlite3.SQLITE_LIMIT_LENGTH, _VALUE_BYTES),
            (sqlite3.SQLITE_LIMIT_ATTACHED, 0),
            (sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH, 1),
            (sqlite3.SQLITE_LIMIT_WORKER_THREADS, 0),
        ):
            self.database.setlimit(limit, value)
        self.database.set_progress_handler(self._is_stuck, _STEPS_A_CALL)
        self.database.execute("PRAGMA trusted_schema = OFF")
        self.database.execute("PRAGMA query_only = ON")

    def _is_stuck(self) -> bool:
        self.steps += _STEPS_A_CALL
        return self.steps > _STEPS

    def rows(self, query: str, most: int) -> list[tuple[Any, ...]]:
        """Up to `most` rows."""
        self.steps = 0
        return self.database.execute(query).fetchmany(most)


def read_sqlite_log(path: str, *, most_numbers: int = MOST_NUMBERS) -> Log:
    """Read the table `log` of a database."""
    try:
        reader = _Reader(path)
        with closing(reader.database):
            return _read(reader, path, most_numbers)
    except sqlite3.Error as error:
        raise LogError(f"{path}: an SQLite file that cannot be read: {error}") from None


def _read(reader: _Reader, path: str, most_numbers: int) -> Log:
    # A virtual table has no pages of its own.
    tables = reader.rows(
        "SELECT name FROM sqlite_schema WHERE type = 'table' AND rootpage > 0 AND name IN ('log', 'about')",
        10,
    )
    if ("log",) not in tables:
        raise LogError(f"{path}: an SQLite file without a table `log`: no log")
    # `hidden` is not 0 for columns that are computed, which nobody of ours makes.
    found = reader.rows("PRAGMA table_xinfo(log)", MOST_COLUMNS + 2)
    if any(row[6] for row in found) or not found or found[0][1] != "time" or len(found) < 2:
        raise LogError(f"{path}: its table `log` does not begin with `time`, or computes: no log")
    if len(found) > MOST_COLUMNS + 1:
        raise LogError(f"{path}: more than {MOST_COLUMNS} columns")
    about: About | None = None
    if ("about",) in tables:
        told = reader.rows("SELECT value FROM about WHERE key = 'json' AND typeof(value) = 'text'", 1)
        about = about_of(told[0][0]) if told else None
    names = [str(row[1]) for row in found[1:]]
    if about is None or about.names != names:
        about = About(named_columns(path, names))
    numbers = array("d")
    width = len(found)
    listed = ", ".join(map(sql_name, ["time", *names]))
    reader.steps = 0
    cursor = reader.database.execute(f"SELECT {listed} FROM log ORDER BY rowid")
    row = 0
    while rows := cursor.fetchmany(_ROWS):
        reader.steps = 0
        for values in rows:
            row += 1
            try:
                numbers.extend([float("nan") if value is None else value for value in values])
            except (TypeError, OverflowError):
                raise LogError(f"{path}: row {row} of the table `log` holds what is no number") from None
        if len(numbers) > most_numbers:
            raise LogError(f"{path}: more than {most_numbers} numbers; read it with SQLite, in parts")
    table = np.array(numbers, np.float64).reshape(-1, width)
    return made_log(path, "sqlite", about, table, [])
