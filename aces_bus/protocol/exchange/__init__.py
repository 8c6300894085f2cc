"""Protocols in and out of other tools' files.

In: DBC, KCD, SYM, ARXML (through cantools), CANopen's EDS and DCF (through canopen), MAVLink's dialects, canboat's table of
NMEA 2000. Out: DBC, a Wireshark dissector, pages in Markdown, and a protocol as spec source.

1. What a file of the other kind cannot say is reported: an `ImportProblem` or a `Loss` each, never silence.
2. Exporters do no I/O; text of others (names, comments, units) reaches printed source as literals only.

imported = load_database("car.dbc")
imported.protocol       a Protocol like any other: scan, encode, draw
imported.problems       what could not be taken over, with line and reason
"""

from __future__ import annotations

import os

from ...errors import CallerError
from .problems import ImportedProtocol, ImportProblem, Loss

#: What files are taken for, by their suffix.
SUFFIXES = (".dbc", ".kcd", ".sym", ".arxml", ".eds", ".dcf", ".xml", ".json")


def load_database(path: str | os.PathLike[str]) -> ImportedProtocol:
    """Return a database file as a protocol; its suffix says of which kind it is.

    What cannot be taken over is listed in `problems`, never dropped silently. Raises `CallerError` when the file cannot
    be read, is of none of the kinds, has nothing that can be used, or when the library that reads it is not installed.
    """
    name = os.fspath(path)
    suffix = os.path.splitext(name)[1].lower()
    if suffix in (".eds", ".dcf"):
        from .import_eds import load_eds

        return load_eds(name)
    if suffix == ".json":
        from .import_canboat import load_canboat

        return load_canboat(name)
    if suffix == ".xml":
        from .import_mavlink import load_mavlink

        return load_mavlink(name)
    from .import_dbc import FORMATS, load_dbc

    if suffix not in FORMATS:
        raise CallerError(f"{name}: not a database file by its suffix (these are: {', '.join(SUFFIXES)})")
    return load_dbc(name, FORMATS[suffix])


__all__ = ["SUFFIXES", "ImportProblem", "ImportedProtocol", "Loss", "load_database"]
