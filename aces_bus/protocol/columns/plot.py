"""Signals of decoded tables over time, drawn by matplotlib.

1. `aces plot` draws what this leaves out: bits, conditions, windows, terminals.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...errors import CallerError
from .table import Array, Column, MessageTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: A pause of more than so many usual periods breaks the line.
PAUSE = 10
#: With fewer samples than this each is marked.
FEW = 40


def plot_signals(signals: Sequence[tuple[MessageTable, str | None]]) -> list[Axes]:
    """Draw columns of tables (None: all its numbers) in a new figure of pyplot, a pair of axes for each unit.

    Returns the axes from top to bottom. Raises `UnknownNameError` for a column that a table does not have, `TypeError` for
    one of texts or bytes, `CallerError` where no value is a number or matplotlib is not installed.
    """
    try:
        from matplotlib import pyplot
    except ImportError as missing:
        raise CallerError(
            f"pictures are drawn by matplotlib: pip install 'aces-bus[plot]' ({missing})"
        ) from missing

    panels: dict[str, list[tuple[str, MessageTable, Column]]] = {}
    for table, name in signals:
        names = [kind.name for kind in table.kinds if not kind.is_object] if name is None else [name]
        for column in table.columns(names):
            panels.setdefault(column.kind.unit, []).append((f"{table.message}.{column.name}", table, column))
    if not panels:
        raise CallerError(f"no numbers to draw in {', '.join(table.message for table, _ in signals)}")
    _figure, grid = pyplot.subplots(
        len(panels), sharex=True, squeeze=False, figsize=(10, 1 + 2.2 * len(panels)), layout="constrained"
    )
    axes: list[Axes] = list(grid[:, 0])
    starts = [table.seconds[0] for lines in panels.values() for _, table, _ in lines if len(table)]
    start = float(np.nanmin(starts)) if starts and not np.isnan(starts).all() else 0.0
    for ax, (unit, lines) in zip(axes, panels.items(), strict=True):
        for label, table, column in lines:
            words = column.kind.names
            seconds, values = _broken(table.seconds - start, column.to_float())
            # Labels are texts of others: a dollar sign begins no formula, and an underscore hides no line.
            label = label.replace("$", r"\$").lstrip("_")
            ax.plot(
                seconds,
                values,
                label=label,
                drawstyle="steps-post" if words else "default",
                marker="." if len(values) < FEW else "",
            )
            if words and len(words) <= 12:
                ax.set_yticks(list(words), [text.replace("$", r"\$") for text in words.values()])
        ax.set_ylabel(unit.replace("$", r"\$"))
        ax.legend(loc="upper right")
        ax.grid(visible=True, alpha=0.4)
    axes[-1].set_xlabel("s")
    return axes


def _broken(seconds: Array, values: Array) -> tuple[Array, Array]:
    """Return both with a NaN in each pause."""
    steps = np.diff(seconds)
    known = steps[steps > 0]
    if not len(known):
        return seconds, values
    pauses = np.flatnonzero(steps > PAUSE * float(np.median(known))) + 1
    return np.insert(seconds, pauses, seconds[pauses - 1]), np.insert(values, pauses, np.nan)
