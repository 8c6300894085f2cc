"""Database files that are read once for each state they are in, however often they are named."""

from __future__ import annotations

import os
from collections.abc import Callable

from ..protocol import Protocol
from . import load_database
from .problems import ImportedProtocol, ImportProblem

#: By path, time of change and size.
_read: dict[tuple[str, int, int], ImportedProtocol] = {}


def known_database(path: str, report: Callable[[ImportedProtocol], object]) -> Protocol:
    """Return the protocol of a database file; `report` is called when it is read and something of it could not be
    taken over.

    Raises as `load_database`.
    """
    try:
        status = os.stat(path)
        known = (os.path.realpath(path), status.st_mtime_ns, status.st_size)
    except (OSError, ValueError):
        known = (path, 0, -1)  # loading says what is wrong
    if known not in _read:
        imported = load_database(path)
        if imported.problems:
            report(imported)
        _read[known] = imported
    return _read[known].protocol


def problems_of(protocol: Protocol) -> list[ImportProblem]:
    """Return what could not be taken over of the file that a protocol comes from; none when it comes from no such file."""
    return [p for reading in _read.values() if reading.protocol is protocol for p in reading.problems]
