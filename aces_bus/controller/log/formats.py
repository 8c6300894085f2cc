"""The formats of logs: which one a path asks for, which one a file has, and files that were never closed.

1. What is not a log is a `LogError`, never a traceback of a library; a log that was not closed is read as far as it goes.
2. What `read_log` reads of an unclosed log is what the recovered one has.
3. A format is a `LogFormat`: the core's are in `FORMATS`, others are entry points of the group `aces_bus.logs`. Its
   modules are imported when a log of it is written or read.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

from ...errors import CallerError, UnknownNameError
from ...export.parquet import close_journal, journal_of
from ...plugins import installed_items
from .base import About, Log, LogError, LogSink
from .text import TextSink


class LogFormat(NamedTuple):
    """A format of logs; an entry point of the group `aces_bus.logs` is one, or a tuple of them.

    `suffixes` choose it, and `magic` is how its files begin. `sink` is the place of a `LogSink` made of a path and an
    `About` (`their_package.module:TheirSink`), `reader` that of a function which makes a `Log` of a path and the most
    numbers it may have. `recovery` is that of a function which closes a log whose writer was killed, and returns how
    many rows it has; "" for a format that needs none.
    """

    name: str
    suffixes: tuple[str, ...]
    magic: bytes
    sink: str
    reader: str
    recovery: str = ""


#: The core's formats.
FORMATS: tuple[LogFormat, ...] = (
    LogFormat("text", (".txt",), b"", ".text:TextSink", ".text:read_text_log"),
    LogFormat("csv", (".csv",), b"", ".text:CsvSink", ".text:read_text_log"),
    LogFormat(
        "sqlite",
        (".db", ".sqlite", ".sqlite3"),
        b"SQLite format 3\x00",
        ".sqlite:SqliteSink",
        ".sqlite:read_sqlite_log",
    ),
    LogFormat("parquet", (".parquet", ".pq"), b"PAR1", ".parquet:ParquetSink", ".parquet:read_parquet_log"),
)
#: How a journal of Parquet begins: an encapsulated message of Arrow.
JOURNAL = b"\xff\xff\xff\xff"


def log_formats() -> Mapping[str, LogFormat]:
    """Return all formats of logs by name, those of installed packages behind the core's, whose names they cannot take."""
    core = {form.name: form for form in FORMATS}
    return core | {
        form.name: form for form in installed_items("aces_bus.logs", LogFormat) if form.name not in core
    }


def _placed(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(module, __package__), name)


def log_format(path: str | os.PathLike[str], format: str | None = None) -> str:
    """Return the format of a log at `path`; raises `CallerError` for an unknown suffix, `UnknownNameError` for a format.

    >>> log_format("walk.db"), log_format("walk.log", "text")
    ('sqlite', 'text')
    """
    if format is not None:
        if format not in log_formats():
            raise UnknownNameError("format of logs", format, log_formats())
        return format
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    for form in log_formats().values():
        if suffix in form.suffixes:
            return form.name
    known = ", ".join(suffix for form in log_formats().values() for suffix in form.suffixes)
    raise CallerError(
        f"{os.fspath(path)}: its suffix says no format of logs; use one of {known}, or say format="
    )


def open_sink(path: str, format: str, about: About, digits: int | None = None) -> LogSink:
    """Open a log of that format. Raises `OSError`, `sqlite3.Error`, and `CallerError` when a library is missing."""
    if digits is not None:
        return TextSink(path, about, digits)
    sink: LogSink = _placed(log_formats()[format].sink)(path, about)
    return sink


def read_log(path: str | os.PathLike[str], *, most_numbers: int = Log.MOST_NUMBERS) -> Log:
    """Read a log: the original's text (bare names, or `Name(attribute)`), CSV, SQLite, Parquet, MCAP.

    `log.time_s` is (rows,) in seconds, `log["RHY"]` a column, NaN where unknown. Raises `LogError` with file:line for
    what is not a log and for more than `most_numbers` numbers; `CallerError` when a library is missing.
    """
    where = os.fspath(path)
    if not os.path.exists(where) and os.path.exists(journal_of(where)):
        where = journal_of(where)
    try:
        if not os.path.isfile(where):
            raise LogError(f"{where}: " + ("not a file" if os.path.exists(where) else "no such file"))
        with open(where, "rb") as stream:
            head = stream.read(16)
        log: Log = _placed(_reader_of(head))(where, most_numbers)
        return log
    except OSError as error:
        raise LogError(f"{where}: {error.strerror or error}") from None


def _reader_of(head: bytes) -> str:
    """Return the place of what reads a log that begins so: anything that no format knows may be text."""
    if head.startswith(JOURNAL):
        return ".parquet:read_journal"
    known = (form.reader for form in log_formats().values() if form.magic and head.startswith(form.magic))
    return next(known, ".text:read_text_log")


def recover(path: str | os.PathLike[str]) -> int:
    """Close a log whose writer was killed, Parquet or MCAP; returns the number of rows.

    The closed log takes its place when it is whole. Raises `CallerError` for a file that needs none, `LogError` for one
    that is not a log, `OSError` when the closed one cannot be written; what is there stays then.
    """
    where = os.fspath(path).removesuffix(".journal")
    if os.path.isfile(where):
        with open(where, "rb") as stream:
            head = stream.read(16)
        for form in log_formats().values():
            if form.recovery and form.magic and head.startswith(form.magic):
                rows: int = _placed(form.recovery)(where)
                return rows
    if not os.path.exists(journal_of(where)):
        raise CallerError(
            f"{where}: is not a log that needs closing, and there is no {os.path.basename(journal_of(where))} beside it;"
            " text, CSV and SQLite need no recovery"
        )
    return close_journal(where)
