"""Which export a path asks for, by its suffix.

1. A format's libraries are imported when it is used; a missing one is named with the extra that has it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING

from ..errors import CallerError, UnknownNameError
from ..protocol.declare.protocol import Variant

if TYPE_CHECKING:
    from .base import Export

#: Format → its module here and its class.
FORMATS: Mapping[str, tuple[str, str]] = {
    "parquet": ("parquet", "ParquetExport"),
    "arrow": ("folder", "ArrowExport"),
    "feather": ("folder", "FeatherExport"),
    "csv": ("csv", "CsvExport"),
    "npz": ("npz", "NpzExport"),
    "sqlite": ("sqlite", "SqliteExport"),
    "mcap": ("mcap", "McapExport"),
}
#: Those that can be written while they grow, and survive a kill.
GROWING: Mapping[str, tuple[str, str]] = {
    "parquet": ("parquet_parts", "ParquetParts"),
    "sqlite": FORMATS["sqlite"],
    "mcap": FORMATS["mcap"],
}
#: Suffix → format; CSV only where the path ends in a slash: `walk.csv/`.
SUFFIXES: Mapping[str, str] = {
    ".parquet": "parquet",
    ".pq": "parquet",
    ".arrow": "arrow",
    ".ipc": "arrow",
    ".feather": "feather",
    ".npz": "npz",
    ".sqlite": "sqlite",
    ".sqlite3": "sqlite",
    ".db": "sqlite",
    ".mcap": "mcap",
}


def export_format(path: str | os.PathLike[str]) -> str | None:
    """Return the format that a path asks for, None when it asks for none of these.

    >>> export_format("walk.parquet"), export_format("walk.csv/"), export_format("walk.csv"), export_format("walk/")
    ('parquet', 'csv', None, 'parquet')
    """
    text = os.fspath(path)
    stem = text.rstrip("/" + os.sep)
    suffix = os.path.splitext(stem)[1].lower()
    if _is_plain_folder(text):
        return "parquet"
    if suffix == ".csv" and stem != text:
        return "csv"
    return SUFFIXES.get(suffix)


def _is_plain_folder(text: str) -> bool:
    """Return whether a path names a folder, and no format: such a folder is of Parquet files."""
    stem = text.rstrip("/" + os.sep)
    return not os.path.splitext(stem)[1] and bool(stem) and (stem != text or os.path.isdir(text))


def open_export(
    path: str | os.PathLike[str],
    format: str | None = None,
    *,
    variants: Sequence[Variant] = (),
    only: str | None = None,
    names: bool = False,
    float32: bool = False,
    sources: bool = False,
    live: bool = False,
) -> Export:
    """Open an export into a file or folder, which is at `path` when it is closed.

    `format` is one of "parquet", "arrow", "feather", "csv", "npz", "sqlite", "mcap"; by default the suffix says it.
    `variants` are the protocols that tables come from: they say what is in columns of Python objects (without them such
    values are JSON texts), and which names need the protocol in front. `only` is a single message: Parquet, Arrow and
    CSV then write a file instead of a folder, unless the path is one (`walk/`). `names` writes enumerations as names,
    `float32` physical values in half the size, `sources` a column with the name of the capture.

    With `live` the export grows at `path`, where nothing may be yet, and each `commit` makes what was written safe from a
    kill: for what does not end. "parquet" is then a folder of parts for each message (see `parquet_parts`), "sqlite" and
    "mcap" are files that other programs read meanwhile; the others need their end, and are refused.

    Raises `CallerError` when the path cannot be written, the suffix says no format or a library is missing,
    `UnknownNameError` for a format that does not exist.
    """
    text = os.fspath(path)
    chosen = format or export_format(text)
    if chosen is None:
        raise CallerError(
            f"{text}: its suffix says no format; use one of {', '.join(SUFFIXES)}, or .csv/ for a folder"
        )
    if chosen not in FORMATS:
        raise UnknownNameError("format", chosen, FORMATS)
    if text == "-":
        raise CallerError(f"{chosen} goes to a file or folder and not to standard output; name one")
    if live and chosen not in GROWING:
        raise CallerError(
            f"{text}: {chosen} needs its end, and cannot be written while it grows; there are {', '.join(GROWING)}"
        )
    from .base import Options

    module, name = GROWING[chosen] if live else FORMATS[chosen]
    kind: type[Export] = getattr(import_module(f".{module}", __package__), name)
    if _is_plain_folder(text):
        only = None  # a folder, also of one message
    options = Options(names=names, float32=float32, only=only, sources=sources, live=live)
    return kind(text.rstrip("/" + os.sep) or text, options, variants)
