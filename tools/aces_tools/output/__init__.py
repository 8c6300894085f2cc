"""How decoded records are written: for programs (`jsonl`), for spreadsheets (`sheet`), for people (`text`).

A writer is given the items of one source, in order, and returns bytes; it never writes anything itself.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol

from aces_bus.errors import CallerError
from aces_bus.export.open import SUFFIXES as TABLES
from aces_bus.export.open import export_format


class Writer(Protocol):
    """What the three have in common."""

    def begin(self, source: str, link: str, start: float | None = None) -> bytes:
        """What comes before the items of a source; `start` is the time of its first one, shown or not."""
        ...

    def items(self, items: Sequence[Any]) -> bytes:
        """Records and `Unknown`s of the source."""
        ...


# ---------------------------------------------------------------------- which format

Format = Literal["text", "jsonl", "csv"]

SUFFIXES: Mapping[str, Format] = {
    ".jsonl": "jsonl",
    ".ndjson": "jsonl",
    ".csv": "csv",
    ".txt": "text",
    ".text": "text",
    ".log": "text",
    ".out": "text",
    "": "text",
}
#: Formats that are written value by value, in the order of the recording.
LIVE: tuple[Format, ...] = ("text", "jsonl", "csv")


def table_format(path: str | None, chosen: str | None) -> str | None:
    """The format of tables that is asked for; None for text, record lines and CSV by rows.

    Raises `CallerError` for a suffix that says no format, one that contradicts `--format`, and tables without a file.

    >>> table_format("walk.parquet", None), table_format("walk.csv/", None), table_format("walk.csv", None)
    ('parquet', 'csv', None)
    """
    of_path = export_format(path) if path is not None else None
    said = _said(path)
    if said is None and chosen is None:
        known = " ".join(suffix for suffix in (*SUFFIXES, *TABLES) if suffix)
        raise CallerError(
            f"-o {path}: no format has the suffix {_suffix(path)!r}; there are {known} .csv/; or say --format text"
        )
    if chosen is None:
        return of_path
    if said not in (None, "text", chosen):
        raise CallerError(
            f"-o {path}: the suffix says {said}, and --format {chosen}; leave one of them away, or give the file"
            " another name"
        )
    if chosen in LIVE and not (chosen == "csv" and of_path == "csv"):
        return None
    if path is None or path == "-":
        raise CallerError(f"--format {chosen} goes to a file or folder; name it with --output")
    return chosen


def line_format(path: str | None, chosen: Format | None) -> Format:
    """The format of lines that are written as they come; raises `CallerError` for anything else."""
    is_table = path is not None and export_format(path) is not None
    if is_table or (chosen is None and _said(path) is None):
        known = " ".join(suffix for suffix in SUFFIXES if suffix)
        raise CallerError(
            f"-o {path}: lines are written as they come, into {known}; for anything else record the bus"
            " (--record FILE.blf) and then convert or decode the recording"
        )
    table_format(path, chosen)
    return chosen or SUFFIXES[_suffix(path)]


def _said(path: str | None) -> str | None:
    """What a path says; None for a suffix that means nothing here."""
    return (export_format(path) if path is not None else None) or SUFFIXES.get(_suffix(path))


def _suffix(path: str | None) -> str:
    return os.path.splitext(path or "")[1].lower()


__all__ = ["Writer", "line_format", "table_format"]
