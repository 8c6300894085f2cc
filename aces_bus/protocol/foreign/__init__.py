"""Files of other tools as protocols: DBC, KCD, SYM, ARXML (through cantools), CANopen's EDS and DCF (through canopen).

imported = load_database("car.dbc")
imported.protocol       a Protocol like any other: scan, encode, draw
imported.problems       what could not be taken over, with line and reason
"""

from __future__ import annotations

from pathlib import Path

from ...errors import CallerError
from .problems import Imported, Problem

#: What files are taken for, by their suffix.
SUFFIXES = (".dbc", ".kcd", ".sym", ".arxml", ".eds", ".dcf")


def load_database(path: str | Path) -> Imported:
    """A database file as a protocol, told by its suffix.

    What cannot be taken over is listed in `problems`, never dropped silently. Raises `CallerError` when the file cannot
    be read, is of none of the kinds, has nothing that can be used, or when the library that reads it is not installed.
    """
    name = str(path)
    suffix = Path(name).suffix.lower()
    if suffix in (".eds", ".dcf"):
        from .eds import load as load_eds

        return load_eds(name)
    from .dbc import FORMATS, load

    if suffix not in FORMATS:
        raise CallerError(f"{name}: not a database file by its suffix (these are: {', '.join(SUFFIXES)})")
    return load(name, FORMATS[suffix])


__all__ = ["SUFFIXES", "Imported", "Problem", "load_database"]
