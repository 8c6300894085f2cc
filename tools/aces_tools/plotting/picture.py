"""What is drawn where: panels above each other over one time axis, for both kinds of drawing.

1. A panel shows one sort of thing: numbers on one or more vertical axes, one enumeration with its names as ticks (several
   would lie on each other), or flags as lanes. A group of several sorts becomes several panels.
2. A label says what distinguishes lines, and the panel's title what they share; together they are the signal's full name
   as it can be asked for.
"""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .select import CHANNEL, ImageFormat, PlotSignal, SignalPattern
from .series import MOST_LINES, Key, Series, TimeAxis, broken, longest_period, matching, too_many

Array = npt.NDArray[Any]
Sort = Literal["numbers", "names", "flags"]
Limits = tuple[float | None, float | None]

#: Names that an axis may carry.
MOST_CATEGORIES = 40
#: Since 1970, and not since the recorder was switched on.
EPOCH_NS = 10**17


@dataclass
class PlotLine:
    """A series as it is drawn; `y` is NaN in gaps. Of an enumeration `y` are places of `Panel.categories`."""

    series: Series
    format: ImageFormat
    x: Array
    y: Array
    label: str = ""

    @property
    def unit(self) -> str:
        """The unit of its values."""
        return self.series.signal.kind.unit if self.series.signal.bit is None else ""


@dataclass
class PlotPanel:
    """Lines over one time axis. `axes` are the vertical ones: the first on the left, others on the right."""

    sort: Sort
    axes: list[list[PlotLine]]
    title: str = ""
    #: Of each axis: the units of its lines, and what the caller wants to stand there instead.
    units: list[str] = field(default_factory=list)
    captions: list[str] = field(default_factory=list)
    limits: list[Limits] = field(default_factory=list)
    #: One of many of a kind, for which little height will do.
    is_small: bool = False
    #: Of an enumeration: the names at 0, 1, 2, ….
    categories: list[str] = field(default_factory=list)

    @property
    def lines(self) -> list[PlotLine]:
        """The lines of all axes."""
        return [line for axis in self.axes for line in axis]


@dataclass
class Picture:
    """Panels from top to bottom. `is_absolute` asks for instants instead of seconds from the first one."""

    panels: list[PlotPanel]
    clock: TimeAxis
    title: str = ""
    x_label: str = ""
    unit_of_rows: str = "frame"
    is_absolute: bool = False
    is_step: bool = False
    style: str | None = None

    @property
    def has_instants(self) -> bool:
        """True if the axis shows a time of day."""
        return self.is_absolute and self.clock.origin is not None and self.clock.origin >= EPOCH_NS

    @property
    def offset(self) -> float:
        """Seconds to add to a place on the axis to get the number that its tick shows."""
        if self.is_absolute and self.clock.origin is not None and not self.has_instants:
            return self.clock.origin / 1e9
        return 0.0

    @property
    def caption(self) -> str:
        """Label of the horizontal axis."""
        if self.x_label:
            return self.x_label
        if self.clock.origin is None:
            return self.unit_of_rows
        if self.has_instants:
            return f"UTC, from {instant(self.clock.origin):%Y-%m-%d}"
        return "time in s"

    @property
    def span(self) -> tuple[float, float]:
        """Limits of the horizontal axis."""
        ends = [(line.x[0], line.x[-1]) for panel in self.panels for line in panel.lines if len(line.x)]
        low, high = min(low for low, _ in ends), max(high for _, high in ends)
        if not high > low:
            low, high = low - 0.5, high + 0.5
        return float(low), float(high)


def instant(ns: int) -> datetime.datetime:
    """Return an instant as a date; the last second of the calendar for what lies behind it."""
    try:
        return datetime.datetime.fromtimestamp(ns / 1e9, datetime.UTC)
    except (OverflowError, ValueError, OSError):
        return datetime.datetime.max.replace(tzinfo=datetime.UTC)


def panels_of(
    groups: Sequence[Sequence[Sequence[SignalPattern]]],
    series: Sequence[Series],
    *,
    longest_gap: float | None = None,
    by_unit: bool = False,
) -> list[PlotPanel]:
    """Return the panels of subplots × axes × patterns. `by_unit` gives each unit its own; lines are interrupted where
    more than `longest_gap` lies between two points (None: as each message's period says).

    Raises `CallerError` when there are too many lines.
    """
    asked = {name for group in groups for axis in group for pattern in axis for name, _ in pattern.where}
    names = LineNames(series, asked)
    panels: list[PlotPanel] = []
    for group in groups:
        found: dict[Any, PlotPanel] = {}
        for place, patterns in enumerate(group):
            for curve, pattern in _lines_of(patterns, series):
                if curve.others:
                    continue
                x, y = curve.points()
                x, y = broken(x, y, longest_period(x) if longest_gap is None else longest_gap)
                kind = curve.signal.kind
                if (curve.signal.bit is not None or kind.names is not None) and not pattern.format.marker:
                    x, y = value_changes(x, y)
                line = PlotLine(curve, pattern.format, x, y)
                if curve.signal.bit is not None:
                    panel = found.setdefault("flags", PlotPanel("flags", [[]]))
                    panel.axes[0].append(line)
                elif kind.names is not None and is_enumeration(y, kind.names):
                    panel = found.setdefault((curve.signal, curve.key), PlotPanel("names", [[line]]))
                else:
                    panel = found.setdefault((line.unit if by_unit else "numbers",), PlotPanel("numbers", []))
                    while len(panel.axes) <= place:
                        panel.axes.append([])
                    panel.axes[place].append(line)
        for panel in found.values():
            panel.axes = [axis for axis in panel.axes if axis]
            units = dict.fromkeys(line.unit for line in panel.lines)
            if panel.sort == "numbers" and len(panel.axes) == 1 and len(units) == 2 and all(units):
                panel.axes = [[line for line in panel.lines if line.unit == unit] for unit in units]
            panels.append(panel)
    if sum(len(panel.lines) for panel in panels) > MOST_LINES:
        raise too_many(panels[0].lines[0].series)
    for panel in panels:
        _label(panel, names)
        if panel.sort == "names":
            _categorise(panel)
    return panels


def _lines_of(
    patterns: Iterable[SignalPattern], series: Sequence[Series]
) -> list[tuple[Series, SignalPattern]]:
    found: dict[tuple[PlotSignal, Key], tuple[Series, SignalPattern]] = {}
    for pattern in patterns:
        for curve in matching(pattern, series):
            found.setdefault((curve.signal, curve.key), (curve, pattern))
    return list(found.values())


class LineNames:
    """The names of lines: with those device fields of which there are several values, or that were asked for."""

    def __init__(
        self, series: Sequence[Series], asked: Collection[str] = (), *, always: bool = False
    ) -> None:
        values: dict[tuple[tuple[str, str], str], set[str]] = {}
        for curve in series:
            for name, value in curve.key:
                values.setdefault((curve.signal.owner, name), set()).add(value)
        self._telling = {
            place
            for place, some in values.items()
            if len(some) > 1 or place[1] in asked or (always and place[1] != CHANNEL)
        }
        # Where each device speaks on one bus only, its number says enough.
        seen = Counter(
            (curve.signal, tuple(part for part in curve.key if part[0] != CHANNEL)) for curve in series
        )
        for owner in {curve.signal.owner for curve in series} if CHANNEL not in asked else ():
            if all(count == 1 for (signal, _), count in seen.items() if signal.owner == owner):
                self._telling.discard((owner, CHANNEL))

    def key(self, curve: Series) -> str:
        """Return `[board=3]`, or nothing."""
        owner = curve.signal.owner
        parts = [f"{name}={value}" for name, value in curve.key if (owner, name) in self._telling]
        return f"[{','.join(parts)}]" if parts else ""

    def full(self, curve: Series) -> str:
        """Return `Encoder[board=3].position.0`."""
        return f"{curve.signal.message}{self.key(curve)}.{curve.signal.path}"


def _label(panel: PlotPanel, names: LineNames) -> None:
    """Set the panel's title to what all its lines share, and each line's label to the rest of its name."""
    lines = panel.lines
    first = lines[0].series
    is_one_message = len({line.series.signal.owner for line in lines}) == 1
    is_one_key = len({names.key(line.series) for line in lines}) == 1
    is_one_path = len({line.series.signal.path for line in lines}) == 1
    if is_one_message:
        message = first.signal.message
        panel.title = (
            f"{message}{names.key(first)}" if is_one_key else first.signal.name if is_one_path else message
        )
        if len(lines) == 1:
            panel.title = names.full(first)
    for line in lines:
        key, path = names.key(line.series), line.series.signal.path
        if not is_one_message:
            line.label = names.full(line.series)
        elif is_one_path and not is_one_key:
            line.label = key.strip("[]")
        else:
            line.label = path if is_one_key else f"{key}.{path}".lstrip(".")
    panel.limits = [(None, None)] * len(panel.axes)
    for axis in panel.axes:
        units = list(dict.fromkeys(line.unit for line in axis))
        panel.units.append(", ".join(unit for unit in units if unit))
        panel.captions.append("")
        if len(units) > 1:
            for line in axis:
                line.label += f" ({line.unit})" if line.unit else ""


def is_enumeration(y: Array, names: Mapping[Any, str]) -> bool:
    """Return whether values are mostly names; else they are numbers of which some have a name, such as "error" for 255."""
    numbers = np.unique(y[~np.isnan(y)]).tolist()
    named = sum(number in names for number in numbers)
    return len(numbers) <= MOST_CATEGORIES and 2 * named >= len(numbers)


def _categorise(panel: PlotPanel) -> None:
    """Map the values that occur to 0, 1, 2, …: values far apart would leave no room for those close together."""
    lines = panel.lines
    present = [line.y[~np.isnan(line.y)] for line in lines]
    numbers = np.unique(np.concatenate(present))
    known = lines[0].series.signal.kind.names or {}
    panel.categories = [known.get(number, f"{number:g}") for number in numbers.tolist()]
    for line in lines:
        gone = np.isnan(line.y)
        line.y = np.searchsorted(numbers, line.y).astype(np.float64)
        line.y[gone] = np.nan


def value_changes(x: Array, y: Array) -> tuple[Array, Array]:
    """Return samples without those that repeat the sample before and behind them: of steps, nothing is lost."""
    gone = np.isnan(y)
    same = (y[1:] == y[:-1]) | (gone[1:] & gone[:-1])
    kept = np.ones(len(y), bool)
    kept[1:-1] = ~(same[1:] & same[:-1])
    return x[kept], y[kept]


def steps(x: Array, y: Array) -> tuple[Array, Array]:
    """Return samples with a corner at each: a value holds until the next one comes."""
    if len(x) < 2:
        return x, y
    out_x, out_y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
    return out_x, out_y


def lone(y: Array) -> Array:
    """Return which samples have a gap on both sides: a line would not show them."""
    there = ~np.isnan(y)
    before = np.concatenate(([False], there[:-1]))
    after = np.concatenate((there[1:], [False]))
    out: Array = there & ~before & ~after
    return out


#: As far as an axis goes: the difference of two such numbers is a number still.
LARGEST = 8e307


def values_range(lines: Sequence[PlotLine], limits: Limits) -> tuple[float, float]:
    """Return from where to where a vertical axis goes: all values with a margin, or what the caller said."""
    values = [line.y[~np.isnan(line.y)] for line in lines]
    some = np.concatenate(values) if values else np.empty(0)
    if any(line.format.is_stem for line in lines):
        some = np.append(some, 0.0)
    low, high = (float(some.min()), float(some.max())) if len(some) else (0.0, 1.0)
    margin = (high - low) * 0.05
    if not margin > 0:
        margin = max(abs(low) * 0.05, 0.5)
    given_low, given_high = limits
    bottom = max(low - margin, -LARGEST) if given_low is None else given_low
    top = min(high + margin, LARGEST) if given_high is None else given_high
    if not top > bottom:
        top = bottom + max(abs(bottom) * 0.05, 1) if given_high is None else top
        bottom = top - max(abs(top) * 0.05, 1) if given_low is None else bottom
    return bottom, top
