"""Filters: descriptions, each of which starts as many running filters as are asked for.

1. A running filter is `step(value, instant) -> value`: floats, in order of time; it never sees an unknown sample.
2. It starts in the steady state of its first value, as if that had always been; `initial="zero"` starts from rest at zero.
3. A filter designed for a rate says so (`rate_hz`); one without takes samples as they come, by real time (`LowPass`,
   `RateLimit`, `Kalman`) or by count (`MovingAverage`, `Median`).

Coefficients are found by `aces_bus.state.design`; what runs here is a few lines, as a library's call for one sample costs
more than the sum.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from .errors import StateError, raise_first

Step = Callable[[float, int], float]
Initial = Literal["steady", "zero"]

#: Samples a filter may keep.
MOST_LENGTH = 100_000


class Filter(Protocol):
    """What describes a filter. A plain function `f(value) -> value` is one, too: with a state of its own, use it once."""

    @property
    def rate_hz(self) -> float | None:
        """The rate it is designed for; None: any samples."""
        ...

    def start_filter(self, first: float) -> Step:
        """Start a filter, whose first value will be `first`."""
        ...


class AnyRate:
    """What a filter is that takes samples as they come."""

    rate_hz: float | None = None


def _is_length(length: Any) -> bool:
    return isinstance(length, int) and 1 <= length <= MOST_LENGTH


@dataclass(frozen=True)
class MovingAverage(AnyRate):
    """Moving averages in cascade, by count of samples. Behind averages of n, m and l samples velocity, acceleration
    and jerk of a step are limited to 1/n, 1/(n·m) and 1/(n·m·l) of it per sample; it settles within n + m + l - 2 samples.

    >>> step = MovingAverage((2, 2, 2), initial="zero").start_filter(1.0)
    >>> [step(1.0, 0) for _ in range(4)]
    [0.125, 0.5, 0.875, 1.0]
    """

    lengths: int | tuple[int, ...]
    initial: Initial = "steady"

    def __post_init__(self) -> None:
        lengths = self.lengths if isinstance(self.lengths, tuple) else (self.lengths,)
        if not lengths or not all(_is_length(length) for length in lengths):
            raise StateError(f"{self}: give one or more lengths of 1 … {MOST_LENGTH} samples")

    def start_filter(self, first: float) -> Step:
        """Start a filter, whose first value will be `first`."""
        lengths = self.lengths if isinstance(self.lengths, tuple) else (self.lengths,)
        level = first if self.initial == "steady" else 0.0
        return _cascade([_average(length, level) for length in lengths])


def _cascade(stages: Sequence[Callable[[float], float]]) -> Step:
    """Return a running filter that gives each stage's output to the next."""

    def step(value: float, _instant: int) -> float:
        for stage in stages:
            value = stage(value)
        return value

    return step


def _average(length: int, filled: float) -> Callable[[float], float]:
    ring = [filled] * length
    total, at, share = filled * length, 0, 1 / length

    def stage(value: float) -> float:
        nonlocal total, at
        total += value - ring[at]
        ring[at] = value
        at += 1
        if at == length:
            at = 0
            total = math.fsum(ring)  # what rounding has left behind does not add up for ever
        return total * share

    return stage


@dataclass(frozen=True)
class Median(AnyRate):
    """The median of the last `length` samples: takes out spikes of up to half of them. Fewer at the beginning."""

    length: int

    def __post_init__(self) -> None:
        if not _is_length(self.length):
            raise StateError(f"{self}: a length of 1 … {MOST_LENGTH} samples")

    def start_filter(self, first: float) -> Step:
        """Start a filter, whose first value will be `first`."""
        length, recent, in_order = self.length, deque[float](), list[float]()

        def step(value: float, _instant: int) -> float:
            if len(recent) == length:
                del in_order[bisect_left(in_order, recent.popleft())]
            recent.append(value)
            insort(in_order, value)
            middle, is_odd = divmod(len(in_order), 2)
            return in_order[middle] if is_odd else 0.5 * (in_order[middle - 1] + in_order[middle])

        return step


@dataclass(frozen=True)
class RateLimit(AnyRate):
    """Follows its input by at most `rising_per_s` upwards and `falling_per_s` (default: the same) downwards; real time."""

    rising_per_s: float
    falling_per_s: float | None = None

    def __post_init__(self) -> None:
        if not self.rising_per_s > 0 or not (self.falling_per_s is None or self.falling_per_s > 0):
            raise StateError(f"{self}: rates are unit per second, > 0")

    def start_filter(self, first: float) -> Step:
        """Start a filter, whose first value will be `first`."""
        rise = self.rising_per_s * 1e-9
        fall = rise if self.falling_per_s is None else self.falling_per_s * 1e-9
        here = first
        since: int | None = None

        def step(value: float, instant: int) -> float:
            nonlocal here, since
            elapsed = 0 if since is None else instant - since
            since = instant
            change = value - here
            if change > rise * elapsed:
                here += rise * elapsed
            elif -change > fall * elapsed:
                here -= fall * elapsed
            else:
                here = value
            return here

        return step


@dataclass(frozen=True)
class LowPass(AnyRate):
    """First order, by real time: what is left of a step after t seconds is exp(-t / `time_constant_s`), however it
    is sampled.
    """

    time_constant_s: float

    def __post_init__(self) -> None:
        if not 0 < self.time_constant_s < math.inf:
            raise StateError(f"{self}: the time constant is seconds, > 0")

    def start_filter(self, first: float) -> Step:
        """Start a filter, whose first value will be `first`."""
        decay, exp = -1e-9 / self.time_constant_s, math.expm1
        here, since = first, 0
        is_first = True

        def step(value: float, instant: int) -> float:
            nonlocal here, since, is_first
            if is_first:
                is_first = False
            else:
                here -= exp(decay * (instant - since)) * (value - here)
            since = instant
            return here

        return step


@dataclass(frozen=True)
class Sos:
    """Second-order sections: rows (b0, b1, b2, a0, a1, a2), as scipy.signal's `output="sos"` has them, for samples
    at `rate_hz`.

    >>> half = Sos(((0.5, 0.5, 0, 1, 0, 0),), rate_hz=100)        # the mean of two
    >>> step = half.start_filter(1.0)
    >>> step(1.0, 0), step(3.0, 0)
    (1.0, 2.0)
    """

    sections: tuple[tuple[float, ...], ...]
    rate_hz: float
    initial: Initial = "steady"

    def __post_init__(self) -> None:
        rows = tuple(tuple(float(number) for number in row) for row in self.sections)
        raise_first(
            StateError,
            (
                not rows
                or any(len(row) != 6 or row[3] == 0 or not all(map(math.isfinite, row)) for row in rows),
                "Sos: sections are rows of six finite numbers b0, b1, b2, a0, a1, a2, a0 not zero",
            ),
            (not 0 < self.rate_hz < math.inf, f"Sos: rate_hz = {self.rate_hz!r} is not a rate"),
        )
        object.__setattr__(self, "sections", rows)

    def start_filter(self, first: float) -> Step:
        """Start a filter, whose first value will be `first`."""
        level = first if self.initial == "steady" else 0.0
        stages: list[Callable[[float], float]] = []
        for b0, b1, b2, a0, a1, a2 in self.sections:
            stage, level = _section(b0 / a0, b1 / a0, b2 / a0, a1 / a0, a2 / a0, level)
            stages.append(stage)
        return _cascade(stages)


def _section(
    b0: float, b1: float, b2: float, a1: float, a2: float, level: float
) -> tuple[Callable[[float], float], float]:
    """Return a section in the transposed direct form II, steady at `level`, and the level behind it."""
    poles = 1 + a1 + a2
    behind = level * (b0 + b1 + b2) / poles if poles else 0.0  # an integrator has no steady state
    second = b2 * level - a2 * behind if poles else 0.0
    first = b1 * level - a1 * behind + second if poles else 0.0

    def stage(value: float) -> float:
        nonlocal first, second
        result = b0 * value + first
        first = b1 * value - a1 * result + second
        second = b2 * value - a2 * result
        return result

    return stage, behind
