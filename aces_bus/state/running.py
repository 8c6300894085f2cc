"""Quantities that need every sample: integrals and filters. Each is a state of its own, fed by its source.

1. An unknown sample of the source is an unknown sample here, and changes nothing inside: what follows is as if it
   had not been.
2. Whatever a filter does, the source goes on: one that raises gives an unknown sample (`counts.failed`, `failure`); one
   that has run away to infinity begins anew (`counts.restarts`).
3. A repeated instant is not taken again, so that no sample counts twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

from ..device.reading import UNKNOWN
from . import units
from .declaration import checked_seconds
from .errors import StateError, raise_first
from .quantity import TimeSeries
from .state import State

if TYPE_CHECKING:
    from .filters import Filter, Step

#: What becomes of uneven samples; see `TimeSeries.filtered`.
Uneven = Literal["resample", "refuse", "accept"]

#: Samples are even when none is off by more than this share of the period.
EVEN = 0.1
#: A sample so near to an instant of the grid (share of the period) is taken for it, or every second one would come late.
SNAP = 0.01
#: A gap of more periods than this is not bridged, and the filter begins anew.
GAP_PERIODS = 100

_NEVER = -(1 << 63)


class Running(State):
    """A state fed by another quantity; `source` is that one."""

    def __init__(self, source: TimeSeries, name: str, unit: str | None, *, late_s: float = 0.0) -> None:
        stale = source.stale_after_s
        super().__init__(
            name,
            unit=unit,
            clock=source.clock,
            history=source.history,
            interpolation="linear",
            stale_after_s=None if stale is None else stale + late_s,
        )
        self.source = source
        #: What a filter of the user's own raised last.
        self.failure: Exception | None = None
        self._taken_at, self._taken_epoch = _NEVER, source.epoch

    def _is_old(self) -> bool:
        """Return whether the source has given this instant before; not when it has forgotten all since, as this does
        then.
        """
        epoch = self.source.epoch
        if epoch == self._taken_epoch:
            return True
        self._taken_epoch = epoch
        self.clear()
        self._begin_again()
        return False

    def _begin_again(self) -> None:
        """Begin anew, as the source has."""
        raise NotImplementedError

    def _begin_taking(self, *, past: bool) -> None:
        """Take the source's samples: all that it has kept, or the newest only, and those to come."""
        span = self.source.span
        if span is not None:
            for instant in self.source.samples_between(span[0] if past else span[1], span[1]):
                self._take(self.source.at(instant), instant)
        self.source.subscribe(self._take)

    def _take(self, value: Any, instant: int) -> None:
        if instant <= self._taken_at and self._is_old():
            return
        self._taken_at = instant
        if value is UNKNOWN:
            self.push(UNKNOWN, instant)
        else:
            self._each(value, instant)

    #: Take a sample whose value is known.
    _each: Callable[[float, int], None]


class Integral(Running):
    """The integral over time; see `TimeSeries.integral`."""

    def __init__(self, source: TimeSeries, start: float = 0.0, max_gap_s: float | None = None) -> None:
        super().__init__(source, f"integral({source.name})", units.multiplied(source.unit, "s"))
        gap = checked_seconds(
            self.name, "max_gap_s", source.stale_after_s if max_gap_s is None else max_gap_s
        )
        self._max_gap = math.inf if gap is None else gap * 1e9
        self._skipped = 0
        self._area = self._start = start
        self._before: tuple[float, int] | None = None
        self._begin_taking(past=False)

    @property
    def skipped_s(self) -> float:
        """Time that adds nothing: its samples are too far apart, or the sum would be beyond what a float holds."""
        return self._skipped / 1e9

    def reset(self, start: float | None = None) -> None:
        """Begin again, from `start` (default: the one at the beginning), at the newest known sample."""
        self._area = self._start if start is None else start
        if self._before is not None:
            self.clear()
            self.push(self._area, self._before[1])

    def _each(self, value: float, instant: int) -> None:
        before = self._before
        self._before = value, instant
        if before is not None:
            duration = instant - before[1]
            area = self._area + (value + before[0]) * duration * 0.5e-9
            if duration <= self._max_gap and -math.inf < area < math.inf:
                self._area = area
            else:
                self._skipped += duration
        self.push(self._area, instant)

    def _begin_again(self) -> None:
        self._before = None


class Filtered(Running):
    """A quantity behind a filter; see `TimeSeries.filtered`."""

    def __init__(
        self, source: TimeSeries, kind: Filter | Callable[[float], float], uneven: Uneven = "resample"
    ) -> None:
        raise_first(
            StateError,
            (
                uneven not in ("resample", "refuse", "accept"),
                f"state {source.name!r}: uneven={uneven!r}; there are 'resample', 'refuse', 'accept'",
            ),
            (
                isinstance(kind, type) or not (callable(kind) or hasattr(kind, "start_filter")),
                f"state {source.name!r}: {kind!r} is not a filter; give one like LowPass(0.1), or a function of a value",
            ),
        )
        label = getattr(kind, "__name__", None) or type(kind).__name__
        rate = getattr(kind, "rate_hz", None)
        unit_of = getattr(kind, "unit_of", None)
        super().__init__(
            source,
            f"{label}({source.name})",
            source.unit if unit_of is None else unit_of(source.unit),
            late_s=0.0 if rate is None else 1 / rate,
        )
        self.kind, self.rate_hz, self.uneven = kind, rate, uneven
        self._step: Step | None = None
        self._before: tuple[float, int] = 0.0, _NEVER
        self._grid_from = self._grid_place = 0
        self._grid_next = _NEVER
        if rate is not None and uneven != "accept":
            period = getattr(source, "period_s", None)
            if uneven == "refuse" and period is not None and abs(period * rate - 1) > EVEN:
                raise StateError(
                    f"state {self.name!r}: the filter is made for {rate:g} Hz, its source is sampled at {1 / period:g} Hz; "
                    "design it for that rate, or say uneven='resample'"
                )
            self._period = 1e9 / rate
            self._snap = SNAP * self._period
            stale = source.stale_after_s
            self._max_gap = GAP_PERIODS * self._period
            if stale is not None:
                self._max_gap = min(self._max_gap, max(stale * 1e9, 2 * self._period))
            self._each = self._resampled if uneven == "resample" else self._refused
        else:
            self._each = self._accepted
        self._begin_taking(past=True)

    def _begin_again(self) -> None:
        self._step = None
        self._before = 0.0, _NEVER
        self._grid_next = _NEVER

    def _start(self, value: float) -> Step:
        start = getattr(self.kind, "start_filter", None)
        if start is not None:
            return start(value)  # type: ignore[no-any-return]
        function: Any = self.kind
        return lambda value, _: function(value)

    def _accepted(self, value: float, instant: int) -> None:
        """Take a sample as one step."""
        try:
            step = self._step
            if step is None:
                step = self._step = self._start(value)
            result: Any = step(value, instant)
            if not -math.inf < result < math.inf:
                self._step = None
                self._restarts += 1
        except Exception as error:  # a filter of the user's own: its source must go on
            self._failed += 1
            self.failure = error
            result = UNKNOWN
        if instant > self._newest_at:  # a grid instant may lie before an unknown sample that was passed on
            self.push(result, instant)

    def _refused(self, value: float, instant: int) -> None:
        """Step the filter while samples are even; restart it at an uneven one."""
        before, self._before = self._before[1], (value, instant)
        if before != _NEVER and abs(instant - before - self._period) > EVEN * self._period:
            self._uneven += 1
            self._step = self._start(value)
            self.push(UNKNOWN, instant)
            return
        self._accepted(value, instant)

    def _resampled(self, value: float, instant: int) -> None:
        """Step on the even grid that begins with the first sample; interpolate linearly between two samples."""
        old, before = self._before
        self._before = value, instant
        at, snap = self._grid_next, self._snap
        if -snap <= instant - at <= snap:  # samples that come as they should
            self._grid_place = place = self._grid_place + 1
            self._grid_next = self._grid_from + round(place * self._period)
            self._accepted(value, at if at < instant else instant)
            return
        if before == _NEVER or instant - before > self._max_gap:
            if before != _NEVER:
                self._step = None
                self._restarts += 1
            self._grid_from, self._grid_place = instant, 0
            self._grid_on()
            self._accepted(value, instant)
            return
        slope = (value - old) / (instant - before)
        while (at := self._grid_next) <= instant + snap:
            self._grid_on()
            if at >= instant - snap:
                self._accepted(value, at if at < instant else instant)
            else:
                self._accepted(old + slope * (at - before), at)

    def _grid_on(self) -> None:
        """Move to the next instant of the grid, counted from its beginning, so that rounding does not add up."""
        self._grid_place += 1
        self._grid_next = self._grid_from + round(self._grid_place * self._period)
