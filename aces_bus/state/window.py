"""A stretch of a quantity's history as arrays, and the frequencies that it has: its Fourier transform.

1. Samples are given with their real instants, NaN where unknown; nothing is resampled unless `rate_hz` says so.
2. Samples that were there and are gone make an error, not a shorter array.
3. Amplitudes are single-sided and in the quantity's unit: a sine of amplitude A that fits the window has a peak of A.
4. The transform needs even samples. Those within 1 % of the period are taken as they are; others are interpolated
   onto an even grid, and the result says so. Unknown samples and a history shorter than the window are errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from ..device.reading import UNKNOWN
from .errors import StateError, raise_first
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
    end = origin + quantity.in_ns(t1)
    start = span[0] if t0 is None else origin + quantity.in_ns(t0)
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
    return np.array(
        [np.nan if (value := at(instant)) is UNKNOWN else value for instant in instants], np.float64
    )


def _grid(quantity: TimeSeries, start: int, end: int, rate_hz: float) -> list[int]:
    if not 0 < rate_hz <= 1e9:
        raise StateError(f"state {quantity.name!r}: rate_hz = {rate_hz!r} is not a rate (0 < rate_hz ≤ 1e9)")
    if end < start:
        return []
    steps = int((end - start) * rate_hz / 1e9 + 1e-6)
    if steps >= MOST_POINTS:
        raise StateError(f"state {quantity.name!r}: {steps} points at {rate_hz:g} Hz; at most {MOST_POINTS}")
    return [end - round(i * 1e9 / rate_hz) for i in range(steps, -1, -1)]


#: Name of a taper → the NumPy function of it.
TAPERS = {"none": "ones", "hann": "hanning", "hamming": "hamming", "blackman": "blackman"}

#: Spacing off by less than this share of the period counts as even.
EVEN = 0.01
FEWEST = 4


@dataclass(frozen=True, repr=False)
class Spectrum:
    """`amplitudes` (in `unit`) and `phases_rad` (of a cosine, at the first sample) at `frequencies_hz`, of samples
    at `rate_hz`.
    """

    frequencies_hz: NDArray[float64]
    amplitudes: NDArray[float64]
    phases_rad: NDArray[float64]
    rate_hz: float
    is_resampled: bool
    unit: str | None

    @property
    def peak(self) -> tuple[float, float]:
        """Frequency (Hz) and amplitude of the highest line, the mean left out."""
        place = 1 + int(self.amplitudes[1:].argmax())
        return float(self.frequencies_hz[place]), float(self.amplitudes[place])

    def __repr__(self) -> str:
        frequency, amplitude = self.peak
        unit = f" {self.unit}" if self.unit else ""
        resampled = ", resampled" if self.is_resampled else ""
        mean, last = self.amplitudes[0], self.frequencies_hz[-1]
        return (
            f"<Spectrum of {len(self.frequencies_hz)} lines up to {last:.6g} Hz: peak {amplitude:.6g}{unit} at"
            f" {frequency:.6g} Hz, mean {mean:.6g}{unit}; sampled at {self.rate_hz:.6g} Hz{resampled}>"
        )


def spectrum_of(quantity: TimeSeries, window_s: float, taper: str, rate_hz: float | None) -> Spectrum:
    """See `TimeSeries.spectrum`."""
    import numpy as np

    who = f"state {quantity.name!r}"
    raise_first(
        StateError,
        (taper not in TAPERS, f"{who}: no taper named {taper!r} (there are: {', '.join(TAPERS)})"),
        (not window_s > 0, f"{who}: a window of {window_s!r} s"),
    )
    found = quantity.window(-window_s, 0.0)
    if len(found.instants) < FEWEST:
        raise StateError(
            f"{who}: {len(found.instants)} samples in the last {window_s:g} s, a spectrum needs {FEWEST}"
        )
    spacing = np.diff(found.instants)
    period = float(np.median(spacing))
    unknown = int(np.isnan(found.values).sum())
    raise_first(
        StateError,
        (
            found.times_s[0] + window_s > 2e-9 * period,
            f"{who}: a spectrum of {window_s:g} s is asked for, the history reaches back to {found.times_s[0]:.6g} s",
        ),
        (
            unknown > 0,
            f"{who}: {unknown} of {len(found.values)} samples in the last {window_s:g} s are unknown",
        ),
    )
    is_even = bool(np.abs(spacing - period).max() <= EVEN * period)
    values: Any = found.values
    is_resampled = rate_hz is not None or not is_even
    if is_resampled:
        rate = 1e9 / period if rate_hz is None else rate_hz
        origin, span = quantity.origin, quantity.span
        begin = 0.0 if origin is None or span is None else (span[0] - origin) / 1e9
        values = quantity.window(max(-window_s, begin), float(found.times_s[-1]), rate_hz=rate).values
    else:
        rate = 1e9 * (len(values) - 1) / float(found.instants[-1] - found.instants[0])
    size = len(values)
    if size < FEWEST:
        raise StateError(f"{who}: {size} points at {rate:g} Hz, a spectrum needs {FEWEST}")
    weights: Any = getattr(np, TAPERS[taper])(size + 1)[:-1]
    mean = values.mean()  # taken out before the taper, which would spread it over the first lines
    lines = np.fft.rfft((values - mean) * weights) / weights.sum()
    lines[0] = mean
    lines[1 : (size + 1) // 2] *= 2  # the mean and, of an even number, the last line have no second side
    return Spectrum(
        np.fft.rfftfreq(size, 1 / rate).astype(np.float64),
        np.abs(lines),
        np.angle(lines),
        rate,
        is_resampled,
        quantity.unit,
    )
