"""Bit flips over time as images: a small multiple an identifier, time across, bits down.

1. The first byte is on top, and of each byte the highest bit, as bytes are written.
2. White is where no frame came; the lightest grey, where one came and the bit did not flip.
3. A pixel shows all frames of its time: where pictures have fewer pixels than there are bins, bins are joined, not left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..console import Output, terminal_width, wants_colour
from ..output.text import can_write, printable
from .bit_image import BitImage, BitImages
from .figure import DPI, TALLEST, WIDTH, styled, write_figure
from .series import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: From no flip to one in each frame. Seldom flips are to be seen: the scale goes by the square root.
SHADES = ("#E9E9E9", "#9CCBE8", "#3B8FCB", "#0B4F8A", "#04213D")
TICKS = (0.0, 0.01, 0.05, 0.2, 0.5, 1.0)
#: Inches: of a bit's row, of what is between two images, beside, above and below them.
ROW, BETWEEN, LEFT, BELOW, ABOVE = 0.028, 0.42, 0.62, 0.55, 0.75
#: One image alone has room for more.
LARGE_ROW = 0.075
#: No image is higher, and a line beside it has at least this height.
HIGHEST, LINE = 5.0, 0.11
#: Images up to which there is one column, and two; more have three.
ONE_COLUMN, TWO_COLUMNS = 2, 10


def bit_order(length: int) -> Array:
    """Return the bits of so many bytes from top to bottom: byte 0 first, of each byte bit 7 first."""
    order: Array = (np.arange(length)[:, None] * 8 + np.arange(7, -1, -1)).ravel()
    return order


@dataclass
class BitPicture:
    """Images of some identifiers of a recording, in this order."""

    images: BitImages
    chosen: Sequence[BitImage]
    title: str = ""
    style: str | None = None
    #: Names of the images, where these are not of identifiers.
    labels: Sequence[str] = ()

    @property
    def x_label(self) -> str:
        """Label of the horizontal axis."""
        return "time in s" if self.images.has_times else "frame"

    def names(self) -> list[str]:
        """Return the identifier of each image, behind its channel where there are several."""
        if self.labels:
            return [*self.labels]
        several = len({image.identifier.channel for image in self.images.images.values()}) > 1
        return [
            f"{image.identifier.channel} {image.identifier}" if several else str(image.identifier)
            for image in self.chosen
        ]


def save_bits(picture: BitPicture, path: str) -> None:
    """Draw into a file, whose suffix says the format. Raises `CallerError` when it cannot be written."""
    from matplotlib.figure import Figure

    with styled(picture.style):
        figure = Figure()
        draw_bits(picture, figure)
        write_figure(figure, path)


def draw_bits(picture: BitPicture, figure: Any) -> None:
    """Draw into a matplotlib figure, and make it as large as it needs to be."""
    import matplotlib.colors as colours
    from matplotlib.patches import Rectangle

    chosen, images = picture.chosen, picture.images
    count = len(chosen)
    columns = 1 if count <= ONE_COLUMN else 2 if count <= TWO_COLUMNS else 3
    rows = -(-count // columns)
    bit = LARGE_ROW if count == 1 else ROW
    lines = [chosen[n * columns : (n + 1) * columns] for n in range(rows)]
    heights = [max(_height(image, bit) for image in line) for line in lines]
    above = ABOVE + (0.3 if picture.title else 0)
    tall = sum(heights) + BETWEEN * (rows - 1) + above + BELOW
    scale = min(1.0, TALLEST / tall)
    tall *= scale
    figure.set_size_inches(WIDTH, tall)
    wide = (WIDTH - 0.25) / columns - LEFT
    pixels = max(1, round(wide * DPI))
    shades = colours.LinearSegmentedColormap.from_list("flips", SHADES).with_extremes(bad="white")
    norm = colours.PowerNorm(0.5, 0.0, 1.0)
    low, high = images.seconds()
    top = tall - above * scale
    drawn: Any = None
    names = picture.names()
    for row, line in enumerate(lines):
        for column, image in enumerate(line):
            height = _height(image, bit) * scale
            left = LEFT + column * (wide + LEFT)
            ax = figure.add_axes((left / WIDTH, (top - height) / tall, wide / WIDTH, height / tall))
            begin, end, rates = flip_rates(images, image, pixels)
            drawn = ax.imshow(
                np.ma.masked_invalid(rates),
                extent=(begin, end, rates.shape[0], 0),
                aspect="auto",
                interpolation="nearest",
                cmap=shades,
                norm=norm,
            )
            first = images.begin(image)
            drawn.set_clip_path(Rectangle((first, 0), high - first, rates.shape[0], transform=ax.transData))
            ax.set_xlim(low, max(high, low + 1e-9))
            ax.grid(False)
            for edge in range(8, rates.shape[0] if image.length <= 16 else 0, 8):
                ax.axhline(edge, color="white", linewidth=0.6)
            apart = math.ceil(LINE * image.length / height)
            shown = range(0, image.length, apart)
            ax.set_yticks([8 * byte + 4 for byte in shown], [str(byte) for byte in shown])
            ax.tick_params(axis="y", length=0, labelsize=7)
            ax.tick_params(axis="x", labelsize=7, length=2)
            if count == 1:
                _bit_ticks(ax, image.length)
            ax.set_title(
                f"{names[row * columns + column]}  {_frames(image)}", fontsize=8, parse_math=False, pad=3
            )
            is_last = row * columns + column + columns >= count
            ax.tick_params(labelbottom=is_last)
            if is_last:
                ax.set_xlabel(picture.x_label, fontsize=8)
            if column == 0:
                ax.set_ylabel("byte", fontsize=8)
        top -= (heights[row] + BETWEEN) * scale
    if drawn is not None:
        bar = figure.add_axes((1 - 3.6 / WIDTH, 1 - 0.3 / tall, 3.3 / WIDTH, 0.11 / tall))
        key = figure.colorbar(drawn, cax=bar, orientation="horizontal", ticks=TICKS)
        key.ax.set_xticklabels([f"{tick:g}" for tick in TICKS], fontsize=7)
        key.outline.set_linewidth(0.5)
        place = 1 - 3.75 / WIDTH, 1 - 0.245 / tall
        figure.text(*place, "share of frames in which a bit flips", ha="right", va="center", fontsize=8)
    if picture.title:
        figure.text(
            LEFT / WIDTH, 1 - 0.5 / tall, picture.title, fontsize=11, fontweight="bold", parse_math=False
        )


def _height(image: BitImage, bit: float) -> float:
    """Return inches, where a bit has `per_bit`."""
    return min(max(0.24, bit * 8 * image.length), HIGHEST if bit == LARGE_ROW else HIGHEST / 2)


def _bit_ticks(ax: Axes, length: int) -> None:
    """Put each bit's number on the right of an image that is alone."""
    if length <= 8:
        right = ax.secondary_yaxis("right")
        right.set_yticks(
            [row + 0.5 for row in range(8 * length)],
            [str(7 - row % 8) for row in range(8 * length)],
            fontsize=5,
        )
        right.tick_params(length=0, pad=1)


def _frames(image: BitImage) -> str:
    number = int(image.frames.sum())
    return f"{number} frame" + ("s" if number != 1 else "")


def flip_rates(images: BitImages, image: BitImage, pixels: int) -> tuple[float, float, Array]:
    """Begin and end of the time of an image, and the flips of its bits: (bits from top to bottom, at most `pixels`)."""
    count, rates = image.rates(images.used, least=-(-images.used // pixels))
    begin, end = images.extent(count, len(rates))
    return begin, end, rates.T[bit_order(image.length)]


# ---------------------------------------------------------------------- in a terminal

#: No frame, no flip, and ever more.
RICH_SHADES, PLAIN_SHADES = " ·░▒▓█", " .:+*#"
#: Shares from which on each of the upper four is drawn.
STEPS = (0.0, 0.05, 0.2, 0.5)


def print_bits(picture: BitPicture, colour: bool | None, *, is_by_byte: bool) -> None:
    """Draw in characters on standard output: a line a bit that flips, or a line a byte that changes."""
    output = Output(None)
    rich = can_write(RICH_SHADES, output.encoding)
    text = terminal_bits(picture, terminal_width(), is_rich=rich, is_by_byte=is_by_byte)
    if wants_colour(colour, output.is_terminal):
        lines = text.splitlines(keepends=True)
        text = "".join(line if line[:1] == " " else f"\x1b[1m{line.rstrip()}\x1b[0m\n" for line in lines)
    output.write(text.encode(output.encoding, "replace"))
    output.close()


def terminal_bits(picture: BitPicture, width: int, *, is_rich: bool, is_by_byte: bool) -> str:
    """Return the images as lines of text, none wider than `width`."""
    shades = np.array(list(RICH_SHADES if is_rich else PLAIN_SHADES))
    gutter = 7 if is_by_byte else 13
    room = max(8, width - gutter - 1)
    images = picture.images
    low, high = images.seconds()
    lines: list[str] = []
    if picture.title:
        lines += [printable(picture.title)[:width], ""]
    for name, image in zip(picture.names(), picture.chosen, strict=True):
        begin, end, rates = flip_rates(images, image, room)
        rows = rates.shape[0]
        labels = [f"byte {row // 8} bit {7 - row % 8}" for row in range(rows)]
        if is_by_byte:
            rates = _most(rates.reshape(-1, 8, rates.shape[1]))
            labels = [f"byte {byte}" for byte in range(image.length)]
        moving = [row for row in range(len(labels)) if (rates[row] > 0).any()]
        still = len(labels) - len(moving)
        what = "byte" if is_by_byte else "bit"
        note = f", {still} {what}{'s' if still > 1 else ''} constant" if still else ""
        lines.append(printable(f"{name}  {_frames(image)}{note}")[:width])
        places = low + (np.arange(room) + 0.5) * (high - low) / room
        columns = np.floor((places - begin) / (end - begin) * rates.shape[1]).astype(np.int64)
        columns = np.where((columns >= 0) & (columns < rates.shape[1]), columns, -1)
        for row in moving:
            values = np.where(columns >= 0, rates[row][np.maximum(columns, 0)], np.nan)
            level = np.where(
                np.isnan(values), 0, 1 + np.searchsorted(STEPS, np.nan_to_num(values), side="left")
            )
            lines.append(f" {labels[row]:<{gutter - 1}} " + "".join(shades[level].tolist()).rstrip())
        lines.append("")
    unit = " s" if images.has_times else ""
    left, right = f"{low:.6g}{unit}", f"{high:.6g}{unit}"
    lines.append(f" {'':<{gutter - 1}} {left} {right.rjust(room - len(left) - 1)}"[:width])
    key = [f"{shade} {top:.0%}" for top, shade in zip((*STEPS[1:], 1.0), shades[2:].tolist(), strict=True)]
    lines += _wrapped(
        ["blank: no frame", "flips in at most", f"{shades[1]} 0%", *key[:-1], f"{key[-1]} of frames"], width
    )
    return "\n".join(lines) + "\n"


def _wrapped(parts: Sequence[str], width: int) -> list[str]:
    """Return parts beside each other, in as many lines as a narrow terminal takes; a part that is wider alone
    is cut.
    """
    lines = [""]
    for part in parts:
        if lines[-1] and len(lines[-1]) + 2 + len(part) > width:
            lines.append("")
        lines[-1] += f"{'  ' if lines[-1] else ' '}{part}"
    return [line[:width] for line in lines]


def _most(rates: Array) -> Array:
    """Return the largest rate of the bits of each byte, NaN where there is none."""
    filled = np.where(np.isnan(rates), -1.0, rates).max(axis=1)
    return np.where(filled < 0, np.nan, filled)
