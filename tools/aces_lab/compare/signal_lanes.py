"""Messages and signals while two recordings are compared: kept in bounded memory, and drawn as lanes of a picture.

1. Signals are kept as `aces plot` keeps them, each with less room: every point is a sample.
2. A number is a line between the lowest and the highest value of both sides; an enumeration has a level a name; a flag is
   filled while it is set; a message shows how often it came.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from aces_bus.protocol import Variant
from aces_bus.protocol.columns.table import ColumnKind, MessageTable
from aces_tools.plotting.figure import COLOURS, short_name
from aces_tools.plotting.picture import is_enumeration, lone, steps
from aces_tools.plotting.select import PlotSignal, Wanted, declared_signals
from aces_tools.plotting.series import Array, Collector, Key, Series, TimeAxis, broken, longest_period
from aces_tools.reading.traffic import BusIdentifier

from .signals import DeviceMessage

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Signals that are kept, and the points that each may hold: 256 KB.
MOST_SIGNALS, ROOM = 1024, 1 << 14
#: Inches: a lane of a number, a level of an enumeration, and what is left free above and below.
NUMBER, LEVEL, FREE = 0.48, 0.14, 0.1
#: Levels of an enumeration: of more it is drawn as a number.
MOST_LEVELS = 12


class LaneSignals:
    """The messages and signals of one recording."""

    def __init__(self, variants: Sequence[Variant], clock: TimeAxis, arrivals: Arrivals) -> None:
        wanted = {
            owner: Wanted(
                tuple((signal, ()) for signal in message.signals if signal.column not in message.devices),
                message.devices,
            )
            for owner, message in declared_signals(variants).items()
        }

        def came(table: MessageTable, key: Key, x: Array) -> None:
            arrivals.add(_subject((table.protocol, table.message), key), x)

        self.collector = Collector(wanted, clock, leaves_out=True, most=MOST_SIGNALS, room=ROOM, came=came)

    def find(self, subject: DeviceMessage, path: str, any_channel: bool) -> Series | None:
        """Return a signal of a message; None where nothing is kept of it."""
        for series in self.collector.series.values():
            if series.signal.path == path and is_of(
                _subject(series.signal.owner, series.key), subject, any_channel
            ):
                return None if series.others or not series.points()[0].size else series
        return None


class Arrivals:
    """How many of each kind had come, over time: frames of an identifier, messages of a device."""

    def __init__(self) -> None:
        self.kept: dict[BusIdentifier | DeviceMessage, Series] = {}

    def add(self, kind: BusIdentifier | DeviceMessage, x: Array) -> None:
        """Add more of a kind, at these places of the axis."""
        series = self.kept.get(kind)
        if series is None:
            if len(self.kept) >= MOST_SIGNALS:
                return
            series = self.kept[kind] = Series(PlotSignal("", "", "", "", ColumnKind("")), (), room=ROOM)
        series.extend(x, series.count + np.arange(1.0, len(x) + 1))
        series.count += len(x)

    def find(self, kind: BusIdentifier | DeviceMessage, any_channel: bool) -> Series | None:
        """Return a kind's, or that of its like on whatever channel; None where none came."""
        return next((kept for key, kept in self.kept.items() if is_of(key, kind, any_channel)), None)

    @property
    def last(self) -> float:
        """Place of the last arrival on the axis."""
        return max((float(series.points()[0][-1]) for series in self.kept.values()), default=0.0)


def _subject(owner: tuple[str, str], key: Key) -> DeviceMessage:
    (_, channel), *device = key
    return DeviceMessage(*owner, channel, tuple(device))


def is_of(
    kind: BusIdentifier | DeviceMessage, asked: BusIdentifier | DeviceMessage, any_channel: bool
) -> bool:
    """Return whether this is what is asked for: on the same channel, or on whatever channel."""
    return type(kind) is type(asked) and (
        kind == asked or (any_channel and kind._replace(channel=None) == asked._replace(channel=None))
    )


@dataclass
class SignalLane:
    """How one signal is drawn in each part: from `low` to `high`, or on the levels of `names`."""

    low: float
    high: float
    unit: str = ""
    is_flag: bool = False
    #: Values that are levels, lowest first, and their names.
    values: Sequence[float] = ()
    names: Sequence[str] = ()

    @classmethod
    def of(cls, series: Sequence[Series]) -> SignalLane:
        """Return it for the series of both sides."""
        signal = series[0].signal
        values = np.unique(np.concatenate([part.points()[1] for part in series]))
        values = values[~np.isnan(values)]
        low, high = (float(values[0]), float(values[-1])) if len(values) else (0.0, 0.0)
        known = signal.kind.names
        if signal.bit is not None:
            return cls(0.0, 1.0, is_flag=True)
        if known is not None and len(values) <= MOST_LEVELS and is_enumeration(values, known):
            names = [known.get(value, f"{value:g}") for value in values.tolist()]
            return cls(0.0, max(1.0, len(names) - 1.0), values=values.tolist(), names=names)
        return cls(low, high if high > low else low + 1.0, signal.kind.unit or "")

    @property
    def height(self) -> float:
        """Inches."""
        return 0.0 if self.is_flag else LEVEL * len(self.names) + FREE if self.names else NUMBER

    def ticks(self) -> list[tuple[float, str]]:
        """Return what is said of which level."""
        if self.names:
            return [(float(level), short_name(name)) for level, name in enumerate(self.names)]
        return [] if self.is_flag else [(self.low, f"{self.low:.5g}"), (self.high, f"{self.high:.5g}")]

    def place(self, value: Any, top: float, height: float) -> Any:
        """Return where values are drawn in a lane."""
        free = (FREE + LEVEL) / 2 if self.names else FREE / 2 if self.is_flag else FREE
        return top + free + (self.high - value) / (self.high - self.low) * (height - 2 * free)

    def draw(self, ax: Axes, series: Series, top: float, height: float) -> None:
        """Draw the values of one part into its lane."""
        x, y = series.points()
        x, y = broken(x, y, longest_period(x))
        if self.names:
            gone = np.isnan(y)
            y = np.where(gone, np.nan, np.searchsorted(self.values, y))
        drawn = self.place(y, top, height)
        if self.is_flag:
            base = float(self.place(0.0, top, height))
            ax.plot([x[0], x[-1]], [base, base], color="#C8C8C8", linewidth=0.7, zorder=1)
            corners_x, corners_y = steps(x, drawn)
            ax.fill_between(corners_x, base, corners_y, color=COLOURS[0], linewidth=0)
            return
        ax.plot(x, drawn, color=COLOURS[0], linewidth=1.0, drawstyle="steps-post")
        alone = lone(y)
        if alone.any():
            ax.plot(x[alone], drawn[alone], ".", color=COLOURS[0], markersize=4)


def arrival_rates(x: Array, number: Array, span: tuple[float, float], pixels: int) -> Array:
    """Return how often something came in each of `pixels` stretches of `span`, a unit of `x`; NaN where it did not.

    `number` had come when the one at `x` was there. Between two that come periodically it is one over the time between them.
    """
    number = np.sort(number)
    edges = np.linspace(*span, pixels + 1)
    wide = (span[1] - span[0]) / pixels
    longest = longest_period(x)
    if not np.isfinite(longest):
        counts = np.concatenate(([0], number))[np.searchsorted(x, edges, side="right")]
        rates = np.diff(counts) / wide
        return np.where(rates > 0, rates, np.nan)
    rates = np.diff(np.interp(edges, x, number)) / wide
    before, after = np.searchsorted(x, edges[1:]), np.searchsorted(x, edges[:-1], side="right")
    outside = (before == 0) | (after == len(x))
    at = after.clip(1, len(x) - 1)
    is_gap = (before == after) & (x[at] - x[at - 1] > longest)
    return np.where(outside | is_gap, np.nan, rates)
