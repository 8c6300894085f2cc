"""What tests of states share: a state on a virtual clock, and samples for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from hypothesis import strategies as st

from aces_bus.runtime import VirtualClock
from aces_bus.state import State

MS = 1_000_000
S = 1_000_000_000


def made(name: str = "omega", **options: Any) -> State:
    """A state on a virtual clock of its own."""
    options.setdefault("clock", VirtualClock())
    options.setdefault("unit", "rad/s")
    return State(name, **options)


def fed(state: State, function: Callable[[float], float], instants: Iterable[int]) -> State:
    """The state with samples of a function of seconds; its clock, if virtual, goes along."""
    for instant in instants:
        if isinstance(state.clock, VirtualClock):
            state.clock.sleep_until(instant)
        state.push(function(instant / S), instant)
    return state


def instants(least: int = 2, most: int = 60, *, shortest: int = 100_000, longest: int = 20 * MS) -> Any:
    """A strategy: unevenly spaced instants."""
    return st.lists(st.integers(shortest, longest), min_size=least, max_size=most).map(accumulated)


def accumulated(spacings: list[int]) -> list[int]:
    """Instants from what lies between them."""
    at, found = 0, list[int]()
    for spacing in spacings:
        at += spacing
        found.append(at)
    return found


def sine(frequency_hz: float, amplitude: float = 1.0) -> Callable[[float], float]:
    """A sine of seconds."""
    return lambda t: amplitude * math.sin(2 * math.pi * frequency_hz * t)
