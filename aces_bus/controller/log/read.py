"""Logs read back, whatever their format; told by content.

1. What is no log is a `LogError`, never a traceback of a library; a log that was not closed is read as far as it goes.
"""

from __future__ import annotations

import os

from .mcap import MAGIC as MCAP
from .parquet import journal_of
from .read_mcap import read_mcap_log
from .read_parquet import read_journal, read_parquet_log
from .read_sqlite import read_sqlite_log
from .read_text import read_text_log
from .table import MOST_NUMBERS, Log, LogError

SQLITE = b"SQLite format 3\x00"
PARQUET = b"PAR1"
#: What an encapsulated message of Arrow begins with.
ARROW = b"\xff\xff\xff\xff"


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
            head = stream.read(4096)
            stream.seek(0)
            if head.startswith(SQLITE):
                return read_sqlite_log(where, most_numbers=most_numbers)
            if head.startswith(PARQUET):
                return read_parquet_log(where, most_numbers=most_numbers)
            if head.startswith(ARROW):
                return read_journal(where, most_numbers=most_numbers)
            if head.startswith(MCAP):
                return read_mcap_log(where, most_numbers=most_numbers)
            line = head.removeprefix(b"\xef\xbb\xbf").lstrip().split(b"\n", 1)[0]
            is_csv = line.startswith((b"time,", b'"time",', b"time_s,", b"0,"))
            return read_text_log(stream, where, is_csv=is_csv, most_numbers=most_numbers)
    except OSError as error:
        raise LogError(f"{where}: {error.strerror or error}") from None
