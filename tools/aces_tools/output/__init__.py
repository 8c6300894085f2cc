"""How decoded records are written: for programs (`jsonl`), for spreadsheets (`sheet`), for people (`text`).

A writer is given the items of one source, in order, and returns bytes; it never writes anything itself.
"""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol

from aces_bus.errors import CallerError
from aces_bus.export.open import export_format, table_formats, table_suffixes
from aces_bus.recordings.base import Link


class Writer(Protocol):
    """What the three have in common."""

    def begin(self, source: str, link: str, start: float | None = None) -> bytes:
        """Return what comes before the items of a source; `start` is the time of its first one, shown or not."""
        ...

    def items(self, items: Sequence[Any]) -> bytes:
        """Return the text of records and `Unknown`s of the source."""
        ...


class SpeltOut:
    """A writer for a terminal: control characters but line ends are spelt out, such as `\\x{:02x}` says."""

    def __init__(self, writer: Writer, spelling: str) -> None:
        self._writer, self._spelling = writer, spelling

    def begin(self, source: str, link: str, start: float | None = None) -> bytes:
        return self._plain(self._writer.begin(source, link, start))

    def items(self, items: Sequence[Any]) -> bytes:
        return self._plain(self._writer.items(items))

    def _plain(self, data: bytes) -> bytes:
        text = data.decode("utf-8", "surrogateescape")
        if text.replace("\n", "").isprintable():
            return data
        plain = "".join(
            self._spelling.format(ord(c)) if c != "\n" and unicodedata.category(c)[0] == "C" else c
            for c in text
        )
        return plain.encode("utf-8", "replace")


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
    """Return the format of tables that is asked for; None for text, record lines and CSV by rows.

    Raises `CallerError` for a suffix that says no format, one that contradicts `--format`, and tables without a file.

    >>> table_format("walk.parquet", None), table_format("walk.csv/", None), table_format("walk.csv", None)
    ('parquet', 'csv', None)
    """
    of_path = export_format(path) if path is not None else None
    said = _said(path)
    if said is None and chosen is None:
        known = " ".join(suffix for suffix in (*SUFFIXES, *table_suffixes()) if suffix)
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
    """Return the format of lines that are written as they come; raises `CallerError` for a path that says another."""
    table_format(path, chosen)
    return chosen or SUFFIXES[_suffix(path)]


#: What a live log may be: lines as they are shown, frames or bytes as they came, decoded tables.
LiveKind = Literal["lines", "frames", "tables"]


def live_kind(path: str | None, chosen: Format | None, link: Link, *, is_decoded: bool) -> LiveKind:
    """Return what `aces sniff -o` writes: with a protocol (`is_decoded`) lines or tables, without one lines, frames or
    bytes.

    Raises `CallerError` with what there is for a suffix that says none of these.

    >>> live_kind("walk.parquet", None, "can", is_decoded=True), live_kind("walk.blf", None, "can", is_decoded=False)
    ('tables', 'frames')
    """
    suffix = _suffix(path)
    table = export_format(path) if path is not None else None
    if path is None or path == "-" or chosen is not None or (not suffix and table is None):
        line_format(path, chosen)
        return "lines"
    if not suffix:  # a folder: the slash is a part of what it says
        suffix, table = f"{_suffix(path.rstrip('/'))}/", None if table == "csv" else table
    if is_decoded:
        if _grows(table):
            return "tables"
        if table is None and suffix in SUFFIXES:
            return "lines"
        said = "frames as they came, and no messages; leave -p out, or record them beside (--record)"
        why = said if _is_recording(path, link) else "no format that is written while a bus is listened to"
        raise CallerError(
            f"-o {path}: {suffix} is {why}; with -p there are {' '.join((*_LINES, *table_suffixes(growing=True)))}"
        )
    if suffix in SUFFIXES and not (_is_recording(path, link) and suffix in (".log", ".csv")):
        return "lines"
    if _is_recording(path, link):
        return "frames"
    if _grows(table):
        raise CallerError(f"-o {path}: {suffix} is for decoded messages; name the protocol: -p NAME")
    from aces_bus.recordings.write import writer_formats

    frames = dict.fromkeys(
        ending for form in writer_formats().values() if form.link == link for ending in form.suffixes
    )
    raise CallerError(
        f"-o {path}: no format has the suffix {suffix!r}; there are {' '.join((*frames, *_LINES))}, and with -p"
        f" {' '.join(table_suffixes(growing=True))}"
    )


def _grows(format: str | None) -> bool:
    """Return whether this is a format of tables that can be written while it grows."""
    return format is not None and bool(table_formats()[format].growing)


def _is_recording(path: str, link: Link) -> bool:
    from aces_bus.recordings.write import writer_format

    try:
        return writer_format(path, link).link == link
    except CallerError:
        return False


_LINES = [suffix for suffix in SUFFIXES if suffix]


def _said(path: str | None) -> str | None:
    """Return what a path says; None for a suffix that means nothing here."""
    return (export_format(path) if path is not None else None) or SUFFIXES.get(_suffix(path))


def _suffix(path: str | None) -> str:
    return os.path.splitext(path or "")[1].lower()


__all__ = ["Writer", "line_format", "live_kind", "table_format"]
