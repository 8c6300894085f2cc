"""What a state knows beyond its samples: extrapolation, Kalman filters, a function of the user's own.

1. An estimator is a description; `start(state)` makes what runs, so that one description serves many states.
2. It is asked only for instants outside of the history: inside, samples and their interpolation count.
3. What it cannot say is `UNKNOWN`, never a guess.

A function `f(state, instant)` is an estimator too: it gives the value at an instant (ns).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from ..device.reading import UNKNOWN
from .errors import StateError
from .polynomial import value_at

if TYPE_CHECKING:
    from .state import State

Observe = Callable[[float, int], None]
Estimate = Callable[..., Any]


class Estimation(NamedTuple):
    """A running estimator: given each known sample (None: not needed), asked for the value at an instant (ns)."""

    observe: Observe | None
    estimate: Estimate


class Estimator(Protocol):
    """What describes one."""

    def start(self, state: State) -> Estimation:
        """Begin for one state."""
        ...


def started(estimator: Estimator | Estimate, state: State) -> Estimation:
    """Start an estimator, or take a function `f(state, instant)` for one."""
    start = getattr(estimator, "start", None)
    if start is not None:
        return start(state)  # type: ignore[no-any-return]
    if not callable(estimator):
        raise StateError(
            f"state {state.name!r}: {estimator!r} is not an estimator; give Kalman(…), ConstantVelocity(), "
            "ConstantAcceleration(), Hold() or a function of the state and an instant"
        )
    return Estimation(None, lambda instant: estimator(state, instant))


@dataclass(frozen=True)
class Extrapolation:
    """The polynomial of an order through the newest (into the future) or oldest (into the past) order + 1 known samples.

    With fewer samples than that, of the order that they allow.
    """

    order: int

    def start(self, state: State) -> Estimation:
        """Begin for one state."""

        def estimate(instant: int) -> Any:
            newest = state.instant
            is_future = newest is not None and instant > newest
            instants, values = state.known_samples(self.order + 1, newest=is_future)
            return value_at(instants, values, instant) if values else UNKNOWN

        return Estimation(None, estimate)


def Hold() -> Extrapolation:
    """Return an estimator that repeats the last known value."""
    return Extrapolation(0)


def ConstantVelocity() -> Extrapolation:
    """Return an estimator that continues the line through two samples; it amplifies noise: see `Kalman`."""
    return Extrapolation(1)


def ConstantAcceleration() -> Extrapolation:
    """Return an estimator that continues the parabola through three samples."""
    return Extrapolation(2)
