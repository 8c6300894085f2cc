"""One quantity over time: how it is read, whatever gives its values.

1. `q[t]` is the value `t` seconds from its *origin*. Without an estimator the origin is the newest sample, so that
   with samples at f hertz `q[-1 / f]` is the one before, as in the paper; with an estimator it is now.
   `q.at(instant)` takes an instant (ns).
2. Unknown is a value: `UNKNOWN` before the first sample, where a sample was unknown, and in `q[0]` when it is stale: an old
   value never passes as a fresh one. `q.last` is the newest sample, however old.
3. What lies outside the history and has no estimator raises `StateError`; it is never clamped. `q.get(t, default)`
   does not raise.
4. Arithmetic gives quantities, evaluated when they are read. `rate`, `integral` and `filtered` give the same object when
   asked the same again, so that a control loop may call them each cycle.

A subclass says where values come from: `State` keeps samples, `Derived` computes from other quantities, `Running` (integral,
filters) is a state fed by another quantity.
"""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any

from ..device.reading import UNKNOWN, Reading
from ..runtime.clock import Clock
from .errors import StateError

if TYPE_CHECKING:
    from .derived import Derived
    from .filters import Filter
    from .rate import Rate
    from .running import Filtered, Integral, Uneven
    from .window import SampleWindow, Spectrum

Listener = Callable[[Any, int], None]

#: Asked so little beyond the first or last sample, it is meant: -3 / f seconds is not a whole number of nanoseconds.
EDGE_NS = 1_000

#: Integrals, filters and derivatives of one quantity, at most: each costs time with every sample.
MOST_MADE = 64


class TimeSeries(ABC):
    """What can be read like a state. `unit` is "" for a plain number and None where it is not stated."""

    name: str
    unit: str | None
    clock: Clock
    #: How many samples are kept.
    history: int
    #: The age after which the value passes no longer as fresh; None: never.
    stale_after_s: float | None

    def __init__(self, name: str, unit: str | None, clock: Clock) -> None:
        self.name, self.unit, self.clock = name, unit, clock
        self._made: dict[Hashable, TimeSeries] = {}

    # ---- what a subclass gives ------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def last(self) -> Any:
        """The newest value (float), however old; `UNKNOWN` where there is none."""

    @property
    @abstractmethod
    def span(self) -> tuple[int, int] | None:
        """The instants (ns) between which it has values of its own; None before the first."""

    @property
    @abstractmethod
    def is_stale(self) -> bool:
        """True if the newest value is too old, or there is none."""

    @abstractmethod
    def at(self, instant: int) -> Any:
        """Return the value at an instant (ns of `clock`): float or `UNKNOWN`. Raises `StateError` outside of what it
        can know.
        """

    @abstractmethod
    def samples_up_to(self, instant: int, most: int) -> list[int]:
        """Return the instants of up to `most` samples, ascending; the last one is the first that is not
        before `instant`.
        """

    @abstractmethod
    def samples_between(self, start: int, end: int) -> list[int]:
        """Return the instants of all samples kept with start ≤ instant ≤ end, ascending."""

    @property
    @abstractmethod
    def forgotten(self) -> int | None:
        """Samples before this instant were there and are not kept any more; None when none was dropped."""

    @property
    @abstractmethod
    def epoch(self) -> int:
        """Grows whenever all was forgotten, so that who keeps sums of it begins anew."""

    @abstractmethod
    def subscribe(self, listener: Listener) -> None:
        """Call `listener(value, instant)` with each new sample; it must return soon, and may get `UNKNOWN`."""

    # ---- reading --------------------------------------------------------------------------------------------------

    @property
    def instant(self) -> int | None:
        """When the newest value was measured (ns); None before the first."""
        span = self.span
        return None if span is None else span[1]

    @property
    def origin(self) -> int | None:
        """The instant of `q[0]` (rule 1)."""
        return self.instant

    @property
    def value(self) -> Any:
        """The newest value (float) if it is fresh, else `UNKNOWN`; the same as `q[0]`."""
        return UNKNOWN if self.is_stale else self.last

    @property
    def age_ns(self) -> int | None:
        """Age of the newest value; None when there is none."""
        instant = self.instant
        return None if instant is None else max(0, self.clock.now() - instant)

    @property
    def age_s(self) -> float | None:
        """The same in seconds."""
        age = self.age_ns
        return None if age is None else age / 1e9

    @property
    def is_known(self) -> bool:
        """True if `q[0]` is a number."""
        return self.value is not UNKNOWN

    def read(self) -> Reading:
        """Return last value, its instant, age and staleness, together."""
        return Reading(self.last, self.instant, self.age_ns, self.is_stale)

    def __getitem__(self, t: float) -> Any:
        """Return the value `t` seconds from the origin (rule 1): float or `UNKNOWN`; raises `StateError` outside the
        history.
        """
        if t == 0:
            return self.value
        origin = self.origin
        if origin is None:
            return UNKNOWN
        try:
            instant = origin + round(t * 1e9)
        except (OverflowError, ValueError, TypeError):
            instant = origin + self.in_ns(t)  # says what is wrong with it
        try:
            return self.at(instant)
        except StateError as error:
            error.is_permanent = error.is_permanent or t > 0
            raise

    def get(self, t: float, default: Any = UNKNOWN) -> Any:
        """Return `q[t]`, or `default` where that is unknown or outside of what can be known."""
        try:
            value = self[t]
        except StateError:
            return default
        return default if value is UNKNOWN else value

    def in_ns(self, t: float) -> int:
        """Return a time in seconds as nanoseconds; raises `StateError` where it is none."""
        try:
            return round(t * 1e9)
        except (OverflowError, ValueError, TypeError):
            raise StateError(f"state {self.name!r}: {t!r} is not a time in seconds") from None

    def _outside(self, instant: int, hint: str) -> StateError:
        """Return the error for an instant outside of the history."""
        origin, span = self.origin, self.span
        if origin is None or span is None:
            return StateError(f"state {self.name!r}: it has no sample yet")
        error = StateError(
            f"state {self.name!r} has no value at t = {(instant - origin) / 1e9:+.9g} s: its history reaches from "
            f"{(span[0] - origin) / 1e9:.9g} to {(span[1] - origin) / 1e9:.9g} s; {hint}"
        )
        forgotten = self.forgotten
        error.is_permanent = forgotten is not None and instant < forgotten
        return error

    # ---- quantities made from it ----------------------------------------------------------------------------------

    def _make(self, kind: str, *arguments: Any) -> Any:
        """Return the integral, filter or derivative of these arguments: the same object when asked the same again."""
        made = self._made.get((kind, *arguments))
        if made is None:
            if len(self._made) >= MOST_MADE:
                raise StateError(
                    f"state {self.name!r} has {MOST_MADE} integrals, filters and derivatives already; "
                    "are their parameters changed each cycle? Make them once"
                )
            from . import rate, running

            kinds: dict[str, Any] = {
                "rate": rate.Rate,
                "integral": running.Integral,
                "filtered": running.Filtered,
            }
            made = self._made[kind, *arguments] = kinds[kind](self, *arguments)
        return made

    def rate(self, order: int = 1) -> Rate:
        """Return the derivative (unit per second), from the polynomial through the `order` + 1 samples up to the asked
        instant.

        Real time stamps count. Order 1 is the slope of the last two samples, with an error up to half a sampling
        period times the second derivative; higher orders are exact for polynomials of that order and louder with noise.
        """
        return self._make("rate", order)  # type: ignore[no-any-return]

    def integral(self, start: float = 0.0, *, max_gap_s: float | None = None) -> Integral:
        """Return the integral over time (unit × s), in trapezoids of real time stamps, from the sample that is newest at
        the first call.

        Unknown samples are bridged; known ones further apart than `max_gap_s` (default: what makes the state stale, or any
        distance) are not: that time adds nothing and is counted in `.skipped_s`. `.reset()` begins again.
        """
        return self._make("integral", start, max_gap_s)  # type: ignore[no-any-return]

    def filtered(self, kind: Filter, *, uneven: Uneven = "resample") -> Filtered:
        """Return the quantity behind a filter (see `aces_bus.state.filters` and `design`), with a history of its own.

        A filter designed for a rate needs even samples. `uneven` says what becomes of others: "resample"
        interpolates onto the even grid of the filter's rate, "refuse" makes the output `UNKNOWN` where samples are
        not even to 10 % of the period and starts the filter anew, "accept" takes each sample as one. Filters without
        a rate take samples as they come.
        """
        return self._make("filtered", kind, uneven)  # type: ignore[no-any-return]

    def window(
        self, t0: float | None = None, t1: float = 0.0, *, rate_hz: float | None = None
    ) -> SampleWindow:
        """Return samples from `t0` to `t1` (seconds from the origin; None: all that are kept) as arrays, NaN
        where unknown.

        `rate_hz` interpolates onto an even grid that ends at `t1`. Raises `StateError` when samples of that
        time were dropped.
        """
        from .window import window_of

        return window_of(self, t0, t1, rate_hz)

    def spectrum(self, window_s: float, *, taper: str = "hann", rate_hz: float | None = None) -> Spectrum:
        """Return amplitudes over frequency of the last `window_s` seconds; see `aces_bus.state.window`."""
        from .window import spectrum_of

        return spectrum_of(self, window_s, taper, rate_hz)

    # ---- arithmetic -----------------------------------------------------------------------------------------------

    def _with(self, symbol: str, function: Callable[..., Any], left: Any, right: Any) -> Derived:
        from .derived import combined

        return combined(symbol, function, left, right)

    def __add__(self, other: TimeSeries | float) -> Derived:
        return self._with("+", operator.add, self, other)

    def __radd__(self, other: float) -> Derived:
        return self._with("+", operator.add, other, self)

    def __sub__(self, other: TimeSeries | float) -> Derived:
        return self._with("-", operator.sub, self, other)

    def __rsub__(self, other: float) -> Derived:
        return self._with("-", operator.sub, other, self)

    def __mul__(self, other: TimeSeries | float) -> Derived:
        return self._with("*", operator.mul, self, other)

    def __rmul__(self, other: float) -> Derived:
        return self._with("*", operator.mul, other, self)

    def __truediv__(self, other: TimeSeries | float) -> Derived:
        return self._with("/", operator.truediv, self, other)

    def __rtruediv__(self, other: float) -> Derived:
        return self._with("/", operator.truediv, other, self)

    def __pow__(self, other: float) -> Derived:
        return self._with("**", operator.pow, self, other)

    def __neg__(self) -> Derived:
        return self._with("*", operator.mul, -1, self)

    def __abs__(self) -> Derived:
        from .derived import derived

        return derived(f"|{self.name}|", abs, self, unit=self.unit)

    def __repr__(self) -> str:
        age = self.age_s
        unit = f" {self.unit}" if self.unit else ""
        aged = "" if age is None else f", {age:.3g} s old"
        return f"<{type(self).__name__} {self.name} = {self.last!r}{unit}{aged}>"

    # Quantities are things, not their values: two are equal when they are the same. `a[0] == b[0]` compares values.
    __array_ufunc__: None = None  # NumPy numbers leave it to us
    __iter__: None = None  # indexing takes seconds, not places
