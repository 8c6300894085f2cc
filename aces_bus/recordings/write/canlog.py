"""What python-can's `CSVWriter` and `SqliteWriter` write: the same seven values of a frame.

    timestamp,arbitration_id,extended,remote,error,dlc,data
    1483389946.197,0xdadada,1,0,0,7,WzQyLCA5XQ==

1. Neither has a channel, a direction or a mark for CAN FD: what they do not hold is counted.
2. A time in CSV is exact; in SQLite it is a float of seconds, some 0.2 µs apart today.

*Facts*: python-can's documentation of both; data are base64, `dlc` is a number of bytes. The table in SQLite is `messages`.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
import weakref
from binascii import b2a_base64
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, BinaryIO

import numpy as np

from ...errors import CallerError
from ...frame_table import FrameFlag, FrameTable, ns_of
from ..beginnings import PYTHON_CAN_CSV
from ..sqlite import COLUMNS
from .base import FrameWriter


class _CanlogWriter(FrameWriter):
    """Frames as identifier, extended, remote, error, length and data."""

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        self._names: set[str] = set()

    def _values(self, table: FrameTable) -> Iterator[tuple[int, int, int, int, int, bytes]]:
        """Return those of each frame. What is lost of it is counted."""
        flags, length = table.flags, self._remote_lengths(table)
        for number in np.unique(table.channel).tolist():
            name = table.channels.names[number]
            if name is not None and name not in self._names:
                self._names.add(name)
                self.lose("channel names")
        self.lose("directions", np.count_nonzero(flags & (FrameFlag.RX | FrameFlag.TX)))
        self.lose_fd(table)
        data = table.data.tobytes()
        width = table.data.shape[1]
        marks = (
            (flags & mark != 0).astype(np.uint8).tolist()
            for mark in (FrameFlag.EXTENDED, FrameFlag.REMOTE, FrameFlag.ERROR)
        )
        sizes = np.where(flags & FrameFlag.REMOTE, 0, length).tolist()
        cells = (data[at : at + size] for at, size in zip(range(0, len(data), width), sizes, strict=True))
        return zip(table.id.tolist(), *marks, length.tolist(), cells, strict=True)


class CanlogCsvWriter(_CanlogWriter):
    """Frames as lines of python-can's CSV."""

    format = "csv"

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        file.write(PYTHON_CAN_CSV + b"\n")

    def _encoded(self, table: FrameTable) -> bytes:
        seconds, rest = np.divmod(self._epoch_times(table), 1_000_000_000)
        times = (
            f"{whole}.{ns:09}" if ns % 1000 else f"{whole}.{ns // 1000:06}"
            for whole, ns in zip(seconds.tolist(), rest.tolist(), strict=True)
        )
        return b"".join(
            b"%b,0x%x,%d,%d,%d,%d,%b" % (time.encode(), *values[:5], b2a_base64(values[5]))
            for time, values in zip(times, self._values(table), strict=True)
        )


class CanlogSqliteWriter(_CanlogWriter):
    """Frames as rows of python-can's table. The database is made in a temporary file, and becomes the file by `close`."""

    format = "sqlite"
    keeps_error_width = True

    def rows(self, table: FrameTable) -> list[tuple[Any, ...]]:
        """Return what `INSERT` takes."""
        time = self._epoch_times(table)
        seconds = time / 1e9
        self.lose("times finer than a float of seconds", np.count_nonzero(ns_of(seconds) != time))
        return [(ts, *values) for ts, values in zip(seconds.tolist(), self._values(table), strict=True)]

    @contextmanager
    def _telling(self) -> Generator[None]:
        """Raise what SQLite refuses as a `CallerError`: a full disk below the temporary file, say."""
        try:
            yield
        except sqlite3.Error as error:
            raise CallerError(f"{self.name}: cannot be written: {error}") from error

    @cached_property
    def _base(self) -> tuple[str, sqlite3.Connection]:
        folder = tempfile.mkdtemp()
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        base = sqlite3.connect(os.path.join(folder, "log"), isolation_level=None, check_same_thread=False)
        base.executescript(
            "PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; BEGIN;" + CanlogSqliteWriter.CREATE
        )
        return folder, base

    def write(self, table: FrameTable) -> None:
        """Write the frames, in order."""
        with self._telling():
            self._base[1].executemany(CanlogSqliteWriter.INSERT, self.rows(table))

    def _encoded(self, table: FrameTable) -> bytes:
        raise NotImplementedError

    def close(self) -> None:
        """Write the database."""
        with self._telling():
            folder, base = self._base
            base.execute("COMMIT")
            base.close()
        with open(os.path.join(folder, "log"), "rb") as made:
            shutil.copyfileobj(made, self._file, 1 << 20)

    #: SQL that makes the table, and that adds a row.
    CREATE = (
        "CREATE TABLE messages (ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, error INTEGER,"
        " dlc INTEGER, data BLOB)"
    )
    INSERT = f"INSERT INTO messages VALUES ({', '.join('?' * len(COLUMNS))})"
