"""Recordings decoded as a whole into columns.

1. Everything is in memory; a larger recording goes piece by piece, as `aces decode -o` does.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from contextlib import ExitStack
from itertools import chain
from typing import Any, BinaryIO, TypeGuard

from ..errors import CallerError
from ..protocol.columns.decode import decode_tables
from ..protocol.declare.message import GivenWay
from ..protocol.declare.protocol import Configuration
from ..protocol.exchange import database_suffixes, load_database
from ..protocol.files import load_protocol
from ..protocol.protocol import Protocol
from .base import CanRecording, Recording, SerialRecording
from .decoded import DecodedRecording
from .merge import Merge
from .open import open_recording
from .source import PathSource


def decode(
    source: PathSource | BinaryIO | Iterable[Any],
    protocol: Protocol | str,
    *,
    message: str | Iterable[str] | None = None,
    dialect: str | None = None,
    configuration: str | Configuration | None = None,
    direction: GivenWay | None = None,
    include_unknown: bool = False,
    raw: bool = False,
) -> DecodedRecording:
    """Return all messages of a recording as columns: `decode("walk.log", hubo)["Encoder"]["position.0"].values`.

    `source` is a path, "-" or an open file; a list of paths, which are read as one recording (on CAN by time, bytes one
    after the other); or what is open or in memory already: a recording, frames (also python-can's), frame tables, bytes.
    `protocol` is a protocol, the name of an installed one, or the path of a Python file that declares it (`lamp.py`) or of
    a database (`car.dbc`, …; a warning says what could not be taken over).

    `message` limits what is kept to one or several messages; the counts stay those of the whole. `dialect` and
    `configuration` choose the protocol's variant. `direction` is that of a stream which does not say it: "to device"
    ("to"), "from device" ("from") or "both". With `include_unknown`, what was not decoded is the table named "". `raw`
    leaves out units, scales and names.
    What of the files could not be read, the result's `recordings` say: `lines_unreadable`, `problems`, `others`.

    Raises `CaptureError` for what is no such recording, `UnknownNameError` for names that do not exist, `CallerError`
    where bytes alone do not tell messages apart and no direction is given.
    """
    if isinstance(protocol, str):
        if protocol.lower().endswith(database_suffixes()):
            imported = load_database(protocol)
            if imported.problems:
                warnings.warn(imported.summary, stacklevel=2)
            protocol = imported.protocol
        else:
            protocol = load_protocol(protocol)
    variant = protocol.variant(dialect, configuration)
    if protocol.link == "datagram":
        raise CallerError(
            f"{protocol.name} is a protocol on datagrams, and there is no capture format for them yet"
        )
    with ExitStack() as stack:
        opened: list[Recording] = []
        capture: Any = source
        if _is_path(source):
            opened = [stack.enter_context(open_recording(source, link=protocol.link))]
            capture = opened[0]
        elif isinstance(source, (list, tuple)) and source and all(map(_is_path, source)):
            opened = [stack.enter_context(open_recording(path, link=protocol.link)) for path in source]
            capture = (
                Merge.by_time([one.tables() for one in opened if isinstance(one, CanRecording)])
                if protocol.link == "can"
                else chain.from_iterable(one for one in opened if isinstance(one, SerialRecording))
            )
        tables, counts = decode_tables(
            variant, capture, message=message, direction=direction, include_unknown=include_unknown, raw=raw
        )
    return DecodedRecording(variant, tables, counts, tuple(opened))


def _is_path(source: object) -> TypeGuard[PathSource | BinaryIO]:
    return isinstance(source, (str, os.PathLike)) or hasattr(source, "read")


__all__ = ["decode"]
