"""Two recordings, or two times of one, read into profiles and compared.

1. Each file is read once, front to back. All of it is decoded, so that replies find their requests, and only what is inside
   a side's windows is counted for it.
2. Where nothing says when A is, it is all of the recording that is not B.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np

from aces_bus import FrameTable, load_protocol, make_column_scanner, open_recording
from aces_bus.errors import CallerError
from aces_bus.frame_table import NO_TIME, Ints, joined_tables, to_ns
from aces_bus.protocol import Protocol, Variant
from aces_bus.protocol.columns.decode import feed
from aces_bus.protocol.columns.table import Array, MessageTable
from aces_bus.protocol.exchange import database_suffixes, load_database
from aces_bus.recordings.base import CanRecording, SerialRecording
from aces_bus.recordings.filters import CanFilter, passing
from aces_bus.recordings.source import PathSource
from aces_tools.reading.pieces import Direction, SerialWays
from aces_tools.reading.window import TimeWindow

from .changes import TrafficChange, traffic_changes
from .exposure import Exposure, WatchedTime
from .signal_changes import message_changes
from .signals import MessageProfile
from .traffic import TrafficProfile

#: Seconds from the first frame of the recording, or since 1970 from 1e8 on; None is open.
Span = tuple[float | None, float | None]
#: Frames that are counted at once, at least.
PIECE = 1 << 17
#: A change that is less telling is left out by default.
LEAST = 0.2


class ComparedSide:
    """One of the two: its windows, and what was counted in them. Without windows it is the whole recording, with `rest_of`
    what is in none of the other's windows."""

    def __init__(
        self,
        windows: Sequence[TimeWindow] = (),
        variants: Sequence[Variant] = (),
        rest_of: ComparedSide | None = None,
    ) -> None:
        self.windows = list(windows)
        self.rest_of = rest_of
        number = len(rest_of.windows) + 1 if rest_of is not None else max(1, len(self.windows))
        self.watched = WatchedTime(number)
        self.traffic = TrafficProfile(number)
        self.messages = MessageProfile(variants)
        self.untimed = 0

    @property
    def is_windowed(self) -> bool:
        """True if this side is only a part of its recording."""
        return bool(self.windows) or self.rest_of is not None

    def places(self, times: Ints) -> Ints:
        """Return the window that each instant is in, -1 for none. What is left beside the other's windows is numbered
        by how many of these are over, so that nothing is counted across them."""
        if self.rest_of is not None:
            others = self.rest_of.places(times)
            ends = sorted(stop for window in self.rest_of.windows if (stop := window.bounds[1]) is not None)
            parts = np.searchsorted(np.array(ends, np.int64), times, side="right")
            return np.where((others < 0) & (times != NO_TIME), parts, -1)
        if not self.windows:
            return np.zeros(len(times), np.int64)
        found = np.full(len(times), -1, np.int64)
        for number, window in enumerate(self.windows):
            found[window.inside(times) & (found < 0)] = number
        return found

    def begin(self) -> None:
        """Begin another recording, with a first instant of its own."""
        for window in self.windows:
            window.begin()


@dataclass
class RecordingComparison:
    """What came out. `changes` are the most telling ones first; `weaker` counts those that were left out."""

    a: ComparedSide
    b: ComparedSide
    changes: list[TrafficChange]
    weaker: int = 0
    #: Lines or objects of the recordings that could not be read.
    lines_unreadable: int = 0

    @property
    def is_same(self) -> bool:
        """True if no change is as telling as was asked for."""
        return not self.changes

    def __repr__(self) -> str:
        return f"<{len(self.changes)} changes, and {self.weaker} less telling>"


class ComparisonWatcher(typing.Protocol):
    """Looks on while recordings are compared, to draw them. `sides` says whose recording it is: "a", "b" or "ab"."""

    def watch_times(self, times: Ints, sides: str) -> None:
        """Take the instants (ns) of all that is read, before what belongs to them."""

    def watch_frames(self, table: FrameTable, sides: str) -> None:
        """Take frames that are compared, in pieces."""

    def watch_messages(self, table: MessageTable, sides: str) -> None:
        """Take messages that are compared; each piece behind its frames."""


@dataclass
class RecordingComparer:
    """Reads recordings for two sides, and compares these. With a filter only frames that it lets pass are counted, with
    `selected` only messages that it says of a table's rows; frames that are not decoded then are left out."""

    a: ComparedSide
    b: ComparedSide
    variants: Sequence[Variant] = ()
    wanted: CanFilter | None = None
    selected: Callable[[MessageTable], Array] | None = None
    #: Which way the bytes of a line went, where they do not tell and the recording does not say.
    direction: Direction | None = None
    watcher: ComparisonWatcher | None = None
    _decoded: set[int] = field(default_factory=set)
    _unknown: set[int] = field(default_factory=set)

    def read(
        self,
        capture: CanRecording | SerialRecording,
        sides: str = "ab",
        each: Callable[[Iterable[Any]], Iterable[Any]] = iter,
    ) -> None:
        """Read a recording for the sides "a", "b" or, where both are times of it, "ab". `each` goes between: it gets pieces
        as they are read, and hands them on.

        Raises `CallerError` for bytes without a protocol, and `CaptureError` where reading stops.
        """
        chosen = [self.a if side == "a" else self.b for side in sides]
        for side in chosen:
            side.begin()
        link = "can" if isinstance(capture, CanRecording) else "serial"
        variants = [variant for variant in self.variants if (variant.link == "can") == (link == "can")]
        if link == "serial" and not variants:
            raise CallerError(
                f"{capture.name}: bytes of a serial line have no identifiers to compare: name the protocol (protocol=, -p"
                " NAME); 'aces decode FILE' says what fits, 'aces spec new' begins a protocol of your own"
            )
        if isinstance(capture, CanRecording):
            self._can(capture, chosen, sides, variants, each)
        else:
            self._serial(capture, chosen, sides, variants, each)
        for side in chosen:
            if side.is_windowed and not side.watched.frames and side.untimed:
                raise CallerError(f"{capture.name}: has no times, and none of its frames is in a window")

    def _can(
        self,
        capture: CanRecording,
        chosen: Sequence[ComparedSide],
        sides: str,
        variants: Sequence[Variant],
        each: Callable[[Iterable[Any]], Iterable[Any]],
    ) -> None:
        scanner = (
            make_column_scanner(variants, direction=self.direction, include_unknown=True)
            if variants
            else None
        )
        passed: list[Ints] = []
        for frames in joined_tables(each(capture.tables()), PIECE):
            kept = np.ones(len(frames), bool) if self.wanted is None else passing(self.wanted, frames)
            mine = frames if self.wanted is None else frames.take(np.flatnonzero(kept))
            if self.wanted is not None and scanner is not None:
                passed.append(kept)
            for side in reversed(chosen):  # what A is may hang on B's windows, which see the first instant
                side.untimed += int(np.count_nonzero(mine.time == NO_TIME))
                _see(side, frames.time)
                places = side.places(frames.time)
                side.watched.add(frames.time, places)
                if self.selected is None:
                    side.traffic.add(mine, places if mine is frames else places[kept])
            if self.watcher is not None:
                self.watcher.watch_times(frames.time, sides)
                if self.selected is None:
                    self.watcher.watch_frames(mine, sides)
            if scanner is not None:
                self._take(scanner.feed(frames), chosen, sides, passed)
        if scanner is not None:
            self._take(scanner.close(), chosen, sides, passed)

    def _serial(
        self,
        capture: SerialRecording,
        chosen: Sequence[ComparedSide],
        sides: str,
        variants: Sequence[Variant],
        each: Callable[[Iterable[Any]], Iterable[Any]],
    ) -> None:
        ways = SerialWays(
            variants, self.direction, lambda way: make_column_scanner(variants, direction=way), feed
        )
        for chunk in each(ways.chunks(capture)):
            times = np.array([to_ns(chunk.time)])
            for side in reversed(chosen):
                side.untimed += chunk.time is None
                _see(side, times)
            if self.watcher is not None:
                self.watcher.watch_times(times, sides)
            for tables in ways.feed(chunk):
                self._take(tables, chosen, sides)
        for tables in ways.close():
            self._take(tables, chosen, sides)

    def _take(
        self,
        tables: Iterable[MessageTable],
        chosen: Sequence[ComparedSide],
        sides: str,
        passed: Sequence[Ints] = (),
    ) -> None:
        kept = np.concatenate(passed) if self.wanted is not None and passed else None
        for table in tables:
            if not len(table):
                continue
            if not table.is_stream:
                (self._decoded if table.message else self._unknown).update(np.unique(table.key).tolist())
            if not table.message:
                continue
            if table.is_stream:
                for side in chosen:
                    side.watched.add(table.time, side.places(table.time))
            if kept is not None:
                table = table.take(np.flatnonzero(kept[table.row]))
            if self.selected is not None:
                table = table.take(np.flatnonzero(self.selected(table)))
            for side in reversed(chosen):
                side.messages.add(table, side.places(table.time))
            if self.watcher is not None:
                self.watcher.watch_messages(table, sides)

    def compare(self, least: float = LEAST) -> RecordingComparison:
        """Return what differs, as far as it was read.

        Identifiers of which every frame was decoded are compared by their messages and signals alone.
        """
        exposure = Exposure.of(self.a.watched, self.b.watched)
        changes = traffic_changes(self.a.traffic, self.b.traffic, exposure)
        whole = self._decoded - self._unknown
        changes = [
            change for change in changes if change.identifier is None or change.identifier.key not in whole
        ]
        changes += message_changes(self.a.messages, self.b.messages, exposure)
        changes.sort(key=lambda change: -change.score)
        telling = [change for change in changes if change.score >= least]
        return RecordingComparison(self.a, self.b, telling, len(changes) - len(telling))


def _see(side: ComparedSide, times: Ints) -> None:
    known = times[times != NO_TIME]
    for window in (*side.windows, *(side.rest_of.windows if side.rest_of is not None else ())):
        if len(known):
            window.see(int(known[0]))


def compare_recordings(
    a: PathSource | BinaryIO,
    b: PathSource | BinaryIO | None = None,
    *,
    a_times: Iterable[Span | TimeWindow] = (),
    b_times: Iterable[Span | TimeWindow] = (),
    protocol: Protocol | Variant | str | None = None,
    wanted: CanFilter | None = None,
    selected: Callable[[MessageTable], Array] | None = None,
    direction: Direction | None = None,
    least: float = LEAST,
) -> RecordingComparison:
    """Return what differs between two recordings, or between two times of one: `compare_recordings("run.log",
    b_times=[(10, 12)])`.

    `a` and `b` are paths, "-" or open files. Times are pairs of seconds from the first frame (or since 1970), None open, or
    windows of `aces_lab.compare.parse_marks`' kind; without `b`, A is by default all of the recording but B's times.
    `protocol` compares decoded messages and signals as well, and is necessary for serial lines: a protocol, the name of an
    installed one, the path of a database. `wanted` is a filter of `parse_filter`; `selected` says which rows of a
    `MessageTable` are compared (an array of bool), and then nothing but messages is. `direction` is that of
    `aces_bus.decode`. Changes that are less telling than `least` (0 … 1) are counted only.

    Raises `CaptureError` for what is not a recording, `CallerError` for one without times, bytes without a protocol,
    a selection without one, and times that no frame is in.
    """
    if selected is not None and protocol is None:
        raise CallerError("messages are selected where a protocol says what they are (protocol=)")
    variants = [] if protocol is None else [_variant(protocol)]
    windows = [
        [window if isinstance(window, TimeWindow) else _window(window) for window in times]
        for times in (a_times, b_times)
    ]
    if b is None and not windows[1]:
        raise CallerError(
            "one recording is compared with itself: say when B is (b_times=), or give another one"
        )
    side_b = ComparedSide(windows[1], variants)
    rest = side_b if b is None and not windows[0] else None
    comparer = RecordingComparer(
        ComparedSide(windows[0], variants, rest), side_b, variants, wanted, selected, direction
    )
    unreadable = 0
    for source, sides in [(a, "ab")] if b is None else [(a, "a"), (b, "b")]:
        with open_recording(source, link=_link(variants)) as capture:
            comparer.read(capture, sides)
        unreadable += capture.lines_unreadable
    for name, side in (("A", comparer.a), ("B", comparer.b)):
        if side.is_windowed and not side.watched.frames:
            raise CallerError(f"nothing of the recording is in the times of {name}")
    found = comparer.compare(least)
    found.lines_unreadable = unreadable
    return found


def _link(variants: Sequence[Variant]) -> Any:
    return None if not variants else "can" if variants[0].link == "can" else "serial"


def _window(span: Span) -> TimeWindow:
    start, stop = (None if seconds is None else to_ns(seconds) for seconds in span)
    return TimeWindow(start, stop)


def _variant(protocol: Protocol | Variant | str) -> Variant:
    if isinstance(protocol, Variant):
        return protocol
    if isinstance(protocol, str):
        is_database = protocol.lower().endswith(database_suffixes())
        protocol = load_database(protocol).protocol if is_database else load_protocol(protocol)
    return protocol.variant()


__all__ = ["ComparedSide", "RecordingComparer", "RecordingComparison", "compare_recordings"]
