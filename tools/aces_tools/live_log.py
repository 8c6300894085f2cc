"""Logs that grow while a bus is listened to, in the format that their name says, in one file or a numbered series.

1. What `commit` has returned from is with the system, and reads back: a program that is killed does not lose it.
2. A file that is there is never written over.
3. Files of a series follow each other without a gap or an overlap: an item is in exactly one.

Recordings of frames and bytes are written as they are where their format needs no end (`FormatOut.grows`). For one that has
to be finished (MF4, a packed file …) a log is kept beside it, named FILE.log or FILE.slog, which becomes it when it is
closed; after a kill the log is what there is. Decoded tables are a live export (`aces_bus.export`).
"""

from __future__ import annotations

import glob
import io
import os
import sqlite3
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, Protocol

import numpy as np

from aces_bus import FrameTable, open_recording
from aces_bus.errors import AcesError, CallerError
from aces_bus.export import open_export
from aces_bus.export.files import AppendFile, size_on_disk, telling
from aces_bus.export.sqlite import JournaledDatabase
from aces_bus.protocol import Variant
from aces_bus.protocol.columns.scanner import RecordColumns
from aces_bus.protocol.live.scanner import Scanner
from aces_bus.recordings.base import CanRecording, Link
from aces_bus.recordings.write import PACKED, open_writer, writer_format, writer_formats
from aces_bus.recordings.write.canlog import CanlogSqliteWriter

from .console import say
from .rotation import Rotation, numbered

#: What a recording of a link is kept as, and its suffix.
KEPT = {"can": ("candump", ".log"), "serial": ("slog", ".slog")}
#: Formats in which each item is whole by itself, whatever came before it: one that did not fit may be left out.
INDEPENDENT = ("candump", "slog", "raw")


class LiveFile(Protocol):
    """A log that grows."""

    @property
    def written(self) -> str:
        """The file that has what was committed."""
        ...

    def write(self, item: Any) -> None:
        """Take an item; it is safe after the next `commit`."""

    def commit(self) -> None:
        """Hand to the system what was written: all of it, or none and `OSError` or `CallerError`."""

    def sync(self) -> None:
        """Wait until the disk has what was committed."""

    @property
    def size(self) -> int:
        """Size of the file so far, in bytes."""
        ...

    def close(self) -> None:
        """Finish the file. Raises `CallerError` when it is not whole."""

    def leave(self) -> None:
        """Close the file as it is, after a failure; what was committed is in it."""

    def abandon(self) -> None:
        """Leave no file behind: there is nothing to write after all."""


# ---------------------------------------------------------------------- frames and bytes


class PendingFile:
    """What writers of recordings write into, kept until `commit`. They may go back over what they wrote in one piece."""

    def __init__(self, path: str) -> None:
        self._file = AppendFile(path)
        self._new = bytearray()
        #: What goes over bytes that are in the file: place and bytes.
        self._over: list[tuple[int, bytes]] = []
        self._at = 0

    @property
    def size(self) -> int:
        return self._file.size

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset if whence == os.SEEK_SET else self._file.size + len(self._new) + offset
        return self._at

    def write(self, data: bytes) -> int:
        start = self._at - self._file.size
        if start >= 0:
            self._new[start : start + len(data)] = data
        else:
            self._over.append((self._at, bytes(data)))
        self._at += len(data)
        return len(data)

    def commit(self) -> None:
        """Append what is new as a whole, then write over what is old; or nothing, and `OSError`."""
        new, over = bytes(self._new), self._over
        self._new, self._over = bytearray(), []
        try:
            self._file.write(new)
        finally:
            self._at = self._file.size
        if over:
            with open(self._file.path, "r+b") as file:
                for place, data in over:
                    file.seek(place)
                    file.write(data)

    def sync(self) -> None:
        self._file.sync()

    def close(self) -> None:
        self._file.close()


class DatabaseFile:
    """Frames in python-can's table of SQLite, whose write-ahead log survives a kill; as `PendingFile` and its writer."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._writer = CanlogSqliteWriter(io.BytesIO(), path)
        self._rows: list[Any] = []
        self._base = JournaledDatabase(path)
        with self._base.transaction() as database:
            database.execute(CanlogSqliteWriter.CREATE)

    @property
    def lossy(self) -> dict[str, int]:
        return self._writer.lossy

    @property
    def size(self) -> int:
        return size_on_disk(self._path)

    def write(self, table: FrameTable) -> None:
        self._rows += self._writer.rows(table)

    def settle(self) -> None:
        """Do nothing: rows are whole."""

    def commit(self) -> None:
        rows, self._rows = self._rows, []
        with telling(self._path), self._base.transaction() as database:
            database.executemany(CanlogSqliteWriter.INSERT, rows)

    def sync(self) -> None:
        with telling(self._path):
            self._base.sync()

    def close(self) -> None:
        with telling(self._path):
            self._base.close()


class LiveRecording:
    """A recording of frame tables, or of chunks of a serial line. `option` is what messages call the option with its path.

    Raises `CallerError` for a suffix that says no format of the link, a file that is there, and one that cannot be written.
    """

    def __init__(self, path: str, link: Link, option: str) -> None:
        self.path, self._option = path, option
        self.link: Link = link
        kept, suffix = KEPT[link]
        has_suffix = bool(os.path.splitext(os.path.basename(path))[1])
        form = writer_formats()[self._format(path)] if has_suffix else writer_formats()[kept]
        is_direct = (form.grows or form.name == "sqlite") and not path.lower().endswith(tuple(PACKED))
        #: What is written now, and what it becomes at the end.
        self.journal = path if is_direct else path + suffix
        self.final = None if is_direct else form.name
        self._kind = form if is_direct else writer_formats()[kept]
        self.is_independent = self._kind.name in INDEPENDENT
        self._check()
        try:
            self._open()
        except (OSError, ValueError, sqlite3.Error) as error:
            said = error.strerror if isinstance(error, OSError) else None
            raise CallerError(f"{option} {path}: cannot be written: {said or error}") from error

    def _open(self) -> None:
        self._file: Any
        self._writer: Any
        if self._kind.name == "sqlite":
            self._file = self._writer = DatabaseFile(self.journal)
            return
        self._file = PendingFile(self.journal)
        kind = getattr(import_module(self._kind.module, "aces_bus.recordings.write"), self._kind.writer)
        self._writer = kind(self._file, self.journal)
        self._file.commit()

    def _format(self, path: str) -> str:
        form = writer_format(path, self.link)
        if form.link != self.link:
            known = " ".join(f.suffixes[0] for f in writer_formats().values() if f.link == self.link)
            what = "CAN frames" if self.link == "can" else "bytes of a serial line"
            raise CallerError(f"{self._option} {path}: {form.what} does not hold {what}; there are {known}")
        return form.name

    def _check(self) -> None:
        for path in {self.path, self.journal}:
            if os.path.isfile(path) and os.path.getsize(path):
                if path == self.journal != self.path:
                    raise CallerError(
                        f"{self._option} {self.path}: {path} is there, of a recording that was cut short; convert it"
                        f" first (aces convert {path} …), or take it away"
                    )
                raise CallerError(f"{self._option} {path}: there is such a file already; choose another name")

    @property
    def written(self) -> str:
        """The file that has the recording."""
        return self.path if self.final is None or not os.path.exists(self.journal) else self.journal

    @property
    def size(self) -> int:
        """Size of the file so far, in bytes."""
        return int(self._file.size)

    def write(self, item: Any) -> None:
        """Take a table, or a chunk."""
        self._writer.write(item)

    def commit(self) -> None:
        """Hand it to the system: all of it, or none and `OSError`."""
        self._writer.settle()
        self._file.commit()

    def sync(self) -> None:
        """Wait until the disk has it."""
        self._file.sync()

    def leave(self) -> None:
        """Close the file as it is."""
        self._file.close()

    def abandon(self) -> None:
        """Leave no file behind."""
        self._file.close()
        if os.path.isfile(self.journal):
            os.unlink(self.journal)

    def close(self) -> None:
        """Finish the file. Raises `CallerError` when that fails, and says where the recording is."""
        try:
            if self._writer is not self._file:
                self._writer.close()
            self._file.commit()
        finally:
            self._file.close()
        for kind, count in self._writer.lossy.items():
            say(f"{self._kind.what} does not hold: {count} {kind}")
        if self.final is not None:
            self._convert(self.final)

    def _convert(self, form: str) -> None:
        """Make the log that was kept what was asked for."""
        try:
            with (
                open_recording(self.journal, link=self.link) as capture,
                open_writer(self.path, form, link=self.link) as writer,
            ):
                pieces: Any = capture.tables() if isinstance(capture, CanRecording) else capture
                for piece in pieces:
                    writer.write(piece)
        except AcesError as error:
            raise CallerError(f"{error}; the recording is {self.journal}") from error
        os.unlink(self.journal)


# ---------------------------------------------------------------------- decoded tables


class LiveTables:
    """Decoded items as tables, one a message. Raises `CallerError` when they cannot be written."""

    def __init__(
        self,
        path: str,
        variants: Sequence[Variant],
        scanner: Scanner,
        *,
        only: str | None,
        shows_losses: bool,
    ) -> None:
        self._path = path
        self._export = open_export(path, variants=variants, only=only, live=True)
        self._columns = RecordColumns(variants, include_unknown=shows_losses, scanner=scanner)
        self._is_can = scanner.link == "can"
        self._items = 0
        #: Items that are not in the export yet.
        self._waiting: list[Any] = []

    @property
    def written(self) -> str:
        """The file or folder."""
        return self._path

    @property
    def size(self) -> int:
        """Size of the file so far, in bytes."""
        return self._export.size

    def write(self, item: Sequence[Any]) -> None:
        """Take records and `Unknown`s."""
        self._waiting += item

    def commit(self) -> None:
        """Write what has come; it is safe then."""
        items, self._waiting = self._waiting, []
        rows = np.arange(self._items, self._items + len(items)) if self._is_can else None
        self._items += len(items)
        self._export.write(self._columns.tables(items, rows))
        self._export.commit()

    def sync(self) -> None:
        """Do nothing: the operating system writes the file to the disk."""

    def close(self) -> None:
        """Finish the files."""
        self._export.close()
        for note in self._export.notes:
            say(note)

    def leave(self) -> None:
        """Close the files as they are; they go where nothing was committed."""
        self._export.abandon()

    abandon = leave


# ---------------------------------------------------------------------- series of files


class LogSeries:
    """A log in one file, or with a rotation in several: `walk-00001.blf`, `walk-00002.blf`, …

    `make` opens a file; `now` gives ns. Raises `CallerError` when a file cannot be opened.
    """

    def __init__(
        self,
        path: str,
        rotation: Rotation,
        make: Callable[[str], LiveFile],
        *,
        option: str,
        now: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._path, self._rotation, self._make, self._now = path, rotation, make, now
        #: Files that were begun; what was written and what of it is safe: frames, bytes or records.
        self.files = 0
        self.given = self.committed = 0
        if rotation:
            there = glob.glob(numbered(glob.escape(path), "[0-9]*"))
            if there:
                raise CallerError(
                    f"{option} {path}: {min(there)} is there already, of another run; choose another name"
                )
        self._first: str = ""
        self.file = self._next()
        self._begun: int | None = None

    def _next(self) -> LiveFile:
        path = numbered(self._path, self.files + 1) if self._rotation else self._path
        made = self._make(path)
        self.files += 1
        self._first = self._first or path
        return made

    def _is_full(self) -> bool:
        if self._begun is None:
            return False
        size, ns = self._rotation.size, self._rotation.ns
        return (size is not None and self.file.size >= size) or (
            ns is not None and self._now() - self._begun >= ns
        )

    def write(self, item: Any, size: int) -> None:
        """Take an item of `size` frames, bytes or records."""
        if self._rotation and self._is_full():
            self.commit()
            self.file.close()
            self.file = self._next()
            self._begun = None
        if self._begun is None:
            self._begun = self._now()
        self.given += size
        self.file.write(item)

    def commit(self) -> None:
        """Hand what was written to the system. Raises `OSError` or `CallerError`; it is not in the file then."""
        if self.given != self.committed:
            given = self.given
            try:
                self.file.commit()
            except BaseException:
                self.given = self.committed
                raise
            self.committed = given

    def sync(self) -> None:
        """Wait until the disk has it."""
        self.file.sync()

    def close(self) -> None:
        """Finish the last file. Raises `CallerError` when it is not whole."""
        with telling(self.file.written):
            try:
                self.commit()
            finally:
                self.file.close()

    def leave(self) -> None:
        """Close the file as it is, after a failure."""
        with telling(self.file.written):
            self.file.leave()

    def abandon(self) -> None:
        """Leave no file behind."""
        self.file.abandon()

    @property
    def written(self) -> str:
        """The files, for people."""
        last = self.file.written
        return last if self.files == 1 else f"{self.files} files, {self._first} to {last}"
