"""Which format a log's path asks for.

1. A format's library is imported when a log of it is made.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import import_module

from ...errors import CallerError, UnknownNameError
from .base import About, LogSink

#: Format → its module here and its class.
FORMATS: Mapping[str, tuple[str, str]] = {
    "text": ("text", "TextSink"),
    "csv": ("text", "CsvSink"),
    "sqlite": ("sqlite", "SqliteSink"),
    "parquet": ("parquet", "ParquetSink"),
    "mcap": ("mcap", "McapSink"),
}
SUFFIXES: Mapping[str, str] = {
    ".txt": "text",
    ".csv": "csv",
    ".db": "sqlite",
    ".sqlite": "sqlite",
    ".sqlite3": "sqlite",
    ".parquet": "parquet",
    ".pq": "parquet",
    ".mcap": "mcap",
}


def log_format(path: str | os.PathLike[str], format: str | None = None) -> str:
    """The format of a log at `path`; raises `CallerError` for a suffix that says none, `UnknownNameError` for a format.

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
    """A log of that format. Raises `OSError` where it cannot be written, `CallerError` when a library is missing."""
    module, name = FORMATS[format]
    kind: type[LogSink] = getattr(import_module(f".{module}", __package__), name)
    return kind(path, about) if digits is None else kind(path, about, digits)  # type: ignore[call-arg]
