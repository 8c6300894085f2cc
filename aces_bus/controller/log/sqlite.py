"""Logs as SQLite: a table `log`, and what it is about in `columns` and `about`.

1. Rows go in by transactions, into the write-ahead log: a process that is killed loses none that was committed, and whoever
   opens the database next finds them.
2. When the log is closed there is one file, without a write-ahead log beside it.

`log(time REAL, "RHY" REAL, "RHY(rate)" REAL, …)`: seconds since the start, and NULL for unknown. `columns(place, name,
state, attribute, unit)`, `about(key, value)`: robot, rate_hz, clock, start_ns, wall_ns (ns since 1970), and all of it as
JSON.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Sequence

from .base import About, LogSink, Row


def sql_name(name: str) -> str:
    """A name in SQL."""
    return '"' + name.replace('"', '""') + '"'


class SqliteSink(LogSink):
    """`walk.db`."""

    format = "sqlite"

    def __init__(self, path: str, about: About) -> None:
        super().__init__(path, about)
        for end in ("", "-wal", "-shm", "-journal"):
            if os.path.isfile(path + end):
                os.remove(path + end)
        try:
            self._database = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
            self._database.execute("PRAGMA journal_mode = WAL")
            # In WAL mode a commit then waits for no disk; `sync` asks for that.
            self._database.execute("PRAGMA synchronous = NORMAL")
            self._create(about)
        except sqlite3.Error as error:
            raise OSError(f"SQLite: {error}") from error
        marks = ", ".join("?" * (1 + len(about.columns)))
        self._insert = f"INSERT INTO log VALUES ({marks})"

    def _create(self, about: About) -> None:
        run = self._database.execute
        run("BEGIN")
        columns = "".join(f", {sql_name(name)} REAL" for name in about.names)
        run(f"CREATE TABLE log (time REAL NOT NULL{columns})")
        run(
            "CREATE TABLE columns (place INTEGER PRIMARY KEY, name TEXT, state TEXT, attribute TEXT, unit TEXT)"
        )
        run("CREATE TABLE about (key TEXT PRIMARY KEY, value)")
        self._database.executemany(
            "INSERT INTO columns VALUES (?, ?, ?, ?, ?)",
            [(i, c.name, c.state, c.attribute, c.unit) for i, c in enumerate(about.columns, 1)],
        )
        told = {
            "robot": about.robot,
            "rate_hz": about.rate_hz,
            "clock": about.clock,
            "start_ns": about.start_ns,
            "wall_ns": about.wall_ns,
            "json": about.to_json(),
        }
        self._database.executemany("INSERT INTO about VALUES (?, ?)", told.items())
        run("COMMIT")

    def append(self, rows: Sequence[Row]) -> None:
        """One transaction."""
        run = self._database.execute
        try:
            run("BEGIN IMMEDIATE")
            # SQLite keeps NaN as NULL, which is what unknown is.
            self._database.executemany(self._insert, [(ns / 1e9, *values) for ns, values in rows])
            run("COMMIT")
        except sqlite3.Error as error:
            if self._database.in_transaction:
                try:
                    run("ROLLBACK")
                except sqlite3.Error:
                    pass  # SQLite has rolled back by itself
            raise OSError(f"SQLite: {error}") from error

    def sync(self) -> None:
        """To the disk, as far as readers allow."""
        try:
            self._database.execute("PRAGMA wal_checkpoint(PASSIVE)")
        except sqlite3.Error as error:
            raise OSError(f"SQLite: {error}") from error

    def close(self) -> None:
        """Back to one file."""
        try:
            self._database.execute("PRAGMA journal_mode = DELETE").fetchall()
        except sqlite3.Error as error:
            raise OSError(f"SQLite: {error}") from error
        finally:
            self._database.close()
