"""A recording by its path, decoded as a whole into columns.

1. Everything is in memory; a larger recording goes piece by piece, as `aces decode -o` does.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import BinaryIO, Literal

from ..errors import CallerError
from ..protocol.scan.decoded import Decoded
from ..protocol.scan.scanner import load_protocol
from ..protocol.spec.message import Direction
from ..protocol.spec.protocol import Configuration, Protocol
from ._source import PathSource
from .open import open_capture


def decode(
    source: PathSource | BinaryIO,
    protocol: Protocol | str,
    *,
    message: str | Iterable[str] | None = None,
    dialect: str | None = None,
    configuration: str | Configuration | None = None,
    direction: Direction | Literal["both"] | None = None,
    everything: bool = False,
) -> Decoded:
    """All messages of a recording as columns: `decode("walk.log", hubo)["Encoder"]["position.0"].values`.

    `source` is a path, "-" or an open file, `protocol` a protocol or the name of an installed one; the others are
    arguments of `Protocol.decode`.

    Raises `CaptureError` for what is no such recording, `UnknownNameError` for names that do not exist, `CallerError`
    where bytes alone do not tell messages apart and no direction is given.
    """
    if isinstance(protocol, str):
        protocol = load_protocol(protocol)
    if protocol.link == "datagram":
        raise CallerError(
            f"{protocol.name} is a protocol on datagrams, and there is no capture format for them yet"
        )
    with open_capture(source, link=protocol.link) as capture:
        return protocol.decode(
            capture,
            message=message if message is None or isinstance(message, str) else list(message),
            dialect=dialect,
            configuration=configuration,
            direction=direction,
            everything=everything,
        )


__all__ = ["decode"]
