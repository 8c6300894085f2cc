"""A state: one quantity as samples with their instants.

1. `push` never raises for a value, whatever it is: NaN, infinities, text and `UNKNOWN` are kept as an unknown
   sample, and counted.
2. Instants only grow. A sample older than the newest is dropped (`counts.late`); one at the same instant takes its place
   (`counts.repeated`), and is not passed to listeners again.
3. One thread pushes; any may read. A sample is in place before `_count` says so, and a reader that was overtaken
   reads again.
4. No allocation for a sample: instants and values are preallocated arrays.

Theory: the ring is written twice, at `i` and at `i + size`, so that the newest n samples are always one contiguous piece and
`bisect` and NumPy need no wrap-around. `size` is larger than the history by SPARE: what a reader looks at is not overwritten
before that many samples have come.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import Any

from ..device.reading import UNKNOWN
from ..runtime import RealClock
from ..runtime.clock import Clock
from .declaration import (
    Interpolation,
    SampleCounts,
    SignalSource,
    checked_history,
    checked_name,
    checked_order,
    checked_seconds,
)
from .errors import StateError
from .estimators import Estimate, Estimator, Observe, started
from .polynomial import value_at
from .quantity import EDGE_NS, Listener, TimeSeries

#: See the theory above.
SPARE = 64
_NEVER = -(1 << 63)
_INFINITY = math.inf
_NAN = math.nan


class State(TimeSeries):
    """A quantity that is sensed, or set.

    `node` is the identification that its device gives it, `type` what its values are (float, int or bool; others are not
    quantities). It is writable when it has a `setter`, or by `writable`, when it is `sampled=False`: then a set-point is its
    value at once, as it is not measured. `period_s` is how often it should be refreshed; `refresh` asks for that through
    `request`. `history` counts samples; `history_s` says the same in seconds, and needs `period_s`. `interpolation`
    is "hold" (the last one counts; what whole numbers get), "linear", "cubic" or the order of the polynomial.
    `stale_after_s` is the age after which the value passes no longer as fresh; None: never.

    >>> from aces_bus.runtime import VirtualClock
    >>> clock = VirtualClock()
    >>> omega = State("omega", unit="rad/s", clock=clock)
    >>> for ms, value in [(0, 1.0), (10, 2.0), (20, 4.0)]:
    ...     omega.push(value, ms * 1_000_000)
    >>> omega[0], omega[-0.01], omega[-0.015]
    (4.0, 2.0, 1.5)
    """

    def __init__(
        self,
        name: str,
        *,
        unit: str | None = "",
        node: int | str | None = None,
        type: type[float] | type[int] | type[bool] = float,
        clock: Clock | None = None,
        writable: bool | None = None,
        setter: Callable[[Any], None] | None = None,
        sampled: bool = True,
        period_s: float | None = None,
        request: Callable[[], None] | None = None,
        history: int | None = None,
        history_s: float | None = None,
        interpolation: Interpolation | None = None,
        estimator: Estimator | Estimate | None = None,
        stale_after_s: float | None = None,
    ) -> None:
        super().__init__(checked_name(name, unit), unit, RealClock() if clock is None else clock)
        if type not in (float, int, bool):
            raise StateError(f"state {name!r}: a quantity is float, int or bool, not {type!r}")
        self.node, self.type = node, type
        self.setter, self.request = setter, request
        self.is_sampled = sampled
        self.is_writable = (setter is not None or not sampled) if writable is None else writable
        if self.is_writable and setter is None and sampled:
            raise StateError(
                f"state {name!r} is writable: say setter=…, or sampled=False where it is not measured"
            )
        self.period_s = checked_seconds(name, "period_s", period_s)
        self.stale_after_s = checked_seconds(name, "stale_after_s", stale_after_s)
        self._stale_after = None if stale_after_s is None else round(stale_after_s * 1e9)
        self.history = checked_history(name, history, history_s, period_s)
        self.order = checked_order(name, interpolation, is_real=type is float)
        self._cast = None if type is float else type
        self._now = self.clock.now

        self._size = size = self.history + SPARE
        self._instants = array("q", bytes(16 * size))
        self._values = array("d", bytes(16 * size))
        self._count = self._begin = self._epoch = 0
        self._newest: Any = UNKNOWN
        self._newest_at = _NEVER
        #: Called with each new sample.
        self.listeners: list[Listener] = []
        self._repeated = self._late = self._unknown = 0
        self._uneven = self._restarts = self._failed = 0
        self._target: State | None = None
        self._source: SignalSource | None = None
        self._is_known = False

        self._observe: Observe | None = None
        self._estimate: Estimate | None = None
        self._estimator = estimator
        if estimator is not None:
            self._observe, self._estimate = started(estimator, self)

    @classmethod
    def of(cls, source: SignalSource, **options: Any) -> State:
        """Return a state fed by a device's signal: its name, unit, clock and staleness, unless `options` say otherwise."""
        options.setdefault("unit", source.unit)
        options.setdefault("clock", source.clock)
        options.setdefault("request", source.request)
        if source.stale_after_ns is not None:
            options.setdefault("stale_after_s", source.stale_after_ns / 1e9)
        if source.is_writable:
            options.setdefault("setter", source.set)
        state = cls(options.pop("name", source.name), **options)
        state.follow(source)
        return state

    def follow(self, source: SignalSource) -> None:
        """Take the samples of a signal from now on, and its last one if there is one."""
        if source.instant is not None:
            self.push(source.last, source.instant)
        source.listeners.append(self.push)
        self._source = source
        self._is_known = hasattr(source, "given")  # it says what was really handed down
        if self._target is not None or not self.is_sampled:
            self._follow_given()

    def _follow_given(self) -> None:
        """Take what is handed down, too: a call for each set-point, which not every state is asked for."""
        if self._is_known:
            given: list[Listener] = getattr(self._source, "given")  # noqa: B009
            if self._was_given not in given:
                given.append(self._was_given)

    def disconnect(self) -> None:
        """Follow nothing any more; what is known stays."""
        if self._source is not None:
            self._source.listeners.remove(self.push)
            if self._was_given in getattr(self._source, "given", ()):
                getattr(self._source, "given").remove(self._was_given)  # noqa: B009
            self._is_known = False
            self._source = None

    # ---- samples come in ------------------------------------------------------------------------------------------

    def push(self, value: Any, instant: int) -> None:
        """Add a sample, measured at `instant` (ns of `clock`)."""
        if instant <= self._newest_at:
            self._push_again(value, instant)
            return
        try:
            if not -_INFINITY < value < _INFINITY:
                return self._push_unknown(instant)
            count = self._count
            size = self._size
            at = count % size
            values, instants = self._values, self._instants
            values[at] = values[at + size] = value
            instants[at] = instants[at + size] = instant
            newest = values[at] if self._cast is None else self._cast(value)
            instant = instants[at]  # NumPy's numbers end here
        except (TypeError, ValueError, OverflowError):
            self._push_unknown(instant)
            return
        # The instant last: beside it there is never an older value, and what it counts from is in the history.
        self._newest = newest
        self._count = count + 1
        self._newest_at = instant
        if self._observe is not None:
            try:
                self._observe(newest, instant)
            except Exception:  # an estimator of the user's own: samples go on
                self._failed += 1
        for listener in self.listeners:
            listener(newest, instant)

    def _push_unknown(self, instant: int) -> None:
        self._store(_NAN, instant, self._count)
        self._newest = UNKNOWN
        self._count += 1
        self._newest_at = instant
        self._unknown += 1
        for listener in self.listeners:
            listener(UNKNOWN, instant)

    def _push_again(self, value: Any, instant: int) -> None:
        """Handle a sample that is not newer than the newest."""
        if instant < self._newest_at or self._count == self._begin:
            self._late += 1
            return
        self._repeated += 1
        try:
            number = float(value) if -_INFINITY < value < _INFINITY else _NAN
        except (TypeError, ValueError, OverflowError):
            number = _NAN
        self._store(number, instant, self._count - 1)
        self._unknown += number != number
        self._newest = UNKNOWN if number != number else number if self._cast is None else self._cast(value)

    def _store(self, number: float, instant: int, count: int) -> None:
        at = count % self._size
        try:
            self._instants[at] = self._instants[at + self._size] = instant
        except (TypeError, OverflowError):
            raise StateError(f"state {self.name!r}: {instant!r} is not an instant in ns of a clock") from None
        self._values[at] = self._values[at + self._size] = number

    def clear(self) -> None:
        """Forget all samples, and begin anew; also what to do when the clock of the samples was set back."""
        self._newest = UNKNOWN
        self._newest_at = _NEVER
        self._begin = self._count
        self._epoch += 1
        if self._estimator is not None:
            self._observe, self._estimate = started(self._estimator, self)
        if self._target is not None:
            self._target.clear()

    @property
    def counts(self) -> SampleCounts:
        """Numbers of samples so far by their outcome."""
        return SampleCounts(
            self._count, self._repeated, self._late, self._unknown, self._uneven, self._restarts, self._failed
        )

    def subscribe(self, listener: Listener) -> None:
        """Call `listener(value, instant)` with each new sample."""
        self.listeners.append(listener)

    # ---- set-points go down ---------------------------------------------------------------------------------------

    def set(self, value: float) -> None:
        """Give a set-point, in `unit`. Raises `StateError` when it is read-only or the value is not a finite number."""
        if not self.is_writable:
            raise StateError(f"state {self.name!r} is read-only")
        if self._is_known and self.setter is not None:
            self.setter(value)
            return
        try:
            is_number = -_INFINITY < value < _INFINITY
        except TypeError:
            is_number = False
        if not is_number:
            raise StateError(f"state {self.name!r}: {value!r} is not a set-point; give a finite number")
        if self.setter is not None:
            self.setter(value)
        self._was_given(value, self._now())

    def _was_given(self, value: float, instant: int) -> None:
        """Note a set-point that was sent."""
        if self._target is not None:
            self._target.push(value, instant)
        if not self.is_sampled:
            self.push(value, instant)

    @property
    def setpoint(self) -> State:
        """The set-points as a state, from its first reading on: to log and draw beside what was measured."""
        if self._target is None:
            self._target = State(
                f"{self.name}.setpoint",
                unit=self.unit,
                node=self.node,
                type=self.type,
                clock=self.clock,
                history=self.history,
                interpolation="hold",
            )
            self._follow_given()
        return self._target

    def refresh(self) -> None:
        """Ask the device for a new sample, from any thread; nothing where samples come by themselves."""
        if self.request is not None:
            self.request()

    # ---- reading --------------------------------------------------------------------------------------------------

    def __getitem__(self, t: float) -> Any:
        """Return the value `t` seconds from the newest sample, with an estimator from now: float or `UNKNOWN`."""
        if self._estimate is None:
            if t == 0:
                if self._stale_after is None or self._now() - self._newest_at <= self._stale_after:
                    return self._newest
                return UNKNOWN
            origin = self._newest_at
            if origin == _NEVER:
                return UNKNOWN
        else:
            if self._newest_at == _NEVER:
                return UNKNOWN
            origin = max(self._now(), self._newest_at)
        try:
            instant = origin + round(t * 1e9)
        except (OverflowError, ValueError, TypeError):
            instant = origin + self.in_ns(t)  # says what is wrong with it
        try:
            return self.at(instant)
        except StateError as error:
            error.is_permanent = error.is_permanent or t > 0
            raise

    def at(self, instant: int) -> Any:
        """Return the value at an instant (ns): a sample, between two the interpolation, beyond them the estimator's."""
        while True:
            count = self._count
            kept = count - self._begin
            if kept <= 0:
                return UNKNOWN
            end = count % self._size + self._size
            start = end - (kept if kept < self.history else self.history)
            instants = self._instants
            at = bisect_left(instants, instant, start, end)
            if at == end:
                newest = instants[end - 1]
                if self._estimate is not None:
                    value = self._beyond(instant)
                elif instant - newest <= EDGE_NS:
                    value = self._values[end - 1]
                else:
                    raise self._no_value(instant)
            elif instants[at] == instant:
                value = self._values[at]
            elif at == start:
                if self._estimate is not None:
                    value = self._beyond(instant)
                elif instants[at] - instant <= EDGE_NS:
                    value = self._values[at]
                else:
                    raise self._no_value(instant)
            elif self.order == 1:
                before, value = instants[at - 1], self._values[at - 1]
                value += (self._values[at] - value) * (instant - before) / (instants[at] - before)
            elif self.order:
                value = self._fitted(instant, at, start, end)
            else:
                value = self._values[at - 1]
            if self._count - count < SPARE:
                break
        if not -_INFINITY < value < _INFINITY:
            return UNKNOWN
        return value if self._cast is None else self._cast(value)

    def _fitted(self, instant: int, at: int, start: int, end: int) -> float:
        """Return the polynomial through the order + 1 known samples around places at - 1 and at, or as many as there are."""
        values = self._values
        low, high = at - 1, at + 1
        if values[low] != values[low] or values[at] != values[at]:
            return _NAN
        want = self.order + 1
        if want == 4 and at - 2 >= start and at + 2 <= end:  # the usual case, in one go
            low, high = at - 2, at + 2
            if values[low] == values[low] and values[at + 1] == values[at + 1]:
                return value_at(self._instants[low:high], values[low:high], instant)
            low, high = at - 1, at + 1
        # Centred where possible; at the ends and beside unknown samples, more from the other side.
        most_low = max(start, at - want)
        most_high = min(end, at + want)
        while high - low < want:
            lower = low > most_low and values[low - 1] == values[low - 1]
            upper = high < most_high and values[high] == values[high]
            if upper and (not lower or high - at <= at - 1 - low):
                high += 1
            elif lower:
                low -= 1
            else:
                break
        return value_at(self._instants[low:high], values[low:high], instant)

    def _beyond(self, instant: int) -> float:
        """Return what the estimator says; nothing (NaN) of the future when the newest sample is stale (rule 2 of
        `quantity`).
        """
        assert self._estimate is not None
        if instant > self._newest_at and self.is_stale:
            return _NAN
        value: Any = self._estimate(instant)
        return _NAN if value is UNKNOWN else value

    def _no_value(self, instant: int) -> StateError:
        where = (
            ""
            if self._source is None
            else f': in the robot\'s file, [states] "{self.name}" = {{ estimator = "velocity" }}, or states={{…}} of the run'
        )
        hint = "give the state an estimator to go beyond it, or keep more with history=… (samples)"
        return self._outside(instant, hint + where)

    @property
    def last(self) -> Any:
        """The newest sample (float, or the state's type), however old; `UNKNOWN` when there is none or it was unknown."""
        return self._newest

    @property
    def span(self) -> tuple[int, int] | None:
        """The instants (ns) of the oldest sample kept and of the newest."""
        start, end, _ = self._piece()
        return None if start == end else (self._instants[start], self._instants[end - 1])

    @property
    def instant(self) -> int | None:
        """When the newest sample was measured (ns); None before the first."""
        return None if self._newest_at == _NEVER else self._newest_at

    @property
    def origin(self) -> int | None:
        """The instant of `state[0]`: the newest sample's instant; with an estimator, now."""
        if self._newest_at == _NEVER:
            return None
        return self._newest_at if self._estimate is None else max(self._now(), self._newest_at)

    @property
    def value(self) -> Any:
        """The newest value if it is fresh, with an estimator brought to now; else `UNKNOWN`."""
        return self[0]

    @property
    def is_stale(self) -> bool:
        """True if the newest sample is older than `stale_after_s`, or there is none."""
        if self._newest_at == _NEVER:
            return True
        return self._stale_after is not None and self._now() - self._newest_at > self._stale_after

    @property
    def epoch(self) -> int:
        """Number of times that the state was cleared."""
        return self._epoch

    @property
    def forgotten(self) -> int | None:
        """The instant (ns) of the oldest sample kept, when older ones had to go."""
        if self._count - self._begin <= self.history:
            return None
        span = self.span
        return None if span is None else span[0]

    def newest_slope(self) -> Any:
        """Return the slope (per second) between the last two samples; `UNKNOWN` where there are none, or one is unknown."""
        while True:
            count = self._count
            if count - self._begin < 2 or self.history < 2:
                return UNKNOWN
            end = count % self._size + self._size
            values, instants = self._values, self._instants
            slope = (values[end - 1] - values[end - 2]) * 1e9 / (instants[end - 1] - instants[end - 2])
            if self._count - count < SPARE:
                return slope if -_INFINITY < slope < _INFINITY else UNKNOWN

    def samples_up_to(self, instant: int, most: int) -> list[int]:
        """Return the instants of up to `most` samples; the last one is the first that is not before
        `instant`, or the newest.
        """
        while True:
            start, end, count = self._piece()
            stop = min(end, bisect_left(self._instants, instant, start, end) + 1)
            found = self._instants[max(start, stop - most) : stop].tolist()
            if self._count - count < SPARE:
                return found

    def samples_between(self, start: int, end: int) -> list[int]:
        """Return the instants of all samples kept with start ≤ instant ≤ end."""
        return self.piece_between(start, end)[0].tolist()

    def piece_between(self, start: int, end: int) -> tuple[array[int], array[float]]:
        """Return instants (ns) and values (NaN: unknown) of the samples kept with start ≤ instant ≤ end, copied."""
        while True:
            low, high, count = self._piece()
            first = bisect_left(self._instants, start, low, high)
            behind = bisect_right(self._instants, end, first, high)
            found = self._instants[first:behind], self._values[first:behind]
            if self._count - count < SPARE:
                return found

    def known_samples(self, most: int, *, newest: bool) -> tuple[list[int], list[float]]:
        """Return instants and values of up to `most` known samples at the newest or the oldest end, ascending."""
        span = self.span
        if span is None:
            return [], []
        instants, values = self.piece_between(*span)
        known = (
            [i for i, value in enumerate(values) if value == value]
            if most > 16
            else self._some(values, most, newest)
        )
        known = known[-most:] if newest else known[:most]
        return [instants[i] for i in known], [values[i] for i in known]

    @staticmethod
    def _some(values: array[float], most: int, newest: bool) -> list[int]:
        places = range(len(values) - 1, -1, -1) if newest else range(len(values))
        found: list[int] = []
        for i in places:
            if values[i] == values[i]:
                found.append(i)
                if len(found) == most:
                    break
        return sorted(found)

    def _piece(self) -> tuple[int, int, int]:
        """Start and end of the history in the arrays, and the count that this holds for."""
        count = self._count
        end = count % self._size + self._size
        return end - min(max(count - self._begin, 0), self.history), end, count
