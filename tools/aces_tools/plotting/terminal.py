"""A picture in characters: braille dots for lines, block characters for flags, as wide as the terminal.

1. No line of text is wider than `width`, whatever the names.
2. Without colours lines carry their number, as on a map: a plot in a file or an e-mail can be read, too.
3. Where the output has no braille, dots are `*` and frames ASCII.
4. Nothing that came from a protocol or a wire reaches the terminal as a control character.

Each character is two dots wide and four high. Series are thinned to the first, last, lowest and highest sample of each
dot's stretch of time before they are drawn, so that a spike shows however short it is.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt

from ..console import Output, terminal_width, wants_colour
from ..output.text import can_write, printable
from .picture import Picture, PlotLine, PlotPanel, instant, lone, steps, values_range
from .series import thin

#: (style, text) → text: style is a colour of rich, or "dim" or "bold".
Paint = Callable[[str, str], str]
Array = npt.NDArray[Any]

#: Okabe and Ito's colours, those first that show on dark and on light ground.
COLOURS = ("#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#0072B2", "#F0E442")
NAMED = {
    "b": "blue",
    "g": "green",
    "r": "red",
    "c": "cyan",
    "m": "magenta",
    "y": "yellow",
    "k": "default",
    "w": "default",
}
#: Bits of a braille character's dots: column, then row from the top.
DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
LEAST_WIDTH = 20
#: Lines carry their number every so many columns where there are no colours.
APART = 24


def make_plot_paint() -> Paint:
    """Return a function that colours as rich does for this terminal, or by its 16 colours where it cannot tell."""
    from rich.color import ColorSystem
    from rich.console import Console
    from rich.style import Style

    name = Console(force_terminal=True).color_system or "standard"
    system = {
        "standard": ColorSystem.STANDARD,
        "256": ColorSystem.EIGHT_BIT,
        "truecolor": ColorSystem.TRUECOLOR,
        "windows": ColorSystem.WINDOWS,
    }[name]
    styles: dict[str, Style] = {}

    def paint(style: str, text: str) -> str:
        if style not in styles:
            styles[style] = Style.parse(style)
        return styles[style].render(text, color_system=system)

    return paint


def draw_terminal(
    picture: Picture,
    width: int,
    *,
    paint: Paint | None = None,
    height: int | None = None,
    encoding: str = "utf-8",
) -> str:
    """Return the picture as lines of text. `height` is what all of it may have, in lines; `paint` None is without colour."""
    return _Drawing(picture, max(width, LEAST_WIDTH), paint, can_write("⣿│┤└─┬█▓…━", encoding)).text(height)


def print_picture(
    picture: Picture, colour: bool | None, most_width: int = 10_000, spare_lines: int = 1
) -> None:
    """Draw on standard output, as wide as the terminal, and as high but for the spare lines."""
    output = Output(None)
    height = None
    if output.is_terminal:
        with suppress(OSError, ValueError, AttributeError):
            height = os.get_terminal_size(sys.stdout.fileno()).lines - spare_lines
    paint = make_plot_paint() if wants_colour(colour, output.is_terminal) else None
    width = min(terminal_width(), most_width)
    text = draw_terminal(picture, width, paint=paint, height=height, encoding=output.encoding)
    output.write(text.encode(output.encoding, "replace"))
    output.close()


class _Drawing:
    def __init__(self, picture: Picture, width: int, paint: Paint | None, is_rich: bool) -> None:
        self.picture = picture
        self.width = width
        self.is_coloured = paint is not None
        self.paint: Paint = paint or (lambda style, text: text)
        self.bar, self.tick, self.corner, self.dash, self.down, self.dots = (
            ("│", "┤", "└", "─", "┬", "…") if is_rich else ("|", "+", "+", "-", "+", "~")
        )
        self.is_rich = is_rich
        self.low, self.high = picture.span
        #: Panels in characters show one vertical axis each.
        self.parts = [(panel, place) for panel in picture.panels for place in range(max(1, len(panel.axes)))]
        self.gutter = 0
        self.columns = 0

    def text(self, height: int | None) -> str:
        rows = self._rows(height)
        frames = [self._scale(panel, place, n) for (panel, place), n in zip(self.parts, rows, strict=True)]
        longest = max(len(label) for labels in frames for label in labels.values())
        self.gutter = min(max(longest, 4), max(6, self.width // 3))
        self.columns = self.width - self.gutter - 1
        lines: list[str] = []
        if self.picture.title:
            lines += [
                self.paint(
                    "bold", self._cut(printable(self.picture.title), self.width).center(self.width).rstrip()
                )
            ]
        for (panel, place), n, labels in zip(self.parts, rows, frames, strict=True):
            if lines:
                lines.append("")
            lines += self._heading(panel, place)
            lines += self._panel(panel, place, n, labels)
        lines += self._axis()
        return "\n".join(lines) + "\n"

    def _rows(self, height: int | None) -> list[int]:
        """Return the lines of each panel."""
        fixed: list[int | None] = []
        for panel, _ in self.parts:
            if panel.sort == "flags":
                fixed.append(len(panel.lines))
            elif panel.sort == "names":
                fixed.append(min(max(3, 2 * len(panel.categories) - 1), 16))
            else:
                fixed.append(None)
        free = sum(rows is None for rows in fixed)
        each = 14 if free < 3 else 10
        if height is not None and free:
            taken = sum(rows or 0 for rows in fixed) + 3 * len(fixed) + 3
            each = min(24, max(6, (height - taken) // free))
        return [each if rows is None else rows for rows in fixed]

    # ------------------------------------------------------------------ vertical axis

    def _scale(self, panel: PlotPanel, place: int, rows: int) -> dict[int, str]:
        """Return labels of the vertical axis by row."""
        if panel.sort == "flags":
            return {row: printable(line.label) for row, line in enumerate(panel.lines)}
        if panel.sort == "names":
            top = len(panel.categories) - 0.5
            places = reversed(list(enumerate(panel.categories)))  # of several in one row the first is named
            return {self._row(at, -0.5, top, rows): printable(name) for at, name in places}
        low, high = values_range(panel.axes[place], panel.limits[place])
        step = nice_step((high - low) / max(1, rows // 3))
        return {
            self._row(number, low, high, rows): number_text(number, step) for number in ticks(low, high, step)
        }

    @staticmethod
    def _row(value: float, low: float, high: float, rows: int) -> int:
        return min(rows - 1, max(0, int((high - value) / (high - low) * rows)))

    # ------------------------------------------------------------------ text around

    def _cut(self, text: str, width: int) -> str:
        return text if len(text) <= width else text[: max(0, width - 1)] + self.dots

    def _heading(self, panel: PlotPanel, place: int) -> list[str]:
        lines = panel.axes[place]
        parts = [panel.title] if panel.title else []
        if len(lines) == 1 and (not panel.title or len(panel.axes) > 1):
            parts.append(lines[0].label)
        if panel.captions[place]:
            parts.append(panel.captions[place])
        title = "  ".join(parts)
        if not panel.captions[place] and panel.units[place]:
            title = f"{title} in {panel.units[place]}".lstrip()
        title = printable(title)
        out = [self.paint("bold", self._cut(title, self.width))] if title else []
        if len(lines) > 1 and panel.sort != "flags":
            out += self._legend(lines)
        return out

    def _legend(self, lines: Sequence[PlotLine]) -> list[str]:
        out: list[str] = []
        line, at = "", 0
        for number, entry in enumerate(lines):
            mark = ("━━" if self.is_rich else "--") if self.is_coloured else str(number + 1)
            label = self._cut(printable(entry.label), self.width - len(mark) - 2)
            size = len(mark) + 1 + len(label)
            if at and at + 3 + size > self.width:
                out.append(line)
                line, at = "", 0
            if at:
                line, at = line + "   ", at + 3
            line += f"{self.paint(_colour(entry, number), mark)} {label}"
            at += size
        return [*out, line]

    def _axis(self) -> list[str]:
        """Return the time axis: a rule with ticks, their labels, what they are."""
        picture, columns = self.picture, self.columns
        room = 12 if picture.has_instants else 10
        offset = picture.offset
        low, high = self.low + offset, self.high + offset
        step = nice_step((high - low) / max(1, columns // room))
        rule = [self.dash] * columns
        labels = [" "] * (self.gutter + 1 + columns)
        taken = 0
        for number in ticks(low, high, step):
            at = min(columns - 1, int((number - low) / (high - low) * columns))
            text = self._instant(number, step) if picture.has_instants else number_text(number, step)
            start = min(max(0, self.gutter + 1 + at - len(text) // 2), self.width - len(text))
            if start < taken:
                continue
            rule[at] = self.down
            labels[start : start + len(text)] = text
            taken = start + len(text) + 1
        caption = printable(picture.caption)
        return [
            " " * self.gutter + self.paint("dim", self.corner + "".join(rule)),
            "".join(labels).rstrip(),
            " " * self.gutter + self._cut(caption, columns).center(columns + 1).rstrip(),
        ]

    def _instant(self, seconds: float, step: float) -> str:
        origin = self.picture.clock.origin or 0
        text = f"{instant(origin + round(seconds * 1e9)):%H:%M:%S.%f}"
        digits = max(0, math.ceil(-math.log10(step) - 1e-9))
        return text[:8] if not digits else text[: 9 + min(digits, 6)]

    # ------------------------------------------------------------------ panels

    def _panel(self, panel: PlotPanel, place: int, rows: int, labels: dict[int, str]) -> list[str]:
        bodies = (
            [self._lane(line, number) for number, line in enumerate(panel.lines)]
            if panel.sort == "flags"
            else self._canvas(panel, place, rows)
        )
        out: list[str] = []
        for row, body in enumerate(bodies):
            text = labels.get(row, "")
            if len(text) > self.gutter:  # of a long name the end says more
                text = self.dots + text[1 - self.gutter :]
            bar = self.tick if row in labels else self.bar
            out.append(f"{text.rjust(self.gutter)}{self.paint('dim', bar)}{body}".rstrip())
        return out

    def _columns_of(self, x: Array, count: int) -> Array:
        places: Array = ((x - self.low) * (count / (self.high - self.low))).astype(np.int64)
        return np.clip(places, 0, count - 1)

    def _lane(self, line: PlotLine, number: int) -> str:
        """Return a flag: full while set, a thin line while not, half where both happen in one column."""
        on = np.zeros(self.columns, bool)
        off = np.zeros(self.columns, bool)
        x, y = line.x, line.y
        for index in range(len(x)):
            if np.isnan(y[index]):
                continue
            start = int(self._columns_of(x[index : index + 1], self.columns)[0])
            stop = start + 1
            if index + 1 < len(x) and not np.isnan(y[index + 1]):
                stop = max(stop, int(self._columns_of(x[index + 1 : index + 2], self.columns)[0]))
            (on if y[index] else off)[start:stop] = True
        full, mixed, thin_line = ("█", "▓", "─") if self.is_rich else ("#", "%", "-")
        marks = np.where(on, np.where(off, mixed, full), np.where(off, thin_line, " "))
        return self.paint(_colour(line, number), "".join(marks.tolist()).rstrip())

    def _canvas(self, panel: PlotPanel, place: int, rows: int) -> list[str]:
        """Return the lines of one axis, drawn in braille."""
        lines = panel.axes[place]
        low, high = (
            (-0.5, len(panel.categories) - 0.5)
            if panel.sort == "names"
            else values_range(lines, panel.limits[place])
        )
        wide, tall = 2 * self.columns, 4 * rows
        cells = np.zeros((rows, self.columns), np.uint8)
        owner = np.full((rows, self.columns), -1, np.int64)
        marks: dict[tuple[int, int], str] = {}
        for number, line in enumerate(lines):
            bits = np.zeros((tall, wide), bool)
            is_step = panel.sort == "names" or self.picture.is_step
            self._trace(bits, line, low, high, is_step=is_step)
            mine = np.zeros((rows, self.columns), np.uint8)
            for column in (0, 1):
                for row in range(4):
                    mine |= bits[row::4, column::2] * np.uint8(DOTS[column][row])
            cells |= mine
            owner[mine > 0] = number
            if len(lines) > 1 and not self.is_coloured:
                self._number(mine, number, len(lines), marks)
        return self._cells(cells, owner, lines, marks)

    def _number(self, mine: Array, number: int, count: int, marks: dict[tuple[int, int], str]) -> None:
        """Write a line's number onto the line, about every `APART` columns, beside no other number.

        `mine` has the cells of the line; `marks` are the characters so far, by row and column.
        """
        digits = str(number + 1)
        first = round(APART / 2 * (number + 0.5) / count) + 1  # lines begin at different columns
        for start in range(first, self.columns, APART):
            for column in range(start, min(start + APART - 4, self.columns - len(digits))):
                rows = np.flatnonzero(mine[:, column])
                if not len(rows):
                    continue
                row = int(rows[0])
                around = range(column - 1, column + len(digits) + 1)
                if not any((row, place) in marks for place in around):
                    marks.update(((row, column + n), digit) for n, digit in enumerate(digits))
                    break

    def _cells(
        self, cells: Array, owner: Array, lines: Sequence[PlotLine], marks: dict[tuple[int, int], str]
    ) -> list[str]:
        out: list[str] = []
        for row in range(len(cells)):
            text, run, style = "", "", ""
            for column in range(self.columns):
                bits = int(cells[row, column])
                character = marks.get((row, column))
                if character is None:
                    character = " " if not bits else chr(0x2800 + bits) if self.is_rich else "*"
                number = int(owner[row, column])
                wanted = _colour(lines[number], number) if bits and number >= 0 else ""
                if wanted != style and character != " ":
                    text += self.paint(style, run) if style else run
                    run, style = "", wanted
                run += character
            text += self.paint(style, run.rstrip()) if style else run.rstrip()
            out.append(text)
        return out

    def _trace(self, bits: Array, line: PlotLine, low: float, high: float, *, is_step: bool) -> None:
        """Set the dots of a line."""
        tall, wide = bits.shape
        x, y = thin(line.x, line.y, wide)
        single = lone(y) if line.format.marker is None or line.format.line else ~np.isnan(y)
        lone_x, lone_y = x[single], y[single]
        is_line = line.format.line is not None or line.format.marker is None

        def row_of(values: Array) -> Array:
            rows: Array = np.floor((high - values) / (high - low) * tall)
            return rows

        def column_of(places: Array) -> Array:
            return self._columns_of(places, wide)

        for column, row in zip(column_of(lone_x).tolist(), row_of(lone_y).tolist(), strict=True):
            if 0 <= row < tall:
                bits[int(row), column] = True
        if line.format.is_stem:
            there = ~np.isnan(y)
            zero = row_of(np.zeros(1))[0]
            for column, row in zip(column_of(x[there]).tolist(), row_of(y[there]).tolist(), strict=True):
                _vertical(bits, column, row, zero)
            return
        if not is_line:
            return
        if is_step:
            x, y = steps(x, y)
        columns = column_of(x).tolist()
        rows = row_of(np.where(np.isnan(y), 0.0, y)).tolist()
        gone = np.isnan(y).tolist()
        for n in range(len(columns) - 1):
            if not (gone[n] or gone[n + 1]):
                _segment(bits, columns[n], rows[n], columns[n + 1], rows[n + 1])


def _vertical(bits: Array, column: int, low: float, other: float) -> None:
    tall = bits.shape[0]
    top, bottom = max(0, int(min(low, other))), min(tall - 1, int(max(low, other)))
    if top <= bottom:
        bits[top : bottom + 1, column] = True


def _segment(bits: Array, start: int, first: float, stop: int, last: float) -> None:
    """Draw a straight line without holes between two dots; clip what lies outside."""
    if start == stop:
        _vertical(bits, start, first, last)
        return
    tall = bits.shape[0]
    slope = (last - first) / (stop - start)
    for column in range(start, stop + 1):
        here = first + slope * (column - start)
        half = abs(slope) / 2
        top = max(here - half, min(first, last))
        bottom = min(here + half, max(first, last))
        if bottom >= 0 and top < tall:
            _vertical(bits, column, round(max(top, 0.0)), round(min(bottom, tall - 1.0)))


def _colour(line: PlotLine, number: int) -> str:
    colour = line.format.colour
    if colour is None:
        return COLOURS[number % len(COLOURS)]
    return COLOURS[int(colour[1]) % len(COLOURS)] if len(colour) == 2 else NAMED[colour]


def nice_step(least: float) -> float:
    """Return the next of 1, 2, 5, 10, 20, … from `least` on."""
    if not least > 0 or not math.isfinite(least):
        return 1.0
    power: float = 10.0 ** math.floor(math.log10(least))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least * (1 - 1e-9))


def ticks(low: float, high: float, step: float) -> list[float]:
    """Return multiples of `step` in [low, high]."""
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [number * step for number in range(first, min(last, first + 200) + 1)]


def number_text(number: float, step: float) -> str:
    """Return a tick's number, with the digits that its step has."""
    size = max(abs(number), step)
    if size >= 1e7 or (step < 1e-5 and size < 1e-2):
        return f"{number:.6g}"
    digits = max(0, math.ceil(-math.log10(step) - 1e-9))
    text = f"{number:.{min(digits, 9)}f}"
    return text.lstrip("-") if float(text) == 0 else text
