"""A picture as PNG, SVG, PDF or a window, drawn by matplotlib.

1. Files need no display: nothing here touches matplotlib's global state unless a window is asked for.
2. The same capture gives the same bytes: no dates, no random names.
3. Names come from protocols: they are text, never formulas.

Colours are those of Okabe and Ito (2008), which people who see colours differently tell apart; after seven lines the
dashes change.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.export.files import Staging, telling

from .picture import Picture, PlotLine, PlotPanel, lone, steps, values_range
from .series import thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#5F5F5F")
DASHES = ("-", "--", "-.", ":")
SUFFIXES = (".png", ".svg", ".pdf")
#: Inches.
WIDTH, TALLEST = 11.0, 60.0
DPI = 120
#: With fewer samples than this each is marked.
FEW = 40
LONGEST_NAME = 32


def load_matplotlib() -> ModuleType:
    """Return matplotlib; raise `CallerError` when it is not installed."""
    try:
        import matplotlib
    except ImportError as error:
        raise CallerError(
            "pictures and windows are drawn by matplotlib: pip install 'aces-bus[plot]'"
            " (without -o and --show the plot is drawn in the terminal, which needs nothing)"
        ) from error
    return matplotlib


def check_output(path: str) -> None:
    """Raise `CallerError` unless the file's suffix names a format, and its folder exists."""
    if os.path.splitext(path)[1].lower() not in SUFFIXES:
        raise CallerError(f"-o {path}: the suffix says the format, one of {', '.join(SUFFIXES)}")
    Staging(path, is_folder=False).discard()
    load_matplotlib()


def check_style(style: str | None) -> None:
    """Raise `CallerError` for a style that matplotlib does not have."""
    if style is not None:
        load_matplotlib()
        import matplotlib.style as styles

        if style not in styles.available and style != "default" and not os.path.isfile(style):
            raise UnknownNameError("matplotlib style", style, [s for s in styles.available if s[0] != "_"])


def save_figure(picture: Picture, path: str) -> None:
    """Draw into a file, whose suffix says the format. Raises `CallerError` when it cannot be written, and leaves what
    was there before."""
    check_output(path)
    from matplotlib.figure import Figure

    for panel in picture.panels:
        for line in panel.lines:  # files need not be larger than what is seen of them
            line.x, line.y = thin(line.x, line.y, 2 * round(WIDTH * DPI))
    with styled(picture.style):
        figure = Figure(figsize=(WIDTH, height_of(picture)), layout="constrained")
        draw_figure(picture, figure)
        write_figure(figure, path)


def write_figure(figure: Any, path: str) -> None:
    """Write a matplotlib figure to a file, inside of `styled`. Raise `CallerError` on failure, and keep the
    old file then.
    """
    kind = os.path.splitext(path)[1].lower()[1:]
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    staging = Staging(path, is_folder=False)
    try:
        with telling(path):
            figure.savefig(staging.temporary, format=kind, dpi=DPI, metadata=metadata)
        staging.commit()
    finally:
        staging.discard()


def show_figure(picture: Picture) -> None:
    """Open a window, and wait until it is closed. Raises `CallerError` when there is no display."""
    matplotlib = load_matplotlib()
    from matplotlib import pyplot

    if matplotlib.get_backend().lower() in ("agg", "pdf", "svg", "ps", "cairo", "template", "pgf"):
        raise CallerError("--show: no display, or no window toolkit (such as python3-tk); use -o FILE.png")
    with styled(picture.style):
        figure = pyplot.figure(figsize=(WIDTH, min(height_of(picture), 8.0)), layout="constrained")
        draw_figure(picture, figure)
        pyplot.show()


@contextmanager
def styled(style: str | None) -> Generator[None, None, None]:
    """Draw inside of this: in the style of this name, or in ours."""
    import matplotlib
    import matplotlib.style as styles

    ours: Any = {
        "agg.path.chunksize": 10_000,
        "svg.hashsalt": "aces",
        "text.usetex": False,
    }
    if style is None:
        ours |= {
            "font.size": 9,
            "axes.grid": True,
            "grid.color": "#E4E4E4",
            "grid.linewidth": 0.7,
            "axes.axisbelow": True,
            "axes.edgecolor": "#808080",
            "axes.titlesize": 9,
            "axes.titleweight": "bold",
            "axes.titlelocation": "left",
            "lines.linewidth": 1.2,
        }
    with matplotlib.rc_context(), styles.context(style or "default"), matplotlib.rc_context(ours):
        yield


def height_of(picture: Picture) -> float:
    """Return the inches that all panels together want."""
    return min(TALLEST, max(2.6, sum(map(_height, picture.panels)) + 0.6 + (0.3 if picture.title else 0)))


def _height(panel: PlotPanel) -> float:
    legend = 0.18 * len(panel.lines) + 0.35
    if panel.sort == "flags":
        return max(0.7, 0.24 * len(panel.lines) + 0.45)
    if panel.sort == "names":
        return max(1.1, 0.24 * min(len(panel.categories), 24) + 0.6, legend)
    return max(1.15 if panel.is_small else 2.3, legend)


def draw_figure(picture: Picture, figure: Any) -> None:
    """Draw the panels into a matplotlib figure."""
    grid = figure.add_gridspec(
        len(picture.panels), 1, height_ratios=[_height(panel) for panel in picture.panels]
    )
    shared: Any = None
    every: list[Any] = []
    for number, panel in enumerate(picture.panels):
        ax = figure.add_subplot(grid[number], sharex=shared)
        shared = shared if shared is not None else ax
        every.append(ax)
        if panel.title:
            ax.set_title(panel.title, parse_math=False)
        if panel.sort == "flags":
            _flags(picture, panel, ax)
        else:
            _lines(picture, panel, ax)
        if number < len(picture.panels) - 1:
            ax.tick_params(labelbottom=False)
    last = every[-1]
    # The formatter of dates says which day it is.
    caption = "UTC" if picture.has_instants and not picture.x_label else picture.caption
    last.set_xlabel(caption, parse_math=False)
    low, high = picture.span
    margin = (high - low) * 0.01
    last.set_xlim(*_places(picture, np.array([low - margin, high + margin])))
    if picture.has_instants:
        import matplotlib.dates

        dates: Any = matplotlib.dates  # has types for some of its functions only
        locator = dates.AutoDateLocator(tz="UTC")
        last.xaxis.set_major_locator(locator)
        last.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator, tz="UTC"))
    else:
        last.ticklabel_format(axis="x", style="plain", useOffset=False)
    if picture.title:
        figure.suptitle(picture.title, parse_math=False)


def _places(picture: Picture, x: Any) -> Any:
    if not picture.has_instants:
        return x + picture.offset
    assert picture.clock.origin is not None
    return (picture.clock.origin + np.round(x * 1e9).astype(np.int64)).astype("datetime64[ns]")


def _lines(picture: Picture, panel: PlotPanel, ax: Axes) -> None:
    number = 0
    handles: list[Any] = []
    labels: list[str] = []
    for place, lines in enumerate(panel.axes):
        own = ax if place == 0 else ax.twinx()
        if place > 0:
            own.grid(False)
            if place > 1:
                own.spines["right"].set_position(("axes", 1 + 0.08 * (place - 1)))
        for line in lines:
            handles.append(_line(picture, panel, line, own, number))
            labels.append(line.label + (" →" if place else ""))
            number += 1
        caption = panel.captions[place] or panel.units[place]
        if len(panel.axes) > 1 and len(lines) == 1:
            named = f"{lines[0].label} in {caption}" if caption else lines[0].label
            if not panel.captions[place] and len(named) <= LONGEST_NAME:
                caption = named
            own.yaxis.label.set_color(handles[-1].get_color())
        if caption:
            own.set_ylabel(short_name(caption), parse_math=False)
        if panel.sort == "numbers":
            own.set_ylim(*values_range(lines, panel.limits[place]))
    if panel.sort == "names":
        last = len(panel.categories) - 1
        apart = max(1, -(-(last + 1) // 24))
        ticks = list(range(0, last + 1, apart))
        ax.set_yticks(ticks, [short_name(panel.categories[tick]) for tick in ticks], parse_math=False)
        ax.set_ylim(-0.5, last + 0.5)
    if len(labels) > 1:
        beyond = 1.01 + (0.07 if len(panel.axes) > 1 else 0.0) + 0.08 * max(0, len(panel.axes) - 2)
        legend = ax.legend(
            handles,
            [str(n) for n in range(len(handles))],  # names that begin with _ would be left out
            loc="upper left",
            bbox_to_anchor=(beyond, 1.0),
            borderaxespad=0.0,
            frameon=False,
            fontsize=8,
            handlelength=1.8,
        )
        for text, label in zip(legend.get_texts(), labels, strict=True):
            text.set_parse_math(False)
            text.set_text(label)


def _line(picture: Picture, panel: PlotPanel, line: PlotLine, ax: Axes, number: int) -> Any:
    shape = line.format
    colour = shape.colour
    if colour is None:
        colour = COLOURS[number % len(COLOURS)] if picture.style is None else f"C{number % 10}"
    elif picture.style is None and len(colour) == 2:
        colour = COLOURS[int(colour[1]) % len(COLOURS)]
    x, y = _places(picture, line.x), line.y
    if shape.is_stem:
        there = ~np.isnan(y)
        stems = ax.stem(x[there], y[there], basefmt=" ", markerfmt=shape.marker or "o")
        stems.markerline.set(color=colour, markersize=3)
        stems.stemlines.set_color(colour)
        return stems.markerline
    style = shape.line
    if style is None:
        style = "none" if shape.marker else DASHES[number // len(COLOURS) % len(DASHES)]
    marker = shape.marker or ("." if len(x) <= FEW and panel.sort == "numbers" else None)
    is_step = panel.sort == "names" or picture.is_step
    (drawn,) = ax.plot(
        x,
        y,
        color=colour,
        linestyle=style,
        marker=marker,
        markersize=3 if marker not in (".", ",") else 5,
        drawstyle="steps-post" if is_step else "default",
    )
    if marker is None:
        alone = lone(y)
        if alone.any():
            ax.plot(x[alone], y[alone], ".", color=colour, markersize=4)
    return drawn


def _flags(picture: Picture, panel: PlotPanel, ax: Axes) -> None:
    """Draw each flag in a lane of its own, the first on top, filled while the flag is set."""
    lines = panel.lines
    for number, line in enumerate(lines):
        lane = len(lines) - 1 - number
        colour = COLOURS[number % len(COLOURS)]
        for part in _parts(line):
            x, y = steps(line.x[part], line.y[part])
            x = _places(picture, x)
            ax.fill_between(x, lane, lane + 0.75 * y, color=colour, alpha=0.65, linewidth=0)
            ax.plot(x, lane + 0.75 * y, color=colour, linewidth=0.8)
    ax.set_yticks(
        [len(lines) - 1 - n + 0.35 for n in range(len(lines))],
        [short_name(line.label, is_end=True) for line in lines],
        parse_math=False,
    )
    ax.tick_params(axis="y", length=0)
    ax.grid(False, axis="y")
    ax.set_ylim(-0.2, len(lines))


def _parts(line: PlotLine) -> Sequence[slice]:
    """Return the stretches between gaps."""
    there = np.concatenate(([False], ~np.isnan(line.y), [False]))
    edges = np.flatnonzero(there[1:] != there[:-1]).tolist()
    return [slice(start, stop) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def short_name(name: str, *, is_end: bool = False) -> str:
    """Return as much of a name as there is room for: its beginning, or its end."""
    if len(name) <= LONGEST_NAME:
        return name
    return "…" + name[1 - LONGEST_NAME :] if is_end else name[: LONGEST_NAME - 1] + "…"
