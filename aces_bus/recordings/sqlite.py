"""What python-can's `SqliteWriter` writes: a table `messages`, a row a frame.

1. Every row is a frame or unreadable with its reason; a row's number is its place in the table.
2. The database is read and never written, and nothing in it is run: no extension, no trusted schema, no view; work without a
   row is bounded, and so are values and the number of rows.
3. Where the database breaks off, what was read is given, and the rest counts as one unreadable row.

*Facts*: columns ts, arbitration_id, extended, remote, error, dlc (a number of bytes), data. *Choice*: the table has no
column for CAN FD; more than 8 bytes are taken for a CAN FD frame, as nothing else can carry them. It has no channel
either. A row whose dlc is not its number of bytes is unreadable.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from itertools import chain, islice
from typing import Any, ClassVar
from urllib.parse import quote

import numpy as np

from ..errors import CallerError, CaptureError
from ..frame_table import FrameFlag, FrameTable, ns_of
from ..frames import FD_LENGTHS, Frame
from .base import REMOTE_AND_ERROR, CanRecording
from .source import on_disk

COLUMNS = ("ts", "arbitration_id", "extended", "remote", "error", "dlc", "data")

_ROWS = 1 << 14
#: Read from SQLite at once; also what one odd row makes slow.
_BATCH = 512
#: Of a row, so that a batch is bounded.
_VALUE_BYTES = 1 << 14
#: Steps of SQLite's machine for a batch; a real row takes some twenty.
_STEPS = 20_000_000
_STEPS_A_CALL = 100_000
#: No row takes less of a file; pages that are linked in circles give more.
_ROW_BYTES = 4

_Row = tuple[Any, ...]
_Columns = tuple[tuple[Any, ...], ...]
_TYPES = ({float}, {int}, {int}, {int}, {int}, {int}, {bytes})
_IS_FD_LENGTH = np.zeros(65, bool)
_IS_FD_LENGTH[list(FD_LENGTHS)] = True


class UntrustedDatabase:
    """An SQLite file that is read; raises `sqlite3.Error`. Between two batches SQLite takes at most `most_steps` steps.

    `protect` takes the pragmas that keep SQLite from running what is in the file. Texts come as `text_factory` makes them.
    """

    def __init__(self, path: str, most_steps: int, value_bytes: int, text_factory: Any = str) -> None:
        # A journal means that a writer was interrupted, or is writing: then SQLite must look at it, if it may. Without one
        # the file need not be locked, and its folder may be read-only.
        is_quiet = not any(os.path.exists(path + end) for end in ("-wal", "-journal"))
        where = f"file:{quote(os.path.abspath(path))}?mode=ro{'&immutable=1' if is_quiet else ''}"
        self._steps, self._most_steps = 0, most_steps
        self.database = sqlite3.connect(where, uri=True, isolation_level=None, check_same_thread=False)
        self.database.text_factory = text_factory
        for limit, value in (
            (sqlite3.SQLITE_LIMIT_LENGTH, value_bytes),
            (sqlite3.SQLITE_LIMIT_ATTACHED, 0),
            (sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH, 1),
            (sqlite3.SQLITE_LIMIT_WORKER_THREADS, 0),
        ):
            self.database.setlimit(limit, value)
        self.database.set_progress_handler(self._is_stuck, _STEPS_A_CALL)

    def protect(self, *pragmas: str) -> None:
        """Set pragmas."""
        for pragma in pragmas:
            self.database.execute(f"PRAGMA {pragma}")

    def _is_stuck(self) -> bool:
        self._steps += _STEPS_A_CALL
        return self._steps > self._most_steps

    def rows(self, query: str, most: int) -> list[_Row]:
        """Return the first rows of a query, at most so many."""
        self._steps = 0
        return self.database.execute(query).fetchmany(most)

    def batches(self, query: str, size: int) -> Iterator[list[_Row]]:
        """Yield all rows of a query, so many at a time. Where SQLite fails, those before come first."""
        self._steps = 0
        cursor = self.database.execute(query)
        while True:
            rows: list[_Row] = []
            try:
                rows.extend(islice(cursor, size))  # keeps those before an error
            except sqlite3.Error:
                if rows:
                    yield rows
                raise
            if rows:
                yield rows
            if len(rows) < size:
                return
            self._steps = 0


class SqliteCapture(CanRecording):
    """Frames of python-can's SQLite logs.

    Reading raises `CaptureError` when the database cannot be opened or has no such table. What does not come from a plain
    file is kept in a temporary one meanwhile.
    """

    format: ClassVar[str] = "SQLite log of python-can"

    def _tables(self) -> Iterator[FrameTable]:
        with on_disk(self._source) as (path, folder):
            try:
                source = UntrustedDatabase(_whole_pages(path, folder), _STEPS, _VALUE_BYTES, bytearray)
            except sqlite3.Error as error:
                raise CaptureError(f"{self.name}: an SQLite file that cannot be opened: {error}") from error
            with closing(source.database):
                parts = (path, f"{path}-wal")  # a log that was not closed
                room = sum(os.path.getsize(part) for part in parts if os.path.exists(part))
                yield from self._rows(source, room // _ROW_BYTES)
        self.close()

    def _rows(self, source: UntrustedDatabase, room: int) -> Iterator[FrameTable]:
        try:
            query = self._query(source)
        except sqlite3.Error as error:
            raise CaptureError(
                f"{self.name}: an SQLite file that cannot be read: {error}; `sqlite3 FILE .recover` may help"
            ) from error
        kept: list[_Columns] = []
        count, broken = 0, ""
        try:
            for rows in source.batches(query, _BATCH):
                if (usual := _columns_of(rows)) is not None:
                    kept.append(usual)
                    count += len(rows)
                if usual is None or count >= _ROWS:
                    yield from self._plain(kept)
                    kept, count = [], 0
                if usual is None:
                    yield from self._one_by_one(rows)
                if self.lines + count > room:
                    broken = "more rows than the file has room for"
                    break
        except sqlite3.Error as error:
            broken = f"the database is damaged: {error}"
        yield from self._plain(kept)
        if broken:
            self.lines += 1
            self._unreadable(self.lines, f"{broken}; rows behind this one are lost", b"")

    def _query(self, source: UntrustedDatabase) -> str:
        # A writable schema is one that may be broken: a file that was cut is read as far as it goes. Nothing is written.
        source.protect(
            "writable_schema = ON",
            "trusted_schema = OFF",
            "cell_size_check = ON",
            "mmap_size = 0",
            "query_only = ON",
        )
        found = source.rows("SELECT type, sql FROM sqlite_master WHERE name = 'messages'", 10)
        if [kind for kind, sql in found if kind == b"table" and b"VIRTUAL" not in (sql or b"").upper()[:40]]:
            names = {bytes(row[1]) for row in source.rows("PRAGMA table_info(messages)", 100)}
            if names.issuperset(name.encode() for name in COLUMNS):
                return f"SELECT {', '.join(COLUMNS)} FROM messages ORDER BY rowid"
        raise CaptureError(
            f"{self.name}: an SQLite file without python-can's table messages({', '.join(COLUMNS)}); it is not a CAN log"
        )

    def _one_by_one(self, rows: Iterable[_Row]) -> list[FrameTable]:
        """Return the frames of rows of which some may be none."""
        frames: list[Frame] = []
        for row in rows:
            self.lines += 1
            try:
                frames.append(_frame(row))
            except CallerError as error:
                self._unreadable(self.lines, str(error), repr(row)[1:-1].encode())
        self.frames += len(frames)
        return [FrameTable.from_frames(frames, self.channels)] if frames else []

    def _plain(self, kept: Sequence[_Columns]) -> list[FrameTable]:
        """Return the frames of the rows that were kept, all at once when none of them is odd."""
        if not kept:
            return []
        columns = [list(chain.from_iterable(parts)) for parts in zip(*kept, strict=True)]
        ts, identifier, extended, remote, error, dlc, data = columns
        n = len(ts)
        try:
            ids, wide, asks, faulty, length = (
                np.array(column, np.int64) for column in (identifier, extended, remote, error, dlc)
            )
        except OverflowError:
            return self._one_by_one(zip(*columns, strict=True))
        sizes = np.fromiter(map(len, data), np.int64, n)
        is_fd = sizes > 8
        limit = np.where((wide != 0) | (faulty != 0), 0x1FFF_FFFF, 0x7FF)
        is_odd = (asks != 0) & (faulty != 0)
        is_odd |= (ids < 0) | (ids > limit) | ~_IS_FD_LENGTH[sizes]
        is_odd |= np.where(asks != 0, (length < 0) | (length > 8) | (sizes > 0), length != sizes)
        if is_odd.any():
            return self._one_by_one(zip(*columns, strict=True))
        flags = (
            (wide != 0) * np.uint8(FrameFlag.EXTENDED)
            | (asks != 0) * np.uint8(FrameFlag.REMOTE)
            | (faulty != 0) * np.uint8(FrameFlag.ERROR)
            | is_fd * np.uint8(FrameFlag.FD)
        )
        width = 64 if is_fd.any() else 8
        self.lines += n
        self.frames += n
        table = FrameTable(
            ns_of(np.array(ts, np.float64)),
            np.full(n, self.channels.number(None), np.uint16),
            ids.astype(np.uint32),
            flags.astype(np.uint8),
            length.astype(np.uint8),
            np.frombuffer(b"".join([value.ljust(width, b"\0") for value in data]), np.uint8).reshape(
                n, width
            ),
            self.channels,
        )
        return [table]


def _columns_of(rows: Sequence[_Row]) -> _Columns | None:
    """Return rows as columns, which take less room; None if they do not have the types and sizes of frames."""
    columns = tuple(zip(*rows, strict=True))
    if any(set(map(type, column)) != kind for column, kind in zip(columns, _TYPES, strict=True)):
        return None
    return None if len(max(columns[-1], key=len)) > 64 else columns


def _whole_pages(path: str, folder: str) -> str:
    """Return the path of the database without a last page that was cut: SQLite takes the bytes that lack for zeros."""
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        page = int.from_bytes(file.read(18)[16:], "big")
    page = 1 << 16 if page == 1 else page
    if page < 512 or page & (page - 1) or size % page == 0:
        return path
    copy = os.path.join(folder, "whole")
    shutil.copyfile(path, copy)
    os.truncate(copy, size // page * page)
    return copy


def _frame(row: _Row) -> Frame:
    """Return the frame of a row; raises `CallerError` with the reason when it is none."""
    ts, identifier, extended, remote, error, dlc, data = row
    data = b"" if data is None else data
    if not isinstance(ts, (int, float, type(None))):
        raise CallerError("ts is not a number")
    if type(data) is not bytes:
        raise CallerError("data is not a blob")
    for name, value in zip(COLUMNS[1:6], (identifier, extended, remote, error, dlc), strict=True):
        if type(value) is not int:
            raise CallerError(f"{name} is not an integer")
    if remote and error:
        raise CallerError(REMOTE_AND_ERROR)
    if remote:
        if not 0 <= dlc <= 8:
            raise CallerError(f"dlc {dlc} of a remote frame is outside 0…8")
    elif dlc != len(data):
        raise CallerError(f"dlc is {dlc}, and there are {len(data)} data bytes")
    return Frame(
        identifier,
        data,
        None if ts is None else float(ts),
        None,
        bool(extended),
        bool(remote),
        bool(error),
        len(data) > 8,
        dlc=dlc if remote else None,
    )
