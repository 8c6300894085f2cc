"""Which of the installed protocols a recording is, before anything is guessed.

1. A protocol is tried in every dialect and configuration, on the first piece of a recording; the best one counts.
2. A protocol that cannot be imported is left out; `aces protocols` reports what is wrong with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

from .._lazy import np
from ..errors import AcesError
from ..frame_table import FrameTable
from ..protocol import Variant, list_protocols, load_protocol
from ..protocol.columns.decode import feed
from ..protocol.columns.scanner import make_column_scanner
from .fields import Array

#: Frames and bytes on which protocols are tried; the share from which on one fits.
TRIED_FRAMES, TRIED_BYTES, FITS = 20_000, 1 << 18, 0.8
#: Frames that are tried first, and the share of them below which a protocol is not tried on more.
FIRST, HOPELESS = 1000, 0.3


@dataclass(frozen=True)
class FittingProtocol:
    """A protocol and the share (0 … 1) of a recording that it decodes; `name` is what `-p` takes."""

    share: float
    name: str
    variant: Variant


def fitting_protocols(piece: FrameTable | bytes) -> list[FittingProtocol]:
    """The installed protocols that decode most of some CAN frames, or of the bytes of a serial line, best first."""
    return sorted(_fitting(piece), key=lambda one: -one.share)


def _fitting(piece: FrameTable | bytes) -> Iterator[FittingProtocol]:
    for name in list_protocols():
        try:
            protocol = load_protocol(name)
        except AcesError:
            continue
        if (protocol.link == "can") != isinstance(piece, FrameTable):
            continue
        found: list[FittingProtocol] = []
        for dialect, configuration in product(protocol.dialects or [""], protocol.configurations or [""]):
            text = name + (f":{dialect}" if dialect and dialect != protocol.dialect else "")
            text += f"@{configuration}" if configuration else ""
            variant = protocol.variant(dialect or None, configuration or None)
            found.append(FittingProtocol(_share(variant, piece), text, variant))
        best = max(found, key=lambda one: (one.share, one.name))
        if best.share >= FITS:
            yield best


def _scanner(variant: Variant, **keywords: Any) -> Any:
    direction: Any = "both" if variant.link == "can" or variant.direction_conflict else None
    return make_column_scanner([variant], direction=direction, **keywords)


def _share(variant: Variant, piece: Any) -> float:
    if isinstance(piece, FrameTable) and len(piece) > 2 * FIRST:
        first = _share(variant, piece.take(slice(0, FIRST)))
        if first < HOPELESS:
            return first
    scanner = _scanner(variant)
    scanner.feed(piece) if variant.link == "can" else feed(scanner, piece, None)
    scanner.close()
    return float(scanner.counts.decoded / max(scanner.counts.total, 1))


def undecoded(variant: Variant, frames: FrameTable) -> Array:
    """The rows of `frames` that a protocol on CAN does not decode, in order; int64."""
    scanner = _scanner(variant, include_unknown=True)
    tables = [*scanner.feed(frames), *scanner.close()]
    lost = [np.asarray(table.row, np.int64) for table in tables if not table.message]
    return np.unique(np.concatenate(lost)) if lost else np.zeros(0, np.int64)
