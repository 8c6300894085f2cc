"""What changed between two recordings or times, over time: a lane a change, A and B side by side or on one axis.

1. A lane shows its bits or byte as they were: darker is a higher share of ones, or a higher value; white is no frame.
   Of an identifier that appears, vanishes or comes at another rate, the lane shows how often it came.
2. Lanes are in the order of the report. Each side is read once, while it is compared: pipes can be drawn, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from aces_bus.compare import RecordingComparison, TrafficChange
from aces_bus.compare.comparer import ComparedSide
from aces_bus.compare.traffic import BusIdentifier
from aces_bus.frame_table import FrameTable

from .bit_image import BitImage, BitImages
from .figure import DPI, WIDTH, styled, write_figure
from .series import Array

#: Lanes in a picture.
MOST_LANES = 48
#: Inches: a lane, and what is left, right, above and below of all.
LANE, LEFT, RIGHT, ABOVE, BELOW, BETWEEN = 0.24, 2.3, 0.55, 0.62, 0.5, 0.2
SHADES = ("#E9E9E9", "#0072B2")
#: B's times, behind and beside the lanes.
B_COLOUR = "#D55E00"


class LanePicture:
    """Watches frames while they are compared, and draws what came out."""

    def __init__(self) -> None:
        self._images: dict[str, BitImages] = {}

    def add(self, table: FrameTable, sides: str) -> None:
        """Frames of the recording of these sides ("a", "b", or "ab")."""
        self._images.setdefault(sides, BitImages()).add(table)

    def save(self, path: str, found: RecordingComparison, names: Sequence[str]) -> int:
        """Draw into a file, if any identifier differs; how many changes have a lane. Raises `CallerError` when the file
        cannot be written."""
        from matplotlib.figure import Figure

        changes = [one for one in found.changes if one.identifier is not None][:MOST_LANES]
        if changes:
            with styled(None):
                figure = Figure()
                self.draw(figure, changes, found, names)
                write_figure(figure, path)
        return len(changes)

    def draw(
        self, figure: Any, changes: Sequence[TrafficChange], found: RecordingComparison, names: Sequence[str]
    ) -> None:
        """Draw lanes into a matplotlib figure, and make it as large as it needs to be."""
        parts = list(self._images)
        height = LANE * len(changes)
        tall = height + ABOVE + BELOW
        figure.set_size_inches(WIDTH, tall)
        room = WIDTH - LEFT - RIGHT - BETWEEN * (len(parts) - 1)
        left = LEFT
        for part in parts:
            wide = room / len(parts)
            ax = figure.add_axes((left / WIDTH, BELOW / tall, wide / WIDTH, height / tall))
            left += wide + BETWEEN
            self._lanes(ax, part, changes, max(1, round(wide * DPI)))
            _shade(ax, self._images[part], found.a if part == "a" else found.b)
            if len(parts) > 1:
                ax.set_title(f"{part.upper()}  {names['ab'.index(part)]}", parse_math=False)
            else:
                ax.set_title(f"A  {names[0]}      B (orange)  {names[1]}", parse_math=False)
            if part == parts[0]:
                labels = [f"{one.subject}  {one.place or one.kind}" for one in changes]
                ax.set_yticks(np.arange(len(changes)) + 0.5, labels, fontsize=8, parse_math=False)
            else:
                ax.set_yticks([])
            if part == parts[-1]:
                right = ax.secondary_yaxis("right")
                scores = [f"{one.score:.2f}" for one in changes]
                right.set_yticks(np.arange(len(changes)) + 0.5, scores, fontsize=7)
                right.tick_params(length=0)
        key = "blue: bit set, higher value, or more frames; grey: clear; white: no frame"
        figure.text(
            1 - 0.1 / WIDTH,
            1 - 0.16 / tall,
            f"{key}; on the right how telling it is",
            ha="right",
            va="center",
            fontsize=8,
        )

    def _lanes(self, ax: Any, part: str, changes: Sequence[TrafficChange], pixels: int) -> None:
        import matplotlib.colors as colours
        from matplotlib.patches import Rectangle

        images = self._images[part]
        low, high = images.seconds()
        shades = colours.LinearSegmentedColormap.from_list("lanes", SHADES).with_extremes(
            bad=(1.0, 1.0, 1.0, 0.0)
        )
        for row, change in enumerate(changes):
            image = _image(images, change.identifier)
            if image is None:
                continue
            count, lane = _lane(images, image, change, pixels)
            begin, end = images.extent(count, len(lane))
            drawn = ax.imshow(
                np.ma.masked_invalid(lane)[None, :],
                extent=(begin, end, row + 0.92, row + 0.08),
                aspect="auto",
                interpolation="nearest",
                cmap=shades,
                vmin=0.0,
                vmax=1.0,
            )
            first = images.begin(image)
            drawn.set_clip_path(Rectangle((first, row), high - first, 1, transform=ax.transData))
        ax.set_xlim(low, max(high, low + 1e-9))
        ax.set_ylim(len(changes), 0)
        ax.grid(False)
        ax.tick_params(axis="y", length=0)
        ax.set_xlabel("time in s" if images.has_times else "frame")


def _image(images: BitImages, identifier: BusIdentifier | None) -> BitImage | None:
    """Of this identifier, whatever its channel is called where there is one channel only."""
    if identifier is None or identifier in images.images:
        return images.images.get(identifier) if identifier is not None else None
    same = [one for key, one in images.images.items() if key[1:] == identifier[1:]]
    return same[0] if len(same) == 1 else None


def _lane(images: BitImages, image: BitImage, change: TrafficChange, pixels: int) -> tuple[int, Array]:
    """How many bins are joined, and what each shows: 0 to 1, NaN in gaps."""
    used = images.used
    least = -(-used // pixels)
    if change.byte is None or change.byte >= image.length:
        count = max(least, image.coarseness())
        frames = image.joined(image.frames, count, used).astype(float)
        return count, np.where(frames > 0, frames / max(1.0, frames.max()), np.nan)
    count, shares = image.shares(used, least)
    mine = shares[:, 8 * change.byte : 8 * change.byte + 8]
    bits = change.bits or tuple(range(8))
    weights = np.array([float(1 << bit) for bit in bits])
    return count, mine[:, list(bits)] @ weights / weights.sum()


def _shade(ax: Any, images: BitImages, side: ComparedSide) -> None:
    """Show the times of a side, where it is not the whole recording."""
    low, high = images.seconds()
    for window in side.windows:
        if window.bounds == (None, None):
            continue
        start, stop = ((None if at is None else (at - images.start) / images.unit) for at in window.bounds)
        begin, end = low if start is None else max(low, start), high if stop is None else min(high, stop)
        if end > begin:
            ax.axvspan(begin, end, color=B_COLOUR, alpha=0.3, linewidth=0, zorder=-1)
            ax.plot([begin, end], [0, 0], color=B_COLOUR, linewidth=4, clip_on=False, zorder=6)
