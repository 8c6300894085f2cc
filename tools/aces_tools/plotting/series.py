"""Values over time, out of tables, in memory that does not grow with the capture.

1. Every point kept is a sample of the capture: nothing is averaged or invented.
2. However long a capture, the highest and lowest sample of each of `BUCKETS` stretches of time (of a series with less room,
   fewer) is kept, and the first
   and last: a spike of one frame in an hour is drawn. (Jugel et al., "M4: A Visualization-Oriented Time Series Data
   Aggregation", VLDB 2014: with a bucket a pixel, the picture is the same.)
3. A value that is absent, NaN or infinite is a gap; a value that other messages of its kind carry instead is none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from aces_bus.errors import CallerError
from aces_bus.frame_table import NO_TIME
from aces_bus.protocol.columns.table import Column, MessageTable

from ..reading.window import TimeWindow
from .select import CHANNEL, PlotSignal, SignalPattern, Wanted

Array = npt.NDArray[Any]
Key = tuple[tuple[str, str], ...]

#: Stretches of time that a long series is divided in: some for each pixel of a wide screen.
BUCKETS = 8192
#: Points a series may hold before it is thinned, to five for each stretch at most.
MOST_POINTS = 16 * BUCKETS
#: Lines in one picture: more cannot be distinguished, nor listed beside it.
MOST_LINES = 64
#: A message that comes so often is periodic where most of its periods are alike, and gone after so many of them.
PERIODS, MISSED = 8, 5
#: Lines in a list of signals.
MOST_SERIES = 4096


def thin(x: Array, y: Array, buckets: int) -> tuple[Array, Array]:
    """Return of each of `buckets` equal stretches of `x` the first, last, lowest and highest point, and one
    gap; in order of x.

    `x` and `y` are float64 of one length, `y` NaN in gaps. What comes back has at most 5 × `buckets` points.
    """
    if len(x) > 1 and (x[1:] < x[:-1]).any():
        order = np.argsort(x, kind="stable")
        x, y = x[order], y[order]
    if len(x) <= 5 * buckets:
        return x, y
    span = x[-1] - x[0]
    number = (
        np.minimum(((x - x[0]) * (buckets / span)).astype(np.int64), buckets - 1)
        if span > 0
        else np.zeros(len(x), np.int64)
    )
    starts = np.flatnonzero(np.concatenate(([True], number[1:] != number[:-1])))
    ends = np.append(starts[1:], len(x)) - 1
    gone = np.isnan(y)
    kept = np.zeros(len(x), bool)
    kept[starts] = kept[ends] = True
    sizes = np.diff(np.append(starts, len(x)))
    group = np.repeat(np.arange(len(starts)), sizes)
    for fill, best in ((np.inf, np.minimum), (-np.inf, np.maximum)):
        filled = np.where(gone, fill, y)
        extreme = best.reduceat(filled, starts)
        at = np.flatnonzero((filled == np.repeat(extreme, sizes)) & ~gone)
        _, first = np.unique(group[at], return_index=True)
        kept[at[first]] = True
    at = np.flatnonzero(gone)
    _, first = np.unique(group[at], return_index=True)
    kept[at[first]] = True
    return x[kept], y[kept]


@dataclass
class Series:
    """One line: a signal of one device. `count`, `low` and `high` are of all values, thinned or not."""

    signal: PlotSignal
    key: Key
    count: int = 0
    low: float | int | None = None
    high: float | int | None = None
    #: Types of values that are not numbers: "bytes", "str".
    others: str = ""
    #: Points that it may hold before it is thinned.
    room: int = MOST_POINTS
    _x: list[Array] = field(default_factory=list)
    _y: list[Array] = field(default_factory=list)
    _held: int = 0

    def note(self, values: Array) -> None:
        """Count values that are there; NaN has no place between the lowest and the highest."""
        self.count += len(values)
        if values.dtype.kind == "f":
            values = values[~np.isnan(values)]
        if len(values):
            low, high = values.min().item(), values.max().item()
            self.low = low if self.low is None else min(self.low, low)
            self.high = high if self.high is None else max(self.high, high)

    def extend(self, x: Array, y: Array) -> None:
        """Add points, `y` NaN in gaps."""
        self._x.append(x)
        self._y.append(y)
        self._held += len(x)
        if self._held > self.room:
            self.points()

    def points(self) -> tuple[Array, Array]:
        """Return what is kept, in order of time."""
        if not self._x:
            return np.empty(0), np.empty(0)
        x, y = np.concatenate(self._x), np.concatenate(self._y)
        x, y = thin(x, y, self.room // 16 if self._held > self.room else self._held)
        self._x, self._y, self._held = [x], [y], len(x)
        return x, y


def broken(x: Array, y: Array, longest: float) -> tuple[Array, Array]:
    """Return points with a gap wherever more than `longest` lies between two of them."""
    at = np.flatnonzero(np.diff(x) > longest) + 1
    return (np.insert(x, at, x[at - 1]), np.insert(y, at, np.nan)) if len(at) else (x, y)


def longest_period(x: Array) -> float:
    """Return the longest time between two points that is not a gap: some periods where they come periodically, else any."""
    steps = np.diff(x)
    if len(steps) < PERIODS:
        return np.inf
    period = float(np.median(steps))
    return MISSED * period if np.quantile(steps, 0.8) <= 2 * period else np.inf


@dataclass
class TimeAxis:
    """The horizontal axis. `origin` is the instant of zero in ns, None where the captures have no times: then frames
    (or bytes) are counted.
    """

    origin: int | None = None
    is_set: bool = False
    #: Messages left out because they have no time while others do.
    timeless: int = 0

    def see(self, times: Array) -> None:
        """Take zero from the first instant of the first capture."""
        if not self.is_set and len(times):
            known = times[times != NO_TIME]
            self.origin = int(known[0]) if len(known) else None
            self.is_set = True

    def place(self, table: MessageTable) -> Array:
        """Return where on the axis each message is, NaN where that is not known."""
        self.see(table.time)
        if self.origin is None:
            return table.row.astype(np.float64)
        x: Array = (table.time - self.origin) / 1e9
        unknown = table.time == NO_TIME
        if unknown.any():
            self.timeless += int(unknown.sum())
            x[unknown] = np.nan
        return x


class Collector:
    """Collects the wanted signals out of tables. With `keeps_points` False it only counts.

    Raises `CallerError` as soon as there are more than `most` lines, and not at the end of a long recording; with
    `leaves_out` the others are left out. Each has room for so many points. `came` is called with a table, a device and the
    places of its messages on the axis.
    """

    def __init__(
        self,
        wanted: Mapping[tuple[str, str], Wanted],
        clock: TimeAxis,
        window: TimeWindow | None = None,
        *,
        keeps_points: bool = True,
        leaves_out: bool = False,
        most: int = MOST_LINES,
        room: int = MOST_POINTS,
        came: Callable[[MessageTable, Key, Array], None] | None = None,
    ) -> None:
        self.wanted, self._came = wanted, came
        self.clock = clock
        self.window = window
        self.keeps_points, self.leaves_out = keeps_points, leaves_out
        self.most, self.room = most, room
        self.series: dict[tuple[PlotSignal, Key], Series] = {}
        #: Lines that there was no room for.
        self.left_out = 0

    def add(self, table: MessageTable) -> None:
        """Take what is wanted from a table."""
        wanted = self.wanted.get((table.protocol, table.message))
        if wanted is None or not len(table):
            return
        x = self.clock.place(table)
        kept = ~np.isnan(x)
        if self.window is not None:
            kept &= self.window.inside(table.time)
        rows = None if kept.all() else np.flatnonzero(kept)
        groups = _by_key(table, wanted.keys, rows)
        for key, at in groups:
            if self._came is not None:
                self._came(table, key, x[at])
        for signal, patterns in wanted.signals:
            takers = [
                (key, at)
                for key, at in groups
                if not patterns or any(pattern.holds(key) for pattern in patterns)
            ]
            if not takers:
                continue
            column = table[signal.column]
            if signal.is_list:
                for key, at in takers:
                    self._take_lists(signal, key, x[at], column, at)
                continue
            values, floats = _numbers(column, signal)
            for key, at in takers:
                if floats is None:
                    self._strange(signal, key, column, at)
                else:
                    self._take(signal, key, x[at], values[at], floats[at], column, at)

    def _of(self, signal: PlotSignal, key: Key, *, there: bool) -> Series | None:
        if signal.column in dict(key):  # a device's number, drawn itself: one line
            key = tuple(part for part in key if part[0] != signal.column)
        found = self.series.get((signal, key))
        if found is None and there:
            is_full = self.keeps_points and len(self.series) >= self.most
            if is_full and not self.leaves_out:
                raise too_many(next(iter(self.series.values())))
            if is_full or len(self.series) >= MOST_SERIES:
                self.left_out += 1
                return None
            found = self.series[signal, key] = Series(signal, key, room=self.room)
        return found

    def _take(
        self, signal: PlotSignal, key: Key, x: Array, values: Array, y: Array, column: Column, at: Any
    ) -> None:
        if column.absent is not None:
            there = ~column.absent[at]
            values = values[there]
            if signal.conditional:
                x, y = x[there], y[there]
        series = self._of(signal, key, there=bool(len(values)))
        if series is None:
            return
        series.note(values)
        if self.keeps_points:
            series.extend(x, y)

    def _take_lists(self, signal: PlotSignal, key: Key, x: Array, column: Column, at: Any) -> None:
        """Take every value of every list as a point at the time of its message."""
        lists = column.values[at].tolist()
        values = [value for row in lists for value in row]
        if not all(value is None or isinstance(value, (int, float)) for value in values):
            self._strange(signal, key, column, at)
            return
        points = Column(column.kind, np.array(values, np.float64))
        x = np.repeat(x, [len(row) for row in lists])
        self._take(signal, key, x, points.values, points.values, points, slice(None))

    def _strange(self, signal: PlotSignal, key: Key, column: Column, at: Any) -> None:
        values = [value for value in column.values[at].tolist() if value is not None]
        series = self._of(signal, key, there=bool(values))
        if series is not None and values:
            series.count += len(values)
            series.others = type(values[0]).__name__


def _by_key(table: MessageTable, names: Sequence[str], rows: Array | None) -> list[tuple[Key, Any]]:
    """Return the rows of each device on each channel."""
    columns: list[tuple[str, Array, Callable[[Any], str]]] = []
    channels = table.channels.names
    columns.append((CHANNEL, table.channel, lambda number: str(channels[number])))
    for name in names:
        column = table[name]
        listed = column.to_list() if column.kind.is_object or column.absent is not None else None
        if listed is not None:
            texts, numbers = np.unique([str(value) for value in listed], return_inverse=True)
            columns.append((name, numbers, lambda number, texts=texts: str(texts[number])))  # type: ignore[misc]
        else:
            shown = column.kind.names or {}
            columns.append((name, column.values, lambda value, shown=shown: str(shown.get(value, value))))  # type: ignore[misc]
    code: Array | None = None
    values: list[Array] = []
    for _, numbers, _ in columns:
        some = numbers if rows is None else numbers[rows]
        if len(some) and (some == some[0]).all():
            distinct, inverse = some[:1], None
        else:
            distinct, inverse = np.unique(some, return_inverse=True)
        if inverse is None:
            values.append(some)
            continue
        values.append(some)
        code = inverse if code is None else np.unique(code * len(distinct) + inverse, return_inverse=True)[1]
    size = len(table) if rows is None else len(rows)
    if not size:
        return []
    if code is None:
        firsts, parts = [0], [slice(None) if rows is None else rows]
    else:
        order = np.argsort(code, kind="stable")
        bounds = np.flatnonzero(np.diff(code[order])) + 1
        pieces = np.split(order, bounds)
        firsts = [int(piece[0]) for piece in pieces]
        parts = [piece if rows is None else rows[piece] for piece in pieces]
    keyed = [(name, show, some) for (name, _, show), some in zip(columns, values, strict=True)]
    return [
        (tuple((name, show(some[first].item())) for name, show, some in keyed), part)
        for first, part in zip(firsts, parts, strict=True)
    ]


def _numbers(column: Column, signal: PlotSignal) -> tuple[Array, Array | None]:
    """Return the values as they are, and as float64 with NaN in gaps; None instead when they are not numbers."""
    if signal.bit is not None:
        bit = signal.bit
        if column.kind.is_object:
            values: Array = np.array(
                [0 if v is None else int(v) >> bit & 1 for v in column.values.tolist()], np.uint8
            )
        else:
            values = (column.values.astype(np.int64) >> bit & 1).astype(np.uint8)
        floats = values.astype(np.float64)
        if column.absent is not None:
            floats[column.absent] = np.nan
        return values, floats
    try:
        floats = column.to_float()
    except (TypeError, ValueError, OverflowError):
        return column.values, None
    values = floats if column.kind.is_object else column.values
    infinite = np.isinf(floats)
    if infinite.any():
        floats = np.where(infinite, np.nan, floats)
    return values, floats


def matching(pattern: SignalPattern, series: Sequence[Series]) -> list[Series]:
    """Return the series that a pattern means, in declared order."""
    return [curve for curve in series if pattern.takes(curve.signal) and pattern.holds(curve.key)]


def too_many(curve: Series) -> CallerError:
    """Return what is said of more lines than a picture can show."""
    where = ",".join(f"{name}={value}" for name, value in curve.key if name != CHANNEL)
    example = f"{curve.signal.message}{f'[{where}]' if where else ''}.{curve.signal.path}"
    return CallerError(
        f"more than {MOST_LINES} lines are too many for one picture: name fewer signals or one device,"
        f" such as '{example}'; --list shows all"
    )
