"""What changed between two recordings or times, over time: a lane a change, A and B side by side or on one axis.

1. A lane of bytes shows its bits or byte as they were: darker is a higher share of ones, or a higher value; white is no
   frame. Of what appears, vanishes or comes at another rate, the lane shows how often it came. Signals are drawn as lines.
2. Lanes are in the order of the report. Each side is read once, while it is compared: pipes can be drawn, too.
3. Both sides have one scale: the same shade and height are the same value and rate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from aces_bus import FrameTable
from aces_bus.frame_table import NO_TIME
from aces_bus.protocol import Variant
from aces_bus.protocol.columns.table import MessageTable
from aces_tools.plotting.bit_image import BitImage, BitImages
from aces_tools.plotting.figure import DPI, WIDTH, styled, write_figure
from aces_tools.plotting.series import Array, TimeAxis
from aces_tools.reading.traffic import identifier_groups

from . import RecordingComparison, TrafficChange
from .comparer import ComparedSide
from .signal_lanes import Arrivals, LaneSignals, SignalLane, arrival_rates, is_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Lanes in a picture.
MOST_LANES = 48
#: Inches: a lane, and what is left, right, above and below of all; beside the levels of signals; between A and B.
LANE, LEFT, RIGHT, ABOVE, BELOW, LEVELS, BETWEEN = 0.24, 0.2, 0.55, 0.62, 0.5, 0.75, 0.2
#: Share of the time shown that is left free at each end: a single frame at the beginning is seen.
EDGE = 0.004
#: Inches of a letter of the names beside the lanes, and letters of the longest one.
LETTER, LONGEST = 0.062, 60
SHADES = ("#E9E9E9", "#0072B2")
#: B's times, behind and beside the lanes.
B_COLOUR = "#D55E00"


class LanePart:
    """What is kept of one recording."""

    def __init__(self, variants: Sequence[Variant]) -> None:
        self.clock = TimeAxis()
        self.images = BitImages()
        self.arrivals = Arrivals()
        self.signals = LaneSignals(variants, self.clock, self.arrivals)
        self.is_of_frames = False
        self._frames = 0
        self._first = self._last = NO_TIME

    def see(self, times: Array) -> None:
        """Take instants of the recording."""
        self.clock.see(times)
        self._frames += len(times)
        known = times[times != NO_TIME]
        if len(known):
            first, last = int(known.min()), int(known.max())
            self._first = first if self._first == NO_TIME else min(first, self._first)
            self._last = max(last, self._last)

    def add(self, table: FrameTable) -> None:
        """Add frames, without a protocol."""
        self.images.add(table)
        self.is_of_frames = True
        for identifier, rows in identifier_groups(table):
            if self.clock.origin is None:
                x = rows + float(self._frames - len(table))
            else:
                times = table.time[rows]
                x = (times[times != NO_TIME] - self.clock.origin) / 1e9
            self.arrivals.add(identifier, x)

    @property
    def has_channels(self) -> bool:
        """True if there are several channels; each then has its own count of frames."""
        return len({shown.channel for shown in self.arrivals.kept}) > 1

    @property
    def span(self) -> tuple[float, float]:
        """Limits of the axis: seconds from the first frame, or frame numbers (of a byte stream: byte numbers)."""
        if self.clock.origin is not None:
            low, high = self.place(self._first), self.place(self._last)
        else:
            low, high = 0.0, max(float(self._frames), self.arrivals.last)
        return low, high if high > low else low + 1.0

    def place(self, at_ns: int) -> float:
        """Return an instant on the axis."""
        return (at_ns - (self.clock.origin or 0)) / 1e9


class Shades(NamedTuple):
    """Values between two places, NaN in gaps; nothing is drawn before `first`."""

    begin: float
    end: float
    values: Array
    first: float


@dataclass
class Lane:
    """One change in the picture: where it is, and how it is drawn into each part that has something of it."""

    change: TrafficChange
    height: float
    draws: Mapping[str, Callable[[Any, float], None]]
    ticks: Sequence[tuple[float, str]] = ()
    unit: str = ""
    top: float = 0.0

    @property
    def label(self) -> str:
        """Subject, place and unit; a label that is too long keeps its end, which says more."""
        text = f"{self.change.subject}  {self.change.place or self.change.kind}"
        text += f" ({self.unit})" if self.unit else ""
        return text if len(text) <= LONGEST else "…" + text[1 - LONGEST :]


class LanePicture:
    """Watches while recordings are compared, and draws what came out."""

    def __init__(self, variants: Sequence[Variant] = ()) -> None:
        self._variants = variants
        self._parts: dict[str, LanePart] = {}

    def _part(self, sides: str) -> LanePart:
        if sides not in self._parts:
            self._parts[sides] = LanePart(self._variants)
        return self._parts[sides]

    def watch_times(self, times: Array, sides: str) -> None:
        """Take all of a recording's instants, before what belongs to them."""
        self._part(sides).see(times)

    def watch_frames(self, table: FrameTable, sides: str) -> None:
        """Take frames of the recording of these sides ("a", "b", or "ab")."""
        self._part(sides).add(table)

    def watch_messages(self, table: MessageTable, sides: str) -> None:
        """Take decoded messages."""
        self._part(sides).signals.collector.add(table)

    def save(self, path: str, found: RecordingComparison, names: Sequence[str]) -> int:
        """Draw into a file, if there is anything to draw; how many changes have a lane. Raises `CallerError` when the file
        cannot be written."""
        from matplotlib.figure import Figure

        lanes: list[Lane] = []
        for change in found.changes:
            lane = self._lane(change)
            if lane is not None and len(lanes) < MOST_LANES:
                lane.top = lanes[-1].top + lanes[-1].height if lanes else 0.0
                lanes.append(lane)
        if lanes:
            with styled(None):
                figure = Figure()
                self._draw(figure, lanes, found, names)
                write_figure(figure, path)
        return len(lanes)

    # ------------------------------------------------------------------ lanes

    def _lane(self, change: TrafficChange) -> Lane | None:
        """Return how a change is drawn; None where nothing is kept of it."""
        subject = change.device_message or change.identifier
        assert subject is not None
        any_channel = not any(part.has_channels for part in self._parts.values())
        if change.byte is not None:
            images = {
                name: image
                for name, part in self._parts.items()
                for image in part.images.images.values()
                if is_of(image.identifier, subject, any_channel)
            }
            return self._shaded(
                change, {name: self._bits(self._parts[name], bits, change) for name, bits in images.items()}
            )
        if change.signal is None:
            came = {
                name: arrivals.points()
                for name, part in self._parts.items()
                if (arrivals := part.arrivals.find(subject, any_channel)) is not None
            }
            shades: dict[str, Shades] = {}
            for name, (x, number) in came.items():
                low, high = self._parts[name].span
                shades[name] = Shades(low, high, arrival_rates(x, number, (low, high), self._pixels), low)
            return self._shaded(change, shades)
        assert change.device_message is not None
        kept = {
            name: series
            for name, part in self._parts.items()
            if (series := part.signals.find(change.device_message, change.signal, any_channel)) is not None
        }
        if not kept:
            return None
        look = SignalLane.of(list(kept.values()))
        height = look.height or LANE

        def drawing(part: str) -> Callable[[Any, float], None]:
            return lambda ax, top: look.draw(ax, kept[part], top, height)

        ticks = [(look.place(level, 0.0, height), text) for level, text in look.ticks()]
        return Lane(change, height, {part: drawing(part) for part in kept}, ticks, look.unit)

    def _shaded(self, change: TrafficChange, shades: Mapping[str, Shades]) -> Lane | None:
        """Return a lane of shades, where there is anything."""
        seen = np.concatenate(
            [shade.values[~np.isnan(shade.values)] for shade in shades.values()] or [np.empty(0)]
        )
        if not len(seen):
            return None
        low, high = (0.0 if change.byte is None else float(seen.min())), float(seen.max())
        if len(change.bits) == 1 or not high > low:
            low, high = 0.0, 1.0

        def drawing(shade: Shades) -> Callable[[Any, float], None]:
            return lambda ax, top: _shade_lane(ax, top, shade, low, high)

        return Lane(change, LANE, {name: drawing(shade) for name, shade in shades.items()})

    def _bits(self, part: LanePart, image: BitImage, change: TrafficChange) -> Shades:
        """Return the mean of a byte, or of some of its bits, as shares of the highest value that there is."""
        images, origin, byte = part.images, part.clock.origin, change.byte or 0
        used = images.used
        count, shares = image.shares(used, -(-used // self._pixels))
        mine = shares[:, 8 * byte : 8 * byte + 8]
        bits = [bit for bit in change.bits or range(8) if bit < mine.shape[1]]
        weights = np.array([float(1 << bit) for bit in bits])
        values = mine[:, bits] @ weights / max(1.0, weights.sum())
        return Shades(*images.extent(count, len(mine), origin), values, images.begin(image, origin))

    # ------------------------------------------------------------------ the picture

    @property
    def _pixels(self) -> int:
        """Of the narrowest part that there may be, so that none is lost."""
        return round((WIDTH - LEFT - LETTER * LONGEST - LEVELS - RIGHT) / len(self._parts) * DPI)

    def _draw(
        self, figure: Any, lanes: Sequence[Lane], found: RecordingComparison, names: Sequence[str]
    ) -> None:
        """Draw lanes into a matplotlib figure, and make it as large as it needs to be."""
        height = lanes[-1].top + lanes[-1].height
        tall = height + ABOVE + BELOW
        figure.set_size_inches(WIDTH, tall)
        labels = [lane.label for lane in lanes]
        has_levels = any(lane.ticks for lane in lanes)
        left = LEFT + LETTER * max(map(len, labels)) + (LEVELS if has_levels else 0.0)
        wide = (WIDTH - left - RIGHT - BETWEEN * (len(self._parts) - 1)) / len(self._parts)
        middles = [lane.top + lane.height / 2 for lane in lanes]
        for number, (part, kept) in enumerate(self._parts.items()):
            at = left + number * (wide + BETWEEN)
            ax = figure.add_axes((at / WIDTH, BELOW / tall, wide / WIDTH, height / tall))
            low, high = kept.span
            for lane in lanes:
                if part in lane.draws:
                    lane.draws[part](ax, lane.top)
                if lane.top:
                    ax.axhline(lane.top, color="#F0F0F0", linewidth=0.6, zorder=0)
            margin = EDGE * (high - low)
            ax.set_xlim(low - margin, high + margin)
            ax.set_ylim(height, 0)
            ax.grid(False)
            ax.tick_params(axis="y", length=0)
            ax.set_xlabel(
                "time in s" if kept.clock.origin is not None else "frame" if kept.is_of_frames else "byte"
            )
            _shade_times(ax, kept, found.a if part == "a" else found.b)
            if len(self._parts) > 1:
                ax.set_title(f"{part.upper()}  {names['ab'.index(part)]}", parse_math=False)
            else:
                ax.set_title(f"A  {names[0]}      B (orange)  {names[1]}", parse_math=False)
            if number == 0:
                ax.set_yticks(middles, labels, fontsize=8, parse_math=False)
                if has_levels:
                    ax.tick_params(axis="y", pad=3.5 + LEVELS * 72)
                _write_levels(ax, lanes)
            else:
                ax.set_yticks([])
            if number == len(self._parts) - 1:
                right = ax.secondary_yaxis("right")
                right.set_yticks(middles, [f"{lane.change.score:.2f}" for lane in lanes], fontsize=7)
                right.tick_params(length=0)
        is_shaded = any(lane.change.signal is None for lane in lanes)
        key = (
            "blue: bit set, higher value, or more often; grey: clear; white: nothing came; "
            if is_shaded
            else ""
        )
        figure.text(
            1 - 0.1 / WIDTH,
            1 - 0.16 / tall,
            f"{key}on the right how telling it is",
            ha="right",
            va="center",
            fontsize=8,
        )


def _shade_lane(ax: Axes, top: float, shown: Shades, low: float, high: float) -> None:
    import matplotlib.colors as colours
    from matplotlib.patches import Rectangle

    shades = colours.LinearSegmentedColormap.from_list("lanes", SHADES)
    drawn = ax.imshow(
        np.ma.masked_invalid(shown.values)[None, :],
        extent=(shown.begin, shown.end, top + 0.92 * LANE, top + 0.08 * LANE),
        aspect="auto",
        interpolation="nearest",
        cmap=shades.with_extremes(bad=(1.0, 1.0, 1.0, 0.0)),
        vmin=low,
        vmax=high,
    )
    clip = Rectangle((shown.first, top), shown.end - shown.first, LANE, transform=ax.transData)
    drawn.set_clip_path(clip.get_path(), clip.get_transform())  # beside the box of the axes, not in its place


def _write_levels(ax: Axes, lanes: Sequence[Lane]) -> None:
    """Say left of the first part what the levels of signals are."""
    for lane in lanes:
        for at, text in lane.ticks:
            ax.annotate(
                text,
                (0, lane.top + at),
                xytext=(-4, 0),
                xycoords=ax.get_yaxis_transform(),
                textcoords="offset points",
                ha="right",
                va="center",
                fontsize=6.5,
                color="#505050",
                parse_math=False,
            )


def _shade_times(ax: Axes, part: LanePart, side: ComparedSide) -> None:
    """Show the times of a side, where it is not the whole recording."""
    low, high = part.span
    for window in side.windows:
        if window.bounds == (None, None):
            continue
        start, stop = (None if at is None else part.place(at) for at in window.bounds)
        begin, end = low if start is None else max(low, start), high if stop is None else min(high, stop)
        if end > begin:
            ax.axvspan(begin, end, color=B_COLOUR, alpha=0.3, linewidth=0, zorder=-1)
            ax.plot([begin, end], [0, 0], color=B_COLOUR, linewidth=4, clip_on=False, zorder=6)
