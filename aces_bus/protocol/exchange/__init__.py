"""Protocols in and out of other tools' files.

In: DBC, KCD, SYM, ARXML (through cantools), and other databases by entry point. Out: DBC, and a protocol as spec source.

1. What a file of the other kind cannot say is reported: an `ImportProblem` or a `Loss` each, never silence.
2. Exporters do no I/O; text of others (names, comments, units) reaches printed source as literals only.
3. A kind of database is a `DatabaseFormat`: the core's are in `FORMATS`, others are entry points of the group
   `aces_bus.databases`. Its module is imported when a file of it is read.

imported = load_database("car.dbc")
imported.protocol       a Protocol like any other: scan, encode, draw
imported.problems       what could not be taken over, with line and reason
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

from ..._lazy import lazy_names
from ...errors import CallerError
from ...plugins import installed_items
from .problems import ImportedProtocol

if TYPE_CHECKING:
    from .export_dbc import print_dbc
    from .export_source import print_source


class DatabaseFormat(NamedTuple):
    """A kind of database; an entry point of the group `aces_bus.databases` is one, or a tuple of them.

    `place` is that of a function which makes an `ImportedProtocol` of a path (`their_package.module:load_theirs`), and
    raises `CallerError` for a file that cannot be read or has nothing that can be used.
    """

    name: str
    suffixes: tuple[str, ...]
    place: str

    def load(self, path: str) -> ImportedProtocol:
        """Read a file of this kind."""
        module, _, name = self.place.partition(":")
        load: Callable[[str], ImportedProtocol] = getattr(import_module(module, __package__), name)
        return load(path)


#: The core's kinds, all read by cantools.
FORMATS: tuple[DatabaseFormat, ...] = (
    DatabaseFormat("cantools", (".dbc", ".kcd", ".sym", ".arxml"), ".import_dbc:load_dbc"),
)


def database_formats() -> tuple[DatabaseFormat, ...]:
    """Return all kinds of databases, those of installed packages behind the core's."""
    return FORMATS + installed_items("aces_bus.databases", DatabaseFormat)


def database_suffixes() -> tuple[str, ...]:
    """Return the suffixes of all kinds of databases."""
    return tuple(suffix for form in database_formats() for suffix in form.suffixes)


def load_database(path: str | os.PathLike[str]) -> ImportedProtocol:
    """Return a database file as a protocol; its suffix says of which kind it is.

    What cannot be taken over is listed in `problems`, never dropped silently. Raises `CallerError` when the file cannot
    be read, is of none of the kinds, has nothing that can be used, or when the library that reads it is not installed.
    """
    name = os.fspath(path)
    suffix = os.path.splitext(name)[1].lower()
    for form in database_formats():
        if suffix in form.suffixes:
            return form.load(name)
    raise CallerError(
        f"{name}: not a database file by its suffix (these are: {', '.join(database_suffixes())})"
    )


__all__ = [
    "load_database",
    "print_dbc",
    "print_source",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".export_dbc": "print_dbc",
        ".export_source": "print_source",
    },
)
