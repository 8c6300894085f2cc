"""Plays a scene to a scanner and to the reference, and brings what both say into one form.

1. Values are compared by bits: NaN equals itself, 1 does not equal 1.0, a flag set is its number.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..protocol.counts import ScanCounts
from ..protocol.declare.packet import can_image
from ..protocol.live.scanner import Scanner
from ..protocol.record import Unknown, as_dict
from ..protocol.reference import Reference
from ._bench import bench_of
from ._scenes import Scene, Way, Wire


@dataclass(frozen=True)
class ScannedItem:
    """One thing on the wire: a message with its fields, or a loss with its reason. Sizes in bytes, or 1 frame."""

    offset: int
    size: int
    message: str | None
    fields: Any
    reason: str
    protocol: str | None

    def __str__(self) -> str:
        where = f"{self.offset}…{self.offset + self.size}"
        return (
            f"{where} {self.protocol}.{self.message} {self.fields}"
            if self.message
            else f"{where} {self.reason}"
        )


def scanner_of(wire: Wire, direction: Way, *, include_unknown: bool = True, raw: bool = True) -> Scanner:
    """A scanner as if just made."""
    return bench_of(wire, direction).scanner(include_unknown=include_unknown, raw=raw)


def play(scanner: Scanner, scene: Scene, cuts: Iterable[int] = ()) -> list[Any]:
    """Feed a scene, cut at `cuts`, with its silences and transmissions, and close: everything the scanner gave."""
    out: list[Any] = []
    events: list[tuple[int, int, Any]] = [(offset, 0, None) for offset in cuts]
    events += [(offset, 1, None) for offset in scene.idle_at]
    events += [(offset, 2, word) for offset, word in scene.sent_at]
    events.sort(key=lambda event: event[:2])
    at = 0
    feed: Any = scanner.feed
    sent: Any = scanner.sent
    for offset, kind, word in events:
        if offset > at or kind == 0:
            out += feed(scene.words[at:offset])
            at = max(at, offset)
        if kind == 1:
            out += scanner.idle()
        elif kind == 2:
            sent(word)
    out += feed(scene.words[at:])
    return out + scanner.close()


def scanned_items(scanner: Scanner, scene: Scene, cuts: Iterable[int] = ()) -> list[ScannedItem]:
    """What a scanner hears in a scene, in its form for comparison."""
    return as_heard(play(scanner, scene, cuts), scanner.link == "can")


def as_heard(given: Iterable[Any], is_can: bool) -> list[ScannedItem]:
    """What a scanner gave, in its form for comparison."""
    if is_can:
        return [_heard(item, number, 1) for number, item in enumerate(given)]
    return join_losses(_heard(item, item.meta.offset, item.meta.size) for item in given)


def _heard(item: Any, offset: int, size: int) -> ScannedItem:
    if isinstance(item, Unknown):
        return ScannedItem(offset, size, None, None, item.reason, None)
    return ScannedItem(offset, size, type(item).__name__, comparable(as_dict(item)), "", item.meta.protocol)


def reference_items(wire: Wire, direction: Way, scene: Scene, *, raw: bool = True) -> list[ScannedItem]:
    """What the reference says of a scene."""
    return told_by(bench_of(wire, direction).reference(raw=raw), scene)


def told_by(reference: Reference, scene: Scene) -> list[ScannedItem]:
    """What this reference says of a scene."""
    if isinstance(scene.words, bytes):
        found = reference.stream(scene.words, idle_at=scene.idle_at, sent_at=scene.sent_at)
        return join_losses(
            ScannedItem(f.offset, f.size, f.message, comparable(f.fields), f.reason, f.protocol)
            for f in found
        )
    out: list[ScannedItem] = []
    at = 0
    for offset, frame in [*scene.sent_at, (len(scene.words), None)]:
        for f in reference.frames(scene.words[at:offset]):
            out.append(ScannedItem(len(out), 1, f.message, comparable(f.fields), f.reason, f.protocol))
        at = offset
        if frame is not None:
            reference.sent(image_of(frame), frame.channel, frame.timestamp)
    return out


def join_losses(items: Iterable[ScannedItem]) -> list[ScannedItem]:
    """Runs of lost bytes with one reason, as one each: where a run is cut means nothing."""
    out: list[ScannedItem] = []
    for item in items:
        last = out[-1] if out else None
        is_run = item.message is None and item.reason.startswith(("skipped", "malformed"))
        if (
            is_run
            and last is not None
            and last.reason == item.reason
            and last.offset + last.size == item.offset
        ):
            out[-1] = replace(last, size=last.size + item.size)
        else:
            out.append(item)
    return out


def image_of(frame: Any) -> bytes:
    """The image of a CAN frame that `message.struct` parses."""
    return can_image(
        frame.arbitration_id,
        bytes(frame.data),
        extended=frame.is_extended_id,
        remote=frame.is_remote_frame,
        fd=frame.is_fd,
    )


def comparable(value: Any) -> Any:
    """A value for comparison by bits: floats as their bytes, sequences as lists, numbers of every kind as int."""
    if isinstance(value, float):
        return struct.pack("<d", value)[::-1].hex() + "f"
    if isinstance(value, Mapping):
        return {k: comparable(v) for k, v in value.items() if not str(k).startswith("_")}
    if isinstance(value, (list, tuple)):
        return [comparable(item) for item in value]
    if isinstance(value, int):
        return int(value)
    return value


def copy_item(counts: ScanCounts) -> dict[str, Any]:
    """Counts as plain values."""
    bins = (
        "total",
        "decoded",
        "unknown",
        "malformed",
        "skipped",
        "filtered",
        "errors",
        "pending",
        "records",
        "missed",
    )
    return {**{name: getattr(counts, name) for name in bins}, "reasons": dict(counts.reasons)}


__all__ = [
    "ScannedItem",
    "as_heard",
    "comparable",
    "copy_item",
    "image_of",
    "join_losses",
    "play",
    "reference_items",
    "scanned_items",
    "scanner_of",
    "told_by",
]
