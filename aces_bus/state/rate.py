"""The derivative of a quantity, from the samples it has: nothing is stored, so all of its history has one at once.

1. The slope at an instant is that of the polynomial through the `order` + 1 samples up to the first one not before it.
2. Beside an unknown sample it is unknown: differences over gaps are guesses.
"""

from __future__ import annotations

import math
from typing import Any

from ..device.reading import UNKNOWN
from . import units
from .errors import StateError
from .polynomial import slope_at
from .quantity import EDGE_NS, Listener, TimeSeries
from .state import State

MOST_ORDER = 4


class Rate(TimeSeries):
    """The derivative over time, per second."""

    def __init__(self, source: TimeSeries, order: int = 1) -> None:
        if order not in range(1, MOST_ORDER + 1):
            raise StateError(f"state {source.name!r}: derivatives of order 1 … {MOST_ORDER}, not {order!r}")
        super().__init__(f"d({source.name})/dt", units.multiplied(source.unit, "s", -1), source.clock)
        self.source, self.order = source, order
        self.history, self.stale_after_s = source.history, source.stale_after_s
        self._newest = source.newest_slope if order == 1 and isinstance(source, State) else None

    def named(self, name: str, unit: str | None = None) -> Rate:
        """Return the same under a name, and in a unit of your choice of symbols."""
        made = Rate(self.source, self.order)
        made.name, made.unit = name, self.unit if unit is None else unit
        return made

    @property
    def value(self) -> Any:
        """The slope at the newest sample; `UNKNOWN` while there are fewer than two, or when they are stale."""
        return UNKNOWN if self.source.is_stale else self.last

    @property
    def last(self) -> Any:
        """The same, however old."""
        if self._newest is not None:
            return self._newest()
        instant = self.source.instant
        return UNKNOWN if instant is None else self._slope(instant)

    def at(self, instant: int) -> Any:
        """Return the slope at an instant (ns) within the history."""
        span = self.source.span
        if span is None:
            return UNKNOWN
        if not span[0] - EDGE_NS <= instant <= span[1] + EDGE_NS:
            raise self._outside(
                instant, "a derivative is not estimated beyond it: Kalman(…, derivative=1) is a filter"
            )
        return self._slope(instant)

    def _slope(self, instant: int) -> Any:
        source = self.source
        instants = source.samples_up_to(instant, self.order + 1)
        if len(instants) == 1:  # the oldest sample: the slope behind it
            span = source.span
            if span is None or span[1] == instants[0]:
                return UNKNOWN
            instants = source.samples_up_to(instants[0] + 1, 2)
        try:
            values = [source.at(sampled) for sampled in instants]
        except StateError:  # gone meanwhile, or not all inputs reach that far
            return UNKNOWN
        if len(values) < 2 or UNKNOWN in values:
            return UNKNOWN
        slope = slope_at(instants, values, instant)
        return slope if -math.inf < slope < math.inf else UNKNOWN

    @property
    def span(self) -> tuple[int, int] | None:
        """The instants (ns) between which the source has values; None before the first."""
        return self.source.span

    @property
    def instant(self) -> int | None:
        """The source's newest instant (ns)."""
        return self.source.instant

    @property
    def is_stale(self) -> bool:
        """True if the source is stale."""
        return self.source.is_stale

    @property
    def epoch(self) -> int:
        """The source's epoch."""
        return self.source.epoch

    @property
    def forgotten(self) -> int | None:
        """The instant (ns) before which the source's samples are gone; None when none was dropped."""
        return self.source.forgotten

    def samples_up_to(self, instant: int, most: int) -> list[int]:
        """Return the instants of the source's samples, up to the first that is not before `instant`."""
        return self.source.samples_up_to(instant, most)

    def samples_between(self, start: int, end: int) -> list[int]:
        """Return the instants of the source's samples there."""
        return self.source.samples_between(start, end)

    @property
    def origin(self) -> int | None:
        """The newest sample's instant, also of a source with an estimator."""
        return self.source.instant

    def subscribe(self, listener: Listener) -> None:
        """Call `listener(slope, instant)` with each sample of the source."""
        self.source.subscribe(lambda _, instant: listener(self._slope(instant), instant))
