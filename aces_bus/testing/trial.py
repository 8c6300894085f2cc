"""One scene before the laws: what scanner, reference and construct make of it, each asked once and only when a law asks.

1. A trial is a pure function of bench, scene and cuts; laws that judge the same trial share what was played.
2. Values are compared by bits: NaN equals itself, 1 does not equal 1.0, a flag set is its number.
3. A broken law is a `LawError`, with everything that it takes to show and repeat it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NoReturn, TypeVar
from zlib import crc32

from ..protocol import Record
from ..protocol.counts import ScanCounts
from ..protocol.declare.message import Message
from ..protocol.declare.packet import can_image
from ..protocol.live.scanner import Scanner
from ..protocol.record import FieldValue, PlainValue, Unknown, as_dict
from ..protocol.reference import Reference
from .bench import Bench, bench_of
from .scenes import Scene, Way, Wire

T = TypeVar("T")

#: The laws by number.
NAMES = {
    1: "round trip",
    2: "oracle",
    3: "chunking",
    4: "resynchronisation",
    5: "no false accept",
    6: "accounting",
    7: "bounded",
    8: "calm",
    9: "unambiguous",
}


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
    """Return a scanner as if just made."""
    return bench_of(wire, direction).scanner(include_unknown=include_unknown, raw=raw)


def play(scanner: Scanner, scene: Scene, cuts: Iterable[int] = ()) -> list[Any]:
    """Feed a scene, cut at `cuts`, with its silences and transmissions, and close: everything the scanner gave."""
    out: list[Record] = []
    events: list[tuple[int, int, Any]] = [(offset, 0, None) for offset in cuts]
    events += [(offset, 1, None) for offset in scene.idle_at]
    events += [(offset, 2, packet) for offset, packet in scene.sent_at]
    events.sort(key=lambda event: event[:2])
    at = 0
    feed: Any = scanner.feed
    sent: Any = scanner.sent
    for offset, kind, packet in events:
        if offset > at or kind == 0:
            out += feed(scene.traffic[at:offset])
            at = max(at, offset)
        if kind == 1:
            out += scanner.idle()
        elif kind == 2:
            sent(packet)
    out += feed(scene.traffic[at:])
    return out + scanner.close()


def scanned_items(scanner: Scanner, scene: Scene, cuts: Iterable[int] = ()) -> list[ScannedItem]:
    """Return what a scanner gives of a scene, in its form for comparison."""
    return as_items(play(scanner, scene, cuts), scanner.link == "can")


def as_items(given: Iterable[Any], is_can: bool) -> list[ScannedItem]:
    """Return what a scanner gave, in its form for comparison."""
    if is_can:
        return [_item(item, number, max(1, len(item.meta.frames))) for number, item in enumerate(given)]
    return join_losses(_item(item, item.meta.offset, item.meta.size) for item in given)


def _item(item: Any, offset: int, size: int) -> ScannedItem:
    if isinstance(item, Unknown):
        return ScannedItem(offset, size, None, None, item.reason, None)
    return ScannedItem(offset, size, type(item).__name__, comparable(as_dict(item)), "", item.meta.protocol)


def reference_items(wire: Wire, direction: Way, scene: Scene, *, raw: bool = True) -> list[ScannedItem]:
    """Return what the reference says of a scene."""
    return items_by(bench_of(wire, direction).reference(raw=raw), scene)


def items_by(reference: Reference, scene: Scene) -> list[ScannedItem]:
    """Return what this reference says of a scene."""
    if isinstance(scene.traffic, bytes):
        found = reference.stream(scene.traffic, idle_at=scene.idle_at, sent_at=scene.sent_at)
        return join_losses(
            ScannedItem(f.offset, f.size, f.message, comparable(f.fields), f.reason, f.protocol)
            for f in found
        )
    out: list[ScannedItem] = []
    at = 0
    for offset, frame in [*scene.sent_at, (len(scene.traffic), None)]:
        found = reference.frames(scene.traffic[at:offset])
        for f in [*found, *(reference.end() if frame is None else ())]:
            out.append(ScannedItem(len(out), f.size, f.message, comparable(f.fields), f.reason, f.protocol))
        at = offset
        if frame is not None:
            reference.sent_frame(frame)
    return out


def join_losses(items: Iterable[ScannedItem]) -> list[ScannedItem]:
    """Join runs of lost bytes that have one reason: where a run is cut means nothing."""
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


def record_image(record: Record) -> bytes:
    """Return the image that a record was read from."""
    meta = record.meta
    if meta.identifier is None:
        return bytes(meta.raw)
    return can_image(meta.identifier, meta.raw, extended=meta.extended, remote=meta.remote, fd=meta.fd)


def comparable(value: FieldValue) -> Any:
    """Return a value for comparison by bits: floats as their bytes, sequences as lists, numbers of every kind as int."""
    if isinstance(value, float):
        return struct.pack("<d", value)[::-1].hex() + "f"
    if isinstance(value, Mapping):
        return {k: comparable(v) for k, v in value.items() if not str(k).startswith("_")}
    if isinstance(value, (list, tuple)):
        return [comparable(item) for item in value]
    if isinstance(value, int):
        return int(value)
    return value


def as_given(found: object, given: object) -> object:
    """Return what was found, as far as it was given: numbers that are rebuilt when sending are left out, at any depth."""
    if isinstance(found, dict) and isinstance(given, dict):
        return {k: as_given(found.get(k), v) for k, v in given.items()}
    if isinstance(found, list) and isinstance(given, list) and len(found) == len(given):
        return [as_given(one, other) for one, other in zip(found, given, strict=True)]
    return found


def plain_counts(counts: ScanCounts) -> dict[str, PlainValue]:
    """Return counts as plain values."""
    bins = (
        "total",
        "decoded",
        "control",
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


class LawError(AssertionError):
    """A law does not hold. `text` says what was expected and what came; `scene` and `cuts` repeat it."""

    def __init__(self, number: int, trial: Trial, text: str, *, with_scene: bool = True) -> None:
        self.number, self.law, self.text = number, NAMES[number], text
        self.wire, self.direction = trial.bench.wire, trial.bench.direction
        self.label = trial.bench.label
        self.scene, self.cuts = trial.scene, trial.cuts
        where = f"\n  scene: {scene_source(trial.scene)}" if with_scene else ""
        super().__init__(
            f"law {number} ({self.law}) of {self.label}, direction {self.direction!r}: {text}{where}"
        )


def scene_source(scene: Scene) -> str:
    """Return a scene as it is written in a test."""
    if isinstance(scene.traffic, bytes):
        traffic = f"bytes.fromhex({scene.traffic.hex(' ').upper()!r})"
        sent = tuple((at, f"bytes.fromhex({packet.hex(' ').upper()!r})") for at, packet in scene.sent_at)
        return f"Scene({traffic}, idle_at={scene.idle_at}, sent_at={sent})"
    return f"Scene(({', '.join(map(repr, scene.traffic))},), sent_at={scene.sent_at!r})"


class Trial:
    """A scene, cut at `cuts`, before a bench.

    `thorough` has laws look at every packet of a scene, `columns` has them read it as columns, too: both cost more than
    all the rest. A fuzzer does that now and then, and always for what has failed.
    """

    def __init__(
        self,
        bench: Bench,
        scene: Scene,
        cuts: Iterable[int] = (),
        *,
        thorough: bool = True,
        columns: bool = True,
    ) -> None:
        self.bench, self.scene = bench, scene
        self.cuts = tuple(sorted(cuts))
        self.thorough, self.columns = thorough, columns

    @property
    def direction(self) -> Way:
        return self.bench.direction

    def fail(self, number: int, text: str, *, with_scene: bool = True) -> NoReturn:
        """Raise `LawError`."""
        raise LawError(number, self, text, with_scene=with_scene)

    def sample(self, items: Sequence[T]) -> Sequence[T]:
        """Return all of them; of a trial that is not thorough, one."""
        if self.thorough or len(items) < 2:
            return items
        at = self.turn % len(items)
        return items[at : at + 1]

    @cached_property
    def turn(self) -> int:
        """A number that a scene has from its traffic: what is looked at when not everything is."""
        traffic = self.scene.traffic
        if isinstance(traffic, bytes):
            return crc32(traffic)
        return sum(crc32(frame.data, frame.arbitration_id) for frame in traffic)

    # ------------------------------------------------------------------ played

    @cached_property
    def _whole(self) -> tuple[list[Any], dict[str, PlainValue], int]:
        scanner = self.bench.scanner()
        given = play(scanner, self.scene)
        return given, plain_counts(scanner.counts), scanner.counts.balance

    @property
    def given(self) -> list[Any]:
        """Items that a scanner gives for the whole scene: raw records and all losses."""
        return self._whole[0]

    @property
    def counts(self) -> dict[str, PlainValue]:
        """Its counts."""
        return self._whole[1]

    @cached_property
    def scanned(self) -> list[ScannedItem]:
        """The same for comparison."""
        return as_items(self.given, self.bench.is_can)

    @cached_property
    def cut_up(self) -> tuple[list[Any], dict[str, PlainValue], int]:
        """Items that the scanner gives for the scene in pieces, its counts, and their imbalance."""
        scanner = self.bench.scanner()
        given = play(scanner, self.scene, self.cuts)
        return given, plain_counts(scanner.counts), scanner.counts.balance

    @cached_property
    def physical(self) -> list[ScannedItem]:
        """Items that a scanner for physical values gives for the whole scene."""
        return as_items(play(self.bench.scanner(raw=False), self.scene), self.bench.is_can)

    @cached_property
    def expected(self) -> list[ScannedItem]:
        """Items that the reference gives for the whole scene."""
        return items_by(self.bench.reference(), self.scene)

    def accepted(self) -> Iterator[tuple[Message, bytes, dict[str, FieldValue]]]:
        """Return message, image and request's fields of each record that the scanner gave."""
        names = self.bench.by_name
        for record in self.given:
            if isinstance(record, Unknown):
                continue
            message = names[record._protocol, type(record).__name__]
            yield (
                message,
                record_image(record),
                {name: getattr(record, name) for name in message.request_fields},
            )


Judge = Callable[[Trial], None]


@dataclass(frozen=True)
class Law:
    """A law by its number. Called with wire, direction, scene (and cuts) it raises `LawError` when it does not hold.

    `judges` asks it of a `Trial`, which several laws may share. `takes_cuts`: it also depends on where a scene is cut.
    `streams_only`: it is about streams, because a frame comes whole.
    """

    number: int
    judges: Judge
    takes_cuts: bool = False
    streams_only: bool = False

    def __call__(self, wire: Wire, direction: Way, scene: Scene, cuts: Iterable[int] = ()) -> None:
        self.judges(Trial(bench_of(wire, direction), scene, cuts))

    @property
    def name(self) -> str:
        return NAMES[self.number]

    def __str__(self) -> str:
        return f"{self.number}-{self.name.replace(' ', '-')}"


def law(number: int, *, takes_cuts: bool = False, streams_only: bool = False) -> Callable[[Judge], Law]:
    """Return a decorator that makes a law of a function of a `Trial`."""
    return lambda judges: Law(number, judges, takes_cuts, streams_only)


__all__ = [
    "NAMES",
    "Judge",
    "Law",
    "LawError",
    "ScannedItem",
    "Trial",
    "as_items",
    "comparable",
    "items_by",
    "join_losses",
    "law",
    "plain_counts",
    "play",
    "record_image",
    "reference_items",
    "scanned_items",
    "scanner_of",
    "scene_source",
]
