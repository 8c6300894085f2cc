"""The formats of logs: which one a path asks for, which one a file has, and files that were never closed.

1. What is no log is a `LogError`, never a traceback of a library; a log that was not closed is read as far as it goes.
2. What `read_log` reads of an unclosed log is what the recovered one has.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping

from ...errors import CallerError, UnknownNameError
from ...export.mcap_file import MAGIC as MCAP
from ...export.parquet import close_journal, journal_of
from .base import MOST_NUMBERS, About, Log, LogError, LogSink
from .mcap import McapSink, read_mcap_log, recover_mcap
from .parquet import ParquetSink, read_journal, read_parquet_log
from .sqlite import SqliteSink, read_sqlite_log
from .text import CsvSink, TextSink, read_text_log

#: Format → what writes it.
FORMATS: Mapping[str, type[LogSink]] = {
    kind.format: kind for kind in (TextSink, CsvSink, SqliteSink, ParquetSink, McapSink)
}
SUFFIXES = {suffix: name for name, kind in FORMATS.items() for suffix in kind.suffixes}
#: How a file begins → what reads it; the third is an encapsulated message of Arrow. Anything else may be text.
READERS: Mapping[bytes, Callable[[str, int], Log]] = {
    b"SQLite format 3\x00": read_sqlite_log,
    b"PAR1": read_parquet_log,
    b"\xff\xff\xff\xff": read_journal,
    MCAP: read_mcap_log,
    b"": read_text_log,
}


def log_format(path: str | os.PathLike[str], format: str | None = None) -> str:
    """Return the format of a log at `path`; raises `CallerError` for an unknown suffix, `UnknownNameError` for a format.

    >>> log_format("walk.db"), log_format("walk.log", "text")
    ('sqlite', 'text')
    """
    if format is not None:
        if format not in FORMATS:
            raise UnknownNameError("format of logs", format, FORMATS)
        return format
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    if suffix not in SUFFIXES:
        raise CallerError(
            f"{os.fspath(path)}: its suffix says no format of logs; use one of {', '.join(SUFFIXES)}, or say format="
        )
    return SUFFIXES[suffix]


def open_sink(path: str, format: str, about: About, digits: int | None = None) -> LogSink:
    """Open a log of that format. Raises `OSError`, `sqlite3.Error`, and `CallerError` when a library is missing."""
    return FORMATS[format](path, about) if digits is None else TextSink(path, about, digits)


def read_log(path: str | os.PathLike[str], *, most_numbers: int = MOST_NUMBERS) -> Log:
    """Read a log: the original's text (bare names, or `Name(attribute)`), CSV, SQLite, Parquet, MCAP.

    `log.time_s` is (rows,) in seconds, `log["RHY"]` a column, NaN where unknown. Raises `LogError` with file:line for
    what is no log and for more than `most_numbers` numbers; `CallerError` when a library is missing.
    """
    where = os.fspath(path)
    if not os.path.exists(where) and os.path.exists(journal_of(where)):
        where = journal_of(where)
    try:
        if not os.path.isfile(where):
            raise LogError(f"{where}: " + ("not a file" if os.path.exists(where) else "no such file"))
        with open(where, "rb") as stream:
            head = stream.read(16)
        return next(read for magic, read in READERS.items() if head.startswith(magic))(where, most_numbers)
    except OSError as error:
        raise LogError(f"{where}: {error.strerror or error}") from None


def recover(path: str | os.PathLike[str]) -> int:
    """Close a log whose writer was killed, Parquet or MCAP; returns the number of rows.

    The closed log takes its place when it is whole. Raises `CallerError` for a file that needs none, `LogError` for one
    that is no log, `OSError` when the closed one cannot be written; what is there stays then.
    """
    where = os.fspath(path).removesuffix(".journal")
    if os.path.isfile(where):
        with open(where, "rb") as stream:
            if stream.read(len(MCAP)) == MCAP:
                return recover_mcap(where)
    if not os.path.exists(journal_of(where)):
        raise CallerError(
            f"{where}: is no unclosed MCAP, and there is no {os.path.basename(journal_of(where))} beside it;"
            " text, CSV and SQLite need no recovery"
        )
    return close_journal(where)
