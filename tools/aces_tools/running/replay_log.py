"""A log in memory, and curves of it: what a demonstration draws.

1. A sample that is not known is NaN, which is a gap in a curve.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from aces_bus.protocol.columns.table import ColumnKind

from ..plotting.formats import ImageFormat
from ..plotting.picture import PlotLine, PlotPanel
from ..plotting.select import PlotSignal
from ..plotting.series import Series

Array = npt.NDArray[np.float64]


class Tape:
    """Samples states at a rate, for a `Runner`; `tape["RKN"]` is an array, `tape.seconds` when (s since the start)."""

    def __init__(self, states: Sequence[str], *, rate_hz: float, name: str = "tape") -> None:
        self.name, self.rate_hz, self.states = name, rate_hz, tuple(states)
        self._bound: list[Any] = []
        self._rows = array("d")
        self._began = 0

    def bind(self, states: Mapping[str, Any]) -> None:
        """Take the states; raises `UnknownNameError`."""
        self._bound = [states[name] for name in self.states]

    def start(self, now: int) -> None:
        """Begin anew at `now` (ns)."""
        self._began = now
        self._rows = array("d")

    def step(self, now: int) -> None:
        """Sample once."""
        row = self._rows
        row.append((now - self._began) / 1e9)
        for state in self._bound:
            value = state[0]
            row.append(float(value) if isinstance(value, int | float) else np.nan)

    def stop(self, now: int) -> None:
        """Nothing is to be closed."""

    def _table(self) -> Array:
        return np.array(self._rows, np.float64).reshape(-1, 1 + len(self.states))

    @property
    def seconds(self) -> Array:
        """When each sample was taken, in s since the start."""
        return self._table()[:, 0]

    def __getitem__(self, name: str) -> Array:
        """The samples of a state."""
        return self._table()[:, 1 + self.states.index(name)]


PLAIN = ImageFormat()


@dataclass(frozen=True)
class Curve:
    """One line of a picture: its label and values; `format` as of `aces plot`."""

    label: str
    values: Array
    format: ImageFormat = PLAIN


def panel_of(title: str, unit: str, seconds: Array, curves: Sequence[Curve]) -> PlotPanel:
    """A panel with these curves over one time axis (s)."""
    lines: list[PlotLine] = []
    for curve in curves:
        signal = PlotSignal("run", title, curve.label, curve.label, ColumnKind(curve.label, unit))
        series = Series(signal, ())
        lines.append(PlotLine(series, curve.format, seconds, curve.values, curve.label))
    return PlotPanel("numbers", [lines], title, [unit], [""], [(None, None)])
