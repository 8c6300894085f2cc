"""A recording by its path, decoded as a whole into columns.

1. Everything is in memory; a larger recording goes piece by piece, as `aces decode -o` does.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from typing import BinaryIO

from ..errors import CallerError
from ..protocol.columns.decode import DecodedRecording
from ..protocol.declare.message import GivenWay
from ..protocol.declare.protocol import Configuration
from ..protocol.exchange import database_suffixes, load_database
from ..protocol.files import load_protocol
from ..protocol.protocol import Protocol
from .open import open_recording
from .source import PathSource


def decode(
    source: PathSource | BinaryIO,
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

    `source` is a path, "-" or an open file; `protocol` a protocol, the name of an installed one, or the path of a Python
    file that declares it (`lamp.py`) or of a database (`car.dbc`, …; a warning says what could not be taken over). The
    others are arguments of `Protocol.decode`.
    What of the recording could not be read, the result's `capture` says: `lines_unreadable`, `problems`, `others`.

    Raises `CaptureError` for what is no such recording, `UnknownNameError` for names that do not exist, `CallerError`
    where bytes alone do not tell messages apart and no direction is given.
    """
    if isinstance(source, (list, tuple, set)):
        raise CallerError(
            "decode reads one recording: [decode(path, protocol) for path in paths] reads several, and"
            " `aces decode FILE FILE …` does"
        )
    if isinstance(protocol, str):
        if protocol.lower().endswith(database_suffixes()):
            imported = load_database(protocol)
            if imported.problems:
                warnings.warn(imported.summary, stacklevel=2)
            protocol = imported.protocol
        else:
            protocol = load_protocol(protocol)
    if protocol.link == "datagram":
        raise CallerError(
            f"{protocol.name} is a protocol on datagrams, and there is no capture format for them yet"
        )
    with open_recording(source, link=protocol.link) as capture:
        decoded = protocol.decode(
            capture,
            message=message if message is None or isinstance(message, str) else list(message),
            dialect=dialect,
            configuration=configuration,
            direction=direction,
            include_unknown=include_unknown,
            raw=raw,
        )
    decoded.capture = capture
    return decoded


__all__ = ["decode"]
