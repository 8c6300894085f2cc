"""Quantities computed from others, lazily: `power = torque * omega`.

1. Nothing is stored: a value is computed when it is read, from the inputs' values at that instant, interpolated where they
   have no sample. `power[0]` takes the newest value of each input.
2. It is unknown where an input is, and where the function has no finite value (a division by zero, a square root of -1).
   It is as old as its oldest input, stale as soon as one is.
3. Its samples, for whoever subscribes (filters, integrals), are at every instant at which an input has one, as soon as all
   inputs have come that far.
"""

from __future__ import annotations

import math
import numbers
import threading
from collections.abc import Callable, Sequence
from typing import Any

from ..device.reading import UNKNOWN
from ..runtime import RealClock
from ..runtime.clock import Clock
from . import units
from .errors import StateError
from .quantity import Listener, TimeSeries

_INFINITY = math.inf
_NEVER = -(1 << 63)


class Derived(TimeSeries):
    """A function of other quantities."""

    def __init__(
        self, name: str, function: Callable[..., Any], inputs: Sequence[TimeSeries], unit: str | None
    ) -> None:
        super().__init__(name, unit, _common_clock(name, inputs))
        self.function, self.inputs = function, tuple(inputs)
        self._sources = tuple(dict.fromkeys(inputs))
        self.history = min(quantity.history for quantity in inputs)
        self.stale_after_s = min(
            (quantity.stale_after_s for quantity in inputs if quantity.stale_after_s is not None),
            default=None,
        )
        self._listeners: list[Listener] = []
        self._emitted, self._emitted_epoch = _NEVER, 0
        self._lock = threading.RLock()  # a listener may set an input
        #: Samples that listeners did not get, as an input's history had gone by then.
        self.skipped = 0
        #: What the function raised last, when a sample was made for listeners: they got `UNKNOWN`.
        self.failure: Exception | None = None

    def named(self, name: str, unit: str | None = None) -> Derived:
        """Return the same under a name, and in a unit of your choice of symbols ("W" for N·m·rad/s)."""
        return Derived(name, self.function, self.inputs, self.unit if unit is None else unit)

    def _computed(self, values: list[Any]) -> Any:
        if UNKNOWN in values:
            return UNKNOWN
        try:
            result = self.function(*values)
        except (ArithmeticError, ValueError):
            return UNKNOWN
        return result if not isinstance(result, complex) and -_INFINITY < result < _INFINITY else UNKNOWN

    @property
    def value(self) -> Any:
        """The function of the inputs' newest values; `UNKNOWN` where one is unknown or stale."""
        return self._computed([quantity[0] for quantity in self.inputs])

    @property
    def last(self) -> Any:
        """The same with stale values, too."""
        return self._computed([quantity.last for quantity in self.inputs])

    def at(self, instant: int) -> Any:
        """Return the function of the inputs at an instant (ns)."""
        return self._computed([quantity.at(instant) for quantity in self.inputs])

    @property
    def span(self) -> tuple[int, int] | None:
        """Time in which all inputs have values of their own; None if there is none."""
        start, end = _NEVER, 1 << 63
        for source in self._sources:
            span = source.span
            if span is None:
                return None
            start, end = max(start, span[0]), min(end, span[1])
        return (start, end) if start <= end else None

    def _oldest(self, which: str) -> int | None:
        oldest: int | None = None
        for source in self._sources:
            instant: int | None = getattr(source, which)
            if instant is None:
                return None
            if oldest is None or instant < oldest:
                oldest = instant
        return oldest

    @property
    def instant(self) -> int | None:
        """The oldest of the inputs' newest instants (ns)."""
        return self._oldest("instant")

    @property
    def origin(self) -> int | None:
        """The instant of `[0]` when the past is counted from it: the oldest of the inputs' origins."""
        return self._oldest("origin")

    @property
    def is_stale(self) -> bool:
        """True if an input is stale."""
        return any(source.is_stale for source in self._sources)

    @property
    def epoch(self) -> int:
        """Grows with each of the inputs'."""
        return sum(source.epoch for source in self._sources)

    @property
    def forgotten(self) -> int | None:
        """The latest of the inputs' instants before which samples are gone."""
        return max(
            (source.forgotten for source in self._sources if source.forgotten is not None), default=None
        )

    def samples_up_to(self, instant: int, most: int) -> list[int]:
        """Return the instants of the inputs' samples together, up to the first that is not before `instant`."""
        found = [source.samples_up_to(instant, most) for source in self._sources]
        if not all(found):
            return []
        last = min(instants[-1] for instants in found)
        return sorted({at for instants in found for at in instants if at <= last})[-most:]

    def samples_between(self, start: int, end: int) -> list[int]:
        """Return the instants of all the inputs' samples there, as far as all of them reach."""
        span = self.span
        if span is None:
            return []
        start, end = max(start, span[0]), min(end, span[1])
        if len(self._sources) == 1:
            return self._sources[0].samples_between(start, end)
        return sorted({at for source in self._sources for at in source.samples_between(start, end)})

    def subscribe(self, listener: Listener) -> None:
        """Call `listener(value, instant)` with each new sample (rule 3)."""
        if not self._listeners:
            newest = self.instant
            self._emitted = _NEVER if newest is None else newest
            self._emitted_epoch = self.epoch
            for source in self._sources:
                source.subscribe(self._advanced)
        self._listeners.append(listener)

    def _advanced(self, _value: Any, _instant: int) -> None:
        with self._lock:  # inputs of two buses come on two threads
            newest = self.instant
            if newest is None:
                return
            if newest <= self._emitted:
                if self.epoch == self._emitted_epoch:
                    return
                self._emitted = _NEVER
            self._emitted_epoch = self.epoch
            since, self._emitted = self._emitted, newest
            for instant in self.samples_between(since + 1, newest):
                self._emit(instant)

    def _emit(self, instant: int) -> None:
        try:
            value = self.at(instant)
        except StateError:
            self.skipped += 1
            return
        except Exception as error:  # a function of the user's own: its inputs must go on
            self.failure = error
            value = UNKNOWN
        for listener in self._listeners:
            listener(value, instant)


def derived(name: str, function: Callable[..., Any], *inputs: TimeSeries, unit: str | None = None) -> Derived:
    """Return the quantity `function(*inputs)`, in `unit`.

    >>> import math
    >>> from aces_bus.runtime import VirtualClock
    >>> from aces_bus.state import State
    >>> clock = VirtualClock()
    >>> x, y = State("x", unit="m", clock=clock), State("y", unit="m", clock=clock)
    >>> heading = derived("heading", math.atan2, y, x, unit="rad")
    >>> heading[0]
    UNKNOWN
    >>> x.push(1.0, 0); y.push(0.0, 0)
    >>> heading[0]
    0.0
    """
    given: tuple[Any, ...] = inputs
    if not given or not all(isinstance(quantity, TimeSeries) for quantity in given):
        raise StateError(f"state {name!r}: give the quantities that it is computed from")
    return Derived(name, function, inputs, unit)


def combined(symbol: str, function: Callable[..., Any], left: Any, right: Any) -> Derived:
    """Return what an operator between two quantities, or one and a number, gives; a number is in the quantity's unit."""
    for operand in (left, right):
        if not isinstance(operand, TimeSeries | numbers.Real):
            raise StateError(f"{operand!r} is neither a state nor a number: states are combined with those")
    names = [operand.name if isinstance(operand, TimeSeries) else f"{operand:g}" for operand in (left, right)]
    name = f"({names[0]} {symbol} {names[1]})"
    if isinstance(left, TimeSeries) and isinstance(right, TimeSeries):
        return Derived(name, function, (left, right), _unit(name, symbol, left.unit, right.unit))
    if isinstance(left, TimeSeries):
        unit = units.raise_unit(left.unit, right) if symbol == "**" else left.unit
        return Derived(name, lambda value: function(value, right), (left,), unit)
    unit = units.multiplied("", right.unit, -1) if symbol == "/" else right.unit
    return Derived(name, lambda value: function(left, value), (right,), unit)


def _unit(name: str, symbol: str, left: str | None, right: str | None) -> str | None:
    if symbol in "+-":
        if not units.are_same(left, right):
            raise StateError(
                f"{name}: {left or 'a plain number'} and {right or 'a plain number'} do not add up"
            )
        return right if left is None else left
    if symbol == "**":
        return "" if left == right == "" else None
    return units.multiplied(left, right, -1 if symbol == "/" else 1)


def _common_clock(name: str, inputs: Sequence[TimeSeries]) -> Clock:
    first = inputs[0].clock
    for quantity in inputs[1:]:
        both_real = quantity.clock.name == first.name == RealClock.name
        if quantity.clock is not first and not both_real:
            raise StateError(
                f"{name}: {inputs[0].name!r} and {quantity.name!r} have different clocks, and their instants cannot be "
                "compared; give both states the same clock=…"
            )
    return first
