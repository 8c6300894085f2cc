"""Which of the installed protocols a recording is, before anything is guessed.

1. A protocol is tried in every dialect and configuration, on a few runs of neighbours of a recording; the best one counts.
2. What is decoded counts where its values can be (`plausible`): ODrive's identifiers are three quarters of all there are.
3. A protocol that cannot be imported is left out; `aces protocols` reports what is wrong with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

from aces_bus import FrameTable, list_protocols, load_protocol, make_column_scanner
from aces_bus._lazy import np
from aces_bus.errors import AcesError
from aces_bus.frame_table import FrameFlag
from aces_bus.protocol import Variant
from aces_bus.protocol.columns.decode import feed
from aces_bus.protocol.columns.table import Array, MessageTable

from .plausible import is_opaque, is_tested, plausible

#: Frames and bytes among which protocols are tried, where a recording is not kept; the share from which on one fits.
TRIED_FRAMES, TRIED_BYTES, FITS = 20_000, 1 << 18, 0.8
#: Frames that are tried of them, first and then, and the share of the first ones below which there is no then.
FIRST, THEN, HOPELESS = 256, 4096, 0.3
#: The share of decoded frames whose contents could have spoken against a protocol; where they are fewer, at most so many
#: frames may decode under any identifiers: otherwise the identifiers say nothing either.
TESTED, ANYWHERE = 0.2, 0.25
#: The runs of neighbours that they are taken in, evenly over all.
RUNS = 4
#: Frames that are decoded at once: tables of values are larger than frames.
AT_ONCE = 1 << 16


@dataclass(frozen=True)
class FittingProtocol:
    """A protocol and the share (0 … 1) of a recording that it decodes; `name` is what `-p` takes, and `direction` what
    `--direction` takes where bytes alone do not tell messages apart.
    """

    share: float
    name: str
    variant: Variant
    direction: Literal["both", "from", "to"] | None = None

    @property
    def options(self) -> str:
        """Options with which `aces decode` reads the recording."""
        return f"-p {self.name}" + (f" --direction {self.direction}" if self.direction else "")


def fitting_protocols(piece: FrameTable | bytes) -> list[FittingProtocol]:
    """Return the installed protocols that decode most of some CAN frames, or of the bytes of a serial line, best first.

    Where the check of one holds, none that has no check is named: any bytes behind its sync bytes are its packets.
    """
    found = sorted(_fitting(piece), key=lambda fit: -fit.share)
    if isinstance(piece, FrameTable):
        return found
    return [fit for fit in found if _has_checks(fit.variant)] or found


def _has_checks(variant: Variant) -> bool:
    framings = [message.framing for message in variant.messages.values()]
    return all(framing is not None and framing.check is not None for framing in framings)


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
            found += [
                FittingProtocol(_share(variant, piece, way), text, variant, way) for way in _ways(variant)
            ]
        best = max(found, key=lambda fit: (fit.share, fit.name, fit.direction == "both"))
        if best.share >= FITS and (not isinstance(piece, FrameTable) or _is_told(best.variant, piece)):
            yield best


_Way = Literal["both", "from", "to"] | None
_DIRECTIONS = {"both": "both", "from": "from device", "to": "to device", None: None}


def _ways(variant: Variant) -> tuple[_Way, ...]:
    """Return which way the bytes of a line may have gone, where that must be said."""
    return ("both", "from", "to") if variant.link != "can" and variant.direction_conflict else (None,)


def _scanner(variant: Variant, way: _Way = None, **keywords: Any) -> Any:
    direction: Any = "both" if variant.link == "can" else _DIRECTIONS[way]
    return make_column_scanner([variant], direction=direction, **keywords)


def _share(variant: Variant, piece: FrameTable | bytes, way: _Way) -> float:
    if isinstance(piece, FrameTable):
        first = _decoded(variant, _runs(piece, FIRST))
        return first if first < HOPELESS or len(piece) <= FIRST else _decoded(variant, _runs(piece, THEN))
    scanner = _scanner(variant, way)
    return _closed(scanner, variant, feed(scanner, piece, None))


def _decoded(variant: Variant, frames: FrameTable) -> float:
    scanner = _scanner(variant)
    return _closed(scanner, variant, scanner.feed(frames))


def _is_told(variant: Variant, piece: FrameTable) -> bool:
    """Return whether contents of CAN frames speak for a protocol, or else their identifiers: ODrive's are three quarters of
    all there are, and any eight bytes are its `Version`.
    """
    frames = _runs(piece, THEN)
    scanner = _scanner(variant)
    tested = sum(
        int(plausible(table, variant).sum())
        for table in (*scanner.feed(frames), *scanner.close())
        if table.message and is_tested(variant.messages[table.message])
    )
    if tested >= TESTED * scanner.counts.decoded:
        return True
    is_extended = frames.flags & FrameFlag.EXTENDED != 0
    anywhere = np.random.default_rng(0).integers(0, np.where(is_extended, 1 << 29, 1 << 11))
    scanner = _scanner(variant)
    scanner.feed(replace(frames, id=anywhere.astype(frames.id.dtype)))
    scanner.close()
    return bool(scanner.counts.decoded < ANYWHERE * scanner.counts.total)


def _closed(scanner: Any, variant: Variant, tables: Iterable[MessageTable]) -> float:
    """Return the share that speaks for the protocol; a packet of several frames is one of them."""
    lost = 0
    for table in (*tables, *scanner.close()):
        if table.message:
            bad = ~plausible(table, variant)
            lost += int(bad.sum()) if table.size is None else int(table.size[bad].sum())
    return float((scanner.counts.decoded - lost) / max(scanner.counts.total, 1))


def _runs(frames: FrameTable, most: int) -> FrameTable:
    """Return at most so many of the frames, in runs of neighbours: what hangs on other frames is decoded, too."""
    if len(frames) <= most:
        return frames
    starts = np.linspace(0, len(frames) - most // RUNS, RUNS).astype(int)
    return frames.take((starts[:, None] + np.arange(most // RUNS)).ravel())


def undecoded(variant: Variant, frames: FrameTable) -> Array:
    """Return the rows of `frames` that a protocol on CAN does not decode, or to bytes alone, in order; int64."""
    scanner = _scanner(variant, include_unknown=True)
    lost: list[Array] = [np.zeros(0, np.int64)]
    for start in range(0, len(frames), AT_ONCE):
        lost += _lost(scanner.feed(frames.take(slice(start, start + AT_ONCE))), variant)
    return np.unique(np.concatenate([*lost, *_lost(scanner.close(), variant)]))


def _lost(tables: list[MessageTable], variant: Variant) -> list[Array]:
    return [
        np.asarray(table.row, np.int64)
        for table in tables
        if not table.message or is_opaque(variant.messages[table.message])
    ]
