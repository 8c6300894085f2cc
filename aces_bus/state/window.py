"""A stretch of a quantity's history as arrays.

1. Samples are given with their real instants, NaN where unknown; nothing is resampled unless `rate_hz` says so.
2. Samples that were there and are gone make an error, not a shorter array.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from ..device.signals import UNKNOWN
from .errors import StateError
from .quantity import TimeSeries
from .state import State

if TYPE_CHECKING:
    from numpy import float64, int64
    from numpy.typing import NDArray

#: Points of an even grid.
MOST_POINTS = 1 << 22


class SampleWindow(NamedTuple):
    """`instants` in ns of the clock, `times_s` from the origin (0 is now or the newest sample), `values` with NaN:
    unknown.
    """

    instants: NDArray[int64]
    times_s: NDArray[float64]
    values: NDArray[float64]


def window_of(quantity: TimeSeries, t0: float | None, t1: float, rate_hz: float | None) -> SampleWindow:
    """See `TimeSeries.window`."""
    import numpy as np

    origin, span = quantity.origin, quantity.span
    if origin is None or span is None:
        empty = np.empty(0)
        return SampleWindow(np.empty(0, np.int64), empty, empty)
    end = origin + quantity._ns(t1)
    start = span[0] if t0 is None else origin + quantity._ns(t0)
    forgotten = quantity.forgotten
    if t0 is not None and forgotten is not None and start < forgotten:
        raise StateError(
            f"state {quantity.name!r}: samples from t = {t0:g} s on are asked for, those before "
            f"{(forgotten - origin) / 1e9:.9g} s are gone (it keeps {quantity.history}); keep more with history=…"
        )
    values: Any
    if rate_hz is not None:
        instants = np.array(
            _grid(quantity, start, min(end, span[1]) if t0 is None else end, rate_hz), np.int64
        )
        values = _values_at(quantity, instants.tolist())
    elif isinstance(quantity, State):
        stamps, numbers = quantity.piece_between(start, end)
        instants, values = np.array(stamps, np.int64), np.array(numbers, np.float64)
    else:
        instants = np.array(quantity.samples_between(start, end), np.int64)
        values = _values_at(quantity, instants.tolist())
    return SampleWindow(instants, (instants - origin) / 1e9, values)


def _values_at(quantity: TimeSeries, instants: list[int]) -> Any:
    import numpy as np

    at = quantity.at
    return np.array([np.nan if (value := at(one)) is UNKNOWN else value for one in instants], np.float64)


def _grid(quantity: TimeSeries, start: int, end: int, rate_hz: float) -> list[int]:
    if not 0 < rate_hz <= 1e9:
        raise StateError(f"state {quantity.name!r}: rate_hz = {rate_hz!r} is not a rate (0 < rate_hz ≤ 1e9)")
    if end < start:
        return []
    steps = int((end - start) * rate_hz / 1e9 + 1e-6)
    if steps >= MOST_POINTS:
        raise StateError(f"state {quantity.name!r}: {steps} points at {rate_hz:g} Hz; at most {MOST_POINTS}")
    return [end - round(i * 1e9 / rate_hz) for i in range(steps, -1, -1)]
