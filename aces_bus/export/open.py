"""Formats of decoded tables, chosen by the suffix of a path.

1. A format is a `TableFormat`: the core's are in `FORMATS`, others are entry points of the group `aces_bus.exporters`.
2. A format's module and libraries are imported when it is written; a missing library is named with the extra that has it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

from ..errors import CallerError, UnknownNameError
from ..plugins import installed_items
from ..protocol.declare.protocol import Variant

if TYPE_CHECKING:
    from .base import Export, Options


class TableFormat(NamedTuple):
    """A format of decoded tables; an entry point of the group `aces_bus.exporters` is one, or a tuple of them.

    `suffixes` choose it. `place` is the module and the class that writes (`their_package.module:TheirExport`), an `Export`
    made of a path, `Options` and variants. `growing` is the place of the class that writes while the export grows, whose
    committed rows survive a kill; "" for a format that needs its end.
    """

    name: str
    suffixes: tuple[str, ...]
    place: str
    growing: str = ""

    def open(self, path: str, options: Options, variants: Sequence[Variant]) -> Export:
        """Open an export of this format."""
        module, _, name = (self.growing if options.live else self.place).partition(":")
        kind: type[Export] = getattr(import_module(module, __package__), name)
        return kind(path, options, variants)


#: The core's formats; CSV is a folder, and only where the path ends in a slash: `walk.csv/`.
FORMATS: tuple[TableFormat, ...] = (
    TableFormat("parquet", (".parquet", ".pq"), ".parquet:ParquetExport", ".parquet_parts:ParquetParts"),
    TableFormat("arrow", (".arrow", ".ipc"), ".folder:ArrowExport"),
    TableFormat("feather", (".feather",), ".folder:FeatherExport"),
    TableFormat("csv", (), ".csv:CsvExport"),
    TableFormat("sqlite", (".sqlite", ".sqlite3", ".db"), ".sqlite:SqliteExport", ".sqlite:SqliteExport"),
)


def table_formats() -> Mapping[str, TableFormat]:
    """Return all formats by name, those of installed packages behind the core's, whose names they cannot take."""
    installed = installed_items("aces_bus.exporters", TableFormat)
    core = {form.name: form for form in FORMATS}
    return core | {form.name: form for form in installed if form.name not in core}


def table_suffixes(*, growing: bool = False) -> Mapping[str, str]:
    """Return the suffixes with the names of their formats: all, or those of formats that grow. The core's stay its own."""
    found: dict[str, str] = {}
    for form in table_formats().values():
        for suffix in form.suffixes if form.growing or not growing else ():
            found.setdefault(suffix, form.name)
    return found


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
    return table_suffixes().get(suffix)


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

    `format` is a name of `table_formats()`: "parquet", "arrow", "feather", "csv", "sqlite", and "npz" and "mcap" of the lab;
    by default the suffix says it.
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
            f"{text}: its suffix says no format; use one of {', '.join(table_suffixes())}, or .csv/ for a folder"
        )
    known = table_formats()
    if chosen not in known:
        raise UnknownNameError("format", chosen, known)
    if text == "-":
        raise CallerError(f"{chosen} goes to a file or folder and not to standard output; name one")
    if live and not known[chosen].growing:
        grow = ", ".join(form.name for form in known.values() if form.growing)
        raise CallerError(
            f"{text}: {chosen} needs its end, and cannot be written while it grows; there are {grow}"
        )
    from .base import Options

    if _is_plain_folder(text):
        only = None  # a folder, also of one message
    options = Options(names=names, float32=float32, only=only, sources=sources, live=live)
    return known[chosen].open(text.rstrip("/" + os.sep) or text, options, variants)
